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
use crate::simd::Lanes;
use pulp::{Simd, WithSimd};

/// Columns fitted at a time.
pub(super) const LANES: usize = 16;
/// Largest half height of a window, rows.
pub(super) const MAX_HALF: usize = 16;
/// Rows of the largest window.
const ROWS: usize = 2 * MAX_HALF + 1;
/// Rows on either side of the window that give the background.
const OUTER: usize = 6;

/// A step of this length, px, is the last, for the next would be shorter by far ...
const ENOUGH: f32 = 3e-3;
/// ... and so is one of this part of its own standard deviation.
const NOTHING: f32 = 0.05;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "stripe, profiles: largest half height of a window",
            format!("{MAX_HALF} rows"),
        ),
        (
            "stripe, profiles: rows on either side for the background",
            OUTER.to_string(),
        ),
        (
            "stripe, profiles: the last step is below",
            format!("{ENOUGH} px or {NOTHING} σ"),
        ),
    ]
}

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
    /// Variance by read and shot noise.
    spread: [Lane; ROWS],
    /// Relative albedo.
    albedo: [Lane; ROWS],
    /// 1 for a pixel that counts, 0 for one that does not.
    mask: [Lane; ROWS],
    /// Least residual that counts: a saturated pixel's is 0, for the model may lie above it.
    least: [Lane; ROWS],
    /// Saturated pixels.
    saturated: Lane,
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
        windows.fill(on, off, albedo, group, noise);
        let mut work = Work {
            windows: &windows,
            speckle: noise.speckle,
            free_width,
            solved: Solved::start(group, &windows.middle),
        };
        pulp::Arch::new().dispatch(&mut work);
        let solved = work.solved;
        fits.extend(group.iter().enumerate().map(|(l, start)| {
            let (centre, variance) = (solved.centre[l], solved.variance[l]);
            // A centre that ran away is no measurement.
            let lost = !(centre.is_finite() && variance.is_finite())
                || (centre - solved.first[l]).abs() > 1.5 * start.width + 1.0;
            Fit {
                u: start.u,
                centre: windows.middle[l] + centre,
                variance: if lost { f32::INFINITY } else { variance },
                peak: solved.peak[l],
                width: solved.width[l],
                chi2: solved.chi2[l],
                saturated: windows.saturated[l],
                background_step: windows.step[l],
            }
        }));
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
            spread: [[1.0; LANES]; ROWS],
            albedo: [[1.0; LANES]; ROWS],
            mask: zero,
            least: [[f32::NEG_INFINITY; LANES]; ROWS],
            saturated: [0.0; LANES],
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
        noise: &Noise,
    ) {
        let height = on.height() as isize;
        let width = on.width();
        let half = self.half as isize;
        let on_pixels = on.pixels();
        let off_pixels = off.map(Image::pixels);
        for l in 0..LANES {
            self.saturated[l] = 0.0;
            let Some(start) = group.get(l) else {
                for k in 0..2 * self.half + 1 {
                    self.mask[k][l] = 0.0;
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
                    self.y[row][l] = 0.0;
                    continue;
                }
                let (raw, difference) = value(v);
                self.y[row][l] = difference - base - slope * (k - half) as f32;
                self.spread[row][l] = noise.read + noise.shot * raw;
                self.mask[row][l] = 1.0;
                let saturated = raw >= noise.saturation;
                self.least[row][l] = if saturated { 0.0 } else { f32::NEG_INFINITY };
                self.saturated[l] += f32::from(u8::from(saturated));
                if let Some(albedo) = albedo {
                    self.albedo[row][l] = albedo(u, v as usize);
                }
            }
        }
    }
}

/// Sixteen columns' parameters; centres count from the windows' middles.
struct Solved {
    centre: Lane,
    /// The centre that the iteration started from.
    first: Lane,
    peak: Lane,
    width: Lane,
    variance: Lane,
    chi2: Lane,
}

impl Solved {
    fn start(group: &[Start], middle: &Lane) -> Self {
        let mut first = [0.0; LANES];
        let mut width = [1.5; LANES];
        for (l, start) in group.iter().enumerate() {
            first[l] = start.centre - middle[l];
            width[l] = start.width;
        }
        Self {
            centre: first,
            first,
            peak: [1.0; LANES],
            width,
            variance: [0.0; LANES],
            chi2: [0.0; LANES],
        }
    }
}

/// A group to solve, as many columns at once as a register holds.
struct Work<'a> {
    windows: &'a Windows,
    speckle: f32,
    free_width: bool,
    solved: Solved,
}

impl WithSimd for &mut Work<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for block in 0..LANES / S::F32_LANES {
            if self.free_width {
                self.solve::<S, 4>(simd, block);
            } else {
                self.solve::<S, 3>(simd, block);
            }
        }
    }
}

