//! Centres along the stripe, smoothed as far as their scatter bears it.
//!
//! Four neighbouring columns are taken together (speckle grains are two or three pixels wide: the
//! means of four are nearly independent). The stripe's row v(u) is a thrice integrated random
//! walk, v''' = white noise of density q, observed with the noise r·R at each bin: a Kalman filter and the
//! Rauch–Tung–Striebel smoother (Särkkä, Bayesian Filtering and Smoothing, 2013, Alg. 8.2). q/r
//! is chosen by maximum likelihood among eight values, r (how far the centres scatter more than
//! their variances say) follows in closed form. Nothing is smoothed over a jump: the caller splits first.

/// Columns of a bin.
pub(super) const BIN: usize = 4;
/// q in units of the bins' mean variance, px⁻⁵ px²… from a nearly quadratic curve to a free one.
const DENSITIES: [f64; 8] = [1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];

/// A centre to smooth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub u: f64,
    pub v: f64,
    pub variance: f64,
}

/// A smoothed centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Smoothed {
    pub v: f64,
    pub slope: f64,
    pub variance: f64,
}

/// The smooth curve through a run of samples.
pub(super) struct Curve {
    bins: Vec<Bin>,
    states: Vec<State>,
    /// Observed variance of a bin ÷ the variance that its samples stated.
    pub scale: f64,
}

#[derive(Clone, Copy)]
struct Bin {
    u: f64,
    v: f64,
    /// As the samples stated it.
    variance: f64,
}

#[derive(Clone, Copy)]
struct State {
    x: [f64; 3],
    /// Covariance, upper triangle: 00, 01, 02, 11, 12, 22.
    p: [f64; 6],
}

fn bins(samples: &[Sample]) -> Vec<Bin> {
    let mut bins = Vec::with_capacity(samples.len() / BIN + 2);
    let mut i = 0;
    while i < samples.len() {
        let cell = (samples[i].u / BIN as f64).floor();
        let (mut w, mut wu, mut wv) = (0.0, 0.0, 0.0);
        while i < samples.len() && (samples[i].u / BIN as f64).floor() == cell {
            let s = &samples[i];
            let weight = 1.0 / s.variance;
            w += weight;
            wu += weight * s.u;
            wv += weight * s.v;
            i += 1;
        }
        if w > 0.0 {
            bins.push(Bin {
                u: wu / w,
                v: wv / w,
                variance: 1.0 / w,
            });
        }
    }
    bins
}

/// State and covariance after `dt`, with process noise of density q.
fn predict(s: &State, dt: f64, q: f64) -> State {
    let [v, d, c] = s.x;
    let [a, b, e, f, g, h] = s.p;
    let k = 0.5 * dt * dt;
    // F P Fᵀ with F = [1 dt k; 0 1 dt; 0 0 1]
    let (a1, b1, e1) = (a + dt * b + k * e, b + dt * f + k * g, e + dt * g + k * h);
    let (f1, g1) = (f + dt * g, g + dt * h);
    let dt2 = dt * dt;
    let dt3 = dt2 * dt;
    State {
        x: [v + dt * d + k * c, d + dt * c, c],
        p: [
            a1 + dt * b1 + k * e1 + q * dt3 * dt2 / 20.0,
            b1 + dt * e1 + q * dt2 * dt2 / 8.0,
            e1 + q * dt3 / 6.0,
            f1 + dt * g1 + q * dt3 / 3.0,
            g1 + q * dt2 / 2.0,
            h + q * dt,
        ],
    }
}

/// Takes in an observation of v; also its innovation and the innovation's variance.
fn update(s: &State, v: f64, r: f64) -> (State, f64, f64) {
    let [a, b, e, f, g, h] = s.p;
    let total = a + r;
    let innovation = v - s.x[0];
    let (k0, k1, k2) = (a / total, b / total, e / total);
    let state = State {
        x: [
            s.x[0] + k0 * innovation,
            s.x[1] + k1 * innovation,
            s.x[2] + k2 * innovation,
        ],
        p: [
            a - k0 * a,
            b - k0 * b,
            e - k0 * e,
            f - k1 * b,
            g - k1 * e,
            h - k2 * e,
        ],
    };
    (state, innovation, total)
}

/// What is known before the first bin: next to nothing.
fn prior(first: &Bin, unit: f64) -> State {
    State {
        x: [first.v, 0.0, 0.0],
        p: [1e4, 0.0, 0.0, 10.0, 0.0, (0.1_f64).powi(2).max(unit)],
    }
}

