//! The stripe on skin: one sub-pixel centre a column, in segments without a jump.
//!
//! A search over the whole frame gives candidates a column (`search`), continuity makes
//! chains of them (`link`), a Gaussian profile with the width of its neighbourhood is
//! fitted in each column (`profile`), and the centres are smoothed along the stripe as
//! far as their scatter bears it (`smooth`).
//!
//! Skin's albedo changes under the profile (veins, spots) and draws the centre towards the brighter
//! side: a Gaussian of width s times exp(g·v) is the same Gaussian moved by s²·g, with g the
//! logarithmic gradient of the albedo. The ambient image shows g, and the centre is moved back.

use super::chain;
use super::link::{self, Chain};
use super::profile::{Fit, Noise};
use super::search::{self, Region};
use super::smooth::{Curve, Sample, Scatter};
use super::{Axis, StripeError, StripePoint};
use crate::geometry::Vector2;
use crate::image::{Image, Pixel};

/// What to expect of the stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSettings {
    /// Along which axis the stripe is searched.
    pub axis: Axis,
    /// Smooth the centres along the stripe, as far as the data bear it.
    pub smooth: bool,
    /// Correct the centres for the albedo's gradient in the ambient image.
    pub albedo: bool,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self {
            axis: Axis::Columns,
            smooth: true,
            albedo: true,
        }
    }
}

/// Where a segment of the stripe lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// On the nearest bright surface: the hand.
    Hand,
    /// Beyond a depth jump and much dimmer: the table behind.
    Background,
}

/// A piece of the stripe without a jump.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Its points, in ascending column (or row).
    pub points: Vec<StripePoint>,
    /// What it lies on.
    pub surface: Surface,
    /// How many neighbouring points share one error (speckle grains are wider than a pixel, and
    /// smoothing widens them): the variance of a mean of n points is `variance · correlation / n`.
    pub correlation: f64,
    /// The same points as they were measured, without smoothing: for whoever fits a surface to
    /// them, who knows better how far it may be smoothed.
    pub measured: Vec<StripePoint>,
    /// As `correlation`, of `measured`.
    pub grain: f64,
}

/// Columns left out at each end of a segment: the edge of the surface is blurred into them.
const END: usize = 2;
/// Fewest columns of a segment.
const LEAST: usize = 10;
/// Columns on either side that vote on a jump, and on the local width.
const SIDE: usize = 8;

/// The stripe's segments in a frame with the laser on; `ambient` is the same view without it.
/// No stripe is an empty list; images of two sizes, or swapped ones, are errors.
pub fn extract<P: Pixel>(
    image: &Image<P>,
    ambient: Option<&Image<P>>,
    settings: &HandSettings,
) -> Result<Vec<Segment>, StripeError> {
    if let Some(ambient) = ambient {
        super::same_size(image, ambient)?;
    }
    match settings.axis {
        Axis::Columns => in_columns(image, ambient, settings),
        Axis::Rows => {
            let turned = super::transposed(image);
            let turned_ambient = ambient.map(super::transposed);
            let mut segments = in_columns(&turned, turned_ambient.as_ref(), settings)?;
            for point in segments
                .iter_mut()
                .flat_map(|s| s.points.iter_mut().chain(&mut s.measured))
            {
                point.pixel = Vector2::new(point.pixel.y, point.pixel.x);
                point.across = Vector2::new(point.across.y, point.across.x);
            }
            Ok(segments)
        }
    }
}

/// [`extract`] with one centre a column.
fn in_columns<P: Pixel>(
    image: &Image<P>,
    ambient: Option<&Image<P>>,
    settings: &HandSettings,
) -> Result<Vec<Segment>, StripeError> {
    let region = Region::whole(image);
    let candidates = search::candidates(image, ambient, &region);
    let mut chains = link::chains(&candidates, LEAST);
    if let Some(ambient) = ambient {
        refuse_swapped(image, ambient, &chains)?;
    }
    chains.sort_by_key(|c| c.points.first().map_or(0, |p| p.u));
    let noise = chain::noise_in(image, ambient, &region);
    let faint = faint(&chains);
    let mut segments = Vec::new();
    for chain in &mut chains {
        let sparse = chain.brightness() < faint;
        if sparse {
            let mut column = 0;
            chain.points.retain(|_| {
                column += 1;
                column % SPARSE == 1
            });
        }
        measure(
            image,
            ambient,
            chain,
            &noise,
            settings,
            sparse,
            &mut segments,
        );
    }
    classify(&mut segments);
    Ok(segments)
}

