//! What a scene truly holds, in the form of truth.json (cannula-truth/1), computed from the
//! scene's equations and not from its images.

use super::hand::TENDONS;
use super::render::Renderer;
use super::scene::Scene;
use crate::geometry::{Matrix3, Plane, Point3, Pose, Vector2, Vector3};
use crate::session;
use serde_json::{Value, json};

/// Radius of the region about the entry to which the plane is fitted, mm.
pub const RADIUS_MM: f64 = 12.0;
/// Spacing of the grid of surface points that the true plane is fitted to, mm.
const GRID_MM: f64 = 0.1;

/// The answer: what the pipeline should find on the hand.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The entry pixel and the vein, as a vein-imaging stage would give them.
    pub entry: session::Entry,
    /// Where the entry pixel's ray meets the skin, mm.
    pub point: Point3,
    /// The plane fitted to the skin within 12 mm, each part weighted by its area.
    pub plane: Plane,
    /// Its residual, mm.
    pub plane_rms_mm: f64,
    /// Where the vein pixels' rays meet the skin.
    pub vein_points: Vec<Point3>,
    /// The vein's direction laid into the plane.
    pub vein: Vector3,
    /// The same from the rays' points on the plane.
    pub vein_by_plane: Vector3,
}

impl Truth {
    /// The answer for a scene; `None` if its hand does not show.
    pub fn new(scene: &Scene) -> Option<Self> {
        let hand = &scene.hand;
        let vein = *hand.ridges.get(TENDONS)?;
        let on_vein = |q: f64| {
            let dq = q - vein[1];
            let p = vein[0] + dq * (vein[2] + vein[3] * dq);
            hand.camera(&Vector3::new(p, q, hand.height(p, q).h))
        };
        let rounded = |p: &Point3| {
            let pixel = scene.camera.project(p)?;
            Some([
                (pixel.x * 100.0).round() / 100.0,
                (pixel.y * 100.0).round() / 100.0,
            ])
        };
        let pixels: Vec<[f64; 2]> = [-4.4, -2.2, 0.0, 2.2, 4.4]
            .iter()
            .map(|dq| rounded(&on_vein(2.0 + dq)))
            .collect::<Option<_>>()?;
        let meet = |pixel: &[f64; 2]| {
            let ray = scene.camera.ray(&Vector2::new(pixel[0], pixel[1]))?;
            Some(Point3::from(ray * hand.meet(&ray, hand.origin.z)?.0))
        };
        let point = meet(&pixels[2])?;
        let (plane, plane_rms_mm) = region_plane(scene, &point)?;
        let vein_points: Vec<Point3> = pixels.iter().map(meet).collect::<Option<_>>()?;
        let on_plane: Vec<Point3> = pixels
            .iter()
            .map(|p| plane.meet(&scene.camera.ray(&Vector2::new(p[0], p[1]))?))
            .collect::<Option<_>>()?;
        let into_plane = |d: Vector3| (d - plane.normal * plane.normal.dot(&d)).normalize();
        Some(Self {
            point,
            plane,
            plane_rms_mm,
            vein: into_plane(direction(&vein_points)),
            vein_by_plane: into_plane(direction(&on_plane)),
            vein_points,
            entry: session::Entry {
                pixel: pixels[2],
                vein: pixels,
                radius_mm: RADIUS_MM,
            },
        })
    }

    /// The needle's axis for an angle to the plane, radians: along the vein and into the hand.
    pub fn needle(&self, angle: f64) -> Vector3 {
        self.vein * angle.cos() + self.plane.normal * angle.sin()
    }
}

/// Direction of the line through points, from the first towards the last.
fn direction(points: &[Point3]) -> Vector3 {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3>() / points.len() as f64;
    let scatter: Matrix3 = points
        .iter()
        .map(|p| (p.coords - mean) * (p.coords - mean).transpose())
        .sum();
    let eigen = scatter.symmetric_eigen();
    let d: Vector3 = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imax())
        .into_owned();
    match (points.first(), points.last()) {
        (Some(a), Some(b)) if d.dot(&(b - a)) < 0.0 => -d,
        _ => d,
    }
}

