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

use super::model::Gray;
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

/// Colours in an order, far to near, after those of [`PALETTE`]: five of viridis, the light end left
/// out, for it is lost on white.
const ORDERED: [RGBColor; 5] = [
    RGBColor(0x44, 0x01, 0x54),
    RGBColor(0x3E, 0x4A, 0x89),
    RGBColor(0x26, 0x82, 0x8E),
    RGBColor(0x35, 0xB7, 0x79),
    RGBColor(0xA6, 0xD0, 0x2B),
];

/// The colour of a series' number.
fn colour(number: usize) -> RGBColor {
    let all = PALETTE.iter().chain(&ORDERED);
    all.cycle().nth(number).copied().unwrap_or(INK)
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Joined points.
    Line,
    /// Joined by dashes of this length and this space between, px.
    Dashes(i32, i32),
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
    /// Index in [`PALETTE`], and after its end in five colours that have an order, far to near.
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
    /// A unit is as long along y as along x.
    pub equal: bool,
    /// A picture under the series.
    pub under: Option<Under>,
}

/// A picture in the chart's coordinates.
#[derive(Clone, Debug, Default)]
pub struct Under {
    /// The picture.
    pub image: Gray,
    /// x and y of its top left corner.
    pub corner: [f64; 2],
    /// Side of a pixel.
    pub side: f64,
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
            if self.draw(&area, 1.0).is_err() || area.present().is_err() {
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
        pen: Pen,
    ) -> Result<i32, DrawingAreaErrorKind<DB::ErrorType>> {
        let width = area.dim_in_pixel().0 as i32;
        let px = |length: i32| pen.px(length);
        let middle = pen.text(16).pos(Pos::new(HPos::Center, VPos::Top));
        area.draw(&Text::new(self.title.clone(), (width / 2, px(8)), middle))?;
        let (mut x, mut y) = (px(64), px(38));
        let mut named = false;
        for series in self.series.iter().filter(|s| !s.name.is_empty()) {
            let style = pen.text(13);
            let (wide, _) = area.estimate_text_size(&series.name, &style)?;
            let next = x + px(26) + wide as i32 + px(20);
            if named && next > width {
                (x, y) = (px(64), y + px(18));
            }
            let colour = colour(series.colour);
            key(area, &series.kind, colour, (x, y), pen)?;
            let words = style.pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.name.clone(), (x + px(24), y), words))?;
            x += px(26) + wide as i32 + px(20);
            named = true;
        }
        Ok(if named { y + px(12) } else { px(30) })
    }

    /// Draws on any backend, everything `scale` times as large as usual.
    pub fn draw<'a, DB: DrawingBackend + 'a>(
        &self,
        area: &DrawingArea<DB, Shift>,
        scale: f64,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        let pen = Pen(scale);
        let bars = self.series.iter().any(|s| matches!(s.kind, Kind::Bars(_)));
        let x = self.x_range.unwrap_or_else(|| self.range(|p| p.0, false));
        let y = self.y_range.unwrap_or_else(|| {
            let (low, high) = self.range(|p| p.1, bars);
            // Room for the marks' words above the data.
            (low, high + 0.065 * self.marks.len() as f64 * (high - low))
        });
        let head = self.head(area, pen)?;
        let (_, body) = area.split_vertically(head);
        let (margin, right, below, beside) = (pen.px(6), pen.px(16), pen.px(44), pen.px(64));
        let (x, y) = if self.equal {
            let (w, h) = body.dim_in_pixel();
            let (w, h) = (
                w as i32 - margin - right - beside,
                h as i32 - 2 * margin - below,
            );
            equal(x, y, f64::from(w.max(1)), f64::from(h.max(1)))
        } else {
            (x, y)
        };
        let mut chart = ChartBuilder::on(&body)
            .margin(margin)
            .margin_right(right)
            .x_label_area_size(below)
            .y_label_area_size(beside)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let (fx, fy) = (label_format(x), label_format(y));
        chart
            .configure_mesh()
            .axis_style(INK)
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .label_style(pen.text(13))
            .axis_desc_style(pen.text(14))
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .x_label_formatter(&|v| fx(*v))
            .y_label_formatter(&|v| fy(*v))
            .x_labels(7)
            .y_labels(6)
            .draw()?;
        if let Some(under) = &self.under {
            chart.draw_series(under.runs().map(|(from, to, grey)| {
                Rectangle::new([from, to], RGBColor(grey, grey, grey).filled())
            }))?;
        }
        for series in &self.series {
            let colour = colour(series.colour);
            let points = || {
                series
                    .points
                    .iter()
                    .copied()
                    .filter(|p| p.0.is_finite() && p.1.is_finite())
            };
            let style = colour.stroke_width(pen.px(2) as u32);
            match series.kind {
                Kind::Line => chart.draw_series(LineSeries::new(points(), style))?,
                Kind::Dashes(dash, space) => chart.draw_series(DashedLineSeries::new(
                    points(),
                    pen.px(dash),
                    pen.px(space),
                    style,
                ))?,
                Kind::Dots => chart
                    .draw_series(points().map(|p| Circle::new(p, pen.px(3), colour.filled())))?,
                Kind::Points => chart
                    .draw_series(points().map(|p| Circle::new(p, pen.px(1), colour.filled())))?,
                Kind::Crosses => {
                    chart.draw_series(points().map(|p| Cross::new(p, pen.px(4), style)))?
                }
                Kind::Bars(w) => chart.draw_series(points().map(|(x, y)| {
                    Rectangle::new([(x - w / 2.0, 0.0), (x + w / 2.0, y)], colour.filled())
                }))?,
                Kind::Segments => chart.draw_series(series.points.chunks_exact(2).map(|p| {
                    PathElement::new(p.to_vec(), colour.stroke_width(pen.px(1) as u32))
                }))?,
                Kind::Area => chart.draw_series(std::iter::once(Polygon::new(
                    points().collect::<Vec<_>>(),
                    colour.mix(0.2).filled(),
                )))?,
            };
        }
        let inside = |at: f64| at >= x.0.min(x.1) && at <= x.0.max(x.1);
        let mut marks: Vec<&(f64, String)> = self.marks.iter().filter(|m| inside(m.0)).collect();
        marks.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Each word stands to the right of its line, the next one lower, and a line ends at its
        // word: so none crosses another's word. Where one has no room there, all stand left of
        // their lines, the last one highest.
        let edge = chart.backend_coord(&(x.1, y.0)).0;
        let style = pen.text(12);
        let mut room = true;
        for (at, word) in marks.iter().copied() {
            let (wide, _) = area.estimate_text_size(word, &style)?;
            room &= chart.backend_coord(&(*at, y.0)).0 + wide as i32 + pen.px(4) <= edge;
        }
        if !room {
            marks.reverse();
        }
        let top = chart.backend_coord(&(x.0, y.1)).1;
        let high = f64::from(chart.backend_coord(&(x.0, y.0)).1 - top);
        for (row, (at, word)) in marks.into_iter().enumerate() {
            let down = pen.px(2 + 15 * row as i32);
            let end = y.1 - (y.1 - y.0) * f64::from(down) / high.max(1.0);
            chart.draw_series(std::iter::once(PathElement::new(
                vec![(*at, y.0), (*at, end)],
                INK.mix(0.6).stroke_width(pen.px(1) as u32),
            )))?;
            let side = if room { HPos::Left } else { HPos::Right };
            let shift = (pen.px(if room { 4 } else { -4 }), 0);
            let style = style.clone().pos(Pos::new(side, VPos::Top));
            chart.draw_series(std::iter::once(
                EmptyElement::at((*at, end)) + Text::new(word.clone(), shift, style),
            ))?;
        }
        // The caller presents: that ends the file, and other charts may follow in it.
        Ok(())
    }
}

