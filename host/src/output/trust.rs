//! Whether a calibration is still to be trusted: its age and how loose it is.

use super::{CalibrationFile, LightFile};
use crate::calibration::camera::REFUSE_RMS_PX;
use crate::calibration::light::REFUSE_HOLD_OUT_MM;
use crate::checks::{self, Check, Limit, decimals};
use crate::needle::Uncertainty;
use jiff::{SignedDuration, Timestamp};

/// A rig is knocked and warmed: a calibration that has not been looked at for longer is doubted.
pub const OLD_DAYS: i64 = 30;
/// Corners that miss the fitted boards by more, root mean square, px: ten times what is usual.
pub const LOOSE_CORNERS_PX: f64 = 0.3;
/// Positions predicted from the others that miss by more on the mean, mm: ten times what is usual. A slip
/// of the slide that misses by 0.07 mm turns the hand's normal by half a degree, and no σ holds it.
pub const LOOSE_PLANES_MM: f64 = 0.02;
/// The same of positions that are among those they are predicted from (the paper's way): its own level.
pub const LOOSE_OFFSETS_MM: f64 = 0.1;
/// Beyond these a calibration is refused: a year without a look at it, corners by which none would be
/// made today, planes off by twice what the paper's own rig shows.
pub const REFUSED_DAYS: i64 = 365;
/// See [`REFUSED_DAYS`].
pub const REFUSED_CORNERS_PX: f64 = REFUSE_RMS_PX;
/// See [`REFUSED_DAYS`].
pub const REFUSED_PLANES_MM: f64 = REFUSE_HOLD_OUT_MM;
/// A line farther off its own planes was not fitted to them.
pub const OWN_PLANES_MM: f64 = 5.0;
/// Standard deviations that the calibration alone may put on entry (mm) and needle axis (degrees)
/// before it is called loose.
pub const LOOSE_ENTRY_MM: f64 = 0.2;
/// See [`LOOSE_ENTRY_MM`].
pub const LOOSE_AXIS_DEG: f64 = 0.2;

/// The remedy for a file that does not say how it came about.
const REMAKE: &str = "calibrate again with `cannula calibrate`";

/// Whole seconds, ISO 8601 in UTC.
pub fn seconds(time: Timestamp) -> String {
    Timestamp::from_second(time.as_second())
        .unwrap_or(time)
        .to_string()
}

/// When the calibration's boards were recorded, or when it was made, if it says so.
pub fn age(file: &CalibrationFile) -> Option<Timestamp> {
    let p = file.provenance.as_ref()?;
    p.recorded.as_ref().or(p.time.as_ref())?.parse().ok()
}

/// "so long ago", or how long before a scan.
fn span(words: SignedDuration) -> String {
    if words < SignedDuration::from_mins(1) {
        "less than a minute".to_owned()
    } else if words < SignedDuration::from_hours(1) {
        format!("{} min", words.as_mins())
    } else if words < SignedDuration::from_hours(48) {
        format!("{} h", words.as_hours())
    } else {
        format!("{} days", words.as_hours() / 24)
    }
}

/// A moment, to be read.
pub fn moment(time: Timestamp) -> String {
    seconds(time).replace('T', " ").replace('Z', " UTC")
}

/// "of … UTC, so long ago".
pub fn age_words(then: Timestamp, now: Timestamp) -> String {
    let ago = now.duration_since(then);
    if ago < SignedDuration::ZERO {
        format!("of {}, in the future", moment(then))
    } else {
        format!("of {}, {} ago", moment(then), span(ago))
    }
}

/// The same, and how long before (or after) the scan where it is known when that was recorded.
pub fn age_at_scan(then: Timestamp, scan: Option<Timestamp>, now: Timestamp) -> String {
    let ago = age_words(then, now);
    match scan.map(|scan| scan.duration_since(then)) {
        Some(before) if before >= SignedDuration::ZERO => {
            format!("{ago}, {} before the scan", span(before))
        }
        Some(after) => format!("{ago}, {} after the scan", span(-after)),
        None => ago,
    }
}

