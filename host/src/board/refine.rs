//! Sub-pixel corners of a whole board: each [`super::site::Site`] fitted, weighted by the noise that
//! the whole board shows, with the covariance from its normal matrix; corners that go wrong are
//! fitted again from what their neighbours predict.
//!
//! In a point-symmetric patch the position decouples from blur, angles and grey levels, so that
//! they may be wrong together without moving it.

use super::edge_model::{FREE, Parameters, Patch, index};
use super::layout::{Layout, Place};
use super::noise::{Noise, mask_foreign};
use super::site::{BAND, Prior, Site, position_covariance};
use super::{BoardGeometry, Corner, Detection, NotFound, Quality};
use crate::geometry::{Homography, Matrix2, Vector2};
use crate::image::{Image, Pixel};
use crate::median::median;

/// More blur than this part of a square's side, and neighbouring edges run into each other.
pub(super) const MOST_BLUR: f64 = 0.18;
/// A corner with more of its patch covered by something foreign leans on its neighbours ...
const LEANING: f64 = 0.2;
/// ... and with more than this it counts as hidden.
const MOST_MASKED: f64 = 0.8;
/// Edges at least this long, px, have pixels to spare for a first fit.
const MANY: f64 = 8.0;
/// Standard deviation of a pixel's own area, px: √(1/12).
const PIXEL: f64 = 0.288_675_134_594_812_9;
/// Standard deviation that no covariance goes below, px: what the model leaves on clean images.
const FLOOR: f64 = 1e-3;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        ("board: most blur", format!("{MOST_BLUR} of a square")),
        (
            "board: a corner leans on its neighbours, is hidden where covered by more than",
            format!("{:.0} %, {:.0} %", 100.0 * LEANING, 100.0 * MOST_MASKED),
        ),
        ("board: least σ of a corner", format!("{FLOOR} px")),
    ]
}

/// Refines all corners of a layout found at a level of 2ᵏ = `coarseness` pixels a pixel.
pub(super) fn refine<P: Pixel>(
    image: &Image<P>,
    layout: &Layout,
    geometry: &BoardGeometry,
    coarseness: usize,
) -> Result<Detection, NotFound> {
    let mut board = Board::new(image, layout, geometry, coarseness as f64);
    board.approach();
    board.check()?;
    board.finish()
}

/// Refines corners known to a part of a pixel, in the order of [`BoardGeometry::point`], at a known
/// blur, px, and about the noise given, grey.
pub(super) fn again<P: Pixel>(
    image: &Image<P>,
    corners: &[Vector2],
    blur_px: f64,
    noise: f64,
    geometry: &BoardGeometry,
) -> Result<Detection, NotFound> {
    let places = corners.iter().map(|&position| Place {
        position,
        seen: true,
    });
    let layout = Layout {
        places: places.collect(),
        dark_first: false,
    };
    // An edge of a search level c times as coarse as the image starts at a blur of 0.4 + c/2.
    let coarseness = (2.0 * (blur_px.hypot(PIXEL) - 0.4)).max(1.0);
    let mut board = Board::new(image, &layout, geometry, coarseness);
    let brightness: f64 = (0..board.sites.len())
        .map(|i| {
            let [same, other] = board.diagonals(i);
            (same - other) * board.expected_sign(i)
        })
        .sum();
    if brightness < 0.0 {
        board.sign = -1.0;
    }
    if !board.stand(blur_px.hypot(PIXEL), noise) {
        board.approach();
    }
    board.check()?;
    board.finish()
}

struct Board<'a, P> {
    image: &'a Image<P>,
    columns: usize,
    rows: usize,
    sites: Vec<Site>,
    /// Sign of h at corner 0.
    sign: f64,
    coarseness: f64,
    seen: Vec<bool>,
}

impl<'a, P: Pixel> Board<'a, P> {
    fn new(
        image: &'a Image<P>,
        layout: &Layout,
        geometry: &BoardGeometry,
        coarseness: f64,
    ) -> Self {
        let (columns, rows) = (geometry.columns, geometry.rows);
        let site = Site {
            origin: Vector2::zeros(),
            parameters: Parameters {
                free: [0.0; FREE],
                curvature: [0.0; 2],
            },
            patch: Patch::default(),
            steps: [Vector2::zeros(); 2],
            reach: [0.0; 4],
            sound: false,
            masked: 0.0,
            darker: 0.0,
            rough: 0.0,
            leaning: false,
            prior: None,
            residual: Vec::new(),
            pattern: Vec::new(),
        };
        let mut board = Self {
            image,
            columns,
            rows,
            sites: vec![site; columns * rows],
            sign: if layout.dark_first { -1.0 } else { 1.0 },
            coarseness,
            seen: layout.places.iter().map(|p| p.seen).collect(),
        };
        let positions: Vec<Vector2> = layout.places.iter().map(|p| p.position).collect();
        board.measure(&positions);
        for (site, p) in board.sites.iter_mut().zip(&positions) {
            site.origin = *p;
        }
        board
    }

