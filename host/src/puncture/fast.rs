//! The fast model: force at any angle in microseconds, calibrated once on the reference solver
//! (fit.rs), stored with its residuals.
//!
//! ```text
//! F(s) = Σ_L { Γ_L [ (T_L + S_L/sin θ) g + E_L e + B_L ℓ ] + (p_L + q_L Γ_L) (μ + m_L) π D W r }
//! ```
//! The sum goes over skin, fat and the vein's roof; s is the path of the tip. A layer that lies from
//! s₀ to s₁ = s₀ + thickness/sin θ on the path gives way under the needle: it is first felt at
//! s_c = s₀ + c/sin θ, and the tip is through at s_p = s₁ + a + b/sin θ + k (Γ − Γ₀), the dimple
//! being deeper in what is tough. Then
//! - g, the tip: rises from s_c over a share ρ of the way to s_p, and fades from s_p on over the
//!   process zone's way, 2ℓ/sin θ;
//! - e, what is severed after the tip: 1 − fade, until the heel has passed;
//! - ℓ, the length of the bevel's edge in the layer, mm, after the same fade;
//! - W = ∫ φ dx, the length of needle in the layer weighted by its width: x runs from s − s₁ to
//!   s − s₀ behind the tip (less what dimple is left, d), φ grows along a share χ of the bevel and
//!   is 1 behind; so the drag is friction × pressure × length, the length ≤ thickness/sin θ;
//! - r rises from 0 to 1 around s_p (the tissue closes on the needle once it is through), over
//!   ± w/sin θ.
//!
//! What the needle pushes aside resists without friction too (m). What is tough is cut less wide
//! and squeezes the needle more (q).

use super::tissue::Setup;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::sync::OnceLock;

/// A layer's constants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LayerFit {
    /// T, S, E, B: tip, what a slant adds to it, severing behind it (N per kJ/m²) and the bevel's
    /// edge (N/mm per kJ/m²).
    pub cut: [f64; 4],
    /// p: pressure on the needle, MPa.
    pub pressure_mpa: f64,
    /// q: pressure per fracture energy, MPa/(kJ/m²).
    pub pressure_per_toughness: f64,
    /// m: what adds to friction.
    pub wedge: f64,
    /// c: depth to which the layer sinks before it is felt, mm.
    pub sink_mm: f64,
    /// a, b: the dimple when the tip is through, mm.
    pub dimple_mm: [f64; 2],
    /// k: how it grows with the fracture energy, mm/(kJ/m²), and Γ₀, kJ/m².
    pub dimple_per_toughness: [f64; 2],
    /// ρ: share of the way to s_p over which the tip's force rises.
    pub rise: f64,
    /// d: dimple that is left while the shaft follows, d₀ + d₁/sin θ, mm.
    pub rest_mm: [f64; 2],
    /// χ: share of the bevel's length over which φ grows.
    pub taper: f64,
    /// w: half the way over which the drag sets in, mm.
    pub onset_mm: f64,
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
    /// RMS of (fast − reference)/reference over the peaks.
    pub peak_error: f64,
    /// How far the reference's own peaks move when brick and step are halved, as a share: RMS over
    /// 15° (brick 0.1 mm), 30°, 45°, 60° and 75°, rounded up.
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
pub(super) struct Crossing {
    /// Path at the layer's top, and through it, mm.
    from: f64,
    long: f64,
    sine: f64,
    pub(super) toughness: f64,
    pub(super) friction: f64,
    perimeter: f64,
    /// Length of the bevel, mm.
    bevel: f64,
    /// Path over which the tip's force fades behind the layer, mm.
    fade: f64,
}

