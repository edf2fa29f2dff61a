//! Levenberg–Marquardt for bundle adjustments: a few global parameters (camera, light) and one
//! board pose a view. Views meet only in the globals, so each pose is eliminated on its own
//! (Schur complement; Triggs et al., Bundle Adjustment – A Modern Synthesis, 2000, § 6):
//!
//! ```text
//! | U  W | |δg|     |g|      S = U − Σ W·V⁻¹·Wᵀ   (G × G)
//! | Wᵀ V | |δp| = − |p|      δp = −V⁻¹·(p + Wᵀ·δg)
//! ```
//!
//! Knows neither cameras nor stripes: a [`Problem`] fills the normal equations of one view.

use crate::geometry::Pose;
use crate::geometry::Vector3;

/// Parameters of a pose: ω and τ of [`Pose::updated`].
pub const POSE: usize = 6;

/// Normal equations of one view (or of a part of it): Σ w·JᵀJ, Σ w·Jᵀr and Σ ρ.
#[derive(Clone, Debug, PartialEq)]
pub struct Block<const G: usize> {
    /// Value of the objective, Σ ρ (Σ w·r² for a quadratic loss).
    pub cost: f64,
    /// Globals × globals.
    pub gg: [[f64; G]; G],
    /// Globals × pose.
    pub gp: [[f64; POSE]; G],
    /// Pose × pose.
    pub pp: [[f64; POSE]; POSE],
    /// Half the gradient by the globals.
    pub g: [f64; G],
    /// Half the gradient by the pose.
    pub p: [f64; POSE],
}

impl<const G: usize> Block<G> {
    /// Nothing yet.
    pub fn zero() -> Self {
        Self {
            cost: 0.0,
            gg: [[0.0; G]; G],
            gp: [[0.0; POSE]; G],
            pp: [[0.0; POSE]; POSE],
            g: [0.0; G],
            p: [0.0; POSE],
        }
    }

    /// Adds one residual r of weight w with its derivatives by the first `C` globals and by the
    /// pose. The cost is the caller's.
    #[inline(always)]
    pub fn add_row<const C: usize>(
        &mut self,
        by_globals: &[f64; C],
        by_pose: &[f64; POSE],
        r: f64,
        w: f64,
    ) {
        for i in 0..C {
            let wj = w * by_globals[i];
            for k in 0..C {
                self.gg[i][k] += wj * by_globals[k];
            }
            for k in 0..POSE {
                self.gp[i][k] += wj * by_pose[k];
            }
            self.g[i] += wj * r;
        }
        for i in 0..POSE {
            let wj = w * by_pose[i];
            for k in 0..POSE {
                self.pp[i][k] += wj * by_pose[k];
            }
            self.p[i] += wj * r;
        }
    }

    /// Adds `factor` times another block.
    pub fn add(&mut self, other: &Self, factor: f64) {
        self.cost += factor * other.cost;
        for i in 0..G {
            for k in 0..G {
                self.gg[i][k] += factor * other.gg[i][k];
            }
            for k in 0..POSE {
                self.gp[i][k] += factor * other.gp[i][k];
            }
            self.g[i] += factor * other.g[i];
        }
        for i in 0..POSE {
            for k in 0..POSE {
                self.pp[i][k] += factor * other.pp[i][k];
            }
            self.p[i] += factor * other.p[i];
        }
    }
}

/// A least-squares problem over globals and one pose a view.
pub trait Problem<const G: usize> {
    /// The global parameters in their own shape.
    type Globals: Clone;

    /// How many views there are.
    fn views(&self) -> usize;

    /// Adds one view's normal equations to `block`; false where a point falls behind the camera.
    fn linearise(
        &self,
        view: usize,
        globals: &Self::Globals,
        pose: &Pose,
        block: &mut Block<G>,
    ) -> bool;

    /// Adds what is known of the globals beforehand (the pose part stays untouched).
    fn prior(&self, globals: &Self::Globals, block: &mut Block<G>);

    /// The globals moved by a step.
    fn updated(&self, globals: &Self::Globals, step: &[f64; G]) -> Self::Globals;

    /// Globals that are held where they are.
    fn held(&self) -> [bool; G] {
        [false; G]
    }
}

/// The linear system at one point of a problem: every view's block, and the prior's.
#[derive(Clone, Debug)]
pub struct System<const G: usize> {
    /// One block a view.
    pub views: Vec<Block<G>>,
    /// The prior on the globals.
    pub prior: Block<G>,
    /// Globals that are held.
    pub held: [bool; G],
}

impl<const G: usize> System<G> {
    /// Linearises a problem; `None` where a view can't be evaluated.
    pub fn at<P: Problem<G>>(problem: &P, globals: &P::Globals, poses: &[Pose]) -> Option<Self> {
        let mut views = vec![Block::zero(); problem.views()];
        for (i, (block, pose)) in views.iter_mut().zip(poses).enumerate() {
            if !problem.linearise(i, globals, pose, block) {
                return None;
            }
        }
        let mut prior = Block::zero();
        problem.prior(globals, &mut prior);
        let system = Self {
            views,
            prior,
            held: problem.held(),
        };
        system.cost().is_finite().then_some(system)
    }

