//! Fits the fast model to the reference solver: which runs, and how. `cannula puncture --fit` does
//! it again (minutes) and writes fast_model.json; the program's own is puncture/calibration.json.

use super::events::smooth;
use super::fast::{Calibration, Crossing, LayerFit, Residual};
use super::run::Run;
use super::tissue::Setup;
use serde::{Deserialize, Serialize};

/// Angle (degrees), friction and factor on the fracture energies of the runs to fit to.
pub const CASES: [(f64, f64, f64); 20] = [
    (15.0, 0.7, 1.0),
    (20.0, 0.7, 1.0),
    (30.0, 0.7, 1.0),
    (37.5, 0.7, 1.0),
    (45.0, 0.7, 1.0),
    (52.5, 0.7, 1.0),
    (60.0, 0.7, 1.0),
    (75.0, 0.7, 1.0),
    (20.0, 0.3, 1.0),
    (30.0, 0.3, 1.0),
    (45.0, 0.3, 1.0),
    (60.0, 0.3, 1.0),
    (30.0, 0.0, 1.0),
    (60.0, 0.0, 1.0),
    (30.0, 0.7, 0.5),
    (45.0, 0.7, 0.5),
    (60.0, 0.7, 0.5),
    (30.0, 0.7, 2.0),
    (45.0, 0.7, 2.0),
    (60.0, 0.7, 2.0),
];

/// Setup of a case.
pub fn setup_of(base: &Setup, friction: f64, toughness: f64) -> Setup {
    Setup {
        friction,
        ..base.with_toughness(toughness)
    }
}

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

/// Fits the constants to curves of the reference at the given setup (friction and toughness are
/// each curve's own). `mesh_error`: how far the reference's peaks move under refinement.
pub fn fit(setup: &Setup, curves: &[ReferenceCurve], mesh_mm: f64, mesh_error: f64) -> Calibration {
    let setups: Vec<Setup> = curves
        .iter()
        .map(|c| setup_of(setup, c.friction, c.toughness))
        .collect();
    let usual = [setup.skin, setup.fat, setup.vein].map(|t| t.toughness_kj_m2);
    let mut fit = Calibration {
        mesh_mm,
        layers: [0, 1, 2].map(|k| fit_layer(k, curves, &setups, usual[k])),
        peak_error: 0.0,
        mesh_error,
        residuals: Vec::new(),
    };
    polish(&mut fit, curves, &setups);
    for k in 0..3 {
        fit.layers[k].rms_n = layer_rms(&fit, k, curves, &setups);
    }
    fit.residuals = residuals(&fit, curves, &setups);
    let squares = |r: &Residual| (r.peak_fast_n / r.peak_reference_n - 1.0).powi(2);
    fit.peak_error = mean(&fit.residuals, squares).sqrt();
    fit
}

fn residuals(fast: &Calibration, curves: &[ReferenceCurve], setups: &[Setup]) -> Vec<Residual> {
    let one = |(c, s): (&ReferenceCurve, &Setup)| {
        let angle = c.angle_deg.to_radians();
        let mut sum = 0.0;
        for (i, &path) in c.path_mm.iter().enumerate() {
            let y: f64 = c.layer_n.iter().map(|l| l[i]).sum();
            let d = fast.force(s, angle, path).total() - y;
            sum += d * d;
        }
        Residual {
            angle_deg: c.angle_deg,
            friction: c.friction,
            toughness: c.toughness,
            peak_reference_n: c.peak_n,
            peak_fast_n: fast.angle(s, c.angle_deg).peak_force_n,
            rms_n: (sum / c.path_mm.len().max(1) as f64).sqrt(),
        }
    };
    curves.iter().zip(setups).map(one).collect()
}

/// RMS residual of one layer's force over all curves, N.
fn layer_rms(fast: &Calibration, k: usize, curves: &[ReferenceCurve], setups: &[Setup]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (c, s) in curves.iter().zip(setups) {
        for (&path, y) in c.path_mm.iter().zip(&c.layer_n[k]) {
            let d = fast.force(s, c.angle_deg.to_radians(), path).layer_n[k] - y;
            sum += d * d;
            n += 1.0;
        }
    }
    f64::sqrt(sum / f64::max(n, 1.0))
}

fn mean(residuals: &[Residual], f: impl Fn(&Residual) -> f64) -> f64 {
    residuals.iter().map(f).sum::<f64>() / residuals.len().max(1) as f64
}

