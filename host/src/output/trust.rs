//! Whether a calibration is still to be trusted: its age and how loose it is.

use super::CalibrationFile;
use jiff::{SignedDuration, Timestamp};

/// A rig is knocked and warmed: a calibration that has not been looked at for longer is doubted.
pub const OLD_DAYS: i64 = 30;
/// Corners that miss the fitted boards by more, root mean square, px: ten times what is usual.
pub const LOOSE_CORNERS_PX: f64 = 0.3;
/// Positions predicted from the others that miss by more on the mean, mm: the paper's own level.
pub const LOOSE_PLANES_MM: f64 = 0.1;
/// Standard deviations that the calibration alone may put on entry (mm) and needle axis (degrees)
/// before it is called loose.
pub const LOOSE_ENTRY_MM: f64 = 0.2;
/// See [`LOOSE_ENTRY_MM`].
pub const LOOSE_AXIS_DEG: f64 = 0.2;

/// What speaks against a calibration, and what to do.
#[derive(Clone, Debug, PartialEq)]
pub struct Doubt {
    /// What.
    pub what: String,
    /// The remedy.
    pub remedy: &'static str,
}

impl Doubt {
    /// In one sentence.
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.what, self.remedy)
    }
}

/// Whole seconds, ISO 8601 in UTC.
pub fn seconds(time: Timestamp) -> String {
    Timestamp::from_second(time.as_second())
        .unwrap_or(time)
        .to_string()
}

/// When the calibration was made, if it says so.
pub fn age(file: &CalibrationFile) -> Option<Timestamp> {
    file.provenance.as_ref()?.time.as_ref()?.parse().ok()
}

/// "made … (so long ago)".
pub fn age_words(then: Timestamp, now: Timestamp) -> String {
    let ago = now.duration_since(then);
    let words = if ago < SignedDuration::ZERO {
        "in the future".to_owned()
    } else if ago < SignedDuration::from_hours(1) {
        format!("{} min ago", ago.as_mins())
    } else if ago < SignedDuration::from_hours(48) {
        format!("{} h ago", ago.as_hours())
    } else {
        format!("{} days ago", ago.as_hours() / 24)
    };
    format!("made {}, {words}", seconds(then))
}

/// What speaks against it, whatever is measured with it.
pub fn doubts(file: &CalibrationFile, now: Timestamp) -> Vec<Doubt> {
    let mut all = Vec::new();
    let mut doubt = |what: String, remedy| all.push(Doubt { what, remedy });
    if let Some(then) = age(file) {
        let ago = now.duration_since(then);
        if ago > SignedDuration::from_hours(24 * OLD_DAYS) {
            doubt(
                format!(
                    "the calibration is {} days old (more than {OLD_DAYS})",
                    ago.as_hours() / 24
                ),
                "calibrate again, or check it with one board pose",
            );
        } else if ago < SignedDuration::from_mins(-5) {
            doubt(
                format!("the calibration is dated {}, in the future", seconds(then)),
                "set this machine's clock",
            );
        }
    }
    if file.camera.rms_px > LOOSE_CORNERS_PX {
        doubt(
            format!(
                "the calibration is loose: corners miss by {:.2} px (more than {LOOSE_CORNERS_PX})",
                file.camera.rms_px
            ),
            "calibrate again with a flat board, sharp and still",
        );
    }
    let light = file.light.as_ref();
    let planes = light.and_then(|l| l.hold_out_error_mm.or(l.offset_error_mm));
    if let Some(miss) = planes.filter(|m| *m > LOOSE_PLANES_MM) {
        doubt(
            format!(
                "the calibration is loose: light planes are predicted to {miss:.2} mm (more than {LOOSE_PLANES_MM})"
            ),
            "check the slide for slip and calibrate again with more board poses",
        );
    }
    for warning in &file.warnings {
        doubt(
            format!("the calibration said: {warning}"),
            "calibrate again if that matters here",
        );
    }
    all
}

/// Whether the calibration alone makes this result uncertain: its parts of the standard deviations
/// of entry (mm) and needle axis (rad).
pub fn loose_here(entry_mm: f64, axis: f64) -> Option<Doubt> {
    let axis_deg = axis.to_degrees();
    (entry_mm > LOOSE_ENTRY_MM || axis_deg > LOOSE_AXIS_DEG).then(|| Doubt {
        what: format!(
            "the calibration is too loose: it alone leaves the entry to ±{entry_mm:.2} mm and the angle to ±{axis_deg:.2}° (more than {LOOSE_ENTRY_MM} mm or {LOOSE_AXIS_DEG}°)"
        ),
        remedy: "calibrate with more board poses, tilted more, nearer and farther",
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::tests::{contract, read};

    fn dated(days: i64) -> (CalibrationFile, Timestamp) {
        let now: Timestamp = "2026-11-25T12:00:00Z".parse().unwrap();
        let then = now - SignedDuration::from_hours(24 * days);
        let mut value = contract();
        value["provenance"] = serde_json::json!({
            "program": "cannula", "session": "s", "time": seconds(then),
        });
        (read(&value).unwrap(), now)
    }

    #[test]
    fn an_old_one_a_future_one_and_a_fresh_one() {
        let (file, now) = dated(3);
        assert_eq!(doubts(&file, now), []);
        assert!(age_words(age(&file).unwrap(), now).ends_with("3 days ago"));
        let (file, now) = dated(45);
        assert!(doubts(&file, now)[0].what.contains("45 days old"));
        let (file, now) = dated(-2);
        assert!(doubts(&file, now)[0].what.contains("in the future"));
        // The contract's own file has no date: nothing is invented.
        let bare = read(&contract()).unwrap();
        assert_eq!((age(&bare), doubts(&bare, now)), (None, Vec::new()));
    }

    #[test]
    fn a_loose_one_is_named_with_its_figure() {
        let (mut file, now) = dated(0);
        file.camera.rms_px = 0.8;
        file.light.as_mut().unwrap().hold_out_error_mm = Some(0.25);
        let said: Vec<String> = doubts(&file, now).iter().map(Doubt::sentence).collect();
        assert_eq!(said.len(), 2);
        assert!(
            said[0].contains("0.80 px") && said[1].contains("0.25 mm"),
            "{said:?}"
        );
        assert_eq!(loose_here(0.05, 0.001), None);
        assert!(loose_here(0.05, 0.01).unwrap().what.contains("0.57°"));
        assert!(loose_here(0.4, 0.0).is_some());
    }
}
