//! The simulated hand: a curved surface with knuckles, tendons and veins over a table, and what
//! it looks like.
//!
//! In the hand's own frame (p across the hand, q towards the fingers, h out of the skin, mm)
//!
//! h(p, q) = −p²/2Rp − q²/2Rq + Σ knuckles + Σ ridges + Σ relief − rolloff·[(p/p₀)⁴ + (q/q₀)⁴]²
//!
//! where a knuckle [p, q, height, σ] is a Gaussian bump, a ridge [p, q, slope, bend, height, σ] a
//! Gaussian across the curve p + slope·Δq + bend·Δq², and a relief [kp, kq, phase, height] a sine.
//! The hand ends at the curve (p/p₀)⁴ + (q/q₀)⁴ = 1; behind it lies the table.

use super::profile::Parameters;
use super::random::Random;
use crate::geometry::{Matrix3, Plane, Point3, Vector3};

/// Tendons come first among the ridges, then the veins.
pub const TENDONS: usize = 4;
/// No hand reaches higher (h).
const TOP_MM: f64 = 6.0;
/// No hand reaches lower.
const BOTTOM_MM: f64 = -22.0;

/// The hand's shape; the keys of `hand` in truth.json.
#[derive(Clone, Debug, PartialEq)]
pub struct Hand {
    /// Origin of the hand's frame in the camera's, mm.
    pub origin: Point3,
    /// Rows: the directions of p, q and h in the camera's frame.
    pub axes: Matrix3,
    /// p₀, mm.
    pub half_p: f64,
    /// q₀, mm.
    pub half_q: f64,
    /// Rp, mm.
    pub radius_p: f64,
    /// Rq, mm.
    pub radius_q: f64,
    /// How far the edge falls, mm.
    pub rolloff: f64,
    /// Bumps: p, q, height, σ.
    pub knuckles: Vec<[f64; 4]>,
    /// Tendons and veins: p, q, slope, bend, height, σ.
    pub ridges: Vec<[f64; 6]>,
    /// Skin relief: kp, kq, phase, height.
    pub relief: Vec<[f64; 4]>,
    /// The table.
    pub table: Plane,
}

/// What the skin looks like.
#[derive(Clone, Debug)]
pub struct Skin {
    vein_contrast: f64,
    /// p, q, radius, depth.
    spots: Vec<[f64; 4]>,
    /// From p, q to p, q.
    hairs: Vec<[f64; 4]>,
    /// p, q, radius.
    highlights: Vec<[f64; 3]>,
}

/// Height and slopes of the surface at a place.
#[derive(Clone, Copy, Debug)]
pub struct Height {
    /// h, mm.
    pub h: f64,
    /// ∂h/∂p.
    pub by_p: f64,
    /// ∂h/∂q.
    pub by_q: f64,
}