/// The checks of a calibration, whatever is measured with it. `scan` is when that was recorded, where
/// it is known: the age that counts is the one then.
pub fn calibration_checks(
    file: &CalibrationFile,
    scan: Option<Timestamp>,
    now: Timestamp,
) -> Vec<Check> {
    let mut all = Vec::new();
    let because = |words: String, remedy: &str| (words, remedy.to_owned());
    if let Some(then) = age(file) {
        let apart = scan.unwrap_or(now).duration_since(then);
        let days = |d: SignedDuration| d.as_secs_f64() / 86_400.0;
        let old = Check::held(
            match scan {
                Some(_) => "calibration: from its recording to the scan",
                None => "calibration: age",
            },
            days(apart).abs(),
            Limit::AtMost(OLD_DAYS as f64),
            "days",
        );
        let old = old.refused_beyond(Limit::AtMost(REFUSED_DAYS as f64));
        all.push(old.or_beyond(|most| {
            let days = days(apart).abs();
            let n = decimals(days, most, 0);
            let days = format!("{days:.n$}");
            let what = match (scan, apart > SignedDuration::ZERO) {
                (None, true) => format!("the calibration is {days} days old"),
                (None, false) => format!("the calibration is of {days} days from now"),
                (Some(_), true) => format!("the calibration was {days} days old at the scan"),
                (Some(_), false) => format!("the calibration is of {days} days after the scan"),
            };
            because(
                format!("{what} (more than {most})"),
                "calibrate again, or check it with one board pose",
            )
        }));
        let past = now.duration_since(then) >= SignedDuration::from_mins(-5);
        all.push(
            Check::is("calibration: not dated in the future", past).or(|| {
                because(
                    format!("the calibration is dated {}, in the future", seconds(then)),
                    "set this machine's clock",
                )
            }),
        );
    } else {
        all.push(Check::is("calibration: carries its date", false).or(|| {
            because(
                "the calibration carries no date, so its age is unknown".to_owned(),
                REMAKE,
            )
        }));
    }
    let sure = file.covariance.is_some();
    all.push(Check::is("calibration: carries its uncertainty", sure).or(|| {
        because(
            "the calibration carries no uncertainty (covariance), so its part of every σ is unknown and left out"
                .to_owned(),
            REMAKE,
        )
    }));
    let views = !file.camera.views.is_empty();
    all.push(Check::is("calibration: carries its views", views).or(|| {
        because(
            "the calibration carries no views of the board, so coverage and tilts are unknown"
                .to_owned(),
            REMAKE,
        )
    }));
    let rms = file.camera.rms_px;
    all.push(stated(
        Check::held(
            "calibration: corners off the fitted boards, RMS",
            rms,
            Limit::Between([0.0, LOOSE_CORNERS_PX]),
            "px",
        ),
        rms,
        REFUSED_CORNERS_PX,
        ["corners miss by", &format!("rms_px is {rms:.2}")],
        "calibrate again with a flat board, sharp and still",
    ));
    let light = file.light.as_ref();
    all.push(
        Check::is("calibration: has light planes", light.is_some()).or(|| {
            because(
                "the calibration is the camera’s alone: no hand can be measured with it".to_owned(),
                "calibrate with a session that has \"light\", too",
            )
        }),
    );
    if let Some(light) = light {
        let travels = light.a.is_some() && light.b.is_some();
        all.push(Check::is("calibration: knows how the light plane travels", travels).or(|| {
            because(
                "the calibration has one slide position: a hand can be measured with the slide there only".to_owned(),
                "calibrate with the slide at several positions",
            )
        }));
    }
    let predicted = |l: &LightFile| match l.hold_out_error_mm {
        Some(miss) => Some((miss, LOOSE_PLANES_MM)),
        None => Some((l.offset_error_mm?, LOOSE_OFFSETS_MM)),
    };
    if let Some((miss, loose)) = light.and_then(predicted) {
        let limit = Limit::Between([0.0, loose]);
        all.push(stated(
            Check::held("calibration: light planes as predicted", miss, limit, "mm"),
            miss,
            REFUSED_PLANES_MM,
            [
                "light planes are predicted to",
                &format!("light planes are predicted to {miss:.2} mm"),
            ],
            "check the slide for slip and calibrate again with more board poses",
        ));
    }
    all.extend(light.and_then(own_planes));
    all.extend(file.checks.iter().cloned());
    all.extend(own_words(file));
    all
}

/// A distance that a calibration states of itself, held against what is loose: refused beyond a second
/// limit, or where it is none. `says` leads to the figure, or says it all where that is negative.
fn stated(check: Check, value: f64, refused: f64, says: [&str; 2], remedy: &str) -> Check {
    let check = check.refused_beyond(Limit::Between([0.0, refused]));
    let unit = check.unit.clone();
    check.or_beyond(|most| {
        let n = decimals(value, most, 2);
        let words = match value < 0.0 {
            true => format!("the calibration’s {}, which no distance is", says[1]),
            false => format!(
                "the calibration is loose: {} {value:.n$} {unit} (more than {most:?})",
                says[0]
            ),
        };
        (words, remedy.to_owned())
    })
}