impl Work<'_> {
    /// Gauss–Newton on (a, b, μ) for FREE = 3, on (a, b, μ, s) for 4.
    #[inline(always)]
    fn solve<S: Simd, const FREE: usize>(&mut self, simd: S, block: usize) {
        let windows = self.windows;
        let rows = 2 * windows.half + 1;
        let half = windows.half as f32;
        let c = |x: f32| Lanes::splat(simd, x);
        let (zero, one) = (c(0.0), c(1.0));
        let take = |lane: &Lane| Lanes::new(simd, S::as_simd_f32s(lane).0[block]);
        let start = take(&self.solved.centre);
        let width0 = take(&self.solved.width);

        // Start: the largest value near the centre, and the centroid of what lies above its third.
        let mut peak = one;
        for k in 0..rows {
            let away = (c(k as f32 - half) - start).abs();
            peak = peak.larger(take(&windows.y[k]).where_at_least(c(2.5), away));
        }
        let reach = c(2.0) * width0 + one;
        let third = c(0.3) * peak;
        let (mut moment, mut mass) = (zero, c(1e-6));
        for k in 0..rows {
            let d = c(k as f32 - half);
            let y = (take(&windows.y[k]) - third).at_least(0.0);
            let y = y.where_at_least(reach, (d - start).abs());
            mass = mass + y;
            moment = y.times_plus(d, moment);
        }
        let mut centre = (moment / mass).between(start - c(3.0), start + c(3.0));
        let first = centre;
        let mut width = width0;
        let mut base = zero;
        let (mut variance, mut chi2) = (zero, zero);
        let speckle = c(self.speckle);
        for _ in 0..if FREE == 4 { 6 } else { 4 } {
            // Normal matrix (lower triangle) and right side of (a, b, μ, s).
            let mut h = [zero; 10];
            let mut r = [zero; 4];
            let (mut squares, mut used) = (zero, c(1e-6));
            let inverse = width.reciprocal();
            for k in 0..rows {
                let t = (c(k as f32 - half) - centre) * inverse;
                let exponent = (t * t * c(-0.5 * std::f32::consts::LOG2_E)).at_least(-100.0);
                let g = exponent.power_of_two() * take(&windows.albedo[k]);
                let signal = peak * g;
                let residual = take(&windows.y[k]) - signal - base;
                let rough = speckle * signal;
                // Below a saturated pixel's value the model is wrong, above it may be anything.
                let open = take(&windows.mask[k]).where_at_least(residual, take(&windows.least[k]));
                let w = open / rough.times_plus(rough, take(&windows.spread[k]));
                let jm = signal * t * inverse;
                let (wg, wm, wr) = (w * g, w * jm, w * residual);
                h[0] = wg.times_plus(g, h[0]);
                h[1] = h[1] + wg;
                h[2] = h[2] + w;
                h[3] = wm.times_plus(g, h[3]);
                h[4] = h[4] + wm;
                h[5] = wm.times_plus(jm, h[5]);
                r[0] = wr.times_plus(g, r[0]);
                r[1] = r[1] + wr;
                r[2] = wr.times_plus(jm, r[2]);
                if FREE == 4 {
                    let js = jm * t;
                    let ws = w * js;
                    h[6] = ws.times_plus(g, h[6]);
                    h[7] = h[7] + ws;
                    h[8] = ws.times_plus(jm, h[8]);
                    h[9] = ws.times_plus(js, h[9]);
                    r[3] = wr.times_plus(js, r[3]);
                }
                squares = wr.times_plus(residual, squares);
                used = used + open;
            }
            // A window that is masked or saturated throughout must not divide by nothing.
            let tiny = c(1e-9);
            // Cholesky, order (a, b, s, μ): the last pivot is then 1/variance of μ.
            let l00 = (h[0] + tiny).square_root();
            let (l10, l30) = (h[1] / l00, h[3] / l00);
            let l11 = (h[2] + c(1e-6) - l10 * l10).larger(tiny).square_root();
            let l31 = (h[4] - l30 * l10) / l11;
            let y0 = r[0] / l00;
            let y1 = (r[1] - l10 * y0) / l11;
            let mut pivot = h[5] + c(1e-6) - l30 * l30 - l31 * l31;
            let mut right = r[2] - l30 * y0 - l31 * y1;
            let (mut l20, mut l21, mut l22, mut l32, mut y2) = (zero, zero, one, zero, zero);
            if FREE == 4 {
                // The width is free near its start.
                let stiff = (c(0.09) * width0 * width0).reciprocal();
                l20 = h[6] / l00;
                l21 = (h[7] - l20 * l10) / l11;
                let square = h[9] + stiff - l20 * l20 - l21 * l21;
                l22 = square.larger(tiny).square_root();
                l32 = (h[8] - l30 * l20 - l31 * l21) / l22;
                y2 = (r[3] + stiff * (width0 - width) - l20 * y0 - l21 * y1) / l22;
                pivot = pivot - l32 * l32;
                right = right - l32 * y2;
            }
            let pivot = pivot.larger(tiny);
            let l33 = pivot.square_root();
            // y3 is the centre's step in standard deviations.
            let y3 = right / l33;
            let dm = y3 / l33;
            let ds = (y2 - l32 * dm) / l22;
            let db = (y1 - l21 * ds - l31 * dm) / l11;
            let da = (y0 - l10 * db - l20 * ds - l30 * dm) / l00;
            let step = c(0.7) * width;
            centre = centre + dm.between(-step, step);
            peak = (peak + da)
                .between(c(0.3) * peak, c(4.0) * peak)
                .at_least(0.05);
            base = base + db;
            let mut left = (dm * c(1.0 / ENOUGH)).abs();
            left = left.smaller((y3 * c(1.0 / NOTHING)).abs());
            if FREE == 4 {
                let step = c(0.3) * width;
                width = (width + ds.between(-step, step)).between(c(0.4), c(0.6 * half));
                let wide = (ds * c(1.0 / (8.0 * ENOUGH))).abs();
                left = left.larger(wide.smaller((y2 * c(1.0 / NOTHING)).abs()));
            }
            variance = pivot.reciprocal();
            chi2 = squares / (used - c(4.0)).at_least(1.0);
            if left.maximum() < 1.0 {
                break;
            }
        }
        let put = |lane: &mut Lane, value: Lanes<S>| {
            S::as_mut_simd_f32s(lane).0[block] = value.value;
        };
        put(&mut self.solved.centre, centre);
        put(&mut self.solved.first, first);
        put(&mut self.solved.peak, peak);
        put(&mut self.solved.width, width);
        put(&mut self.solved.variance, variance);
        put(&mut self.solved.chi2, chi2);
    }
}
