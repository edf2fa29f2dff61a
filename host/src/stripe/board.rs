//! The stripe on the checkerboard: centres for the light planes.
//!
//! The stripe is a ridge of on − off, ten times dimmer on black squares than on white ones. The line
//! that it draws is found first (it is straight but for the lens), then a Gaussian profile is
//! fitted in each column with the width that the bright columns show. Where a square's border
//! lies under the profile, the albedo's step would draw the centre to the white side: there the
//! profile is multiplied by the albedo that the image without the laser shows, less the sensor's
//! dark level (found from how the stripe's own brightness follows it); where the step
//! dominates the profile, and without such an image, the column is left out.
//!
//! Speckle grains span columns: every point is the mean over four columns, so that the
//! points' errors are independent, and their variances are scaled to the scatter about the line.

use super::chain;
use super::link::{self, Chain};
use super::outline::Outline;
use super::profile::{self, Fit, Noise, Start};
use super::search::{self, Candidates, MARGIN, Region};
use super::{StripeError, StripePoint};
use crate::geometry::Vector2;
use crate::image::{Image, Pixel};

/// Columns that make one point.
const BIN: usize = 4;
/// Fewest columns with a stripe.
const LEAST: usize = 24;
/// Shortest side of a square, px, without an image to subtract.
const SMALL: f64 = 30.0;
/// How far beside the board a stripe is looked for once there is none on it, squares.
const BESIDE: f64 = 3.0;
/// A slope above which rows are measured rather than columns.
const STEEP: f64 = 1.2;

/// What is decided by, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    vec![
        ("board stripe: columns to a point", BIN.to_string()),
        ("board stripe: fewest columns", LEAST.to_string()),
        (
            "board stripe: shortest square without an image to subtract",
            format!("{SMALL} px"),
        ),
        (
            "board stripe: rows measured above a slope of",
            STEEP.to_string(),
        ),
    ]
}

/// Stripe centres on the board in an image with the laser on; `off` is the same view without it.
/// `corners` are the inner corners in the board's order (`columns` along its long side × `rows`):
/// only the board's area is read. Each point stands for four columns (or rows, where the stripe
/// is steep); the errors of different points are independent.
pub fn extract<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    corners: &[Vector2],
    columns: usize,
    rows: usize,
) -> Result<Vec<StripePoint>, StripeError> {
    if let Some(off) = off {
        super::same_size(on, off)?;
    }
    let bad = StripeError::Corners {
        given: corners.len(),
        columns,
        rows,
    };
    let outline = Outline::new(corners, columns, rows).ok_or(bad.clone())?;
    if off.is_none() {
        let square_px = (corners[1] - corners[0])
            .norm()
            .min((corners[columns] - corners[0]).norm());
        if square_px < SMALL {
            return Err(StripeError::NeedsOff {
                square_px,
                least_px: SMALL,
            });
        }
    }
    let upright = in_columns(on, off, &outline);
    let steep = match &upright {
        Ok((_, slope)) => slope.abs() > STEEP,
        Err(e) => matches!(e, StripeError::NoStripe { .. }),
    };
    if !steep {
        return upright.map(|(points, _)| points);
    }
    let turned: Vec<Vector2> = corners.iter().map(|c| Vector2::new(c.y, c.x)).collect();
    let outline_turned = Outline::new(&turned, columns, rows).ok_or(bad)?;
    let on_turned = super::transposed(on);
    let off_turned = off.map(super::transposed);
    match (
        in_columns(&on_turned, off_turned.as_ref(), &outline_turned),
        upright,
    ) {
        (Ok((mut points, _)), _) => {
            for p in &mut points {
                p.pixel = Vector2::new(p.pixel.y, p.pixel.x);
                p.across = Vector2::new(p.across.y, p.across.x);
            }
            Ok(points)
        }
        (Err(turned), Err(none @ StripeError::NoStripe { .. })) => {
            // What was seen of it was seen the way it runs.
            let none = match (&turned, &none) {
                (
                    StripeError::NoStripe { found: a, .. },
                    StripeError::NoStripe { found: b, .. },
                ) if a > b => turned,
                _ => none,
            };
            let squares = beside(on, off, &outline)
                .or_else(|| beside(&on_turned, off_turned.as_ref(), &outline_turned));
            Err(squares.map_or(none, |squares| StripeError::Beside { squares }))
        }
        (Err(_), upright) => upright.map(|(points, _)| points),
    }
}

