//! Rigid poses: P_camera = R·P + T (paper, Eq. 6).

use super::{Matrix3, Point3, Vector3};
use nalgebra::{Rotation3, SMatrix};

/// A rigid motion from a local frame (a board's, say) into the camera's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// R.
    pub rotation: Rotation3<f64>,
    /// T, mm.
    pub translation: Vector3,
}

impl Pose {
    /// Eq. 6.
    #[inline]
    pub fn apply(&self, p: &Point3) -> Point3 {
        self.rotation * p + self.translation
    }

    /// The inverse motion of [`Pose::apply`].
    #[inline]
    pub fn apply_inverse(&self, p: &Point3) -> Point3 {
        Point3::from(
            self.rotation
                .inverse_transform_vector(&(p.coords - self.translation)),
        )
    }

    /// ∂(R·P + T)/∂(ω, τ) for the update R ← exp(ω)·R, T ← T + τ.
    #[inline]
    pub fn jacobian(&self, p: &Point3) -> SMatrix<f64, 3, 6> {
        let r = self.rotation * p.coords;
        let mut j = SMatrix::<f64, 3, 6>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&-r.cross_matrix());
        j.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&Matrix3::identity());
        j
    }

    /// The update of [`Pose::jacobian`]: R ← exp(ω)·R, T ← T + τ.
    pub fn updated(&self, omega: &Vector3, tau: &Vector3) -> Self {
        Self {
            rotation: Rotation3::new(*omega) * self.rotation,
            translation: self.translation + tau,
        }
    }

    /// The board's plane z = 0 in the camera frame.
    pub fn plane(&self) -> Option<super::Plane> {
        let n = self.rotation * Vector3::z();
        super::Plane::new(n, -n.dot(&self.translation))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jacobian_agrees_with_differences() {
        let pose = Pose {
            rotation: Rotation3::new(Vector3::new(0.3, -0.2, 1.1)),
            translation: Vector3::new(10.0, -20.0, 430.0),
        };
        let p = Point3::new(30.0, 40.0, 0.0);
        let j = pose.jacobian(&p);
        for i in 0..6 {
            let mut d = [0.0; 6];
            d[i] = 1e-6;
            let w = Vector3::new(d[0], d[1], d[2]);
            let t = Vector3::new(d[3], d[4], d[5]);
            let numeric =
                (pose.updated(&w, &t).apply(&p) - pose.updated(&-w, &-t).apply(&p)) / 2e-6;
            assert!((numeric - j.column(i)).norm() < 1e-6);
        }
        assert!((pose.apply_inverse(&pose.apply(&p)) - p).norm() < 1e-12);
    }
}