/// All layers together, by a compass search: the whole force's curve and its peak count alike.
fn polish(fast: &mut Calibration, curves: &[ReferenceCurve], setups: &[Setup]) {
    let cost = |f: &Calibration| {
        mean(&residuals(f, curves, setups), |r| {
            let peak = r.peak_fast_n / r.peak_reference_n - 1.0;
            peak * peak + (r.rms_n / r.peak_reference_n).powi(2)
        })
    };
    fn constants(l: &mut LayerFit) -> [(&mut f64, f64); 15] {
        let [t, s, e, b] = &mut l.cut;
        let [a, slant] = &mut l.dimple_mm;
        let [rest, rest_slant] = &mut l.rest_mm;
        // Each with its least value.
        [
            (t, 0.0),
            (s, 0.0),
            (e, 0.0),
            (b, 0.0),
            (&mut l.pressure_mpa, 0.0),
            (&mut l.pressure_per_toughness, 0.0),
            (&mut l.wedge, 0.0),
            (&mut l.sink_mm, 0.0),
            (a, -2.0),
            (slant, -2.0),
            (&mut l.dimple_per_toughness[0], 0.0),
            (&mut l.rise, 0.2),
            (rest, -2.0),
            (rest_slant, -2.0),
            (&mut l.taper, 0.3),
        ]
    }
    let mut best = cost(fast);
    let mut step = [[0.05; 15]; 3];
    for _ in 0..60 {
        for k in 0..3 {
            for i in 0..15 {
                let mut moved = false;
                for sign in [1.0, -1.0] {
                    let mut other = fast.clone();
                    let (x, least) = &mut constants(&mut other.layers[k])[i];
                    **x = (**x + sign * step[k][i] * (0.2 + x.abs())).max(*least);
                    let there = cost(&other);
                    if there < best {
                        (*fast, best, moved) = (other, there, true);
                        break;
                    }
                }
                step[k][i] = (step[k][i] * if moved { 1.3 } else { 0.6 }).max(1e-4);
            }
        }
    }
}

/// The constants that are searched; the others follow by least squares.
type Shape = [f64; 10];
/// Least, largest and first step of each.
const RANGE: [[f64; 3]; 10] = [
    [0.0, 1.5, 0.2],  // sink
    [-1.0, 3.0, 0.4], // dimple a
    [-0.5, 2.0, 0.2], // dimple b
    [-1.0, 8.0, 0.5], // dimple per toughness
    [0.2, 1.0, 0.2],  // rise
    [-1.0, 2.0, 0.3], // rest
    [0.05, 1.5, 0.2], // onset
    [0.0, 2.0, 0.2],  // wedge
    [-0.5, 1.0, 0.2], // rest against 1/sin
    [0.3, 1.3, 0.2],  // taper
];

fn shaped(x: &Shape, usual: f64) -> LayerFit {
    LayerFit {
        sink_mm: x[0],
        dimple_mm: [x[1], x[2]],
        dimple_per_toughness: [x[3], usual],
        rise: x[4],
        rest_mm: [x[5], x[8]],
        onset_mm: x[6],
        wedge: x[7],
        taper: x[9],
        ..LayerFit::default()
    }
}

/// One layer's constants: the shape by a compass search from several starts, the rest linear.
fn fit_layer(k: usize, curves: &[ReferenceCurve], setups: &[Setup], usual: f64) -> LayerFit {
    let layers: Vec<Crossing> = curves
        .iter()
        .zip(setups)
        .map(|(c, s)| Crossing::new(s, c.angle_deg.to_radians(), k))
        .collect();
    let try_out = |x: &Shape| linear(k, curves, &layers, shaped(x, usual));
    let mut best = LayerFit {
        rms_n: f64::INFINITY,
        ..LayerFit::default()
    };
    for start in 0..4 {
        let (dimple, rest) = ([0.3, 1.0][start % 2], [0.0, 0.6][start / 2]);
        let mut x: Shape = [0.2, dimple, 0.3, 0.8, 0.6, rest, 0.4, 0.2, 0.1, 0.8];
        let mut step = RANGE.map(|r| r[2]);
        let mut here = try_out(&x);
        for _ in 0..80 {
            for i in 0..x.len() {
                let mut moved = false;
                for sign in [1.0, -1.0] {
                    let mut y = x;
                    y[i] = (y[i] + sign * step[i]).clamp(RANGE[i][0], RANGE[i][1]);
                    let there = try_out(&y);
                    if there.rms_n < here.rms_n {
                        (x, here, moved) = (y, there, true);
                        break;
                    }
                }
                step[i] *= if moved { 1.3 } else { 0.6 };
                step[i] = step[i].max(1e-4);
            }
        }
        if here.rms_n < best.rms_n {
            best = here;
        }
    }
    best
}

