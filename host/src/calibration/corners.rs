//! Residuals of board corners: the pixel where Eq. 1–2 and 6 put a corner less the measured one,
//! whitened by the corner's covariance, under Huber's loss.

use super::solve::{Block, POSE};
use crate::board::{BoardGeometry, Corner};
use crate::geometry::{Camera, PARAMETERS, Point3, Pose, Vector2, Vector3};
use crate::simd::widest;

/// Huber's threshold in standard deviations of a whitened two-dimensional residual: 1 % of good
/// corners lie beyond it.
const HUBER: f64 = 3.0;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![("corners: Huber’s threshold", format!("{HUBER} σ"))]
}

/// Smallest variance factor that is told from zero (exact data).
const LEAST_VARIANCE: f64 = 1e-10;

/// One view's corners made ready for the solver.
#[derive(Clone, Debug)]
pub struct CornerView {
    corners: Vec<Prepared>,
    /// Whether its residuals say anything of the others'.
    counts: bool,
}

#[derive(Clone, Copy, Debug)]
struct Prepared {
    point: Point3,
    pixel: Vector2,
    /// Inverse Cholesky factor of the covariance: (w11, w21, w22).
    whitening: [f64; 3],
}

impl CornerView {
    /// `None` where a corner or its covariance is not a number or not positive definite.
    pub fn new(corners: &[Corner], board: &BoardGeometry) -> Option<Self> {
        let corners = corners
            .iter()
            .enumerate()
            .map(|(i, corner)| {
                let c = &corner.covariance;
                let l11 = c.m11.sqrt();
                let l21 = c.m12 / l11;
                let l22 = (c.m22 - l21 * l21).sqrt();
                let whitening = [1.0 / l11, -l21 / (l11 * l22), 1.0 / l22];
                let good = l11 > 0.0
                    && l22 > 0.0
                    && corner.pixel.iter().chain(&whitening).all(|v| v.is_finite());
                good.then(|| Prepared {
                    point: board.point(i),
                    pixel: corner.pixel,
                    whitening,
                })
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self {
            corners,
            counts: true,
        })
    }

    /// The view with hardly any weight: enough to hold its own pose, too little to move the rest.
    pub fn set_aside(mut self) -> Self {
        for corner in &mut self.corners {
            corner.whitening = corner.whitening.map(|w| 1e-3 * w);
        }
        self.counts = false;
        self
    }

    /// How many corners there are.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// Adds the view's normal equations, residuals divided by `scale` (the standard deviation of
    /// a whitened residual); false where a corner falls behind the camera.
    pub fn linearise<const G: usize>(
        &self,
        camera: &Camera,
        pose: &Pose,
        scale: f64,
        block: &mut Block<G>,
    ) -> bool {
        let mut done = false;
        widest(
            #[inline(always)]
            || done = self.add(camera, pose, scale, block),
        );
        done
    }

    #[inline(always)]
    fn add<const G: usize>(
        &self,
        camera: &Camera,
        pose: &Pose,
        scale: f64,
        block: &mut Block<G>,
    ) -> bool {
        let inverse = 1.0 / scale;
        for corner in &self.corners {
            let r = pose.rotation * corner.point.coords;
            let Some(j) = camera.project_with_jacobian(&Point3::from(r + pose.translation)) else {
                return false;
            };
            let [w11, w21, w22] = corner.whitening.map(|w| w * inverse);
            let e = j.pixel - corner.pixel;
            let (e1, e2) = (w11 * e.x, w21 * e.x + w22 * e.y);
            let d2 = e1 * e1 + e2 * e2;
            let (cost, weight) = huber(d2);
            block.cost += cost;
            // a·(ω × r) = ω·(r × a)
            let a1: Vector3 = j.by_point.row(0).transpose();
            let a2: Vector3 = j.by_point.row(1).transpose();
            let (m1, m2) = (r.cross(&a1), r.cross(&a2));
            let pose_u = [m1.x, m1.y, m1.z, a1.x, a1.y, a1.z];
            let pose_v = [m2.x, m2.y, m2.z, a2.x, a2.y, a2.z];
            let (mut g1, mut g2) = ([0.0; PARAMETERS], [0.0; PARAMETERS]);
            for i in 0..PARAMETERS {
                g1[i] = w11 * j.by_camera[(0, i)];
                g2[i] = w21 * j.by_camera[(0, i)] + w22 * j.by_camera[(1, i)];
            }
            let (mut p1, mut p2) = ([0.0; POSE], [0.0; POSE]);
            for i in 0..POSE {
                p1[i] = w11 * pose_u[i];
                p2[i] = w21 * pose_u[i] + w22 * pose_v[i];
            }
            block.add_row(&g1, &p1, e1, weight);
            block.add_row(&g2, &p2, e2, weight);
        }
        true
    }

    /// What the residuals of this view look like.
    pub fn residuals(&self, camera: &Camera, pose: &Pose, scale: f64, out: &mut Residuals) {
        if !self.counts {
            return;
        }
        for corner in &self.corners {
            let Some(seen) = camera.project(&pose.apply(&corner.point)) else {
                continue;
            };
            let [w11, w21, w22] = corner.whitening;
            let e = seen - corner.pixel;
            let d2 = (w11 * e.x).powi(2) + (w21 * e.x + w22 * e.y).powi(2);
            out.squared_px += e.norm_squared();
            out.whitened.push(d2);
            out.clipped += d2.min((HUBER * scale).powi(2));
        }
    }
}

/// Residuals of one or several views.
#[derive(Clone, Debug, Default)]
pub struct Residuals {
    /// Squared whitened residual of every corner (two degrees of freedom each).
    pub whitened: Vec<f64>,
    /// Their sum, each cut off at Huber's threshold (Huber's ψ²: what an outlier may add to the
    /// variance of the result).
    pub clipped: f64,
    /// Sum of squared distances, px².
    pub squared_px: f64,
}

impl Residuals {
    /// Root mean square distance, px (as OpenCV counts it: per corner, not per coordinate).
    pub fn rms_px(&self) -> f64 {
        (self.squared_px / self.whitened.len().max(1) as f64).sqrt()
    }

