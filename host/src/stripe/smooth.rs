//! Centres along the stripe, smoothed as far as their scatter bears it.
//!
//! Speckle grains are wider than a column, so that the centres' errors are correlated: third differences
//! of the centres over 1 to 6 columns, Var = σ²(20 − 30ρ(l) + 12ρ(2l) − 2ρ(3l)), give σ²
//! and the correlation ρ, whatever smooth shape the surface has. A local quadratic is then fitted in
//! windows of several widths, and each column takes the width of least estimated risk, bias² + variance
//! (Mallows' Cp over the neighbourhood, with the correlation accounted for). Where the surface is
//! too rough to smooth, the raw centre remains. Nothing is smoothed over a jump: the caller
//! splits first.

use std::sync::OnceLock;

/// Half widths of the windows; 0 is the raw centre.
const HALVES: [usize; 9] = [0, 2, 3, 4, 5, 7, 10, 14, 20];
/// Columns on either side over which the risk is averaged.
const NEIGHBOURS: usize = 25;
/// Lags up to which errors are correlated.
const LAGS: usize = 8;

/// A centre to smooth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub u: usize,
    pub v: f64,
    /// As the fit stated it: right up to a factor.
    pub variance: f64,
}

/// A smoothed centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Smoothed {
    pub v: f64,
    pub variance: f64,
}

/// How the centres of one segment scatter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scatter {
    /// Observed variance ÷ stated variance.
    pub scale: f64,
    /// Correlation at lags 0…7.
    pub correlation: [f64; LAGS],
}

impl Scatter {
    /// Where too few columns are there to tell: grains of two to three columns.
    pub const USUAL: Self = Self {
        scale: 2.0,
        correlation: [1.0, 0.5, 0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
    };

    /// Columns that share one error.
    pub fn columns(&self) -> f64 {
        self.correlation[0] + 2.0 * self.correlation[1..].iter().sum::<f64>()
    }

    /// From third differences over several lags, each relative to its stated variance.
    fn observe(v: &[f64], variance: &[f64]) -> Self {
        let n = v.len();
        if n < 24 {
            return Self::USUAL;
        }
        let spread = |lag: usize| -> f64 {
            let mut squares: Vec<f64> = (0..n - 3 * lag)
                .map(|i| {
                    let d = v[i + 3 * lag] - 3.0 * v[i + 2 * lag] + 3.0 * v[i + lag] - v[i];
                    let s = variance[i]
                        + 9.0 * (variance[i + lag] + variance[i + 2 * lag])
                        + variance[i + 3 * lag];
                    20.0 * d * d / s
                })
                .collect();
            let middle = squares.len() / 2;
            // The median of a squared normal deviate is 0.455.
            *squares.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.455
        };
        // Over many columns the surface's shape shows: only where there is room for them.
        let lags = if n < 60 { 4 } else { 6 };
        let spreads: Vec<f64> = (1..=lags).map(spread).collect();
        // White noise beside grains whose correlation is nearly a Gaussian of the distance:
        // ρ(l) = share·exp(−l²/2g²).
        let mut best = (f64::INFINITY, 1.0, 0.0, 0.0);
        for i in 0..GRAINS {
            let grain = 0.5 + 0.15 * i as f64;
            let rho = |lag: usize| (-0.5 * (lag as f64 / grain).powi(2)).exp();
            let change: [f64; 6] = std::array::from_fn(|k| {
                let lag = k + 1;
                -30.0 * rho(lag) + 12.0 * rho(2 * lag) - 2.0 * rho(3 * lag)
            });
            for j in 0..=10 {
                let share = 0.1 * f64::from(j);
                let ratio = |k: usize| spreads[k] / (20.0 + share * change[k]);
                // The surface's shape adds to the far differences: what exceeds the least of them
                // by more than its own scatter is shape.
                let least = (1..lags).map(ratio).fold(f64::INFINITY, f64::min);
                let far = |k: usize| ratio(k).min(SCATTER * least);
                let scale = (1..lags).map(far).sum::<f64>() / (lags - 1) as f64;
                let miss = (ratio(0) / scale).ln().powi(2)
                    + (1..3).map(|k| (far(k) / scale).ln().powi(2)).sum::<f64>();
                if miss < best.0 {
                    best = (miss, scale, share, grain);
                }
            }
        }
        let (_, scale, share, grain) = best;
        Self {
            scale: scale.max(0.02),
            correlation: std::array::from_fn(|lag| match lag {
                0 => 1.0,
                _ => share * (-0.5 * (lag as f64 / grain).powi(2)).exp(),
            }),
        }
    }
}

/// How much the estimates of a variance from different lags differ by chance.
const SCATTER: f64 = 1.15;
/// Sizes of grains that are tried.
const GRAINS: usize = 17;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "stripe, smoothing: half widths tried, columns",
            HALVES.map(|h| h.to_string()).join(", "),
        ),
        (
            "stripe, smoothing: columns on either side that the risk is averaged over",
            NEIGHBOURS.to_string(),
        ),
        (
            "stripe, smoothing: lags of the correlation, sizes of grains tried",
            format!("{LAGS}, {GRAINS}"),
        ),
        (
            "stripe, smoothing: chance scatter allowed between lags",
            format!("factor {SCATTER}"),
        ),
    ]
}

