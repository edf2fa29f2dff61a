//! A hand in closed form for the tests: a curved sheet with tendons and veins on it, "scanned" by
//! exact geometry, so that truth is known without any of the code under test.

use super::EntryRequest;
use super::plane::Cell;
use crate::calibration::RigModel;
use crate::cloud::{CloudPoint, triangulate};
use crate::geometry::{Point3, Vector2, Vector3};
use crate::stripe::StripePoint;
use crate::synthetic::Noise;

pub struct Hand {
    origin: Point3,
    axes: [Vector3; 3],
    /// Tendons and veins: place, slope, height, width.
    ridges: Vec<[f64; 4]>,
    phase: [f64; 2],
    entry: [f64; 2],
}

impl Hand {
    pub fn new(noise: &mut Noise) -> Self {
        let normal = Vector3::new(-0.09, -0.58, -0.80).normalize();
        let p = Vector3::new(0.993, 0.009, -0.115);
        let p = (p - normal * normal.dot(&p)).normalize();
        let mut ridges = Vec::new();
        for (place, slope, height, width) in [
            (-19.0, -0.1, 0.5, 2.7),
            (14.0, 0.2, 0.45, 2.9),
            (0.0, 0.35, 0.3, 1.7),
            (-11.0, -0.25, 0.4, 1.25),
            (9.0, -0.2, 0.35, 1.2),
        ] {
            ridges.push([
                place + noise.normal(),
                slope + 0.1 * noise.normal(),
                height * (0.7 + 0.6 * noise.uniform()),
                width,
            ]);
        }
        Self {
            origin: Point3::new(1.7, -14.9, 433.7),
            axes: [p, normal.cross(&p), normal],
            ridges,
            phase: [6.0 * noise.uniform(), 6.0 * noise.uniform()],
            entry: [3.0 * noise.normal(), 3.0 * noise.normal()],
        }
    }

    /// Height and its two slopes.
    pub fn height(&self, p: f64, q: f64) -> [f64; 3] {
        let mut h = [-p * p / 176.0 - q * q / 576.0, -p / 88.0, -q / 288.0];
        for [place, slope, height, width] in &self.ridges {
            let d = (p - place - slope * q) / width;
            let g = height * (-0.5 * d * d).exp();
            h[0] += g;
            h[1] -= g * d / width;
            h[2] += g * d / width * slope;
        }
        for (k, (a, b)) in [(0.93, 0.18), (-0.47, 0.33)].into_iter().enumerate() {
            let angle = a * p + b * q + self.phase[k];
            h[0] += 0.02 * angle.sin();
            h[1] += 0.02 * a * angle.cos();
            h[2] += 0.02 * b * angle.cos();
        }
        h
    }

    pub fn point(&self, p: f64, q: f64) -> Point3 {
        let [x, y, z] = self.axes;
        self.origin + x * p + y * q + z * self.height(p, q)[0]
    }

    pub fn entry(&self) -> Point3 {
        self.point(self.entry[0], self.entry[1])
    }

    pub fn vein(&self) -> Vec<Point3> {
        (-2..=2)
            .map(|i| {
                self.point(
                    self.entry[0] + 0.7 * f64::from(i),
                    self.entry[1] + 2.2 * f64::from(i),
                )
            })
            .collect()
    }

    pub fn request(&self, rig: &RigModel) -> EntryRequest {
        let pixel = |p: &Point3| rig.camera.project(p).unwrap();
        EntryRequest {
            pixel: pixel(&self.entry()),
            vein: self.vein().iter().map(pixel).collect(),
            radius_mm: 12.0,
        }
    }

    /// The whole surface within the region, in fine pieces.
    pub fn region(&self) -> Vec<Cell> {
        const STEP: f64 = 0.12;
        let entry = self.entry();
        let mut cells = Vec::new();
        for i in -130..=130 {
            for j in -130..=130 {
                let (p, q) = (
                    self.entry[0] + f64::from(i) * STEP,
                    self.entry[1] + f64::from(j) * STEP,
                );
                let position = self.point(p, q);
                if (position - entry).norm() <= 12.0 {
                    let [_, a, b] = self.height(p, q);
                    cells.push(Cell {
                        position,
                        area: (1.0 + a * a + b * b).sqrt(),
                    });
                }
            }
        }
        cells
    }

    /// The pixels of every stripe: (slide position, pixels), a pixel apart along the stripe.
    pub fn stripes(&self, rig: &RigModel) -> Vec<(f64, Vec<Vector2>)> {
        let light = &rig.light;
        (0..=30)
            .map(|k| {
                let slide = 2.0 * f64::from(k);
                let plane = light.plane(slide);
                let mut pixels = Vec::new();
                let mut q = 0.0;
                for i in -100..=100 {
                    let p = self.entry[0] + 0.2 * f64::from(i);
                    for _ in 0..60 {
                        let miss = plane.distance(&self.point(p, q));
                        let tangent = self.axes[1] + self.axes[2] * self.height(p, q)[2];
                        q -= (miss / plane.normal.dot(&tangent)).clamp(-5.0, 5.0);
                    }
                    if q.abs() < 33.0 {
                        pixels.push(rig.camera.project(&self.point(p, q)).unwrap());
                    }
                }
                (slide, pixels)
            })
            .collect()
    }
}

/// Stripes to a cloud with noise of `sigma` px on each centre, shared by `grain` neighbours.
pub fn cloud(
    stripes: &[(f64, Vec<Vector2>)],
    rig: &RigModel,
    sigma: f64,
    grain: usize,
    noise: &mut Noise,
) -> Vec<CloudPoint> {
    let mut cloud = Vec::new();
    for (frame, (slide, pixels)) in stripes.iter().enumerate() {
        let white: Vec<f64> = (0..pixels.len() + grain).map(|_| noise.normal()).collect();
        let points: Vec<StripePoint> = pixels
            .iter()
            .enumerate()
            .map(|(i, pixel)| {
                // A moving sum: unit variance, `grain` neighbours alike.
                let e: f64 = white[i..i + grain].iter().sum::<f64>() / (grain as f64).sqrt();
                StripePoint {
                    pixel: pixel + Vector2::new(0.0, sigma * e),
                    across: Vector2::y(),
                    variance: (sigma * sigma).max(1e-12),
                    intensity: 100.0,
                    width_px: 2.0,
                    quality: 1.0,
                }
            })
            .collect();
        triangulate(&points, grain as f64, frame as u32, *slide, rig, &mut cloud);
    }
    cloud
}
