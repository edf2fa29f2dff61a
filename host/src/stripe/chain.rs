//! The profiles of one chain: noise, local width, speckle, then a centre in each column.

use super::link::Chain;
use super::profile::{self, Fit, Noise, Start};
use super::search::Region;
use crate::image::{Image, Pixel};

/// Every how many columns the width is fitted.
pub(super) const STRIDE: usize = 3;

/// Noise of the pixels of `on` − `off` (or of `on` alone) in a part of the image.
pub(super) fn noise_in<P: Pixel>(on: &Image<P>, off: Option<&Image<P>>, region: &Region) -> Noise {
    // Mean |difference of neighbours two rows apart| on a sparse grid, the largest tenth left out
    // (edges, the stripe): 0.80 of the standard deviation of a normal difference's |x| … the
    // truncation at the 90 % point leaves a mean of 0.637 σ.
    let width = on.width();
    let value = |at: usize| -> f32 {
        let x: f32 = on.pixels()[at].into();
        x - off.map_or(0.0, |off| off.pixels()[at].into())
    };
    let area = (region.u1 - region.u0) * (region.v1 - region.v0);
    let step = ((area as f32 / 4096.0).sqrt() as usize).max(1);
    let mut steps = Vec::with_capacity(area / (step * step) + 64);
    for v in (region.v0..region.v1.saturating_sub(2)).step_by(step) {
        for u in (region.u0..region.u1).step_by(step) {
            let at = v * width + u;
            steps.push((value(at) - value(at + 2 * width)).abs());
        }
    }
    let n = steps.len() * 9 / 10;
    let unit = P::MAX / 255.0;
    let sigma = if n > 0 {
        steps.select_nth_unstable_by(n, f32::total_cmp);
        steps[..n].iter().sum::<f32>() / n as f32 / 0.637 / std::f32::consts::SQRT_2
    } else {
        unit
    };
    let quantum = if P::BITS == 8 { 1.0 / 6.0 } else { 0.0 };
    Noise {
        read: sigma * sigma + quantum + 0.02 * unit * unit,
        shot: 0.02 * unit * if off.is_some() { 1.5 } else { 1.0 },
        speckle: 0.15,
        saturation: P::MAX,
    }
}

/// Speckle of a pixel over that of a fitted peak, which averages over the grains along its
/// profile. (Renderings with grains of 1.2 and 1.6 px have 1.4 to 1.6.)
const PIXEL: f32 = 1.5;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "stripe, profiles: width fitted in every so many columns",
            STRIDE.to_string(),
        ),
        (
            "stripe, profiles: speckle of a pixel over that of a peak",
            PIXEL.to_string(),
        ),
    ]
}

/// Fits every column of a chain.
pub(super) fn fit<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    chain: &Chain,
    noise: &Noise,
) -> Vec<Fit> {
    let mut starts: Vec<Start> = chain
        .points
        .iter()
        .map(|p| Start {
            u: p.u,
            centre: f32::from(p.v),
            width: 0.0,
        })
        .collect();
    let rough = rough_width(on, off, &starts);
    for s in &mut starts {
        s.width = rough;
    }
    let half = (3.2 * rough + 2.0).ceil() as usize;
    let sparse: Vec<Start> = starts.iter().step_by(STRIDE).copied().collect();
    let first = profile::fit(on, off, None, &sparse, half, noise, true);
    let widths = local_widths(&first, rough);
    let noise = Noise {
        // Without the image without laser the flanks carry the skin's own pattern: no more weight
        // on them.
        speckle: speckle(&first, noise) * if off.is_some() { PIXEL } else { 1.0 },
        ..*noise
    };
    let starts: Vec<Start> = starts
        .iter()
        .enumerate()
        .map(|(i, s)| Start {
            width: widths[(i / STRIDE).min(widths.len() - 1)],
            ..*s
        })
        .collect();
    profile::fit(on, off, None, &starts, half, &noise, false)
}