    /// Value of the objective.
    pub fn cost(&self) -> f64 {
        self.prior.cost + self.views.iter().map(|b| b.cost).sum::<f64>()
    }

    /// The system reduced to the globals, each diagonal raised by the factor 1 + λ: S and the
    /// right-hand side, with the eliminated poses.
    fn reduced(&self, lambda: f64) -> Option<Reduced<G>> {
        let mut s = self.prior.gg;
        let mut rhs = self.prior.g;
        // Damping acts on the undiminished diagonal, as if nothing had been eliminated.
        let mut damping = [0.0; G];
        for (i, d) in damping.iter_mut().enumerate() {
            *d = lambda * self.prior.gg[i][i];
        }
        let mut factors = Vec::with_capacity(self.views.len());
        for block in &self.views {
            let mut v = block.pp;
            for (i, row) in v.iter_mut().enumerate() {
                row[i] *= 1.0 + lambda;
            }
            let factor = Cholesky::new(&v)?;
            let solved_p = factor.solve(&block.p);
            // Rows of W·L⁻ᵀ: their products give W·V⁻¹·Wᵀ symmetrically.
            let mut half = [[0.0; POSE]; G];
            for i in 0..G {
                half[i] = factor.forward(&block.gp[i]);
            }
            for i in 0..G {
                for k in 0..G {
                    let mut sum = 0.0;
                    for j in 0..POSE {
                        sum += half[i][j] * half[k][j];
                    }
                    s[i][k] += block.gg[i][k] - sum;
                }
                let mut sum = 0.0;
                for j in 0..POSE {
                    sum += block.gp[i][j] * solved_p[j];
                }
                rhs[i] += block.g[i] - sum;
                damping[i] += lambda * block.gg[i][i];
            }
            factors.push(factor);
        }
        for i in 0..G {
            s[i][i] += damping[i];
            if self.held[i] {
                for k in 0..G {
                    s[i][k] = 0.0;
                    s[k][i] = 0.0;
                }
                s[i][i] = 1.0;
                rhs[i] = 0.0;
            }
        }
        Some(Reduced { s, rhs, factors })
    }

    /// The Gauss–Newton step (λ = 0) or a damped one: globals, poses, and gᵀδ, the decrease that
    /// the linear model promises (twice the true one of a quadratic with δᵀHδ).
    pub fn step(&self, lambda: f64) -> Option<Step<G>> {
        let reduced = self.reduced(lambda)?;
        let mut globals = Cholesky::new(&reduced.s)?.solve(&reduced.rhs);
        let mut promised = 0.0;
        for (i, d) in globals.iter_mut().enumerate() {
            *d = -*d;
            if self.held[i] {
                *d = 0.0;
            }
            promised -= *d * self.prior.g[i];
        }
        let mut poses = Vec::with_capacity(self.views.len());
        for (block, factor) in self.views.iter().zip(&reduced.factors) {
            let mut rhs = block.p;
            for i in 0..G {
                for (k, r) in rhs.iter_mut().enumerate() {
                    *r += block.gp[i][k] * globals[i];
                }
                promised -= globals[i] * block.g[i];
            }
            let mut step = factor.solve(&rhs);
            for (k, s) in step.iter_mut().enumerate() {
                *s = -*s;
                promised -= *s * block.p[k];
            }
            poses.push(step);
        }
        promised.is_finite().then_some(Step {
            globals,
            poses,
            promised,
        })
    }

    /// Inverse of the reduced system: the covariance of the globals for residuals of unit
    /// variance. Zero for the held ones; `None` where the data does not determine them.
    pub fn covariance(&self) -> Option<[[f64; G]; G]> {
        let reduced = self.reduced(0.0)?;
        let factor = Cholesky::new(&reduced.s)?;
        let mut out = [[0.0; G]; G];
        for i in 0..G {
            if self.held[i] {
                continue;
            }
            let mut unit = [0.0; G];
            unit[i] = 1.0;
            out[i] = factor.solve(&unit);
        }
        // Exactly symmetric for those who factor it later.
        for i in 0..G {
            for k in 0..i {
                let mean = 0.5 * (out[i][k] + out[k][i]);
                out[i][k] = mean;
                out[k][i] = mean;
            }
        }
        Some(out)
    }
}

struct Reduced<const G: usize> {
    s: [[f64; G]; G],
    rhs: [f64; G],
    factors: Vec<Cholesky<POSE>>,
}

/// A step of the solver.
#[derive(Clone, Debug)]
pub struct Step<const G: usize> {
    /// By the globals.
    pub globals: [f64; G],
    /// By each pose.
    pub poses: Vec<[f64; POSE]>,
    /// −gᵀδ.
    pub promised: f64,
}