/// The response below which a chain is surely background: it is measured in every fourth column
/// and not smoothed, since nothing is decided on it.
fn faint(chains: &[Chain]) -> f32 {
    let main = chains.iter().max_by_key(|c| c.strength);
    main.map_or(0.0, |c| FAINT * c.brightness())
}

/// Part of the main chain's response below which another is surely background.
const FAINT: f32 = 0.2;
/// Every how many columns such a chain is measured.
const SPARSE: usize = 4;

/// If the ambient image has a clear stripe and the frame has none, they are swapped.
fn refuse_swapped<P: Pixel>(
    image: &Image<P>,
    ambient: &Image<P>,
    chains: &[Chain],
) -> Result<(), StripeError> {
    let found: usize = chains.iter().map(|c| c.points.len()).sum();
    if found * 10 > image.width() {
        return Ok(());
    }
    let reversed = search::candidates(ambient, Some(image), &Region::whole(image));
    let there = link::chains(&reversed, LEAST);
    let reversed: usize = there.iter().map(|c| c.points.len()).sum();
    if reversed * 10 > image.width() && reversed > 4 * found {
        return Err(StripeError::Swapped);
    }
    Ok(())
}

/// Fits, splits and smooths one chain.
fn measure<P: Pixel>(
    image: &Image<P>,
    ambient: Option<&Image<P>>,
    chain: &Chain,
    noise: &Noise,
    settings: &HandSettings,
    sparse: bool,
    segments: &mut Vec<Segment>,
) {
    let mut fits: Vec<Fit> = chain::fit(image, ambient, chain, noise);
    fits.retain(|f| f.variance.is_finite());
    if let (Some(ambient), true) = (ambient, settings.albedo) {
        correct_for_albedo(ambient, &mut fits);
    }
    for piece in split(&fits) {
        if let Some(segment) = segment(trimmed(piece), settings, sparse) {
            segments.push(segment);
        }
    }
}

/// Moves each centre back by s²·d ln ρ/dv, ρ from the ambient image; takes out those on an edge
/// so steep that the profile is cut rather than moved.
fn correct_for_albedo<P: Pixel>(ambient: &Image<P>, fits: &mut Vec<Fit>) {
    let slopes: Vec<Option<f32>> = fits.iter().map(|fit| log_slope(ambient, fit)).collect();
    for (i, fit) in fits.iter_mut().enumerate() {
        let near = &slopes[i.saturating_sub(4)..(i + 5).min(slopes.len())];
        let known = near.iter().flatten();
        let mean = known.clone().sum::<f32>() / (known.count() as f32).max(1.0);
        fit.centre -= mean * fit.width * fit.width;
    }
    let mut cut = slopes.iter().map(Option::is_none);
    fits.retain(|_| cut.next() != Some(true));
}

/// The steepest course of ln ρ that moves a profile by a shift of its centre, 1/px.
const STEEP: f32 = 0.15;

/// Least-squares slope of ln ρ over ± 2 s, at least five rows; shrunk where it is dim and the slope
/// is mostly noise. `None` where it is too steep.
fn log_slope<P: Pixel>(ambient: &Image<P>, fit: &Fit) -> Option<f32> {
    let reach = (2.0 * fit.width).ceil().clamp(2.0, 8.0) as usize;
    let middle = fit.centre.round() as usize;
    if middle < reach || middle + reach >= ambient.height() {
        return Some(0.0);
    }
    let (mut sum, mut moment, mut squares) = (0.0, 0.0, 0.0);
    for k in 0..=2 * reach {
        let d = k as f32 - reach as f32;
        let y: f32 = ambient.at(usize::from(fit.u), middle + k - reach).into();
        sum += y;
        moment += d * y;
        squares += d * d;
    }
    let mean = sum / (2 * reach + 1) as f32;
    let slope = moment / squares / mean.max(1.0);
    let dark = 8.0 * P::MAX / 255.0;
    let slope = slope * mean * mean / (mean * mean + dark * dark);
    (slope.abs() <= STEEP).then_some(slope)
}

/// Pieces between gaps and jumps.
fn split(fits: &[Fit]) -> Vec<&[Fit]> {
    let mut cuts = vec![0];
    let mut i = 1;
    while i < fits.len() {
        if fits[i].u - fits[i - 1].u > SIDE as u16 || jump(fits, i, *cuts.last().unwrap_or(&0)) {
            cuts.push(i);
        }
        i += 1;
    }
    cuts.push(fits.len());
    cuts.windows(2).map(|w| &fits[w[0]..w[1]]).collect()
}

