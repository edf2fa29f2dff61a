//! The image of a checker corner: two edges through one point, blurred, on shaded ground.
//!
//! With dᵢ the signed distance of a pixel from edge i (normal nᵢ = (cos θᵢ, sin θᵢ), curvature κᵢ
//! held fixed: dᵢ = nᵢ·δ − κᵢ·tᵢ²/2), a = d₁/σ, b = d₂/σ and ρ = n₁·n₂,
//!
//! I = m + g·δ + (h + q·δ)·K,
//! K = E[sgn(d₁ + σz₁)·sgn(d₂ + σz₂)], z normal with correlation ρ:
//! K = e(a)·e(b) + 4·φ(a)·φ(b)·Σₖ ρᵏ⁺¹/(k+1)!·Heₖ(a)·Heₖ(b)   (tetrachoric series, four terms),
//! e(a) = erf(a/√2) − 2·c·He₃(a)·φ(a).
//!
//! σ² is the variance of the point spread plus the pixel's own 1/12; a pixel is a box, not a
//! Gaussian, and the term in c = κ₄/(24σ⁴), κ₄ = −(cos⁴θ + sin⁴θ)/120, is its fourth cumulant
//! across the edge (Edgeworth). Perspective keeps straight edges straight, so that the model holds
//! for any tilt; lens distortion bends them, hence κ. A pixel-wise gamma or clipping leaves the
//! pattern's point symmetry, and with it the position, untouched.

/// Free parameters, in the order of [`Parameters::free`].
pub(super) const FREE: usize = 11;
const COLUMNS: usize = FREE + 1;
const PRODUCTS: usize = COLUMNS * (COLUMNS + 1) / 2;
/// Pixels handled together.
const LANES: usize = 16;

/// Index of x₀, y₀ (relative to the patch's origin), θ₁, θ₂, σ, m and h in [`Parameters::free`].
pub(super) mod index {
    pub const X: usize = 0;
    pub const Y: usize = 1;
    pub const THETA: usize = 2;
    pub const SIGMA: usize = 4;
    pub const MEAN: usize = 5;
    pub const HALF: usize = 8;
}

/// A corner's parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters {
    /// x₀, y₀, θ₁, θ₂, σ, m, g (2), h, q (2). Pixels, radians, grey, grey/px.
    pub free: [f64; FREE],
    /// κ₁, κ₂, 1/px: how far edge i bends towards its normal.
    pub curvature: [f64; 2],
}

/// Pixels of a patch. Lengths are a multiple of [`LANES`]; the padding weighs nothing.
#[derive(Clone, Debug, Default)]
pub(super) struct Patch {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub value: Vec<f32>,
    /// Square root of each pixel's weight.
    pub weight: Vec<f32>,
    /// Pixels before the padding.
    pub len: usize,
}

impl Patch {
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.value.clear();
        self.weight.clear();
        self.len = 0;
    }

    #[inline]
    pub fn push(&mut self, x: f32, y: f32, value: f32) {
        self.x.push(x);
        self.y.push(y);
        self.value.push(value);
    }

    /// Pads to whole blocks and sets all weights to 1.
    pub fn finish(&mut self) {
        self.len = self.x.len();
        let padded = self.len.next_multiple_of(LANES);
        self.x.resize(padded, 0.0);
        self.y.resize(padded, 0.0);
        self.value.resize(padded, 0.0);
        self.weight.resize(self.len, 1.0);
        self.weight.resize(padded, 0.0);
    }
}

/// Weighted sums of products of the Jacobian's columns and the residual (the last column).
#[derive(Clone, Debug)]
pub(super) struct Normal {
    pub products: [[f64; COLUMNS]; COLUMNS],
}

/// What the lanes need, once per corner.
#[derive(Clone, Copy)]
struct Constants {
    x0: f32,
    y0: f32,
    n1: [f32; 2],
    n2: [f32; 2],
    half_curvature: [f32; 2],
    inverse_sigma: f32,
    mean: f32,
    gradient: [f32; 2],
    half: f32,
    half_gradient: [f32; 2],
    cumulant: [f32; 2],
    /// ρᵏ⁺¹/(k+1)!, k = 0..4.
    series: [f32; 4],
    /// ρᵏ/k!, k = 0..4: its derivative by ρ.
    series_by_rho: [f32; 4],
    /// ∂ρ/∂θ₁.
    rho_by_theta: f32,
}

