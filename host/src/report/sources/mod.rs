//! From the results of the stages to what the report shows. Reads the few images that are shown.

mod calibration;
mod decision;
mod measurement;
mod picture;
mod puncture;

pub use calibration::calibration;
pub use decision::{decided, punctured, with_reference};
pub use measurement::{needle, scene, scene_refused};
pub use picture::{ambient, picture, stripe_middle, stripe_sample, stripes};
pub use puncture::puncture_folder;

use super::model::Provenance;
use crate::needle::surface::{BROAD_MM, FINE_MM, GAP_SPACINGS};
use crate::output::{
    LOOSE_AXIS_DEG, LOOSE_CORNERS_PX, LOOSE_ENTRY_MM, LOOSE_OFFSETS_MM, LOOSE_PLANES_MM, OLD_DAYS,
    REFUSED_CORNERS_PX, REFUSED_DAYS, REFUSED_PLANES_MM,
};
use crate::pipeline::{Method, Times};

/// What is known of every run.
pub fn provenance(session: &str, settings: Vec<(String, String)>, times: &Times) -> Provenance {
    Provenance {
        program: crate::PROGRAM.to_owned(),
        command: std::env::args().collect::<Vec<_>>().join(" "),
        time: crate::output::moment(jiff::Timestamp::now()),
        session: session.to_owned(),
        settings,
        stages: times
            .seconds()
            .into_iter()
            .map(|(name, s)| (name.replace('_', " "), 1e3 * s))
            .collect(),
    }
}

/// Every setting and threshold of a measurement, by name, in the units of the screen.
pub fn settings(method: Method, s: &crate::needle::Settings) -> Vec<(String, String)> {
    let l = &s.limits;
    let degrees = |r: f64| format!("{:.2}°", r.to_degrees());
    let own = [
        ("method", method.name().to_owned()),
        ("needle angle", degrees(s.angle)),
        (
            "path begins before the entry by",
            format!("{} mm", s.stand_off_mm),
        ),
        ("path ends under the plane by", format!("{} mm", s.depth_mm)),
        (
            "stripe error shared by a whole stripe",
            format!("{} px", s.stripe_bias_px),
        ),
        ("region: fewest points", l.points.to_string()),
        ("region: fewest stripes", l.stripes.to_string()),
        (
            "region: widest gap bridged",
            format!(
                "{} mm, or {GAP_SPACINGS} of the usual spacing of stripes where that is more",
                l.gap_mm
            ),
        ),
        (
            "region: least coverage",
            format!("{:.0} %", 100.0 * l.coverage),
        ),
        (
            "region: called cut off below a coverage of",
            format!("{:.0} %", 100.0 * l.whole),
        ),
        ("vein: least length", format!("{} mm", l.vein_mm)),
        (
            "vein: called beside the entry, or bent, from",
            format!("{} mm", l.beside_mm),
        ),
        (
            "region: largest RMS distance over radius",
            l.roughness.to_string(),
        ),
        ("largest σ of the angle", degrees(l.angle_sigma)),
        ("largest σ of the entry", format!("{} mm", l.entry_sigma_mm)),
        (
            "largest angle between normal and sight",
            degrees(l.obliquity),
        ),
        (
            "smallest angle between light plane and surface",
            degrees(l.grazing),
        ),
        (
            "region: called curved from RMS distance over radius",
            l.curved.to_string(),
        ),
        (
            "region: angle said to hang on the radius from",
            degrees(l.turn),
        ),
    ];
    let mut rows: Vec<(String, String)> = named(own).collect();
    rows.extend([(
        "region: parabola along the stripe, half its width for heights, for the vein".to_owned(),
        format!("{} mm, {} mm", FINE_MM, BROAD_MM),
    )]);
    if method == Method::Ml {
        let hand = crate::stripe::hand::HandSettings::default();
        let yes = |on: bool| if on { "yes" } else { "no" }.to_owned();
        rows.extend([
            (
                "hand stripe: smoothed along it".to_owned(),
                yes(hand.smooth),
            ),
            ("hand stripe: albedo corrected".to_owned(), yes(hand.albedo)),
        ]);
        rows.extend(named(crate::stripe::hand::limits()));
    } else {
        let hand = crate::stripe::paper::hand::Settings::default();
        rows.extend(under("hand stripe, the paper’s way", &hand));
        rows.extend(named(crate::stripe::paper::hand::limits()));
    }
    rows.extend(calibration_settings(method).into_iter().skip(1));
    rows
}