/// How large everything is drawn.
#[derive(Clone, Copy)]
struct Pen(f64);

impl Pen {
    /// A length, px.
    fn px(self, length: i32) -> i32 {
        (self.0 * f64::from(length)).round() as i32
    }

    /// Words in the page's ink.
    fn text(self, size: i32) -> TextStyle<'static> {
        ("sans-serif", self.0 * f64::from(size))
            .into_font()
            .color(&INK)
    }
}

/// Two ranges widened about their middles until a unit is as long along y as along x in an area of
/// `wide` by `high` pixels. A range that runs downwards goes on doing so.
fn equal(x: (f64, f64), y: (f64, f64), wide: f64, high: f64) -> ((f64, f64), (f64, f64)) {
    let unit = ((x.1 - x.0).abs() / wide).max((y.1 - y.0).abs() / high);
    let about = |(from, to): (f64, f64), pixels: f64| {
        let (middle, half) = (0.5 * (from + to), 0.5 * unit * pixels);
        let half = if to < from { -half } else { half };
        (middle - half, middle + half)
    };
    (about(x, wide), about(y, high))
}

impl Under {
    /// Runs of one grey along the rows: two corners and the grey, in sixteen steps. Each reaches a
    /// pixel under the next to the right and below, so that no seam shows between them.
    fn runs(&self) -> impl Iterator<Item = ((f64, f64), (f64, f64), u8)> + '_ {
        let rows = self.image.pixels.chunks(self.image.width.max(1));
        let end = [self.image.width, self.image.height];
        let reach = move |axis: usize, k: usize| {
            self.corner[axis] + self.side * (k + 1).min(end[axis]) as f64
        };
        rows.enumerate().flat_map(move |(v, row)| {
            let top = self.corner[1] + self.side * v as f64;
            let mut at = 0;
            row.chunk_by(|a, b| a / 16 == b / 16).map(move |run| {
                let place = |k: usize| self.corner[0] + self.side * k as f64;
                let from = (place(at), top);
                at += run.len();
                (from, (reach(0, at), reach(1, v + 1)), run[0] / 16 * 17)
            })
        })
    }
}

