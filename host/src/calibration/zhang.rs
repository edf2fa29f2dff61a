//! Zhang's closed form (IEEE PAMI 22(11), 2000, § 3.1): intrinsics from the homographies of a
//! plane in several views, without skew. Every homography H = (h1 h2 h3) gives two equations on
//! ω = K⁻ᵀK⁻¹: h1ᵀωh2 = 0 and h1ᵀωh1 = h2ᵀωh2.
//!
//! Few or nearly parallel views leave the principal point, then fx/fy, then f itself open. So several
//! solutions are tried, from the full one to a guess of f, and the one that reprojects best starts
//! the maximum-likelihood solve.

use super::plane_pose;
use crate::geometry::{Camera, Distortion, Homography, Matrix3, Point3, Pose, Vector2};
use nalgebra::{Matrix5, SymmetricEigen, Vector5};

/// A camera without distortion and the poses of the views under it, from homographies; `None` if no candidate puts every board before the
/// camera. `plane` are the board's points, mm, `image` each view's pixels.
pub fn start(
    homographies: &[Homography],
    plane: &[Vector2],
    image: &[&[Vector2]],
    width: u32,
    height: u32,
) -> Option<(Camera, Vec<Pose>)> {
    let size = f64::from(width.max(height));
    let centre = Vector2::new(
        (f64::from(width) - 1.0) / 2.0,
        (f64::from(height) - 1.0) / 2.0,
    );
    let equations = Equations::new(homographies, centre, size / 2.0);
    let mut best: Option<(f64, (Camera, Vec<Pose>))> = None;
    let mut consider = |fx: f64, fy: f64, u0: f64, v0: f64| {
        let plausible = (0.2..50.0).contains(&(fx / size))
            && (0.5..2.0).contains(&(fx / fy))
            && (u0 - centre.x).abs() < size / 2.0
            && (v0 - centre.y).abs() < size / 2.0;
        if !plausible {
            return false;
        }
        let camera = Camera {
            width,
            height,
            fx,
            fy,
            u0,
            v0,
            distortion: Distortion::default(),
        };
        let Some((error, poses)) = reprojection(&camera, homographies, plane, image) else {
            return false;
        };
        if best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, (camera, poses)));
        }
        true
    };
    let mut found = false;
    if let Some((fx, fy, u0, v0)) = equations.full() {
        found |= consider(fx, fy, u0, v0);
    }
    if let Some((fx, fy)) = equations.centred() {
        found |= consider(fx, fy, centre.x, centre.y);
    }
    if let Some(f) = equations.square() {
        found |= consider(f, f, centre.x, centre.y);
    }
    if !found {
        for f in [0.5, 0.8, 1.2, 2.0, 4.0, 8.0] {
            consider(f * size, f * size, centre.x, centre.y);
        }
    }
    best.map(|(_, start)| start)
}

/// Sum of squared reprojection errors with the poses that the homographies give.
fn reprojection(
    camera: &Camera,
    homographies: &[Homography],
    plane: &[Vector2],
    image: &[&[Vector2]],
) -> Option<(f64, Vec<Pose>)> {
    let mut sum = 0.0;
    let mut poses = Vec::with_capacity(homographies.len());
    for (h, pixels) in homographies.iter().zip(image) {
        let pose = plane_pose::pose(h, camera)?;
        for (p, q) in plane.iter().zip(*pixels) {
            let seen = camera.project(&pose.apply(&Point3::new(p.x, p.y, 0.0)))?;
            sum += (seen - q).norm_squared();
        }
        poses.push(pose);
    }
    Some((sum, poses))
}

/// Normal equations on (ω11, ω22, ω13, ω23, ω33) in centred pixels scaled to about ±1.
struct Equations {
    normal: Matrix5<f64>,
    centre: Vector2,
    scale: f64,
}

impl Equations {
    fn new(homographies: &[Homography], centre: Vector2, scale: f64) -> Self {
        let s = 1.0 / scale;
        let to = Matrix3::new(s, 0.0, -s * centre.x, 0.0, s, -s * centre.y, 0.0, 0.0, 1.0);
        let mut normal = Matrix5::zeros();
        for h in homographies {
            let h = to * h.0;
            let length = (h.column(0).norm_squared() + h.column(1).norm_squared()).sqrt();
            let h = h / length;
            let v = |i: usize, j: usize| {
                let (a, b) = (h.column(i), h.column(j));
                Vector5::new(
                    a[0] * b[0],
                    a[1] * b[1],
                    a[0] * b[2] + a[2] * b[0],
                    a[1] * b[2] + a[2] * b[1],
                    a[2] * b[2],
                )
            };
            let (orthogonal, equal) = (v(0, 1), v(0, 0) - v(1, 1));
            normal += orthogonal * orthogonal.transpose() + equal * equal.transpose();
        }
        Self {
            normal,
            centre,
            scale,
        }
    }

    /// fx, fy, u0, v0.
    fn full(&self) -> Option<(f64, f64, f64, f64)> {
        let eigen = SymmetricEigen::try_new(self.normal, 1e-15, 200)?;
        let least =
            (0..5).min_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]))?;
        let b = eigen.eigenvectors.column(least);
        let (u, v) = (-b[2] / b[0], -b[3] / b[1]);
        let lambda = b[4] - b[2] * b[2] / b[0] - b[3] * b[3] / b[1];
        let (fx2, fy2) = (lambda / b[0], lambda / b[1]);
        (fx2 > 0.0 && fy2 > 0.0 && u.is_finite() && v.is_finite()).then(|| {
            (
                fx2.sqrt() * self.scale,
                fy2.sqrt() * self.scale,
                u * self.scale + self.centre.x,
                v * self.scale + self.centre.y,
            )
        })
    }

    /// fx, fy with the principal point in the middle of the image.
    fn centred(&self) -> Option<(f64, f64)> {
        let n = &self.normal;
        let det = n[(0, 0)] * n[(1, 1)] - n[(0, 1)] * n[(0, 1)];
        let x = (-n[(0, 4)] * n[(1, 1)] + n[(1, 4)] * n[(0, 1)]) / det;
        let y = (-n[(1, 4)] * n[(0, 0)] + n[(0, 4)] * n[(0, 1)]) / det;
        (x > 0.0 && y > 0.0 && x.is_finite() && y.is_finite())
            .then(|| (self.scale / x.sqrt(), self.scale / y.sqrt()))
    }

    /// One f for both axes, the principal point in the middle of the image.
    fn square(&self) -> Option<f64> {
        let n = &self.normal;
        let x = -(n[(0, 4)] + n[(1, 4)]) / (n[(0, 0)] + 2.0 * n[(0, 1)] + n[(1, 1)]);
        (x > 0.0 && x.is_finite()).then(|| self.scale / x.sqrt())
    }
}
