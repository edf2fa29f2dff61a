//! Charts as files: one or several in a grid, as SVG or PNG.

use super::Plot;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::sync::Once;

/// DejaVu Sans, cut down to Latin, Greek and mathematical signs: a fresh machine may have no fonts,
/// and a picture must look the same everywhere.
const SANS: &[u8] = include_bytes!("sans.ttf");

/// How large a picture is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Size {
    /// Width and height of the whole, px; 640 × 420 a chart if not given.
    pub pixels: Option<(u32, u32)>,
    /// Words, lines and marks so many times as large; 1 if not given. Where no size is given, the
    /// whole grows with them.
    pub scale: Option<f64>,
    /// Width on paper, mm.
    pub width_mm: Option<f64>,
}

/// Width and height of one chart, px.
const CELL: (u32, u32) = (640, 420);

/// Makes the font known to the drawing library.
pub(super) fn fonts() {
    static ONCE: Once = Once::new();
    // A font that can't be parsed would show in the first test that draws a word.
    ONCE.call_once(|| {
        let _ = register_font("sans-serif", FontStyle::Normal, SANS);
    });
}

/// How many columns charts are laid out in.
fn columns(count: usize) -> usize {
    if count < 2 { 1 } else { 2 }
}

/// Width and height of so many charts, px, and how large all in them is drawn.
fn size(count: usize, asked: Size) -> ((u32, u32), f64) {
    let columns = columns(count);
    let rows = count.div_ceil(columns).max(1);
    let scale = asked.scale.unwrap_or(1.0);
    let long = |px: u32, times: usize| (scale * f64::from(px) * times as f64).round() as u32;
    let usual = (long(CELL.0, columns), long(CELL.1, rows));
    (asked.pixels.unwrap_or(usual), scale)
}

fn draw<'a, DB: DrawingBackend + 'a>(
    plots: &[Plot],
    area: &DrawingArea<DB, plotters::coord::Shift>,
    scale: f64,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    area.fill(&WHITE)?;
    let columns = columns(plots.len());
    let cells = area.split_evenly((plots.len().div_ceil(columns).max(1), columns));
    for (plot, cell) in plots.iter().zip(&cells) {
        plot.draw(cell, scale)?;
    }
    area.present()
}

/// The charts as one SVG on white.
pub fn svg(plots: &[Plot], asked: Size) -> Option<String> {
    fonts();
    let mut out = String::new();
    let ((width, height), scale) = size(plots.len(), asked);
    {
        let area = SVGBackend::with_string(&mut out, (width, height)).into_drawing_area();
        draw(plots, &area, scale).ok()?;
    }
    // The drawing stays as it is; only what a pixel means on paper changes.
    if let Some(mm) = asked.width_mm {
        let high = mm * f64::from(height) / f64::from(width);
        out = out.replacen(
            &format!("width=\"{width}\" height=\"{height}\""),
            &format!("width=\"{mm}mm\" height=\"{high:.3}mm\""),
            1,
        );
    }
    Some(out)
}

/// The charts as one PNG on white.
pub fn png(plots: &[Plot], asked: Size) -> Option<Vec<u8>> {
    fonts();
    let ((width, height), scale) = size(plots.len(), asked);
    let mut pixels = vec![0u8; width as usize * height as usize * 3];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        draw(plots, &area, scale).ok()?;
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    if let Some(mm) = asked.width_mm {
        let per_metre = (1000.0 * f64::from(width) / mm).round() as u32;
        encoder.set_pixel_dims(Some(png::PixelDimensions {
            xppu: per_metre,
            yppu: per_metre,
            unit: png::Unit::Meter,
        }));
    }
    encoder
        .write_header()
        .ok()?
        .write_image_data(&pixels)
        .ok()?;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::chart::{INK, Kind, Series};

    fn plot() -> Plot {
        Plot {
            title: "Überschrift σ".into(),
            x_label: "x / mm".into(),
            y_label: "y / µm".into(),
            series: vec![Series::new(
                "s",
                0,
                Kind::Line,
                vec![(0.0, 0.0), (1.0, 2.0)],
            )],
            ..Plot::default()
        }
    }

    #[test]
    fn a_png_has_ink_in_it() {
        let bytes = png(&[plot(), plot(), plot()], Size::default()).unwrap();
        let image = ::image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!((image.width(), image.height()), (1280, 840));
        let ink = [INK.0, INK.1, INK.2];
        let dark = image.pixels().filter(|p| p.0 == ink).count();
        assert!(dark > 500, "axes and words: {dark} pixels");
        // The empty fourth cell stays white.
        assert!((660..1270).all(|x| image.get_pixel(x, 630).0 == [255; 3]));
    }

    #[test]
    fn a_size_is_kept_in_pixels_and_on_paper() {
        let asked = Size {
            pixels: Some((900, 500)),
            scale: Some(2.0),
            width_mm: Some(90.0),
        };
        let bytes = png(&[plot()], asked).unwrap();
        let image = ::image::load_from_memory(&bytes).unwrap();
        assert_eq!((image.width(), image.height()), (900, 500));
        let dims = png::Decoder::new(std::io::Cursor::new(&bytes))
            .read_info()
            .unwrap();
        let dims = dims.info().pixel_dims.unwrap();
        assert_eq!((dims.xppu, dims.yppu), (10_000, 10_000));
        let text = svg(&[plot()], asked).unwrap();
        assert!(
            text.contains("width=\"90mm\" height=\"50.000mm\""),
            "{}",
            &text[..200]
        );
        assert!(text.contains("viewBox=\"0 0 900 500\""));
        // Twice as large without a size: the whole grows too, the words with it.
        let large = Size {
            scale: Some(2.0),
            ..Size::default()
        };
        let text = svg(&[plot()], large).unwrap();
        assert!(
            text.contains("viewBox=\"0 0 1280 840\"") && text.contains("font-size=\"25.8"),
            "{}",
            &text[..900]
        );
    }

    #[test]
    fn an_svg_is_one_document() {
        let text = svg(&[plot(), plot()], Size::default()).unwrap();
        assert_eq!(text.matches("<svg").count(), 1);
        assert!(text.trim_end().ends_with("</svg>"));
        assert_eq!(text.matches("</svg>").count(), 1);
        assert_eq!(text.matches("Überschrift σ").count(), 2);
    }
}
