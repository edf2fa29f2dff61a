//! The plane of the entry region.
//!
//! Default: least squares of orthogonal distances over pieces of surface, each weighted by its
//! area, so that the stripes' spacing does not tilt it. Paper: z = a·x + b·y + c over the points
//! (Eq. 14, 15).

use crate::geometry::{Matrix3, Plane, Point3, Vector3};
use nalgebra::{DMatrix, DVector};

/// A piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its centre, mm.
    pub position: Point3,
    /// Its area, mm².
    pub area: f64,
}

/// An orthogonal fit with what its derivatives need.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneFit {
    /// The plane.
    pub plane: Plane,
    /// The cells' centroid.
    pub centroid: Point3,
    /// Root mean square distance, mm.
    pub rms_mm: f64,
    /// Two directions in the plane, with the reciprocal of the scatter along each beyond the
    /// scatter along the normal.
    directions: [(Vector3, f64); 2],
}

impl PlaneFit {
    /// Fits; `None` for fewer than three cells or cells on one line.
    pub fn new(cells: &[Cell]) -> Option<Self> {
        let total: f64 = cells.iter().map(|c| c.area).sum();
        if cells.len() < 3 || !(total > 0.0) {
            return None;
        }
        let sum: Vector3 = cells.iter().map(|c| c.position.coords * c.area).sum();
        let centroid = Point3::from(sum / total);
        let mut scatter = Matrix3::zeros();
        for c in cells {
            let r = c.position - centroid;
            scatter += r * r.transpose() * c.area;
        }
        let (plane, values) = Plane::from_scatter(&centroid, &scatter)?;
        if !(values[1] > 1e-9 * values[2] && values[1] - values[0] > 1e-6 * values[2]) {
            return None;
        }
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
        let direction = |k: usize| {
            let e: Vector3 = eigen.eigenvectors.column(order[k]).into_owned();
            (
                e,
                1.0 / (eigen.eigenvalues[order[k]] - eigen.eigenvalues[order[0]]),
            )
        };
        Some(Self {
            plane,
            centroid,
            rms_mm: (values[0].max(0.0) / total).sqrt(),
            directions: [direction(1), direction(2)],
        })
    }

    /// How the normal turns when `cell` moves by `step`: the first-order change of the scatter's
    /// eigenvector, δn = Σᵢ eᵢ·(eᵢ·δM·n)/(λ₀ − λᵢ).
    #[inline]
    pub fn turn(&self, cell: &Cell, step: &Vector3) -> Vector3 {
        let n = &self.plane.normal;
        let r = cell.position - self.centroid;
        let (rn, sn) = (r.dot(n), step.dot(n));
        let mut turn = Vector3::zeros();
        for (e, inverse) in &self.directions {
            turn -= e * ((e.dot(&r) * sn + rn * e.dot(step)) * cell.area * inverse);
        }
        turn
    }
}

/// Eq. 15: z = a·x + b·y + c by linear least squares; gives the plane and the root mean square
/// orthogonal distance. `None` for points on one line.
pub fn least_squares<'a>(points: impl Iterator<Item = &'a Point3>) -> Option<(Plane, f64)> {
    let points: Vec<&Point3> = points.collect();
    if points.len() < 3 {
        return None;
    }
    let matrix = DMatrix::from_fn(points.len(), 3, |i, j| [points[i].x, points[i].y, 1.0][j]);
    let right = DVector::from_fn(points.len(), |i, _| points[i].z);
    let qr = matrix.qr();
    let r = qr.r();
    if (0..3).any(|i| !(r[(i, i)].abs() > 1e-9 * r[(0, 0)].abs())) {
        return None;
    }
    let x = r.solve_upper_triangular(&(qr.q().transpose() * right))?;
    let plane = Plane::new(Vector3::new(-x[0], -x[1], 1.0), -x[2])?;
    let sum: f64 = points.iter().map(|p| plane.distance(p).powi(2)).sum();
    Some((plane, (sum / points.len() as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells() -> Vec<Cell> {
        (0..400)
            .map(|i| {
                let (s, t) = (f64::from(i % 20) - 9.0, f64::from(i / 20) - 11.0);
                let z = 430.0 + 0.3 * s - 0.5 * t + 0.02 * s * t.sin() - 0.01 * s * s;
                Cell {
                    position: Point3::new(s, t, z),
                    area: 0.5 + 0.01 * f64::from(i % 7),
                }
            })
            .collect()
    }

    #[test]
    fn the_turn_is_the_derivative() {
        let cells = cells();
        let fit = PlaneFit::new(&cells).unwrap();
        for (k, step) in [
            (3, Vector3::new(0.1, -0.2, 1.0)),
            (210, Vector3::x()),
            (399, Vector3::z()),
        ] {
            let h = 1e-4;
            let moved = |sign: f64| {
                let mut c = cells.clone();
                c[k].position += step * (sign * h);
                PlaneFit::new(&c).unwrap().plane.normal
            };
            let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * h);
            assert!((numeric - fit.turn(&cells[k], &step)).norm() < 1e-8);
        }
    }

    /// Eq. 15 by Cramer's rule on the normal equations.
    #[test]
    fn least_squares_agrees_with_the_normal_equations() {
        let cells = cells();
        let (plane, _) = least_squares(cells.iter().map(|c| &c.position)).unwrap();
        let (mut m, mut r) = (Matrix3::zeros(), Vector3::zeros());
        for c in &cells {
            let row = Vector3::new(c.position.x, c.position.y, 1.0);
            m += row * row.transpose();
            r += row * c.position.z;
        }
        let det = m.determinant();
        let solve = |k: usize| {
            let mut mk = m;
            mk.set_column(k, &r);
            mk.determinant() / det
        };
        let n = plane.normal;
        for (k, got) in [-n.x / n.z, -n.y / n.z, -plane.d / n.z]
            .into_iter()
            .enumerate()
        {
            assert!((got - solve(k)).abs() < 1e-9 * (1.0 + got.abs()));
        }
    }

    #[test]
    fn a_line_is_no_plane() {
        let cells: Vec<Cell> = (0..50)
            .map(|i| Cell {
                position: Point3::new(f64::from(i), 2.0 * f64::from(i), 400.0 + f64::from(i)),
                area: 1.0,
            })
            .collect();
        assert!(PlaneFit::new(&cells).is_none());
        assert!(least_squares(cells.iter().map(|c| &c.position)).is_none());
    }
}
