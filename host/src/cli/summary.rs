//! The short table at the end of a job.

use crate::pipeline::{Calibrated, Measurement, Times};

/// Rows of cells in columns: the first left, the others right.
fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let wide: Vec<usize> = (0..columns)
        .map(|k| {
            let cells = rows.iter().filter_map(|r| r.get(k));
            cells.map(|c| c.chars().count()).max().unwrap_or(0)
        })
        .collect();
    let lines = rows.iter().map(|row| {
        let cells = row.iter().zip(&wide).enumerate();
        let line: Vec<String> = cells
            .map(|(k, (c, &w))| {
                if k == 0 {
                    format!("{c:w$}")
                } else {
                    format!("{c:>w$}")
                }
            })
            .collect();
        line.join("  ").trim_end().to_owned()
    });
    lines.collect::<Vec<_>>().join("\n")
}

fn row(name: &str, cells: &[String]) -> Vec<String> {
    std::iter::once(name.to_owned())
        .chain(cells.iter().cloned())
        .collect()
}

/// A calibration.
pub fn calibration(c: &Calibrated) -> String {
    let sigma = |i: usize| {
        let v = c.covariance[(i, i)];
        if v > 0.0 {
            format!("± {:.3}", v.sqrt())
        } else {
            String::new()
        }
    };
    let mut text = aligned(
        &["fx", "fy", "u0", "v0"]
            .iter()
            .zip(c.camera.parameters().iter())
            .enumerate()
            .map(|(i, (name, v))| row(&format!("{name} / px"), &[format!("{v:.3}"), sigma(i)]))
            .collect::<Vec<_>>(),
    );
    text += &format!(
        "\ncorners       {:.4} px RMS over {} views",
        c.zhang.rms_px,
        c.views.len()
    );
    let Some(light) = &c.light else { return text };
    let n = light.model.normal;
    text += &format!(
        "\nlight planes  normal ({:.5}, {:.5}, {:.5})",
        n.x, n.y, n.z
    );
    if light.travels {
        text += &format!(
            ", D = {:.5}·x {:+.4} mm\n              {} positions, spacing error {:.4} mm, offset error {:.4} mm",
            light.model.a,
            light.model.b,
            light.planes.len(),
            light.spacing_error_mm,
            light.offset_error_mm
        );
    } else {
        text += ", one position: no travel";
    }
    text
}

/// A measurement.
pub fn measurement(m: &Measurement) -> String {
    let d = &m.decision;
    let u = &d.uncertainty;
    let vector = |v: [f64; 3], decimals: usize| v.map(|x| format!("{x:.decimals$}"));
    let three = |name: &str, v: &crate::geometry::Vector3, decimals, sigma: String| {
        let mut cells = vector([v.x, v.y, v.z], decimals).to_vec();
        cells.push(sigma);
        row(name, &cells)
    };
    let degrees = |r: f64| format!("± {:.3}°", r.to_degrees());
    let rows = [
        row("camera frame", &["X", "Y", "Z", "1 σ"].map(str::to_owned)),
        three(
            "entry / mm",
            &d.entry.coords,
            3,
            format!("± {:.3} mm", u.entry_sigma_mm()),
        ),
        three(
            "plane normal",
            &d.plane.normal,
            5,
            degrees(u.normal_sigma()),
        ),
        three("vein", &d.direction, 5, String::new()),
        three("needle axis", &d.needle.axis, 5, degrees(u.axis_sigma())),
    ];
    format!(
        "{}\nneedle angle  {:.1}° ± {:.2}° measured (1 σ), {}\n              to the plane of {} points within {:.1} mm ({:.3} mm RMS); cloud of {} points",
        aligned(&rows),
        d.needle.angle.to_degrees(),
        u.angle_sigma.to_degrees(),
        d.radius_change()
            .map_or("the radius's part unknown".to_owned(), |r| format!(
                "± {:.2}° by the region's radius (systematic)",
                r.abs().to_degrees()
            )),
        d.points,
        m.request.radius_mm,
        d.rms_mm,
        m.cloud.len(),
    ) + &verdict(m)
}

/// The report's verdict in a line.
fn verdict(m: &Measurement) -> String {
    let words = crate::checks::verdict(&m.checks);
    let warnings = match crate::checks::sentences(&m.checks).len() {
        0 => String::new(),
        1 => ": one warning (above, in result.json and in the report)".to_owned(),
        n => format!(": {n} warnings (above, in result.json and in the report)"),
    };
    format!("\nverdict       {words}{warnings}")
}

/// Where the time went, for `-v`.
pub fn times(times: &Times) -> String {
    let all: Vec<String> = times
        .seconds()
        .iter()
        .map(|(name, s)| format!("{} {:.1}", name.replace('_', " "), 1e3 * s))
        .collect();
    format!(
        "time per stage, summed over threads, ms: {}",
        all.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_under_each_other() {
        let rows = [
            row("σ", &["1".into(), "±".into()]),
            row("long", &["-22.5".into()]),
        ];
        assert_eq!(aligned(&rows), "σ         1  ±\nlong  -22.5");
    }
}
