//! Central differences in time, with mass scaling.
//!
//! Time counts in steps (Δt = 1). The load is quasi-static, so that the density is free: each
//! brick gets the density at which its own limit of stability is 1/C steps,
//!
//! ```text
//! ρ = M · 8 max ΣB² / (4 C²)        M = K + 4μ/3,  C: Courant number
//! ```
//!
//! and the kinetic energy says what that cost. A brick that is squeezed grows stiffer against its
//! highest frequency (the cofactor of F enters squared); its density follows, momentum is kept,
//! and the kinetic energy that this takes is booked. Damping is proportional to mass and booked.

use super::element::{Bricks, Field, Health, Scratch};
use super::lane::{Lane, Wide};
use super::material::{Branch, Law, Material};
use super::mesh::{Mesh, Region};
use pulp::{Arch, Simd, WithSimd};

/// Numbers of the time integration.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Integration {
    /// Courant number at rest, below 1.
    pub courant: f64,
    /// Damping: the share of its velocity that a free node loses in a step.
    pub damping: f64,
    /// The same where kinetic energy has reached 5 % of strain energy: tissue that comes unstuck
    /// snaps back, and what it loses there is booked. In between, from 2 % on, it rises with the
    /// square. The needle's own motion stays below 2 %: damping it would add a force that depends
    /// on the step (4 % of the peak when the rise began at 1 %).
    pub snap_damping: f64,
    /// ε of the hourglass springs.
    pub hourglass: f64,
}

impl Default for Integration {
    fn default() -> Self {
        Self {
            courant: 0.6,
            damping: 5e-4,
            snap_damping: 0.15,
            hourglass: 0.2,
        }
    }
}

/// Why a run stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Stopped {
    /// A brick turned inside out.
    #[error(
        "the run stopped at {path_mm:.2} mm: a brick of the {region} at ({:.1}, {:.1}, {:.1}) mm is \
         crushed (det F = {j:.3}); use a finer mesh or slower steps", at[0], at[1], at[2]
    )]
    Inverted {
        /// Its tissue.
        region: &'static str,
        /// Its middle at rest, mm.
        at: [f64; 3],
        /// Its det F.
        j: f64,
        /// Path of the needle, mm.
        path_mm: f64,
    },
    /// A number is not finite.
    #[error("the run stopped at {path_mm:.2} mm: the state is not finite; use smaller steps")]
    NotFinite {
        /// Path of the needle, mm.
        path_mm: f64,
    },
}

/// A body in motion.
#[derive(Clone, Debug)]
pub struct Body {
    /// The mesh.
    pub mesh: Mesh,
    /// Its bricks.
    pub bricks: Bricks,
    /// Displacement, mm.
    pub u: Field,
    /// Velocity half a step before the displacement, mm per step.
    pub v: Field,
    /// External forces of this step, N; zeroed by each step.
    pub f: Field,
    /// Nodal mass, N·step²/mm.
    pub mass: Vec<f64>,
    /// 1/mass; 0 where a component is held or prescribed.
    pub inverse: Field,
    /// Kinetic energy of the last step, N·mm.
    pub kinetic: f64,
    /// Energy taken by damping, N·mm.
    pub damped: f64,
    /// Energy taken when density followed squeezed bricks, N·mm.
    pub mass_sink: f64,
    /// Largest det F minus one ever seen, and smallest det F.
    pub j_range: (f64, f64),
    /// Most bricks on the stabilised branch at a time.
    pub stabilised: usize,
    prescribed: Vec<(usize, usize, f64)>,
    density: Vec<f64>,
    factor: Vec<f64>,
    growth: Vec<f64>,
    scratch: Scratch,
    integration: Integration,
    alpha: f64,
    arch: Arch,
}

