//! Images of one pose stacked: the mean of the image without the laser and of those with it, away
//! from the stripe. The board stands still between them, so that fourteen images have a quarter of
//! the noise of one, and the corners with it.

use super::{BoardGeometry, Detection, NotFound, refine, search};
use crate::geometry::Vector2;
use crate::image::{Image, Pixel};
use crate::simd::widest;

/// Squares around the outer corners that belong to the stack.
const AROUND: f64 = 1.1;
/// A mean has this many times the steps of 8 bits: 256·64 fits 16 bits.
const STEPS: f32 = 64.0;
/// Corners that move by more than this, px, are not those of the same pose.
const MOST_MOVED: f64 = 0.5;

/// Pixels that can be summed: in the fewest bits that hold [`Summable::MOST`] of them, since the time
/// goes into memory.
pub trait Summable: Pixel {
    /// What holds a sum.
    type Sum: Copy + Default + Send + std::fmt::Debug;
    /// Most images of one stack.
    const MOST: u32;
    /// Factor from a pixel's units to the mean's.
    const SCALE: f32;
    /// `sum` and one more.
    fn add(sum: Self::Sum, pixel: Self) -> Self::Sum;
    /// The sum.
    fn total(sum: Self::Sum) -> f32;
}

impl Summable for u8 {
    type Sum = u16;
    const MOST: u32 = 257;
    const SCALE: f32 = STEPS;
    #[inline(always)]
    fn add(sum: u16, pixel: u8) -> u16 {
        sum.wrapping_add(u16::from(pixel))
    }
    #[inline(always)]
    fn total(sum: u16) -> f32 {
        f32::from(sum)
    }
}

impl Summable for u16 {
    type Sum = u32;
    const MOST: u32 = 65_537;
    const SCALE: f32 = 1.0;
    #[inline(always)]
    fn add(sum: u32, pixel: u16) -> u32 {
        sum.wrapping_add(u32::from(pixel))
    }
    #[inline(always)]
    fn total(sum: u32) -> f32 {
        sum as f32
    }
}

/// The board's part of some images of one pose.
#[derive(Clone, Debug)]
pub struct Stack<P: Summable> {
    /// The part's first pixel.
    origin: (usize, usize),
    width: usize,
    height: usize,
    sums: Vec<P::Sum>,
    images: u32,
    bands: Vec<Band>,
}

/// The pixels within `half` of the line n·p = c are left out of one image.
#[derive(Clone, Copy, Debug)]
struct Band {
    normal: Vector2,
    offset: f64,
    half: f64,
}

impl Band {
    /// Around the line through points (total least squares); `None` if they show no line.
    fn around(points: &[Vector2], half: f64) -> Option<Self> {
        if points.len() < 2 {
            return None;
        }
        let mean = points.iter().sum::<Vector2>() / points.len() as f64;
        let spread: crate::geometry::Matrix2 = points
            .iter()
            .map(|p| (p - mean) * (p - mean).transpose())
            .sum();
        let eigen = spread.symmetric_eigen();
        let across = usize::from(eigen.eigenvalues[1] < eigen.eigenvalues[0]);
        let normal: Vector2 = eigen.eigenvectors.column(across).into();
        normal.iter().all(|x| x.is_finite()).then_some(Self {
            normal,
            offset: normal.dot(&mean),
            half,
        })
    }

    /// The columns left out of row `v`, of `width` columns from `u0`: first and one past the last.
    fn columns(&self, u0: usize, v: usize, width: usize) -> (usize, usize) {
        let rest = self.normal.y * v as f64 - self.offset;
        if self.normal.x.abs() < 1e-6 {
            let inside = rest.abs() < self.half;
            return (0, if inside { width } else { 0 });
        }
        let (a, b) = (
            (-self.half - rest) / self.normal.x,
            (self.half - rest) / self.normal.x,
        );
        let clip = |u: f64| (u - u0 as f64).clamp(0.0, width as f64) as usize;
        (clip(a.min(b)), clip(a.max(b) + 1.0))
    }
}