/// Whether D = a·x + b is the line of the planes in the same file. Each of those has a normal of its
/// own, so that they lie off it by some tenths of a millimetre.
fn own_planes(light: &LightFile) -> Option<Check> {
    let (a, b) = (light.a?, light.b?);
    let off = light
        .planes
        .iter()
        .map(|p| (a * p.slide_mm + b - p.d).abs());
    let mean = off.sum::<f64>() / light.planes.len() as f64;
    let limit = Limit::AtMost(OWN_PLANES_MM);
    let what = "calibration: D = a·x + b off the planes in its file, mean";
    let check = Check::held(what, mean, limit, "mm").refused_beyond(limit);
    (!light.planes.is_empty()).then(|| {
        check.or(|| {
            (
                format!("the calibration contradicts itself: its line D = a·x + b lies {mean:.1} mm off its own planes"),
                REMAKE.to_owned(),
            )
        })
    })
}

/// What the calibration said of itself when it was made.
fn own_words(file: &CalibrationFile) -> Vec<Check> {
    let said = |words: String| Check {
        said: true,
        remedy: "calibrate again if that matters here".to_owned(),
        ..Check::caution(
            "calibration: its own words",
            format!("the calibration {words}"),
        )
    };
    // Many images that were left out are one doubt; the file names them all.
    let (left, other): (Vec<&String>, Vec<&String>) = file
        .warnings
        .iter()
        .partition(|w| w.contains(": left out: "));
    let mut all: Vec<Check> = match left.as_slice() {
        [first, _, _, ..] => vec![said(format!(
            "left out {} images, the first: {first} (all of them stand under \"warnings\" in its file)",
            left.len()
        ))],
        few => few.iter().map(|w| said(format!("said: {w}"))).collect(),
    };
    all.extend(other.iter().map(|w| said(format!("said: {w}"))));
    all
}

/// The same, and where a hand was measured with it, whether it alone makes that result uncertain.
pub fn all_checks(
    file: &CalibrationFile,
    scan: Option<Timestamp>,
    now: Timestamp,
    measured: Option<&Uncertainty>,
) -> Vec<Check> {
    let here = measured.filter(|_| file.covariance.is_some());
    let here = here.map(|u| tight_here(u.entry_parts_mm[0], u.angle_parts[0]));
    let alone = calibration_checks(file, scan, now);
    checks::of("calibration", here.into_iter().flatten().chain(alone)).collect()
}