/// The weights of a local quadratic fit's value at one of the window's columns.
struct Kernel {
    weights: Vec<f64>,
    /// Index of that column.
    at: usize,
}

impl Kernel {
    fn new(length: usize, at: usize) -> Self {
        let mut m = nalgebra::Matrix3::<f64>::zeros();
        let row = |i: usize| {
            let x = i as f64 - at as f64;
            nalgebra::Vector3::new(1.0, x, x * x)
        };
        for i in 0..length {
            m += row(i) * row(i).transpose();
        }
        // Five columns or more determine a quadratic.
        let first = m
            .try_inverse()
            .map_or(nalgebra::Vector3::x(), |m| m.column(0).into_owned());
        Self {
            weights: (0..length).map(|i| first.dot(&row(i))).collect(),
            at,
        }
    }

    fn value(&self, window: &[f64]) -> f64 {
        self.weights.iter().zip(window).map(|(k, v)| k * v).sum()
    }

    /// Variance of the value, and its covariance with the raw centre, for unit variances.
    fn noise(&self, correlation: &[f64; LAGS]) -> (f64, f64) {
        let k = &self.weights;
        let (mut variance, mut covariance) = (0.0, 0.0);
        for i in 0..k.len() {
            variance += k[i] * k[i];
            for (lag, r) in correlation.iter().enumerate().skip(1) {
                if i + lag < k.len() {
                    variance += 2.0 * r * k[i] * k[i + lag];
                }
            }
            let lag = i.abs_diff(self.at);
            if lag < LAGS {
                covariance += correlation[lag] * k[i];
            }
        }
        (variance, covariance)
    }
}

/// For each half width: the full window's kernel last, before it those cut short at the left
/// end, for the columns 0, 1, … (the right end's are their mirror images).
fn kernels() -> &'static Vec<Vec<Kernel>> {
    static KERNELS: OnceLock<Vec<Vec<Kernel>>> = OnceLock::new();
    KERNELS.get_or_init(|| {
        HALVES
            .iter()
            .map(|&h| {
                (0..=h)
                    .map(|at| Kernel::new((at + h + 1).max(if h > 0 { 5 } else { 1 }), at))
                    .collect()
            })
            .collect()
    })
}

/// The smooth curve through a run of samples.
pub(super) struct Curve {
    first: usize,
    values: Vec<Smoothed>,
    pub scatter: Scatter,
}

