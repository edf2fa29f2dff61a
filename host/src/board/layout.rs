//! Which of a grid's corners are the board's, and in which order; or what is wrong with the grid.

use super::candidate::Candidate;
use super::grid::{Grid, bounds, predict};
use super::levels::Level;
use super::{BoardGeometry, NotFound, Sides};
use crate::geometry::Vector2;

/// The board's corners in order, each with its place and steps in image pixels.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub places: Vec<Place>,
    /// Whether the square between +x and +y of corner 0 is dark.
    pub dark_first: bool,
}

/// Where a corner is or should be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub position: Vector2,
    /// Whether the search saw it, or the grid only predicts it.
    pub seen: bool,
}

/// A part of the places that may be missing from a board that is still taken as found.
const MISSING: f64 = 0.4;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "board: corners that may be missing",
        format!("{:.0} %", 100.0 * MISSING),
    )]
}

/// Lays the board onto a grid. `saturation` is the level's value of a saturated pixel.
pub(super) fn lay_out(
    grid: &Grid,
    candidates: &[Candidate],
    geometry: &BoardGeometry,
    level: &Level,
    saturation: f32,
) -> Result<Layout, NotFound> {
    let (columns, rows) = (geometry.columns as i32, geometry.rows as i32);
    let mut frame = Frame::new(grid, candidates, level, saturation);
    frame.strip();
    let (w, h) = frame.size();
    let wrong_count = |(w, h): (i32, i32)| NotFound::WrongCount {
        found_columns: w.max(h) as usize,
        found_rows: w.min(h) as usize,
        columns: columns as usize,
        rows: rows as usize,
    };
    // Along which of the grid's directions the board's x axis runs.
    let upright = w <= columns && h <= rows;
    let turned = w <= rows && h <= columns;
    let (target, exact) = match (upright, turned) {
        (false, false) => return Err(wrong_count((w, h))),
        (true, false) => ((columns, rows), false),
        (false, true) => ((rows, columns), false),
        // Both could be: the one that is already full, or else the one with fewer lines missing.
        (true, true) if (w, h) == (rows, columns) => ((rows, columns), true),
        (true, true) => ((columns, rows), (w, h) == (columns, rows)),
    };
    if !exact {
        frame.widen(target, 0)?;
        frame.widen(target, 1)?;
    }
    if frame.size() != target {
        return Err(if frame.holes().is_empty() {
            wrong_count(frame.size())
        } else {
            frame.hidden()
        });
    }
    let holes = frame.holes();
    if holes.len() as f64 > MISSING * f64::from(columns * rows) {
        return Err(frame.hidden());
    }
    frame.inside(&holes)?;
    if holes.iter().any(|&p| frame.glaring(p)) {
        return Err(frame.hidden());
    }
    Ok(frame.ordered(columns, rows))
}

/// A rectangle of grid places.
struct Frame<'a> {
    grid: &'a Grid,
    candidates: &'a [Candidate],
    level: &'a Level,
    saturation: f32,
    low: (i32, i32),
    high: (i32, i32),
    /// White minus black, median of the corners seen.
    contrast: f32,
}

impl<'a> Frame<'a> {
    fn new(grid: &'a Grid, candidates: &'a [Candidate], level: &'a Level, saturation: f32) -> Self {
        let (low, high) = bounds(&grid.cells);
        let mut contrasts: Vec<f32> = grid
            .cells
            .iter()
            .map(|c| candidates[c.1].contrast)
            .collect();
        contrasts.sort_unstable_by(f32::total_cmp);
        Self {
            grid,
            candidates,
            level,
            saturation,
            low,
            high,
            contrast: contrasts[contrasts.len() / 2],
        }
    }

    fn size(&self) -> (i32, i32) {
        (self.high.0 - self.low.0 + 1, self.high.1 - self.low.1 + 1)
    }

    fn seen(&self, place: (i32, i32)) -> Option<&Candidate> {
        self.grid
            .cells
            .iter()
            .find(|c| c.0 == place)
            .map(|c| &self.candidates[c.1])
    }