    /// Steps and reach of every site from the positions of its neighbours.
    fn measure(&mut self, positions: &[Vector2]) {
        for i in 0..self.sites.len() {
            let (column, row) = (i % self.columns, i / self.columns);
            for (axis, (place, count, stride)) in
                [(column, self.columns, 1), (row, self.rows, self.columns)]
                    .into_iter()
                    .enumerate()
            {
                let back = (place > 0).then(|| positions[i] - positions[i - stride]);
                let ahead = (place + 1 < count).then(|| positions[i + stride] - positions[i]);
                let step = match (back, ahead) {
                    (Some(a), Some(b)) => (a + b) / 2.0,
                    (Some(a), None) | (None, Some(a)) => a,
                    (None, None) => Vector2::zeros(),
                };
                let site = &mut self.sites[i];
                site.steps[axis] = step;
                site.reach[2 * axis] = back.unwrap_or(step).norm();
                site.reach[2 * axis + 1] = ahead.unwrap_or(step).norm();
            }
        }
        for i in 0..self.sites.len() {
            self.limit_border(i, positions[i]);
        }
    }

    /// The outermost squares may be cut narrower than the others: where the two sides of an edge
    /// do not differ as they should at 0.7 squares outwards, the edge is followed for 0.4 squares.
    fn limit_border(&mut self, i: usize, p: Vector2) {
        let (column, row) = (i % self.columns, i / self.columns);
        let outward = [
            (column == 0, 0, 0, -1.0),
            (column + 1 == self.columns, 1, 0, 1.0),
            (row == 0, 2, 1, -1.0),
            (row + 1 == self.rows, 3, 1, 1.0),
        ];
        for (at_border, side, axis, sign) in outward {
            if !at_border {
                continue;
            }
            let along = self.sites[i].steps[axis] * sign;
            let across = self.sites[i].steps[1 - axis] * 0.3;
            let difference = |t: f64| {
                let q = p + along * t;
                self.grey(q + across) - self.grey(q - across)
            };
            let (near, far) = (difference(0.3), difference(0.75));
            if !(far / near > 0.6 && far / near < 1.6) {
                self.sites[i].reach[side] *= 0.4;
            }
        }
    }

    /// Grey at the nearest pixel.
    fn grey(&self, p: Vector2) -> f64 {
        let u = (p.x.round().max(0.0) as usize).min(self.image.width() - 1);
        let v = (p.y.round().max(0.0) as usize).min(self.image.height() - 1);
        let value: f32 = self.image.at(u, v).into();
        f64::from(value)
    }

    /// Mean grey of the two squares at site i's origin that +x and +y border, and of the other two.
    fn diagonals(&self, i: usize) -> [f64; 2] {
        let site = &self.sites[i];
        let ([ex, ey], p) = (site.steps, site.origin);
        let quadrant = |a: f64, b: f64| self.grey(p + ex * a + ey * b);
        [
            0.5 * (quadrant(0.25, 0.25) + quadrant(-0.25, -0.25)),
            0.5 * (quadrant(0.25, -0.25) + quadrant(-0.25, 0.25)),
        ]
    }

    /// Sign of h: +1 where the square between +x and +y is bright.
    fn expected_sign(&self, i: usize) -> f64 {
        if (i % self.columns + i / self.columns).is_multiple_of(2) {
            self.sign
        } else {
            -self.sign
        }
    }

    /// Every site at its place with a blur of `sigma`, px, in place of a first fit; whether all show
    /// what they should there.
    fn stand(&mut self, sigma: f64, noise: f64) -> bool {
        for i in 0..self.sites.len() {
            let sign = self.expected_sign(i);
            let [same, other] = self.diagonals(i);
            let half = 0.5 * (same - other);
            let site = &mut self.sites[i];
            site.place(site.origin, sigma, 0.5 * (same + other), half);
            site.rough = noise;
            site.sound = half * sign > 0.0;
        }
        self.doubt();
        self.sites.iter().all(|s| s.sound)
    }

