//! Stripe centres at sub-pixel accuracy, each with a variance and a quality.
//!
//! [`hand`] finds the stripe on skin in a frame of a scan, [`board`] on the checkerboard.

pub mod board;
mod chain;
pub mod hand;
mod link;
mod outline;
pub mod pair;
mod profile;
mod search;
mod smooth;

pub mod paper;

use crate::geometry::Vector2;
use crate::image::{Image, Pixel};

/// What search, chains, profiles, smoothing and outline decide by, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    [
        search::limits(),
        link::limits(),
        chain::limits(),
        profile::limits(),
        smooth::limits(),
        outline::limits(),
        pair::limits(),
    ]
    .concat()
}

/// One point on the centre of the laser's stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripePoint {
    /// Sub-pixel position of the centre.
    pub pixel: Vector2,
    /// Unit vector across the stripe in the image; the centre is measured along it.
    pub across: Vector2,
    /// Variance of the centre along `across`, px².
    pub variance: f64,
    /// Peak above the background, in the image's grey values.
    pub intensity: f32,
    /// Standard deviation of the stripe's profile across it, px.
    pub width_px: f32,
    /// 0 (worthless) to 1 (a clean, unsaturated, well-fitted profile).
    pub quality: f32,
}

/// The image axis along which a stripe is searched and its centre measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axis {
    /// The stripe runs across the image: one centre in each column.
    #[default]
    Columns,
    /// The stripe runs down the image: one centre in each row.
    Rows,
}

impl Axis {
    /// Unit vector along which the centre is measured.
    pub fn across(self) -> Vector2 {
        match self {
            Self::Columns => Vector2::y(),
            Self::Rows => Vector2::x(),
        }
    }
}

/// Why no stripe was measured.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StripeError {
    /// The two images of a pair differ in size.
    #[error(
        "the image with the laser is {on_width} × {on_height}, the one without {off_width} × {off_height}: take both with the same settings"
    )]
    Size {
        /// Width with the laser on, px.
        on_width: usize,
        /// Height with the laser on, px.
        on_height: usize,
        /// Width with the laser off, px.
        off_width: usize,
        /// Height with the laser off, px.
        off_height: usize,
    },
    /// The image without the laser shows the stripe.
    #[error("the stripe is in the image without the laser: on and off are swapped")]
    Swapped,
    /// The image without the laser is brighter than the one with it.
    #[error(
        "the image without the laser is brighter than one with it at {pixels} pixels: they are swapped, the laser was on in it, or it shows another scene"
    )]
    Lit {
        /// About so many pixels.
        pixels: usize,
    },
    /// No stripe was found.
    #[error(
        "no stripe: {found} columns or rows show one where at least {needed} should (laser off, too dim, or not on the target)"
    )]
    NoStripe {
        /// Columns (or rows) with something like a stripe.
        found: usize,
        /// The least number of them.
        needed: usize,
    },
    /// No stripe on the board, one beside it.
    #[error(
        "no stripe on the checkerboard, but one {squares:.1} squares beside it: move board or laser until the stripe crosses its squares"
    )]
    Beside {
        /// From the edge of the outer squares, squares.
        squares: f64,
    },
    /// Small squares look like a stripe themselves where nothing can be subtracted.
    #[error(
        "squares of {square_px:.0} pixels are too small to tell the stripe from them without an image with the laser off (at least {least_px:.0}): record one for each board pose and name it as \"off\", or bring the board nearer"
    )]
    NeedsOff {
        /// Shortest side of a square, px.
        square_px: f64,
        /// The least side, px.
        least_px: f64,
    },
    /// The scene changed between the two images.
    #[error(
        "the two images differ by {grey:.0} grey values away from the stripe: the scene or its lighting changed between them"
    )]
    SceneChanged {
        /// Median |on − off| off the stripe.
        grey: f32,
    },
    /// The corners do not outline a board.
    #[error(
        "{given} corners given for a board of {columns} × {rows}, or they do not lie on a grid"
    )]
    Corners {
        /// Corners given.
        given: usize,
        /// Inner corners along the long side.
        columns: usize,
        /// Inner corners along the short side.
        rows: usize,
    },
}

/// Both images of a pair must have one size.
fn same_size<P: Pixel>(on: &Image<P>, off: &Image<P>) -> Result<(), StripeError> {
    if on.width() == off.width() && on.height() == off.height() {
        return Ok(());
    }
    Err(StripeError::Size {
        on_width: on.width(),
        on_height: on.height(),
        off_width: off.width(),
        off_height: off.height(),
    })
}

/// Rows for columns.
fn transposed<P: Pixel>(image: &Image<P>) -> Image<P> {
    let (width, height) = (image.width(), image.height());
    let mut turned = Image::new(height, width, P::default());
    let pixels = turned.pixels_mut();
    // Tiles, so that both sides stay in the cache.
    for v0 in (0..height).step_by(32) {
        for u0 in (0..width).step_by(32) {
            for v in v0..(v0 + 32).min(height) {
                let row = image.row(v);
                for u in u0..(u0 + 32).min(width) {
                    pixels[u * height + v] = row[u];
                }
            }
        }
    }
    turned
}

#[cfg(test)]
mod tests;