/// Without the columns at either end in which the light fades out: there the profile is cut by
/// the surface's edge, or already on what lies behind.
fn trimmed(fits: &[Fit]) -> &[Fit] {
    let n = fits.len();
    let level = |inner: &[Fit]| chain::median(inner.iter().map(|f| f.peak)).unwrap_or(0.0);
    let (mut a, mut b) = (0, n);
    while a + LEAST < n && fits[a].peak < FADED * level(&fits[a + 1..(a + 2 * SIDE).min(n)]) {
        a += 1;
    }
    while b > a + LEAST
        && fits[b - 1].peak < FADED * level(&fits[b.saturating_sub(2 * SIDE)..b - 1])
    {
        b -= 1;
    }
    &fits[a..b]
}

/// Part of its neighbours' brightness below which an end column is on the edge.
const FADED: f32 = 0.35;

/// Whether the lines through the columns before and after `i` miss each other there.
fn jump(fits: &[Fit], i: usize, start: usize) -> bool {
    let (a, b) = (
        i.saturating_sub(SIDE).max(start),
        (i + SIDE).min(fits.len()),
    );
    if i - a < 4 || b - i < 4 {
        return false;
    }
    let at = 0.5 * (f32::from(fits[i - 1].u) + f32::from(fits[i].u));
    let (Some(before), Some(after)) = (line(&fits[a..i], at), line(&fits[i..b], at)) else {
        return false;
    };
    let miss = (before.0 - after.0).abs();
    miss > 1.5 && miss * miss > 36.0 * (before.1 + after.1)
}

/// A line through the centres, at column `at`: its row, and the row's variance from the scatter.
fn line(fits: &[Fit], at: f32) -> Option<(f32, f32)> {
    let n = fits.len() as f32;
    let (mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0);
    let v0 = fits.first()?.centre;
    for f in fits {
        let (x, y) = (f32::from(f.u) - at, f.centre - v0);
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
    }
    let det = n * sxx - sx * sx;
    if det < 1e-3 {
        return None;
    }
    let intercept = (sxx * sy - sx * sxy) / det;
    let slope = (n * sxy - sx * sy) / det;
    let squares: f32 = fits
        .iter()
        .map(|f| (f.centre - v0 - intercept - slope * (f32::from(f.u) - at)).powi(2))
        .sum();
    let variance = (squares / (n - 2.0)).max(0.0025) * sxx / det;
    Some((v0 + intercept, variance))
}

/// One segment of a continuous piece; `None` if too little of it is good.
fn segment(fits: &[Fit], settings: &HandSettings, sparse: bool) -> Option<Segment> {
    if fits.len() < LEAST {
        return None;
    }
    let all: Vec<Sample> = fits
        .iter()
        .map(|f| Sample {
            u: usize::from(f.u),
            v: f64::from(f.centre),
            variance: f64::from(f.variance * f.chi2.max(1.0)) + 1e-5,
        })
        .collect();
    let mut keep = near_median(&all);
    // Twice: gross outliers bend the first curve.
    let mut curve = None;
    for _ in 0..if sparse { 0 } else { 2 } {
        let good: Vec<Sample> = all
            .iter()
            .zip(&keep)
            .filter(|(_, k)| **k)
            .map(|(s, _)| *s)
            .collect();
        curve = Curve::fit(&good);
        let Some(curve) = &curve else { break };
        let mut changed = false;
        for (k, s) in keep.iter_mut().zip(&all) {
            let e = s.v - curve.at(s.u).v;
            let good = e * e < OUTLIER * OUTLIER * s.variance * curve.scatter.scale;
            changed |= good != *k;
            *k = good;
        }
        if !changed {
            break;
        }
    }
    let scatter = curve.as_ref().map_or(Scatter::USUAL, |c| c.scatter);
    let smoothed = curve.as_ref().filter(|_| settings.smooth);
    let mut measured: Vec<StripePoint> = fits
        .iter()
        .zip(&all)
        .zip(&keep)
        .filter(|(_, k)| **k)
        .map(|((fit, sample), _)| StripePoint {
            pixel: Vector2::new(sample.u as f64, sample.v),
            across: Vector2::new(0.0, 1.0),
            variance: sample.variance * scatter.scale + FLOOR * FLOOR,
            intensity: fit.peak,
            width_px: fit.width,
            quality: chain::quality(fit),
        })
        .collect();
    if measured.len() < LEAST {
        return None;
    }
    measured.truncate(measured.len() - END);
    measured.drain(..END);
    let mut points = measured.clone();
    if let Some(curve) = smoothed {
        for p in &mut points {
            let s = curve.at(p.pixel.x as usize);
            p.pixel.y = s.v;
            p.variance = s.variance + FLOOR * FLOOR;
        }
    }
    let n = points.len() as f64;
    let mean = points.iter().map(|p| p.variance).sum::<f64>() / n;
    // Smoothing moves information between columns but makes none: a mean over many columns keeps
    // the variance that the raw centres give it.
    let raw = all.iter().map(|s| s.variance).sum::<f64>() / all.len() as f64;
    let correlation = (raw * scatter.scale * scatter.columns() / mean).max(1.0);
    Some(Segment {
        points,
        surface: Surface::Hand,
        correlation,
        measured,
        grain: scatter.columns(),
    })
}