/// Whether the calibration alone makes this result uncertain: its parts of the standard deviations
/// of entry (mm) and needle axis (rad).
fn tight_here(entry_mm: f64, axis: f64) -> [Check; 2] {
    let axis_deg = axis.to_degrees();
    let words = || {
        (
            format!(
                "the calibration is too loose: it alone leaves the entry to ±{entry_mm:.2} mm and the angle to ±{axis_deg:.2}° (more than {LOOSE_ENTRY_MM} mm or {LOOSE_AXIS_DEG}°)"
            ),
            "calibrate with more board poses, tilted more, nearer and farther".to_owned(),
        )
    };
    let entry = Check::held(
        "entry: σ by the calibration alone",
        entry_mm,
        Limit::AtMost(LOOSE_ENTRY_MM),
        "mm",
    );
    let axis = Check::held(
        "needle axis: σ by the calibration alone",
        axis_deg,
        Limit::AtMost(LOOSE_AXIS_DEG),
        "°",
    );
    // One sentence for both.
    let axis = if entry.sound() { axis.or(words) } else { axis };
    [entry.or(words), axis]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::PARAMETERS;
    use crate::checks::sentences;
    use crate::output::tests::{contract, read};

    fn doubts(file: &CalibrationFile, scan: Option<Timestamp>, now: Timestamp) -> Vec<String> {
        sentences(&calibration_checks(file, scan, now))
    }

    fn dated(days: i64) -> (CalibrationFile, Timestamp) {
        let now: Timestamp = "2026-11-25T12:00:00Z".parse().unwrap();
        let then = now - SignedDuration::from_hours(24 * days);
        let mut value = contract();
        value["provenance"] = serde_json::json!({
            "program": "cannula", "session": "s", "time": seconds(then),
        });
        let row = vec![1e-6; PARAMETERS];
        value["covariance"] = serde_json::json!(vec![row; PARAMETERS]);
        value["camera"]["views"] =
            serde_json::json!([{ "image": "a.png", "rms_px": 0.01, "used": true }]);
        (read(&value).unwrap(), now)
    }

    #[test]
    fn an_old_one_a_future_one_and_a_fresh_one() {
        let (file, now) = dated(3);
        assert_eq!(doubts(&file, None, now), [] as [String; 0]);
        assert!(
            calibration_checks(&file, None, now)
                .iter()
                .all(Check::sound)
        );
        assert!(age_words(age(&file).unwrap(), now).ends_with("3 days ago"));
        let (file, now) = dated(45);
        assert!(doubts(&file, None, now)[0].contains("45 days old"));
        // It counts what it was at the scan.
        let scan = now - SignedDuration::from_hours(24 * 40);
        assert_eq!(doubts(&file, Some(scan), now), [] as [String; 0]);
        let words = age_at_scan(age(&file).unwrap(), Some(scan), now);
        assert!(
            words.ends_with("45 days ago, 5 days before the scan"),
            "{words}"
        );
        let early = now - SignedDuration::from_hours(24 * 90);
        assert!(doubts(&file, Some(early), now)[0].contains("45 days after the scan"));
        let (fresh, now) = dated(0);
        let late = now + SignedDuration::from_hours(24 * 31);
        assert!(doubts(&fresh, Some(late), late)[0].contains("was 31 days old at the scan"));
        let (file, now) = dated(-2);
        assert!(doubts(&file, None, now)[0].contains("in the future"));
        // The contract's own file has no date, σ or views: nothing is invented, and that is said.
        let bare = read(&contract()).unwrap();
        assert_eq!(age(&bare), None);
        let said = doubts(&bare, None, now);
        assert_eq!(said.len(), 3, "{said:?}");
        for (doubt, word) in said.iter().zip(["no date", "no uncertainty", "no views"]) {
            assert!(
                doubt.contains(word) && doubt.contains("unknown"),
                "{doubt:?}"
            );
        }
    }

    #[test]
    fn one_far_too_old_or_too_loose_is_refused() {
        let verdict = |file: &CalibrationFile, now| {
            crate::checks::verdict(&calibration_checks(file, None, now))
        };
        for (days, words) in [
            (3, "usable"),
            (45, "usable with caution"),
            (400, "not usable"),
        ] {
            let (file, now) = dated(days);
            assert_eq!(verdict(&file, now), words);
        }
        for rms in [-3.0, 1.2, 50.0] {
            let (mut file, now) = dated(1);
            file.camera.rms_px = rms;
            assert_eq!(verdict(&file, now), "not usable", "{rms}");
        }
        let (mut file, now) = dated(1);
        if let Some(b) = &mut file.light.as_mut().unwrap().b {
            *b += 40.0;
        }
        assert_eq!(verdict(&file, now), "not usable");
        for miss in [-0.1, 5.0] {
            let (mut file, now) = dated(1);
            file.light.as_mut().unwrap().hold_out_error_mm = Some(miss);
            assert_eq!(verdict(&file, now), "not usable", "{miss}");
        }
    }

    #[test]
    fn a_loose_one_is_named_with_its_figure() {
        let (mut file, now) = dated(0);
        file.camera.rms_px = 0.8;
        file.light.as_mut().unwrap().hold_out_error_mm = Some(0.25);
        let said = doubts(&file, None, now);
        assert_eq!(said.len(), 2);
        assert!(
            said[0].contains("0.80 px") && said[1].contains("0.25 mm"),
            "{said:?}"
        );
        file.warnings = vec!["planes ± 0.12 mm".into()];
        file.warnings
            .extend((0..4).map(|i| format!("on_{i}.png: left out: no stripe")));
        let said = doubts(&file, None, now);
        assert_eq!(said.len(), 4, "{said:?}");
        assert!(said[2].contains("left out 4 images, the first: on_0.png"));
        assert!(said[3].contains("± 0.12 mm"));
        let loose = |entry, axis| sentences(&tight_here(entry, axis));
        assert_eq!(loose(0.05, 0.001), [] as [String; 0]);
        assert!(loose(0.05, 0.01)[0].contains("0.57°"));
        assert_eq!((loose(0.4, 0.0).len(), loose(0.4, 0.01).len()), (1, 1));
    }
}
