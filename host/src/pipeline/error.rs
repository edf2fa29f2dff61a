//! What a stage says, with the file that it is about.

use super::calibration::Calibrated;
use super::reconstruction::Scanned;
use crate::needle::NeedleError;
use crate::session::SessionError;
use crate::stripe::StripeError;
use std::path::PathBuf;

/// Why a recording gives no result.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The recording itself.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The board was found in too few images.
    #[error("{path}: {reason} ({failed} of {of} board images can't be used)", path = path.display())]
    NoBoard {
        /// The first image without a board.
        path: PathBuf,
        /// Why it was not found there.
        reason: String,
        /// Images without a board.
        failed: usize,
        /// Images looked at.
        of: usize,
    },
    /// The camera can't be calibrated.
    #[error("{path}: the camera can't be calibrated: {reason}", path = path.display())]
    Camera {
        /// session.json.
        path: PathBuf,
        /// What is lacking.
        reason: String,
        /// What was found all the same, for the report that says why.
        found: Option<Box<Calibrated>>,
    },
    /// The light planes can't be calibrated.
    #[error("{path}: the light planes can't be calibrated: {reason}", path = path.display())]
    Light {
        /// session.json.
        path: PathBuf,
        /// What is lacking.
        reason: String,
        /// What was found all the same, for the report that says why.
        found: Option<Box<Calibrated>>,
    },
    /// An image shows the stripe where it should not, or not where it should.
    #[error("{path}: {source}", path = path.display())]
    Stripe {
        /// The image.
        path: PathBuf,
        /// What is wrong.
        source: StripeError,
    },
    /// An image is of one grey throughout.
    #[error("{path}: the image is empty, every pixel is {grey}; check camera, exposure and lens cap", path = path.display())]
    Empty {
        /// The image.
        path: PathBuf,
        /// Its grey.
        grey: f32,
    },
    /// An image is mostly saturated.
    #[error("{path}: {percent:.0} % of the image is saturated; shorten the exposure or take the light away", path = path.display())]
    Saturated {
        /// The image.
        path: PathBuf,
        /// Part of it, per cent.
        percent: f64,
    },
    /// Too few images show the stripe.
    #[error("{path}: {reason} ({failed} of {of} images with the laser can't be used)", path = path.display())]
    NoStripe {
        /// The first such image.
        path: PathBuf,
        /// What is wrong there.
        reason: String,
        /// Images without a stripe.
        failed: usize,
        /// Images looked at.
        of: usize,
        /// The camera, for the report that says why.
        found: Option<Box<Calibrated>>,
    },
    /// Calibration and scan do not belong together.
    #[error("{path}: {what}; {remedy}", path = path.display())]
    Mismatch {
        /// session.json.
        path: PathBuf,
        /// What does not fit.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// No needle angle is given.
    #[error("{path}: no needle angle: {source}", path = path.display())]
    Needle {
        /// session.json.
        path: PathBuf,
        /// Why not.
        source: NeedleError,
        /// What was scanned, for the report that shows why.
        scanned: Box<Scanned>,
    },
}

impl PipelineError {
    /// What there is of a calibration that was refused.
    pub fn calibrated(&self) -> Option<&Calibrated> {
        match self {
            Self::Camera { found, .. }
            | Self::Light { found, .. }
            | Self::NoStripe { found, .. } => found.as_deref(),
            _ => None,
        }
    }
}
