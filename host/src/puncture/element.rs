//! Eight-node bricks with one integration point, total Lagrangian, hourglass control by stiffness.
//!
//! For a swept mesh the mean gradient of a brick (Flanagan & Belytschko 1981) is
//!
//! ```text
//! ∂u/∂x = (s₊ − s₋)/(4 Δx)          s: sum over the quadrilateral's nodes on a plane
//! ∂u/∂y = ½ Σ_planes [by0 (u0 − u2) + by1 (u1 − u3)]      and the same with bz
//! ```
//!
//! with four scalars per row of bricks; nothing is gathered. The four hourglass modes are
//! γ1 = (h₋ + h₊) − 2(hy ∂u/∂y + hz ∂u/∂z), γ2 = r1₊ − r1₋, γ3 = r2₊ − r2₋, γ4 = h₊ − h₋, where
//! h, r1, r2 are the patterns (+−+−), (−++−), (−−++) on a plane. They vanish for every linear
//! field, and |γ·u|² does not change under a rotation: the energy ½κ|γ·u|² is objective.
//! κ = ε μ V ΣB²/8.

use super::lane::{Lane, Wide};
use super::material::{Material, Matrix, columns};
use super::mesh::{Mesh, ROW_ALIGN};
use pulp::{Arch, Simd, WithSimd};

/// Three components of a nodal field, each in rows along x.
pub type Field = [Vec<f64>; 3];

/// What a row of bricks (one quadrilateral, swept) shares.
#[derive(Clone, Debug)]
pub struct Row {
    /// Section nodes.
    pub node: [usize; 4],
    /// Area of the quadrilateral, mm².
    pub area: f64,
    by: [f64; 2],
    bz: [f64; 2],
    hy: f64,
    hz: f64,
    hourglass: f64,
    material: Material,
}

/// All rows, with what they share along x.
#[derive(Clone, Debug)]
pub struct Bricks {
    /// The rows.
    pub rows: Vec<Row>,
    /// Bricks in a row.
    pub along: usize,
    stride: usize,
    /// Length along x; 0 in the padding.
    dx: Vec<f64>,
    quarter_inverse_dx: Vec<f64>,
    half: Vec<f64>,
    arch: Arch,
}

/// Sums over all bricks.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    /// Strain energy, N·mm.
    pub strain: f64,
    /// Energy in the hourglass springs, N·mm.
    pub hourglass: f64,
}

/// What a health scan finds.
#[derive(Clone, Debug)]
pub struct Health {
    /// Smallest det F; NaN if the state is not finite.
    pub least_j: f64,
    /// Row and place along x of the brick with the smallest det F.
    pub at: (usize, usize),
    /// Largest det F.
    pub largest_j: f64,
    /// Bricks on the stabilised branch.
    pub stabilised: usize,
}

impl Bricks {
    /// Rows of a mesh. `hourglass` is ε above.
    pub fn new(mesh: &Mesh, material: impl Fn(usize) -> Material, hourglass: f64) -> Self {
        let rows = mesh
            .quads
            .iter()
            .enumerate()
            .map(|(q, quad)| {
                let p = quad.map(|n| mesh.section[n]);
                let area = mesh.area(quad);
                let by = [
                    (p[1][1] - p[3][1]) / (2.0 * area),
                    (p[2][1] - p[0][1]) / (2.0 * area),
                ];
                let bz = [
                    (p[3][0] - p[1][0]) / (2.0 * area),
                    (p[0][0] - p[2][0]) / (2.0 * area),
                ];
                let material = material(q);
                Row {
                    node: *quad,
                    area,
                    by,
                    bz,
                    hy: p[0][0] - p[1][0] + p[2][0] - p[3][0],
                    hz: p[0][1] - p[1][1] + p[2][1] - p[3][1],
                    hourglass: hourglass * material.law().shear_modulus() / 8.0,
                    material,
                }
            })
            .collect();
        let along = mesh.bricks_along();
        let n = along.next_multiple_of(ROW_ALIGN);
        let padded = |f: &dyn Fn(f64) -> f64| {
            let mut v: Vec<f64> = mesh.x.windows(2).map(|w| f(w[1] - w[0])).collect();
            v.resize(n, 0.0);
            v
        };
        Self {
            rows,
            along,
            stride: mesh.stride(),
            dx: padded(&|d| d),
            quarter_inverse_dx: padded(&|d| 0.25 / d),
            half: padded(&|_| 0.5),
            arch: Arch::new(),
        }
    }

