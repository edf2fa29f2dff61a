//! The pinhole camera with lens distortion (paper, Eq. 1–3; OpenCV's model and order).
//!
//! Eq. 2 maps the ideal normalised point (x, y) = (X/Z, Y/Z) to the distorted one; pixels follow
//! by u = fx·x' + u0, v = fy·y' + v0.

use super::{Matrix2, Point3, Vector2, Vector3};
use nalgebra::{Matrix2x3, SMatrix};

/// How many parameters a camera has; their order is fx, fy, u0, v0, k1, k2, p1, p2, k3.
pub const PARAMETERS: usize = 9;

/// Radial (k1, k2, k3) and tangential (p1, p2) distortion, Eq. 2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// r² coefficient.
    pub k1: f64,
    /// r⁴ coefficient.
    pub k2: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// r⁶ coefficient.
    pub k3: f64,
}

/// Intrinsic parameters of one camera at one image size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point, u.
    pub u0: f64,
    /// Principal point, v.
    pub v0: f64,
    /// Lens distortion.
    pub distortion: Distortion,
}

/// A projected pixel with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct ProjectionJacobian {
    /// The pixel.
    pub pixel: Vector2,
    /// ∂(u, v)/∂(X, Y, Z), px/mm.
    pub by_point: Matrix2x3<f64>,
    /// ∂(u, v)/∂(fx, fy, u0, v0, k1, k2, p1, p2, k3).
    pub by_camera: SMatrix<f64, 2, PARAMETERS>,
}

impl Distortion {
    /// Eq. 2: the ideal normalised point to the distorted one.
    #[inline]
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let Self { k1, k2, p1, p2, k3 } = *self;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// ∂(x', y')/∂(x, y) of Eq. 2.
    #[inline]
    pub fn jacobian(&self, x: f64, y: f64) -> Matrix2 {
        let Self { k1, k2, p1, p2, k3 } = *self;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)); // ∂radial/∂x = slope·x
        let cross = slope * x * y + 2.0 * (p1 * x + p2 * y);
        Matrix2::new(
            radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        )
    }

    /// Inverse of Eq. 2 by Newton's method; `None` where the model folds over (no inverse there).
    #[inline]
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<(f64, f64)> {
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let (fx, fy) = self.distort(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            let j = self.jacobian(x, y);
            let det = j.determinant();
            if !(det > 1e-6) {
                return None;
            }
            let dx = (j.m22 * ex - j.m12 * ey) / det;
            let dy = (j.m11 * ey - j.m21 * ex) / det;
            x -= dx;
            y -= dy;
            if dx * dx + dy * dy < 1e-26 {
                return Some((x, y));
            }
        }
        None
    }
}

impl Camera {
    /// The parameters in the order of [`PARAMETERS`].
    pub fn parameters(&self) -> [f64; PARAMETERS] {
        let d = &self.distortion;
        [
            self.fx, self.fy, self.u0, self.v0, d.k1, d.k2, d.p1, d.p2, d.k3,
        ]
    }

    /// The same camera with other parameters (order of [`PARAMETERS`]).
    pub fn with_parameters(&self, p: &[f64; PARAMETERS]) -> Self {
        Self {
            fx: p[0],
            fy: p[1],
            u0: p[2],
            v0: p[3],
            distortion: Distortion {
                k1: p[4],
                k2: p[5],
                p1: p[6],
                p2: p[7],
                k3: p[8],
            },
            ..*self
        }
    }

    /// Eq. 1 and 2: the pixel at which a point in the camera frame appears; `None` behind the camera.
    #[inline]
    pub fn project(&self, p: &Point3) -> Option<Vector2> {
        if !(p.z > 0.0) {
            return None;
        }
        let (x, y) = self.distortion.distort(p.x / p.z, p.y / p.z);
        Some(Vector2::new(self.fx * x + self.u0, self.fy * y + self.v0))
    }

