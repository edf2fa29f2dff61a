//! The checkerboard's outline in the image, from its corners.

use crate::geometry::Vector2;
use nalgebra::{Matrix3, SMatrix, Vector3};

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
        let map = homography(&grid, corners)?;
        // Lens distortion bends the grid by a few pixels, a wrong order of corners by squares.
        let square = (corners[1] - corners[0]).norm();
        let misfit = grid
            .iter()
            .zip(corners)
            .map(|(g, c)| (apply(&map, g) - c).norm())
            .fold(0.0, f64::max);
        if !(misfit < 0.5 * square) {
            return None;
        }
        let (x0, y0) = (-1.0 + RIM, -1.0 + RIM);
        let (x1, y1) = (columns as f64 - RIM, rows as f64 - RIM);
        let vertices =
            [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| apply(&map, &Vector2::new(x, y)));
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

/// The map of the plane's points to the image's: the direct linear transform on centred, scaled points.
fn homography(from: &[Vector2], to: &[Vector2]) -> Option<Matrix3<f64>> {
    let normal = |points: &[Vector2]| -> Option<Matrix3<f64>> {
        let n = points.len() as f64;
        let mean = points.iter().sum::<Vector2>() / n;
        let spread = points.iter().map(|p| (p - mean).norm()).sum::<f64>() / n;
        let k = std::f64::consts::SQRT_2 / spread;
        k.is_finite()
            .then(|| Matrix3::new(k, 0.0, -k * mean.x, 0.0, k, -k * mean.y, 0.0, 0.0, 1.0))
    };
    let (a, b) = (normal(from)?, normal(to)?);
    let mut m = SMatrix::<f64, 9, 9>::zeros();
    for (p, q) in from.iter().zip(to) {
        let (p, q) = (apply(&a, p), apply(&b, q));
        let x = [p.x, p.y, 1.0];
        for (sign, along) in [(q.x, 0), (q.y, 1)] {
            let mut row = SMatrix::<f64, 9, 1>::zeros();
            for k in 0..3 {
                row[3 * along + k] = x[k];
                row[6 + k] = -sign * x[k];
            }
            m += row * row.transpose();
        }
    }
    let eigen = m.symmetric_eigen();
    let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let map = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    Some(b.try_inverse()? * map * a)
}

fn apply(map: &Matrix3<f64>, p: &Vector2) -> Vector2 {
    let q = map * Vector3::new(p.x, p.y, 1.0);
    Vector2::new(q.x / q.z, q.y / q.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_lies_one_square_beyond_the_corners() {
        let map = Matrix3::new(40.0, 3.0, 200.0, -5.0, 42.0, 150.0, 2e-3, -1e-3, 1.0);
        let corners: Vec<Vector2> = (0..48)
            .map(|i| apply(&map, &Vector2::new((i % 8) as f64, (i / 8) as f64)))
            .collect();
        let outline = Outline::new(&corners, 8, 6).unwrap();
        let expected = apply(&map, &Vector2::new(-1.0 + RIM, -1.0 + RIM));
        assert!((outline.vertices[0] - expected).norm() < 1e-6);
        let middle = apply(&map, &Vector2::new(3.0, 2.0));
        let (low, high) = outline.rows(middle.x).unwrap();
        assert!(low < middle.y && middle.y < high);
        assert!(outline.rows(0.0).is_none());
        let mut shuffled = corners.clone();
        shuffled.swap(0, 47);
        assert!(Outline::new(&shuffled, 8, 6).is_none());
        assert!(Outline::new(&corners[1..], 8, 6).is_none());
    }
}
