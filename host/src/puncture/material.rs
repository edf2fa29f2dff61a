//! Hyperelastic materials: Yeoh and two-parameter Mooney–Rivlin, nearly incompressible.
//!
//! ```text
//! Yeoh           W = C10(Ī1−3) + C20(Ī1−3)² + (J−1)²/D1 + (J−1)⁴/D2
//! Mooney–Rivlin  W = C10(Ī1−3) + C01(Ī2−3) + (J−1)²/D1
//! ```
//! (paper, Table 5; ANSYS' form; Ī1 = J^(−2/3) tr C, Ī2 = J^(−4/3) I2.)
//!
//! Table 5's second constants are negative, and the materials lose strong ellipticity at moderate
//! strain: Yeoh beyond Ī1−3 = C10/(6|C20|), Mooney–Rivlin once a stretch passes √(C10/|C01|). There
//! a mesh would localise into one row of bricks. The stabilised branch keeps the published law up
//! to the limit and goes on with continuous stress and an elliptic law beyond:
//! - Yeoh: ∂W/∂Ī1 stays at its value of the limit (a neo-Hookean solid of ⅔ C10).
//! - Mooney–Rivlin: the slope of the C01 term decays as (I2*/Ī2)⁴, I2* being Ī2 of uniaxial
//!   tension at the limit: the smallest Ī2 at which any stretch can reach it. So no state beyond
//!   the limit is missed; states that have one stretch only near the limit may switch early.

use super::lane::Lane;
use serde::{Deserialize, Serialize};

/// 3 × 3, row by row.
pub type Matrix<T> = [[T; 3]; 3];

/// Which strain energy, with the paper's constants in MPa and MPa⁻¹.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Law {
    /// Yeoh, two terms.
    Yeoh {
        /// C10, MPa.
        c10: f64,
        /// C20, MPa.
        c20: f64,
        /// D1, MPa⁻¹.
        d1: f64,
        /// D2, MPa⁻¹.
        d2: f64,
    },
    /// Mooney–Rivlin, two parameters.
    MooneyRivlin {
        /// C10, MPa.
        c10: f64,
        /// C01, MPa.
        c01: f64,
        /// D1, MPa⁻¹.
        d1: f64,
    },
}

/// What to do beyond the limit of ellipticity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branch {
    /// The published law everywhere (for the oracles).
    Published,
    /// The stabilised branch beyond the limit.
    Stabilised,
}

/// A law, ready for the kernels.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    law: Law,
    /// Ī1−3 (Yeoh) or Ī2 (Mooney–Rivlin) where the stabilised branch begins.
    limit: f64,
}

/// Stress and energy of a state.
#[derive(Clone, Copy)]
pub struct State<T> {
    /// First Piola–Kirchhoff stress, MPa.
    pub stress: Matrix<T>,
    /// Strain energy per reference volume, MPa.
    pub energy: T,
    /// det F.
    pub j: T,
    /// Larger than one where the stabilised branch is in use.
    pub limit_ratio: T,
    /// Cofactor matrix of F.
    pub cofactor: Matrix<T>,
}

impl Law {
    /// Shear modulus at no strain, MPa.
    pub fn shear_modulus(self) -> f64 {
        match self {
            Law::Yeoh { c10, .. } => 2.0 * c10,
            Law::MooneyRivlin { c10, c01, .. } => 2.0 * (c10 + c01),
        }
    }

    /// Bulk modulus at no strain, MPa.
    pub fn bulk_modulus(self) -> f64 {
        match self {
            Law::Yeoh { d1, .. } | Law::MooneyRivlin { d1, .. } => 2.0 / d1,
        }
    }

    /// Ī1−3 (Yeoh) or Ī2 (Mooney–Rivlin) beyond which strong ellipticity may be lost.
    pub fn ellipticity_limit(self) -> f64 {
        match self {
            Law::Yeoh { c10, c20, .. } if c20 < 0.0 => c10 / (-6.0 * c20),
            Law::MooneyRivlin { c10, c01, .. } if c01 < 0.0 => {
                let l2 = c10 / -c01;
                2.0 * l2.sqrt() + 1.0 / l2
            }
            _ => f64::INFINITY,
        }
    }

