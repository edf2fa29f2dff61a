//! Needle, verdict and turnable view.

use super::three;
use crate::geometry::{Point3, Vector3, tangent_basis};
use crate::needle::Decision;
use crate::pipeline::Measurement;
use crate::report::model::{Frame, Needle, Scene, SceneNeedle, Verdict};

/// Radius of the needle in the view, mm: 22G.
const NEEDLE_RADIUS_MM: f64 = 0.36;

/// Most points in the view; a larger cloud is thinned evenly.
const MOST_POINTS: usize = 100_000;

/// The needle's figures; `robot` is the session's `robot_from_camera`.
pub fn needle(m: &Measurement, angle_source: &str, robot: Option<&[[f64; 4]; 4]>) -> Needle {
    let d = &m.decision;
    let u = &d.uncertainty;
    let mut frames = vec![frame("camera", d, &|p| *p, &|v| *v)];
    if let Some(t) = robot {
        let turn =
            |v: &Vector3| Vector3::from_fn(|i, _| t[i][0] * v.x + t[i][1] * v.y + t[i][2] * v.z);
        let place =
            |p: &Point3| Point3::from(turn(&p.coords) + Vector3::new(t[0][3], t[1][3], t[2][3]));
        frames.push(frame("robot", d, &place, &turn));
    }
    Needle {
        angle_deg: d.needle.angle.to_degrees(),
        angle_sigma_deg: u.angle_sigma.to_degrees(),
        angle_source: angle_source.to_owned(),
        entry_sigma_mm: Some([0, 1, 2].map(|i| u.entry[(i, i)].max(0.0).sqrt())),
        axis_sigma_deg: Some(u.axis_sigma().to_degrees()),
        region_points: d.points,
        region_rms_mm: d.rms_mm,
        radius_mm: m.request.radius_mm,
        frames,
    }
}

fn frame(
    name: &str,
    d: &Decision,
    place: &dyn Fn(&Point3) -> Point3,
    turn: &dyn Fn(&Vector3) -> Vector3,
) -> Frame {
    Frame {
        name: name.to_owned(),
        entry_mm: three(&place(&d.entry).coords),
        normal: three(&turn(&d.plane.normal)),
        vein: three(&turn(&d.direction)),
        axis: three(&turn(&d.needle.axis)),
    }
}

/// A measurement that stands was not refused; its warnings (the calibration's among them) are what
/// is weak.
pub fn verdict(m: &Measurement) -> Verdict {
    Verdict {
        usable: true,
        reasons: Vec::new(),
        warnings: m.warnings.clone(),
    }
}

/// Distance between neighbouring points along a stripe: the median over the cloud, mm.
fn spacing(m: &Measurement) -> f64 {
    let pairs = m.cloud.windows(2).filter_map(|w| match w {
        [p, q] if p.frame == q.frame => Some((p.position - q.position).norm()),
        _ => None,
    });
    let mut apart: Vec<f64> = pairs.collect();
    apart.sort_by(f64::total_cmp);
    apart.get(apart.len() / 2).copied().unwrap_or(0.3)
}

/// The turnable view.
pub fn scene(m: &Measurement) -> Scene {
    let d = &m.decision;
    let every = m.cloud.len().div_ceil(MOST_POINTS).max(1);
    let kept = || m.cloud.iter().step_by(every);
    let brightest = kept().map(|p| p.intensity).fold(1.0f32, f32::max);
    let basis = tangent_basis(&d.plane.normal);
    let on_plane = |p: &Point3| p - d.plane.normal * d.plane.distance(p);
    let centre = on_plane(&d.entry);
    let r = m.request.radius_mm;
    let corner = |s: f64, t: f64| {
        three(&(centre + basis.column(0) * (s * r) + basis.column(1) * (t * r)).coords)
    };
    // Of the two sides of the section plane, the one that the camera is nearer to.
    let across = d.direction.cross(&d.plane.normal);
    let side = if across.z > 0.0 { -across } else { across };
    let path = &d.needle.path;
    // The section plane holds vein and normal: drawn from above the entry to under the vein.
    let along = d.direction * r;
    let up = -d.plane.normal * (0.6 * r);
    let down = d.plane.normal * (0.5 * r);
    Scene {
        points: kept()
            .map(|p| {
                [
                    p.position.x as f32,
                    p.position.y as f32,
                    p.position.z as f32,
                ]
            })
            .collect(),
        brightness: kept()
            .map(|p| (255.0 * p.intensity / brightest).clamp(0.0, 255.0) as u8)
            .collect(),
        point_size_mm: spacing(m) * (every as f64).sqrt(),
        plane: Some([
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ]),
        section: Some([
            three(&(d.entry - along + up).coords),
            three(&(d.entry + along + up).coords),
            three(&(d.entry + along + down).coords),
            three(&(d.entry - along + down).coords),
        ]),
        vein: d.vein.iter().map(|p| three(&p.coords)).collect(),
        needle: Some(SceneNeedle {
            from: three(&path.start.coords),
            entry: three(&path.entry.coords),
            to: three(&path.end.coords),
            radius: NEEDLE_RADIUS_MM,
        }),
        focus: three(&d.entry.coords),
        reach_mm: 2.2 * r,
        // From the side, so that the needle's angle to the plane is seen, and from above.
        view: three(&(side * 0.8 - d.plane.normal * 0.6)),
        up: three(&-d.plane.normal),
        radius_mm: r,
    }
}