/// The pose moved by a step.
pub fn moved(pose: &Pose, step: &[f64; POSE]) -> Pose {
    pose.updated(
        &Vector3::new(step[0], step[1], step[2]),
        &Vector3::new(step[3], step[4], step[5]),
    )
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Largest number of linearisations.
    pub iterations: usize,
    /// Stop when a step is shorter than this many standard deviations of the result (the noise
    /// taken from the residuals themselves).
    pub step_sigma: f64,
    /// How many residuals there are: cost / residuals is the noise's variance.
    pub residuals: usize,
}

/// Minimises by Levenberg–Marquardt from the given start, which it moves. Returns the system at
/// the end, or `None` where the start itself can't be evaluated.
pub fn minimise<const G: usize, P: Problem<G>>(
    problem: &P,
    globals: &mut P::Globals,
    poses: &mut Vec<Pose>,
    stop: &Stop,
) -> Option<System<G>> {
    let mut system = System::at(problem, globals, poses)?;
    let mut lambda = 1e-3;
    for _ in 1..stop.iterations {
        let Some(step) = system.step(lambda) else {
            lambda *= 10.0;
            if lambda > 1e8 {
                break;
            }
            continue;
        };
        let cost = system.cost();
        let noise = cost / stop.residuals.max(1) as f64;
        let done = step.promised <= stop.step_sigma * stop.step_sigma * noise;
        let next_globals = problem.updated(globals, &step.globals);
        let next_poses: Vec<Pose> = poses
            .iter()
            .zip(&step.poses)
            .map(|(pose, step)| moved(pose, step))
            .collect();
        match System::at(problem, &next_globals, &next_poses) {
            Some(next) if next.cost() <= cost => {
                *globals = next_globals;
                *poses = next_poses;
                system = next;
                lambda /= 30.0;
                if done {
                    break;
                }
            }
            _ if done => break, // the last bits: no smaller cost to be had
            _ => {
                lambda = (lambda * 10.0).max(1e-6);
                if lambda > 1e8 {
                    break;
                }
            }
        }
    }
    Some(system)
}

/// A = L·Lᵀ after scaling to a unit diagonal (parameters of very unlike sizes).
#[derive(Clone, Copy, Debug)]
pub struct Cholesky<const N: usize> {
    l: [[f64; N]; N],
    scale: [f64; N],
    inverse_pivot: [f64; N],
}

impl<const N: usize> Cholesky<N> {
    /// `None` where the matrix is not positive definite to working precision.
    pub fn new(a: &[[f64; N]; N]) -> Option<Self> {
        let mut scale = [0.0; N];
        for i in 0..N {
            if !(a[i][i] > 0.0 && a[i][i].is_finite()) {
                return None;
            }
            scale[i] = 1.0 / a[i][i].sqrt();
        }
        let mut l = [[0.0; N]; N];
        let mut inverse_pivot = [0.0; N];
        for i in 0..N {
            for k in 0..=i {
                let mut sum = a[i][k] * scale[i] * scale[k];
                for j in 0..k {
                    sum -= l[i][j] * l[k][j];
                }
                if i == k {
                    // Pivots of a correlation matrix are 1 − R²: below rounding there is nothing.
                    if !(sum > 1e-13) {
                        return None;
                    }
                    l[i][i] = sum.sqrt();
                    inverse_pivot[i] = 1.0 / l[i][i];
                } else {
                    l[i][k] = sum * inverse_pivot[k];
                }
            }
        }
        Some(Self {
            l,
            scale,
            inverse_pivot,
        })
    }

    /// L⁻¹·b (of the unscaled factor).
    #[inline]
    pub fn forward(&self, b: &[f64; N]) -> [f64; N] {
        let mut y = [0.0; N];
        for i in 0..N {
            let mut sum = b[i] * self.scale[i];
            for k in 0..i {
                sum -= self.l[i][k] * y[k];
            }
            y[i] = sum * self.inverse_pivot[i];
        }
        y
    }

    /// A⁻¹·b.
    #[inline]
    pub fn solve(&self, b: &[f64; N]) -> [f64; N] {
        let mut y = self.forward(b);
        for i in (0..N).rev() {
            let mut sum = y[i];
            for k in i + 1..N {
                sum -= self.l[k][i] * y[k];
            }
            y[i] = sum * self.inverse_pivot[i];
        }
        for i in 0..N {
            y[i] *= self.scale[i];
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves_and_refuses() {
        let a = [[4.0, 2.0e3, 0.6], [2.0e3, 5.0e6, 1.0e2], [0.6, 1.0e2, 3.0]];
        let x = [1.0, -2.0e-3, 3.0];
        let b = [0, 1, 2].map(|i| (0..3).map(|k| a[i][k] * x[k]).sum::<f64>());
        let solved = Cholesky::new(&a).unwrap().solve(&b);
        for i in 0..3 {
            assert!((solved[i] / x[i] - 1.0).abs() < 1e-12);
        }
        assert!(Cholesky::new(&[[1.0, 1.0], [1.0, 1.0]]).is_none());
        assert!(Cholesky::new(&[[1.0, f64::NAN], [f64::NAN, 1.0]]).is_none());
    }
}
