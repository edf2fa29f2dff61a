//! Planes n·P + d = 0 with |n| = 1 (paper, Eq. 4, 12) and where rays meet them (Eq. 5).

use super::{Matrix3, Point3, Vector3};
use nalgebra::Matrix3x2;

/// A plane n·P + d = 0, n of unit length, d in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: Vector3,
    /// Offset, mm: minus the signed distance of the plane from the origin along the normal.
    pub d: f64,
}

impl Plane {
    /// From any (A, B, C, D) with a non-zero normal, scaled to unit length and turned to C > 0.
    pub fn new(normal: Vector3, d: f64) -> Option<Self> {
        let length = normal.norm();
        if !(length > 0.0 && length.is_finite() && d.is_finite()) {
            return None;
        }
        let scale = if normal.z < 0.0 { -1.0 } else { 1.0 } / length;
        Some(Self {
            normal: normal * scale,
            d: d * scale,
        })
    }

    /// Signed distance of a point, mm, positive on the side of the normal.
    #[inline]
    pub fn distance(&self, p: &Point3) -> f64 {
        self.normal.dot(&p.coords) + self.d
    }

    /// Eq. 5: where the ray Z·(x, y, 1) meets the plane in front of the camera.
    #[inline]
    pub fn meet(&self, ray: &Vector3) -> Option<Point3> {
        let z = -self.d / self.normal.dot(ray);
        (z.is_finite() && z > 0.0).then(|| Point3::from(ray * z))
    }

    /// The plane through a centroid with the direction of least scatter as its normal, and the
    /// three eigenvalues of the scatter, ascending (orthogonal least squares).
    pub fn from_scatter(centroid: &Point3, scatter: &Matrix3) -> Option<(Self, [f64; 3])> {
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
        let normal: Vector3 = eigen.eigenvectors.column(order[0]).into_owned();
        let plane = Self::new(normal, -normal.dot(&centroid.coords))?;
        Some((plane, order.map(|i| eigen.eigenvalues[i])))
    }
}

/// Two unit vectors that span the plane at right angles to the unit vector `n` (right-handed with
/// it). Small changes of a direction are written n + basis·(t1, t2): the frame of the two
/// direction parameters in every covariance.
pub fn tangent_basis(n: &Vector3) -> Matrix3x2<f64> {
    // The axis least along n, so that the cross product is well conditioned.
    let (x, y, z) = (n.x.abs(), n.y.abs(), n.z.abs());
    let axis = if x <= y && x <= z {
        Vector3::x()
    } else if y <= z {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let first = axis.cross(n).normalize();
    Matrix3x2::from_columns(&[first, n.cross(&first)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_its_plane() {
        let plane = Plane::new(Vector3::new(0.02, -0.87, 0.48), -190.0).unwrap();
        let p = plane.meet(&Vector3::new(0.01, 0.02, 1.0)).unwrap();
        assert!(plane.distance(&p).abs() < 1e-12);
        assert!((p.x / p.z - 0.01).abs() < 1e-15);
    }

    #[test]
    fn the_basis_is_right_handed() {
        for n in [
            Vector3::z(),
            Vector3::y(),
            -Vector3::x(),
            Vector3::new(0.6, 0.0, 0.8),
        ] {
            let b = tangent_basis(&n);
            assert!((b.column(0).cross(&b.column(1)) - n).norm() < 1e-14);
        }
    }
}
