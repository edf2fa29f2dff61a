//! Cameras behind one small trait: frames with a sequence number and a time stamp.

use crate::image::Image;
use cannula_shared::message::Trigger;
use std::path::PathBuf;
use std::time::Duration;

/// What a camera can't do.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// There is no such camera.
    #[error("no camera {0}: {1}")]
    NotFound(String, String),
    /// This program was built without it.
    #[error("this program was built without {0} cameras: build it with --features {1}")]
    NotBuilt(&'static str, &'static str),
    /// A setting that the camera does not take.
    #[error("the camera does not take {key}: {reason}")]
    Setting {
        /// The key in the rig's configuration.
        key: &'static str,
        /// What the camera says.
        reason: String,
    },
    /// It failed in the middle.
    #[error("the camera failed: {0}")]
    Failed(String),
    /// An image of a folder can't be read.
    #[error("{path}: {reason}", path = path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// A picture as the camera gives it.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// 8 bits of grey.
    Eight(Image<u8>),
    /// 16 bits of grey.
    Sixteen(Image<u16>),
}

impl Picture {
    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Eight(i) => (i.width(), i.height()),
            Self::Sixteen(i) => (i.width(), i.height()),
        }
    }
}

/// One frame as it arrives.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The camera's own count.
    pub sequence: u64,
    /// When its exposure began, µs of the camera's own clock.
    pub time_us: i64,
    /// The picture; `None` if parts of it were lost on the way.
    pub picture: Option<Picture>,
}

/// How to expose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// How long, ms.
    pub ms: f64,
    /// Gain, dB.
    pub gain_db: f64,
}

/// A camera.
///
/// From [`Camera::arm`] on, every exposure that its trigger starts ends in one frame from
/// [`Camera::wait`], in order. What was exposed before is discarded by `arm`.
pub trait Camera: Send {
    /// Maker, model, serial number.
    fn description(&self) -> String;
    /// Width and height of its images, pixels.
    fn size(&self) -> (u32, u32);
    /// Makes it ready for triggers.
    fn arm(&mut self, exposure: &Exposure) -> Result<(), CameraError>;
    /// The next frame, or `None` if none came in time.
    fn wait(&mut self, timeout: Duration) -> Result<Option<Frame>, CameraError>;
    /// Starts an exposure by command. Cameras that are triggered by the board, or that run by
    /// themselves, need none and do nothing.
    fn fire(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
    /// What the clock of its time stamps shows now, µs, if it can be asked.
    fn clock_us(&mut self) -> Option<i64> {
        None
    }
    /// The ledger's next line. Only a camera that exists in this process alone needs it, to learn
    /// what its trigger cable would have told it.
    fn ledger(&mut self, trigger: &Trigger) {
        let _ = trigger;
    }
    /// Ends what [`Camera::arm`] began.
    fn disarm(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
}
