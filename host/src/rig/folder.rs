//! Images of a recording, as if a camera took them.

use super::acquisition::{Ledger, LedgerEvent};
use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::link::LinkError;
use crate::session::{self, Depth};
use cannula_shared::message::Trigger;
use cannula_shared::units::{Micros, Steps};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time from one frame to the next where a recording does not say, µs.
const SPACING_US: i64 = 40_000;
/// The replayed camera's clock stands this far from the board's, as a camera's would.
const CLOCK_US: i64 = 7_000_000;

/// Frames from files, in order; each comes once.
pub struct FolderCamera {
    name: String,
    size: (u32, u32),
    /// File and time on the camera's clock.
    files: VecDeque<(PathBuf, i64)>,
    sequence: u64,
    /// Frames whose lines of the ledger have come, and that are not yet taken.
    due: usize,
}

impl FolderCamera {
    /// A replay: given files with the times of their triggers, µs of the board's clock. Each comes
    /// once its line of the ledger has.
    pub fn of(name: String, files: Vec<(PathBuf, i64)>) -> Result<Self, CameraError> {
        let files: VecDeque<_> = files.into_iter().map(|(f, t)| (f, t + CLOCK_US)).collect();
        let Some((first, _)) = files.front() else {
            return Err(CameraError::NotFound(name, "no images there".into()));
        };
        let header = session::header(first).map_err(|e| CameraError::Image {
            path: first.clone(),
            reason: e.to_string(),
        })?;
        Ok(Self {
            name,
            size: (header.width, header.height),
            files,
            sequence: 0,
            due: 0,
        })
    }
}

impl Camera for FolderCamera {
    fn description(&self) -> String {
        format!("images of {}", self.name)
    }

    fn size(&self) -> (u32, u32) {
        self.size
    }

    fn arm(&mut self, _exposure: &Exposure) -> Result<(), CameraError> {
        Ok(())
    }

    fn wait(&mut self, _timeout: Duration) -> Result<Option<Frame>, CameraError> {
        if self.due == 0 {
            return Ok(None);
        }
        self.due -= 1;
        let Some((path, time_us)) = self.files.pop_front() else {
            return Ok(None);
        };
        let picture = read(&path)?;
        self.sequence += 1;
        Ok(Some(Frame {
            sequence: self.sequence,
            time_us,
            picture: Some(picture),
        }))
    }

    fn ledger(&mut self, _trigger: &Trigger) {
        self.due += 1;
    }
}

/// Reads a picture of 8 or 16 bits as grey.
pub fn read(path: &Path) -> Result<Picture, CameraError> {
    let fail = |e: session::SessionError| CameraError::Image {
        path: path.to_owned(),
        reason: e.to_string(),
    };
    let depth = session::header(path).map_err(fail)?.depth;
    let raw = session::decode(path).map_err(fail)?;
    match depth {
        Depth::Sixteen => raw.luma().map(Picture::Sixteen),
        Depth::Eight => raw.luma().map(Picture::Eight),
    }
    .ok_or_else(|| CameraError::Image {
        path: path.to_owned(),
        reason: "no grey can be made of it".into(),
    })
}

/// The ledger of a recorded sweep.
pub struct RecordedLedger {
    lines: VecDeque<Trigger>,
}

impl RecordedLedger {
    /// From a session's frames (whose images a [`FolderCamera::of`] gives with the same times).
    /// `steps_per_mm` serves where the recording has no steps.
    pub fn new(frames: &[session::Frame], steps_per_mm: f64) -> Self {
        let lines = frames
            .iter()
            .zip(trigger_times(frames))
            .zip(0..)
            .map(|((frame, time), index)| Trigger {
                job: 1,
                index,
                position: Steps(
                    frame
                        .slide_steps
                        .unwrap_or((frame.slide_mm * steps_per_mm).round() as i64)
                        as i32,
                ),
                time: Micros(time as u64),
                laser: true,
            })
            .collect();
        Self { lines }
    }
}

/// When recorded frames were triggered, µs of the board's clock: as recorded, where these times go up
/// with the travel. They do not where a position was visited again or a scan went on later; the
/// frames then follow each other evenly.
pub fn trigger_times(frames: &[session::Frame]) -> Vec<i64> {
    let recorded: Option<Vec<i64>> = frames
        .iter()
        .map(|f| f.trigger_us.and_then(|t| i64::try_from(t).ok()))
        .collect();
    recorded
        .filter(|times| times.is_sorted_by(|a, b| a < b))
        .unwrap_or_else(|| {
            let all = 0..frames.len() as i64;
            all.map(|i| 1_000_000 + i * SPACING_US).collect()
        })
}

/// The anchor that goes with [`FolderCamera::of`].
pub fn recorded_anchor(frames: &[session::Frame]) -> super::matching::Anchor {
    let first = trigger_times(frames).first().copied().unwrap_or(0);
    super::matching::Anchor::from_pair(first, first + CLOCK_US)
}

impl Ledger for RecordedLedger {
    fn next(&mut self, _wait: Micros) -> Result<Option<LedgerEvent>, LinkError> {
        Ok(Some(match self.lines.pop_front() {
            Some(trigger) => LedgerEvent::Trigger(trigger),
            None => LedgerEvent::End,
        }))
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.lines.clear();
        Ok(())
    }
}