impl Hand {
    /// A seed's hand under a camera about 430 mm away.
    pub fn random(random: &mut Random) -> Self {
        let tilt = random.between(33.0, 38.0f64).to_radians();
        let roll = random.between(-10.0, 10.0f64).to_radians();
        let turn = random.between(-6.0, 6.0f64).to_radians();
        // At no tilt: p right, q up in the image, h towards the camera.
        let base = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
        let turned = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), roll)
            * nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), -tilt)
            * nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
        let axes = base * turned.matrix().transpose();
        let origin = Point3::new(
            random.between(-4.0, 4.0),
            -14.5 + random.between(-2.0, 2.0),
            431.0 + random.between(-5.0, 5.0),
        );
        let knuckles: Vec<[f64; 4]> = [(-27.5, 29.5), (-9.0, 33.0), (9.5, 32.5), (27.0, 29.0)]
            .iter()
            .map(|&(p, q)| {
                [
                    p + random.between(-1.5, 1.5),
                    q + random.between(-1.5, 1.5),
                    random.between(1.3, 2.4),
                    random.between(5.5, 7.2),
                ]
            })
            .collect();
        let mut ridges: Vec<[f64; 6]> = knuckles
            .iter()
            .map(|k| {
                let slope = 0.0103 * k[0] + random.between(-0.02, 0.02);
                [
                    k[0],
                    k[1],
                    slope,
                    0.0,
                    random.between(0.4, 0.8),
                    random.between(2.5, 3.3),
                ]
            })
            .collect();
        for p in [0.0, -20.0, 20.0] {
            let near = if p == 0.0 { 6.0 } else { 2.0 };
            ridges.push([
                p + random.between(-near, near),
                random.between(-7.0, 7.0),
                random.between(-0.4, 0.4),
                random.between(-0.0025, 0.0025),
                random.between(0.2, 0.45),
                random.between(1.1, 1.7),
            ]);
        }
        let relief = (0..3)
            .map(|_| {
                let length = random.between(5.0, 9.0);
                let angle = random.between(0.0, std::f64::consts::TAU);
                let k = std::f64::consts::TAU / length;
                [
                    k * angle.cos(),
                    k * angle.sin(),
                    random.between(0.0, std::f64::consts::TAU),
                    0.035 / 3f64.sqrt(),
                ]
            })
            .collect();
        let out: Vector3 = axes.row(2).transpose();
        let tilted = out
            + Vector3::x() * random.between(-0.02, 0.02)
            + Vector3::y() * random.between(-0.02, 0.04);
        let below = origin - out * random.between(25.0, 30.0);
        let normal = -tilted.normalize();
        let table = Plane {
            normal,
            d: -normal.dot(&below.coords),
        };
        Self {
            origin,
            axes,
            half_p: random.between(37.5, 39.5),
            half_q: random.between(44.0, 48.0),
            radius_p: random.between(78.0, 92.0),
            radius_q: random.between(280.0, 380.0),
            rolloff: random.between(4.5, 6.0),
            knuckles,
            ridges,
            relief,
            table,
        }
    }

    /// Camera frame to the hand's (p, q, h).
    #[inline]
    pub fn local(&self, p: &Point3) -> Vector3 {
        self.axes * (p - self.origin)
    }

    /// The hand's frame (p, q, h) to the camera's.
    #[inline]
    pub fn camera(&self, local: &Vector3) -> Point3 {
        self.origin + self.axes.tr_mul(local)
    }

    /// Whether there is hand at (p, q).
    #[inline]
    pub fn covers(&self, p: f64, q: f64) -> bool {
        (p / self.half_p).powi(4) + (q / self.half_q).powi(4) <= 1.0
    }

    /// The surface at (p, q).
    #[inline]
    pub fn height(&self, p: f64, q: f64) -> Height {
        let (a, b) = (p / self.half_p, q / self.half_q);
        let (a3, b3) = (a.powi(3), b.powi(3));
        let edge = a3 * a + b3 * b;
        let mut h =
            -0.5 * p * p / self.radius_p - 0.5 * q * q / self.radius_q - self.rolloff * edge * edge;
        let mut by_p = -p / self.radius_p - 8.0 * self.rolloff * edge * a3 / self.half_p;
        let mut by_q = -q / self.radius_q - 8.0 * self.rolloff * edge * b3 / self.half_q;
        for &[p0, q0, height, sigma] in &self.knuckles {
            let (dp, dq, w) = (p - p0, q - q0, 1.0 / (sigma * sigma));
            let e = 0.5 * w * (dp * dp + dq * dq);
            if e < 30.0 {
                let bump = height * (-e).exp();
                h += bump;
                by_p -= bump * dp * w;
                by_q -= bump * dq * w;
            }
        }
        for &[p0, q0, slope, bend, height, sigma] in &self.ridges {
            let (dq, w) = (q - q0, 1.0 / (sigma * sigma));
            let dp = p - p0 - dq * (slope + bend * dq);
            let e = 0.5 * w * dp * dp;
            if e < 30.0 {
                let ridge = height * (-e).exp();
                h += ridge;
                by_p -= ridge * dp * w;
                by_q += ridge * dp * w * (slope + 2.0 * bend * dq);
            }
        }
        for &[kp, kq, phase, height] in &self.relief {
            let (sin, cos) = (kp * p + kq * q + phase).sin_cos();
            h += height * sin;
            by_p += height * kp * cos;
            by_q += height * kq * cos;
        }
        Height { h, by_p, by_q }
    }

    /// Where the ray z·(x, y, 1) meets the hand: its (p, q, h), its z and the slopes there. `guess`
    /// is a z to start from. Seen from the camera the hand has no overhangs, so the gap between ray
    /// and surface falls all along the ray over the hand, and there is one solution.
    pub fn meet(&self, ray: &Vector3, guess: f64) -> Option<(f64, Vector3, Height)> {
        let start = self.axes * (-self.origin.coords);
        let along = self.axes * ray;
        if !(along.z < -0.1) {
            return None;
        }
        let at = |z: f64| start + along * z;
        let level = |h: f64| (h - start.z) / along.z;
        let (above, below) = (level(TOP_MM), level(BOTTOM_MM));
        let (a, b) = (at(above), at(below));
        let beside = |a: f64, b: f64, half: f64| a.min(b) > half || a.max(b) < -half;
        if beside(a.x, b.x, self.half_p) || beside(a.y, b.y, self.half_q) {
            return None;
        }
        let found = |z: f64| {
            let l = at(z);
            self.covers(l.x, l.y).then(|| (z, l, self.height(l.x, l.y)))
        };
        // Newton from the guess, which is nearly always right.
        let mut z = guess;
        for _ in 0..8 {
            let l = at(z);
            if !self.covers(l.x, l.y) {
                break;
            }
            let s = self.height(l.x, l.y);
            let step = (l.z - s.h) / (along.z - s.by_p * along.x - s.by_q * along.y);
            z -= step;
            if step.abs() < 1e-9 {
                return found(z);
            }
        }
        // Else between a place above and one below the surface.
        let gap = |z: f64| {
            let l = at(z);
            l.z - self.height(l.x, l.y).h
        };
        let mut high = above;
        let mut low = (0..=16)
            .map(|i| below + (above - below) * f64::from(i) / 16.0)
            .find(|&z| gap(z) < 0.0)?;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if gap(middle) < 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        found(0.5 * (low + high))
    }

    /// Whether a point on the table lies in the hand's shadow for light that travels along `light`.
    pub fn shades(&self, p: &Point3, light: &Vector3) -> bool {
        let from = self.local(p);
        let back = self.axes * (-light);
        if back.z <= 0.0 {
            return false;
        }
        (1..60).any(|i| {
            let l = from + back * (f64::from(i) / back.z * 0.7);
            self.covers(l.x, l.y) && l.z < self.height(l.x, l.y).h
        })
    }

    /// The unit normal of the surface towards the camera, camera frame.
    pub fn normal(&self, slope: &Height) -> Vector3 {
        self.axes
            .tr_mul(&Vector3::new(-slope.by_p, -slope.by_q, 1.0))
            .normalize()
    }
}