/// How far beside a board without a stripe one runs, squares.
fn beside<P: Pixel>(on: &Image<P>, off: Option<&Image<P>>, outline: &Outline) -> Option<f64> {
    let (points, _) = in_columns(on, off, &outline.widened(BESIDE)?).ok()?;
    let squares = outline.beyond(&points.get(points.len() / 2)?.pixel)?;
    // A stripe that ends on the squares is not beside them.
    (squares > 0.2).then_some(squares)
}

/// [`extract`] with one centre a column; also the line's slope.
fn in_columns<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    outline: &Outline,
) -> Result<(Vec<StripePoint>, f64), StripeError> {
    let (low, high) = outline.bounds();
    let inside = |x: f64, end: usize| x.clamp(0.0, end as f64) as usize;
    let margin = (MARGIN + 1) as f64;
    let region = Region {
        u0: inside(low.x.ceil(), on.width()),
        u1: inside(high.x.floor() + 1.0, on.width()),
        v0: inside(low.y - margin, on.height()),
        v1: inside(high.y + margin, on.height()),
    };
    let needed = LEAST.max((region.u1.saturating_sub(region.u0)) / 5);
    let none = |found| StripeError::NoStripe { found, needed };
    if region.u1 < region.u0 + LEAST || region.v1 < region.v0 + 3 * MARGIN {
        return Err(none(0));
    }
    let inside = on_board(&search::candidates(on, off, &region), outline);
    let line = find_line(&inside);
    let found = line.as_ref().map_or(0, |l| l.columns);
    let Some(line) = line.filter(|l| l.columns >= needed) else {
        if let Some(off) = off {
            let inside = on_board(&search::candidates(off, Some(on), &region), outline);
            if find_line(&inside).is_some_and(|l| l.columns >= needed) {
                return Err(StripeError::Swapped);
            }
        }
        return Err(none(found));
    };
    let noise = chain::noise_in(on, off, &region);
    if let Some(off) = off {
        refuse_change(on, off, outline, &region, &line, &noise)?;
    }
    let fits = fit_columns(on, off, outline, &region, &line, &noise);
    let points = points(&fits, &line);
    if points.len() * BIN < needed {
        return Err(none(points.len() * BIN));
    }
    Ok((points, line.slope()))
}

/// The candidates inside the outline.
fn on_board(candidates: &Candidates, outline: &Outline) -> Candidates {
    let mut list = Vec::with_capacity(candidates.list.len());
    let mut first = Vec::with_capacity(candidates.first.len());
    for i in 0..candidates.first.len() - 1 {
        first.push(list.len() as u32);
        let column = candidates.column(i);
        let Some((low, high)) = column.first().and_then(|c| outline.rows(f64::from(c.u))) else {
            continue;
        };
        list.extend(
            column
                .iter()
                .filter(|c| f64::from(c.v) > low && f64::from(c.v) < high),
        );
    }
    first.push(list.len() as u32);
    Candidates { list, first }
}

/// A cubic v(u) about the middle column.
#[derive(Clone, Debug)]
struct Line {
    middle: f64,
    scale: f64,
    coefficients: [f64; 4],
    /// Columns that show it.
    columns: usize,
}

impl Line {
    fn at(&self, u: f64) -> f64 {
        let x = (u - self.middle) / self.scale;
        let [a, b, c, d] = self.coefficients;
        a + x * (b + x * (c + x * d))
    }

    fn slope(&self) -> f64 {
        self.coefficients[1] / self.scale
    }