/// The legend's key of a series, its middle at (x + 9, y).
fn key<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    kind: &Kind,
    colour: RGBColor,
    (x, y): (i32, i32),
    pen: Pen,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let style = colour.stroke_width(pen.px(2) as u32);
    let (px, middle) = (|length: i32| pen.px(length), (x + pen.px(9), y));
    let line = |from: i32, to: i32| {
        area.draw(&PathElement::new(
            vec![(x + px(from), y), (x + px(to), y)],
            style,
        ))
    };
    let corners = |from: i32, to: i32| [(x + px(from), y - px(5)), (x + px(to), y + px(5))];
    match kind {
        Kind::Dots | Kind::Points => area.draw(&Circle::new(middle, px(3), colour.filled())),
        Kind::Crosses => area.draw(&Cross::new(middle, px(4), style)),
        Kind::Bars(_) => area.draw(&Rectangle::new(corners(4, 14), colour.filled())),
        Kind::Area => area.draw(&Rectangle::new(corners(2, 16), colour.mix(0.2).filled())),
        Kind::Dashes(dash, space) => {
            let mut from = 0;
            while from < 18 {
                line(from, (from + dash).min(18))?;
                from += dash + space;
            }
            Ok(())
        }
        Kind::Line | Kind::Segments => line(0, 18),
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
        match text.strip_prefix('-') {
            Some("0") => "0".into(),
            Some(rest) => format!("−{rest}"),
            None => text,
        }
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
    fn equal_axes_have_one_unit_and_keep_their_direction() {
        let (x, y) = equal((0.0, 10.0), (5.0, 3.0), 400.0, 200.0);
        assert_eq!((x, y), ((0.0, 10.0), (6.5, 1.5)));
        let (x, y) = equal((0.0, 1.0), (0.0, 10.0), 400.0, 200.0);
        assert_eq!((x, y), ((-9.5, 10.5), (0.0, 10.0)));
    }

    #[test]
    fn a_picture_lies_where_its_pixels_do() {
        let under = Under {
            image: Gray {
                width: 3,
                height: 2,
                pixels: vec![0, 1, 255, 80, 80, 80],
            },
            corner: [9.5, 4.5],
            side: 1.0,
        };
        let runs: Vec<_> = under.runs().collect();
        assert_eq!(runs.len(), 3);
        assert_eq!(runs[0], ((9.5, 4.5), (12.5, 6.5), 0));
        assert_eq!(runs[1], ((11.5, 4.5), (12.5, 6.5), 255));
        assert_eq!(runs[2], ((9.5, 5.5), (12.5, 6.5), 85));
    }

    #[test]
    fn labels_are_short() {
        assert_eq!(label_format((0.0, 60.0))(5.0), "5");
        assert_eq!(label_format((0.0, 0.5))(0.25), "0.25");
        assert_eq!(label_format((-1e-3, 1e-3))(-0.0), "0");
    }
}