/// Every threshold of a calibration.
pub fn calibration_settings(method: Method) -> Vec<(String, String)> {
    let own = [
        ("method", method.name().to_owned()),
        ("calibration: old after", format!("{OLD_DAYS} days")),
        (
            "calibration: refused beyond",
            format!(
                "{REFUSED_DAYS} days, corners {REFUSED_CORNERS_PX} px, planes {REFUSED_PLANES_MM} mm"
            ),
        ),
        (
            "calibration: loose if corners miss by",
            format!("{LOOSE_CORNERS_PX} px"),
        ),
        (
            "calibration: loose if planes are predicted to",
            format!("{LOOSE_PLANES_MM} mm ({LOOSE_OFFSETS_MM} mm without hold-out)"),
        ),
        (
            "calibration: loose if it alone leaves entry, angle to",
            format!("{LOOSE_ENTRY_MM} mm, {LOOSE_AXIS_DEG}°"),
        ),
    ];
    let stages = crate::board::limits()
        .into_iter()
        .chain(crate::stripe::board::limits())
        .chain(crate::stripe::limits())
        .chain(crate::pipeline::sequence::limits())
        .chain(crate::calibration::camera::limits())
        .chain(crate::calibration::light::limits());
    let mut rows: Vec<_> = named(own).chain(named(stages)).collect();
    if method == Method::Paper {
        let board = crate::stripe::paper::board::Settings::default();
        let loss = crate::calibration::loss::Settings::default();
        rows.extend(under("board stripe, the paper’s way", &board));
        rows.extend(under("Eq. 7 and 11, the paper’s way", &loss));
    }
    rows
}

/// Names as text of their own.
fn named(
    rows: impl IntoIterator<Item = (&'static str, String)>,
) -> impl Iterator<Item = (String, String)> {
    rows.into_iter()
        .map(|(name, value)| (name.to_owned(), value))
}

/// A field's name as words, its unit as on every axis: "fast_mm_s" is "fast / mm/s".
fn words(key: &str) -> String {
    const UNITS: [(&str, &str); 14] = [
        ("_mm_s2", "mm/s²"),
        ("_mm_s", "mm/s"),
        ("_kj_m2", "kJ/m²"),
        ("_mm", "mm"),
        ("_ms", "ms"),
        ("_us", "µs"),
        ("_s", "s"),
        ("_deg", "°"),
        ("_mpa", "MPa"),
        ("_kpa", "kPa"),
        ("_px", "px"),
        ("_db", "dB"),
        ("_n", "N"),
        ("_ppm", "ppm"),
    ];
    let unit = UNITS.iter().find_map(|(end, unit)| {
        let name = key.strip_suffix(end)?;
        // "steps_per_mm" is a name.
        (!name.ends_with("per")).then(|| format!("{} / {unit}", name.replace('_', " ")))
    });
    unit.unwrap_or_else(|| key.replace('_', " "))
}

/// The same with a word before each path.
pub fn under(name: &str, value: &impl serde::Serialize) -> Vec<(String, String)> {
    let rows = leaves(value).into_iter();
    rows.map(|(path, value)| (format!("{name}: {path}"), value))
        .collect()
}

/// The leaves of anything that can be written as JSON, with the path to each.
pub fn leaves(value: &impl serde::Serialize) -> Vec<(String, String)> {
    fn walk(path: &str, value: &serde_json::Value, rows: &mut Vec<(String, String)>) {
        use serde_json::Value;
        let under = |key: &str| {
            if path.is_empty() {
                words(key)
            } else {
                format!("{path}: {}", words(key))
            }
        };
        match value {
            Value::Object(map) => map.iter().for_each(|(k, v)| walk(&under(k), v, rows)),
            Value::Array(list) if list.iter().all(Value::is_number) => {
                let numbers: Vec<String> = list.iter().map(Value::to_string).collect();
                rows.push((path.to_owned(), numbers.join(", ")));
            }
            Value::Array(list) => list
                .iter()
                .enumerate()
                .for_each(|(i, v)| walk(&under(&(i + 1).to_string()), v, rows)),
            Value::String(text) => rows.push((path.to_owned(), text.clone())),
            other => rows.push((path.to_owned(), other.to_string())),
        }
    }
    let mut rows = Vec::new();
    if let Ok(json) = serde_json::to_value(value) {
        walk("", &json, &mut rows);
    }
    rows
}

/// A vector as an array.
fn three(v: &crate::geometry::Vector3) -> [f64; 3] {
    [v.x, v.y, v.z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_are_named_by_their_path() {
        let setup = crate::puncture::tissue::Setup::default();
        let rows = leaves(&setup);
        let value = |name: &str| rows.iter().find(|r| r.0 == name).map(|r| r.1.as_str());
        assert_eq!(value("friction"), Some(setup.friction.to_string().as_str()));
        assert_eq!(value("needle: bevel / °"), Some("12.0"));
        assert_eq!(value("skin: toughness / kJ/m²"), Some("1.1"));
        assert_eq!(words("steps_per_mm"), "steps per mm");
        assert_eq!(value("skin: law: model"), Some("yeoh"));
    }
}
