//! The extractors on recordings whose true centres are known.

use super::super::StripeError;
use super::super::board;
use super::super::hand::{self, HandSettings, Surface};
use crate::geometry::{Camera, Distortion, Point3, Vector2, Vector3};
use crate::image::Image;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The recordings at hand: the shared ones where they exist, the project's own small one.
fn sessions() -> Vec<PathBuf> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found: Vec<PathBuf> = std::fs::read_dir(top.join("../../shared/sessions"))
        .or_else(|_| std::fs::read_dir(top.join("../shared/sessions")))
        .map(|all| all.flatten().map(|e| e.path()).collect())
        .unwrap_or_default();
    if found.is_empty() {
        println!("skipped");
    }
    found.push(top.join("tests/data/tiny-1001"));
    found.retain(|p| p.join("truth.json").exists());
    found.sort();
    found
}

fn read(path: &Path) -> Image<u8> {
    let image = image::open(path).unwrap().into_luma8();
    let (w, h) = image.dimensions();
    Image::from_vec(w as usize, h as usize, image.into_raw()).unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Errors of extracted points, px, and how far they are from what was claimed.
#[derive(Default)]
struct Score {
    errors: Vec<f64>,
    normalised: Vec<f64>,
    spurious: usize,
    missed: usize,
}

impl Score {
    fn rms(&self) -> f64 {
        (self.errors.iter().map(|e| e * e).sum::<f64>() / self.errors.len() as f64).sqrt()
    }
    fn worst(&self) -> f64 {
        self.errors.iter().fold(0.0, |a, e| a.max(e.abs()))
    }
    fn normalised(&self) -> f64 {
        let n = self.normalised.len() as f64;
        (self.normalised.iter().map(|e| e * e).sum::<f64>() / n).sqrt()
    }
    fn print(&self, name: &str) {
        let n = self.errors.len() as f64;
        let mut sorted: Vec<f64> = self.errors.iter().map(|e| e.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        println!(
            "{name}: {} points, rms {:.4}, mean {:+.4}, p99 {:.3}, max {:.3}, normalised {:.2}, spurious {}, missed {}",
            self.errors.len(),
            self.rms(),
            self.errors.iter().sum::<f64>() / n,
            sorted.get(sorted.len() * 99 / 100).unwrap_or(&0.0),
            sorted.last().unwrap_or(&0.0),
            (self.normalised.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            self.spurious,
            self.missed
        );
    }
}

fn hand_score(session: &Path, settings: &HandSettings, with_ambient: bool) -> Score {
    let truth = json(&session.join("truth.json"));
    let plan = json(&session.join("session.json"));
    let ambient = read(&session.join(plan["scan"]["ambient"].as_str().unwrap()));
    let mut score = Score::default();
    for (frame, t) in plan["scan"]["frames"]
        .as_array()
        .unwrap()
        .iter()
        .zip(truth["scan"].as_array().unwrap())
    {
        let image = read(&session.join(frame["image"].as_str().unwrap()));
        let segments = hand::extract(&image, with_ambient.then_some(&ambient), settings).unwrap();
        let v = t["v"].as_array().unwrap();
        let mut seen = vec![false; v.len()];
        for segment in segments.iter().filter(|s| s.surface == Surface::Hand) {
            for p in &segment.points {
                let u = p.pixel.x as usize;
                seen[u] = true;
                match v[u].as_f64() {
                    Some(v) => {
                        let e = p.pixel.y - v;
                        score.errors.push(e);
                        score.normalised.push(e / p.variance.sqrt());
                    }
                    None => score.spurious += 1,
                }
            }
        }
        score.missed += v
            .iter()
            .zip(&seen)
            .filter(|(v, s)| !v.is_null() && !**s)
            .count();
    }
    score
}

#[test]
fn centres_on_the_hand_are_true() {
    for session in sessions() {
        let name = session.file_name().unwrap().to_string_lossy().into_owned();
        for (smooth, albedo, with) in [
            (true, true, true),
            (false, true, true),
            (true, false, true),
            (true, true, false),
        ] {
            let settings = HandSettings {
                smooth,
                albedo,
                ..HandSettings::default()
            };
            let score = hand_score(&session, &settings, with);
            score.print(&format!(
                "{name} smooth {smooth} albedo {albedo} ambient {with}"
            ));
            assert_eq!(score.spurious, 0, "points on the table taken for the hand");
            let normalised = score.normalised();
            if with {
                // A centroid has 0.09 px on these recordings.
                let limit = if smooth { 0.06 } else { 0.09 };
                assert!(score.rms() < limit, "{}", score.rms());
                assert!(score.worst() < 0.5, "{}", score.worst());
                assert!((0.7..1.4).contains(&normalised), "{normalised}");
            } else {
                assert!(score.rms() < 0.1 && score.worst() < 1.5);
            }
        }
    }
}

/// The stripe that a light plane draws on the board: points of the line, in pixels.
fn true_line(truth: &Value, pose: &Value, d: f64) -> Vec<Vector2> {
    let number = |v: &Value, k: &str| v[k].as_f64().unwrap();
    let c = &truth["camera"];
    let k = &c["distortion"];
    let camera = Camera {
        width: c["width"].as_u64().unwrap() as _,
        height: c["height"].as_u64().unwrap() as _,
        fx: number(c, "fx"),
        fy: number(c, "fy"),
        u0: number(c, "u0"),
        v0: number(c, "v0"),
        distortion: Distortion {
            k1: number(k, "k1"),
            k2: number(k, "k2"),
            p1: number(k, "p1"),
            p2: number(k, "p2"),
            k3: number(k, "k3"),
        },
    };
    let vector = |v: &Value| Vector3::from_fn(|i, _| v[i].as_f64().unwrap());
    let n = vector(&truth["light"]["normal"]);
    let r = nalgebra::Matrix3::from_fn(|i, j| pose["R"][i][j].as_f64().unwrap());
    let t = vector(&pose["t"]);
    // n·(R p + t) + d = 0 with p = (x, y, 0).
    let (a, b) = (n.dot(&r.column(0)), n.dot(&r.column(1)));
    let e = n.dot(&t) + d;
    let norm = a * a + b * b;
    (-3000..3000)
        .filter_map(|i| {
            let s = 0.05 * f64::from(i) / norm.sqrt();
            let p = Vector3::new(-a * e / norm - b * s, -b * e / norm + a * s, 0.0);
            camera.project(&Point3::from(r * p + t))
        })
        .collect()
}

/// Row of the line in column u (interpolated between its points).
fn row_at(line: &[Vector2], u: f64) -> Option<f64> {
    line.windows(2)
        .find(|w| (w[0].x - u) * (w[1].x - u) <= 0.0 && w[0].x != w[1].x)
        .map(|w| w[0].y + (w[1].y - w[0].y) * (u - w[0].x) / (w[1].x - w[0].x))
}

fn board_score(session: &Path, with_off: bool) -> (Score, Vec<f64>, [Score; 2]) {
    let truth = json(&session.join("truth.json"));
    let plan = json(&session.join("session.json"));
    let mut score = Score::default();
    let mut means = Vec::new();
    let mut classes = [Score::default(), Score::default()];
    let poses = truth["light_poses"].as_array().unwrap();
    for (view, pose) in plan["light"].as_array().unwrap().iter().zip(poses) {
        let off = read(&session.join(view["off"].as_str().unwrap()));
        let corners: Vec<Vector2> = pose["corners"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| Vector2::new(c[0].as_f64().unwrap(), c[1].as_f64().unwrap()))
            .collect();
        let all = view["on"].as_array().unwrap();
        for (on, t) in all.iter().zip(pose["on"].as_array().unwrap()) {
            let image = read(&session.join(on["image"].as_str().unwrap()));
            let line = true_line(&truth, pose, t["D_actual"].as_f64().unwrap());
            let found = board::extract(&image, with_off.then_some(&off), &corners, 8, 6);
            let points = match found {
                Ok(points) => points,
                Err(e) => {
                    assert!(!with_off, "{} {e}", on["image"]);
                    score.missed += 1;
                    continue;
                }
            };
            let brightest = points.iter().map(|p| p.intensity).fold(0.0, f32::max);
            let (mut sum, mut weights) = (0.0, 0.0);
            for p in &points {
                let e = p.pixel.y - row_at(&line, p.pixel.x).unwrap();
                score.errors.push(e);
                score.normalised.push(e / p.variance.sqrt());
                let class = &mut classes[usize::from(p.intensity > 0.4 * brightest)];
                class.errors.push(e);
                class.normalised.push(e / p.variance.sqrt());
                sum += e / p.variance;
                weights += 1.0 / p.variance;
            }
            means.push(sum / weights);
        }
    }
    (score, means, classes)
}

#[test]
fn centres_on_the_board_are_true() {
    for session in sessions() {
        let name = session.file_name().unwrap().to_string_lossy().into_owned();
        for with_off in [true, false] {
            let (score, means, classes) = board_score(&session, with_off);
            score.print(&format!("{name} board off {with_off}"));
            classes[0].print("   black");
            classes[1].print("   white");
            let n = means.len() as f64;
            println!(
                "   stripes {n}, mean of weighted means {:+.4}, rms {:.4}, worst {:.4}",
                means.iter().sum::<f64>() / n,
                (means.iter().map(|m| m * m).sum::<f64>() / n).sqrt(),
                means.iter().fold(0.0_f64, |a, b| a.max(b.abs()))
            );
            let mean = means.iter().sum::<f64>() / n;
            if with_off {
                assert!(mean.abs() < 0.01, "{mean}");
                assert!(score.rms() < 0.12 && score.worst() < 1.0);
                let normalised = score.normalised();
                assert!((0.8..1.25).contains(&normalised), "{normalised}");
            } else if n > 0.0 {
                assert!(mean.abs() < 0.02, "{mean}");
            }
        }
    }
}

#[test]
fn swapped_missing_and_foreign_images_are_named() {
    for session in sessions() {
        let truth = json(&session.join("truth.json"));
        let off = read(&session.join("light/00/off.png"));
        let on = read(&session.join("light/00/on_03.png"));
        let corners: Vec<Vector2> = truth["light_poses"][0]["corners"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| Vector2::new(c[0].as_f64().unwrap(), c[1].as_f64().unwrap()))
            .collect();
        let run = |on: &Image<u8>, off: &Image<u8>| board::extract(on, Some(off), &corners, 8, 6);
        assert_eq!(run(&off, &on), Err(StripeError::Swapped));
        assert!(matches!(run(&off, &off), Err(StripeError::NoStripe { .. })));
        let small = Image::new(8, 8, 0_u8);
        assert!(matches!(run(&on, &small), Err(StripeError::Size { .. })));
        assert!(matches!(
            board::extract(&on, Some(&off), &corners[..40], 8, 6),
            Err(StripeError::Corners { .. })
        ));
        let ambient = read(&session.join("scan/ambient.png"));
        let frame = read(&session.join("scan/010.png"));
        let settings = HandSettings::default();
        assert_eq!(
            hand::extract(&ambient, Some(&frame), &settings),
            Err(StripeError::Swapped)
        );
        assert_eq!(
            hand::extract(&ambient, Some(&ambient), &settings),
            Ok(vec![])
        );
    }
}
