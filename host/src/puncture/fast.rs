//! The fast model: force at any angle in microseconds, calibrated once on the reference solver.
//!
//! ```text
//! F(s) = Σ_L { T_L Γ_L g_L(s) + (p_L + q_L Γ_L) (μ + m_L) π D [ ∫_bevel φ dx + ∫_shaft dx ] }
//! ```
//! The sum goes over skin, fat and the vein's roof, the integrals over the part of the needle that
//! stands in the layer: at a path s that is x from s − s₁ to s − s₀ behind the tip, where the layer
//! lies from s₀ to s₁ = s₀ + thickness/sin θ on the path. φ = x/B grows along the first half of the
//! bevel, B = R/tan β, until the needle has its full width. g is the tip's part: it rises while the
//! tip comes into the layer, stays while it is inside, and half of it stays until the heel has
//! passed. The tissue gives way under the needle: s is taken less a dimple d_L. What is tough is cut
//! less far and squeezes the needle more (q); what the needle pushes aside resists without friction
//! too (m). T (N per kJ/m²), p (MPa), q (MPa per kJ/m²), m and d (mm) are fitted per layer, peaks
//! weighing more than feet; the residuals are stored with them (calibration.json).

use super::events::smooth;
use super::run::Run;
use super::tissue::Setup;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::sync::OnceLock;

/// A curve of the reference solver, thinned, for the calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceCurve {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Friction.
    pub friction: f64,
    /// Factor on the fracture energies.
    pub toughness: f64,
    /// Path, mm.
    pub path_mm: Vec<f64>,
    /// Force by layer (skin, fat, vein), N.
    pub layer_n: [Vec<f64>; 3],
    /// Peak of the whole force, N.
    pub peak_n: f64,
    /// Work, N·mm.
    pub work_n_mm: f64,
    /// Path at which the needle stood in the vein's lumen, mm.
    pub through_mm: Option<f64>,
}

impl ReferenceCurve {
    /// Of a run.
    pub fn new(run: &Run, friction: f64, toughness: f64) -> Self {
        let all = smooth(&run.samples);
        let mut curve = Self {
            angle_deg: run.angle_deg,
            friction,
            toughness,
            path_mm: Vec::new(),
            layer_n: Default::default(),
            peak_n: all.iter().map(|s| s.force_n).fold(0.0, f64::max),
            work_n_mm: run.samples.last().map_or(0.0, |s| s.energy.needle),
            through_mm: run.severed.path_mm[2],
        };
        for s in all.iter().step_by(4) {
            curve.path_mm.push((s.path_mm * 1e3).round() / 1e3);
            for (k, l) in curve.layer_n.iter_mut().enumerate() {
                l.push((s.by_region[k] * 1e4).round() / 1e4);
            }
        }
        curve
    }
}

/// A layer's constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LayerFit {
    /// T: tip force per fracture energy, N/(kJ/m²).
    pub tip: f64,
    /// p: pressure on the needle, MPa.
    pub pressure_mpa: f64,
    /// q: pressure per fracture energy, MPa/(kJ/m²).
    pub pressure_per_toughness: f64,
    /// m: what adds to friction.
    pub wedge: f64,
    /// d: dimple, mm.
    pub dimple_mm: f64,
    /// RMS residual of the layer's force over all curves, N.
    pub rms_n: f64,
}

/// How the fast model does against one run of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Friction.
    pub friction: f64,
    /// Factor on the fracture energies.
    pub toughness: f64,
    /// Peak of the reference, N.
    pub peak_reference_n: f64,
    /// Peak of the fast model, N.
    pub peak_fast_n: f64,
    /// RMS over the curve, N.
    pub rms_n: f64,
}

/// The fast model's constants with their residuals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Mesh of the reference, mm.
    pub mesh_mm: f64,
    /// Skin, fat, vein.
    pub layers: [LayerFit; 3],
    /// Path on from the vein's roof to the end of the reference's runs, mm.
    pub beyond_mm: f64,
    /// RMS of (fast − reference)/reference over the peaks.
    pub peak_error: f64,
    /// How far the reference's own peaks move when its mesh is halved, as a share.
    pub mesh_error: f64,
    /// Run by run.
    pub residuals: Vec<Residual>,
}

/// Force of the fast model at a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FastForce {
    /// Skin, fat, vein, N.
    pub layer_n: [f64; 3],
}

impl FastForce {
    /// All layers together, N.
    pub fn total(&self) -> f64 {
        self.layer_n.iter().sum()
    }
}

/// One angle by the fast model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FastAngle {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Peak force, N.
    pub peak_force_n: f64,
    /// Work to the end of the path, N·mm.
    pub work_n_mm: f64,
    /// Path to the lumen, mm.
    pub path_mm: f64,
}