    /// Weighted least squares of the given degree.
    fn fit(points: impl Iterator<Item = (f64, f64, f64)> + Clone, degree: usize) -> Option<Self> {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (u, _, _) in points.clone() {
            low = low.min(u);
            high = high.max(u);
        }
        let (middle, scale) = (0.5 * (low + high), (0.5 * (high - low)).max(1.0));
        let mut h = nalgebra::Matrix4::<f64>::zeros();
        let mut r = nalgebra::Vector4::<f64>::zeros();
        let mut columns = 0;
        for (u, v, w) in points {
            let x = (u - middle) / scale;
            let mut row = nalgebra::Vector4::new(1.0, x, x * x, x * x * x);
            row.rows_range_mut(degree + 1..).fill(0.0);
            h += w * row * row.transpose();
            r += w * v * row;
            columns += 1;
        }
        for k in degree + 1..4 {
            h[(k, k)] = 1.0;
        }
        let c = h.cholesky()?.solve(&r);
        Some(Self {
            middle,
            scale,
            coefficients: [c[0], c[1], c[2], c[3]],
            columns,
        })
    }
}

/// The line that most columns show. White squares show long pieces of it, black ones at least
/// candidates; a row of squares taken for a stripe (without an image to subtract) shows nothing on its black ones.
fn find_line(candidates: &Candidates) -> Option<Line> {
    let chains = link::chains(candidates, 6);
    let mut best: Option<Line> = None;
    for seed in 0..chains.len().min(10) {
        let Some(mut line) = grow(&chains, seed) else {
            continue;
        };
        // Columns whose candidate lies on the line, of those that have any candidate at all.
        let columns = candidates.first.len() - 1;
        let (mut on_line, mut first, mut last) = (0, usize::MAX, 0);
        for i in 0..columns {
            let column = candidates.column(i);
            if column
                .iter()
                .any(|c| (f64::from(c.v) - line.at(f64::from(c.u))).abs() < 2.5)
            {
                on_line += 1;
                first = first.min(i);
                last = last.max(i);
            }
        }
        // Three fifths of the columns between its ends: less is a row of bright squares.
        if on_line == 0 || 5 * on_line < 3 * (last - first + 1) {
            continue;
        }
        line.columns = on_line;
        if best.as_ref().is_none_or(|b| line.columns > b.columns) {
            best = Some(line);
        }
    }
    best
}

