//! Needle, verdict and turnable view.

use super::three;
use crate::cloud::CloudPoint;
use crate::geometry::{Camera, Point3, Vector2, Vector3, tangent_basis};
use crate::needle::Decision;
use crate::pipeline::{Measurement, Scanned};
use crate::report::model::{Frame, Needle, Scene, SceneNeedle};

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
        bend_mm: d.bend_mm,
        turned: d.turned.map(|(radius, angle)| (radius, angle.to_degrees())),
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

/// Distance between neighbouring points along a stripe: the median over the cloud, mm.
fn spacing(cloud: &[CloudPoint]) -> f64 {
    let pairs = cloud.windows(2).filter_map(|w| match w {
        [p, q] if p.frame == q.frame => Some((p.position - q.position).norm()),
        _ => None,
    });
    let mut apart: Vec<f64> = pairs.collect();
    apart.sort_by(f64::total_cmp);
    apart.get(apart.len() / 2).copied().unwrap_or(0.3)
}

/// The cloud alone.
fn cloud(points: &[CloudPoint]) -> Scene {
    let every = points.len().div_ceil(MOST_POINTS).max(1);
    let kept = || points.iter().step_by(every);
    let brightest = kept().map(|p| p.intensity).fold(1.0f32, f32::max);
    Scene {
        points: kept()
            .map(|p| three(&p.position.coords).map(|x| x as f32))
            .collect(),
        brightness: kept()
            .map(|p| (255.0 * p.intensity / brightest).clamp(0.0, 255.0) as u8)
            .collect(),
        point_size_mm: spacing(points) * (every as f64).sqrt(),
        ..Scene::default()
    }
}

/// A circle about `centre` at right angles to `normal`.
pub(super) fn circle(centre: &Point3, normal: &Vector3, radius: f64) -> Vec<Point3> {
    let basis = tangent_basis(normal);
    (0..72)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * 5.0).to_radians().sin_cos();
            centre + basis.column(0) * (radius * cos) + basis.column(1) * (radius * sin)
        })
        .collect()
}

/// Where the ray of a pixel comes to the depth of the cloud around it, the nearer points counting
/// more; `None` for an empty cloud.
pub(super) fn at_cloud(s: &Scanned, pixel: &Vector2, camera: &Camera) -> Option<Point3> {
    let (mut sum, mut depth) = (0.0, 0.0);
    for p in &s.cloud {
        let weight = 1.0 / ((p.pixel - pixel).norm_squared() + 1.0).powi(2);
        sum += weight;
        depth += weight * p.position.z;
    }
    let ray = camera.ray(pixel)?;
    (sum > 0.0).then(|| Point3::from(ray * (depth / sum)))
}

/// The turnable view of a hand for which no angle is given: the cloud, where the entry pixel and
/// the vein's look through it, and the region that was asked for.
pub fn scene_refused(s: &Scanned, camera: &Camera) -> Option<Scene> {
    let entry = at_cloud(s, &s.request.pixel, camera)?;
    let sight = entry.coords.normalize();
    let r = s.request.radius_mm;
    let along = |k: f64| three(&(entry.coords + sight * (k * r)));
    let vein = s.request.vein.iter();
    let vein = vein.filter_map(|p| Some(three(&(camera.ray(p)? * entry.z))));
    Some(Scene {
        vein: vein.collect(),
        region: circle(&entry, &sight, r)
            .iter()
            .map(|p| three(&p.coords))
            .collect(),
        sight: Some([along(-2.0), along(1.0)]),
        focus: three(&entry.coords),
        // From above and a little from the side, as the camera looks.
        view: [0.5, 0.35, -0.8],
        up: [0.0, -1.0, 0.0],
        radius_mm: r,
        ..cloud(&s.cloud)
    })
}

/// The turnable view.
pub fn scene(m: &Measurement) -> Scene {
    let d = &m.decision;
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
        region: circle(&centre, &d.plane.normal, r)
            .iter()
            .map(|p| three(&p.coords))
            .collect(),
        focus: three(&d.entry.coords),
        // From the side, so that the needle's angle to the plane is seen, and from above.
        view: three(&(side * 0.8 - d.plane.normal * 0.6)),
        up: three(&-d.plane.normal),
        radius_mm: r,
        ..cloud(&m.cloud)
    }
}