    /// Number of bricks.
    pub fn count(&self) -> usize {
        self.rows.len() * self.along
    }

    /// Length of a brick along x.
    pub fn dx(&self, along: usize) -> f64 {
        self.dx[along]
    }

    /// Largest of 8·ΣB² over the directions: M·this/ρ bounds the brick's highest frequency squared
    /// (M: P-wave modulus). 4M/(ρh²) for a cube.
    pub fn inverse_size2(&self, row: usize, along: usize) -> f64 {
        let r = &self.rows[row];
        let sx = 0.5 / (self.dx[along] * self.dx[along]);
        let (sy, sz, syz) = r.second_moments();
        8.0 * sx.max(sy + syz.abs()).max(sz + syz.abs())
    }

    /// Subtracts the internal forces at displacement `u` from `f`.
    pub fn subtract_forces(&self, u: &Field, f: &mut Field, scratch: &mut Scratch) {
        self.arch.dispatch(Forces {
            bricks: self,
            u,
            f,
            scratch,
        });
    }

    /// The same by scalar arithmetic: the second implementation, for the tests.
    pub fn subtract_forces_scalar(&self, u: &Field, f: &mut Field, scratch: &mut Scratch) {
        forces(self, 0.0_f64, u, f, scratch);
    }

    /// Energies at displacement `u`.
    pub fn energy(&self, u: &Field) -> Sums {
        self.arch.dispatch(Energies { bricks: self, u })
    }

    /// Looks for inverted bricks and for the stabilised branch; writes into `growth` how much
    /// stiffer than at rest each brick is against its highest frequency.
    pub fn health(&self, u: &Field, growth: &mut [f64]) -> Health {
        self.arch.dispatch(Scan {
            bricks: self,
            u,
            growth,
        })
    }
}

impl Row {
    fn second_moments(&self) -> (f64, f64, f64) {
        (
            self.by[0] * self.by[0] + self.by[1] * self.by[1],
            self.bz[0] * self.bz[0] + self.bz[1] * self.bz[1],
            self.by[0] * self.bz[0] + self.by[1] * self.bz[1],
        )
    }
}

/// Forces of one row before they are summed into the nodes.
#[derive(Clone, Debug)]
pub struct Scratch {
    near: [[Vec<f64>; 4]; 3],
    far: [[Vec<f64>; 4]; 3],
}

impl Scratch {
    /// For these bricks.
    pub fn new(bricks: &Bricks) -> Self {
        let n = bricks.stride;
        let rows = || std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; n]));
        Self {
            near: rows(),
            far: rows(),
        }
    }
}

struct Forces<'a> {
    bricks: &'a Bricks,
    u: &'a Field,
    f: &'a mut Field,
    scratch: &'a mut Scratch,
}

impl WithSimd for Forces<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        forces(self.bricks, Wide::zero(simd), self.u, self.f, self.scratch);
    }
}

struct Energies<'a> {
    bricks: &'a Bricks,
    u: &'a Field,
}

impl WithSimd for Energies<'_> {
    type Output = Sums;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Sums {
        let t = Wide::zero(simd);
        let mut sums = Sums::default();
        for row in &self.bricks.rows {
            let (mut w, mut q) = (t, t);
            let mut i = 0;
            while i < self.bricks.along {
                let k = kinematics(self.bricks, row, t, self.u, i);
                let state = row.material.state(&k.h);
                let volume = t.load(&self.bricks.dx[i..]) * t.splat(row.area);
                w = state.energy.fma(volume, w);
                let mut g2 = t;
                for c in 0..3 {
                    for a in 0..4 {
                        g2 = k.g[c][a].fma(k.g[c][a], g2);
                    }
                }
                q = (g2 * stiffness(self.bricks, row, t, i)).fma(t.splat(0.5), q);
                i += <Wide<S> as Lane>::LANES;
            }
            sums.strain += w.sum();
            sums.hourglass += q.sum();
        }
        sums
    }
}