    /// Takes off border lines with hardly a corner on them: chance finds beside the board.
    fn strip(&mut self) {
        loop {
            let (w, h) = self.size();
            let count = |on: &dyn Fn((i32, i32)) -> bool| {
                let inside = |c: &&((i32, i32), usize)| {
                    (self.low.0..=self.high.0).contains(&c.0.0)
                        && (self.low.1..=self.high.1).contains(&c.0.1)
                };
                self.grid
                    .cells
                    .iter()
                    .filter(inside)
                    .filter(|c| on(c.0))
                    .count() as i32
            };
            let (low, high) = (self.low, self.high);
            let weak = |n: i32, length: i32| n < 2 || 4 * n < length;
            if w > 2 && weak(count(&|p| p.0 == low.0), h) {
                self.low.0 += 1;
            } else if w > 2 && weak(count(&|p| p.0 == high.0), h) {
                self.high.0 -= 1;
            } else if h > 2 && weak(count(&|p| p.1 == low.1), w) {
                self.low.1 += 1;
            } else if h > 2 && weak(count(&|p| p.1 == high.1), w) {
                self.high.1 -= 1;
            } else {
                break;
            }
        }
    }

    /// Adds lines along `axis` that the image shows although the search did not see their corners
    /// (a stripe may lie along them), until the target's size; says what hides them otherwise.
    fn widen(&mut self, target: (i32, i32), axis: usize) -> Result<(), NotFound> {
        loop {
            let (size, wanted) = if axis == 0 {
                (self.size().0, target.0)
            } else {
                (self.size().1, target.1)
            };
            if size >= wanted {
                return Ok(());
            }
            let lines = [self.line(axis, false), self.line(axis, true)];
            let shown = lines.each_ref().map(|line| {
                let n = line.iter().filter(|&&p| self.shows_corner(p)).count();
                n as f64 / line.len() as f64
            });
            let side = usize::from(shown[1] > shown[0]);
            if shown[side] < 0.6 {
                let outside: Vec<(i32, i32)> = lines
                    .iter()
                    .filter(|line| line.iter().any(|&p| self.outside(p).is_some()))
                    .flatten()
                    .copied()
                    .collect();
                self.inside(&outside)?;
                let glaring = |line: &&Vec<(i32, i32)>| {
                    2 * line.iter().filter(|&&p| self.glaring(p)).count() > line.len()
                };
                if let Some(line) = lines.iter().find(glaring) {
                    return Err(NotFound::Glare { hidden: line.len() });
                }
                return Ok(());
            }
            match (axis, side) {
                (0, 0) => self.low.0 -= 1,
                (0, _) => self.high.0 += 1,
                (_, 0) => self.low.1 -= 1,
                _ => self.high.1 += 1,
            }
        }
    }

    /// The places of the next line beyond the frame.
    fn line(&self, axis: usize, upper: bool) -> Vec<(i32, i32)> {
        if axis == 0 {
            let i = if upper {
                self.high.0 + 1
            } else {
                self.low.0 - 1
            };
            (self.low.1..=self.high.1).map(|j| (i, j)).collect()
        } else {
            let j = if upper {
                self.high.1 + 1
            } else {
                self.low.1 - 1
            };
            (self.low.0..=self.high.0).map(|i| (i, j)).collect()
        }
    }

    fn holes(&self) -> Vec<(i32, i32)> {
        let mut holes = Vec::new();
        for j in self.low.1..=self.high.1 {
            for i in self.low.0..=self.high.0 {
                if self.seen((i, j)).is_none() {
                    holes.push((i, j));
                }
            }
        }
        holes
    }

    fn predict(&self, place: (i32, i32)) -> (Vector2, Vector2, Vector2) {
        predict(&self.grid.map, f64::from(place.0), f64::from(place.1))
    }