    /// What is wrong with the constants, if anything.
    pub fn check(self) -> Result<(), String> {
        let finite = match self {
            Law::Yeoh { c10, c20, d1, d2 } => [c10, c20, d1, d2].iter().all(|x| x.is_finite()),
            Law::MooneyRivlin { c10, c01, d1 } => [c10, c01, d1].iter().all(|x| x.is_finite()),
        };
        let (d1, d2) = match self {
            Law::Yeoh { d1, d2, .. } => (d1, d2),
            Law::MooneyRivlin { d1, .. } => (d1, 1.0),
        };
        if !finite {
            return Err("a constant is not a finite number".into());
        }
        if self.shear_modulus() <= 0.0 {
            return Err(format!(
                "the shear modulus 2(C10 + C01) is {} MPa; it must be positive",
                self.shear_modulus()
            ));
        }
        if d1 <= 0.0 || d2 <= 0.0 {
            return Err("D1 and D2 must be positive".into());
        }
        if self.bulk_modulus() < 2.0 * self.shear_modulus() {
            return Err(format!(
                "bulk modulus {} MPa against shear modulus {} MPa: the solver is for nearly \
                 incompressible tissue (at least twice)",
                self.bulk_modulus(),
                self.shear_modulus()
            ));
        }
        Ok(())
    }
}

impl Material {
    /// A law with its branch.
    pub fn new(law: Law, branch: Branch) -> Self {
        let limit = match branch {
            Branch::Published => f64::INFINITY,
            Branch::Stabilised => law.ellipticity_limit(),
        };
        Self { law, limit }
    }

    /// The law.
    pub fn law(&self) -> Law {
        self.law
    }

    /// Stress and energy at a displacement gradient H = F − I.
    #[inline(always)]
    pub fn state<T: Lane>(&self, h: &Matrix<T>) -> State<T> {
        let t = h[0][0];
        let one = t.splat(1.0);
        let f = [
            [h[0][0] + one, h[0][1], h[0][2]],
            [h[1][0], h[1][1] + one, h[1][2]],
            [h[2][0], h[2][1], h[2][2] + one],
        ];
        let cof = [
            [
                minor(f[1][1], f[2][2], f[1][2], f[2][1]),
                minor(f[1][2], f[2][0], f[1][0], f[2][2]),
                minor(f[1][0], f[2][1], f[1][1], f[2][0]),
            ],
            [
                minor(f[0][2], f[2][1], f[0][1], f[2][2]),
                minor(f[0][0], f[2][2], f[0][2], f[2][0]),
                minor(f[0][1], f[2][0], f[0][0], f[2][1]),
            ],
            [
                minor(f[0][1], f[1][2], f[0][2], f[1][1]),
                minor(f[0][2], f[1][0], f[0][0], f[1][2]),
                minor(f[0][0], f[1][1], f[0][1], f[1][0]),
            ],
        ];
        let j = f[0][0].fma(cof[0][0], f[0][1].fma(cof[0][1], f[0][2] * cof[0][2]));
        let i1 = squares(&f);
        let jr = inverse_cube_root(j); // J^(-1/3)
        let jr2 = jr * jr;
        let jinv = jr2 * jr;
        let e = jr2.fma(i1, t.splat(-3.0)); // Ī1 − 3
        let g = j - one;
        let third = t.splat(1.0 / 3.0);
        match self.law {
            Law::Yeoh { c10, c20, d1, d2 } => {
                let ec = e.min(t.splat(self.limit));
                let w1 = ec.fma(t.splat(2.0 * c20), t.splat(c10));
                // W = C10 e + C20 e² up to the limit, straight on beyond.
                let past = e - ec;
                let energy = e * t.splat(c10)
                    + ec * t.splat(c20) * (ec + past + past)
                    + g * g * (g * g).fma(t.splat(1.0 / d2), t.splat(1.0 / d1));
                let dvol = g * (g * g).fma(t.splat(4.0 / d2), t.splat(2.0 / d1));
                let a = w1 * jr2 * t.splat(2.0);
                let b = dvol - a * i1 * third * jinv;
                State {
                    stress: combine(a, &f, b, &cof),
                    energy,
                    j,
                    limit_ratio: e * t.splat(1.0 / self.limit),
                    cofactor: cof,
                }
            }
            Law::MooneyRivlin { c10, c01, d1 } => {
                let i2 = squares(&cof);
                let jr4 = jr2 * jr2;
                let i2bar = jr4 * i2;
                let (slope, value, ratio) = if self.limit.is_finite() {
                    let limit = t.splat(self.limit);
                    let r = limit.div(i2bar.max(limit)); // 1 up to the limit
                    let r2 = r * r;
                    let grown = (one - r2 * r) * t.splat(self.limit / 3.0);
                    (
                        r2 * r2,
                        i2bar.min(limit) - t.splat(3.0) + grown,
                        i2bar * t.splat(1.0 / self.limit),
                    )
                } else {
                    (one, i2bar - t.splat(3.0), t.splat(0.0))
                };
                let energy = e * t.splat(c10) + value * t.splat(c01) + g * g * t.splat(1.0 / d1);
                let dvol = g * t.splat(2.0 / d1);
                let a1 = jr2 * t.splat(2.0 * c10);
                let a2 = slope * jr4 * t.splat(2.0 * c01);
                // C = FᵀF; ∂I2/∂F = 2(I1 F − F C).
                let (c00, c11, c22) = (columns(&f, 0, 0), columns(&f, 1, 1), columns(&f, 2, 2));
                let (c01_, c02, c12) = (columns(&f, 0, 1), columns(&f, 0, 2), columns(&f, 1, 2));
                let a = a1 + a2 * i1;
                let b = dvol - third * jinv * (a1 * i1 + a2 * (i2 + i2));
                let mut stress = combine(a, &f, b, &cof);
                let m = -a2;
                for r in 0..3 {
                    let (s, x) = (&mut stress[r], &f[r]);
                    let y0 = x[0].fma(c00, x[1].fma(c01_, x[2] * c02));
                    let y1 = x[0].fma(c01_, x[1].fma(c11, x[2] * c12));
                    let y2 = x[0].fma(c02, x[1].fma(c12, x[2] * c22));
                    s[0] = m.fma(y0, s[0]);
                    s[1] = m.fma(y1, s[1]);
                    s[2] = m.fma(y2, s[2]);
                }
                State {
                    stress,
                    energy,
                    j,
                    limit_ratio: ratio,
                    cofactor: cof,
                }
            }
        }
    }
}