impl<P: Summable> Stack<P> {
    /// Begins with the image in which the board was found.
    pub fn new(image: &Image<P>, found: &Detection) -> Self {
        let side = AROUND * found.quality.square_px[1];
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::zeros());
        for corner in &found.corners {
            low = low.inf(&corner.pixel);
            high = high.sup(&corner.pixel);
        }
        let within = |x: f64, end: usize| x.clamp(0.0, end as f64) as usize;
        let (u0, v0) = (
            within(low.x - side, image.width()),
            within(low.y - side, image.height()),
        );
        let (u1, v1) = (
            within(high.x + side + 1.0, image.width()),
            within(high.y + side + 1.0, image.height()),
        );
        let (width, height) = (u1.saturating_sub(u0), v1.saturating_sub(v0));
        let mut stack = Self {
            origin: (u0, v0),
            width,
            height,
            sums: vec![P::Sum::default(); width * height],
            images: 0,
            bands: Vec::new(),
        };
        stack.sum(image, None);
        stack
    }

    /// Adds an image of the same pose and size with a stripe along `points`, all but the pixels
    /// within `away` px of it. A stripe without a line is not added, nor is an image beyond
    /// [`Summable::MOST`].
    pub fn add(&mut self, image: &Image<P>, points: &[Vector2], away: f64) {
        if self.images < P::MOST
            && let Some(band) = Band::around(points, away)
        {
            self.sum(image, Some(band));
            self.bands.push(band);
        }
    }

    fn sum(&mut self, image: &Image<P>, band: Option<Band>) {
        let ((u0, v0), width) = (self.origin, self.width);
        widest(
            #[inline(always)]
            || {
                let rows = self.sums.chunks_exact_mut(width.max(1));
                for (v, sums) in (v0..).zip(rows) {
                    let pixels = &image.row(v)[u0..u0 + width];
                    let (from, to) = band.map_or((0, 0), |b| b.columns(u0, v, width));
                    add_up(&mut sums[..from], &pixels[..from]);
                    add_up(&mut sums[to..], &pixels[to..]);
                }
            },
        );
        self.images += 1;
    }

    /// The mean, in 64ths of an 8-bit grey or in the units of deeper pixels.
    fn mean(&self) -> Image<u16> {
        let mut pixels = vec![0; self.sums.len()];
        // How many images each pixel of a row counts: all, less one from where a band begins until
        // where it ends.
        let mut steps = vec![0i32; self.width + 1];
        let mut factors = vec![0f32; self.width];
        let rows = pixels.chunks_exact_mut(self.width.max(1));
        let sums = self.sums.chunks_exact(self.width.max(1));
        for ((v, out), sums) in (self.origin.1..).zip(rows).zip(sums) {
            steps.fill(0);
            for band in &self.bands {
                let (from, to) = band.columns(self.origin.0, v, self.width);
                steps[from] -= 1;
                steps[to] += 1;
            }
            let mut count = self.images as i32;
            for (factor, step) in factors.iter_mut().zip(&steps) {
                count += step;
                *factor = P::SCALE / count.max(1) as f32;
            }
            widest(
                #[inline(always)]
                || {
                    for ((out, sum), factor) in out.iter_mut().zip(sums).zip(&factors) {
                        *out = (P::total(*sum) * factor + 0.5) as i32 as u16;
                    }
                },
            );
        }
        Image::from_vec(self.width, self.height, pixels)
            .unwrap_or_else(|| Image::new(self.width, self.height, 0))
    }

    /// The corners measured again in the mean. What the quality says stays that of the first image.
    ///
    /// # Errors
    /// [`NotFound::Moved`] if the mean shows the board elsewhere; else why it does not show it.
    pub fn measure(
        &self,
        found: &Detection,
        geometry: &BoardGeometry,
    ) -> Result<Detection, NotFound> {
        let origin = Vector2::new(self.origin.0 as f64, self.origin.1 as f64);
        let places: Vec<Vector2> = found.corners.iter().map(|c| c.pixel - origin).collect();
        let [dark, bright] = found.quality.noise;
        let noise = f64::from(P::SCALE) * dark.max(bright) / f64::from(self.images).sqrt();
        let mean = self.mean();
        let moved = |again: &Detection| {
            let far = places.iter().zip(&again.corners);
            far.map(|(p, c)| (c.pixel - p).norm()).fold(0.0, f64::max)
        };
        let again = refine::again(&mean, &places, found.blur_px, noise, geometry);
        let again = match again {
            Ok(again) if moved(&again) <= MOST_MOVED => again,
            // Not where it was: somewhere else?
            other => {
                let mut elsewhere = search::detect(&mean, geometry)?;
                let mut first = found.clone();
                for (corner, place) in first.corners.iter_mut().zip(&places) {
                    corner.pixel = *place;
                }
                super::align(&mut elsewhere, &first);
                let moved_px = moved(&elsewhere);
                if moved_px > MOST_MOVED {
                    return Err(NotFound::Moved { moved_px });
                }
                other?
            }
        };
        let mut result = found.clone();
        for (corner, new) in result.corners.iter_mut().zip(&again.corners) {
            corner.pixel = new.pixel + origin;
            corner.covariance = new.covariance;
        }
        result.blur_px = again.blur_px;
        result.quality.misfit = again.quality.misfit;
        Ok(result)
    }
}

#[inline(always)]
fn add_up<P: Summable>(sums: &mut [P::Sum], pixels: &[P]) {
    for (sum, pixel) in sums.iter_mut().zip(pixels) {
        *sum = P::add(*sum, *pixel);
    }
}
