//! The steps of a recording on any rig: a board pose for the camera, a board pose for the light
//! planes, the scan of the hand. Shared by `cannula capture`, `scan` and `demo`.

use super::acquisition::{AcquireError, Acquisition, Shot, Sink, Sweep};
use super::camera::Picture;
use super::folder;
use super::guide::{Guide, Seen};
use super::light_guide::LightGuide;
use super::progress::{self, Part};
use super::recording::{Recording, RecordingError};
use crate::board::{self, BoardGeometry, Detection, NotFound};
use crate::image::{Image, Pixel};
use crate::session::Frame;
use cannula_shared::message::ScanRequest;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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
        /// How the board lay.
        seen: Seen,
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
    /// Frames that stood already, of a scan that was broken off.
    pub stood: usize,
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
    guide: &mut LightGuide,
    shown: &mut dyn FnMut(),
) -> Result<LightOutcome, CaptureError> {
    acquisition.expose(rig.camera.exposure_laser_ms)?;
    let off_shot = acquisition.still(0, false)?;
    let geometry = rig.geometry();
    let detection = match detect(&off_shot.picture, &geometry) {
        Ok(detection) => detection,
        Err(why) => return Ok(LightOutcome::NotFound(why)),
    };
    let (folder, mut progress) = recording.begin_light(progress::Settings::new())?;
    let off = format!("{folder}/off.png");
    recording.write(&off, &off_shot.picture)?;
    let request = rig.light_request();
    let mut writer = Recording::writer()?;
    let mut frames = Vec::new();
    let sweep = acquisition.sweep(&request, &mut |shot: Shot| {
        let image = format!("{folder}/on_{:02}.png", shot.index);
        let path = recording.path(&image);
        let frame = frame_of(&shot, image);
        progress.add(shot.index, frame.clone())?;
        frames.push(frame);
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
    progress.finish()?;
    Ok(LightOutcome::Taken {
        folder,
        seen: guide.add(&detection, &geometry),
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
    /// There is no further one. (The slide may still be on its ramp down, the disk still writing.)
    Swept,
}

/// What looks at a scan as it is taken; an error ends it.
pub type Live<'a> = dyn FnMut(Step) -> Result<(), AcquireError> + 'a;

/// Takes the scan of the hand, or what is missing of one that was broken off.
pub fn scan(
    acquisition: &mut Acquisition,
    rig: &super::config::Rig,
    recording: &mut Recording,
    force: bool,
    live: &mut Live,
) -> Result<Scanned, CaptureError> {
    let settings = || progress::settings(rig, Part::Scan);
    let (mut folder, mut progress) = recording.begin_scan(force, settings())?;
    acquisition.expose(rig.camera.exposure_laser_ms)?;
    if !progress.frames().is_empty() {
        // Steps count from the switch, and who knows what the slide has been through.
        acquisition.home()?;
    }
    let ambient_picture = acquisition.still(0, false)?.picture;
    let mut then = None;
    if !progress.frames().is_empty() {
        match same_scene(&recording.path(&ambient(&folder)), &ambient_picture) {
            Ok(picture) => then = Some(picture),
            // To be recorded anew in any case: so also what was to replace it.
            Err(_) if force => {
                progress.discard()?;
                (folder, progress) = recording.begin_scan(force, settings())?;
            }
            Err(e) => return Err(e.into()),
        }
    }
    let ambient = ambient(&folder);
    let mut frames: Vec<Frame> = progress.frames().iter().map(|(_, f)| f.clone()).collect();
    let stood = frames.len();
    if let Some(then) = then {
        live(Step::Ambient(&then))?;
        for (index, frame) in progress.frames() {
            let picture =
                folder::read(&recording.path(&frame.image)).map_err(AcquireError::from)?;
            live(Step::Shot(&recorded(*index, frame, picture)))?;
        }
    } else {
        recording.write(&ambient, &ambient_picture)?;
        live(Step::Ambient(&ambient_picture))?;
    }
    let request = rig.scan_request();
    let missing: Vec<u32> = (0..request.count)
        .filter(|i| progress.frames().iter().all(|(index, _)| index != i))
        .collect();
    let mut writer = Recording::writer()?;
    let mut swept = false;
    let mut sink = |shot: Shot| {
        let image = format!("{folder}/{:03}.png", shot.index);
        let path = recording.path(&image);
        let frame = frame_of(&shot, image);
        progress.add(shot.index, frame.clone())?;
        frames.push(frame);
        live(Step::Shot(&shot))?;
        writer.push(path, shot.picture)?;
        // The slide still has its ramp to go: what comes of the frames need not wait for that.
        if frames.len() == request.count as usize {
            swept = true;
            live(Step::Swept)?;
        }
        Ok(())
    };
    let mut sweep = if stood > 0 {
        remaining(acquisition, &request, &missing, &mut sink)?
    } else {
        acquisition.sweep(&request, &mut sink)?
    };
    sweep.planned = request.count;
    sweep.shots += stood as u32;
    if sweep.shots == 0 {
        return Err(too_few(&sweep));
    }
    if !swept {
        live(Step::Swept)?;
    }
    let written = writer.finish()?;
    recording.set_scan(Some(ambient), frames)?;
    progress.finish()?;
    Ok(Scanned {
        sweep,
        stood,
        waited: written.waited,
        session: recording.folder().join("session.json"),
    })
}

fn ambient(folder: &str) -> String {
    format!("{folder}/ambient.png")
}

/// The image without laser of a scan that was broken off, if the scene still is what it shows.
fn same_scene(path: &Path, now: &Picture) -> Result<Picture, RecordingError> {
    let then = folder::read(path).map_err(|e| RecordingError::NoScene(e.to_string()))?;
    let percent = 100.0 * changed(&then, now);
    if percent > CHANGED_PERCENT {
        let path = path.to_owned();
        return Err(RecordingError::Changed { path, percent });
    }
    Ok(then)
}

/// What is missing of a scan: gaps one by one, then the rest of the way as a sweep of its own. (A plan's
/// steps depend on each position alone, not on where the sweep begins.)
fn remaining(
    acquisition: &mut Acquisition,
    request: &ScanRequest,
    missing: &[u32],
    sink: &mut Sink,
) -> Result<Sweep, AcquireError> {
    let tail = std::iter::zip(missing.iter().rev(), (0..request.count).rev())
        .take_while(|(missing, index)| *missing == index)
        .count();
    let (gaps, tail) = missing.split_at(missing.len() - tail);
    let mut sweep = acquisition.visit(request, gaps, sink)?;
    if let Some(&first) = tail.first() {
        let rest = ScanRequest {
            start_um: request.start_um + (first * request.spacing_um) as i32,
            count: tail.len() as u32,
            ..*request
        };
        let swept = acquisition.sweep(&rest, &mut |shot| {
            let index = shot.index + first;
            sink(Shot { index, ..shot })
        })?;
        sweep.join(swept, first);
    }
    Ok(sweep)
}

/// More of the image than this may not differ between two pictures of a scene that stands still, %:
/// the outline of a hand that has moved by a pixel is more.
const CHANGED_PERCENT: f64 = 0.1;

/// How much of the image differs by more than noise does.
fn changed(then: &Picture, now: &Picture) -> f64 {
    fn part<P: Pixel>(a: &Image<P>, b: &Image<P>) -> f64 {
        let values = |i: &Image<P>| -> Vec<f32> { i.pixels().iter().map(|&p| p.into()).collect() };
        let mut apart: Vec<f32> = std::iter::zip(values(a), values(b))
            .map(|(p, q)| (p - q).abs())
            .collect();
        if a.pixels().len() != b.pixels().len() || apart.is_empty() {
            return 1.0;
        }
        let middle = apart.len() / 2;
        let (_, median, _) = apart.select_nth_unstable_by(middle, f32::total_cmp);
        // Eight standard deviations of the middling pixel, and 2 % of the range for the bright ones.
        let limit = 8.0 * 1.4826 * *median + 0.02 * P::MAX;
        apart.iter().filter(|d| **d > limit).count() as f64 / apart.len() as f64
    }
    match (then, now) {
        (Picture::Eight(a), Picture::Eight(b)) => part(a, b),
        (Picture::Sixteen(a), Picture::Sixteen(b)) => part(a, b),
        _ => 1.0,
    }
}

/// A shot from the recording.
fn recorded(index: u32, frame: &Frame, picture: Picture) -> Shot {
    Shot {
        index,
        steps: frame.slide_steps.unwrap_or_default(),
        slide_mm: frame.slide_mm,
        trigger_us: frame.trigger_us.unwrap_or_default(),
        laser: true,
        picture,
        arrived: Instant::now(),
    }
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
