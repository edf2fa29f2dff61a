//! The camera: found, exposes when the board triggers, keeps the frame rate that the configuration
//! promises, and sees something.

use super::{Check, Checks};
use crate::image::Image;
use crate::rig::acquisition::Acquisition;
use crate::rig::camera::{Camera, CameraError, Frame, Picture};
use crate::rig::config::{CameraKind, Rig, TriggerSource};
use crate::rig::link::Board;
use crate::rig::open::{OpenError, Opened};
use crate::simulation::Subject;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Frames taken to measure the rate.
const FRAMES: usize = 20;

/// No camera to look at.
pub fn not_found(e: &OpenError, rig: &Rig) -> Check {
    let remedy = match (e, rig.camera.kind) {
        (OpenError::Camera(CameraError::NotBuilt(..)), _) => {
            "build with that feature (README), or set camera.kind"
        }
        (_, CameraKind::Genicam) => {
            "look at its power, cable and network address; camera.device = \"\" takes the first one found"
        }
        (_, CameraKind::V4l) => {
            "`v4l2-ctl --list-devices` lists the devices; join the group video if it may not be opened"
        }
        (_, CameraKind::Simulated) => "take another simulation.seed",
    };
    let mut c = Checks::new("camera");
    c.wrong("found", e.to_string(), remedy);
    c.list.remove(0)
}

fn found(camera: &dyn Camera, rig: &Rig, c: &mut Checks) {
    let (width, height) = camera.size();
    let words = format!("{}, {width} × {height} pixels", camera.description());
    match rig.camera.kind {
        CameraKind::Simulated => c.weak(
            "found",
            format!("{words}: no real camera"),
            "set camera.kind to \"genicam\" or \"v4l\" for a real one",
        ),
        CameraKind::Genicam | CameraKind::V4l => c.good("found", words),
    }
}

/// A camera whose board did not answer.
pub fn without_board(camera: &dyn Camera, rig: &Rig) -> Vec<Check> {
    let mut c = Checks::new("camera");
    found(camera, rig, &mut c);
    c.skipped("trigger", "needs the board");
    c.skipped("frame rate", "needs the board");
    c.list
}

/// Looks at a camera that is wired to a board.
pub fn camera(opened: &mut Opened, rig: &Rig) -> (Vec<Check>, Option<(u32, u32)>) {
    let mut c = Checks::new("camera");
    let camera = opened.camera.as_mut();
    let size = Some(camera.size());
    found(camera, rig, &mut c);
    if let Some(stage) = &opened.stage {
        stage.show(&Subject::Hand);
    }
    let go_on = AtomicBool::new(false);
    let exposed = {
        let mut acquisition = Acquisition::new(&opened.board, camera, rig, &go_on);
        acquisition
            .expose(rig.camera.exposure_board_ms)
            .and_then(|()| match rig.camera.trigger {
                TriggerSource::Board => acquisition.anchor().map(drop),
                _ => Ok(()),
            })
    };
    if let Err(e) = exposed {
        c.wrong(
            "trigger",
            e.to_string(),
            "GP6 and ground to the camera's input, camera.trigger_line its name; `cannula motion trigger` fires one",
        );
        c.skipped("frame rate", "needs triggers that arrive");
        return (c.list, size);
    }
    match rig.camera.trigger {
        TriggerSource::Board => c.good(
            "trigger",
            "its frames follow the board's triggers".to_owned(),
        ),
        TriggerSource::Software => c.weak(
            "trigger",
            "by command: the rig stops for each frame".to_owned(),
            "wire TRIGGER to the camera and set camera.trigger = \"board\" to scan on the fly",
        ),
        TriggerSource::Free => c.weak(
            "trigger",
            "none, it runs by itself: the rig stops for each frame".to_owned(),
            "a camera with a trigger input scans on the fly",
        ),
    }
    match frames(&opened.board, camera, rig) {
        Ok(seen) => {
            rate(&seen, rig, &mut c);
            if let Some(picture) = seen.frames.iter().rev().find_map(|f| f.picture.as_ref()) {
                light(picture, &mut c);
            }
        }
        Err(said) => c.wrong(
            "frame rate",
            said,
            "see `cannula motion status`, then try again",
        ),
    }
    let _ = camera.disarm();
    (c.list, size)
}

/// What came of a burst.
struct Seen {
    asked: usize,
    /// Mean time between triggers (or frames, of a camera without), ms.
    gap_ms: f64,
    frames: Vec<Frame>,
}

