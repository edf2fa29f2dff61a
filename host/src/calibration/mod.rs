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