impl Body {
    /// A body at rest.
    pub fn new(
        mesh: Mesh,
        law: impl Fn(Region) -> Law,
        branch: Branch,
        integration: Integration,
    ) -> Self {
        let bricks = Bricks::new(
            &mesh,
            |q| Material::new(law(mesh.region[q]), branch),
            integration.hourglass,
        );
        let stride = mesh.stride();
        let n = mesh.section.len() * stride;
        let zeros = || std::array::from_fn(|_| vec![0.0; n]);
        let mut mass = vec![0.0; n];
        let along = bricks.along;
        let mut density = Vec::with_capacity(bricks.count());
        for (r, row) in bricks.rows.iter().enumerate() {
            let l = law(mesh.region[r]);
            let modulus = l.bulk_modulus() + 4.0 / 3.0 * l.shear_modulus();
            for i in 0..along {
                let rho = modulus * bricks.inverse_size2(r, i)
                    / (4.0 * integration.courant * integration.courant);
                let eighth = rho * row.area * bricks.dx(i) / 8.0;
                density.push(eighth);
                for q in row.node {
                    mass[q * stride + i] += eighth;
                    mass[q * stride + i + 1] += eighth;
                }
            }
        }
        let inverse: Vec<f64> = mass
            .iter()
            .map(|&m| if m > 0.0 { 1.0 / m } else { 0.0 })
            .collect();
        let scratch = Scratch::new(&bricks);
        Self {
            u: zeros(),
            v: zeros(),
            f: zeros(),
            inverse: [inverse.clone(), inverse.clone(), inverse],
            mass,
            kinetic: 0.0,
            damped: 0.0,
            mass_sink: 0.0,
            j_range: (1.0, 1.0),
            stabilised: 0,
            prescribed: Vec::new(),
            factor: vec![1.0; density.len()],
            growth: vec![1.0; density.len()],
            density,
            scratch,
            integration,
            alpha: integration.damping,
            arch: Arch::new(),
            mesh,
            bricks,
        }
    }

    /// Place in memory of a section node on a plane.
    pub fn place(&self, section: usize, plane: usize) -> usize {
        section * self.mesh.stride() + plane
    }

    /// Position at rest of a place.
    pub fn rest(&self, place: usize) -> [f64; 3] {
        let stride = self.mesh.stride();
        let [y, z] = self.mesh.section[place / stride];
        let x = self.mesh.x.get(place % stride).copied().unwrap_or(0.0);
        [x, y, z]
    }

    /// All places that hold a node.
    pub fn places(&self) -> impl Iterator<Item = usize> + use<> {
        let (stride, planes) = (self.mesh.stride(), self.mesh.x.len());
        (0..self.mesh.section.len()).flat_map(move |s| (0..planes).map(move |i| s * stride + i))
    }

    /// Holds a component (0, 1, 2) at the places that `which` picks by their position at rest.
    pub fn hold(&mut self, component: usize, which: impl Fn([f64; 3]) -> bool) {
        for p in self.places() {
            if which(self.rest(p)) {
                self.inverse[component][p] = 0.0;
            }
        }
    }

    /// Prescribes the velocity of a component (mm per step) at a place.
    pub fn prescribe(&mut self, place: usize, component: usize, velocity: f64) {
        self.inverse[component][place] = 0.0;
        self.prescribed.push((place, component, velocity));
    }

    /// Sets all prescribed velocities of a component to `velocity(rest position)`.
    pub fn set_prescribed(&mut self, component: usize, velocity: impl Fn([f64; 3]) -> f64) {
        let mut list = std::mem::take(&mut self.prescribed);
        for (p, c, v) in &mut list {
            if *c == component {
                *v = velocity(self.rest(*p));
            }
        }
        self.prescribed = list;
    }

    /// Adds the internal forces to `f`, which holds the external ones; so `f` is the residual, and
    /// at held or prescribed places minus the reaction.
    pub fn internal(&mut self) {
        self.bricks
            .subtract_forces(&self.u, &mut self.f, &mut self.scratch);
    }

    /// Moves by one step with the residual in `f`, which is zeroed.
    pub fn advance(&mut self) {
        let alpha = self.alpha;
        let mut sums = (0.0, 0.0);
        for c in 0..3 {
            let (k, d) = self.arch.dispatch(Update {
                u: &mut self.u[c],
                v: &mut self.v[c],
                f: &mut self.f[c],
                m: &self.mass,
                inverse: &self.inverse[c],
                alpha,
            });
            sums = (sums.0 + k, sums.1 + d);
        }
        self.kinetic = 0.5 * sums.0;
        self.damped += alpha * sums.1;
        for &(p, c, v) in &self.prescribed {
            self.u[c][p] += v - self.v[c][p];
            self.v[c][p] = v;
        }
    }

    /// Sets the damping by the share of kinetic in strain energy; call it now and then.
    pub fn settle(&mut self, strain: f64) {
        let share = self.kinetic / strain.max(1e-9);
        let (calm, snap) = (self.integration.damping, self.integration.snap_damping);
        let k = ((share - 0.02) / 0.03).clamp(0.0, 1.0);
        self.alpha = calm + k * k * (snap - calm).max(0.0);
    }

