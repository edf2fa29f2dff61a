//! The calibration: residuals, coverage, light planes, the paper's tables 1 to 4 for this rig
//! beside the paper's own figures.

use super::needle::parameters;
use super::table::table;
use super::{chart, number, vector};
use crate::report::chart as charts;
use crate::report::model::{Calibration, Light, Position};
use maud::{Markup, html};

/// The section.
pub fn section(c: &Calibration) -> Markup {
    html! {
        h2 { "Calibration" }
        p {
            "Reprojection error " (number(c.rms_px, 4)) " px RMS over " (c.views.len()) " views"
            @if !c.positions.is_empty() {
                "; light planes at " (c.positions.len()) " slide positions"
            }
            ". Method: " (c.method) "."
        }
        @if !c.findings.is_empty() {
            p { "What is weak, and what to do:" }
            ul { @for f in &c.findings { li { (f) } } }
        }
        div.charts {
            (chart(&charts::view_rms(c)))
            @if c.views.iter().any(|v| !v.residuals.is_empty()) { (chart(&charts::residuals(c))) }
            (chart(&charts::coverage(c)))
            (chart(&charts::tilts(c)))
            @if c.positions.len() > 1 { (chart(&charts::offsets(c))) }
            @if !c.figure_14.is_empty() { (chart(&charts::figure_14(c))) }
        }
        (parameters(&c.parameters))
        (tables(c))
    }
}

fn tables(c: &Calibration) -> Markup {
    let table_1: Vec<Vec<String>> = c
        .table_1
        .iter()
        .map(|(name, before, after)| vec![name.clone(), number(*before, 3), format!("{after:.3e}")])
        .collect();
    let table_2: Vec<Vec<String>> = c.positions.iter().filter_map(spacing).collect();
    let table_4: Vec<Vec<String>> = c.positions.iter().map(offset).collect();
    html! {
        (table("Table 1 for this rig: reprojection error of the stripe points, Σ squares", &["board pose", "not optimised / px²", "optimised / px²"], &table_1))
        @if !c.table_1.is_empty() { p.soft { "In the paper: 38.708 to 134.205 before, 2.098 × 10⁻⁷ to 8.626 × 10⁻⁷ after. This figure says that the points lie on their rays; it does not measure the planes." } }
        (table("Table 2 for this rig: distance between neighbouring planes", &["slide / mm", "travelled / mm", "distance / mm", "error / mm"], &table_2))
        @if !table_2.is_empty() { p.soft { "Mean error " (number(c.spacing_error_mm, 4)) " mm; in the paper 0.096 mm («about 0.1 mm»)." } }
        @if let Some(Light { normal, travel }) = &c.light {
            h3 { "Table 3 for this rig: light plane" }
            p { "Common normal " (vector(normal, 5))
                @if let Some((a, b)) = travel { "; D = " (number(*a, 5)) " x " @if *b < 0.0 { "− " } @else { "+ " } (number(b.abs(), 4)) " mm" } "." }
            p.soft { "In the paper: (0.007, −0.876, 0.482); D = −1.005 x − 191.717 (its Table 4 gives −1.0055 and −191.704)." }
        }
        (table("Table 4 for this rig: D predicted and fitted", &["slide / mm", "predicted / mm", "fitted / mm", "difference / mm", "from the others / mm", "points", "RMS / mm"], &table_4))
        @if !table_4.is_empty() { p.soft { "Mean difference " (number(c.offset_error_mm, 4)) " mm; in the paper 0.174 mm (0.179 mm with the misprint in its row of 10 mm mended). «From the others»: the position left out and predicted from the rest." } }
    }
}

fn spacing(p: &Position) -> Option<Vec<String>> {
    let (distance, travelled) = (p.spacing_mm?, p.travelled_mm?);
    Some(vec![
        number(p.slide_mm, 2),
        number(travelled, 2),
        number(distance, 4),
        number(distance - travelled.abs(), 4),
    ])
}

fn offset(p: &Position) -> Vec<String> {
    vec![
        number(p.slide_mm, 2),
        number(p.predicted_mm, 4),
        number(p.fitted_mm, 4),
        number(p.predicted_mm - p.fitted_mm, 4),
        p.hold_out_mm.map_or("–".into(), |h| number(h, 4)),
        p.points.to_string(),
        number(p.rms_mm, 4),
    ]
}