/// Joins to a chain all that lie on its continuation, the nearest first.
fn grow(chains: &[Chain], seed: usize) -> Option<Line> {
    let mut member = vec![false; chains.len()];
    member[seed] = true;
    loop {
        let points = chains
            .iter()
            .zip(&member)
            .filter(|(_, m)| **m)
            .flat_map(|(c, _)| &c.points)
            .map(|p| (f64::from(p.u), f64::from(p.v), 1.0));
        let joined = member.iter().filter(|m| **m).count();
        let line = Line::fit(points, if joined > 3 { 2 } else { 1 })?;
        // A short piece points only roughly: the allowance grows with the distance from it.
        let nearest = (0..chains.len())
            .filter(|i| !member[*i])
            .filter_map(|i| {
                let p = chains[i].points.get(chains[i].points.len() / 2)?;
                let u = f64::from(p.u);
                let away = ((u - line.middle).abs() - line.scale).max(0.0);
                let miss = (f64::from(p.v) - line.at(u)).abs();
                (miss < 2.5 + 1.5 * away / line.scale).then_some((i, away))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((i, _)) => member[i] = true,
            None => return Some(line),
        }
    }
}

/// Off the stripe, both images must show the same board.
fn refuse_change<P: Pixel>(
    on: &Image<P>,
    off: &Image<P>,
    outline: &Outline,
    region: &Region,
    line: &Line,
    noise: &Noise,
) -> Result<(), StripeError> {
    let mut steps = Vec::new();
    let mut changed = 0;
    for u in (region.u0..region.u1).step_by(9) {
        let Some((low, high)) = outline.rows(u as f64) else {
            continue;
        };
        let centre = line.at(u as f64);
        let rows = low.max(0.0) as usize..(high.max(0.0) as usize).min(on.height());
        for v in rows.step_by(7) {
            if (v as f64 - centre).abs() < 30.0 {
                continue;
            }
            let (a, b): (f32, f32) = (on.at(u, v).into(), off.at(u, v).into());
            let step = (a - b).abs();
            let spread = noise.read + noise.shot * a;
            changed += usize::from(step * step > 64.0 * spread);
            steps.push(step);
        }
    }
    if steps.len() < 50 || changed * 4 < steps.len() {
        return Ok(());
    }
    let middle = steps.len() / 2;
    Err(StripeError::SceneChanged {
        grey: *steps.select_nth_unstable_by(middle, f32::total_cmp).1,
    })
}

/// A fitted column and what the albedo does under it.
#[derive(Clone, Copy, Debug)]
struct Column {
    fit: Fit,
    /// How far the albedo's step moves the light's centre of mass, px.
    moved: f32,
}

/// Fits every column in which the line lies on the board.
fn fit_columns<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    outline: &Outline,
    region: &Region,
    line: &Line,
    noise: &Noise,
) -> Vec<Column> {
    let mut starts = Vec::with_capacity(region.u1 - region.u0);
    for u in region.u0..region.u1 {
        let centre = line.at(u as f64);
        let Some((low, high)) = outline.rows(u as f64) else {
            continue;
        };
        if centre > low + 2.0 && centre < high - 2.0 && centre < on.height() as f64 - 2.0 {
            starts.push(Start {
                u: u as u16,
                centre: centre as f32,
                width: 0.0,
            });
        }
    }
    let rough = chain::rough_width(on, off, &starts);
    for s in &mut starts {
        s.width = rough;
    }
    // Without an image to subtract the window must stay inside a square.
    let half = match off {
        Some(_) => (3.2 * rough + 2.0).ceil() as usize,
        None => (2.8 * rough + 1.0).ceil() as usize,
    };
    let sparse: Vec<Start> = starts.iter().step_by(chain::STRIDE).copied().collect();
    let first = profile::fit(on, off, None, &sparse, half, noise, true);
    // Widths and speckle from the bright columns: on black squares the noise rules.
    let bright = upper_quartile(first.iter().map(|f| f.peak)) * 0.4;
    let bright: Vec<Fit> = first.into_iter().filter(|f| f.peak > bright).collect();
    let width = chain::median(bright.iter().map(|f| f.width)).unwrap_or(rough);
    let noise = Noise {
        speckle: chain::speckle(&bright, noise),
        ..*noise
    };
    for s in &mut starts {
        s.width = width;
    }
    let Some(off) = off else {
        // A border under the profile shows as a step of the background.
        return profile::fit(on, None, None, &starts, half, &noise, false)
            .into_iter()
            .map(|fit| Column {
                fit,
                moved: if fit.background_step.abs() > 0.1 * fit.peak {
                    f32::INFINITY
                } else {
                    0.0
                },
            })
            .collect();
    };
    let plain = profile::fit(on, Some(off), None, &starts, half, &noise, false);
    let dark = dark_level(off, &plain, half);
    // Columns with a border within reach of the profile.
    let mut borders = vec![None; on.width()];
    for s in &starts {
        borders[usize::from(s.u)] = border(off, s, dark, &noise);
    }
    let albedo = |u: usize, v: usize| -> f32 {
        let Some(Border { white, .. }) = &borders[u] else {
            return 1.0;
        };
        let x: f32 = off.at(u, v).into();
        ((x - dark) / white).max(0.0)
    };
    let again: Vec<Start> = starts
        .iter()
        .filter(|s| borders[usize::from(s.u)].is_some())
        .copied()
        .collect();
    let mut second = profile::fit(on, Some(off), Some(&albedo), &again, half, &noise, false)
        .into_iter()
        .peekable();
    plain
        .into_iter()
        .map(|fit| {
            let fit = second.next_if(|f| f.u == fit.u).unwrap_or(fit);
            Column {
                fit,
                moved: borders[usize::from(fit.u)].map_or(0.0, |b| b.moved),
            }
        })
        .collect()
}

