//! The image at reduced resolution: boxes of 2ᵏ × 2ᵏ pixels averaged, in 10 bits, for the search.
//!
//! A pixel (x, y) of level k has its centre at u = (x + ½)·2ᵏ − ½ of the image.

use crate::image::{Image, Pixel};

/// One step of the pyramid. Values run from 0 to 1020 (four times 8 bits).
pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    /// Image pixels a level pixel in each direction: 2ᵏ.
    pub step: usize,
    pub pixels: Vec<i16>,
}

/// How far to shift a sum of four pixels to the right so that it fits 10 bits. Deep images are
/// scaled by what they hold: a 12-bit sensor's values in 16 bits lose nothing.
pub(super) fn depth_shift<P: Pixel>(image: &Image<P>) -> u32 {
    if P::BITS <= 8 {
        return 0;
    }
    let mut brightest = 0u16;
    crate::simd::widest(
        #[inline(always)]
        || {
            brightest = image.pixels().iter().fold(0u16, |m, p| m.max(p.to_u16()));
        },
    );
    (u16::BITS - brightest.leading_zeros()).saturating_sub(8)
}

impl Level {
    /// Level 0: the image itself.
    pub fn full<P: Pixel>(image: &Image<P>, shift: u32) -> Self {
        let mut pixels = vec![0; image.width() * image.height()];
        crate::simd::widest(
            #[inline(always)]
            || {
                for (out, p) in pixels.iter_mut().zip(image.pixels()) {
                    *out = ((u32::from(p.to_u16()) << 2) >> shift) as i16;
                }
            },
        );
        Self {
            width: image.width(),
            height: image.height(),
            step: 1,
            pixels,
        }
    }

    /// Level 1, straight from the image; an odd last row or column is left out.
    pub fn half<P: Pixel>(image: &Image<P>, shift: u32) -> Self {
        let (width, height) = (image.width() / 2, image.height() / 2);
        let mut pixels = vec![0; width * height];
        crate::simd::widest(
            #[inline(always)]
            || {
                for (v, out) in pixels.chunks_exact_mut(width.max(1)).enumerate() {
                    let (upper, _) = image.row(2 * v).as_chunks::<2>();
                    let (lower, _) = image.row(2 * v + 1).as_chunks::<2>();
                    if P::BITS <= 8 {
                        for ((out, a), b) in out.iter_mut().zip(upper).zip(lower) {
                            let sum = a[0].to_u16() + a[1].to_u16() + b[0].to_u16() + b[1].to_u16();
                            *out = sum as i16;
                        }
                    } else {
                        for ((out, a), b) in out.iter_mut().zip(upper).zip(lower) {
                            let sum = u32::from(a[0].to_u16())
                                + u32::from(a[1].to_u16())
                                + u32::from(b[0].to_u16())
                                + u32::from(b[1].to_u16());
                            *out = (sum >> shift) as i16;
                        }
                    }
                }
            },
        );
        Self {
            width,
            height,
            step: 2,
            pixels,
        }
    }

    /// The next coarser level.
    pub fn coarser(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut pixels = vec![0i16; width * height];
        crate::simd::widest(
            #[inline(always)]
            || {
                for (v, out) in pixels.chunks_exact_mut(width.max(1)).enumerate() {
                    let (upper, _) = self.row(2 * v).as_chunks::<2>();
                    let (lower, _) = self.row(2 * v + 1).as_chunks::<2>();
                    for ((out, a), b) in out.iter_mut().zip(upper).zip(lower) {
                        *out = (a[0] + a[1] + b[0] + b[1] + 2) >> 2;
                    }
                }
            },
        );
        Self {
            width,
            height,
            step: self.step * 2,
            pixels,
        }
    }

    #[inline]
    pub fn row(&self, y: usize) -> &[i16] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// A level position in image pixels.
    #[inline]
    pub fn to_image(&self, p: [f64; 2]) -> [f64; 2] {
        p.map(|x| (x + 0.5) * self.step as f64 - 0.5)
    }

    /// Bilinear value; positions are clamped to the level.
    #[inline]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32 - 1e-3);
        let y = y.clamp(0.0, (self.height - 1) as f32 - 1e-3);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let k = j * self.width + i;
        let at = |k: usize| f32::from(self.pixels[k]);
        let upper = at(k) + fx * (at(k + 1) - at(k));
        let k = k + self.width;
        let lower = at(k) + fx * (at(k + 1) - at(k));
        upper + fy * (lower - upper)
    }
}