    /// Looks for crushed bricks, and lets the density follow squeezed ones.
    ///
    /// # Errors
    /// A brick is crushed or a number is not finite. `path_mm` goes into the message.
    pub fn check(&mut self, path_mm: f64) -> Result<Health, Stopped> {
        let health = self.bricks.health(&self.u, &mut self.growth);
        if health.least_j.is_nan() || !health.largest_j.is_finite() {
            return Err(Stopped::NotFinite { path_mm });
        }
        self.j_range.0 = self.j_range.0.min(health.least_j);
        self.j_range.1 = self.j_range.1.max(health.largest_j);
        self.stabilised = self.stabilised.max(health.stabilised);
        if health.least_j < 0.3 {
            let (r, i) = health.at;
            let quad = self.mesh.quads[r];
            let middle =
                |k: usize| quad.iter().map(|&q| self.mesh.section[q][k]).sum::<f64>() / 4.0;
            return Err(Stopped::Inverted {
                region: self.mesh.region[r].name(),
                at: [
                    0.5 * (self.mesh.x[i] + self.mesh.x[i + 1]),
                    middle(0),
                    middle(1),
                ],
                j: health.least_j,
                path_mm,
            });
        }
        // A brick may come to C² · HIGH = 0.58 of the limit's square before its density follows;
        // the rest is for the springs of contact and crack on the same nodes.
        const HIGH: f64 = 1.6;
        const SET: f64 = 1.3;
        let along = self.bricks.along;
        let stride = self.mesh.stride();
        for k in 0..self.factor.len() {
            if self.growth[k] > HIGH * self.factor[k] {
                let new = self.growth[k] / SET;
                let add = (new - self.factor[k]) * self.density[k];
                self.factor[k] = new;
                let (r, i) = (k / along, k % along);
                for q in self.bricks.rows[r].node {
                    for p in [q * stride + i, q * stride + i + 1] {
                        self.add_mass(p, add);
                    }
                }
            }
        }
        Ok(health)
    }

    /// Adds mass to a node, keeping its momentum.
    fn add_mass(&mut self, p: usize, add: f64) {
        let old = self.mass[p];
        let new = old + add;
        self.mass[p] = new;
        for c in 0..3 {
            if self.inverse[c][p] > 0.0 {
                self.inverse[c][p] = 1.0 / new;
                let v = self.v[c][p];
                let w = v * old / new;
                self.v[c][p] = w;
                self.mass_sink += 0.5 * (old * v * v - new * w * w);
            }
        }
    }

    /// Makes a node at least this heavy before the run (for stiff springs on it).
    pub fn at_least(&mut self, p: usize, mass: f64) {
        if self.mass[p] < mass {
            self.add_mass(p, mass - self.mass[p]);
        }
    }
}

struct Update<'a> {
    u: &'a mut [f64],
    v: &'a mut [f64],
    f: &'a mut [f64],
    m: &'a [f64],
    inverse: &'a [f64],
    alpha: f64,
}

impl WithSimd for Update<'_> {
    /// Σ m v² (mean of before and after), Σ m v̄².
    type Output = (f64, f64);
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, f64) {
        let t = Wide::zero(simd);
        let lanes = <Wide<S> as Lane>::LANES;
        let keep = t.splat(1.0 - 0.5 * self.alpha);
        let over = t.splat(1.0 / (1.0 + 0.5 * self.alpha));
        let half = t.splat(0.5);
        let (mut kinetic, mut damped) = (t, t);
        let n = self.u.len().min(self.v.len()).min(self.f.len());
        let n = n.min(self.m.len()).min(self.inverse.len());
        let mut i = 0;
        while i + lanes <= n {
            let v = t.load(&self.v[i..n]);
            let f = t.load(&self.f[i..n]);
            let m = t.load(&self.m[i..n]);
            let w = f.fma(t.load(&self.inverse[i..n]), v * keep) * over;
            let mean = (v + w) * half;
            kinetic = m.fma((v * v + w * w) * half, kinetic);
            damped = m.fma(mean * mean, damped);
            w.store(&mut self.v[i..n]);
            (t.load(&self.u[i..n]) + w).store(&mut self.u[i..n]);
            t.store(&mut self.f[i..n]);
            i += lanes;
        }
        (kinetic.sum(), damped.sum())
    }
}