    /// First fits on short edges for the corners that the search saw; then the others, and those
    /// whose first fit went wrong, from what the good ones predict.
    fn approach(&mut self) {
        let sigma = 0.4 + 0.5 * self.coarseness;
        for i in 0..self.sites.len() {
            if !self.seen[i] {
                continue;
            }
            let sign = self.expected_sign(i);
            let p = self.sites[i].origin;
            let [ex, ey] = self.sites[i].steps;
            let [same, other] = self.diagonals(i);
            let half = 0.5 * (same - other);
            let image = self.image;
            let site = &mut self.sites[i];
            site.place(p, sigma, 0.5 * (same + other), half);
            let short = 7.0 * self.coarseness.max(1.0);
            let reach = site.reach.map(|r| (0.45 * r).min(short));
            // Every other pixel will do for a start, where there are many.
            let shortest = reach.iter().fold(short, |a: f64, &b| a.min(b));
            let stride = site.stride().max(if shortest < MANY { 1 } else { 2 });
            site.gather(image, reach, BAND * sigma + 0.5, stride);
            let fitted = site.fit(8, 0.1);
            let converged = half * sign > 0.0 && fitted.is_some();
            site.rough = fitted.map_or(0.0, |(_, left)| {
                (left / site.patch.len.saturating_sub(FREE).max(1) as f64).sqrt()
            });
            let shortest = ex.norm().min(ey.norm());
            site.sound = converged && (site.position() - p).norm() < 0.2 * shortest;
        }
        self.doubt();
        let rough = self.rough_noise();
        for i in 0..self.sites.len() {
            if !self.sites[i].sound {
                self.rescue(i, rough);
            }
        }
    }

    /// Root mean square residual of a typical first fit.
    fn rough_noise(&self) -> f64 {
        median(
            &mut self
                .sites
                .iter()
                .filter(|s| s.sound)
                .map(|s| s.rough)
                .collect::<Vec<_>>(),
        )
    }

    /// Marks fits whose contrast or blur differ grossly from the others'.
    fn doubt(&mut self) {
        let sound = |s: &&Site| s.sound;
        let contrast = median(
            &mut self
                .sites
                .iter()
                .filter(sound)
                .map(Site::contrast)
                .collect::<Vec<_>>(),
        );
        let sigma = median(
            &mut self
                .sites
                .iter()
                .filter(sound)
                .map(Site::sigma)
                .collect::<Vec<_>>(),
        );
        for i in 0..self.sites.len() {
            let sign = self.expected_sign(i);
            let s = &mut self.sites[i];
            let c = s.contrast() / contrast;
            let b = s.sigma() / sigma;
            s.sound &= s.parameters.free[index::HALF] * sign > 0.0
                && (0.5..2.0).contains(&c)
                && (0.5..2.0).contains(&b);
        }
    }

    /// Where the sound corners nearby say that corner i is, with the steps there.
    fn predict(&self, i: usize) -> Option<(Vector2, [Vector2; 2], Vec<usize>)> {
        let (column, row) = (i % self.columns, i / self.columns);
        for radius in [2, 3, 5, usize::MAX] {
            let near: Vec<usize> = (0..self.sites.len())
                .filter(|&k| {
                    k != i
                        && self.sites[k].sound
                        && (k % self.columns).abs_diff(column) <= radius
                        && (k / self.columns).abs_diff(row) <= radius
                })
                .collect();
            if near.len() < 8.min(self.sites.len() / 2) {
                continue;
            }
            let from: Vec<Vector2> = near
                .iter()
                .map(|&k| Vector2::new((k % self.columns) as f64, (k / self.columns) as f64))
                .collect();
            let to: Vec<Vector2> = near.iter().map(|&k| self.sites[k].position()).collect();
            if let Ok(map) = Homography::fit(&from, &to) {
                let (p, ex, ey) = super::grid::predict(&map, column as f64, row as f64);
                return Some((p, [ex, ey], near));
            }
        }
        None
    }

