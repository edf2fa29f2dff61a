//! One corner on its way: its pixels along the two edges, and the Gauss–Newton fit of
//! [`super::edge_model`] to them, with a prior from the neighbours where too few of its own show it.

use super::edge_model::{FREE, Normal, Parameters, Patch, accumulate, index, residuals};
use crate::geometry::{Matrix2, Vector2};
use crate::image::{Image, Pixel};
use nalgebra::{SMatrix, SVector};

/// The longest edge used on each side of a corner, px.
const LONGEST: f64 = 48.0;
/// Part of a square's side that an edge is followed along.
const ALONG: f64 = 0.85;
/// Half the width of the band of pixels around an edge: this many blurs, and a pixel's half.
pub(super) const BAND: f64 = 3.3;
/// Standard deviation of a corner's place as its neighbours' homography predicts it, px.
const PREDICTED: f64 = 0.1;

/// A corner on its way.
#[derive(Clone, Debug)]
pub(super) struct Site {
    /// Pixel that the patch's coordinates count from.
    pub(super) origin: Vector2,
    pub(super) parameters: Parameters,
    pub(super) patch: Patch,
    /// Steps to the next corner along x and y, px.
    pub(super) steps: [Vector2; 2],
    /// How far the two edges may be followed: −x, +x, −y, +y, px.
    pub(super) reach: [f64; 4],
    /// Whether the fit can be believed so far.
    pub(super) sound: bool,
    pub(super) masked: f64,
    /// Part of the foreign pixels that are darker than the board: a stripe only adds light.
    pub(super) darker: f64,
    /// Root mean square residual of the first fit.
    pub(super) rough: f64,
    /// Sound with the help of its neighbours.
    pub(super) leaning: bool,
    /// What the neighbours say, for a corner that too few of its own pixels show.
    pub(super) prior: Option<Prior>,
    /// Value − model and K of each pixel of the patch when last looked at.
    pub(super) residual: Vec<f32>,
    pub(super) pattern: Vec<f32>,
}

impl Site {
    pub(super) fn position(&self) -> Vector2 {
        let f = &self.parameters.free;
        self.origin + Vector2::new(f[index::X], f[index::Y])
    }

    /// Every how many pixels are worth taking: a wide blur carries little per pixel.
    pub(super) fn stride(&self) -> usize {
        ((self.sigma() / 2.0) as usize).max(1)
    }

    pub(super) fn contrast(&self) -> f64 {
        2.0 * self.parameters.free[index::HALF].abs()
    }

    pub(super) fn sigma(&self) -> f64 {
        self.parameters.free[index::SIGMA]
    }

    /// Starts at `p` with edges along the steps and no shading.
    pub(super) fn place(&mut self, p: Vector2, sigma: f64, mean: f64, half: f64) {
        self.origin = p.map(f64::round);
        // Normals: of the x line towards +y, of the y line towards +x, so that the square between
        // +x and +y has K > 0.
        let normal = |along: Vector2, towards: Vector2| {
            let n = Vector2::new(-along.y, along.x);
            let n = if n.dot(&towards) < 0.0 { -n } else { n };
            n.y.atan2(n.x)
        };
        let d = p - self.origin;
        let [ex, ey] = self.steps;
        let mut free = [0.0; FREE];
        free[index::X] = d.x;
        free[index::Y] = d.y;
        free[index::THETA] = normal(ex, ey);
        free[index::THETA + 1] = normal(ey, ex);
        free[index::SIGMA] = sigma;
        free[index::MEAN] = mean;
        free[index::HALF] = half;
        self.parameters.free = free;
    }