fn upper_quartile(values: impl Iterator<Item = f32>) -> f32 {
    let mut all: Vec<f32> = values.collect();
    if all.is_empty() {
        return 0.0;
    }
    let at = all.len() * 3 / 4;
    *all.select_nth_unstable_by(at, f32::total_cmp).1
}

/// The sensor's dark level: where the line through (off, stripe's peak) of black and white squares
/// meets zero.
fn dark_level<P: Pixel>(off: &Image<P>, fits: &[Fit], half: usize) -> f32 {
    let mut black = (0.0_f32, 0.0_f32, 0.0_f32);
    let mut white = (0.0_f32, 0.0_f32, 0.0_f32);
    let mean: Vec<Option<f32>> = fits
        .iter()
        .map(|f| {
            let v = f.centre.round().max(0.0) as usize;
            let (a, b) = (
                v.saturating_sub(half / 2),
                (v + half / 2 + 1).min(off.height()),
            );
            let (mut low, mut high, mut sum) = (f32::INFINITY, 0.0_f32, 0.0);
            for row in a..b {
                let x: f32 = off.at(usize::from(f.u), row).into();
                low = low.min(x);
                high = high.max(x);
                sum += x;
            }
            let mean = sum / (b - a) as f32;
            (b > a && f.variance.is_finite() && high - low < 0.4 * mean.max(8.0)).then_some(mean)
        })
        .collect();
    let level = upper_quartile(mean.iter().flatten().copied());
    for (f, m) in fits.iter().zip(&mean) {
        let Some(m) = m else { continue };
        let side = if *m < 0.4 * level {
            &mut black
        } else if *m > 0.7 * level {
            &mut white
        } else {
            continue;
        };
        side.0 += 1.0;
        side.1 += m;
        side.2 += f.peak;
    }
    if black.0 < 8.0 || white.0 < 8.0 {
        return 0.0;
    }
    let (xb, yb) = (black.1 / black.0, black.2 / black.0);
    let (xw, yw) = (white.1 / white.0, white.2 / white.0);
    ((xb * yw - xw * yb) / (yw - yb).max(1e-3)).clamp(0.0, 0.95 * xb)
}

/// A square's border under the profile.
#[derive(Clone, Copy, Debug)]
struct Border {
    /// How far it moves the profile's centre of mass, px.
    moved: f32,
    /// The brightest value there, less the dark level.
    white: f32,
}

/// The border under the profile; `None` where the albedo is even.
fn border<P: Pixel>(off: &Image<P>, start: &Start, dark: f32, noise: &Noise) -> Option<Border> {
    let reach = (3.5 * start.width).ceil() as isize;
    let middle = start.centre.round() as isize;
    let rows = (middle - reach).max(0)..(middle + reach + 1).min(off.height() as isize);
    let value = |v: isize| -> f32 { off.at(usize::from(start.u), v as usize).into() };
    let (mut low, mut high) = (f32::INFINITY, 0.0_f32);
    for v in rows.clone() {
        let x = value(v);
        low = low.min(x);
        high = high.max(x);
    }
    // Eight standard deviations: noise alone never looks like a border.
    let step = high - low;
    if step * step <= 64.0 * (noise.read + noise.shot * high) {
        return None;
    }
    let (mut mass, mut moment) = (1e-6_f32, 0.0_f32);
    for v in rows {
        let d = v as f32 - start.centre;
        let t = d / start.width;
        let light = (value(v) - dark).max(0.0) * (-0.5 * t * t).exp();
        mass += light;
        moment += light * d;
    }
    Some(Border {
        moved: moment / mass,
        white: (high - dark).max(1.0),
    })
}

