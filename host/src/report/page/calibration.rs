//! The calibration: residuals, coverage, light planes, the paper's tables 1 to 4 for this rig
//! beside the paper's own figures.

use super::needle::parameters;
use super::table::table;
use super::{chart, count, number, scientific};
use crate::calibration::light::published::{TABLE_1, TABLE_2, TABLE_3, TABLE_4};
use crate::report::chart as charts;
use crate::report::model::{Calibration, Light, Position};
use maud::{Markup, html};

/// The section.
pub fn section(c: &Calibration) -> Markup {
    let seen = |f: fn(&crate::report::model::BoardView) -> bool| c.views.iter().any(f);
    html! {
        h2 { "Calibration" }
        p {
            "Corners miss the fitted board by " (number(c.rms_px, 4)) " px RMS over " (count(c.views.len(), "view"))
            @if !c.positions.is_empty() {
                "; light planes at " (count(c.positions.len(), "slide position"))
            }
            ". Method: " (c.method) "."
            @if let Some(made) = &c.made { " It is " (made) "." }
        }
        (findings(c))
        div.charts {
            @if !c.views.is_empty() { (chart(&charts::view_rms(c))) }
            @if seen(|v| !v.residuals.is_empty()) { (chart(&charts::residuals(c))) }
            @if seen(|v| !v.outline.is_empty()) { (chart(&charts::coverage(c))) }
            @if seen(|v| v.tilt_deg.is_some()) { (chart(&charts::tilts(c))) }
            @if c.positions.len() > 1 { (chart(&charts::offsets(c))) }
            @if !c.figure_14.is_empty() { (chart(&charts::figure_14(c))) }
        }
        div.tables {
            (parameters(&c.parameters))
            (table_1(c))
            (table_2(c))
            (table_3(c))
        }
        (table_4(c))
        (views(c))
    }
}

/// The views by name, to find the one that is odd.
fn views(c: &Calibration) -> Markup {
    let rows: Vec<Vec<String>> = c
        .views
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let tilt = |k: usize| v.tilt_deg.map_or("–".into(), |t| number(t[k], 1));
            let largest = v.residuals.iter().map(|r| r[0].hypot(r[1]));
            let largest = largest.fold(f64::NAN, f64::max);
            vec![
                v.name.clone(),
                (i + 1).to_string(),
                number(v.rms_px, 4),
                number(largest, 4),
                tilt(0),
                tilt(1),
                v.distance_mm.map_or("–".into(), |d| number(d, 0)),
                if v.used { "yes" } else { "no" }.to_owned(),
            ]
        })
        .collect();
    table(
        "Views of the board",
        &[
            "image",
            "view",
            "RMS / px",
            "largest / px",
            "tilt about the horizontal / °",
            "about the vertical / °",
            "distance / mm",
            "used",
        ],
        &rows,
    )
}

fn findings(c: &Calibration) -> Markup {
    html! {
        h3 { "What is weak, and what to do" }
        @if !c.findings.is_empty() { ul { @for f in &c.findings { li { (f) } } } }
        @else if c.checked == 0 { p { "Nothing was checked." } }
        @else { p { "Nothing: all " (c.checked) " checks of it are sound. They stand under Checks, with value and limit." } }
    }
}

fn table_1(c: &Calibration) -> Markup {
    let rows: Vec<Vec<String>> = c
        .table_1
        .iter()
        .enumerate()
        .map(|(i, (name, before, after))| {
            let paper = TABLE_1.get(i);
            vec![
                name.clone(),
                scientific(*before),
                scientific(*after),
                paper.map_or("–".into(), |p| number(p.0, 3)),
                paper.map_or("–".into(), |p| scientific(p.1)),
            ]
        })
        .collect();
    html! {
        @if !rows.is_empty() { div.block {
            (table("Table 1: Σ squared reprojection error of the stripe points", &["board pose", "before / px²", "after / px²", "paper: before / px²", "paper: after / px²"], &rows))
            p.soft { "Before and after the optimisation; the paper's rows are its own nine poses, in order. The paper's figure after says that its points lie on their rays, not how good the planes are." }
        } }
    }
}

