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
use plotters::style::text_anchor::{HPos, Pos, VPos};

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

    /// Draws title and legend above the chart, where they hide no data; gives their height, px.
    fn head<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
    ) -> Result<i32, DrawingAreaErrorKind<DB::ErrorType>> {
        let width = area.dim_in_pixel().0 as i32;
        let middle = text(16).pos(Pos::new(HPos::Center, VPos::Top));
        area.draw(&Text::new(self.title.clone(), (width / 2, 8), middle))?;
        let (mut x, mut y) = (64, 38);
        let mut named = false;
        for series in self.series.iter().filter(|s| !s.name.is_empty()) {
            let style = text(13);
            let (wide, _) = area.estimate_text_size(&series.name, &style)?;
            let next = x + 26 + wide as i32 + 20;
            if named && next > width {
                (x, y) = (64, y + 18);
            }
            let colour = PALETTE[series.colour % PALETTE.len()];
            key(area, &series.kind, colour, (x, y))?;
            let words = style.pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.name.clone(), (x + 24, y), words))?;
            x += 26 + wide as i32 + 20;
            named = true;
        }
        Ok(if named { y + 12 } else { 30 })
    }

    /// Draws on any backend.
    pub fn draw<'a, DB: DrawingBackend + 'a>(
        &self,
        area: &DrawingArea<DB, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let bars = self.series.iter().any(|s| matches!(s.kind, Kind::Bars(_)));
        let x = self.x_range.unwrap_or_else(|| self.range(|p| p.0, false));
        let y = self.y_range.unwrap_or_else(|| {
            let (low, high) = self.range(|p| p.1, bars);
            // Room for the marks' words above the data.
            (low, high + 0.065 * self.marks.len() as f64 * (high - low))
        });
        let head = self.head(area)?;
        let (_, body) = area.split_vertically(head);
        let mut chart = ChartBuilder::on(&body)
            .margin(6)
            .margin_right(16)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let (fx, fy) = (label_format(x), label_format(y));
        chart
            .configure_mesh()
            .axis_style(INK)
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .label_style(text(13))
            .axis_desc_style(text(14))
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_label_formatter(&|v| fx(*v))
            .y_label_formatter(&|v| fy(*v))
            .x_labels(7)
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
            match series.kind {
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
        }
        let inside = |at: f64| at >= x.0.min(x.1) && at <= x.0.max(x.1);
        for (row, (at, word)) in self.marks.iter().filter(|m| inside(m.0)).enumerate() {
            chart.draw_series(std::iter::once(PathElement::new(
                vec![(*at, y.0), (*at, y.1)],
                INK.mix(0.6).stroke_width(1),
            )))?;
            // Words one under the other, on the side where there is room.
            let right = (at - x.0) / (x.1 - x.0) > 0.6;
            let side = if right { HPos::Right } else { HPos::Left };
            let style = text(12).pos(Pos::new(side, VPos::Top));
            let shift = (if right { -4 } else { 4 }, 2 + 15 * row as i32);
            chart.draw_series(std::iter::once(
                EmptyElement::at((*at, y.1)) + Text::new(word.clone(), shift, style),
            ))?;
        }
        area.present()
    }
}

/// Words in the page's ink.
fn text(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

/// The legend's key of a series, its middle at (x + 9, y).
fn key<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    kind: &Kind,
    colour: RGBColor,
    (x, y): (i32, i32),
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let style = colour.stroke_width(2);
    let line = |from: i32, to: i32, style| {
        area.draw(&PathElement::new(vec![(x + from, y), (x + to, y)], style))
    };
    match kind {
        Kind::Dots | Kind::Points => area.draw(&Circle::new((x + 9, y), 3, colour.filled())),
        Kind::Crosses => area.draw(&Cross::new((x + 9, y), 4, style)),
        Kind::Bars(_) => {
            let corners = [(x + 4, y - 5), (x + 14, y + 5)];
            area.draw(&Rectangle::new(corners, colour.filled()))
        }
        Kind::Area => {
            let corners = [(x + 2, y - 5), (x + 16, y + 5)];
            area.draw(&Rectangle::new(corners, colour.mix(0.2).filled()))
        }
        Kind::Dashed => {
            line(0, 7, style)?;
            line(11, 18, style)
        }
        Kind::Line | Kind::Segments => line(0, 18, style),
    }
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
