//! The calibration's section.

use super::three;
use crate::geometry::Pose;
use crate::output::{CalibrationFile, LightFile, age, age_words};
use crate::pipeline::{Calibrated, Light, Method};
use crate::report::model::{self, BoardView, Calibration, Position};

/// What the report shows of a calibration.
pub fn calibration(c: &Calibrated) -> Calibration {
    let light = c.light.as_ref();
    Calibration {
        size: [c.camera.width, c.camera.height],
        parameters: parameters(c),
        rms_px: c.zhang.rms_px,
        views: views(c),
        light: light.map(|l| model::Light {
            normal: three(&l.model.normal),
            travel: l.travels.then_some((l.model.a, l.model.b)),
        }),
        positions: light.map(positions).unwrap_or_default(),
        spacing_error_mm: light.map_or(0.0, |l| l.spacing_error_mm),
        offset_error_mm: light.map_or(0.0, |l| l.offset_error_mm),
        table_1: light
            .map(|l| {
                l.table_1
                    .iter()
                    .map(|(name, before, after)| {
                        (
                            name.clone(),
                            before.reprojection_px2,
                            after.reprojection_px2,
                        )
                    })
                    .collect()
            })
            .unwrap_or_default(),
        figure_14: light
            .map(|l| {
                l.figure_14
                    .iter()
                    .map(|(x, before, after)| (*x, before.plane_mm, after.plane_mm))
                    .collect()
            })
            .unwrap_or_default(),
        findings: c.warnings.clone(),
        made: None,
        method: match c.method {
            Method::Ml => "maximum likelihood".into(),
            Method::Paper => "the paper's".into(),
        },
    }
}

/// What a calibration's file tells: no corners, so neither residuals nor coverage.
pub fn of_file(f: &CalibrationFile) -> Calibration {
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
            .map(|v| BoardView {
                name: v.image.clone(),
                rms_px: v.rms_px,
                ..BoardView::default()
            })
            .collect(),
        light: light.map(|l| model::Light {
            normal: l.normal,
            travel,
        }),
        positions: light.map(|l| file_positions(l, travel)).unwrap_or_default(),
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
        findings: f.warnings.clone(),
        made: age(f).map(|then| age_words(then, jiff::Timestamp::now())),
        method: match f.method.as_deref() {
            Some("ml") => "maximum likelihood".into(),
            Some("paper") => "the paper's".into(),
            _ => "not known".into(),
        },
    }
}

fn file_positions(l: &LightFile, travel: Option<(f64, f64)>) -> Vec<Position> {
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
                hold_out_mm: None,
                points: p.points,
                rms_mm: p.rms_mm,
            }
        })
        .collect()
}

/// The camera's parameters in the order of the covariance.
const NAMES: [&str; 9] = ["fx", "fy", "u0", "v0", "k1", "k2", "p1", "p2", "k3"];

fn unit(i: usize) -> &'static str {
    if i < 4 { "px" } else { "" }
}

fn parameters(c: &Calibrated) -> Vec<(String, f64, Option<f64>, String)> {
    let known = c.covariance.diagonal().iter().any(|v| *v > 0.0);
    let sigma = |i: usize| known.then(|| c.covariance[(i, i)].max(0.0).sqrt());
    let mut rows: Vec<_> = c
        .camera
        .parameters()
        .iter()
        .enumerate()
        .map(|(i, v)| (NAMES[i].to_owned(), *v, sigma(i), unit(i).to_owned()))
        .collect();
    if let Some(l) = c.light.as_ref().filter(|l| l.travels) {
        // The covariance of the light planes is zero in the paper's way: not known there.
        let of_light = |i: usize| sigma(i).filter(|s| *s > 0.0);
        rows.push(("a".into(), l.model.a, of_light(11), "mm/mm".into()));
        rows.push(("b".into(), l.model.b, of_light(12), "mm".into()));
    }
    rows
}

fn views(c: &Calibrated) -> Vec<BoardView> {
    let (columns, rows) = (c.board.columns, c.board.rows);
    let ends = [0, columns - 1, columns * rows - 1, columns * (rows - 1)];
    c.views
        .iter()
        .zip(&c.corners)
        .zip(c.zhang.poses.iter().zip(&c.zhang.view_rms_px))
        .map(|((name, corners), (pose, rms))| BoardView {
            name: name.clone(),
            rms_px: *rms,
            corners: corners.iter().map(|k| [k.pixel.x, k.pixel.y]).collect(),
            residuals: corners
                .iter()
                .enumerate()
                .map(|(i, k)| {
                    let drawn = c.zhang.camera.project(&pose.apply(&c.board.point(i)));
                    drawn.map_or([0.0; 2], |p| [k.pixel.x - p.x, k.pixel.y - p.y])
                })
                .collect(),
            outline: ends
                .iter()
                .filter_map(|&i| corners.get(i).map(|k| [k.pixel.x, k.pixel.y]))
                .collect(),
            tilt_deg: tilt(pose),
        })
        .collect()
}

/// Tilt of the board about the image's horizontal and vertical axis, degrees.
fn tilt(pose: &Pose) -> [f64; 2] {
    let n = pose.rotation * crate::geometry::Vector3::z();
    let n = if n.z < 0.0 { -n } else { n };
    [(-n.y).atan2(n.z).to_degrees(), n.x.atan2(n.z).to_degrees()]
}

fn positions(l: &Light) -> Vec<Position> {
    l.planes
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let offset = l.offsets.get(i);
            let spacing = i.checked_sub(1).and_then(|k| l.spacings.get(k));
            Position {
                slide_mm: p.slide_mm,
                normal: three(&p.plane.normal),
                fitted_mm: offset.map_or(p.plane.d, |o| o.fitted_mm),
                predicted_mm: offset.map_or(p.plane.d, |o| o.predicted_mm),
                spacing_mm: spacing.map(|s| s.distance_mm),
                travelled_mm: spacing.map(|s| s.travelled_mm),
                hold_out_mm: l.hold_out_mm.get(i).copied(),
                points: p.points,
                rms_mm: p.rms_mm,
            }
        })
        .collect()
}