impl Curve {
    /// Fits the curve to samples in ascending columns, with gaps of a few columns at most.
    pub fn fit(samples: &[Sample]) -> Option<Self> {
        let (first, last) = (samples.first()?.u, samples.last()?.u);
        let n = last - first + 1;
        if n < 5 || samples.len() < 5 {
            return None;
        }
        let (v, variance) = dense(samples, n);
        let scatter = Scatter::observe(&v, &variance);
        let mut values: Vec<Smoothed> = v
            .iter()
            .zip(&variance)
            .map(|(v, s)| Smoothed {
                v: *v,
                variance: s * scatter.scale,
            })
            .collect();
        let mut least: Vec<f64> = values.iter().map(|s| s.variance).collect();
        let mut fitted = vec![0.0; n];
        let mut noise = vec![0.0; n];
        let mut sums = vec![0.0; n + 1];
        let mut mirrored = vec![0.0; n];
        for (half, kernels) in HALVES.iter().zip(kernels()).skip(1) {
            if n < 2 * half + 1 {
                break;
            }
            let whole = &kernels[*half];
            let (f, c) = whole.noise(&scatter.correlation);
            for i in *half..n - half {
                fitted[i] = whole.value(&v[i - half..]);
                noise[i] = f;
                let s = scatter.scale * variance[i];
                sums[i + 1] = (fitted[i] - v[i]).powi(2) - s * (f + 1.0 - 2.0 * c);
            }
            for (m, x) in mirrored.iter_mut().zip(v.iter().rev()) {
                *m = *x;
            }
            for (at, kernel) in kernels[..*half].iter().enumerate() {
                let (f, c) = kernel.noise(&scatter.correlation);
                for (i, window) in [(at, &v), (n - 1 - at, &mirrored)] {
                    fitted[i] = kernel.value(window);
                    noise[i] = f;
                    let s = scatter.scale * variance[i];
                    sums[i + 1] = (fitted[i] - v[i]).powi(2) - s * (f + 1.0 - 2.0 * c);
                }
            }
            for i in 0..n {
                sums[i + 1] += sums[i];
            }
            for i in 0..n {
                let (a, b) = (i.saturating_sub(NEIGHBOURS), (i + NEIGHBOURS + 1).min(n));
                let own = noise[i] * scatter.scale * variance[i];
                // The estimate of bias² scatters about zero: what is far below means nothing.
                let bias = ((sums[b] - sums[a]) / (b - a) as f64).max(-0.3 * own);
                if own + bias < least[i] {
                    least[i] = own + bias;
                    values[i] = Smoothed {
                        v: fitted[i],
                        variance: own + bias.max(0.0),
                    };
                }
            }
        }
        Some(Self {
            first,
            values,
            scatter,
        })
    }

    /// The curve at column u; its end's value beyond it.
    pub fn at(&self, u: usize) -> Smoothed {
        self.values[u.saturating_sub(self.first).min(self.values.len() - 1)]
    }
}

