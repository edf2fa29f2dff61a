//! The board pose that a plane-to-image homography stands for (Zhang 2000, § 3.1).

use crate::geometry::{Camera, Homography, Matrix3, Pose, Vector2, Vector3};
use nalgebra::Rotation3;

/// The pose of the plane z = 0 that a homography to *ideal normalised* coordinates stands for:
/// H ∝ (r1 r2 T), made a rotation by the nearest orthogonal matrix.
fn pose_of_normalised(h: &Matrix3) -> Option<Pose> {
    let (c1, c2) = (h.column(0).norm(), h.column(1).norm());
    let scale = 2.0 / (c1 + c2) * if h[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    if !scale.is_finite() {
        return None;
    }
    let (r1, r2): (Vector3, Vector3) = (h.column(0) * scale, h.column(1) * scale);
    let t: Vector3 = h.column(2) * scale;
    let (mut e1, mut e2) = (r1.try_normalize(1e-12)?, r2.try_normalize(1e-12)?);
    // Nearest orthonormal pair: both axes give way by half of their deviation from a right angle.
    let (sum, difference) = (
        (e1 + e2).try_normalize(1e-9)?,
        (e1 - e2).try_normalize(1e-9)?,
    );
    let half = std::f64::consts::FRAC_1_SQRT_2;
    e1 = (sum + difference) * half;
    e2 = (sum - difference) * half;
    let rotation = Matrix3::from_columns(&[e1, e2, e1.cross(&e2)]);
    Some(Pose {
        rotation: Rotation3::from_matrix_unchecked(rotation),
        translation: t,
    })
}

/// The pose for a homography to the pixels of a camera without distortion.
pub fn pose(h: &Homography, camera: &Camera) -> Option<Pose> {
    let (ix, iy) = (1.0 / camera.fx, 1.0 / camera.fy);
    let k = Matrix3::new(
        ix,
        0.0,
        -camera.u0 * ix,
        0.0,
        iy,
        -camera.v0 * iy,
        0.0,
        0.0,
        1.0,
    );
    pose_of_normalised(&(k * h.0))
}

/// The pose of points of the plane z = 0 seen at pixels of a camera with distortion (closed form).
pub fn pose_through(camera: &Camera, plane: &[Vector2], pixels: &[Vector2]) -> Option<Pose> {
    let rays = pixels
        .iter()
        .map(|p| camera.ray(p).map(|ray| ray.xy()))
        .collect::<Option<Vec<_>>>()?;
    pose_of_normalised(&Homography::fit(plane, &rays).ok()?.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point3;
    use crate::synthetic::pinhole;

    #[test]
    fn gives_the_pose_back() {
        let camera = pinhole();
        let truth = Pose {
            rotation: Rotation3::new(Vector3::new(2.8, 0.3, 0.4)), // from behind: z of any sign
            translation: Vector3::new(-30.0, 20.0, 440.0),
        };
        let plane: Vec<_> = (0..48)
            .map(|i| Vector2::new((i % 8) as f64 * 10.0, (i / 8) as f64 * 10.0))
            .collect();
        let image: Vec<_> = plane
            .iter()
            .map(|p| {
                camera
                    .project(&truth.apply(&Point3::new(p.x, p.y, 0.0)))
                    .unwrap()
            })
            .collect();
        let found = pose(&Homography::fit(&plane, &image).unwrap(), &camera).unwrap();
        assert!((found.translation - truth.translation).norm() < 1e-6);
        assert!(found.rotation.angle_to(&truth.rotation) < 1e-8);
    }
}
