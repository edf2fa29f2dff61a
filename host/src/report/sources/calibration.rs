//! The calibration's section.

use super::three;
use crate::geometry::Pose;
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
        method: match c.method {
            Method::Ml => "maximum likelihood".into(),
            Method::Paper => "the paper's".into(),
        },
    }
}

fn parameters(c: &Calibrated) -> Vec<(String, f64, Option<f64>, String)> {
    let names = ["fx", "fy", "u0", "v0", "k1", "k2", "p1", "p2", "k3"];
    let known = c.covariance.diagonal().iter().any(|v| *v > 0.0);
    let sigma = |i: usize| known.then(|| c.covariance[(i, i)].max(0.0).sqrt());
    let mut rows: Vec<_> = c
        .camera
        .parameters()
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let unit = if i < 4 { "px" } else { "" };
            (names[i].to_owned(), *v, sigma(i), unit.to_owned())
        })
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