impl Curve {
    /// Fits the curve; `None` below six bins, which cannot tell a curve from noise.
    pub fn fit(samples: &[Sample]) -> Option<Self> {
        let bins = bins(samples);
        if bins.len() < 6 {
            return None;
        }
        let unit = bins.iter().map(|b| b.variance).sum::<f64>() / bins.len() as f64;
        let mut best = (f64::INFINITY, DENSITIES[0], 1.0);
        for density in DENSITIES {
            let q = density * unit;
            let mut state = prior(&bins[0], 0.0);
            let mut last = bins[0].u;
            let (mut squares, mut logs, mut count) = (0.0, 0.0, 0.0);
            for (i, bin) in bins.iter().enumerate() {
                let ahead = predict(&state, bin.u - last, q);
                let (next, innovation, total) = update(&ahead, bin.v, bin.variance);
                if i >= 3 {
                    squares += innovation * innovation / total;
                    logs += total.ln();
                    count += 1.0;
                }
                state = next;
                last = bin.u;
            }
            // −2 ln L with the scale at its best: n ln(scale) + Σ ln S.
            let scale = squares / count;
            let deviance = count * scale.max(1e-12).ln() + logs;
            if deviance < best.0 {
                best = (deviance, density, scale);
            }
        }
        let (_, density, scale) = best;
        let scale = scale.max(1e-6);
        let states = smooth(&bins, density * unit * scale, scale);
        Some(Self {
            bins,
            states,
            scale,
        })
    }

    /// The curve at column u (which may lie between bins, or a few columns past the ends).
    pub fn at(&self, u: f64) -> Smoothed {
        let i = self.bins.partition_point(|b| b.u < u);
        // Between two bins: both parabolas, weighted by nearness.
        let from = |k: usize| -> (f64, f64, f64) {
            let (s, dt) = (&self.states[k], u - self.bins[k].u);
            let ahead = predict(s, dt.abs() * dt.signum(), 0.0);
            (ahead.x[0], ahead.x[1], ahead.p[0])
        };
        let (v, slope, variance) = if i == 0 {
            from(0)
        } else if i == self.bins.len() {
            from(i - 1)
        } else {
            let (a, b) = (from(i - 1), from(i));
            let t = (u - self.bins[i - 1].u) / (self.bins[i].u - self.bins[i - 1].u);
            let mix = |x: f64, y: f64| x + t * (y - x);
            (mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
        };
        Smoothed { v, slope, variance }
    }

    /// Variance of a single column's worth of independent information, px²: a mean over n
    /// columns has this over n.
    pub fn column_variance(&self) -> f64 {
        let mean = self.bins.iter().map(|b| b.variance).sum::<f64>() / self.bins.len() as f64;
        mean * self.scale * BIN as f64
    }
}

/// Filter and smoother with given noise.
fn smooth(bins: &[Bin], q: f64, scale: f64) -> Vec<State> {
    let n = bins.len();
    let mut filtered = Vec::with_capacity(n);
    let mut predicted = Vec::with_capacity(n);
    let mut state = prior(&bins[0], 0.0);
    let mut last = bins[0].u;
    for bin in bins {
        let ahead = predict(&state, bin.u - last, q);
        state = update(&ahead, bin.v, bin.variance * scale).0;
        predicted.push(ahead);
        filtered.push(state);
        last = bin.u;
    }
    let mut states = filtered.clone();
    for i in (0..n - 1).rev() {
        let dt = bins[i + 1].u - bins[i].u;
        states[i] = step_back(&filtered[i], &predicted[i + 1], &states[i + 1], dt);
    }
    states
}

/// One step of the smoother: x + G·(x⁺ − x⁻), P + G·(P⁺ − P⁻)·Gᵀ with G = P·Fᵀ·(P⁻)⁻¹.
fn step_back(filtered: &State, predicted: &State, after: &State, dt: f64) -> State {
    let full =
        |p: &[f64; 6]| nalgebra::Matrix3::new(p[0], p[1], p[2], p[1], p[3], p[4], p[2], p[4], p[5]);
    let f = nalgebra::Matrix3::new(1.0, dt, 0.5 * dt * dt, 0.0, 1.0, dt, 0.0, 0.0, 1.0);
    let (p, ahead, later) = (full(&filtered.p), full(&predicted.p), full(&after.p));
    let Some(inverse) = ahead.try_inverse() else {
        return *filtered;
    };
    let gain = p * f.transpose() * inverse;
    let x = nalgebra::Vector3::from(filtered.x)
        + gain * (nalgebra::Vector3::from(after.x) - nalgebra::Vector3::from(predicted.x));
    let c = p + gain * (later - ahead) * gain.transpose();
    State {
        x: [x[0], x[1], x[2]],
        p: [
            c[(0, 0)],
            c[(0, 1)],
            c[(0, 2)],
            c[(1, 1)],
            c[(1, 2)],
            c[(2, 2)],
        ],
    }
}