/// Asks for frames as fast as the configuration promises.
fn frames(board: &Board, camera: &mut dyn Camera, rig: &Rig) -> Result<Seen, String> {
    let say = |e: &dyn std::fmt::Display| e.to_string();
    let gap_us = 1e3 * rig.camera.frame_time_ms.max(rig.camera.exposure_board_ms);
    let timeout = Duration::from_secs_f64(rig.camera.timeout_ms / 1e3);
    let mut got = Vec::new();
    while camera.wait(Duration::ZERO).map_err(|e| say(&e))?.is_some() {}
    let mut fired = Vec::new();
    if rig.camera.trigger == TriggerSource::Board {
        let began = board.now().0 as f64;
        for k in 0..FRAMES {
            while (board.now().0 as f64) < began + k as f64 * gap_us {
                board.keep_alive().map_err(|e| say(&e))?;
            }
            let trigger = board.trigger().map_err(|e| say(&e))?;
            fired.push(trigger.time.0 as f64);
            camera.ledger(&trigger);
            got.extend(camera.wait(Duration::ZERO).map_err(|e| say(&e))?);
        }
        while got.len() < FRAMES {
            board.keep_alive().map_err(|e| say(&e))?;
            match camera.wait(timeout).map_err(|e| say(&e))? {
                Some(frame) => got.push(frame),
                None => break,
            }
        }
    } else {
        for _ in 0..FRAMES {
            camera.fire().map_err(|e| say(&e))?;
            match camera.wait(timeout).map_err(|e| say(&e))? {
                Some(frame) => got.push(frame),
                None => break,
            }
            board.keep_alive().map_err(|e| say(&e))?;
        }
        fired = got.iter().map(|f| f.time_us as f64).collect();
    }
    let gap_ms = match (fired.first(), fired.last()) {
        (Some(a), Some(b)) if fired.len() > 1 => (b - a) / (fired.len() - 1) as f64 * 1e-3,
        _ => f64::NAN,
    };
    Ok(Seen {
        asked: FRAMES,
        gap_ms,
        frames: got,
    })
}

fn rate(seen: &Seen, rig: &Rig, c: &mut Checks) {
    let whole = seen.frames.iter().filter(|f| f.picture.is_some()).count();
    let found = format!(
        "{whole} of {} frames whole, {:.1} ms apart ({:.1} a second)",
        seen.asked,
        seen.gap_ms,
        1e3 / seen.gap_ms
    );
    let promised = rig.camera.frame_time_ms.max(rig.camera.exposure_board_ms);
    if whole < seen.asked {
        c.wrong(
            "frame rate",
            found,
            "raise camera.frame_time_ms, shorten the exposure, or look at the camera's cable and bandwidth",
        );
    } else if rig.camera.trigger == TriggerSource::Free && seen.gap_ms > 1.2 * promised {
        c.weak(
            "frame rate",
            format!("{found}; the configuration promises {promised:.1} ms"),
            "set camera.frame_time_ms to what the camera does",
        );
    } else {
        c.good("frame rate", found);
    }
}

/// A lens cap, or a lamp too near.
fn light(picture: &Picture, c: &mut Checks) {
    let (median, saturated) = match picture {
        Picture::Eight(i) => levels(i),
        Picture::Sixteen(i) => levels(i),
    };
    let found = format!(
        "median at {:.1} % of white, {:.1} % saturated",
        100.0 * median,
        100.0 * saturated
    );
    if saturated > 0.2 {
        c.weak(
            "picture",
            found,
            "less light, or a shorter camera.exposure_board_ms",
        );
    } else if median < 0.002 && saturated == 0.0 {
        c.weak(
            "picture",
            found,
            "take the lens cap off; more light, or a longer camera.exposure_board_ms",
        );
    } else {
        c.good("picture", found);
    }
}

/// Median as a part of white, and the part of the pixels that is white.
fn levels<P: crate::image::Pixel>(image: &Image<P>) -> (f64, f64) {
    // Every 61st pixel, so that no column is favoured.
    let mut samples: Vec<f32> = image
        .pixels()
        .iter()
        .step_by(61)
        .map(|p| (*p).into())
        .collect();
    samples.sort_by(f32::total_cmp);
    let of = samples.len().max(1) as f64;
    let median = samples.get(samples.len() / 2).copied().unwrap_or(0.0);
    let white = samples.iter().filter(|p| **p >= P::MAX).count();
    (f64::from(median / P::MAX), white as f64 / of)
}