    /// Mean grey of the four squares around a place, near the corner: (+,+), (−,+), (−,−), (+,−).
    fn squares(&self, place: (i32, i32)) -> [f32; 4] {
        let (p, ex, ey) = self.predict(place);
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(sx, sy)| {
            let mut sum = 0.0;
            for (a, b) in [(0.2, 0.2), (0.3, 0.2), (0.2, 0.3), (0.3, 0.3)] {
                let q = p + ex * (a * sx) + ey * (b * sy);
                sum += self.level.sample(q.x as f32, q.y as f32);
            }
            0.25 * sum
        })
    }

    /// Whether the colours around a place are those of a corner of this grid: at least three of the
    /// four borders between the squares show the right step (a stripe may spoil one square).
    fn shows_corner(&self, place: (i32, i32)) -> bool {
        if self.outside(place).is_some() {
            return false;
        }
        let grey = self.squares(place);
        let even = (place.0 + place.1).rem_euclid(2) == 0;
        let right = (0..4)
            .filter(|&k| {
                // Square 0 of an even place is dark.
                let dark_first = (k % 2 == 0) == even;
                let step = grey[(k + 1) % 4] - grey[k];
                (if dark_first { step } else { -step }) > 0.4 * self.contrast
            })
            .count();
        right >= 3
    }

    /// Whether all four squares around a place are saturated.
    fn glaring(&self, place: (i32, i32)) -> bool {
        self.outside(place).is_none()
            && self
                .squares(place)
                .iter()
                .filter(|&&g| g >= 0.97 * self.saturation)
                .count()
                >= 3
    }

    /// The edges of the image that a place lies beyond, or so near that a quarter square is cut.
    fn outside(&self, place: (i32, i32)) -> Option<Sides> {
        let (p, ex, ey) = self.predict(place);
        let margin_x = 0.25 * ex.x.abs().max(ey.x.abs());
        let margin_y = 0.25 * ex.y.abs().max(ey.y.abs());
        let (w, h) = (self.level.width as f64, self.level.height as f64);
        let sides = Sides {
            left: p.x < margin_x - 0.5,
            right: p.x > w - 0.5 - margin_x,
            top: p.y < margin_y - 0.5,
            bottom: p.y > h - 0.5 - margin_y,
        };
        (sides != Sides::default()).then_some(sides)
    }

    /// An error if any of the places is outside.
    fn inside(&self, places: &[(i32, i32)]) -> Result<(), NotFound> {
        let mut sides = Sides::default();
        for s in places.iter().filter_map(|&p| self.outside(p)) {
            sides.left |= s.left;
            sides.right |= s.right;
            sides.top |= s.top;
            sides.bottom |= s.bottom;
        }
        if sides == Sides::default() {
            return Ok(());
        }
        Err(NotFound::PartlyOutside {
            seen: self.grid.cells.len(),
            sides,
        })
    }

    /// The reason for the holes in the frame.
    fn hidden(&self) -> NotFound {
        let holes = self.holes();
        let glaring = holes.iter().filter(|&&p| self.glaring(p)).count();
        if glaring > 0 && 2 * glaring >= holes.len().min(4) {
            return NotFound::Glare {
                hidden: holes.len(),
            };
        }
        let (p, _, _) = self.predict(holes.first().copied().unwrap_or(self.low));
        NotFound::Hidden {
            hidden: holes.len(),
            near: Vector2::from(self.level.to_image(p.into())),
        }
    }

    /// The frame's corners in the board's order. Of the turns that fit, one with a dark first
    /// square is taken (which settles the matter where columns + rows is odd), and of those the one
    /// whose x axis points most to the right.
    fn ordered(&self, columns: i32, rows: i32) -> Layout {
        let ((i0, j0), (i1, j1)) = (self.low, self.high);
        // Origin, x step, y step, and the square between x and y (0 is (+,+), clockwise).
        let turns = [
            ((i0, j0), (1, 0), (0, 1), 0),
            ((i1, j0), (0, 1), (-1, 0), 1),
            ((i1, j1), (-1, 0), (0, -1), 2),
            ((i0, j1), (0, -1), (1, 0), 3),
        ];
        let upright = self.size() == (columns, rows);
        let turned = self.size() == (rows, columns);
        let dark = |o: (i32, i32), square: i32| (o.0 + o.1 + square).rem_euclid(2) == 0;
        let rightward = |o: (i32, i32), x: (i32, i32), length: i32| {
            let (p, ..) = self.predict(o);
            let (q, ..) = self.predict((o.0 + x.0 * (length - 1), o.1 + x.1 * (length - 1)));
            (q - p).normalize().x
        };
        let fitting = turns
            .iter()
            .filter(|t| if t.3 % 2 == 0 { upright } else { turned });
        let best = fitting.max_by(|a, b| {
            let rank = |origin, x, square| (dark(origin, square), rightward(origin, x, columns));
            let (a, b) = (rank(a.0, a.1, a.3), rank(b.0, b.1, b.3));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        let &(origin, x, y, square) = best.unwrap_or(&turns[0]);
        let mut places = Vec::with_capacity((columns * rows) as usize);
        for row in 0..rows {
            for column in 0..columns {
                let place = (
                    origin.0 + column * x.0 + row * y.0,
                    origin.1 + column * x.1 + row * y.1,
                );
                let seen = self.seen(place);
                let p = match seen {
                    Some(c) => c.position.map(f64::from),
                    None => self.predict(place).0.into(),
                };
                places.push(Place {
                    position: Vector2::from(self.level.to_image(p)),
                    seen: seen.is_some(),
                });
            }
        }
        Layout {
            places,
            dark_first: dark(origin, square),
        }
    }
}
