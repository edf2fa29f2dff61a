//! The extractors on recordings whose true centres are known.

use super::super::hand::{self, HandSettings, Surface};
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
        }
    }
}