/// Orthogonal least squares on a fine grid of the skin about a point, weighted by area.
fn region_plane(scene: &Scene, point: &Point3) -> Option<(Plane, f64)> {
    let hand = &scene.hand;
    let centre = hand.local(point);
    let n = (RADIUS_MM / GRID_MM).ceil() as i64;
    let mut points: Vec<(f64, Vector3)> = Vec::new();
    for i in -n..=n {
        for j in -n..=n {
            let (p, q) = (centre.x + i as f64 * GRID_MM, centre.y + j as f64 * GRID_MM);
            let s = hand.height(p, q);
            let place = hand.camera(&Vector3::new(p, q, s.h));
            if hand.covers(p, q) && (place - point).norm() <= RADIUS_MM {
                let area = (1.0 + s.by_p * s.by_p + s.by_q * s.by_q).sqrt();
                points.push((area, place.coords));
            }
        }
    }
    let total: f64 = points.iter().map(|(w, _)| w).sum();
    let mean = points.iter().map(|(w, p)| p * *w).sum::<Vector3>() / total;
    let scatter: Matrix3 = points
        .iter()
        .map(|(w, p)| (p - mean) * (p - mean).transpose() * *w)
        .sum();
    let (plane, eigenvalues) = Plane::from_scatter(&mean.into(), &scatter)?;
    Some((plane, (eigenvalues[0].max(0.0) / total).sqrt()))
}

/// The middle of the laser's line on the skin for every image column: where the light plane meets
/// the skin, as a row (sub-pixel); `None` where it does not.
pub fn scan_stripe(renderer: &Renderer, plane: &Plane) -> Vec<Option<f64>> {
    let scene = renderer.scene();
    let (hand, rays) = (&scene.hand, renderer.rays());
    let distance = |u: usize, v: f64, guess: f64| {
        let ray = scene.camera.ray(&Vector2::new(u as f64, v))?;
        let (z, ..) = hand.meet(&ray, guess)?;
        Some((plane.normal.dot(&ray) * z + plane.d, z))
    };
    (0..rays.width())
        .map(|u| {
            let mut before: Option<f64> = None;
            let mut guess = hand.origin.z;
            for v in 0..rays.height() {
                let ray = rays.at(u, v);
                // Far from the hand no ray need be traced.
                let here = hand.meet(&ray, guess).map(|(z, ..)| {
                    guess = z;
                    plane.normal.dot(&ray) * z + plane.d
                });
                if let (Some(a), Some(b)) = (before, here)
                    && (a <= 0.0) != (b <= 0.0)
                {
                    return refine(
                        |v| distance(u, v, guess).map(|d| d.0),
                        v as f64 - 1.0,
                        v as f64,
                    );
                }
                before = here;
            }
            None
        })
        .collect()
}

/// A root between two places, by bisection to 1e-6.
fn refine(f: impl Fn(f64) -> Option<f64>, mut low: f64, mut high: f64) -> Option<f64> {
    let sign = f(low)? <= 0.0;
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if (f(middle)? <= 0.0) == sign {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}

/// One frame with the laser on: nominal slide position and where the sheet truly was.
#[derive(Clone, Copy, Debug)]
pub struct Lit {
    /// By the steps, mm.
    pub slide_mm: f64,
    /// D of the true plane, mm.
    pub d: f64,
}

/// What was recorded, by image name, for truth.json.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Board images for the camera.
    pub camera: Vec<(String, Pose)>,
    /// Board poses for the light planes, with their off images.
    pub light: Vec<(String, Pose, Vec<Lit>)>,
    /// Scan frames.
    pub scan: Vec<Lit>,
}

