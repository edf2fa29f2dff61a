//! Charts of the puncture: Figures 25 to 27, and the force over the angle.

use super::{Kind, Plot, Series};
use crate::report::model::{Model, Puncture, PunctureRun};

/// Curves of one chart differ in their dashes as well as in colour.
const DASHES: [Kind; 4] = [
    Kind::Line,
    Kind::Dashes(7, 4),
    Kind::Dashes(2, 3),
    Kind::Dashes(14, 5),
];

/// Figures 25 and 27: the whole force of each run over time.
pub fn forces(p: &Puncture) -> Plot {
    Plot {
        title: format!("Force at each angle (Figures 25, 27): {}", words(p)),
        x_label: "time / s".into(),
        y_label: "force / N".into(),
        series: p
            .runs
            .iter()
            .enumerate()
            .map(|(i, r)| {
                let points = r.curve.iter().map(|c| (c[0], c[1])).collect();
                let name = match p.given_deg {
                    Some(given) if given == r.angle_deg => format!("{given}° (given)"),
                    _ => format!("{}°", r.angle_deg),
                };
                Series::new(&name, i, DASHES[i % DASHES.len()], points)
            })
            .chain(p.runs.iter().enumerate().map(|(i, r)| {
                // The force at each puncture, on its curve.
                let events = r.events.iter().filter_map(|e| e.2);
                let at = events.filter_map(|t| {
                    let next = r.curve.iter().find(|c| c[0] >= t)?;
                    Some((next[0], next[1]))
                });
                let name = if i == 0 { "layer punctured" } else { "" };
                Series::new(name, i, Kind::Dots, at.collect())
            }))
            .collect(),
        ..Plot::default()
    }
}

/// What computed the curves.
fn words(p: &Puncture) -> &'static str {
    p.runs.first().map_or("", |r| r.model.words())
}

/// Figure 26: the force of each layer over time, with the moments of puncture.
pub fn force_by_layer(r: &PunctureRun) -> Plot {
    let layer = |name: &str, colour: usize, k: usize, kind: Kind| {
        let points = r.curve.iter().map(|c| (c[0], c[k])).collect();
        Series::new(name, colour, kind, points)
    };
    Plot {
        title: format!(
            "Force by layer at {}° (Figure 26): {}",
            r.angle_deg,
            r.model.words()
        ),
        x_label: "time / s (a line where a layer is punctured)".into(),
        y_label: "force / N".into(),
        series: vec![
            layer("skin", 1, 2, DASHES[0]),
            layer("fat", 4, 3, DASHES[1]),
            layer("vein", 0, 4, DASHES[2]),
        ],
        marks: r
            .events
            .iter()
            .filter_map(|(name, _, puncture, _)| Some(((*puncture)?, name.clone())))
            .collect(),
        ..Plot::default()
    }
}

/// The fast model's peak force over the angle, with its band.
pub fn force_over_angle(p: &Puncture) -> Plot {
    let mut band: Vec<(f64, f64)> = p.force_over_angle.iter().map(|r| (r[0], r[2])).collect();
    band.extend(p.force_over_angle.iter().rev().map(|r| (r[0], r[3])));
    let middle = p.force_over_angle.iter().map(|r| (r[0], r[1])).collect();
    let mut series = vec![
        Series::new("model's own error", 0, Kind::Area, band),
        Series::new("fast model", 0, Kind::Line, middle),
    ];
    let runs: Vec<(f64, f64)> = p
        .runs
        .iter()
        .filter(|r| r.model == Model::Reference)
        .map(|r| {
            (
                r.angle_deg,
                r.curve.iter().map(|c| c[1]).fold(0.0, f64::max),
            )
        })
        .collect();
    if !runs.is_empty() {
        series.push(Series::new("reference simulation", 1, Kind::Dots, runs));
    }
    Plot {
        title: "Peak force over the needle's angle".into(),
        x_label: "angle / °".into(),
        y_label: "peak force / N".into(),
        series,
        marks: match p.given_deg {
            None => vec![(p.angle_deg, "decided".into())],
            Some(given) if given == p.angle_deg => {
                vec![(given, "given; the criterion’s too".into())]
            }
            Some(given) => vec![
                (given, "given".into()),
                (p.angle_deg, "the criterion’s, not used".into()),
            ],
        },
        ..Plot::default()
    }
}