struct Scan<'a> {
    bricks: &'a Bricks,
    u: &'a Field,
    growth: &'a mut [f64],
}

impl WithSimd for Scan<'_> {
    type Output = Health;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Health {
        let t = Wide::zero(simd);
        let lanes = <Wide<S> as Lane>::LANES;
        let along = self.bricks.along;
        let mut health = Health {
            least_j: f64::INFINITY,
            at: (0, 0),
            largest_j: f64::NEG_INFINITY,
            stabilised: 0,
        };
        let (mut js, mut ratios, mut grown) = ([0.0; 16], [0.0; 16], [0.0; 16]);
        for (r, row) in self.bricks.rows.iter().enumerate() {
            let (sy, sz, syz) = row.second_moments();
            let mut i = 0;
            while i < along {
                let k = kinematics(self.bricks, row, t, self.u, i);
                let s = row.material.state(&k.h);
                let inv = t.load(&self.bricks.quarter_inverse_dx[i..]);
                let x = columns(&s.cofactor, 0, 0) * inv * inv * t.splat(8.0);
                let cross = columns(&s.cofactor, 1, 2) * t.splat(syz);
                let cross = cross.max(-cross);
                let now = x
                    .max(columns(&s.cofactor, 1, 1).fma(t.splat(sy), cross))
                    .max(columns(&s.cofactor, 2, 2).fma(t.splat(sz), cross));
                s.j.store(&mut js);
                s.limit_ratio.store(&mut ratios);
                now.store(&mut grown);
                for a in 0..lanes.min(along - i) {
                    if js[a] < health.least_j || js[a].is_nan() {
                        health.least_j = js[a];
                        health.at = (r, i + a);
                        if js[a].is_nan() {
                            return health;
                        }
                    }
                    health.largest_j = health.largest_j.max(js[a]);
                    health.stabilised += usize::from(ratios[a] > 1.0);
                    let rest = self.bricks.inverse_size2(r, i + a) / 8.0;
                    self.growth[r * along + i + a] = grown[a] / rest;
                }
                i += lanes;
            }
        }
        health
    }
}

struct Kinematics<T> {
    /// Displacement gradient.
    h: Matrix<T>,
    /// Hourglass amplitudes.
    g: [[T; 4]; 3],
}

/// Differences along the diagonals, sum and hourglass pattern of a quadrilateral.
#[inline(always)]
fn plane<T: Lane>(t: T, u: &[f64], node: &[usize; 4], stride: usize, i: usize) -> (T, T, T, T) {
    let p0 = t.load(&u[node[0] * stride + i..]);
    let p1 = t.load(&u[node[1] * stride + i..]);
    let p2 = t.load(&u[node[2] * stride + i..]);
    let p3 = t.load(&u[node[3] * stride + i..]);
    let (e, d) = (p0 + p2, p1 + p3);
    (p0 - p2, p1 - p3, e + d, e - d)
}

#[inline(always)]
fn kinematics<T: Lane>(b: &Bricks, row: &Row, t: T, u: &Field, i: usize) -> Kinematics<T> {
    let quarter = t.load(&b.quarter_inverse_dx[i..]);
    let half = t.load(&b.half[i..]);
    let (by0, by1) = (t.splat(row.by[0]), t.splat(row.by[1]));
    let (bz0, bz1) = (t.splat(row.bz[0]), t.splat(row.bz[1]));
    let (hy2, hz2) = (t.splat(2.0 * row.hy), t.splat(2.0 * row.hz));
    let mut h = [[t; 3]; 3];
    let mut g = [[t; 4]; 3];
    for c in 0..3 {
        let (a0, b0, s0, h0) = plane(t, &u[c], &row.node, b.stride, i);
        let (a1, b1, s1, h1) = plane(t, &u[c], &row.node, b.stride, i + 1);
        let (a, bb) = (a0 + a1, b0 + b1);
        let dy = half * by0.fma(a, by1 * bb);
        let dz = half * bz0.fma(a, bz1 * bb);
        h[c] = [(s1 - s0) * quarter, dy, dz];
        let (da, db) = (a1 - a0, b1 - b0);
        g[c] = [
            h0 + h1 - hy2.fma(dy, hz2 * dz),
            db - da,
            -(da + db),
            h1 - h0,
        ];
    }
    Kinematics { h, g }
}