/// The linear constants at a shape, none negative, and the weighted RMS residual.
fn linear(k: usize, curves: &[ReferenceCurve], layers: &[Crossing], shape: LayerFit) -> LayerFit {
    let mut normal = [[0.0; 6]; 6];
    let (mut right, mut yy, mut n) = ([0.0; 6], 0.0, 0.0);
    for (c, layer) in curves.iter().zip(layers) {
        let most = c.peak_n.max(1e-12);
        for (i, &path) in c.path_mm.iter().enumerate() {
            let y = c.layer_n[k][i];
            let [tip, slant, behind, edge, rub] = layer.basis(&shape, path);
            let row = [tip, slant, behind, edge, rub, rub * layer.toughness];
            // Each run counts alike, whatever its length and force, and where its whole force is
            // near the peak more than at its feet.
            let whole: f64 = c.layer_n.iter().map(|l| l[i]).sum();
            let high = (whole / most).max(0.0);
            let w = (0.1 + high.powi(4)) / (c.path_mm.len() as f64 * most * most);
            for a in 0..6 {
                for b in 0..6 {
                    normal[a][b] += w * row[a] * row[b];
                }
                right[a] += w * row[a] * y;
            }
            yy += w * y * y;
            n += w;
        }
    }
    let mut best = LayerFit {
        rms_n: f64::INFINITY,
        ..shape
    };
    for subset in 1..64_u8 {
        let Some(x) = solve(&normal, &right, subset) else {
            continue;
        };
        // The constants are positive by their meaning.
        if x.iter().any(|x| *x < 0.0) {
            continue;
        }
        let mut rest = yy;
        for a in 0..6 {
            rest -= 2.0 * x[a] * right[a];
            for b in 0..6 {
                rest += x[a] * x[b] * normal[a][b];
            }
        }
        let rms = (rest.max(0.0) / n).sqrt();
        if rms < best.rms_n {
            best = LayerFit {
                cut: [x[0], x[1], x[2], x[3]],
                pressure_mpa: x[4],
                pressure_per_toughness: x[5],
                rms_n: rms,
                ..shape
            };
        }
    }
    best
}

/// Solves the normal equations for the unknowns in `subset` (bits); the others are zero.
fn solve(normal: &[[f64; 6]; 6], right: &[f64; 6], subset: u8) -> Option<[f64; 6]> {
    let mut a = nalgebra::Matrix6::identity();
    let mut b = nalgebra::Vector6::zeros();
    let on = |i: usize| subset & (1 << i) != 0;
    for i in (0..6).filter(|&i| on(i)) {
        b[i] = right[i];
        for j in 0..6 {
            a[(i, j)] = if on(j) { normal[i][j] } else { 0.0 };
        }
    }
    let x = a.lu().solve(&b)?;
    x.iter()
        .all(|x| x.is_finite())
        .then(|| std::array::from_fn(|i| x[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Curves drawn from the stored constants, moved a little, are met again: the search finds
    /// what it is given, to a hundredth of the force.
    #[test]
    fn curves_of_the_model_itself_are_met() {
        let setup = Setup::default();
        let mut truth = Calibration::stored().clone();
        for l in &mut truth.layers {
            l.cut[0] *= 1.2;
            l.pressure_mpa = 0.8 * l.pressure_mpa + 0.05;
            l.dimple_mm[0] += 0.1;
            l.wedge += 0.05;
        }
        let cases = [
            (20.0, 0.7, 1.0),
            (45.0, 0.3, 1.0),
            (45.0, 0.7, 2.0),
            (70.0, 0.7, 0.5),
        ];
        let curves: Vec<ReferenceCurve> = cases
            .iter()
            .map(|&(angle_deg, friction, toughness)| {
                let angle = f64::to_radians(angle_deg);
                let s = setup_of(&setup, friction, toughness);
                let path_mm: Vec<f64> =
                    (0..60).map(|i| 0.06 * f64::from(i) / angle.sin()).collect();
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
                    peak_n: truth.angle(&s, angle_deg).peak_force_n,
                    work_n_mm: 1.0,
                    through_mm: None,
                }
            })
            .collect();
        let found = fit(&setup, &curves, 0.2, 0.0);
        assert!(found.peak_error < 0.02, "{}", found.peak_error);
        for r in &found.residuals {
            assert!(r.rms_n < 0.02 * r.peak_reference_n, "{r:?}");
        }
    }
}