#[inline(always)]
fn minor<T: Lane>(a: T, d: T, b: T, c: T) -> T {
    a.fma(d, -(b * c))
}

/// Product of two columns.
#[inline(always)]
pub(super) fn columns<T: Lane>(f: &Matrix<T>, p: usize, q: usize) -> T {
    f[0][p].fma(f[0][q], f[1][p].fma(f[1][q], f[2][p] * f[2][q]))
}

/// Sum of the squares.
#[inline(always)]
fn squares<T: Lane>(f: &Matrix<T>) -> T {
    columns(f, 0, 0) + columns(f, 1, 1) + columns(f, 2, 2)
}

#[inline(always)]
fn combine<T: Lane>(a: T, f: &Matrix<T>, b: T, c: &Matrix<T>) -> Matrix<T> {
    let mut p = *f;
    for i in 0..3 {
        for j in 0..3 {
            p[i][j] = a.fma(f[i][j], b * c[i][j]);
        }
    }
    p
}

/// J^(−1/3) by Newton from a quadratic start: 1e-15 for J within 1 ± 0.2 and 1e-9 down to 0.45 and
/// up to 1.9 (tissue of K/μ ≥ 20 stays within 1 ± 0.2; the health scan stops a run that does not).
#[inline(always)]
fn inverse_cube_root<T: Lane>(j: T) -> T {
    let x = j - j.splat(1.0);
    let third = j.splat(1.0 / 3.0);
    let mut y = x.fma(x.fma(j.splat(2.0 / 9.0), -third), j.splat(1.0));
    let k = j * third;
    let four_thirds = j.splat(4.0 / 3.0);
    for _ in 0..3 {
        let y2 = y * y;
        y = y * (four_thirds - k * (y2 * y));
    }
    y
}