impl Constants {
    fn new(p: &Parameters) -> Self {
        let f = &p.free;
        let sigma = f[index::SIGMA];
        let ((s1, c1), (s2, c2)) = (f[2].sin_cos(), f[3].sin_cos());
        let rho = c1 * c2 + s1 * s2;
        let cumulant = |s: f64, c: f64| -(c.powi(4) + s.powi(4)) / 120.0 / (24.0 * sigma.powi(4));
        Self {
            x0: f[0] as f32,
            y0: f[1] as f32,
            n1: [c1 as f32, s1 as f32],
            n2: [c2 as f32, s2 as f32],
            half_curvature: p.curvature.map(|k| (0.5 * k) as f32),
            inverse_sigma: (1.0 / sigma) as f32,
            mean: f[5] as f32,
            gradient: [f[6] as f32, f[7] as f32],
            half: f[8] as f32,
            half_gradient: [f[9] as f32, f[10] as f32],
            cumulant: [cumulant(s1, c1) as f32, cumulant(s2, c2) as f32],
            series: [
                rho,
                rho.powi(2) / 2.0,
                rho.powi(3) / 6.0,
                rho.powi(4) / 24.0,
            ]
            .map(|x| x as f32),
            series_by_rho: [1.0, rho, rho.powi(2) / 2.0, rho.powi(3) / 6.0].map(|x| x as f32),
            rho_by_theta: (c1 * s2 - s1 * c2) as f32,
        }
    }
}

/// φ(a), the standard normal density, relative error below 1e-6.
#[inline(always)]
fn density(a: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to an integer in the low bits
    let z = (-0.5 * std::f32::consts::LOG2_E * a * a).max(-100.0);
    let rounded = z + MAGIC;
    let f = z - (rounded - MAGIC);
    let power = 1.0
        + f * (0.693_147_2
            + f * (0.240_226_51
                + f * (0.055_504_11 + f * (0.009_618_13 + f * (0.001_333_36 + f * 0.000_154_03)))));
    let scale = f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000));
    0.398_942_3 * power * scale
}

/// erf(a/√2) from φ(a): Abramowitz and Stegun 7.1.26, error below 2e-7.
#[inline(always)]
fn edge(a: f32, density: f32) -> f32 {
    let t = 1.0 / (1.0 + 0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2 * a.abs());
    let series = t
        * (0.254_829_6
            + t * (-0.284_496_74 + t * (1.421_413_7 + t * (-1.453_152 + t * 1.061_405_4))));
    (1.0 - series * density * 2.506_628_3).copysign(a)
}

