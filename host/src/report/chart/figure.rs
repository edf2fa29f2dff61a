//! Charts as files: one or several in a grid, as SVG or PNG.

use super::Plot;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::sync::Once;

/// DejaVu Sans, cut down to Latin, Greek and mathematical signs: a fresh machine may have no fonts,
/// and a picture must look the same everywhere.
const SANS: &[u8] = include_bytes!("sans.ttf");

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

fn size(count: usize) -> (u32, u32) {
    let columns = columns(count);
    let rows = count.div_ceil(columns).max(1);
    (CELL.0 * columns as u32, CELL.1 * rows as u32)
}

fn draw<'a, DB: DrawingBackend + 'a>(
    plots: &[Plot],
    area: &DrawingArea<DB, plotters::coord::Shift>,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    area.fill(&WHITE)?;
    let columns = columns(plots.len());
    let cells = area.split_evenly((plots.len().div_ceil(columns).max(1), columns));
    for (plot, cell) in plots.iter().zip(&cells) {
        plot.draw(cell)?;
    }
    area.present()
}

/// The charts as one SVG on white.
pub fn svg(plots: &[Plot]) -> Option<String> {
    fonts();
    let mut out = String::new();
    {
        let area = SVGBackend::with_string(&mut out, size(plots.len())).into_drawing_area();
        draw(plots, &area).ok()?;
    }
    Some(out)
}

/// The charts as one PNG on white.
pub fn png(plots: &[Plot]) -> Option<Vec<u8>> {
    fonts();
    let (width, height) = size(plots.len());
    let mut pixels = vec![0u8; width as usize * height as usize * 3];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        draw(plots, &area).ok()?;
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
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
        let bytes = png(&[plot(), plot(), plot()]).unwrap();
        let image = ::image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!((image.width(), image.height()), (1280, 840));
        let ink = [INK.0, INK.1, INK.2];
        let dark = image.pixels().filter(|p| p.0 == ink).count();
        assert!(dark > 500, "axes and words: {dark} pixels");
        // The empty fourth cell stays white.
        assert!((660..1270).all(|x| image.get_pixel(x, 630).0 == [255; 3]));
    }

    #[test]
    fn an_svg_is_one_document() {
        let text = svg(&[plot(), plot()]).unwrap();
        assert_eq!(text.matches("<svg").count(), 1);
        assert_eq!(text.matches("Überschrift σ").count(), 2);
    }
}