    /// [`Camera::project`] with derivatives by the point and by the camera's parameters.
    #[inline]
    pub fn project_with_jacobian(&self, p: &Point3) -> Option<ProjectionJacobian> {
        if !(p.z > 0.0) {
            return None;
        }
        let iz = 1.0 / p.z;
        let (x, y) = (p.x * iz, p.y * iz);
        let (xd, yd) = self.distortion.distort(x, y);
        let d = self.distortion.jacobian(x, y);
        let by_normalised = Matrix2::new(
            self.fx * d.m11,
            self.fx * d.m12,
            self.fy * d.m21,
            self.fy * d.m22,
        );
        let by_point = by_normalised * Matrix2x3::new(iz, 0.0, -x * iz, 0.0, iz, -y * iz);
        let r2 = x * x + y * y;
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let (fx, fy) = (self.fx, self.fy);
        let by_camera = SMatrix::<f64, 2, PARAMETERS>::from_row_slice(&[
            xd,
            0.0,
            1.0,
            0.0,
            fx * x * r2,
            fx * x * r4,
            fx * 2.0 * x * y,
            fx * (r2 + 2.0 * x * x),
            fx * x * r6, //
            0.0,
            yd,
            0.0,
            1.0,
            fy * y * r2,
            fy * y * r4,
            fy * (r2 + 2.0 * y * y),
            fy * 2.0 * x * y,
            fy * y * r6,
        ]);
        Some(ProjectionJacobian {
            pixel: Vector2::new(fx * xd + self.u0, fy * yd + self.v0),
            by_point,
            by_camera,
        })
    }

    /// The ray through a pixel as (x, y, 1): Eq. 3 after undoing Eq. 2. A point on it is Z·ray.
    /// `None` where the distortion has no inverse.
    #[inline]
    pub fn ray(&self, pixel: &Vector2) -> Option<Vector3> {
        let (x, y) = self
            .distortion
            .undistort((pixel.x - self.u0) / self.fx, (pixel.y - self.v0) / self.fy)?;
        Some(Vector3::new(x, y, 1.0))
    }

    /// Whether a pixel position lies on the sensor (pixel centres at integers).
    pub fn contains(&self, pixel: &Vector2) -> bool {
        (-0.5..self.width as f64 - 0.5).contains(&pixel.x)
            && (-0.5..self.height as f64 - 0.5).contains(&pixel.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::camera;

    #[test]
    fn a_ray_goes_back_to_its_pixel() {
        let c = camera();
        for (u, v) in [(0.0, 0.0), (1279.0, 959.0), (640.3, 480.7), (100.0, 900.0)] {
            let pixel = Vector2::new(u, v);
            let ray = c.ray(&pixel).unwrap();
            let back = c.project(&Point3::from(ray * 431.0)).unwrap();
            assert!((back - pixel).norm() < 1e-9, "{pixel} came back as {back}");
        }
    }

    #[test]
    fn jacobians_agree_with_differences() {
        let c = camera();
        let p = Point3::new(60.0, -45.0, 420.0);
        let j = c.project_with_jacobian(&p).unwrap();
        assert!((j.pixel - c.project(&p).unwrap()).norm() < 1e-12);
        for i in 0..3 {
            let h = 1e-4;
            let (mut a, mut b) = (p, p);
            a[i] += h;
            b[i] -= h;
            let d = (c.project(&a).unwrap() - c.project(&b).unwrap()) / (2.0 * h);
            assert!((d - j.by_point.column(i)).norm() < 1e-7);
        }
        for i in 0..PARAMETERS {
            let h = 1e-5;
            let (mut a, mut b) = (c.parameters(), c.parameters());
            a[i] += h;
            b[i] -= h;
            let d = (c.with_parameters(&a).project(&p).unwrap()
                - c.with_parameters(&b).project(&p).unwrap())
                / (2.0 * h);
            assert!((d - j.by_camera.column(i)).norm() < 1e-5, "parameter {i}");
        }
    }

    #[test]
    fn a_folded_lens_gives_no_ray() {
        let mut c = camera();
        c.distortion = Distortion {
            k1: -5.0,
            ..Distortion::default()
        };
        assert!(c.ray(&Vector2::new(0.0, 0.0)).is_none());
    }
}