/// One pixel: the model's value and its derivatives by the free parameters.
#[inline(always)]
fn evaluate(c: &Constants, x: f32, y: f32) -> (f32, f32, [f32; FREE]) {
    let (dx, dy) = (x - c.x0, y - c.y0);
    let t1 = c.n1[0] * dy - c.n1[1] * dx;
    let t2 = c.n2[0] * dy - c.n2[1] * dx;
    let d1 = c.n1[0] * dx + c.n1[1] * dy - c.half_curvature[0] * t1 * t1;
    let d2 = c.n2[0] * dx + c.n2[1] * dy - c.half_curvature[1] * t2 * t2;
    let (a, b) = (d1 * c.inverse_sigma, d2 * c.inverse_sigma);
    let (pa, pb) = (density(a), density(b));
    let (a2, b2) = (a * a, b * b);
    let (a_he2, b_he2) = (a2 - 1.0, b2 - 1.0);
    let (a_he3, b_he3) = (a * (a2 - 3.0), b * (b2 - 3.0));
    let a_he4 = a2 * a2 - 6.0 * a2 + 3.0;
    let b_he4 = b2 * b2 - 6.0 * b2 + 3.0;
    let ea = edge(a, pa) - 2.0 * c.cumulant[0] * a_he3 * pa;
    let eb = edge(b, pb) - 2.0 * c.cumulant[1] * b_he3 * pb;
    let ea_a = 2.0 * pa * (1.0 + c.cumulant[0] * a_he4);
    let eb_b = 2.0 * pb * (1.0 + c.cumulant[1] * b_he4);
    let p4 = 4.0 * pa * pb;
    let s = &c.series;
    let k = ea * eb + p4 * (s[0] + s[1] * a * b + s[2] * a_he2 * b_he2 + s[3] * a_he3 * b_he3);
    // d(He_k·φ)/da = −He_{k+1}·φ
    let k_a = ea_a * eb
        - p4 * (s[0] * a + s[1] * a_he2 * b + s[2] * a_he3 * b_he2 + s[3] * a_he4 * b_he3);
    let k_b = ea * eb_b
        - p4 * (s[0] * b + s[1] * a * b_he2 + s[2] * a_he2 * b_he3 + s[3] * a_he3 * b_he4);
    let r = &c.series_by_rho;
    let k_rho = p4 * (r[0] + r[1] * a * b + r[2] * a_he2 * b_he2 + r[3] * a_he3 * b_he3);

    let amplitude = c.half + c.half_gradient[0] * dx + c.half_gradient[1] * dy;
    let value = c.mean + c.gradient[0] * dx + c.gradient[1] * dy + amplitude * k;
    let scaled = amplitude * c.inverse_sigma;
    // ∂d/∂δ with the curvature's part; ∂t/∂x = −n_y, ∂t/∂y = n_x.
    let bend1 = 2.0 * c.half_curvature[0] * t1;
    let bend2 = 2.0 * c.half_curvature[1] * t2;
    let d1x = c.n1[0] + bend1 * c.n1[1];
    let d1y = c.n1[1] - bend1 * c.n1[0];
    let d2x = c.n2[0] + bend2 * c.n2[1];
    let d2y = c.n2[1] - bend2 * c.n2[0];
    let by_x = scaled * (k_a * d1x + k_b * d2x) + c.gradient[0] + c.half_gradient[0] * k;
    let by_y = scaled * (k_a * d1y + k_b * d2y) + c.gradient[1] + c.half_gradient[1] * k;
    // ∂d/∂θ = t·(1 + κ·n·δ); the last factor is 1 to the accuracy that κ has.
    let by_theta1 = scaled * k_a * t1 + amplitude * k_rho * c.rho_by_theta;
    let by_theta2 = scaled * k_b * t2 - amplitude * k_rho * c.rho_by_theta;
    // c goes with σ⁻⁴.
    let ea_sigma = 8.0 * c.cumulant[0] * a_he3 * pa;
    let eb_sigma = 8.0 * c.cumulant[1] * b_he3 * pb;
    let by_sigma = scaled * (ea_sigma * eb + ea * eb_sigma - k_a * a - k_b * b);
    (
        value,
        k,
        [
            -by_x,
            -by_y,
            by_theta1,
            by_theta2,
            by_sigma,
            1.0,
            dx,
            dy,
            k,
            k * dx,
            k * dy,
        ],
    )
}

/// The normal equations of a patch at `p`.
pub(super) fn accumulate(patch: &Patch, p: &Parameters) -> Normal {
    let c = Constants::new(p);
    let mut sums = [[0f32; LANES]; PRODUCTS];
    pulp::Arch::new().dispatch(|| {
        let (x, _) = patch.x.as_chunks::<LANES>();
        let (y, _) = patch.y.as_chunks::<LANES>();
        let (value, _) = patch.value.as_chunks::<LANES>();
        let (weight, _) = patch.weight.as_chunks::<LANES>();
        for (((x, y), value), weight) in x.iter().zip(y).zip(value).zip(weight) {
            let mut columns = [[0f32; LANES]; COLUMNS];
            for l in 0..LANES {
                let (model, _, jacobian) = evaluate(&c, x[l], y[l]);
                for (column, j) in columns.iter_mut().zip(jacobian) {
                    column[l] = j * weight[l];
                }
                columns[FREE][l] = (value[l] - model) * weight[l];
            }
            let mut k = 0;
            for i in 0..COLUMNS {
                for j in i..COLUMNS {
                    for l in 0..LANES {
                        sums[k][l] += columns[i][l] * columns[j][l];
                    }
                    k += 1;
                }
            }
        }
    });
    let mut products = [[0.0; COLUMNS]; COLUMNS];
    let mut k = 0;
    for i in 0..COLUMNS {
        for j in i..COLUMNS {
            let sum: f64 = sums[k].iter().map(|&s| f64::from(s)).sum();
            products[i][j] = sum;
            products[j][i] = sum;
            k += 1;
        }
    }
    Normal { products }
}