    /// A robust fit from the neighbours' prediction, with all foreign pixels left out.
    fn rescue(&mut self, i: usize, rough: f64) {
        let Some((p, steps, near)) = self.predict(i) else {
            return;
        };
        let sign = self.expected_sign(i);
        let of = |f: &dyn Fn(&Site) -> f64| {
            median(&mut near.iter().map(|&k| f(&self.sites[k])).collect::<Vec<_>>())
        };
        let sigma = of(&Site::sigma);
        let mean = of(&|s| s.parameters.free[index::MEAN]);
        let contrast = of(&Site::contrast);
        let image = self.image;
        let site = &mut self.sites[i];
        site.steps = steps;
        site.place(p, sigma, mean, 0.5 * contrast * sign);
        let reach = site.clear_reach();
        site.gather(image, reach, BAND * sigma + 1.0, site.stride());
        let longest = reach.iter().fold(1.0, |a: f64, &b| a.max(b));
        let prior = Prior::around(site.parameters.free, contrast, longest);
        let mut sound = true;
        for part in [0.3, 0.2, 0.12] {
            let noise = Noise::uniform((part * contrast / 4.5).max(rough));
            site.look();
            mask_foreign(site, &noise, true);
            sound &= site
                .fit_near(4, 0.01, Some((&prior, 0.05 * contrast)))
                .is_some();
        }
        let shortest = steps[0].norm().min(steps[1].norm());
        let c = site.contrast() / contrast;
        site.sound = sound
            && site.masked < MOST_MASKED
            && (site.masked < LEANING || site.darker < 0.15)
            && site.parameters.free[index::HALF] * sign > 0.0
            && (site.position() - p).norm() < 0.1 * shortest
            && (0.5..2.0).contains(&c);
        site.prior = Some(prior);
    }

    /// Whether all corners are there, sharp enough.
    fn check(&self) -> Result<(), NotFound> {
        let blur = median(
            &mut self
                .sites
                .iter()
                .filter(|s| s.sound)
                .map(Site::sigma)
                .collect::<Vec<_>>(),
        );
        let shortest = self
            .sites
            .iter()
            .map(|s| s.steps[0].norm().min(s.steps[1].norm()))
            .fold(f64::INFINITY, f64::min);
        let limit = MOST_BLUR * shortest;
        let failed = self.sites.iter().any(|s| !s.sound);
        // Where corners are lost, half the limit is reason enough.
        if blur > limit || (failed && blur > 0.5 * limit) {
            return Err(NotFound::TooBlurred {
                blur_px: point_spread(blur),
                limit_px: point_spread(limit),
            });
        }
        let unsound: Vec<&Site> = self.sites.iter().filter(|s| !s.sound).collect();
        match unsound.first() {
            None => Ok(()),
            Some(first) => Err(NotFound::Hidden {
                hidden: unsound.len(),
                near: first.position(),
            }),
        }
    }

    /// Fits on the whole edges: curvature, noise and foreign pixels settled in between.
    fn finish(mut self) -> Result<Detection, NotFound> {
        let positions: Vec<Vector2> = self.sites.iter().map(Site::position).collect();
        self.measure(&positions);
        let image = self.image;
        let rough = self.rough_noise();
        for site in &mut self.sites {
            let reach = site.clear_reach();
            site.gather(image, reach, BAND * site.sigma() + 0.5, site.stride());
            if site.exceeds(rough) {
                site.look();
                let noise = Noise::uniform((0.15 * site.contrast() / 4.5).max(rough));
                mask_foreign(site, &noise, true);
            }
            let _ = site.fit(5, 0.03);
        }
        self.bend();
        self.sites.iter_mut().for_each(Site::look);
        let mut noise = Noise::estimate(&self.sites);
        let mut covered = false;
        for site in &mut self.sites {
            let mut rounds = 0;
            while mask_foreign(site, &noise, false) && rounds < 3 {
                let _ = site.fit(3, 0.002);
                site.look();
                rounds += 1;
                covered = true;
            }
            site.sound = site.masked < LEANING;
        }
        if covered {
            noise = Noise::estimate(&self.sites);
            for i in 0..self.sites.len() {
                if !self.sites[i].sound {
                    self.rescue(i, rough);
                    let site = &mut self.sites[i];
                    site.look();
                    mask_foreign(site, &noise, false);
                    let prior = site.prior;
                    let held = prior.as_ref().map(|p| (p, noise.edge));
                    let _ = site.fit_near(3, 0.002, held);
                    site.look();
                    mask_foreign(site, &noise, false);
                    // Not to be predicted from.
                    site.leaning = site.sound
                        && site.masked < MOST_MASKED
                        && (site.masked < LEANING || site.darker < 0.15);
                    site.sound = false;
                } else {
                    self.sites[i].prior = None;
                }
            }
            if let Some(hidden) = self.sites.iter().find(|s| !s.sound && !s.leaning) {
                return Err(NotFound::Hidden {
                    hidden: 1,
                    near: hidden.position(),
                });
            }
        } else {
            self.sites.iter_mut().for_each(|s| s.prior = None);
        }
        let mut quality = Quality::default();
        let mut corners = Vec::with_capacity(self.sites.len());
        for site in &mut self.sites {
            noise.weigh(site);
            let used = site.patch.weight.iter().filter(|&&w| w > 0.0).count();
            let freedom = used.saturating_sub(FREE).max(1) as f64;
            let prior = site.prior;
            let fitted = site.fit_near(3, 0.01, prior.as_ref().map(|p| (p, 1.0)));
            let misfit = fitted
                .as_ref()
                .map_or(f64::INFINITY, |(_, left)| (left / freedom).sqrt());
            let covariance = fitted.and_then(|(normal, _)| position_covariance(&normal));
            let Some(covariance) = covariance.filter(|c| c.iter().all(|x| x.is_finite())) else {
                return Err(NotFound::Hidden {
                    hidden: 1,
                    near: site.position(),
                });
            };
            corners.push(Corner {
                pixel: site.position(),
                covariance: covariance * misfit.powi(2).max(1.0)
                    + Matrix2::identity() * FLOOR.powi(2),
            });
            quality.misfit.push(misfit);
            quality.masked.push(site.masked);
        }
        self.describe(&mut quality, &noise);
        let blur = median(&mut self.sites.iter().map(Site::sigma).collect::<Vec<_>>());
        Ok(Detection {
            corners,
            blur_px: point_spread(blur),
            columns: self.columns,
            rows: self.rows,
            quality,
        })
    }