/// A layer as a needle at an angle meets it.
#[derive(Clone, Copy)]
struct Crossing {
    /// Path at the layer's top, and through it, mm.
    from: f64,
    long: f64,
    toughness: f64,
    friction: f64,
    perimeter: f64,
    /// Half of the bevel's length, mm.
    half_bevel: f64,
    /// Path over which the tip's force falls to half behind the layer, mm.
    fade: f64,
}

impl Crossing {
    fn new(setup: &Setup, angle: f64, layer: usize) -> Self {
        let l = &setup.layers;
        let (top, thick, tissue) = match layer {
            0 => (0.0, l.skin_mm, &setup.skin),
            1 => (l.skin_mm, l.fat_mm, &setup.fat),
            _ => (l.skin_mm + l.fat_mm, l.wall_mm, &setup.vein),
        };
        let sine = angle.sin();
        let tan_bevel = setup.needle.bevel_deg.to_radians().tan();
        Self {
            from: top / sine,
            long: thick / sine,
            toughness: tissue.toughness_kj_m2,
            friction: setup.friction,
            perimeter: PI * setup.needle.diameter_mm,
            half_bevel: 0.5 * setup.needle.diameter_mm / tan_bevel,
            fade: 2.0 * setup.process_zone_mm,
        }
    }

    /// What T and p/(μ + m) multiply when the tip has come to `s` (the dimple taken off).
    fn basis(&self, s: f64) -> (f64, f64) {
        let x1 = s - self.from; // how far the tip is past the layer's top
        if x1 <= 0.0 {
            return (0.0, 0.0);
        }
        let past = (x1 - self.long).max(0.0);
        let b = self.half_bevel;
        // ∫ φ from 0 to x on the bevel, and the length on the shaft.
        let bevel = |x: f64| 0.5 * x.min(b) * x.min(b) / b;
        let shaft = |x: f64| (x - b).max(0.0);
        let rub = self.perimeter * (bevel(x1) - bevel(past) + shaft(x1) - shaft(past));
        let g = if past <= 0.0 {
            (2.0 * x1 / self.long).min(1.0)
        } else if past > 2.0 * b {
            0.0
        } else {
            1.0 - 0.5 * (past / self.fade).min(1.0)
        };
        (self.toughness * g, rub)
    }
}

impl Calibration {
    /// The stored calibration.
    pub fn stored() -> &'static Self {
        static STORED: OnceLock<Calibration> = OnceLock::new();
        STORED.get_or_init(|| {
            // The file is part of the program, and a test reads it.
            serde_json::from_str(include_str!("calibration.json")).unwrap_or_else(|_| Self {
                mesh_mm: 0.0,
                layers: [LayerFit::default(); 3],
                beyond_mm: 1.0,
                peak_error: 1.0,
                mesh_error: 1.0,
                residuals: Vec::new(),
            })
        })
    }

    /// Force at a path s (mm) along the needle at an angle (radians).
    pub fn force(&self, setup: &Setup, angle: f64, s: f64) -> FastForce {
        self.at(&[0, 1, 2].map(|k| Crossing::new(setup, angle, k)), s)
    }

    fn at(&self, layers: &[Crossing; 3], s: f64) -> FastForce {
        let mut out = FastForce::default();
        for (k, fit) in self.layers.iter().enumerate() {
            let layer = &layers[k];
            let (tip, rub) = layer.basis(s - fit.dimple_mm);
            let pressure = fit.pressure_mpa + fit.pressure_per_toughness * layer.toughness;
            out.layer_n[k] = fit.tip * tip + pressure * (layer.friction + fit.wedge) * rub;
        }
        out
    }

    /// Path from the skin to where the runs end: through the roof and a little on, mm.
    pub fn end_mm(&self, setup: &Setup, angle: f64) -> f64 {
        setup.lumen_roof_mm() / angle.sin() + self.beyond_mm
    }

    /// Peak, work and path at an angle (degrees).
    pub fn angle(&self, setup: &Setup, angle_deg: f64) -> FastAngle {
        let angle = angle_deg.to_radians();
        let end = self.end_mm(setup, angle);
        let layers = [0, 1, 2].map(|k| Crossing::new(setup, angle, k));
        const N: usize = 64;
        let (mut peak, mut sum) = (0.0_f64, 0.0);
        for i in 0..N {
            let f = self.at(&layers, end * (i as f64 + 0.5) / N as f64).total();
            peak = peak.max(f);
            sum += f;
        }
        // The end of the path is often the peak; midpoints miss it by half a step.
        peak = peak.max(self.at(&layers, end).total());
        FastAngle {
            angle_deg,
            peak_force_n: peak,
            work_n_mm: sum * end / N as f64,
            path_mm: setup.lumen_roof_mm() / angle.sin(),
        }
    }

    /// Fits the constants to curves of the reference at the given setup (friction and toughness
    /// are each curve's own).
    pub fn fit(setup: &Setup, curves: &[ReferenceCurve], mesh_mm: f64, mesh_error: f64) -> Self {
        let setups: Vec<Setup> = curves
            .iter()
            .map(|c| {
                let mut s = setup.with_toughness(c.toughness);
                s.friction = c.friction;
                s
            })
            .collect();
        let fit_layer = |k: usize| fit_layer(k, curves, &setups);
        let mut fit = Self {
            mesh_mm,
            layers: [fit_layer(0), fit_layer(1), fit_layer(2)],
            beyond_mm: 1.0,
            peak_error: 0.0,
            mesh_error,
            residuals: Vec::new(),
        };
        let beyond: Vec<f64> = curves
            .iter()
            .filter_map(|c| {
                let end = c.path_mm.last()?;
                Some(end - setup.lumen_roof_mm() / c.angle_deg.to_radians().sin())
            })
            .collect();
        fit.beyond_mm = beyond.iter().sum::<f64>() / beyond.len().max(1) as f64;
        for (c, s) in curves.iter().zip(&setups) {
            let angle = c.angle_deg.to_radians();
            let mut sum = 0.0;
            for (i, &path) in c.path_mm.iter().enumerate() {
                let y: f64 = c.layer_n.iter().map(|l| l[i]).sum();
                let d = fit.force(s, angle, path).total() - y;
                sum += d * d;
            }
            fit.residuals.push(Residual {
                angle_deg: c.angle_deg,
                friction: c.friction,
                toughness: c.toughness,
                peak_reference_n: c.peak_n,
                peak_fast_n: fit.angle(s, c.angle_deg).peak_force_n,
                rms_n: (sum / c.path_mm.len().max(1) as f64).sqrt(),
            });
        }
        let n = fit.residuals.len().max(1) as f64;
        fit.peak_error = (fit
            .residuals
            .iter()
            .map(|r| (r.peak_fast_n / r.peak_reference_n - 1.0).powi(2))
            .sum::<f64>()
            / n)
            .sqrt();
        fit
    }
}