/// Standard deviations from the curve beyond which a centre is dropped.
const OUTLIER: f64 = 4.5;

/// What no smoothing takes away: model error of the profile, px.
const FLOOR: f64 = 0.01;

/// Columns within reach of their neighbours' median line.
fn near_median(samples: &[Sample]) -> Vec<bool> {
    let n = samples.len();
    let mut window = Vec::with_capacity(2 * SIDE + 1);
    (0..n)
        .map(|i| {
            let (a, b) = (i.saturating_sub(SIDE), (i + SIDE + 1).min(n));
            // Slope from the ends' medians of three, so that a steep stripe is not cut.
            let third = |j: usize| {
                let mut three = [samples[j].v, samples[j + 1].v, samples[j + 2].v];
                three.sort_by(f64::total_cmp);
                (samples[j + 1].u as f64, three[1])
            };
            let ((u0, v0), (u1, v1)) = (third(a), third(b - 3));
            let slope = if u1 > u0 { (v1 - v0) / (u1 - u0) } else { 0.0 };
            window.clear();
            window.extend(
                samples[a..b]
                    .iter()
                    .map(|s| s.v - slope * (s.u as f64 - samples[i].u as f64)),
            );
            let middle = window.len() / 2;
            let median = *window.select_nth_unstable_by(middle, f64::total_cmp).1;
            (samples[i].v - median).abs() < 2.0
        })
        .collect()
}

/// Segments much dimmer than the strongest are the background, unless bright ones lie on both
/// sides and they continue them (a dark patch of the same surface).
fn classify(segments: &mut [Segment]) {
    let brightness: Vec<f32> = segments
        .iter()
        .map(|s| chain::median(s.points.iter().map(|p| p.intensity)).unwrap_or(0.0))
        .collect();
    let Some(main) = (0..segments.len()).max_by(|&a, &b| {
        let energy = |i: usize| brightness[i] * segments[i].points.len() as f32;
        energy(a).total_cmp(&energy(b))
    }) else {
        return;
    };
    let bright = |i: usize| brightness[i] >= DIM * brightness[main];
    // Segments are in ascending columns.
    for i in 0..segments.len() {
        let between = i > 0
            && i + 1 < segments.len()
            && bright(i - 1)
            && bright(i + 1)
            && continues(&segments[i - 1], &segments[i])
            && continues(&segments[i], &segments[i + 1]);
        if !bright(i) && !between {
            segments[i].surface = Surface::Background;
        }
    }
}

/// Part of the hand's brightness below which a segment is taken for the background.
const DIM: f32 = 0.35;

/// What is decided by, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "hand stripe: fewest columns of a segment",
            LEAST.to_string(),
        ),
        ("hand stripe: columns left out at each end", END.to_string()),
        (
            "hand stripe: a chain is surely background below, of the main one’s response",
            format!("{:.0} %", f64::from(100.0 * FAINT)),
        ),
        (
            "hand stripe: columns on either side that vote on a jump",
            SIDE.to_string(),
        ),
        (
            "hand stripe: background below, of the hand’s brightness",
            format!("{:.0} %", f64::from(100.0 * DIM)),
        ),
        (
            "hand stripe: an end column is on the edge below, of its neighbours’ brightness",
            format!("{:.0} %", f64::from(100.0 * FADED)),
        ),
        (
            "hand stripe: centres dropped beyond",
            format!("{OUTLIER} σ"),
        ),
        ("hand stripe: least σ of a centre", format!("{FLOOR} px")),
        (
            "hand stripe: centres dropped where brightness changes along the profile by more than",
            format!("{:.0} % a pixel", 100.0 * STEEP),
        ),
    ]
}

/// Whether the second segment begins where the first would go on.
fn continues(before: &Segment, after: &Segment) -> bool {
    let (Some(a), Some(b)) = (before.points.last(), after.points.first()) else {
        return false;
    };
    let gap = b.pixel.x - a.pixel.x;
    gap < 40.0 && (b.pixel.y - a.pixel.y).abs() < 3.0 + 0.5 * gap
}
