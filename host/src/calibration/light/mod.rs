//! The light planes: thirteen slide positions to one common normal with D = a·x + b
//! (paper, Section 2.2; Eq. 4–10, Algorithm 1).

pub mod paper;
pub mod tables;

use super::{Covariance, LightModel};
use crate::board::Corner;
use crate::geometry::{Camera, Plane};
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

/// The light planes of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct LightCalibration {
    /// Common normal, a and b.
    pub model: LightModel,
    /// The camera, refined where the joint solve carries it; as given otherwise.
    pub camera: Camera,
    /// Covariance of camera, normal, a and b.
    pub covariance: Covariance,
    /// Each position on its own.
    pub planes: Vec<SinglePlane>,
    /// Mean |distance between neighbouring planes − distance travelled|, mm (Table 2).
    pub spacing_error_mm: f64,
    /// Mean |D predicted − D fitted|, mm (Table 4).
    pub offset_error_mm: f64,
    /// Each position predicted from all others: |D predicted − D fitted|, mm.
    pub hold_out_mm: Vec<f64>,
}