/// One layer's constants: dimple and wedge by search, the others by least squares.
fn fit_layer(k: usize, curves: &[ReferenceCurve], setups: &[Setup]) -> LayerFit {
    let mut best = LayerFit {
        rms_n: f64::INFINITY,
        ..LayerFit::default()
    };
    for (d, m) in (0..=30).flat_map(|d| (0..=16).map(move |m| (d, m))) {
        let (dimple, wedge) = (0.05 * f64::from(d), 0.05 * f64::from(m));
        let mut normal = [[0.0; 3]; 3];
        let (mut right, mut yy, mut n) = ([0.0; 3], 0.0, 0.0);
        for (c, s) in curves.iter().zip(setups) {
            let layer = Crossing::new(s, c.angle_deg.to_radians(), k);
            let most = c.layer_n[k].iter().copied().fold(1e-12, f64::max);
            for (&path, &y) in c.path_mm.iter().zip(&c.layer_n[k]) {
                let (tip, rub) = layer.basis(path - dimple);
                let rub = rub * (layer.friction + wedge);
                let row = [tip, rub, rub * layer.toughness];
                // Each run counts alike, whatever its length, and its peak more than its feet.
                let w = (0.2 + (y / most).max(0.0)) / c.path_mm.len() as f64;
                for a in 0..3 {
                    for b in 0..3 {
                        normal[a][b] += w * row[a] * row[b];
                    }
                    right[a] += w * row[a] * y;
                }
                yy += w * y * y;
                n += w;
            }
        }
        for subset in 1..8_u8 {
            let Some(x) = solve(&normal, &right, subset) else {
                continue;
            };
            // The constants are positive by their meaning.
            if x.iter().any(|x| *x < 0.0) {
                continue;
            }
            let mut rest = yy;
            for a in 0..3 {
                rest -= 2.0 * x[a] * right[a];
                for b in 0..3 {
                    rest += x[a] * x[b] * normal[a][b];
                }
            }
            let rms = (rest.max(0.0) / n).sqrt();
            if rms < best.rms_n {
                best = LayerFit {
                    tip: x[0],
                    pressure_mpa: x[1],
                    pressure_per_toughness: x[2],
                    wedge,
                    dimple_mm: dimple,
                    rms_n: rms,
                };
            }
        }
    }
    best
}

