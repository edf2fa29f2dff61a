//! The stripe on skin.

use super::{Axis, StripeError, StripePoint};
use crate::image::{Image, Pixel};

/// What to expect of the stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSettings {
    /// Along which axis the stripe is searched.
    pub axis: Axis,
    /// Smooth the centres along the stripe, as far as the data bear it.
    pub smooth: bool,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self {
            axis: Axis::Columns,
            smooth: true,
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
}

/// The stripe's segments in a frame with the laser on; `ambient` is the same view without it.
/// No stripe is an empty list; images of two sizes, or swapped ones, are errors.
pub fn extract<P: Pixel>(
    image: &Image<P>,
    ambient: Option<&Image<P>>,
    settings: &HandSettings,
) -> Result<Vec<Segment>, StripeError> {
    let _ = (image, ambient, settings);
    Ok(Vec::new())
}
