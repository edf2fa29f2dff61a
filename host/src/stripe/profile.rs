//! Gaussian profiles fitted across the stripe, sixteen columns at a time.
//!
//! In a column, y(v) = a·ρ(v)·exp(−(v − μ)²/2s²) + b, with ρ the surface's relative albedo where it
//! is known (1 otherwise), weighted by 1/(σ² + κ·(grey value) + (c·a·ρ·g)²): read noise, shot
//! noise and speckle. The last is multiplicative, so that the flanks count for more than they do
//! in a least-squares fit or a centroid. Saturated pixels are censored: they pull only where
//! the model lies below them. Gauss–Newton on (a, b, μ) with s given, or on (a, b, μ, s).
//! Variances are the inverse of the normal matrix; pixels of one speckle grain share their error, so
//! that the caller has to scale them by what the scatter along the stripe shows.

use crate::image::{Image, Pixel};
use crate::simd::widest;

/// Columns fitted at a time.
pub(super) const LANES: usize = 16;
/// Largest half height of a window, rows.
pub(super) const MAX_HALF: usize = 16;
/// Rows of the largest window.
const ROWS: usize = 2 * MAX_HALF + 1;
/// Rows on either side of the window that give the background.
const OUTER: usize = 6;

type Lane = [f32; LANES];

/// How the pixels scatter, and what the stripe's width is about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// Variance of a dark pixel of the difference, grey².
    pub read: f32,
    /// Variance a grey value of signal, grey.
    pub shot: f32,
    /// Relative standard deviation of a pixel by speckle.
    pub speckle: f32,
    /// From this grey value the sensor is saturated.
    pub saturation: f32,
}

/// One fitted profile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fit {
    pub u: u16,
    /// Centre, px.
    pub centre: f32,
    /// Its variance if pixels were independent, px².
    pub variance: f32,
    /// Peak above the background, grey.
    pub peak: f32,
    /// Standard deviation of the profile, px.
    pub width: f32,
    /// Weighted mean square residual (about 1 for a good model without speckle).
    pub chi2: f32,
    /// Saturated pixels in the window.
    pub saturated: f32,
    /// Difference of the background above and below the stripe, grey.
    pub background_step: f32,
}

/// A column to fit: where it is, roughly where the stripe is in it, and how wide.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub u: u16,
    pub centre: f32,
    pub width: f32,
}

/// Windows of sixteen columns, row by row.
struct Windows {
    half: usize,
    /// Row of the window's centre.
    middle: Lane,
    /// Signal less a linear background.
    y: [Lane; ROWS],
    /// All light on the pixel, for the shot noise.
    light: [Lane; ROWS],
    /// Relative albedo.
    albedo: [Lane; ROWS],
    /// 1 for a pixel that counts, 0 for one that does not.
    mask: [Lane; ROWS],
    /// 1 for a saturated pixel.
    saturated: [Lane; ROWS],
    step: Lane,
}

/// Relative albedo of the surface at (column, row), 1 on average over the image's stripe.
pub(super) type Albedo<'a> = &'a dyn Fn(usize, usize) -> f32;

/// Fits all `starts`. With `free_width` each width is fitted too (held near its start by 30 %).
pub(super) fn fit<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    albedo: Option<Albedo>,
    starts: &[Start],
    half: usize,
    noise: &Noise,
    free_width: bool,
) -> Vec<Fit> {
    let half = half.clamp(3, MAX_HALF);
    let mut fits = Vec::with_capacity(starts.len());
    let mut windows = Windows::new(half);
    for group in starts.chunks(LANES) {
        windows.fill(on, off, albedo, group, noise.saturation);
        widest(
            #[inline(always)]
            || windows.solve(group, noise, free_width, &mut fits),
        );
    }
    fits
}

impl Windows {
    fn new(half: usize) -> Self {
        let zero = [[0.0; LANES]; ROWS];
        Self {
            half,
            middle: [0.0; LANES],
            y: zero,
            light: zero,
            albedo: [[1.0; LANES]; ROWS],
            mask: zero,
            saturated: zero,
            step: [0.0; LANES],
        }
    }