/// truth.json.
pub fn to_json(renderer: &Renderer, truth: &Truth, recorded: &Recorded) -> Value {
    let scene = renderer.scene();
    let (camera, laser, hand) = (&scene.camera, &scene.laser, &scene.hand);
    let d = &camera.distortion;
    let rows = |m: &Matrix3| -> Vec<[f64; 3]> {
        (0..3).map(|i| [m[(i, 0)], m[(i, 1)], m[(i, 2)]]).collect()
    };
    let v3 = |v: &Vector3| [v.x, v.y, v.z];
    let round = |x: f64, n: f64| (x * n).round() / n;
    let corners = |pose: &Pose| -> Vec<Option<[f64; 2]>> {
        (0..scene.board.corners())
            .map(|i| {
                let p = camera.project(&pose.apply(&scene.board.point(i)))?;
                Some([round(p.x, 1e5), round(p.y, 1e5)])
            })
            .collect()
    };
    let pose = |p: &Pose| (rows(p.rotation.matrix()), v3(&p.translation), corners(p));
    let normal = truth.plane.normal;
    let positions: Vec<Value> = scene
        .light_positions()
        .iter()
        .map(|&x| json!({ "slide_mm": x, "D": laser.plane(x).d }))
        .collect();
    let camera_images: Vec<Value> = recorded
        .camera
        .iter()
        .map(|(image, p)| {
            let (r, t, corners) = pose(p);
            json!({ "image": image, "R": r, "t": t, "corners": corners })
        })
        .collect();
    let light_poses: Vec<Value> = recorded
        .light
        .iter()
        .map(|(off, p, on)| {
            let (r, t, corners) = pose(p);
            let on: Vec<Value> = on
                .iter()
                .map(|l| json!({ "slide_mm": l.slide_mm, "D_actual": l.d }))
                .collect();
            json!({ "off": off, "R": r, "t": t, "corners": corners, "on": on })
        })
        .collect();
    let scan: Vec<Value> = recorded
        .scan
        .iter()
        .map(|l| {
            let plane = Plane {
                normal: laser.model.normal,
                d: l.d,
            };
            let v: Vec<Option<f64>> = scan_stripe(renderer, &plane)
                .into_iter()
                .map(|v| v.map(|v| round(v, 1e4)))
                .collect();
            json!({ "slide_mm": l.slide_mm, "D_actual": l.d, "v": v })
        })
        .collect();
    json!({
        "format": "cannula-truth/1",
        "seed": scene.seed,
        "profile": scene.profile.name(),
        "psf_px": scene.psf_px,
        "camera": {
            "width": camera.width, "height": camera.height,
            "fx": camera.fx, "fy": camera.fy, "u0": camera.u0, "v0": camera.v0,
            "distortion": { "k1": d.k1, "k2": d.k2, "p1": d.p1, "p2": d.p2, "k3": d.k3 },
        },
        "light": {
            "normal": v3(&laser.model.normal), "a": laser.model.a, "b": laser.model.b,
            "width_1e2_mm": laser.width_1e2_mm, "travel": v3(&laser.travel), "screw": laser.screw,
            "positions": positions,
        },
        "camera_images": camera_images,
        "light_poses": light_poses,
        "hand": {
            "origin": v3(&hand.origin.coords), "axes": rows(&hand.axes),
            "half_p": hand.half_p, "half_q": hand.half_q,
            "radius_p": hand.radius_p, "radius_q": hand.radius_q, "rolloff": hand.rolloff,
            "knuckles": hand.knuckles, "ridges": hand.ridges, "relief": hand.relief,
            "table_normal": v3(&hand.table.normal), "table_d": hand.table.d,
        },
        "scan": scan,
        "entry": {
            "pixel": truth.entry.pixel, "point_mm": v3(&truth.point.coords), "radius_mm": RADIUS_MM,
        },
        "plane": {
            "normal": v3(&normal), "d": truth.plane.d,
            "a": -normal.x / normal.z, "b": -normal.y / normal.z, "c": -truth.plane.d / normal.z,
            "rms_mm": truth.plane_rms_mm,
        },
        "vein": {
            "direction": v3(&truth.vein),
            "points_mm": truth.vein_points.iter().map(|p| v3(&p.coords)).collect::<Vec<_>>(),
            "direction_by_plane": v3(&truth.vein_by_plane),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Profile;

    /// A recording made by another program, with its own truth: the same hand must give the same
    /// stripes in our scene.
    #[test]
    fn stripes_of_a_given_recording_come_out_alike() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let path = root.join("../shared/sessions/nominal-1001/truth.json");
        let Ok(text) = std::fs::read(path) else {
            println!("skipped");
            return;
        };
        let t: Value = serde_json::from_slice(&text).unwrap();
        let get = |v: &Value| v.as_f64().unwrap();
        let list = |v: &Value| v.as_array().unwrap().iter().map(get).collect::<Vec<f64>>();
        let v3 = |v: &Value| Vector3::from_column_slice(&list(v));
        let (c, d) = (&t["camera"], &t["camera"]["distortion"]);
        let mut scene = Scene::new(Profile::Tiny, 1);
        scene.camera = scene.camera.with_parameters(
            &[
                &c["fx"], &c["fy"], &c["u0"], &c["v0"], &d["k1"], &d["k2"], &d["p1"], &d["p2"],
                &d["k3"],
            ]
            .map(get),
        );
        scene.camera.width = get(&c["width"]) as u32;
        scene.camera.height = get(&c["height"]) as u32;
        let h = &t["hand"];
        let hand = &mut scene.hand;
        hand.origin = v3(&h["origin"]).into();
        hand.axes = Matrix3::from_rows(&[0, 1, 2].map(|i| v3(&h["axes"][i]).transpose()));
        hand.half_p = get(&h["half_p"]);
        hand.half_q = get(&h["half_q"]);
        hand.radius_p = get(&h["radius_p"]);
        hand.radius_q = get(&h["radius_q"]);
        hand.rolloff = get(&h["rolloff"]);
        let rows = |v: &Value| v.as_array().unwrap().iter().map(list).collect::<Vec<_>>();
        hand.knuckles = rows(&h["knuckles"])
            .iter()
            .map(|k| [k[0], k[1], k[2], k[3]])
            .collect();
        hand.ridges = rows(&h["ridges"])
            .iter()
            .map(|r| [r[0], r[1], r[2], r[3], r[4], r[5]])
            .collect();
        hand.relief = rows(&h["relief"])
            .iter()
            .map(|k| [k[0], k[1], k[2], k[3]])
            .collect();
        let normal = v3(&t["light"]["normal"]);
        let renderer = Renderer::new(scene).unwrap();
        let (mut compared, mut missing) = (0, 0);
        for frame in t["scan"].as_array().unwrap().iter().step_by(5) {
            let ours = scan_stripe(
                &renderer,
                &Plane {
                    normal,
                    d: get(&frame["D_actual"]),
                },
            );
            for (ours, theirs) in ours.iter().zip(frame["v"].as_array().unwrap()) {
                match (ours, theirs.as_f64()) {
                    (Some(a), Some(b)) => {
                        assert!((a - b).abs() < 2e-3, "{a} against {b}");
                        compared += 1;
                    }
                    (None, None) => {}
                    _ => missing += 1,
                }
            }
        }
        assert!(
            compared > 300 && missing < compared / 20,
            "{compared} {missing}"
        );
        // The entry point and the plane about it.
        let point = Point3::from(v3(&t["entry"]["point_mm"]));
        let (plane, rms) = region_plane(renderer.scene(), &point).unwrap();
        let angle = plane
            .normal
            .cross(&v3(&t["plane"]["normal"]))
            .norm()
            .to_degrees();
        assert!(angle < 0.01, "{angle}°");
        assert!((rms - get(&t["plane"]["rms_mm"])).abs() < 0.003, "{rms}");
    }

    #[test]
    fn the_stripe_lies_on_light_plane_and_skin() {
        let scene = Scene::new(Profile::Tiny, 3);
        let renderer = Renderer::new(scene).unwrap();
        let scene = renderer.scene();
        let plane = scene.laser.plane(24.0);
        let stripe = scan_stripe(&renderer, &plane);
        assert!(stripe.iter().flatten().count() > 60);
        for (u, v) in stripe
            .iter()
            .enumerate()
            .filter_map(|(u, v)| v.map(|v| (u, v)))
        {
            let ray = scene.camera.ray(&Vector2::new(u as f64, v)).unwrap();
            let p = plane.meet(&ray).unwrap();
            let l = scene.hand.local(&p);
            assert!((l.z - scene.hand.height(l.x, l.y).h).abs() < 1e-4);
        }
    }
}