    /// Takes the pixels within `band` of either edge, no farther along than `reach`, every `stride`-th
    /// of every `stride`-th row.
    pub(super) fn gather<P: Pixel>(
        &mut self,
        image: &Image<P>,
        reach: [f64; 4],
        band: f64,
        stride: usize,
    ) {
        self.patch.clear();
        let f = &self.parameters.free;
        let (x0, y0) = (f[index::X], f[index::Y]);
        let lines = [0, 1].map(|i| {
            let (s, c) = f[index::THETA + i].sin_cos();
            let along = Vector2::new(s, -c);
            // `reach` counts along the steps.
            let sign = if along.dot(&self.steps[i]) < 0.0 {
                -1.0
            } else {
                1.0
            };
            let along = along * sign;
            [
                Strip::new(Vector2::new(c, s), [-band, band]),
                Strip::new(along, [-reach[2 * i], reach[2 * i + 1]]),
            ]
        });
        let farthest = reach.iter().fold(0.0, |a: f64, &b| a.max(b)) + band;
        let (w, h) = (image.width() as i64, image.height() as i64);
        let (ou, ov) = (self.origin.x as i64, self.origin.y as i64);
        let first = ceil(y0 - farthest).max(-ov);
        let last = floor(y0 + farthest).min(h - 1 - ov);
        let mut y = first;
        while y <= last {
            let dy = y as f64 - y0;
            let mut spans = lines.map(|[across, along]| {
                let (a, b) = across.span(dy);
                let (c, d) = along.span(dy);
                let low = ceil(x0 + a.max(c)).max(-ou);
                let high = floor(x0 + b.min(d)).min(w - 1 - ou);
                (low, high)
            });
            spans.sort_unstable();
            let row = image.row((y + ov) as usize);
            let mut next = i64::MIN;
            for (low, high) in spans {
                let mut x = low.max(next);
                // On the lattice that all rows share.
                x += (stride as i64 - x.rem_euclid(stride as i64)) % stride as i64;
                if x <= high {
                    let pixels = &row[(x + ou) as usize..=(high + ou) as usize];
                    self.patch.append(x, y, pixels, stride);
                }
                next = next.max(high + 1);
            }
            y += stride as i64;
        }
        self.patch.finish();
    }

    /// Gauss–Newton steps until the position moves by less than `enough`, px, and the blur by less
    /// than a tenth; `None` when the fit fails. Returns the last step's normal equations, and the weighted square sum of the residual
    /// that they predict after it.
    pub(super) fn fit(&mut self, steps: usize, enough: f64) -> Option<(Normal, f64)> {
        self.fit_near(steps, enough, None)
    }

    /// [`Site::fit`], held near a prior where one is given with the residual's standard deviation.
    pub(super) fn fit_near(
        &mut self,
        steps: usize,
        enough: f64,
        prior: Option<(&Prior, f64)>,
    ) -> Option<(Normal, f64)> {
        let mut last = None;
        for _ in 0..steps {
            let mut normal = accumulate(&self.patch, &self.parameters);
            if let Some((prior, noise)) = prior {
                for i in 0..FREE {
                    let weight = (noise / prior.deviation[i]).powi(2);
                    normal.products[i][i] += weight;
                    normal.products[i][FREE] += weight * (prior.free[i] - self.parameters.free[i]);
                }
            }
            let mut delta = solve(&normal)?;
            let gain: f64 = (0..FREE).map(|i| delta[i] * normal.products[i][FREE]).sum();
            let sigma = self.sigma();
            // No farther than the linearisation holds.
            let moved = delta[index::X].hypot(delta[index::Y]);
            let limit = 1.5 * sigma;
            if moved > limit {
                delta *= limit / moved;
            }
            for i in 0..2 {
                delta[index::THETA + i] = delta[index::THETA + i].clamp(-0.15, 0.15);
            }
            let f = &mut self.parameters.free;
            for (f, d) in f.iter_mut().zip(delta.iter()) {
                *f += d;
            }
            f[index::SIGMA] = f[index::SIGMA].clamp(0.6 * sigma, 1.6 * sigma).max(0.3);
            if !f.iter().all(|x| x.is_finite()) {
                return None;
            }
            let left = (normal.products[FREE][FREE] - gain).max(0.0);
            last = Some((normal, left));
            // The blur comes from afar and takes the longest.
            if moved < enough && (self.sigma() / sigma - 1.0).abs() < 0.1 {
                break;
            }
        }
        last
    }

    /// Brings residual and pattern up to date.
    pub(super) fn look(&mut self) {
        residuals(
            &self.patch,
            &self.parameters,
            &mut self.residual,
            &mut self.pattern,
        );
    }

