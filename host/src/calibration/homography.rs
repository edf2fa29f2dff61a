//! Plane-to-image homographies by the normalised direct linear transform (Hartley & Zisserman,
//! Multiple View Geometry, § 4.4), and the board pose that one stands for (Zhang 2000, § 3.1).

use super::solve::Cholesky;
use crate::geometry::{Camera, Matrix3, Pose, Vector2, Vector3};
use nalgebra::Rotation3;

/// Shift and scale that bring points to their centroid and to a mean squared radius of 2.
struct Normalisation {
    centre: Vector2,
    scale: f64,
}

impl Normalisation {
    fn of(points: &[Vector2]) -> Option<Self> {
        let n = points.len() as f64;
        let centre = points.iter().sum::<Vector2>() / n;
        let spread = points
            .iter()
            .map(|p| (p - centre).norm_squared())
            .sum::<f64>()
            / n;
        (spread > 0.0 && spread.is_finite()).then(|| Self {
            centre,
            scale: (2.0 / spread).sqrt(),
        })
    }

    fn matrix(&self) -> Matrix3 {
        let (s, c) = (self.scale, self.centre);
        Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0)
    }

    fn inverse(&self) -> Matrix3 {
        let (s, c) = (1.0 / self.scale, self.centre);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }
}

/// H with (u, v, 1) ∝ H·(x, y, 1), the third element of its third row scaled to the board
/// centroid's depth; `None` for fewer than four points or points on a line.
///
/// The centroid of a board before the camera never maps to infinity, so that element can be held
/// at 1 and eight unknowns remain: normal equations instead of a singular value decomposition.
pub fn estimate(plane: &[Vector2], image: &[Vector2]) -> Option<Matrix3> {
    if plane.len() < 4 || plane.len() != image.len() {
        return None;
    }
    let (from, to) = (Normalisation::of(plane)?, Normalisation::of(image)?);
    let mut a = [[0.0; 8]; 8];
    let mut b = [0.0; 8];
    let mut add = |row: &[f64; 8], value: f64| {
        for i in 0..8 {
            for k in 0..8 {
                a[i][k] += row[i] * row[k];
            }
            b[i] += row[i] * value;
        }
    };
    for (p, q) in plane.iter().zip(image) {
        let (p, q) = ((p - from.centre) * from.scale, (q - to.centre) * to.scale);
        add(&[p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y], q.x);
        add(&[0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y], q.y);
    }
    let h = Cholesky::new(&a)?.solve(&b);
    let normalised = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
    let matrix = to.inverse() * normalised * from.matrix();
    matrix.iter().all(|v| v.is_finite()).then_some(matrix)
}

/// The pose of the plane z = 0 that a homography to *ideal normalised* coordinates stands for:
/// H ∝ (r1 r2 T), made a rotation by the nearest orthogonal matrix.
pub fn pose_of_normalised(h: &Matrix3) -> Option<Pose> {
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
pub fn pose(h: &Matrix3, camera: &Camera) -> Option<Pose> {
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
    pose_of_normalised(&(k * h))
}

/// The pose of points of the plane z = 0 seen at pixels of a camera with distortion (closed form).
pub fn pose_through(camera: &Camera, plane: &[Vector2], pixels: &[Vector2]) -> Option<Pose> {
    let rays = pixels
        .iter()
        .map(|p| camera.ray(p).map(|ray| ray.xy()))
        .collect::<Option<Vec<_>>>()?;
    pose_of_normalised(&estimate(plane, &rays)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Distortion, Point3};

    #[test]
    fn gives_the_pose_back() {
        let camera = Camera {
            width: 1280,
            height: 960,
            fx: 2200.0,
            fy: 2190.0,
            u0: 630.0,
            v0: 470.0,
            distortion: Distortion::default(),
        };
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
        let found = pose(&estimate(&plane, &image).unwrap(), &camera).unwrap();
        assert!((found.translation - truth.translation).norm() < 1e-6);
        assert!(found.rotation.angle_to(&truth.rotation) < 1e-8);
    }

    #[test]
    fn a_line_of_points_has_none() {
        let line: Vec<_> = (0..10)
            .map(|i| Vector2::new(i as f64, 2.0 * i as f64))
            .collect();
        assert!(estimate(&line, &line).is_none());
        assert!(estimate(&line[..3], &line[..3]).is_none());
    }
}