fn table_2(c: &Calibration) -> Markup {
    let rows: Vec<Vec<String>> = c.positions.iter().filter_map(spacing).collect();
    html! {
        @if !rows.is_empty() { div.block {
            (table("Table 2: distance between neighbouring planes", &["slide / mm", "travelled / mm", "distance / mm", "error / mm", "paper: distance / mm"], &rows))
            p.soft { "Mean |error| " (number(c.spacing_error_mm, 4)) " mm; in the paper 0.096 mm («about 0.1 mm»), each over 5 mm." }
        } }
    }
}

fn spacing(p: &Position) -> Option<Vec<String>> {
    let (distance, travelled) = (p.spacing_mm?, p.travelled_mm?);
    let paper = TABLE_2.iter().find(|r| r.0 == p.slide_mm);
    Some(vec![
        number(p.slide_mm, 2),
        number(travelled, 2),
        number(distance, 4),
        number(distance - travelled.abs(), 4),
        paper.map_or("–".into(), |r| number(r.1, 2)),
    ])
}

fn table_3(c: &Calibration) -> Markup {
    let Some(Light { normal, travel }) = &c.light else {
        return html! {};
    };
    let ours = [
        number(normal[0], 5),
        number(normal[1], 5),
        number(normal[2], 5),
        travel.map_or("–".into(), |t| number(t.0, 5)),
        travel.map_or("–".into(), |t| number(t.1, 4)),
    ];
    let names = ["A", "B", "C", "a / mm per mm", "b / mm"];
    let rows: Vec<Vec<String>> = names
        .iter()
        .zip(ours)
        .zip(TABLE_3)
        .map(|((name, own), paper)| vec![(*name).to_owned(), own, number(paper, 3)])
        .collect();
    html! { div.block {
        (table("Table 3: common normal and D = a·x + b", &["", "this rig", "paper"], &rows))
        p.soft { "The paper's rig is another one: its planes are not to agree with these. Its own Table 4 gives a = −1.0055, b = −191.704." }
    } }
}

fn table_4(c: &Calibration) -> Markup {
    // With one position there is no line to predict it from.
    let travels = c.light.as_ref().is_some_and(|l| l.travel.is_some());
    let row = |p: &Position| offset(p, travels);
    let rows: Vec<Vec<String>> = c.positions.iter().map(row).collect();
    html! { div.block {
        (table("Table 4: D predicted and fitted", &["slide / mm", "predicted / mm", "fitted / mm", "difference / mm", "|hold-out| / mm", "points", "RMS to plane / mm", "paper: predicted / mm", "paper: real / mm", "paper: |difference| / mm"], &rows))
        @if travels && !rows.is_empty() { p.soft { "Mean |difference| " (number(c.offset_error_mm, 4)) " mm; in the paper 0.174 mm (0.179 mm with the misprint in its row of 10 mm mended, as here). Hold-out: the position is left out and predicted from the rest." } }
    } }
}

fn offset(p: &Position, travels: bool) -> Vec<String> {
    let told = |mm: f64| match travels {
        true => number(mm, 4),
        false => "–".into(),
    };
    let paper = TABLE_4.iter().find(|r| r.0 == p.slide_mm);
    let of = |f: fn(&(f64, f64, f64, f64)) -> f64| paper.map_or("–".into(), |r| number(f(r), 3));
    vec![
        number(p.slide_mm, 2),
        told(p.predicted_mm),
        number(p.fitted_mm, 4),
        told(p.predicted_mm - p.fitted_mm),
        p.hold_out_mm.map_or("–".into(), |h| number(h, 4)),
        p.points.to_string(),
        number(p.rms_mm, 4),
        of(|r| r.1),
        of(|r| r.2),
        of(|r| (r.1 - r.2).abs()),
    ]
}
