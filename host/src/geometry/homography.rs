//! Plane-to-plane projective maps (paper, Algorithm 1 lines 7–14), by the normalised direct
//! linear transform (Hartley and Zisserman, Algorithm 4.2).

use super::{Matrix3, Vector2, Vector3};
use nalgebra::{DMatrix, SMatrix};

/// A projective map of the plane, H: (x, y, 1) ↦ H·(x, y, 1), up to scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub Matrix3);

impl Homography {
    /// The map that takes `from[i]` to `to[i]` with the least algebraic error; `None` for fewer
    /// than four pairs, unequal numbers, or points that determine no map.
    pub fn fit(from: &[Vector2], to: &[Vector2]) -> Option<Self> {
        if from.len() != to.len() || from.len() < 4 {
            return None;
        }
        let (t_from, t_to) = (normalisation(from)?, normalisation(to)?);
        let mut normal = SMatrix::<f64, 9, 9>::zeros();
        for (p, q) in from.iter().zip(to) {
            let p = t_from * Vector3::new(p.x, p.y, 1.0);
            let q = t_to * Vector3::new(q.x, q.y, 1.0);
            let rows = [
                [-p.x, -p.y, -1.0, 0.0, 0.0, 0.0, q.x * p.x, q.x * p.y, q.x],
                [0.0, 0.0, 0.0, -p.x, -p.y, -1.0, q.y * p.x, q.y * p.y, q.y],
            ];
            for row in rows {
                let row = SMatrix::<f64, 9, 1>::from_row_slice(&row);
                normal += row * row.transpose();
            }
        }
        let eigen = DMatrix::from_column_slice(9, 9, normal.as_slice()).symmetric_eigen();
        let mut order: Vec<usize> = (0..9).collect();
        order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
        // A second vanishing eigenvalue: the points do not determine the map.
        if eigen.eigenvalues[order[1]] <= 1e-12 * eigen.eigenvalues[order[8]] {
            return None;
        }
        let h = eigen.eigenvectors.column(order[0]);
        let h = Matrix3::from_row_slice(&[h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]]);
        let h = t_to.try_inverse()? * h * t_from;
        let scale = if h.m33.abs() > 1e-12 * h.norm() {
            h.m33
        } else {
            h.norm()
        };
        let h = h / scale;
        h.iter().all(|x| x.is_finite()).then_some(Self(h))
    }

    /// The image of a point; not finite on the line that the map sends to infinity.
    #[inline]
    pub fn apply(&self, p: &Vector2) -> Vector2 {
        let q = self.0 * Vector3::new(p.x, p.y, 1.0);
        Vector2::new(q.x / q.z, q.y / q.z)
    }

    /// The map back; `None` if this one is singular.
    pub fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self)
    }
}

/// Moves the centroid to the origin and scales the mean distance from it to √2.
fn normalisation(points: &[Vector2]) -> Option<Matrix3> {
    let n = points.len() as f64;
    let centre = points.iter().sum::<Vector2>() / n;
    let mean = points.iter().map(|p| (p - centre).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / mean;
    s.is_finite()
        .then(|| Matrix3::new(s, 0.0, -s * centre.x, 0.0, s, -s * centre.y, 0.0, 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_an_exact_map_and_its_inverse() {
        let truth = Homography(Matrix3::new(
            4.1, -0.3, 610.0, 0.5, 3.9, 420.0, 1e-4, -2e-4, 1.0,
        ));
        let from: Vec<Vector2> = (0..48)
            .map(|i| Vector2::new((i % 8) as f64 * 10.0, (i / 8) as f64 * 10.0))
            .collect();
        let to: Vec<Vector2> = from.iter().map(|p| truth.apply(p)).collect();
        let h = Homography::fit(&from, &to).unwrap();
        let back = h.inverse().unwrap();
        for (p, q) in from.iter().zip(&to) {
            assert!((h.apply(p) - q).norm() < 1e-8);
            assert!((back.apply(q) - p).norm() < 1e-8);
        }
    }

    #[test]
    fn points_on_a_line_determine_nothing() {
        let line: Vec<Vector2> = (0..9)
            .map(|i| Vector2::new(i as f64, 2.0 * i as f64))
            .collect();
        assert!(Homography::fit(&line, &line).is_none());
        assert!(Homography::fit(&line[..3], &line[..3]).is_none());
        let same = [Vector2::new(1.0, 1.0); 6];
        assert!(Homography::fit(&same, &same).is_none());
    }
}