/// One value a column; missing ones interpolated by the cubic that keeps both sides' slopes.
fn dense(samples: &[Sample], n: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut v, mut variance) = (Vec::with_capacity(n), Vec::with_capacity(n));
    for (i, s) in samples.iter().enumerate() {
        if i > 0 && s.u > samples[i - 1].u + 1 {
            let p = &samples[i - 1];
            let slope = |a: usize, b: usize| {
                let (a, b) = (&samples[a], &samples[b]);
                if b.u > a.u {
                    (b.v - a.v) / (b.u - a.u) as f64
                } else {
                    0.0
                }
            };
            let gap = (s.u - p.u) as f64;
            let m0 = slope((i - 1).saturating_sub(4), i - 1) * gap;
            let m1 = slope(i, (i + 4).min(samples.len() - 1)) * gap;
            for u in p.u + 1..s.u {
                let t = (u - p.u) as f64 / gap;
                let (t2, t3) = (t * t, t * t * t);
                v.push(
                    (2.0 * t3 - 3.0 * t2 + 1.0) * p.v
                        + (t3 - 2.0 * t2 + t) * m0
                        + (3.0 * t2 - 2.0 * t3) * s.v
                        + (t3 - t2) * m1,
                );
                variance.push(0.5 * (p.variance + s.variance));
            }
        }
        v.push(s.v);
        variance.push(s.variance);
    }
    (v, variance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::Noise;

    fn noisy(
        seed: u64,
        n: usize,
        blur: f64,
        sigma: f64,
        shape: impl Fn(f64) -> f64,
    ) -> Vec<Sample> {
        let mut noise = Noise(seed);
        let white: Vec<f64> = (0..n + 12).map(|_| noise.normal()).collect();
        let k: Vec<f64> = (0..13)
            .map(|i| (-0.5 * ((i as f64 - 6.0) / blur.max(1e-3)).powi(2)).exp())
            .collect();
        let norm = k.iter().map(|x| x * x).sum::<f64>().sqrt();
        (0..n)
            .map(|i| {
                let e: f64 = k.iter().zip(&white[i..]).map(|(a, b)| a * b).sum();
                Sample {
                    u: i + 100,
                    v: shape(i as f64) + sigma * e / norm,
                    variance: 0.01,
                }
            })
            .collect()
    }

    /// Root mean square and normalised errors of the curve.
    fn errors(samples: &[Sample], shape: impl Fn(f64) -> f64) -> (f64, f64) {
        let curve = Curve::fit(samples).unwrap();
        let (mut e2, mut z2) = (0.0, 0.0);
        for s in samples {
            let c = curve.at(s.u);
            let e = c.v - shape((s.u - 100) as f64);
            e2 += e * e;
            z2 += e * e / c.variance;
        }
        let n = samples.len() as f64;
        ((e2 / n).sqrt(), (z2 / n).sqrt())
    }

    #[test]
    fn noise_is_measured_whatever_the_shape() {
        for (blur, sigma) in [(0.0, 0.1), (0.7, 0.05), (1.0, 0.2)] {
            let samples = noisy(7, 1200, blur, sigma, |x| {
                0.002 * x * x + 3.0 * (x / 40.0).sin()
            });
            let curve = Curve::fit(&samples).unwrap();
            let expected = sigma * sigma / 0.01;
            let found = curve.scatter.scale;
            assert!(
                (0.75..1.3).contains(&(found / expected)),
                "{found} {expected}"
            );
            // Of noise blurred by s: ρ(1) = exp(−1/4s²).
            let rho = if blur > 0.0 {
                (-0.25 / (blur * blur)).exp()
            } else {
                0.0
            };
            let found = curve.scatter.correlation[1];
            assert!((found - rho).abs() < 0.12, "{found} {rho}");
        }
    }

    #[test]
    fn a_smooth_shape_gains_and_a_rough_one_loses_nothing() {
        let smooth = |x: f64| 40.0 * (x / 300.0).sin();
        let draws: Vec<(f64, f64)> = (0..20)
            .map(|seed| errors(&noisy(seed, 1000, 0.7, 0.1, smooth), smooth))
            .collect();
        let of = |pick: fn(&(f64, f64)) -> f64| {
            let squares = draws.iter().map(|d| pick(d).powi(2)).sum::<f64>();
            (squares / draws.len() as f64).sqrt()
        };
        let (rms, normalised) = (of(|d| d.0), of(|d| d.1));
        assert!(rms < 0.045, "{rms}");
        // A chance bias counts as one: stated a fifth too large rather than too small.
        assert!((0.75..1.1).contains(&normalised), "{normalised}");
        let rough = |x: f64| 1.5 * (x / 6.0).sin();
        let samples = noisy(7, 1000, 0.7, 0.02, rough);
        let (rms, _) = errors(&samples, rough);
        assert!(rms < 0.022, "{rms}");
    }

    #[test]
    fn gaps_are_bridged_along_the_curve() {
        let shape = |x: f64| 0.01 * (x - 50.0).powi(2);
        let mut samples = noisy(7, 100, 0.0, 0.03, shape);
        samples.retain(|s| !(140..146).contains(&s.u) && s.u % 17 != 0);
        let curve = Curve::fit(&samples).unwrap();
        for u in 100..200 {
            let e = curve.at(u).v - shape((u - 100) as f64);
            assert!(e.abs() < 0.1, "{u} {e}");
        }
    }
}