    /// Reads the windows of a group of columns.
    fn fill<P: Pixel>(
        &mut self,
        on: &Image<P>,
        off: Option<&Image<P>>,
        albedo: Option<Albedo>,
        group: &[Start],
        saturation: f32,
    ) {
        let height = on.height() as isize;
        let width = on.width();
        let half = self.half as isize;
        let on_pixels = on.pixels();
        let off_pixels = off.map(Image::pixels);
        for l in 0..LANES {
            let Some(start) = group.get(l) else {
                for k in 0..2 * self.half + 1 {
                    self.mask[k][l] = 0.0;
                    self.saturated[k][l] = 0.0;
                    self.y[k][l] = 0.0;
                }
                continue;
            };
            let u = usize::from(start.u);
            let middle = start.centre.round() as isize;
            self.middle[l] = middle as f32;
            let value = |v: isize| -> (f32, f32) {
                let at = v as usize * width + u;
                let raw: f32 = on_pixels[at].into();
                let dark: f32 = off_pixels.map_or(0.0, |off| off[at].into());
                (raw, raw - dark)
            };
            let mean = |from: isize, to: isize| -> Option<f32> {
                let (from, to) = (from.max(0), to.min(height));
                (to - from >= 2)
                    .then(|| (from..to).map(|v| value(v).1).sum::<f32>() / (to - from) as f32)
            };
            let outer = OUTER as isize;
            let above = mean(middle - half - outer, middle - half);
            let below = mean(middle + half + 1, middle + half + 1 + outer);
            let (above, below) = match (above, below) {
                (Some(a), Some(b)) => (a, b),
                (Some(a), None) => (a, a),
                (None, Some(b)) => (b, b),
                (None, None) => (0.0, 0.0),
            };
            let base = 0.5 * (above + below);
            let slope = (below - above) / (2 * half + 1 + outer) as f32;
            self.step[l] = below - above;
            for k in 0..=2 * half {
                let v = middle + k - half;
                let row = k as usize;
                if v < 0 || v >= height {
                    self.mask[row][l] = 0.0;
                    self.saturated[row][l] = 0.0;
                    self.y[row][l] = 0.0;
                    self.light[row][l] = 0.0;
                    continue;
                }
                let (raw, difference) = value(v);
                self.y[row][l] = difference - base - slope * (k - half) as f32;
                self.light[row][l] = raw;
                self.mask[row][l] = 1.0;
                self.saturated[row][l] = if raw >= saturation { 1.0 } else { 0.0 };
                if let Some(albedo) = albedo {
                    self.albedo[row][l] = albedo(u, v as usize);
                }
            }
        }
    }

