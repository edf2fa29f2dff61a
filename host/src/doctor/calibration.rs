//! The calibration: readable, of this camera, over the range that is scanned, not too old, not too
//! loose.

use super::{Check, Checks};
use crate::checks::{Check as Made, Outcome};
use crate::output::{CalibrationFile, age, age_words, calibration_checks, read_calibration};
use crate::pipeline::{PipelineError, belong_together};
use crate::rig::config::Rig;
use std::path::Path;

/// Whether the planned scan can be worked on with it: what the scan itself will say.
fn light_planes(file: &Path, found: &CalibrationFile, rig: Option<&Rig>, c: &mut Checks) {
    const WHAT: &str = "light planes";
    let Some(model) = found.rig() else {
        return c.wrong(
            WHAT,
            "none in it".to_owned(),
            "`cannula capture light --out session`, then calibrate again",
        );
    };
    let positions = found.positions();
    let least = positions.iter().copied().fold(f64::INFINITY, f64::min);
    let most = positions.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let calibrated = format!("calibrated from {least} to {most} mm");
    let Some(rig) = rig else {
        return c.good(WHAT, calibrated);
    };
    let planned = rig.scan.positions();
    // The image's size is another check's business.
    let size = (model.camera.width, model.camera.height);
    match belong_together(file, size, &model, &positions, &planned) {
        Ok(made) => match made.into_iter().find(|m| !m.sound()) {
            Some(weak) => c.weak(
                WHAT,
                format!("{}: {}", weak.words, weak.remedy),
                "widen [light] and calibrate again, or narrow [scan]",
            ),
            None => {
                let ends = planned.first().zip(planned.last());
                let ends = ends.map(|(a, b)| format!(", scanned from {a} to {b} mm"));
                c.good(WHAT, calibrated + &ends.unwrap_or_default());
            }
        },
        Err(PipelineError::Mismatch { what, remedy, .. }) => c.wrong(WHAT, what, remedy),
        Err(e) => c.wrong(WHAT, e.to_string(), "calibrate again"),
    }
}

/// Looks at a calibration file; `size` is the camera's image size, `rig` the configuration, where
/// they are known.
pub fn calibration(file: Option<&Path>, size: Option<(u32, u32)>, rig: Option<&Rig>) -> Vec<Check> {
    let mut c = Checks::new("calibration");
    let Some(file) = file else {
        c.skipped("file", "none given; name it with --calibration FILE");
        return c.list;
    };
    let found = match read_calibration(file) {
        Ok(found) => found,
        Err(e) => {
            c.wrong(
                "file",
                e.to_string(),
                "make one: `cannula capture`, then `cannula calibrate SESSION --out calibration.json`",
            );
            return c.list;
        }
    };
    c.good("file", format!("{}: readable", file.display()));
    let camera = &found.camera;
    match size {
        Some((w, h)) if (w, h) != (camera.width, camera.height) => c.wrong(
            "camera",
            format!(
                "made for {} × {} pixels, the camera gives {w} × {h}",
                camera.width, camera.height
            ),
            "set camera.region as it was, or calibrate again",
        ),
        Some((w, h)) => c.good(
            "camera",
            format!("for {w} × {h} pixels, as the camera gives"),
        ),
        None => c.skipped("camera", "needs the camera"),
    }
    light_planes(file, &found, rig, &mut c);
    let now = jiff::Timestamp::now();
    let made = calibration_checks(&found, None, now);
    match age(&found) {
        Some(then) if made.iter().all(|m| m.sound() || !m.what.contains("age")) => {
            c.good("age", age_words(then, now));
        }
        Some(_) => {} // said below
        None => c.skipped("age", "it carries no date"),
    }
    if made.iter().all(Made::sound) {
        c.good(
            "tightness",
            format!("corners fit to {:.3} px", camera.rms_px),
        );
    }
    for doubt in made.into_iter().filter(|m| m.sentence().is_some()) {
        match doubt.outcome {
            Outcome::Refused => c.wrong("trust", doubt.words, &doubt.remedy),
            _ => c.weak("trust", doubt.words, &doubt.remedy),
        }
    }
    c.list
}
