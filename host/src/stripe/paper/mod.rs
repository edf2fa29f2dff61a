//! The paper's way to the stripe's centre line, as written, to compare with: on the rectified
//! checkerboard (Section 2.2.1, steps 2–5) and on the hand (Section 3.2, steps 2–4).
//!
//! Centres from thinning lie on the pixel grid: 0.4 px RMS and a bias towards the side from which
//! thinning peels last. It is kept for comparison, not made better.

pub mod board;
pub mod hand;
mod thinning;

use crate::image::{Image, Pixel};
use ::image::GrayImage;

/// Eight bits of grey for the library routines (the paper works on 8-bit images).
fn to_gray<P: Pixel>(image: &Image<P>) -> GrayImage {
    let pixels = if P::BITS <= 8 {
        P::to_be_bytes(image.pixels()).into_owned()
    } else {
        let scale = 255.0 / P::MAX;
        let grey = |p: &P| ((*p).into() * scale).round() as u8;
        image.pixels().iter().map(grey).collect()
    };
    // The sizes agree by construction; an empty image is the harmless alternative.
    GrayImage::from_raw(image.width() as u32, image.height() as u32, pixels).unwrap_or_default()
}
