//! Charts: one plain description (`Plot`) drawn with axes, units and legend, as SVG.
//!
//! Colours are Okabe and Ito's, which the colour-blind can tell apart; every series also differs in
//! dash or mark. Ink and grid have their own colours, which the page swaps in the dark.

mod calibration;
mod cloud;
pub mod figure;
mod puncture;
mod stripes;

pub use calibration::{coverage, figure_14, offsets, residuals, tilts, view_rms};
pub use cloud::cloud;
pub use puncture::{force_by_layer, force_over_angle, forces};
pub use stripes::{centres, quality};

use plotters::coord::Shift;
use plotters::prelude::*;

/// Axes, text.
pub const INK: RGBColor = RGBColor(0x22, 0x22, 0x23);
/// Grid lines.
pub const GRID: RGBColor = RGBColor(0xDD, 0xDD, 0xDE);
/// Series colours: blue, vermillion, green, purple, orange, sky.
pub const PALETTE: [RGBColor; 6] = [
    RGBColor(0x00, 0x72, 0xB2),
    RGBColor(0xD5, 0x5E, 0x00),
    RGBColor(0x00, 0x9E, 0x73),
    RGBColor(0xCC, 0x79, 0xA7),
    RGBColor(0xE6, 0x9F, 0x00),
    RGBColor(0x56, 0xB4, 0xE9),
];

/// How a series is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// Joined points.
    Line,
    /// Joined by dashes.
    Dashed,
    /// Dots.
    Dots,
    /// Single small dots, for many points.
    Points,
    /// Crosses.
    Crosses,
    /// Bars from zero, of this width in units of x.
    Bars(f64),
    /// Two points each: from, to.
    Segments,
    /// The area between the first half of the points and the second half taken backwards.
    Area,
}

/// Points with a name.
#[derive(Clone, Debug)]
pub struct Series {
    /// In the legend; empty for none.
    pub name: String,
    /// Index in [`PALETTE`].
    pub colour: usize,
    /// How it is drawn.
    pub kind: Kind,
    /// x, y.
    pub points: Vec<(f64, f64)>,
}

/// A chart.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    /// Above the chart; also its text alternative.
    pub title: String,
    /// With unit.
    pub x_label: String,
    /// With unit.
    pub y_label: String,
    /// From, to; found from the data if `None`.
    pub x_range: Option<(f64, f64)>,
    /// The same; may run downwards (pixels).
    pub y_range: Option<(f64, f64)>,
    /// The series.
    pub series: Vec<Series>,
    /// Vertical lines with a word each.
    pub marks: Vec<(f64, String)>,
}

impl Series {
    /// A series.
    pub fn new(name: &str, colour: usize, kind: Kind, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            colour,
            kind,
            points,
        }
    }
}

impl Plot {
    /// The chart as a stand-alone SVG of the given size.
    pub fn svg(&self, width: u32, height: u32) -> String {
        figure::fonts();
        let mut out = String::new();
        {
            let area = SVGBackend::with_string(&mut out, (width, height)).into_drawing_area();
            // Writing to a string can't fail; an empty chart is what a failure would leave.
            if self.draw(&area).is_err() {
                return String::new();
            }
        }
        out
    }

    /// The range of the data along one coordinate, with a margin; never empty.
    fn range(&self, pick: impl Fn(&(f64, f64)) -> f64, with_zero: bool) -> (f64, f64) {
        let mut lo = f64::INFINITY;
        let mut hi = f64::NEG_INFINITY;
        for v in self.series.iter().flat_map(|s| s.points.iter().map(&pick)) {
            if v.is_finite() {
                lo = lo.min(v);
                hi = hi.max(v);
            }
        }
        if with_zero && lo <= hi {
            lo = lo.min(0.0);
            hi = hi.max(0.0);
        }
        if lo > hi {
            return (0.0, 1.0);
        }
        let margin = if hi > lo {
            0.05 * (hi - lo)
        } else {
            0.5 * hi.abs().max(1e-3)
        };
        let low = if with_zero && lo == 0.0 {
            0.0
        } else {
            lo - margin
        };
        (low, hi + margin)
    }