    /// Whether some pixel is much brighter or darker than white and black are here.
    pub(super) fn exceeds(&self, noise: f64) -> bool {
        let mean = self.parameters.free[index::MEAN];
        let limit = 0.6 * self.contrast() + 5.0 * noise;
        let values = &self.patch.value[..self.patch.len];
        let (low, high) = values
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), &v| {
                (a.min(v), b.max(v))
            });
        f64::from(high) > mean + limit || f64::from(low) < mean - limit
    }

    /// How far edges may be followed at this blur.
    pub(super) fn clear_reach(&self) -> [f64; 4] {
        let edge = 3.5 * self.sigma() + 1.0;
        let shortest = self.steps[0].norm().min(self.steps[1].norm());
        self.reach
            .map(|r| (r - edge).min(ALONG * r).min(LONGEST).max(0.3 * shortest))
    }
}

/// Where a corner's parameters are expected: their values and standard deviations.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    free: [f64; FREE],
    deviation: [f64; FREE],
}

impl Prior {
    /// Around a corner's parameters as its neighbours predict them.
    pub(super) fn around(free: [f64; FREE], contrast: f64, reach: f64) -> Self {
        let grey = 0.1 * contrast;
        let slope = grey / reach;
        let sigma = 0.1 * free[index::SIGMA];
        let deviation = [
            PREDICTED, PREDICTED, 0.03, 0.03, sigma, grey, slope, slope, grey, slope, slope,
        ];
        Self { free, deviation }
    }
}

/// The points between two parallel lines: low ≤ n·(dx, dy) ≤ high.
#[derive(Clone, Copy)]
struct Strip {
    normal: Vector2,
    /// 1 ÷ n's x; infinite where the lines run along the rows.
    inverse: f64,
    limits: [f64; 2],
}

impl Strip {
    fn new(normal: Vector2, limits: [f64; 2]) -> Self {
        let inverse = if normal.x.abs() < 1e-9 {
            f64::INFINITY
        } else {
            1.0 / normal.x
        };
        Self {
            normal,
            inverse,
            limits,
        }
    }

    /// The dx inside, in the row at dy.
    fn span(&self, dy: f64) -> (f64, f64) {
        let rest = self.normal.y * dy;
        let [low, high] = self.limits;
        if self.inverse.is_infinite() {
            return if (low..=high).contains(&rest) {
                (-1e9, 1e9)
            } else {
                (1e9, -1e9)
            };
        }
        let (a, b) = ((low - rest) * self.inverse, (high - rest) * self.inverse);
        (a.min(b), a.max(b))
    }
}

/// Plain code: the library's functions are calls where the processor's rounding is not to be had.
fn floor(x: f64) -> i64 {
    let i = x as i64;
    i - i64::from(i as f64 > x)
}

fn ceil(x: f64) -> i64 {
    -floor(-x)
}

/// The step of the normal equations, scaled to unit diagonal; `None` if they are singular.
fn solve(normal: &Normal) -> Option<SVector<f64, FREE>> {
    let (matrix, scale) = scaled(normal)?;
    let right = SVector::<f64, FREE>::from_fn(|i, _| normal.products[i][FREE] * scale[i]);
    let step = matrix.cholesky()?.solve(&right);
    Some(step.component_mul(&scale))
}

fn scaled(normal: &Normal) -> Option<(SMatrix<f64, FREE, FREE>, SVector<f64, FREE>)> {
    let p = &normal.products;
    let scale = SVector::<f64, FREE>::from_fn(|i, _| 1.0 / p[i][i].sqrt());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let matrix =
        SMatrix::from_fn(|i, j| p[i][j] * scale[i] * scale[j] + if i == j { 1e-7 } else { 0.0 });
    Some((matrix, scale))
}

/// The position's covariance in units of the weights.
pub(super) fn position_covariance(normal: &Normal) -> Option<Matrix2> {
    let (matrix, scale) = scaled(normal)?;
    let inverse = matrix.cholesky()?.inverse();
    let at = |i: usize, j: usize| inverse[(i, j)] * scale[i] * scale[j];
    Some(Matrix2::new(at(0, 0), at(0, 1), at(1, 0), at(1, 1)))
}