/// Points of four columns each, outliers left out, variances scaled to the scatter.
fn points(columns: &[Column], line: &Line) -> Vec<StripePoint> {
    let usable: Vec<&Column> = columns
        .iter()
        .filter(|c| c.fit.variance.is_finite() && c.fit.peak > 0.0)
        .filter(|c| c.moved.abs() < 0.3 * c.fit.width)
        .collect();
    let weight = |c: &Column| {
        // What a border leaves uncertain, beside the fit's own variance.
        let border = 0.1 * f64::from(c.moved);
        1.0 / (f64::from(c.fit.variance * c.fit.chi2.max(1.0)) + border * border + 1e-4)
    };
    let mut keep: Vec<bool> = usable
        .iter()
        .map(|c| (f64::from(c.fit.centre) - line.at(f64::from(c.fit.u))).abs() < 4.0)
        .collect();
    for _ in 0..3 {
        let good = usable
            .iter()
            .zip(&keep)
            .filter(|(_, k)| **k)
            .map(|(c, _)| (f64::from(c.fit.u), f64::from(c.fit.centre), weight(c)));
        let Some(curve) = Line::fit(good, 3) else {
            return Vec::new();
        };
        let ratio = |c: &Column| {
            let e = f64::from(c.fit.centre) - curve.at(f64::from(c.fit.u));
            (e * e * weight(c)) as f32
        };
        let kept = usable.iter().zip(&keep).filter(|(_, k)| **k);
        let Some(median) = chain::median(kept.map(|(c, _)| ratio(c))) else {
            return Vec::new();
        };
        let limit = 16.0 * (median / 0.455).max(0.2);
        for (k, c) in keep.iter_mut().zip(&usable) {
            *k = ratio(c) < limit;
        }
    }
    let good: Vec<&Column> = usable
        .iter()
        .zip(&keep)
        .filter(|(_, k)| **k)
        .map(|(c, _)| *c)
        .collect();
    let mut points = Vec::with_capacity(good.len() / BIN + 2);
    let mut i = 0;
    while i < good.len() {
        let cell = usize::from(good[i].fit.u) / BIN;
        let mut sums = [0.0_f64; 6];
        let mut count = 0.0;
        while i < good.len() && usize::from(good[i].fit.u) / BIN == cell {
            let (c, w) = (good[i], weight(good[i]));
            sums[0] += w;
            sums[1] += w * f64::from(c.fit.u);
            sums[2] += w * f64::from(c.fit.centre);
            sums[3] += f64::from(c.fit.peak);
            sums[4] += f64::from(c.fit.width);
            sums[5] += f64::from(chain::quality(&c.fit));
            count += 1.0;
            i += 1;
        }
        points.push(StripePoint {
            pixel: Vector2::new(sums[1] / sums[0], sums[2] / sums[0]),
            across: Vector2::new(0.0, 1.0),
            variance: 1.0 / sums[0],
            intensity: (sums[3] / count) as f32,
            width_px: (sums[4] / count) as f32,
            quality: (sums[5] / count) as f32,
        });
    }
    scale_variances(&mut points);
    points
}

/// Scales the variances to the scatter about the line: bright and dim points each for themselves, for
/// speckle rules the one and the sensor's noise the other.
fn scale_variances(points: &mut [StripePoint]) {
    let all = points
        .iter()
        .map(|p| (p.pixel.x, p.pixel.y, 1.0 / p.variance));
    let Some(curve) = Line::fit(all, 3) else {
        return;
    };
    let bright = 0.4 * upper_quartile(points.iter().map(|p| p.intensity));
    for is_bright in [true, false] {
        let class = |p: &StripePoint| (p.intensity > bright) == is_bright;
        let mut ratios = Vec::new();
        for p in points.iter().filter(|p| class(p)) {
            let e = p.pixel.y - curve.at(p.pixel.x);
            ratios.push(e * e / p.variance);
        }
        // Few points say little about their own scatter: a prior worth eight of them, at the
        // factor that speckle of two to three columns' width gives.
        let n = ratios.len() as f64;
        let scale = (ratios.iter().sum::<f64>() + 8.0 * 2.0) / (n + 8.0);
        for p in points.iter_mut().filter(|p| class(p)) {
            p.variance *= scale;
        }
    }
}
