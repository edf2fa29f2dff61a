//! Reconstruction while frames arrive, for `scan` and `replay`: each frame is worked on as soon as
//! it is matched, so that the result stands right after the last one.

use super::Output;
use super::job::{NeedleArgs, decision_words};
use crate::calibration::RigModel;
use crate::image::Pixel;
use crate::output::{ResultFile, write_json, write_whole};
use crate::pipeline::{Measurement, Method, Reconstruction, Times};
use crate::rig::acquisition::{AcquireError, Shot};
use crate::rig::camera::Picture;
use crate::session::Entry;
use std::path::Path;
use std::time::{Duration, Instant};

/// A reconstruction of pictures of either depth.
pub struct Live {
    rig: RigModel,
    times: Times,
    depth: Depth,
    /// When the last frame was handed over.
    last: Instant,
    frames: usize,
}

enum Depth {
    Unknown,
    Eight(Reconstruction<u8>),
    Sixteen(Reconstruction<u16>),
}

impl Live {
    /// For a calibrated rig.
    pub fn new(rig: RigModel) -> Self {
        Self {
            rig,
            times: Times::default(),
            depth: Depth::Unknown,
            last: Instant::now(),
            frames: 0,
        }
    }

    /// The scene without laser, before the first frame.
    pub fn ambient(&mut self, picture: &Picture) {
        let rig = self.rig.clone();
        self.depth = match picture {
            Picture::Eight(i) => {
                Depth::Eight(Reconstruction::new(rig, Method::Ml, Some(i.clone())))
            }
            Picture::Sixteen(i) => {
                Depth::Sixteen(Reconstruction::new(rig, Method::Ml, Some(i.clone())))
            }
        };
    }

    /// The next frame.
    pub fn push(&mut self, shot: &Shot, picture: &Picture) -> Result<(), AcquireError> {
        self.last = Instant::now();
        if matches!(self.depth, Depth::Unknown) {
            let rig = self.rig.clone();
            self.depth = match picture {
                Picture::Eight(_) => Depth::Eight(Reconstruction::new(rig, Method::Ml, None)),
                Picture::Sixteen(_) => Depth::Sixteen(Reconstruction::new(rig, Method::Ml, None)),
            };
        }
        let done = match (&mut self.depth, picture) {
            (Depth::Eight(r), Picture::Eight(i)) => r.push(shot.slide_mm, i, &self.times),
            (Depth::Sixteen(r), Picture::Sixteen(i)) => r.push(shot.slide_mm, i, &self.times),
            _ => {
                return Err(AcquireError::Sink(
                    "the camera has changed its depth in the middle of a scan".into(),
                ));
            }
        };
        self.frames += 1;
        done.map(drop)
            .map_err(|e| AcquireError::Sink(format!("frame {}: {e}", shot.index)))
    }

    /// Plane, entry and needle, and how long after the last frame they stood.
    pub fn decide(
        self,
        entry: &Entry,
        needle: &NeedleArgs,
    ) -> anyhow::Result<(Measurement, Duration)> {
        match self.depth {
            Depth::Eight(r) => decide(r, self.last, entry, needle),
            Depth::Sixteen(r) => decide(r, self.last, entry, needle),
            Depth::Unknown => anyhow::bail!("no frame arrived"),
        }
    }
}

fn decide<P: Pixel>(
    whole: Reconstruction<P>,
    last: Instant,
    entry: &Entry,
    needle: &NeedleArgs,
) -> anyhow::Result<(Measurement, Duration)> {
    let request = entry.into();
    let (settings, source) = needle.settings();
    let decision = whole.decide(&request, &settings)?;
    let after = last.elapsed();
    Ok((
        Measurement {
            cloud: whole.cloud,
            background: whole.background,
            counts: whole.counts,
            request,
            decision,
            warnings: decision_words(source).into_iter().collect(),
        },
        after,
    ))
}

/// Writes cloud.ply and result.json.
pub fn write(
    folder: &Path,
    measured: &Measurement,
    needle: &NeedleArgs,
) -> anyhow::Result<ResultFile> {
    let source = needle.settings().1;
    let result = ResultFile::new(measured, "cloud.ply", source, Method::Ml, None);
    let comment = format!("cannula {}", env!("CARGO_PKG_VERSION"));
    write_whole(&folder.join("cloud.ply"), |w| {
        crate::cloud::write_ply(w, &measured.cloud, &comment)
    })?;
    write_json(&folder.join("result.json"), &result)?;
    Ok(result)
}

/// Says what went wrong in a sweep, if anything did.
pub fn complain(sweep: &crate::rig::acquisition::Sweep, out: &Output) {
    for line in sweep.complaints() {
        crate::progress::Progress::warn(out, &line);
    }
}