/// κ of the bricks at i.
#[inline(always)]
fn stiffness<T: Lane>(b: &Bricks, row: &Row, t: T, i: usize) -> T {
    let (sy, sz, _) = row.second_moments();
    let dx = t.load(&b.dx[i..]);
    let quarter = t.load(&b.quarter_inverse_dx[i..]);
    // V ΣB² = A dx (sy + sz) + A/(2 dx)
    let k = row.hourglass * row.area;
    dx.fma(t.splat(k * (sy + sz)), quarter * t.splat(2.0 * k))
}

#[inline(always)]
#[allow(clippy::needless_range_loop)] // one index into five arrays of three components
fn forces<T: Lane>(b: &Bricks, t: T, u: &Field, f: &mut Field, scratch: &mut Scratch) {
    for row in &b.rows {
        let (by0, by1) = (t.splat(row.by[0]), t.splat(row.by[1]));
        let (bz0, bz1) = (t.splat(row.bz[0]), t.splat(row.bz[1]));
        let (hy, hz) = (t.splat(row.hy), t.splat(row.hz));
        let mut i = 0;
        while i < b.along {
            let k = kinematics(b, row, t, u, i);
            let p = row.material.state(&k.h).stress;
            let kappa = stiffness(b, row, t, i);
            let half_volume = t.load(&b.dx[i..]) * t.splat(0.5 * row.area);
            let face = t.load(&b.half[i..]) * t.splat(0.5 * row.area); // A/4, 0 in the padding
            for c in 0..3 {
                let k1 = kappa * k.g[c][0];
                let k2 = kappa * k.g[c][1];
                let k3 = kappa * k.g[c][2];
                let k4 = kappa * k.g[c][3];
                let x = p[c][0] * face;
                let ty = half_volume.fma(p[c][1], -(k1 * hy));
                let tz = half_volume.fma(p[c][2], -(k1 * hz));
                let ya = by0.fma(ty, bz0 * tz);
                let yb = by1.fma(ty, bz1 * tz);
                let (m, n) = (k1 - k4, k1 + k4);
                let (sum, difference) = (k2 + k3, k3 - k2);
                let o = i..i + T::LANES;
                let near = &mut scratch.near[c];
                (ya - x + m + sum).store(&mut near[0][o.clone()]);
                (yb - x - m + difference).store(&mut near[1][o.clone()]);
                (m - ya - x - sum).store(&mut near[2][o.clone()]);
                (-yb - x - m - difference).store(&mut near[3][o.clone()]);
                let o = i + 1..i + 1 + T::LANES;
                let far = &mut scratch.far[c];
                (ya + x + n - sum).store(&mut far[0][o.clone()]);
                (yb + x - n - difference).store(&mut far[1][o.clone()]);
                (x + n - ya + sum).store(&mut far[2][o.clone()]);
                (x - yb - n + difference).store(&mut far[3][o]);
            }
            i += T::LANES;
        }
        // The rows of four section nodes; far[0] stays zero, near beyond the last brick too.
        for c in 0..3 {
            for q in 0..4 {
                let start = row.node[q] * b.stride;
                let place = &mut f[c][start..start + b.stride];
                let (near, far) = (&scratch.near[c][q], &scratch.far[c][q]);
                let mut i = 0;
                while i + T::LANES <= b.stride {
                    let sum = t.load(&near[i..]) + t.load(&far[i..]);
                    (t.load(&place[i..]) - sum).store(&mut place[i..]);
                    i += T::LANES;
                }
            }
        }
    }
}
