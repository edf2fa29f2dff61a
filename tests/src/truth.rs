//! truth.json of a rendered recording, and errors against it, computed apart from the code under
//! test.

use cannula::session::{Manifest, Session};
use nalgebra::{Point3, Vector3};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A recording that is part of the repository.
pub fn committed(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data")
        .join(name)
}

/// A committed recording's session.json, its images named by their full paths.
pub fn manifest(name: &str) -> Manifest {
    let folder = committed(name);
    let mut m = Session::open(&folder).expect("a sound recording").manifest;
    let whole = |name: &mut String| *name = folder.join(&*name).display().to_string();
    m.camera.iter_mut().for_each(|c| whole(&mut c.image));
    for pose in &mut m.light {
        pose.off.iter_mut().for_each(whole);
        pose.on.iter_mut().for_each(|f| whole(&mut f.image));
    }
    if let Some(scan) = &mut m.scan {
        scan.ambient.iter_mut().for_each(whole);
        scan.frames.iter_mut().for_each(|f| whole(&mut f.image));
    }
    m
}

/// A recording of the collection beside the workspace, if that is there; says so in a word if not.
pub fn beside(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared/sessions")
        .join(name);
    // A worktree lies one folder deeper.
    let deeper = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/sessions")
        .join(name);
    let found = [path, deeper]
        .into_iter()
        .find(|p| p.join("session.json").exists());
    if found.is_none() {
        println!("skipped");
    }
    found
}

/// What a rendered recording is known to show.
pub struct Truth {
    value: Value,
}

/// Angle between two directions, degrees.
pub fn degrees(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

/// Three numbers of a JSON array.
pub fn three(value: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| value[i].as_f64().expect("a number"))
}

impl Truth {
    /// Reads truth.json of a recording.
    pub fn read(folder: &Path) -> Self {
        let text = std::fs::read(folder.join("truth.json")).expect("truth.json is there");
        Self {
            value: serde_json::from_slice(&text).expect("truth.json is JSON"),
        }
    }

    fn number(&self, pointer: &str) -> f64 {
        let found = self.value.pointer(pointer).and_then(Value::as_f64);
        found.unwrap_or_else(|| panic!("{pointer} is a number"))
    }

    /// fx.
    pub fn fx(&self) -> f64 {
        self.number("/camera/fx")
    }

    /// The hand plane's normal.
    pub fn normal(&self) -> Vector3<f64> {
        three(&self.value["plane"]["normal"])
    }

    /// The entry point, mm.
    pub fn entry(&self) -> Vector3<f64> {
        three(&self.value["entry"]["point_mm"])
    }

    /// The vein's direction in the plane.
    pub fn vein(&self) -> Vector3<f64> {
        three(&self.value["vein"]["direction"])
    }

    /// The needle's axis at an angle to the plane.
    pub fn axis(&self, angle_deg: f64) -> Vector3<f64> {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        self.vein() * cos + self.normal() * sin
    }

    /// Mean distance, over the measuring volume (z 400–460 mm), between true light planes and those
    /// of a calibration (its JSON), mm.
    pub fn light_plane_error(&self, light: &Value) -> f64 {
        let n = three(&light["normal"]);
        let (a, b) = (
            light["a"].as_f64().expect("a"),
            light["b"].as_f64().expect("b"),
        );
        self.planes_error(|x| Some((n, a * x + b)))
    }

    /// The same for the planes (normal and D) of those positions that have one.
    pub fn planes_error(&self, plane: impl Fn(f64) -> Option<(Vector3<f64>, f64)>) -> f64 {
        let truth = three(&self.value["light"]["normal"]);
        let (mut sum, mut count) = (0.0, 0.0);
        for position in self.value["light"]["positions"]
            .as_array()
            .expect("positions")
        {
            let x = position["slide_mm"].as_f64().expect("slide");
            let Some((n, offset)) = plane(x) else {
                continue;
            };
            let d = position["D"].as_f64().expect("D");
            for z in [400.0, 415.0, 430.0, 445.0, 460.0] {
                for u in [-40.0, -20.0, 0.0, 20.0, 40.0] {
                    let v = -(truth.x * u + truth.z * z + d) / truth.y;
                    if v.abs() < 45.0 {
                        sum += (n.dot(&Vector3::new(u, v, z)) + offset).abs();
                        count += 1.0;
                    }
                }
            }
        }
        assert!(count > 0.0, "a plane to compare");
        sum / count
    }

    /// Points of the true surface under the true stripes, frame by frame: the pixel's ray, with the
    /// distortion undone by fixed-point iteration, meets the plane where the sheet really was.
    pub fn surface(&self) -> Vec<Vec<Point3<f64>>> {
        let c = |k: &str| self.number(&format!("/camera/{k}"));
        let d = |k: &str| self.number(&format!("/camera/distortion/{k}"));
        let (fx, fy, u0, v0) = (c("fx"), c("fy"), c("u0"), c("v0"));
        let (k1, k2, k3, p1, p2) = (d("k1"), d("k2"), d("k3"), d("p1"), d("p2"));
        let n = three(&self.value["light"]["normal"]);
        let frames = self.value["scan"].as_array().expect("scan");
        frames
            .iter()
            .map(|frame| {
                let offset = frame["D_actual"].as_f64().expect("D_actual");
                let stripe = frame["v"].as_array().expect("v").iter().enumerate();
                stripe
                    .filter_map(|(u, v)| Some((u as f64, v.as_f64()?)))
                    .map(|(u, v)| {
                        let (xd, yd) = ((u - u0) / fx, (v - v0) / fy);
                        let (mut x, mut y) = (xd, yd);
                        for _ in 0..60 {
                            let r = x * x + y * y;
                            let radial = 1.0 + r * (k1 + r * (k2 + r * k3));
                            let dx = 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x);
                            let dy = p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y;
                            (x, y) = ((xd - dx) / radial, (yd - dy) / radial);
                        }
                        let z = -offset / (n.x * x + n.y * y + n.z);
                        Point3::new(x * z, y * z, z)
                    })
                    .collect()
            })
            .collect()
    }
}