/// Solves the normal equations for the unknowns in `subset` (bits); the others are zero.
fn solve(normal: &[[f64; 3]; 3], right: &[f64; 3], subset: u8) -> Option<[f64; 3]> {
    let mut a = nalgebra::Matrix3::identity();
    let mut b = nalgebra::Vector3::zeros();
    let on = |i: usize| subset & (1 << i) != 0;
    for i in (0..3).filter(|&i| on(i)) {
        b[i] = right[i];
        for j in 0..3 {
            a[(i, j)] = if on(j) { normal[i][j] } else { 0.0 };
        }
    }
    let x = a.lu().solve(&b)?;
    x.iter().all(|x| x.is_finite()).then(|| [x[0], x[1], x[2]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stored_calibration_is_read_and_gives_its_own_residuals() {
        let c = Calibration::stored();
        assert!(c.residuals.len() >= 5 && c.mesh_mm > 0.0);
        let mut sum = 0.0;
        for r in &c.residuals {
            let mut s = Setup::default().with_toughness(r.toughness);
            s.friction = r.friction;
            let peak = c.angle(&s, r.angle_deg).peak_force_n;
            assert!((peak - r.peak_fast_n).abs() < 1e-9);
            sum += (peak / r.peak_reference_n - 1.0).powi(2);
        }
        let error = (sum / c.residuals.len() as f64).sqrt();
        assert!((error - c.peak_error).abs() < 1e-9);
        assert!(error < 0.25, "{error}");
    }

    #[test]
    fn fitting_curves_of_the_model_gives_its_constants_back() {
        let setup = Setup::default();
        let truth = Calibration {
            layers: [(0.5, 0.6, 0.5), (0.4, 0.2, 1.0), (0.3, 0.1, 0.25)].map(|(t, p, d)| {
                LayerFit {
                    tip: t,
                    pressure_mpa: p,
                    pressure_per_toughness: 0.5 * p,
                    wedge: 0.2,
                    dimple_mm: d,
                    rms_n: 0.0,
                }
            }),
            ..Calibration::stored().clone()
        };
        let cases = [
            (20.0_f64, 0.7, 1.0),
            (45.0, 0.3, 1.0),
            (45.0, 0.7, 2.0),
            (70.0, 0.7, 0.5),
        ];
        let curves: Vec<ReferenceCurve> = cases
            .iter()
            .map(|&(angle_deg, friction, toughness)| {
                let angle = angle_deg.to_radians();
                let mut s = setup.with_toughness(toughness);
                s.friction = friction;
                let path_mm: Vec<f64> = (0..200)
                    .map(|i| 0.02 * f64::from(i) / angle.sin())
                    .collect();
                let layer_n = [0, 1, 2].map(|k| {
                    path_mm
                        .iter()
                        .map(|&x| truth.force(&s, angle, x).layer_n[k])
                        .collect()
                });
                ReferenceCurve {
                    angle_deg,
                    friction,
                    toughness,
                    path_mm,
                    layer_n,
                    peak_n: 1.0,
                    work_n_mm: 1.0,
                    through_mm: None,
                }
            })
            .collect();
        let fit = Calibration::fit(&setup, &curves, 0.2, 0.0);
        for (f, t) in fit.layers.iter().zip(&truth.layers) {
            assert!((f.tip - t.tip).abs() < 1e-6, "{f:?} {t:?}");
            assert!((f.pressure_mpa - t.pressure_mpa).abs() < 1e-6);
            assert!((f.pressure_per_toughness - t.pressure_per_toughness).abs() < 1e-6);
            assert!((f.wedge - t.wedge).abs() < 1e-9);
            assert!((f.dimple_mm - t.dimple_mm).abs() < 1e-9);
        }
    }

    #[test]
    fn friction_makes_flat_angles_dear_and_length_in_a_layer_is_bounded() {
        let c = Calibration::stored();
        let s = Setup::default();
        let peaks: Vec<f64> = (2..=16)
            .map(|k| c.angle(&s, 5.0 * f64::from(k)).peak_force_n)
            .collect();
        assert!(peaks.windows(2).all(|w| w[1] < w[0] + 1e-9), "{peaks:?}");
        // Far through, only friction on the layers' whole thickness is left.
        let a = 50.0_f64.to_radians();
        let f = c.force(&s, a, 100.0);
        let tough = [1.1, 0.2, 0.3];
        for (k, (fit, t)) in c.layers.iter().zip([1.0, 1.0, 0.3]).enumerate() {
            let pressure = fit.pressure_mpa + fit.pressure_per_toughness * tough[k];
            let expected = (0.7 + fit.wedge) * pressure * PI * 0.72 * t / a.sin();
            assert!((f.layer_n[k] - expected).abs() < 1e-9);
        }
    }
}