    /// Each line's curvature from three corners in a row, smoothed over the board: lens distortion
    /// bends lines in proportion to their place, so that a linear function fits.
    fn bend(&mut self) {
        let positions: Vec<Vector2> = self.sites.iter().map(Site::position).collect();
        for (axis, stride, place_of) in [(0, 1, 0), (1, self.columns, 1)] {
            let count = [self.columns, self.rows][place_of];
            let mut normal = nalgebra::Matrix3::<f64>::zeros();
            let mut right = nalgebra::Vector3::<f64>::zeros();
            for i in 0..self.sites.len() {
                let place = [i % self.columns, i / self.columns][place_of];
                if place == 0 || place + 1 >= count {
                    continue;
                }
                let (p, a, b) = (positions[i], positions[i - stride], positions[i + stride]);
                let (la, lb) = ((p - a).norm(), (b - p).norm());
                let chord = (a * lb + b * la) / (la + lb);
                let (s, c) = self.sites[i].parameters.free[index::THETA + axis].sin_cos();
                let curvature = 2.0 * (chord - p).dot(&Vector2::new(c, s)) / (la * lb);
                let row = self.place(i);
                normal += row * row.transpose();
                right += row * curvature;
            }
            let Some(cholesky) = normal.cholesky() else {
                continue; // too few corners in a row
            };
            let coefficients = cholesky.solve(&right);
            for i in 0..self.sites.len() {
                self.sites[i].parameters.curvature[axis] = coefficients.dot(&self.place(i));
            }
        }
    }

    fn place(&self, i: usize) -> nalgebra::Vector3<f64> {
        let centred = |x: usize, n: usize| x as f64 - (n as f64 - 1.0) / 2.0;
        nalgebra::Vector3::new(
            1.0,
            centred(i % self.columns, self.columns),
            centred(i / self.columns, self.rows),
        )
    }

    fn describe(&self, quality: &mut Quality, noise: &Noise) {
        let sides = self.sites.iter().flat_map(|s| s.steps.map(|e| e.norm()));
        quality.square_px = sides.fold([f64::INFINITY, 0.0], |[low, high], s| {
            [low.min(s), high.max(s)]
        });
        let level = |sign: f64| {
            let mut all: Vec<f64> = self
                .sites
                .iter()
                .map(|s| s.parameters.free[index::MEAN] + sign * 0.5 * s.contrast())
                .collect();
            median(&mut all)
        };
        quality.white = level(1.0);
        quality.black = level(-1.0);
        quality.noise = [noise.dark, noise.bright];
        let mut white = 0usize;
        let mut saturated = 0usize;
        let middle = (0.5 * (quality.white + quality.black)) as f32;
        for site in &self.sites {
            for &value in &site.patch.value[..site.patch.len] {
                white += usize::from(value > middle);
                saturated += usize::from(value >= P::MAX);
            }
        }
        quality.saturated = saturated as f64 / white.max(1) as f64;
    }
}

/// The point spread's part of an edge's blur.
fn point_spread(sigma: f64) -> f64 {
    (sigma * sigma - PIXEL * PIXEL).max(0.0).sqrt()
}
