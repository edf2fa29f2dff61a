//! The calibration: readable, of this camera, over the range that is scanned, not too old, not too
//! loose.

use super::{Check, Checks};
use crate::checks::Check as Made;
use crate::output::{age, age_words, calibration_checks, read_calibration};
use crate::rig::config::Rig;
use std::path::Path;

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
    c.good("file", format!("{}: sound", file.display()));
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
    let positions = found.positions();
    let range = positions
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
            (a.min(*x), b.max(*x))
        });
    match (&found.light, rig) {
        (None, _) => c.wrong(
            "light planes",
            "none in it".to_owned(),
            "`cannula capture light --out session`, then calibrate again",
        ),
        (Some(_), Some(rig)) => {
            let scan = &rig.scan;
            let last = scan.start_mm + scan.spacing_mm * f64::from(scan.count.saturating_sub(1));
            let words = format!(
                "calibrated from {} to {} mm, scanned from {} to {last} mm",
                range.0, range.1, scan.start_mm
            );
            if positions.len() > 1 && (scan.start_mm < range.0 - 1e-6 || last > range.1 + 1e-6) {
                c.weak(
                    "light planes",
                    words,
                    "depth beyond is extrapolated: widen [light] and calibrate again, or narrow [scan]",
                );
            } else {
                c.good("light planes", words);
            }
        }
        (Some(_), None) => c.good(
            "light planes",
            format!("from {} to {} mm", range.0, range.1),
        ),
    }
    let now = jiff::Timestamp::now();
    match age(&found) {
        Some(then) => c.good("age", age_words(then, now)),
        None => c.skipped("age", "it carries no date"),
    }
    let made = calibration_checks(&found, None, now);
    if made.iter().all(Made::sound) {
        c.good(
            "tightness",
            format!("corners fit to {:.3} px", camera.rms_px),
        );
    }
    for doubt in made.into_iter().filter(|m| m.sentence().is_some()) {
        c.weak("trust", doubt.words, &doubt.remedy);
    }
    c.list
}