    /// Draws on any backend.
    pub fn draw<'a, DB: DrawingBackend + 'a>(
        &self,
        area: &DrawingArea<DB, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let bars = self.series.iter().any(|s| matches!(s.kind, Kind::Bars(_)));
        let x = self.x_range.unwrap_or_else(|| self.range(|p| p.0, false));
        let y = self.y_range.unwrap_or_else(|| self.range(|p| p.1, bars));
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 16).into_font().color(&INK))
            .margin(8)
            .x_label_area_size(42)
            .y_label_area_size(62)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let (fx, fy) = (label_format(x), label_format(y));
        chart
            .configure_mesh()
            .axis_style(INK)
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 12).into_font().color(&INK))
            .axis_desc_style(("sans-serif", 13).into_font().color(&INK))
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_label_formatter(&|v| fx(*v))
            .y_label_formatter(&|v| fy(*v))
            .x_labels(8)
            .y_labels(6)
            .draw()?;
        for series in &self.series {
            let colour = PALETTE[series.colour % PALETTE.len()];
            let points = || {
                series
                    .points
                    .iter()
                    .copied()
                    .filter(|p| p.0.is_finite() && p.1.is_finite())
            };
            let style = colour.stroke_width(2);
            let drawn = match series.kind {
                Kind::Line => chart.draw_series(LineSeries::new(points(), style))?,
                Kind::Dashed => chart.draw_series(DashedLineSeries::new(points(), 6, 4, style))?,
                Kind::Dots => {
                    chart.draw_series(points().map(|p| Circle::new(p, 3, colour.filled())))?
                }
                Kind::Points => {
                    chart.draw_series(points().map(|p| Circle::new(p, 1, colour.filled())))?
                }
                Kind::Crosses => chart.draw_series(points().map(|p| Cross::new(p, 4, style)))?,
                Kind::Bars(w) => chart.draw_series(points().map(|(x, y)| {
                    Rectangle::new([(x - w / 2.0, 0.0), (x + w / 2.0, y)], colour.filled())
                }))?,
                Kind::Segments => chart.draw_series(
                    series
                        .points
                        .chunks_exact(2)
                        .map(|p| PathElement::new(p.to_vec(), colour.stroke_width(1))),
                )?,
                Kind::Area => chart.draw_series(std::iter::once(Polygon::new(
                    points().collect::<Vec<_>>(),
                    colour.mix(0.2).filled(),
                )))?,
            };
            if !series.name.is_empty() {
                let kind = series.kind.clone();
                drawn
                    .label(&series.name)
                    .legend(move |(x, y)| key(&kind, colour, x, y));
            }
        }
        for (at, word) in &self.marks {
            if !(*at >= x.0.min(x.1) && *at <= x.0.max(x.1)) {
                continue;
            }
            let top = y.1 - 0.02 * (y.1 - y.0);
            chart.draw_series(std::iter::once(PathElement::new(
                vec![(*at, y.0), (*at, y.1)],
                INK.mix(0.6).stroke_width(1),
            )))?;
            chart.draw_series(std::iter::once(Text::new(
                word.clone(),
                (*at, top),
                ("sans-serif", 11).into_font().color(&INK),
            )))?;
        }
        if self.series.iter().any(|s| !s.name.is_empty()) {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .label_font(("sans-serif", 12).into_font().color(&INK))
                .border_style(GRID)
                .draw()?;
        }
        area.present()
    }
}

/// The legend's key of a series: every kind as a path, since a legend takes one type of element.
fn key(kind: &Kind, colour: RGBColor, x: i32, y: i32) -> PathElement<(i32, i32)> {
    let (points, width) = match kind {
        Kind::Dots | Kind::Points => (vec![(x + 6, y), (x + 11, y)], 5),
        Kind::Crosses => (
            vec![
                (x + 5, y - 4),
                (x + 13, y + 4),
                (x + 9, y),
                (x + 13, y - 4),
                (x + 5, y + 4),
            ],
            2,
        ),
        Kind::Bars(_) | Kind::Area => (vec![(x + 2, y), (x + 16, y)], 9),
        Kind::Dashed => (vec![(x, y), (x + 6, y)], 2),
        Kind::Line | Kind::Segments => (vec![(x, y), (x + 18, y)], 2),
    };
    PathElement::new(points, colour.stroke_width(width))
}

/// As many decimals as the range needs.
fn label_format(range: (f64, f64)) -> impl Fn(f64) -> String {
    let span = (range.1 - range.0).abs();
    let decimals = if span > 0.0 && span.is_finite() {
        (1.0 - span.log10().floor()).clamp(0.0, 6.0) as usize
    } else {
        1
    };
    move |v| {
        let text = format!("{v:.decimals$}");
        // No trailing zeros, no −0.
        let text = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_string()
        } else {
            text
        };
        if text == "-0" { "0".into() } else { text }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_has_its_words_and_survives_odd_data() {
        let plot = Plot {
            title: "Title".into(),
            x_label: "time / s".into(),
            y_label: "force / N".into(),
            series: vec![
                Series::new(
                    "whole",
                    0,
                    Kind::Line,
                    vec![(0.0, 0.0), (1.0, f64::NAN), (2.0, 3.0)],
                ),
                Series::new("bars", 1, Kind::Bars(0.5), vec![(1.0, 2.0)]),
            ],
            marks: vec![(1.0, "here".into()), (99.0, "outside".into())],
            ..Plot::default()
        };
        let svg = plot.svg(480, 320);
        for word in ["Title", "time / s", "force / N", "whole", "here"] {
            assert!(svg.contains(word), "{word} is missing");
        }
        assert!(!svg.contains("outside") && !svg.contains("NaN"));
        assert!(!Plot::default().svg(300, 200).is_empty());
    }

    #[test]
    fn labels_are_short() {
        assert_eq!(label_format((0.0, 60.0))(5.0), "5");
        assert_eq!(label_format((0.0, 0.5))(0.25), "0.25");
        assert_eq!(label_format((-1e-3, 1e-3))(-0.0), "0");
    }
}
