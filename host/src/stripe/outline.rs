//! The checkerboard's outline in the image, from its corners.

use crate::geometry::{Homography, Vector2};

/// Fraction of a square left out along the outline: its rim may lie on a bright margin or beyond the board.
const RIM: f64 = 0.06;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "board stripe: left out along the board’s outline",
        format!("{RIM} of a square"),
    )]
}

/// The quadrilateral of all squares (one beyond the outer inner corners on each side).
#[derive(Clone, Debug)]
pub(super) struct Outline {
    /// In order around the board, px.
    vertices: [Vector2; 4],
    /// From the corners' grid (inner corner (i, j) at (i, j)) to the image.
    map: Homography,
    columns: f64,
    rows: f64,
}

impl Outline {
    /// From the inner corners in the board's order; `None` if they are not such a grid.
    pub fn new(corners: &[Vector2], columns: usize, rows: usize) -> Option<Self> {
        if corners.len() != columns * rows || columns < 2 || rows < 2 {
            return None;
        }
        if corners
            .iter()
            .any(|c| !(c.x.is_finite() && c.y.is_finite()))
        {
            return None;
        }
        let grid: Vec<Vector2> = (0..corners.len())
            .map(|i| Vector2::new((i % columns) as f64, (i / columns) as f64))
            .collect();
        let map = Homography::fit(&grid, corners).ok()?;
        // Lens distortion bends the grid by a few pixels, a wrong order of corners by squares.
        let square = (corners[1] - corners[0]).norm();
        let misfit = grid
            .iter()
            .zip(corners)
            .map(|(g, c)| (map.apply(g) - c).norm())
            .fold(0.0, f64::max);
        if !(misfit < 0.5 * square) {
            return None;
        }
        Self::around(map, columns as f64, rows as f64, -RIM)
    }

    /// The quadrilateral `margin` squares outside the outer squares.
    fn around(map: Homography, columns: f64, rows: f64, margin: f64) -> Option<Self> {
        let (low, x1, y1) = (-1.0 - margin, columns + margin, rows + margin);
        let vertices = [(low, low), (x1, low), (x1, y1), (low, y1)]
            .map(|(x, y)| map.apply(&Vector2::new(x, y)));
        let finite = |v: &Vector2| v.x.is_finite() && v.y.is_finite();
        vertices.iter().all(finite).then_some(Self {
            vertices,
            map,
            columns,
            rows,
        })
    }

    /// The same board with `margin` squares of its surroundings.
    pub fn widened(&self, margin: f64) -> Option<Self> {
        Self::around(self.map, self.columns, self.rows, margin)
    }

    /// How far a pixel lies outside the outer squares, squares; 0 on them.
    pub fn beyond(&self, pixel: &Vector2) -> Option<f64> {
        let at = self.map.inverse()?.apply(pixel);
        let out = |x: f64, end: f64| (-1.0 - x).max(x - end).max(0.0);
        Some(out(at.x, self.columns).max(out(at.y, self.rows)))
    }

    /// Least and greatest column and row.
    pub fn bounds(&self) -> (Vector2, Vector2) {
        self.vertices
            .iter()
            .fold((self.vertices[0], self.vertices[0]), |(low, high), v| {
                (low.inf(v), high.sup(v))
            })
    }

    /// The rows that column `u` has on the board.
    pub fn rows(&self, u: f64) -> Option<(f64, f64)> {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..4 {
            let (a, b) = (self.vertices[i], self.vertices[(i + 1) % 4]);
            if (a.x - u) * (b.x - u) <= 0.0 && a.x != b.x {
                let v = a.y + (b.y - a.y) * (u - a.x) / (b.x - a.x);
                low = low.min(v);
                high = high.max(v);
            }
        }
        (low < high).then_some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Matrix3;

    #[test]
    fn the_outline_lies_one_square_beyond_the_corners() {
        let map = Homography(Matrix3::new(
            40.0, 3.0, 200.0, -5.0, 42.0, 150.0, 2e-3, -1e-3, 1.0,
        ));
        let corners: Vec<Vector2> = (0..48)
            .map(|i| map.apply(&Vector2::new((i % 8) as f64, (i / 8) as f64)))
            .collect();
        let outline = Outline::new(&corners, 8, 6).unwrap();
        let expected = map.apply(&Vector2::new(-1.0 + RIM, -1.0 + RIM));
        assert!((outline.vertices[0] - expected).norm() < 1e-6);
        let middle = map.apply(&Vector2::new(3.0, 2.0));
        let (low, high) = outline.rows(middle.x).unwrap();
        assert!(low < middle.y && middle.y < high);
        assert!(outline.rows(0.0).is_none());
        let wide = outline.widened(2.0).unwrap();
        assert!((wide.vertices[2] - map.apply(&Vector2::new(10.0, 8.0))).norm() < 1e-6);
        let beyond = |x, y| outline.beyond(&map.apply(&Vector2::new(x, y))).unwrap();
        assert!((beyond(-2.5, 3.0) - 1.5).abs() < 1e-9 && beyond(7.5, 5.5) == 0.0);
        let mut shuffled = corners.clone();
        shuffled.swap(0, 47);
        assert!(Outline::new(&shuffled, 8, 6).is_none());
        assert!(Outline::new(&corners[1..], 8, 6).is_none());
    }
}