    /// Fits the group and appends to `fits`.
    #[inline(always)]
    fn solve(&self, group: &[Start], noise: &Noise, free_width: bool, fits: &mut Vec<Fit>) {
        let rows = 2 * self.half + 1;
        let half = self.half as f32;
        let mut width0 = [1.5_f32; LANES];
        let mut start = [0.0_f32; LANES];
        for (l, s) in group.iter().enumerate() {
            width0[l] = s.width;
            start[l] = s.centre - self.middle[l];
        }
        // Start: the largest value near the centre, and the centroid of what lies above its third.
        let mut peak = [1.0_f32; LANES];
        for k in 0..rows {
            let d = k as f32 - half;
            for l in 0..LANES {
                let near = (d - start[l]).abs() <= 2.5;
                let y = if near { self.y[k][l] } else { 0.0 };
                peak[l] = peak[l].max(y);
            }
        }
        let mut moment = [0.0_f32; LANES];
        let mut mass = [1e-6_f32; LANES];
        for k in 0..rows {
            let d = k as f32 - half;
            for l in 0..LANES {
                let reach = 2.0 * width0[l] + 1.0;
                let near = if (d - start[l]).abs() <= reach {
                    1.0
                } else {
                    0.0
                };
                let y = (self.y[k][l] - 0.3 * peak[l]).max(0.0) * near;
                mass[l] += y;
                moment[l] += y * d;
            }
        }
        let mut centre = [0.0_f32; LANES];
        for l in 0..LANES {
            centre[l] = (moment[l] / mass[l]).clamp(start[l] - 3.0, start[l] + 3.0);
        }
        let first = centre;
        let mut base = [0.0_f32; LANES];
        let mut width = width0;
        let mut variance = [0.0_f32; LANES];
        let mut chi2 = [0.0_f32; LANES];
        let steps = if free_width { 6 } else { 4 };
        for _ in 0..steps {
            // Normal matrix (lower triangle) and right side of (a, b, μ, s).
            let mut h = [[0.0_f32; LANES]; 10];
            let mut r = [[0.0_f32; LANES]; 4];
            let mut squares = [0.0_f32; LANES];
            let mut used = [1e-6_f32; LANES];
            let mut inverse = [0.0_f32; LANES];
            for l in 0..LANES {
                inverse[l] = 1.0 / width[l];
            }
            for k in 0..rows {
                let d = k as f32 - half;
                for l in 0..LANES {
                    let t = (d - centre[l]) * inverse[l];
                    let g = exp(-0.5 * t * t) * self.albedo[k][l];
                    let signal = peak[l] * g;
                    let model = signal + base[l];
                    let rough = noise.speckle * signal;
                    let residual = self.y[k][l] - model;
                    // Below a saturated pixel's value the model is wrong, above it may be anything.
                    let open = if self.saturated[k][l] > 0.5 && residual < 0.0 {
                        0.0
                    } else {
                        self.mask[k][l]
                    };
                    let spread = noise.read + noise.shot * self.light[k][l] + rough * rough;
                    let w = open / spread;
                    let jm = signal * t * inverse[l];
                    let js = jm * t;
                    h[0][l] += w * g * g;
                    h[1][l] += w * g;
                    h[2][l] += w;
                    h[3][l] += w * jm * g;
                    h[4][l] += w * jm;
                    h[5][l] += w * jm * jm;
                    h[6][l] += w * js * g;
                    h[7][l] += w * js;
                    h[8][l] += w * js * jm;
                    h[9][l] += w * js * js;
                    let wr = w * residual;
                    r[0][l] += wr * g;
                    r[1][l] += wr;
                    r[2][l] += wr * jm;
                    r[3][l] += wr * js;
                    squares[l] += wr * residual;
                    used[l] += open;
                }
            }
            for l in 0..LANES {
                // The width: free near its start, or held.
                let stiff = if free_width {
                    1.0 / (0.09 * width0[l] * width0[l])
                } else {
                    1e12
                };
                h[9][l] += stiff;
                r[3][l] += stiff * (width0[l] - width[l]);
                // A window that is masked or saturated throughout must not divide by nothing.
                h[0][l] += 1e-9;
                h[2][l] += 1e-6;
                h[5][l] += 1e-6;
                // Cholesky, order (a, b, s, μ): the last pivot is then 1/variance of μ.
                let l00 = h[0][l].sqrt();
                let l10 = h[1][l] / l00;
                let l20 = h[6][l] / l00;
                let l30 = h[3][l] / l00;
                let l11 = (h[2][l] - l10 * l10).max(1e-9).sqrt();
                let l21 = (h[7][l] - l20 * l10) / l11;
                let l31 = (h[4][l] - l30 * l10) / l11;
                let l22 = (h[9][l] - l20 * l20 - l21 * l21).max(1e-9).sqrt();
                let l32 = (h[8][l] - l30 * l20 - l31 * l21) / l22;
                let pivot = (h[5][l] - l30 * l30 - l31 * l31 - l32 * l32).max(1e-9);
                let l33 = pivot.sqrt();
                let y0 = r[0][l] / l00;
                let y1 = (r[1][l] - l10 * y0) / l11;
                let y2 = (r[3][l] - l20 * y0 - l21 * y1) / l22;
                let y3 = (r[2][l] - l30 * y0 - l31 * y1 - l32 * y2) / l33;
                let dm = y3 / l33;
                let ds = (y2 - l32 * dm) / l22;
                let db = (y1 - l21 * ds - l31 * dm) / l11;
                let da = (y0 - l10 * db - l20 * ds - l30 * dm) / l00;
                let step = 0.7 * width[l];
                centre[l] += dm.clamp(-step, step);
                peak[l] = (peak[l] + da).clamp(0.3 * peak[l], 4.0 * peak[l]).max(0.05);
                base[l] += db;
                let step = 0.3 * width[l];
                width[l] += if free_width {
                    ds.clamp(-step, step)
                } else {
                    0.0
                };
                width[l] = width[l].clamp(0.4, 0.6 * half);
                variance[l] = 1.0 / pivot;
                chi2[l] = squares[l] / (used[l] - 4.0).max(1.0);
            }
        }
        for (l, s) in group.iter().enumerate() {
            let mut saturated = 0.0;
            for k in 0..rows {
                saturated += self.saturated[k][l];
            }
            // A centre that ran away is no measurement.
            let lost = !(centre[l].is_finite() && variance[l].is_finite())
                || (centre[l] - first[l]).abs() > 1.5 * width0[l] + 1.0;
            fits.push(Fit {
                u: s.u,
                centre: self.middle[l] + centre[l],
                variance: if lost { f32::INFINITY } else { variance[l] },
                peak: peak[l],
                width: width[l],
                chi2: chi2[l],
                saturated,
                background_step: self.step[l],
            });
        }
    }
}

/// exp(x) for x ≤ 0, to 2e-7·(1 + |x|) of its value: 2^n by the exponent's bits, the rest by a polynomial.
/// (libm's does not become SIMD code.)
#[inline(always)]
fn exp(x: f32) -> f32 {
    let y = (x * std::f32::consts::LOG2_E).max(-126.0);
    let n = (y - 0.5) as i32; // towards zero: the nearest for y ≤ 0
    let f = (y - n as f32) * std::f32::consts::LN_2;
    let p = 1.0 / 720.0;
    let p = p * f + 1.0 / 120.0;
    let p = p * f + 1.0 / 24.0;
    let p = p * f + 1.0 / 6.0;
    let p = p * f + 0.5;
    let p = p * f + 1.0;
    let p = p * f + 1.0;
    f32::from_bits(((n + 127) as u32) << 23) * p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_exponential_is_exp() {
        for i in 0..8700 {
            let x = -0.01 * i as f32;
            let (a, b) = (exp(x), x.exp());
            // The exponent's own rounding costs 6e-8·|x|.
            assert!((a - b).abs() <= 2e-7 * (1.0 - x) * b + 1e-37, "{x} {a} {b}");
        }
    }
}
