//! The stripe on the hand, the paper's way (Section 3.2, steps 2–4; Figures 19–21): cut out the
//! region of the hand, gamma transformation, binarisation, closing, thinning.

use super::{thinning, to_gray};
use crate::geometry::Vector2;
use crate::image::{Image, Pixel};
use crate::stripe::{Axis, StripePoint};
use ::image::{GrayImage, Luma, imageops};
use imageproc::contrast::{ThresholdType, otsu_level, threshold};
use imageproc::definitions::Image as Raster;
use imageproc::distance_transform::Norm;
use imageproc::morphology::close;
use imageproc::region_labelling::{Connectivity, connected_components};
use serde::Serialize;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub u: u32,
    /// First row.
    pub v: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// What the paper leaves open, with the values taken here.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Exponent of the gamma transformation; above 1 it darkens all but the stripe.
    pub gamma: f64,
    /// Radius of the closing, px.
    #[serde(rename = "radius of the closing / px")]
    pub closing: u8,
}

/// Below 1.5 the threshold of frames with a short stripe falls on the skin, above 1.7 it breaks the
/// stripe on veins; the closing must bridge a grain of dark speckle.
impl Default for Settings {
    fn default() -> Self {
        Self {
            gamma: 1.6,
            closing: 3,
        }
    }
}

/// The hand's region: the box around the largest bright part of an image without the stripe (the
/// ambient image or, where there is none, the pixelwise minimum of scan frames).
pub fn region<P: Pixel>(image: &Image<P>) -> Region {
    let whole = Region {
        u: 0,
        v: 0,
        width: image.width() as u32,
        height: image.height() as u32,
    };
    let gray = to_gray(image);
    let binary = threshold(&gray, otsu_level(&gray), ThresholdType::Binary);
    let labels: Raster<Luma<u32>> = connected_components(&binary, Connectivity::Eight, Luma([0u8]));
    let parts = labels.pixels().map(|p| p.0[0]).max().unwrap_or(0) as usize;
    let mut boxes = vec![(0usize, u32::MAX, u32::MAX, 0u32, 0u32); parts + 1];
    for (x, y, p) in labels.enumerate_pixels() {
        let b = &mut boxes[p.0[0] as usize];
        *b = (b.0 + 1, b.1.min(x), b.2.min(y), b.3.max(x), b.4.max(y));
    }
    boxes[1..]
        .iter()
        .max_by_key(|b| b.0)
        .map_or(whole, |&(_, u0, v0, u1, v1)| Region {
            u: u0,
            v: v0,
            width: u1 - u0 + 1,
            height: v1 - v0 + 1,
        })
}

/// A stripe fills less of the hand's region than this.
const LARGEST: f64 = 0.1;

/// What else is decided by, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "hand stripe, the paper’s way: a stripe fills less of the hand’s region than",
        format!("{:.0} %", 100.0 * LARGEST),
    )]
}

/// The stripe's skeleton inside the region, in the image's pixels; `axis` says which way its error
/// lies. The variance is that of thinning
/// (0.4 px RMS), the same for all: the method knows no better.
pub fn extract<P: Pixel>(
    image: &Image<P>,
    region: &Region,
    axis: Axis,
    settings: &Settings,
) -> Vec<StripePoint> {
    let gray = to_gray(image);
    let (w, h) = (gray.width(), gray.height());
    let (u, v) = (region.u.min(w), region.v.min(h));
    let cut = imageops::crop_imm(
        &gray,
        u,
        v,
        region.width.min(w - u),
        region.height.min(h - v),
    )
    .to_image();
    if cut.is_empty() {
        return Vec::new();
    }
    let table: Vec<u8> = (0..256)
        .map(|g| (255.0 * (f64::from(g) / 255.0).powf(settings.gamma)).round() as u8)
        .collect();
    let transformed = GrayImage::from_fn(cut.width(), cut.height(), |x, y| {
        Luma([table[cut.get_pixel(x, y).0[0] as usize]])
    });
    let level = otsu_level(&transformed);
    let binary = threshold(&transformed, level, ThresholdType::Binary);
    // Where the stripe is short or missing the level parts bright skin from dark.
    let white = binary.pixels().filter(|p| p.0[0] > 0).count();
    if white as f64 > LARGEST * (binary.width() * binary.height()) as f64 {
        return Vec::new();
    }
    let closed = close(&binary, Norm::LInf, settings.closing);
    thinning::skeleton(&closed)
        .into_iter()
        .map(|(x, y)| StripePoint {
            pixel: Vector2::new(f64::from(x + u), f64::from(y + v)),
            across: axis.across(),
            variance: 0.16,
            intensity: f32::from(cut.get_pixel(x, y).0[0]),
            width_px: 1.0,
            quality: 1.0,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian stripe of σ 2.5 px on skin of 45 grey levels, on a dark table.
    fn frame(peak: f64, centre: impl Fn(usize) -> f64) -> Image<u8> {
        let mut image = Image::new(200, 120, 6u8);
        for v in 0..120 {
            for u in 0..200 {
                if (20..180).contains(&u) && (15..105).contains(&v) {
                    let d = v as f64 - centre(u);
                    let grey = 45.0 + peak * (-d * d / 12.5).exp();
                    image.pixels_mut()[v * 200 + u] = grey as u8;
                }
            }
        }
        image
    }

    #[test]
    fn the_region_is_the_hand() {
        let r = region(&frame(0.0, |_| 60.0));
        assert_eq!((r.u, r.v, r.width, r.height), (20, 15, 160, 90));
    }

    #[test]
    fn the_skeleton_follows_the_stripe_to_a_pixel() {
        let centre = |u: usize| 60.0 + 0.1 * u as f64;
        let image = frame(150.0, centre);
        let hand = region(&frame(0.0, centre));
        let points = extract(&image, &hand, Axis::Columns, &Settings::default());
        assert!(points.len() > 140, "{} points", points.len());
        let worst = points
            .iter()
            .map(|p| (p.pixel.y - centre(p.pixel.x as usize)).abs())
            .fold(0.0, f64::max);
        assert!(worst <= 1.5, "{worst} px");
    }

    #[test]
    fn degenerate_images_give_no_points() {
        for image in [Image::new(64, 48, 0u8), Image::new(64, 48, 255u8)] {
            let r = region(&image);
            assert!(extract(&image, &r, Axis::Columns, &Settings::default()).len() <= 64 * 48);
        }
    }
}
