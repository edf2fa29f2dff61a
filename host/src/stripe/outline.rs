//! The checkerboard's outline in the image, from its corners.

use crate::geometry::{Homography, Vector2};

/// Fraction of a square left out along the outline: its rim may lie on a bright margin or beyond the board.
const RIM: f64 = 0.06;

/// The quadrilateral of all squares (one beyond the outer inner corners on each side).
#[derive(Clone, Debug)]
pub(super) struct Outline {
    /// In order around the board, px.
    vertices: [Vector2; 4],
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
        let (x0, y0) = (-1.0 + RIM, -1.0 + RIM);
        let (x1, y1) = (columns as f64 - RIM, rows as f64 - RIM);
        let vertices =
            [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| map.apply(&Vector2::new(x, y)));
        vertices
            .iter()
            .all(|v| v.x.is_finite() && v.y.is_finite())
            .then_some(Self { vertices })
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
        let mut shuffled = corners.clone();
        shuffled.swap(0, 47);
        assert!(Outline::new(&shuffled, 8, 6).is_none());
        assert!(Outline::new(&corners[1..], 8, 6).is_none());
    }
}
