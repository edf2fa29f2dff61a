//! The light planes: thirteen slide positions to one common normal with D = a·x + b
//! (paper, Section 2.2; Eq. 4–10, Algorithm 1).
//!
//! [`calibrate`] is the maximum-likelihood way: a light-plane point is where the ray of a stripe
//! pixel meets the board, and the residual is the distance in pixels between the measured stripe
//! and the stripe that the plane at D(x) draws on the board, along the stripe's normal. Camera, all
//! board poses, the common normal, a and b are found together with the boards' corners:
//!
//! ```text
//! Σ corners ρ(‖Σᵢ^(−1/2)·(π(R·P + T) − p)‖²)  +  Σ stripes rᵀ·C⁻¹·r,   C = diag(σᵢ²) + τ²·1·1ᵀ
//! ```
//!
//! τ is what a whole stripe is off together (the slide's jitter, speckle that spans the stripe);
//! σ, τ and the corners' scale come from the residuals. [`paper`] is Algorithm 1 as written.

mod check;
mod gate;
mod joint;
pub mod paper;
pub mod published;
mod start;
mod strand;
pub mod tables;
#[cfg(test)]
mod tests;

pub use gate::{REFUSE_HOLD_OUT_MM, limits};
pub use joint::calibrate;

use super::finding::{Finding, refusals};
use super::loss::Measures;
use super::{Covariance, LightModel};
use crate::board::Corner;
use crate::geometry::{Camera, Plane, Pose};
use crate::stripe::StripePoint;

/// What was measured at one board pose.
#[derive(Clone, Debug, PartialEq)]
pub struct LightView {
    /// The board's corners, in the board's order.
    pub corners: Vec<Corner>,
    /// The stripe on the board at each slide position.
    pub stripes: Vec<BoardStripe>,
}

/// The stripe on the board with the slide at one position.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardStripe {
    /// Position of the slide, mm.
    pub slide_mm: f64,
    /// Its centres.
    pub points: Vec<StripePoint>,
}

/// What the joint solve may use to refine the camera.
#[derive(Clone, Copy, Debug)]
pub enum CameraData<'a> {
    /// The views that [`super::camera::calibrate`] was given, in the same order. The corners of the
    /// light views may have stood behind them there, all of them and in their order; they are not
    /// to be repeated here. A light view that was left out there is left out here.
    Views(&'a [Vec<Corner>]),
    /// No views: the camera and its covariance are a prior. It must not come from the light views'
    /// own corners, which would then count twice.
    Prior,
}

/// What the gate is to expect of the rig.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Angle between the light plane's normal and the slide's travel that the rig is built with,
    /// radians. |a| is its cosine; an |a| that means an angle more than 15° away is taken for a
    /// wrong unit, wrong steps per millimetre or a wrong square size, and refused.
    pub travel_angle: f64,
}

/// One position's plane fitted on its own, before the common normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinglePlane {
    /// Position of the slide, mm.
    pub slide_mm: f64,
    /// The plane.
    pub plane: Plane,
    /// Points that it was fitted to.
    pub points: usize,
    /// Root mean square distance of the points from it, mm.
    pub rms_mm: f64,
}

/// How large the measurement errors turned out to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLevels {
    /// Standard deviation of the corners' errors in units of their own.
    pub corner_scale: f64,
    /// Standard deviation of the stripe centres' errors in units of their own.
    pub stripe_scale: f64,
    /// Error common to a short piece (32 px) of a stripe beyond that, px.
    pub piece_px: f64,
    /// Error common to a whole stripe beyond that (τ), px.
    pub stripe_px: f64,
}

/// The light planes of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct LightCalibration {
    /// Common normal, a and b.
    pub model: LightModel,
    /// False when the slide stood at one position in all views: then there is one plane, `model.a`
    /// is 0 and means nothing, and `model.b` is the plane's D.
    pub travels: bool,
    /// The camera, refined where the joint solve carries it; as given otherwise.
    pub camera: Camera,
    /// Covariance of camera, normal, a and b.
    pub covariance: Covariance,
    /// The board's pose in each light view.
    pub poses: Vec<Pose>,
    /// Each position on its own.
    pub planes: Vec<SinglePlane>,
    /// Table 2 for this rig.
    pub spacings: Vec<tables::Spacing>,
    /// Mean |distance between neighbouring planes − distance travelled|, mm (Table 2).
    pub spacing_error_mm: f64,
    /// Table 4 for this rig.
    pub offsets: Vec<tables::Offset>,
    /// Mean |D predicted − D fitted|, mm (Table 4).
    pub offset_error_mm: f64,
    /// Each position predicted from all others: |D predicted − D fitted|, mm.
    pub hold_out_mm: Vec<f64>,
    /// Table 1 for this rig: each light view before (closed form) and after the joint solve.
    pub view_measures: Vec<(Measures, Measures)>,
    /// Figure 14 for this rig: the same for each position.
    pub position_measures: Vec<(Measures, Measures)>,
    /// Root mean square distance of the stripe centres from the stripes that the planes draw, px.
    pub stripe_rms_px: f64,
    /// Root mean square reprojection error of the corners in the joint solve, px.
    pub corner_rms_px: f64,
    /// What the residuals say of the measurements.
    pub noise: NoiseLevels,
    /// What the gate has to say; nothing that refuses.
    pub findings: Vec<Finding>,
    /// Every check that the gate made.
    pub checks: Vec<crate::checks::Check>,
}

/// Why the light planes can't be calibrated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LightError {
    /// Fewer board poses with a stripe than a plane needs.
    #[error(
        "{views} board poses show the stripe; {needed} or more are needed, at different distances and tilts"
    )]
    TooFewViews {
        /// Views with a stripe.
        views: usize,
        /// Views needed.
        needed: usize,
    },
    /// A light view has another number of corners than the board, or one without a covariance.
    #[error("light view {view} has a corner that can't be used, or not all {needed} corners")]
    BadCorners {
        /// Index of the view.
        view: usize,
        /// Corners of the board.
        needed: usize,
    },
    /// A slide position is not a number.
    #[error("light view {view} has a slide position that is not a number")]
    BadPosition {
        /// Index of the view.
        view: usize,
    },
    /// The stripes of all views lie on one line in space.
    #[error(
        "the stripes of all board poses lie on nearly the same line; move the board nearer and farther and tilt it"
    )]
    OneLine,
    /// No light plane draws these stripes.
    #[error("no light plane fits the stripes; check that each image belongs to its slide position")]
    NoSolution,
    /// The gate refuses.
    #[error("{}", refusals(.0))]
    Refused(
        /// All findings, warnings included.
        Vec<Finding>,
        /// What was found all the same, to be looked at and not to be used.
        Box<LightCalibration>,
    ),
}