impl Skin {
    /// A seed's skin.
    pub fn random(random: &mut Random, parameters: &Parameters, hand: &Hand) -> Self {
        let place = |random: &mut Random| {
            (
                random.between(-0.85, 0.85) * hand.half_p,
                random.between(-0.85, 0.85) * hand.half_q,
            )
        };
        let spots = (0..parameters.spots)
            .map(|_| {
                let (p, q) = place(random);
                [p, q, random.between(0.3, 0.8), random.between(0.3, 0.6)]
            })
            .collect();
        let hairs = (0..parameters.hairs)
            .map(|_| {
                let (p, q) = place(random);
                let (length, angle) = (random.between(4.0, 9.0), random.between(0.7, 2.0));
                [
                    p,
                    q,
                    p + length * f64::cos(angle),
                    q - length * f64::sin(angle),
                ]
            })
            .collect();
        let highlights = (0..parameters.highlights)
            .map(|_| {
                let (p, q) = place(random);
                [p, q, random.between(0.5, 1.2)]
            })
            .collect();
        Self {
            vein_contrast: parameters.vein_contrast,
            spots,
            hairs,
            highlights,
        }
    }

    /// Diffuse reflectance at (p, q).
    pub fn albedo(&self, hand: &Hand, p: f64, q: f64) -> f64 {
        let mut albedo = 0.55
            * (1.0
                + 0.02 * (0.9 * p + 0.3 * q).sin()
                + 0.02 * (0.2 * p - 0.8 * q).sin()
                + 0.03 * (0.11 * p + 0.07 * q).sin());
        for &[p0, q0, slope, bend, _, sigma] in &hand.ridges[TENDONS.min(hand.ridges.len())..] {
            let dq = q - q0;
            let dp = (p - p0 - dq * (slope + bend * dq)) / (1.2 * sigma);
            albedo *= 1.0 - self.vein_contrast * (-0.5 * dp * dp).exp();
        }
        for &[p0, q0, radius, depth] in &self.spots {
            let e = ((p - p0).powi(2) + (q - q0).powi(2)) / (2.0 * radius * radius);
            if e < 12.0 {
                albedo *= 1.0 - depth * (-e).exp();
            }
        }
        for &[p0, q0, p1, q1] in &self.hairs {
            let (ap, aq) = (p1 - p0, q1 - q0);
            let t = (((p - p0) * ap + (q - q0) * aq) / (ap * ap + aq * aq)).clamp(0.0, 1.0);
            let e = ((p - p0 - t * ap).powi(2) + (q - q0 - t * aq).powi(2)) / (2.0 * 0.05 * 0.05);
            if e < 12.0 {
                albedo *= 1.0 - 0.7 * (-e).exp();
            }
        }
        albedo
    }

    /// How much brighter wet spots are than dull skin at (p, q) (1: not at all).
    pub fn shine(&self, p: f64, q: f64) -> f64 {
        let mut shine = 1.0;
        for &[p0, q0, radius] in &self.highlights {
            let e = ((p - p0).powi(2) + (q - q0).powi(2)) / (2.0 * radius * radius);
            if e < 12.0 {
                shine += 4.0 * (-e).exp();
            }
        }
        shine
    }
}