    /// Variance of a whitened residual, for so many unknowns fitted to these. Cutting off takes
    /// e^(−9/2) of a χ² of two degrees of freedom; that is given back.
    pub fn variance(&self, unknowns: usize) -> f64 {
        let freedom = (2 * self.whitened.len()).saturating_sub(unknowns).max(1);
        self.clipped / (freedom as f64 * (1.0 - (-0.5 * HUBER * HUBER).exp()))
    }

    /// Standard deviation of a whitened residual from the median: half of a χ² of two degrees of
    /// freedom lies below 2·ln 2.
    pub fn median_scale(&self) -> f64 {
        let mut d2 = self.whitened.clone();
        if d2.is_empty() {
            return 1.0;
        }
        let middle = d2.len() / 2;
        let (_, median, _) = d2.select_nth_unstable_by(middle, f64::total_cmp);
        (*median / (2.0 * std::f64::consts::LN_2))
            .max(LEAST_VARIANCE)
            .sqrt()
    }
}

/// Huber's ρ and weight for a squared residual of unit variance.
#[inline]
fn huber(d2: f64) -> (f64, f64) {
    if d2 <= HUBER * HUBER {
        (d2, 1.0)
    } else {
        let d = d2.sqrt();
        (HUBER * (2.0 * d - HUBER), HUBER / d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::solve::moved;
    use crate::geometry::Matrix2;
    use crate::synthetic::{BOARD, camera};
    use nalgebra::Rotation3;

    /// The gradient (outliers included) against central differences of the cost.
    #[test]
    fn gradient_agrees_with_differences() {
        let board = BOARD;
        let camera = camera();
        let pose = Pose {
            rotation: Rotation3::new(Vector3::new(0.3, -0.2, 1.1)),
            translation: Vector3::new(-10.0, -40.0, 430.0),
        };
        let corners: Vec<_> = (0..48)
            .map(|i| Corner {
                pixel: camera.project(&pose.apply(&board.point(i))).unwrap()
                    + Vector2::new((i as f64).sin(), (2.3 * i as f64).cos())
                        * if i % 7 == 0 { 3.0 } else { 0.3 },
                covariance: Matrix2::new(0.04, 0.01, 0.01, 0.09),
            })
            .collect();
        let view = CornerView::new(&corners, &board).unwrap();
        let at = |camera: &Camera, pose: &Pose| {
            let mut block = Block::<PARAMETERS>::zero();
            assert!(view.linearise(camera, pose, 0.8, &mut block));
            block
        };
        let block = at(&camera, &pose);
        for i in 0..PARAMETERS {
            let h = 1e-4;
            let shifted = |s: f64| {
                let mut p = camera.parameters();
                p[i] += s;
                at(&camera.with_parameters(&p), &pose).cost
            };
            let numeric = (shifted(h) - shifted(-h)) / (4.0 * h);
            let size = block.gg[i][i].sqrt() * block.cost.sqrt();
            assert!(
                (numeric - block.g[i]).abs() < 1e-6 * size,
                "camera parameter {i}"
            );
        }
        for i in 0..POSE {
            let h = 1e-5;
            let shifted = |s: f64| {
                let mut step = [0.0; POSE];
                step[i] = s;
                at(&camera, &moved(&pose, &step)).cost
            };
            let numeric = (shifted(h) - shifted(-h)) / (4.0 * h);
            let size = block.pp[i][i].sqrt() * block.cost.sqrt();
            assert!(
                (numeric - block.p[i]).abs() < 1e-6 * size,
                "pose parameter {i}"
            );
        }
    }

    #[test]
    fn a_corner_without_a_covariance_is_refused() {
        let board = BoardGeometry {
            columns: 2,
            rows: 2,
            square_mm: 10.0,
        };
        let corner = Corner {
            pixel: Vector2::new(1.0, 2.0),
            covariance: Matrix2::zeros(),
        };
        assert!(CornerView::new(&[corner; 4], &board).is_none());
    }
}
