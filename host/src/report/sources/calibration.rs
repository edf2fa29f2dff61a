//! The calibration's section.

use crate::checks::{Check, sentences};
use crate::output::{CalibrationFile, LightFile, ViewFile, age, age_at_scan};
use crate::report::model::{self, BoardView, Calibration, Position};
use jiff::Timestamp;

/// What the report shows of a calibration: what its file tells, whether it was made in the same run
/// or long ago. `checks` are those that were made of it; `scan` is when that was recorded.
pub fn calibration(f: &CalibrationFile, checks: &[Check], scan: Option<Timestamp>) -> Calibration {
    let light = f.light.as_ref();
    let sigma = |i: usize| {
        let row = f.covariance.as_ref()?.get(i)?;
        row.get(i).copied().filter(|v| *v > 0.0).map(f64::sqrt)
    };
    let c = f.camera();
    let mut parameters: Vec<_> = NAMES
        .iter()
        .zip(c.parameters().iter())
        .enumerate()
        .map(|(i, (name, v))| ((*name).to_owned(), *v, sigma(i), unit(i).to_owned()))
        .collect();
    let travel = light.and_then(|l| Some((l.a?, l.b?)));
    if let Some((a, b)) = travel {
        parameters.push(("a".into(), a, sigma(11), "mm/mm".into()));
        parameters.push(("b".into(), b, sigma(12), "mm".into()));
    }
    Calibration {
        size: [c.width, c.height],
        parameters,
        rms_px: f.camera.rms_px,
        views: f
            .camera
            .views
            .iter()
            .map(|v| view(v, f.board.map_or(0, |b| b.columns)))
            .collect(),
        light: light.map(|l| model::Light {
            normal: l.normal,
            travel,
        }),
        positions: light.map(|l| positions(l, travel)).unwrap_or_default(),
        spacing_error_mm: light.and_then(|l| l.spacing_error_mm).unwrap_or(f64::NAN),
        offset_error_mm: light.and_then(|l| l.offset_error_mm).unwrap_or(f64::NAN),
        table_1: light
            .iter()
            .flat_map(|l| &l.table_1)
            .map(|r| (r.image.clone(), r.before_px2, r.after_px2))
            .collect(),
        figure_14: light
            .iter()
            .flat_map(|l| &l.figure_14)
            .map(|r| (r.slide_mm, r.before_mm, r.after_mm))
            .collect(),
        findings: sentences(checks),
        checked: checks.len(),
        made: age(f).map(|then| age_at_scan(then, scan, Timestamp::now())),
        method: match f.method.as_deref() {
            Some("ml") => "maximum likelihood".into(),
            Some("paper") => "the paper's".into(),
            _ => "not known".into(),
        },
    }
}

fn positions(l: &LightFile, travel: Option<(f64, f64)>) -> Vec<Position> {
    let spacing = |x: f64| l.table_2.iter().find(|r| r.slide_mm == x);
    let offset = |x: f64| l.table_4.iter().find(|r| r.slide_mm == x);
    l.planes
        .iter()
        .map(|p| {
            let predicted = travel.map_or(p.d, |(a, b)| a * p.slide_mm + b);
            Position {
                slide_mm: p.slide_mm,
                normal: p.normal,
                fitted_mm: offset(p.slide_mm).map_or(p.d, |o| o.fitted_mm),
                predicted_mm: offset(p.slide_mm).map_or(predicted, |o| o.predicted_mm),
                spacing_mm: spacing(p.slide_mm).map(|s| s.distance_mm),
                travelled_mm: spacing(p.slide_mm).map(|s| s.travelled_mm),
                hold_out_mm: offset(p.slide_mm).and_then(|o| o.hold_out_mm),
                points: p.points,
                rms_mm: p.rms_mm,
            }
        })
        .collect()
}

/// A view of a board with so many columns.
fn view(v: &ViewFile, columns: usize) -> BoardView {
    let pairs = |flat: &[f64]| flat.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
    let corners: Vec<[f64; 2]> = pairs(&v.corners_px);
    // Around the grid: its four outer corners.
    let last = corners.len();
    let ends = [
        0,
        columns.saturating_sub(1),
        last.wrapping_sub(1),
        last.saturating_sub(columns),
    ];
    BoardView {
        name: v.image.clone(),
        rms_px: v.rms_px,
        used: v.used,
        outline: ends
            .iter()
            .filter_map(|&i| corners.get(i).copied())
            .collect(),
        corners,
        residuals: pairs(&v.residuals_px),
        tilt_deg: v.tilt_deg,
        distance_mm: v.distance_mm,
    }
}

/// The camera's parameters in the order of the covariance.
const NAMES: [&str; 9] = ["fx", "fy", "u0", "v0", "k1", "k2", "p1", "p2", "k3"];

fn unit(i: usize) -> &'static str {
    if i < 4 { "px" } else { "" }
}
