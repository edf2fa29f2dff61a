//! The steps of a recording on any rig: a board pose for the camera, a board pose for the light
//! planes, the scan of the hand. Shared by `cannula capture`, `scan` and `demo`.

use super::acquisition::{AcquireError, Acquisition, Shot, Sweep};
use super::camera::Picture;
use super::guide::{Guide, Seen};
use super::recording::{Recording, RecordingError};
use crate::board::{self, BoardGeometry, Detection, NotFound};
use crate::session::Frame;
use std::path::PathBuf;
use std::time::Duration;

/// Why a step of a recording failed.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// Board, camera or disk.
    #[error(transparent)]
    Acquire(#[from] AcquireError),
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Too few frames of a pose arrived.
    #[error("only {got} of {planned} positions gave an image: {why}")]
    TooFew {
        /// Arrived.
        got: u32,
        /// Planned.
        planned: u32,
        /// The first complaint.
        why: String,
    },
}

impl From<super::writer::WriteError> for CaptureError {
    fn from(e: super::writer::WriteError) -> Self {
        Self::Acquire(e.into())
    }
}

impl From<super::link::LinkError> for CaptureError {
    fn from(e: super::link::LinkError) -> Self {
        Self::Acquire(e.into())
    }
}

/// A pose that was taken, or why it was not.
#[derive(Debug)]
pub enum PoseOutcome {
    /// Recorded.
    Taken {
        /// Its image.
        image: String,
        /// How the board lay.
        seen: Seen,
        /// What is weak about the image.
        warning: Option<String>,
    },
    /// The board was not found; nothing was recorded.
    NotFound(NotFound),
}

/// A light pose that was taken, or why it was not.
#[derive(Debug)]
pub enum LightOutcome {
    /// Recorded.
    Taken {
        /// Its folder.
        folder: String,
        /// How the sweep went.
        sweep: Sweep,
        /// Time that the disk made the camera's side wait.
        waited: Duration,
    },
    /// The board was not found in the image without laser; nothing was recorded.
    NotFound(NotFound),
}

/// A scan that was taken.
#[derive(Debug)]
pub struct Scanned {
    /// How the sweep went.
    pub sweep: Sweep,
    /// Time that the disk made the camera's side wait.
    pub waited: Duration,
    /// session.json.
    pub session: PathBuf,
}

/// Finds the board in a picture.
pub fn detect(picture: &Picture, geometry: &BoardGeometry) -> Result<Detection, NotFound> {
    match picture {
        Picture::Eight(image) => board::detect(image, geometry),
        Picture::Sixteen(image) => board::detect(image, geometry),
    }
}

fn weakness(detection: &Detection) -> Option<String> {
    let q = &detection.quality;
    if q.saturated > 0.2 {
        Some("the white squares are overexposed: shorten camera.exposure_board_ms".into())
    } else if detection.blur_px > 2.5 {
        Some(format!(
            "the image is soft (blur {:.1} px): focus the lens",
            detection.blur_px
        ))
    } else {
        None
    }
}

/// Takes a board pose for the camera's calibration: laser off, at the board's exposure.
pub fn camera_pose(
    acquisition: &mut Acquisition,
    exposure_ms: f64,
    recording: &mut Recording,
    guide: &mut Guide,
    geometry: &BoardGeometry,
) -> Result<PoseOutcome, CaptureError> {
    acquisition.expose(exposure_ms)?;
    let shot = acquisition.still(0, false)?;
    let detection = match detect(&shot.picture, geometry) {
        Ok(detection) => detection,
        Err(why) => return Ok(PoseOutcome::NotFound(why)),
    };
    let image = recording.add_camera(&shot.picture)?;
    let seen = guide.add(&detection, geometry);
    Ok(PoseOutcome::Taken {
        image,
        seen,
        warning: weakness(&detection),
    })
}

/// Takes a board pose for the light planes: one image without laser, then the laser at every
/// position of `[light]`.
pub fn light_pose(
    acquisition: &mut Acquisition,
    rig: &super::config::Rig,
    recording: &mut Recording,
    shown: &mut dyn FnMut(),
) -> Result<LightOutcome, CaptureError> {
    acquisition.expose(rig.camera.exposure_laser_ms)?;
    let off_shot = acquisition.still(0, false)?;
    if let Err(why) = detect(&off_shot.picture, &rig.geometry()) {
        return Ok(LightOutcome::NotFound(why));
    }
    let folder = recording.light_folder();
    let off = format!("{folder}/off.png");
    recording.write(&off, &off_shot.picture)?;
    let request = rig.light_request();
    let mut writer = Recording::writer()?;
    let mut frames = Vec::new();
    let sweep = acquisition.sweep(&request, &mut |shot: Shot| {
        let image = format!("{folder}/on_{:02}.png", shot.index);
        let path = recording.path(&image);
        frames.push(frame_of(&shot, image));
        writer.push(path, shot.picture)?;
        shown();
        Ok(())
    })?;
    let written = writer.finish()?;
    // A pose with few positions is worth keeping, one with hardly any is not.
    if sweep.shots == 0 || sweep.shots * 2 < request.count {
        return Err(too_few(&sweep));
    }
    recording.add_light(Some(off), frames)?;
    Ok(LightOutcome::Taken {
        folder,
        sweep,
        waited: written.waited,
    })
}

/// What a scan shows while it is taken.
#[derive(Debug)]
pub enum Step<'a> {
    /// The scene without laser.
    Ambient(&'a Picture),
    /// A shot, as soon as it is matched; positions that were visited again come last.
    Shot(&'a Shot),
    /// There is no further one. (The disk may still be writing.)
    Swept,
}

/// What looks at a scan as it is taken; an error ends it.
pub type Live<'a> = dyn FnMut(Step) -> Result<(), AcquireError> + 'a;

/// Takes the scan of the hand.
pub fn scan(
    acquisition: &mut Acquisition,
    rig: &super::config::Rig,
    recording: &mut Recording,
    force: bool,
    live: &mut Live,
) -> Result<Scanned, CaptureError> {
    let folder = recording.scan_folder(force)?;
    acquisition.expose(rig.camera.exposure_laser_ms)?;
    let ambient_shot = acquisition.still(0, false)?;
    let ambient = format!("{folder}/ambient.png");
    recording.write(&ambient, &ambient_shot.picture)?;
    live(Step::Ambient(&ambient_shot.picture))?;
    let request = rig.scan_request();
    let mut writer = Recording::writer()?;
    let mut frames = Vec::new();
    let sweep = acquisition.sweep(&request, &mut |shot: Shot| {
        let image = format!("{folder}/{:03}.png", shot.index);
        let path = recording.path(&image);
        frames.push(frame_of(&shot, image));
        live(Step::Shot(&shot))?;
        writer.push(path, shot.picture)?;
        Ok(())
    })?;
    if sweep.shots == 0 {
        return Err(too_few(&sweep));
    }
    live(Step::Swept)?;
    let written = writer.finish()?;
    recording.set_scan(Some(ambient), frames)?;
    Ok(Scanned {
        sweep,
        waited: written.waited,
        session: recording.folder().join("session.json"),
    })
}

fn too_few(sweep: &Sweep) -> CaptureError {
    CaptureError::TooFew {
        got: sweep.shots,
        planned: sweep.planned,
        why: sweep
            .complaints()
            .into_iter()
            .next()
            .unwrap_or_else(|| "no reason known".into()),
    }
}

fn frame_of(shot: &Shot, image: String) -> Frame {
    Frame {
        slide_mm: shot.slide_mm,
        slide_steps: Some(shot.steps),
        trigger_us: Some(shot.trigger_us),
        image,
    }
}
