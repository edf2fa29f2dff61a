//! The stages in a row: a recording to a calibration ([`calibrate`]), a recording and a
//! calibration to the needle ([`measure`]). The only room that knows both files and stages.
//!
//! Images are decoded and worked on one by one, in parallel over frames; a thread holds the image
//! at hand and its laser-off partner, so memory does not grow with the recording. The order of
//! results does not depend on the number of threads, and neither do the results.

mod calibration;
mod error;
mod reconstruction;
pub mod sequence;
mod times;
mod views;

pub use calibration::{Calibrated, Light, calibrate};
pub use error::PipelineError;
pub use reconstruction::{FrameResult, Measurement, Reconstruction, Scanned, measure};
pub(crate) use reconstruction::{belong_together, exposed, without_loss};
pub use times::{Stage, Times};

/// Which way a recording is worked on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Maximum likelihood.
    #[default]
    Ml,
    /// Algorithm 1, Eq. 6–11, 15 and Section 3.2 as the paper has them.
    Paper,
}

impl Method {
    /// Its name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ml => "ml",
            Self::Paper => "paper",
        }
    }
}
