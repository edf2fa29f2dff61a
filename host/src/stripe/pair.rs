//! Whether two images are a pair: one scene, the laser on in the first only. Light is only added by
//! it, so that nothing may be darker with it than without.

use super::StripeError;
use crate::image::{Image, Pixel};

/// Every so many rows are looked at: a stripe is wider, or runs across many of them.
const EVERY: usize = 4;
/// A pixel is darker if by this many standard deviations of the difference, and by this part of the
/// range.
const SIGMAS: f32 = 8.0;
const PART: f32 = 1.0 / 16.0;
/// So many darker pixels as a part of the longer side are no dust: a third of a stripe 1 px wide.
const MOST: f32 = 0.3;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "pair of images: darker with the laser than without",
        format!(
            "{SIGMAS} σ and {:.0} % of the range, at {MOST} pixels for each of the longer side",
            100.0 * PART
        ),
    )]
}

/// Whether `off` can be the image without the laser of `on`.
///
/// # Errors
/// [`StripeError::Size`], [`StripeError::Lit`].
pub fn check<P: Pixel>(on: &Image<P>, off: &Image<P>) -> Result<(), StripeError> {
    super::same_size(on, off)?;
    let rows = || {
        (0..on.height())
            .step_by(EVERY)
            .map(|v| (on.row(v), off.row(v)))
    };
    // The noise of the difference from every 61st pixel; the stripe is a small part of them.
    let mut changes: Vec<f32> = rows()
        .flat_map(|(on, off)| on.iter().zip(off).step_by(61))
        .map(|(on, off)| ((*on).into() - (*off).into()).abs())
        .collect();
    if changes.is_empty() {
        return Ok(());
    }
    let middle = changes.len() / 2;
    let median = *changes.select_nth_unstable_by(middle, f32::total_cmp).1;
    let least = (SIGMAS * 1.4826 * median).max(PART * P::MAX) as u16;
    let mut darker = 0usize;
    crate::simd::widest(
        #[inline(always)]
        || {
            for v in (0..on.height()).step_by(EVERY) {
                darker += darker_in(on.row(v), off.row(v), least);
            }
        },
    );
    let longer = on.width().max(on.height()) as f32;
    let pixels = EVERY * darker;
    if pixels as f32 > MOST * longer {
        return Err(StripeError::Lit { pixels });
    }
    Ok(())
}

/// How many pixels of a row are darker by more than `least` with the laser than without.
#[inline(always)]
fn darker_in<P: Pixel>(on: &[P], off: &[P], least: u16) -> usize {
    let mut darker = 0u32;
    for (on, off) in on.iter().zip(off) {
        darker += u32::from(off.to_u16().saturating_sub(on.to_u16()) > least);
    }
    darker as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::Noise;

    /// A textured scene, with a stripe at row `lit`.
    fn scene(seed: u64, lit: Option<usize>) -> Image<u8> {
        let (width, height) = (320, 240);
        let mut noise = Noise(seed);
        let mut image = Image::new(width, height, 0);
        for v in 0..height {
            for u in 0..width {
                let texture = 60.0 + 40.0 * ((u / 20 + v / 15) % 2) as f64;
                let off = lit.map_or(f64::INFINITY, |at| v as f64 - at as f64);
                let stripe = 120.0 * (-0.5 * (off / 1.5).powi(2)).exp();
                let value = texture + stripe + 4.0 * noise.normal();
                image.pixels_mut()[v * width + u] = value.round().clamp(0.0, 255.0) as u8;
            }
        }
        image
    }

    #[test]
    fn a_pair_passes_and_a_stripe_without_the_laser_does_not() {
        for at in [20, 101, 230] {
            assert_eq!(check(&scene(1, Some(at)), &scene(2, None)), Ok(()));
            for on in [None, Some(60)] {
                let found = check(&scene(3, on), &scene(4, Some(at)));
                assert!(matches!(found, Err(StripeError::Lit { pixels }) if pixels > 320));
            }
        }
    }

    #[test]
    fn another_scene_is_no_pair() {
        let moved = scene(5, None);
        let mut other = moved.clone();
        for (p, q) in other.pixels_mut().iter_mut().zip(&moved.pixels()[7..]) {
            *p = *q;
        }
        assert!(check(&scene(6, Some(100)), &other).is_err());
    }
}
