//! Stripe centres at sub-pixel accuracy, each with a variance and a quality.

use crate::geometry::Vector2;

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