/// 0 before `from`, 1 after `from + long`, smooth in between.
fn step(s: f64, from: f64, long: f64) -> f64 {
    let x = ((s - from) / long.max(1e-9)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

impl Crossing {
    pub(super) fn new(setup: &Setup, angle: f64, layer: usize) -> Self {
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
            sine,
            toughness: tissue.toughness_kj_m2,
            friction: setup.friction,
            perimeter: PI * setup.needle.diameter_mm,
            bevel: setup.needle.diameter_mm / tan_bevel,
            fade: 2.0 * setup.process_zone_mm / sine,
        }
    }

    /// Paths at which the layer is first felt and at which the tip is through, mm.
    fn passage(&self, fit: &LayerFit) -> (f64, f64) {
        let contact = self.from + fit.sink_mm / self.sine;
        let [k, usual] = fit.dimple_per_toughness;
        let dimple = fit.dimple_mm[0] + fit.dimple_mm[1] / self.sine;
        let dimple = dimple + k * (self.toughness - usual);
        let through = (self.from + self.long + dimple).max(contact + 0.1 * self.long);
        (contact, through)
    }

    /// What T, S, E, B and (p + qΓ) multiply when the tip has come to `s`.
    pub(super) fn basis(&self, fit: &LayerFit, s: f64) -> [f64; 5] {
        let (contact, through) = self.passage(fit);
        if s <= contact {
            return [0.0; 5];
        }
        let faded = step(s, through - 0.3 * self.fade, self.fade);
        let tip = ((s - contact) / (fit.rise * (through - contact))).min(1.0) * (1.0 - faded);
        // How far the tip is past the layer's top and bottom as they lie now.
        let rest = fit.rest_mm[0] + fit.rest_mm[1] / self.sine;
        let past_top = (s - self.from - rest).max(0.0);
        let past = (past_top - self.long).max(0.0);
        let edge = past_top.min(self.bevel) - past.min(self.bevel);
        let behind = if past < self.bevel { faded } else { 0.0 };
        // ∫ φ from 0 to x where it grows, and the length where it is 1.
        let b = fit.taper * self.bevel;
        let wedge = |x: f64| 0.5 * x.min(b) * x.min(b) / b;
        let shaft = |x: f64| (x - b).max(0.0);
        let long = wedge(past_top) - wedge(past) + shaft(past_top) - shaft(past);
        let onset = fit.onset_mm / self.sine;
        let closed = step(s, through - onset, 2.0 * onset);
        let rub = self.perimeter * long * closed * (self.friction + fit.wedge);
        [
            self.toughness * tip,
            self.toughness * tip / self.sine,
            self.toughness * behind,
            self.toughness * edge * faded,
            rub,
        ]
    }
}

impl LayerFit {
    fn force(&self, layer: &Crossing, s: f64) -> f64 {
        let [tip, slant, behind, edge, rub] = layer.basis(self, s);
        let [t, l, e, b] = self.cut;
        let pressure = self.pressure_mpa + self.pressure_per_toughness * layer.toughness;
        t * tip + l * slant + e * behind + b * edge + pressure * rub
    }
}

impl Calibration {
    /// [`Self::mesh_error`] with bricks of another size. Finer ones count as no better; coarser ones are
    /// worse with the third power: at 0.4 mm a peak at 75° came out at twice its value.
    pub fn mesh_error_at(&self, mesh_mm: f64) -> f64 {
        self.mesh_error * (mesh_mm / self.mesh_mm).max(1.0).powi(3)
    }

    /// The stored calibration.
    pub fn stored() -> &'static Self {
        static STORED: OnceLock<Calibration> = OnceLock::new();
        STORED.get_or_init(|| {
            // The file is part of the program, and a test reads it.
            serde_json::from_str(include_str!("calibration.json")).unwrap_or_else(|_| Self {
                mesh_mm: 0.0,
                layers: [LayerFit::default(); 3],
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
            out.layer_n[k] = fit.force(&layers[k], s);
        }
        out
    }

    /// For skin, fat and vein: the paths at which the layer is first felt and at which the tip is
    /// through, mm.
    pub fn passages(&self, setup: &Setup, angle: f64) -> [(f64, f64); 3] {
        [0, 1, 2].map(|k| Crossing::new(setup, angle, k).passage(&self.layers[k]))
    }

    /// Path from the skin to where the runs end, mm: the tip on the lumen's axis.
    pub fn end_mm(&self, setup: &Setup, angle: f64) -> f64 {
        setup.lumen_axis_mm() / angle.sin()
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
        assert!(error < 0.05, "{error}");
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
