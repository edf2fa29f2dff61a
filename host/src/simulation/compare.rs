//! What was measured against what is true, in mm and degrees.

use super::scene::{Scene, TRAVEL_MM};
use super::truth::Truth;
use crate::calibration::LightModel;
use crate::geometry::{Camera, Plane, Point3, Vector2, Vector3};
use serde::Serialize;

/// What a measurement gave.
#[derive(Clone, Debug)]
pub struct Measured<'a> {
    /// The calibrated camera.
    pub camera: Camera,
    /// The calibrated light planes.
    pub light: LightModel,
    /// The plane of the entry region.
    pub plane: Plane,
    /// The entry point.
    pub entry: Point3,
    /// The vein's direction.
    pub vein: Vector3,
    /// The needle's axis, and the angle that was asked for, radians.
    pub axis: (Vector3, f64),
    /// Points on the hand.
    pub cloud: &'a [Point3],
}

/// One line of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Error {
    /// Which quantity.
    pub quantity: &'static str,
    /// How far off.
    pub error: f64,
    /// "mm", "deg" or "%".
    pub unit: &'static str,
}

/// Every error of a measurement.
pub fn errors(scene: &Scene, truth: &Truth, measured: &Measured) -> Vec<Error> {
    let line = |quantity, error, unit| Error {
        quantity,
        error,
        unit,
    };
    let angle = |a: &Vector3, b: &Vector3| a.cross(b).norm().atan2(a.dot(b)).to_degrees();
    let fx = 100.0 * (measured.camera.fx / scene.camera.fx - 1.0).abs();
    let fy = 100.0 * (measured.camera.fy / scene.camera.fy - 1.0).abs();
    let (plane_mm, plane_max) = light_planes(scene, &measured.light);
    let (cloud_rms, cloud_max) = cloud(scene, measured.cloud);
    vec![
        line("focal length", fx.max(fy), "%"),
        line("light planes, mean over the volume", plane_mm, "mm"),
        line("light planes, worst in the volume", plane_max, "mm"),
        line(
            "light planes, normal",
            angle(&measured.light.normal, &scene.laser.model.normal),
            "deg",
        ),
        line("cloud to skin, RMS", cloud_rms, "mm"),
        line("cloud to skin, worst", cloud_max, "mm"),
        line(
            "plane, normal",
            angle(&measured.plane.normal, &truth.plane.normal),
            "deg",
        ),
        line(
            "plane, at the entry",
            (measured.plane.distance(&truth.point) - truth.plane.distance(&truth.point)).abs(),
            "mm",
        ),
        line("entry point", (measured.entry - truth.point).norm(), "mm"),
        line("vein, direction", angle(&measured.vein, &truth.vein), "deg"),
        line(
            "needle, axis",
            angle(&measured.axis.0, &truth.needle(measured.axis.1)),
            "deg",
        ),
    ]
}

/// Distance of the measured light planes from the points that the true ones light up over the
/// hand's room: mean and maximum.
fn light_planes(scene: &Scene, light: &LightModel) -> (f64, f64) {
    let (mut sum, mut n, mut worst) = (0.0, 0.0, 0.0f64);
    let (w, h) = (
        f64::from(scene.camera.width),
        f64::from(scene.camera.height),
    );
    for k in 0..=12 {
        let x = TRAVEL_MM * f64::from(k) / 12.0;
        let (truth, ours) = (scene.laser.plane(x), light.plane(x));
        for i in 0..=10 {
            for j in 0..=20 {
                let pixel = Vector2::new(w * (0.25 + 0.05 * f64::from(i)), h * f64::from(j) / 20.0);
                let point = scene.camera.ray(&pixel).and_then(|ray| truth.meet(&ray));
                if let Some(p) = point.filter(|p| (395.0..480.0).contains(&p.z)) {
                    let d = ours.distance(&p).abs();
                    sum += d;
                    n += 1.0;
                    worst = worst.max(d);
                }
            }
        }
    }
    (if n > 0.0 { sum / n } else { f64::NAN }, worst)
}

/// Distance of the cloud from the skin along the skin's normal: RMS and maximum.
fn cloud(scene: &Scene, points: &[Point3]) -> (f64, f64) {
    let (mut sum, mut n, mut worst) = (0.0, 0.0, 0.0f64);
    for p in points {
        let l = scene.hand.local(p);
        if !scene.hand.covers(l.x, l.y) {
            continue;
        }
        let s = scene.hand.height(l.x, l.y);
        let d = (l.z - s.h).abs() / (1.0 + s.by_p * s.by_p + s.by_q * s.by_q).sqrt();
        sum += d * d;
        n += 1.0;
        worst = worst.max(d);
    }
    (if n > 0.0 { (sum / n).sqrt() } else { f64::NAN }, worst)
}

/// The errors as one table.
pub fn table(errors: &[Error]) -> String {
    let mut text = String::from("against the truth");
    for e in errors {
        text += &format!("\n  {:<36} {:>9.4} {}", e.quantity, e.error, e.unit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Profile;

    #[test]
    fn the_truth_has_no_error_and_a_known_error_shows() {
        let scene = Scene::new(Profile::Tiny, 4);
        let truth = Truth::new(&scene).unwrap();
        let skin: Vec<Point3> = (-10..=10)
            .map(|i| {
                let (p, q) = (f64::from(i), 0.5 * f64::from(i));
                scene
                    .hand
                    .camera(&Vector3::new(p, q, scene.hand.height(p, q).h))
            })
            .collect();
        let mut measured = Measured {
            camera: scene.camera,
            light: scene.laser.model,
            plane: truth.plane,
            entry: truth.point,
            vein: truth.vein,
            axis: (truth.needle(0.5), 0.5),
            cloud: &skin,
        };
        let exact = errors(&scene, &truth, &measured);
        for e in &exact {
            assert!(e.error.abs() < 1e-9, "{e:?}");
        }
        measured.light.b += 0.05;
        measured.entry.x += 0.3;
        let off = errors(&scene, &truth, &measured);
        assert!((off[1].error - 0.05).abs() < 1e-9 && (off[8].error - 0.3).abs() < 1e-9);
    }
}
