//! Calibration: the camera (Zhang) and the light planes (Algorithm 1, Eq. 7–10; or the joint
//! maximum-likelihood solve). Knows no files and no images.

pub mod camera;
mod corners;
mod finding;
pub mod light;
pub mod loss;
mod plane_pose;
mod solve;
mod zhang;

pub use finding::{Cause, Finding, Severity};

use crate::geometry::{Camera, Plane, Vector3, tangent_basis};
use crate::stripe::Axis;
use nalgebra::SMatrix;

/// How many parameters the whole calibration has. Their order in every covariance: the camera's
/// nine ([`crate::geometry::PARAMETERS`]), the common normal's two (t1, t2) in
/// [`tangent_basis`], then a and b of D(x) = a·x + b.
pub const PARAMETERS: usize = 13;

/// Covariance of the whole calibration.
pub type Covariance = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Eq. 9 with the common normal: A·X + B·Y + C·Z + a·x + b = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightModel {
    /// (A, B, C), unit, C > 0.
    pub normal: Vector3,
    /// a: mm of D a mm of slide. 0 for a rig whose slide was calibrated at one position only.
    pub a: f64,
    /// b, mm.
    pub b: f64,
}

impl LightModel {
    /// The light plane with the slide at x mm (Eq. 9).
    #[inline]
    pub fn plane(&self, slide_mm: f64) -> Plane {
        Plane {
            normal: self.normal,
            d: self.a * slide_mm + self.b,
        }
    }

    /// The model moved by (t1, t2, da, db), the last four of [`PARAMETERS`].
    pub fn updated(&self, step: &[f64; 4]) -> Self {
        let t = tangent_basis(&self.normal);
        let n = self.normal + t * nalgebra::Vector2::new(step[0], step[1]);
        Self {
            normal: n.normalize(),
            a: self.a + step[2],
            b: self.b + step[3],
        }
    }
}

/// What triangulation needs to know of the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigModel {
    /// The camera.
    pub camera: Camera,
    /// The light planes.
    pub light: LightModel,
    /// Covariance of both together, in the order of [`PARAMETERS`]; zero where not known.
    pub covariance: Covariance,
}

impl RigModel {
    /// Along which axis of the image the stripe is to be searched. On a surface that faces the camera
    /// the light plane leaves a line at right angles to (A/fx, B/fy), at any depth.
    pub fn stripe_axis(&self) -> Axis {
        let n = &self.light.normal;
        match (n.x / self.camera.fx).abs() > (n.y / self.camera.fy).abs() {
            true => Axis::Rows,
            false => Axis::Columns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point3;

    /// Against the stripe as it is seen: two points in which the light plane cuts a wall before the
    /// camera, with the laser turned about the line of sight.
    #[test]
    fn the_stripe_is_searched_across_the_way_it_runs() {
        let mut rig = crate::synthetic::rig();
        let mut rows = 0;
        for degrees in (0..180).step_by(10) {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            let (x, y, wall) = (0.8 * sin, 0.8 * cos, 430.0);
            rig.light.normal = Vector3::new(x, y, 0.6);
            rig.light.b = -0.6 * wall;
            let seen = [-20.0, 20.0].map(|at| {
                let place = Point3::new(at * cos, -at * sin, wall);
                assert!(rig.light.plane(0.0).distance(&place).abs() < 1e-9);
                rig.camera.project(&place).unwrap()
            });
            let run = seen[1] - seen[0];
            let expected = match run.y.abs() > run.x.abs() {
                true => Axis::Rows,
                false => Axis::Columns,
            };
            assert_eq!(rig.stripe_axis(), expected, "{degrees}°");
            rows += usize::from(expected == Axis::Rows);
        }
        assert!((8..=10).contains(&rows), "{rows} of 18");
    }
}
