//! Plane-to-plane projective maps (paper, Algorithm 1 lines 7–14; Zhang 2000, appendix A), by the
//! normalised direct linear transform (Hartley and Zisserman, Multiple View Geometry, § 4.4).

use super::{Matrix3, Vector2, Vector3};
use nalgebra::SMatrix;

/// A projective map of the plane, H: (x, y, 1) ↦ H·(x, y, 1), up to scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub Matrix3);

/// Why pairs of points give no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HomographyError {
    /// Fewer than four pairs, or as many on one side as not on the other.
    #[error("{from} points onto {to}: four or more pairs are needed")]
    Pairs {
        /// Points to map.
        from: usize,
        /// Where they go.
        to: usize,
    },
    /// All points but one lie on a line, or a coordinate is not a number.
    #[error("all points or all but one lie on a line, or are no numbers: they determine no map")]
    Degenerate,
}

/// A pivot below this part of its diagonal element is rounding: the rank is not full.
const RANK: f64 = 1e-11;

impl Homography {
    /// The map that takes `from[i]` to `to[i]` with the least algebraic error, scaled so that the
    /// centroid of `from` has weight 1.
    ///
    /// That centroid must not map to infinity (a board before the camera never does): its weight can
    /// then be held, and eight unknowns remain.
    ///
    /// # Errors
    /// Too few pairs, or points that determine no map.
    pub fn fit(from: &[Vector2], to: &[Vector2]) -> Result<Self, HomographyError> {
        if from.len() < 4 || from.len() != to.len() {
            return Err(HomographyError::Pairs {
                from: from.len(),
                to: to.len(),
            });
        }
        let (before, after) = (Normalisation::of(from)?, Normalisation::of(to)?);
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SMatrix::<f64, 8, 1>::zeros();
        for (p, q) in from.iter().zip(to) {
            let (p, q) = (before.apply(p), after.apply(q));
            for (row, value) in [
                ([p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y], q.x),
                ([0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y], q.y),
            ] {
                let row = SMatrix::<f64, 8, 1>::from(row);
                normal += row * row.transpose();
                right += row * value;
            }
        }
        let factor = normal.cholesky().ok_or(HomographyError::Degenerate)?;
        let pivots = factor.l_dirty().diagonal();
        if (0..8).any(|i| !(pivots[i] * pivots[i] > RANK * normal[(i, i)])) {
            return Err(HomographyError::Degenerate);
        }
        let h = factor.solve(&right);
        let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
        let h = after.inverse() * h * before.matrix();
        if h.iter().all(|x| x.is_finite()) {
            Ok(Self(h))
        } else {
            Err(HomographyError::Degenerate)
        }
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

/// Shift and scale that bring points to their centroid and to a mean squared radius of 2.
struct Normalisation {
    centre: Vector2,
    scale: f64,
}

impl Normalisation {
    fn of(points: &[Vector2]) -> Result<Self, HomographyError> {
        let n = points.len() as f64;
        let centre = points.iter().sum::<Vector2>() / n;
        let square = |p: &Vector2| (p - centre).norm_squared();
        let spread = points.iter().map(square).sum::<f64>() / n;
        if spread > 0.0 && spread.is_finite() {
            let scale = (2.0 / spread).sqrt();
            Ok(Self { centre, scale })
        } else {
            Err(HomographyError::Degenerate)
        }
    }

    fn apply(&self, p: &Vector2) -> Vector2 {
        (p - self.centre) * self.scale
    }

    fn matrix(&self) -> Matrix3 {
        let (s, c) = (self.scale, self.centre);
        Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0)
    }

    fn inverse(&self) -> Matrix3 {
        let (s, c) = (1.0 / self.scale, self.centre);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }
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
        let degenerate = Err(HomographyError::Degenerate);
        assert_eq!(Homography::fit(&line, &line), degenerate);
        let same = [Vector2::new(1.0, 1.0); 6];
        assert_eq!(Homography::fit(&same, &same), degenerate);
        // All on a line but one.
        let mut but_one = line.clone();
        but_one[3] = Vector2::new(9.0, 1.0);
        assert_eq!(Homography::fit(&but_one, &but_one), degenerate);
        let mut nowhere = but_one;
        nowhere[0].x = f64::NAN;
        assert_eq!(Homography::fit(&nowhere, &line), degenerate);
        for (from, to) in [(3, 3), (5, 4)] {
            let said = Homography::fit(&line[..from], &line[..to]);
            assert_eq!(said, Err(HomographyError::Pairs { from, to }));
        }
    }

    /// One of the four comes near the line through two others: exact as long as the rank is full.
    #[test]
    fn four_points_are_met_exactly() {
        let to = [
            (610.0, 420.0),
            (912.0, 433.0),
            (640.0, 701.0),
            (930.0, 690.0),
        ]
        .map(|(u, v)| Vector2::new(u, v));
        for depth in [10.0, 1.0, 0.1] {
            let from = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0), (5.0 + depth, 5.0)]
                .map(|(x, y)| Vector2::new(x, y));
            let h = Homography::fit(&from, &to).unwrap();
            for (p, q) in from.iter().zip(&to) {
                assert!((h.apply(p) - q).norm() < 1e-6, "{depth}");
            }
        }
    }
}