/// Residual (value − model) and K of every pixel of a patch, padding included.
pub(super) fn residuals(patch: &Patch, p: &Parameters, residual: &mut Vec<f32>, k: &mut Vec<f32>) {
    let c = Constants::new(p);
    let n = patch.x.len();
    residual.resize(n, 0.0);
    k.resize(n, 0.0);
    pulp::Arch::new().dispatch(|| {
        let residual = &mut residual[..n];
        let k = &mut k[..n];
        for i in 0..n {
            let (model, pattern, _) = evaluate(&c, patch.x[i], patch.y[i]);
            residual[i] = patch.value[i] - model;
            k[i] = pattern;
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters() -> Parameters {
        Parameters {
            free: [0.3, -0.2, 1.4, 0.1, 0.9, 100.0, 0.2, -0.1, 70.0, 0.05, 0.03],
            curvature: [1e-3, -5e-4],
        }
    }

    #[test]
    fn density_and_edge_agree_with_references() {
        // erf(1/√2), erf(2/√2), erf(3/√2): tables of the normal distribution.
        for (a, erf) in [
            (0.0, 0.0),
            (1.0, 0.682_689_5),
            (2.0, 0.954_499_7),
            (3.0, 0.997_300_2),
        ] {
            for a in [a, -a] {
                let d = density(a);
                let exact = (-0.5 * f64::from(a).powi(2)).exp() / std::f64::consts::TAU.sqrt();
                assert!((f64::from(d) / exact - 1.0).abs() < 1e-6);
                assert!((edge(a, d) - erf * a.signum()).abs() < 5e-7, "{a}");
            }
        }
        assert!(density(30.0) < 1e-20);
    }

    #[test]
    fn jacobian_agrees_with_differences() {
        let p = parameters();
        for (x, y) in [
            (0.5, 0.1),
            (-1.0, 0.7),
            (2.0, -1.3),
            (-6.0, 0.2),
            (0.4, 8.0),
        ] {
            let (_, _, j) = evaluate(&Constants::new(&p), x, y);
            for i in 0..FREE {
                let step = 5e-3;
                let mut plus = p;
                let mut minus = p;
                plus.free[i] += step;
                minus.free[i] -= step;
                let f = |p: &Parameters| evaluate(&Constants::new(p), x, y).0;
                let numeric = (f(&plus) - f(&minus)) / (2.0 * step as f32);
                assert!(
                    (numeric - j[i]).abs() < 5e-3 * (1.0 + j[i].abs()) + 0.02,
                    "parameter {i} at ({x}, {y}): {numeric} against {}",
                    j[i]
                );
            }
        }
    }

    /// K against its definition: the skew checker under a Gaussian and a box pixel, by brute force.
    #[test]
    fn pattern_agrees_with_quadrature() {
        let mut p = parameters();
        p.curvature = [0.0; 2];
        p.free[6..8].fill(0.0);
        p.free[9..11].fill(0.0);
        let spread = (p.free[4].powi(2) - 1.0 / 12.0).sqrt();
        let (n1, n2) = (p.free[2].sin_cos(), p.free[3].sin_cos());
        for (x, y) in [(0.3, -0.2), (1.0, 0.2), (-0.4, 0.6), (1.5, -1.0)] {
            // Midpoint rule over (box ∗ Gaussian) in each axis: density of their sum.
            let step = 0.02;
            let weight = |t: f64| {
                let phi = |z: f64| 0.5 * (1.0 + libm_erf(z / (spread * 2f64.sqrt())));
                phi(t + 0.5) - phi(t - 0.5)
            };
            let mut sum = 0.0;
            let mut total = 0.0;
            for i in -250..250 {
                for j in -250..250 {
                    let (s, t) = ((i as f64 + 0.5) * step, (j as f64 + 0.5) * step);
                    let w = weight(s) * weight(t);
                    let (dx, dy) = (x + s - p.free[0], y + t - p.free[1]);
                    let d1 = n1.1 * dx + n1.0 * dy;
                    let d2 = n2.1 * dx + n2.0 * dy;
                    sum += w * d1.signum() * d2.signum();
                    total += w;
                }
            }
            let (_, k, _) = evaluate(&Constants::new(&p), x as f32, y as f32);
            assert!(
                (f64::from(k) - sum / total).abs() < 2e-3,
                "{k} {}",
                sum / total
            );
        }
    }

    /// erf by its Maclaurin series (enough for |x| < 5 in f64).
    fn libm_erf(x: f64) -> f64 {
        if x.abs() > 5.0 {
            return x.signum();
        }
        let (mut term, mut sum, mut n) = (x, x, 0.0);
        while term.abs() > 1e-17 {
            n += 1.0;
            term *= -x * x / n;
            sum += term / (2.0 * n + 1.0);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    }
}