/// Width from the mean profile: half its full width at half maximum ÷ 1.177.
pub(super) fn rough_width<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    starts: &[Start],
) -> f32 {
    const REACH: usize = 14;
    let mut mean = [0.0_f32; 2 * REACH + 1];
    let step = (starts.len() / 64).max(1);
    for s in starts.iter().step_by(step) {
        let (u, v) = (usize::from(s.u), s.centre.round().max(0.0) as usize);
        if v < REACH || v + REACH >= on.height() {
            continue;
        }
        for (k, m) in mean.iter_mut().enumerate() {
            let x: f32 = on.at(u, v + k - REACH).into();
            let y: f32 = off.map_or(0.0, |off| off.at(u, v + k - REACH).into());
            *m += x - y;
        }
    }
    let base = (mean[..4].iter().sum::<f32>() + mean[2 * REACH - 3..].iter().sum::<f32>()) / 8.0;
    let top = mean[REACH - 1..=REACH + 1]
        .iter()
        .fold(base, |a, b| a.max(*b));
    let level = base + 0.5 * (top - base);
    let crossing = |towards: isize| -> f32 {
        let mut at = REACH as isize;
        for k in 1..REACH as isize {
            let (near, far) = (
                mean[at as usize],
                mean[(REACH as isize + towards * k) as usize],
            );
            if far < level {
                return (k - 1) as f32 + (near - level) / (near - far).max(1e-6);
            }
            at = REACH as isize + towards * k;
        }
        REACH as f32
    };
    // The search's row is the nearest to a fraction of a pixel: that blurs the mean by 0.3 px.
    let s = (crossing(-1) + crossing(1)) / 2.355;
    (s * s - 0.1).max(0.5).sqrt().min(4.5)
}

/// Median width over the neighbouring fits, then their mean.
fn local_widths(fits: &[Fit], rough: f32) -> Vec<f32> {
    const SIDE: usize = 7;
    let mut window = Vec::with_capacity(2 * SIDE + 1);
    let medians: Vec<f32> = (0..fits.len())
        .map(|i| {
            let (a, b) = (i.saturating_sub(SIDE), (i + SIDE + 1).min(fits.len()));
            window.clear();
            window.extend(
                fits[a..b]
                    .iter()
                    .filter(|f| f.variance.is_finite())
                    .map(|f| f.width),
            );
            if window.len() < 3 {
                return rough;
            }
            let middle = window.len() / 2;
            *window.select_nth_unstable_by(middle, f32::total_cmp).1
        })
        .collect();
    (0..medians.len())
        .map(|i| {
            let near = &medians[i.saturating_sub(2)..(i + 3).min(medians.len())];
            near.iter().sum::<f32>() / near.len() as f32
        })
        .collect()
}

/// Relative scatter of a peak by speckle, from how neighbouring peaks differ.
pub(super) fn speckle(fits: &[Fit], noise: &Noise) -> f32 {
    let mut steps: Vec<f32> = fits
        .windows(2)
        .filter(|w| w[0].variance.is_finite() && w[1].variance.is_finite())
        .filter(|w| w[0].saturated + w[1].saturated == 0.0)
        .map(|w| {
            // Less what read and shot noise explain (a peak is fitted to about 2 s pixels).
            let a = 0.5 * (w[0].peak + w[1].peak);
            let explained = (noise.read + noise.shot * a) / (2.0 * w[0].width * a * a);
            let ratio = (w[0].peak / w[1].peak).ln();
            ratio * ratio / 2.0 - explained
        })
        .collect();
    if steps.len() < 6 {
        return noise.speckle;
    }
    let middle = steps.len() / 2;
    let median = *steps.select_nth_unstable_by(middle, f32::total_cmp).1;
    // The median of a squared normal deviate is 0.455.
    let contrast = (median.max(0.0) / 0.455).sqrt();
    contrast.clamp(0.02, 0.4)
}

/// The median; `None` of nothing.
pub(super) fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    let mut all: Vec<f32> = values.collect();
    if all.is_empty() {
        return None;
    }
    let middle = all.len() / 2;
    Some(*all.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// 0 to 1, from the fit's residual and saturation.
pub(super) fn quality(fit: &Fit) -> f32 {
    let model = 1.0 / (1.0 + (fit.chi2 - 1.0).max(0.0) / 4.0);
    let open = 1.0 - (fit.saturated / (4.0 * fit.width)).min(0.8);
    let precise = 1.0 / (1.0 + 4.0 * fit.variance);
    (model * open * precise).clamp(0.0, 1.0)
}
