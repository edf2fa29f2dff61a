//! From the results of the stages to what the report shows. Reads the few images that are shown.

mod calibration;
mod decision;
mod measurement;
mod picture;
mod puncture;

pub use calibration::calibration;
pub use decision::{decided, punctured};
pub use measurement::{needle, scene, verdict};
pub use picture::{picture, stripe_sample, stripes};
pub use puncture::puncture_folder;

use super::model::Provenance;
use crate::pipeline::Times;

/// What is known of every run.
pub fn provenance(session: &str, settings: Vec<(String, String)>, times: &Times) -> Provenance {
    Provenance {
        program: format!("cannula {}", env!("CARGO_PKG_VERSION")),
        command: std::env::args().collect::<Vec<_>>().join(" "),
        time: utc_now(),
        session: session.to_owned(),
        settings,
        stages: times
            .seconds()
            .into_iter()
            .map(|(name, s)| (name.replace('_', " "), 1e3 * s))
            .collect(),
    }
}

/// Every threshold of the measurement, by name, in the units of the screen.
pub fn settings(method: &str, s: &crate::needle::Settings) -> Vec<(String, String)> {
    let l = &s.limits;
    let degrees = |r: f64| format!("{:.2}°", r.to_degrees());
    [
        ("method", method.to_owned()),
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
        ("region: widest gap bridged", format!("{} mm", l.gap_mm)),
        (
            "region: least coverage",
            format!("{:.0} %", 100.0 * l.coverage),
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
    ]
    .into_iter()
    .map(|(name, value)| (name.to_owned(), value))
    .collect()
}

/// The time as ISO 8601, UTC, to the second.
pub fn utc_now() -> String {
    let seconds = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| d.as_secs());
    iso_8601(seconds)
}

/// Seconds since 1970 as a date (H. Hinnant, «chrono-compatible low-level date algorithms»).
fn iso_8601(seconds: u64) -> String {
    let (days, rest) = ((seconds / 86_400) as i64, seconds % 86_400);
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z",
        rest / 3600,
        rest / 60 % 60,
        rest % 60
    )
}

/// A vector as an array.
fn three(v: &crate::geometry::Vector3) -> [f64; 3] {
    [v.x, v.y, v.z]
}

#[cfg(test)]
mod tests {
    use super::iso_8601;

    #[test]
    fn dates_of_known_seconds() {
        assert_eq!(iso_8601(0), "1970-01-01T00:00:00Z");
        assert_eq!(iso_8601(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(iso_8601(1_795_305_599), "2026-11-21T23:59:59Z");
    }
}
