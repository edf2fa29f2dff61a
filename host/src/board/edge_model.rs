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

use crate::image::Pixel;
use crate::simd::Lanes;
use pulp::{Simd, WithSimd};

/// Free parameters, in the order of [`Parameters::free`].
pub(super) const FREE: usize = 11;
const COLUMNS: usize = FREE + 1;
/// Patches are padded to this many pixels: no register holds more.
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

    /// Every `stride`-th pixel of a piece of a row that starts at (x, y).
    #[inline]
    pub fn append<P: Pixel>(&mut self, x: i64, y: i64, pixels: &[P], stride: usize) {
        let before = self.value.len();
        if stride == 1 {
            self.value
                .extend(pixels.iter().map(|&p| -> f32 { p.into() }));
        } else {
            let some = pixels.iter().step_by(stride);
            self.value.extend(some.map(|&p| -> f32 { p.into() }));
        }
        let count = self.value.len() - before;
        self.x
            .extend((0..count).map(|i| (x + (i * stride) as i64) as f32));
        self.y.resize(before + count, y as f32);
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
fn density<S: Simd>(a: Lanes<S>, simd: S) -> Lanes<S> {
    let c = |x: f32| Lanes::splat(simd, x);
    let z = (a * a * c(-0.5 * std::f32::consts::LOG2_E)).at_least(-100.0);
    c(0.398_942_3) * z.power_of_two()
}

/// erf(a/√2) from φ(a): Abramowitz and Stegun 7.1.26, error below 2e-7.
#[inline(always)]
fn edge<S: Simd>(a: Lanes<S>, density: Lanes<S>, simd: S) -> Lanes<S> {
    let c = |x: f32| Lanes::splat(simd, x);
    let one = c(1.0);
    let t = a
        .abs()
        .times_plus(c(0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2), one)
        .reciprocal();
    let series = t * t.polynomial([
        0.254_829_6,
        -0.284_496_74,
        1.421_413_7,
        -1.453_152,
        1.061_405_4,
    ]);
    (one - series * density * c(2.506_628_3))
        .at_least(0.0)
        .with_sign_of(a)
}

/// The model in all lanes: its value, K, and the derivatives by the free parameters.
#[inline(always)]
fn evaluate<S: Simd>(
    simd: S,
    p: &Constants,
    x: S::f32s,
    y: S::f32s,
) -> (Lanes<S>, Lanes<S>, [Lanes<S>; FREE]) {
    let c = |x: f32| Lanes::splat(simd, x);
    let (one, three, six) = (c(1.0), c(3.0), c(6.0));
    let dx = Lanes::new(simd, x) - c(p.x0);
    let dy = Lanes::new(simd, y) - c(p.y0);
    let ([n1x, n1y], [n2x, n2y]) = (p.n1.map(c), p.n2.map(c));
    let [c1, c2] = p.cumulant.map(c);
    let [bend1, bend2] = p.half_curvature.map(c);
    let scale = c(p.inverse_sigma);

    let t1 = n1x * dy - n1y * dx;
    let t2 = n2x * dy - n2y * dx;
    let d1 = n1x * dx + n1y * dy - bend1 * t1 * t1;
    let d2 = n2x * dx + n2y * dy - bend2 * t2 * t2;
    let (a, b) = (d1 * scale, d2 * scale);
    let (pa, pb) = (density(a, simd), density(b, simd));
    let (aa, bb) = (a * a, b * b);
    let (a2, b2) = (aa - one, bb - one); // He₂
    let (a3, b3) = (a * (aa - three), b * (bb - three));
    let (a4, b4) = (aa * (aa - six) + three, bb * (bb - six) + three);
    let two = c(2.0);
    let (tail_a, tail_b) = (two * c1 * a3 * pa, two * c2 * b3 * pb);
    let ea = edge(a, pa, simd) - tail_a;
    let eb = edge(b, pb, simd) - tail_b;
    let ea_a = two * pa * (one + c1 * a4);
    let eb_b = two * pb * (one + c2 * b4);
    // d(He_k·φ)/da = −He_{k+1}·φ
    let p4 = c(4.0) * pa * pb;
    let [s0, s1, s2, s3] = p.series.map(c);
    let [r0, r1, r2, r3] = p.series_by_rho.map(c);
    let k = ea * eb + p4 * (s0 + s1 * a * b + s2 * a2 * b2 + s3 * a3 * b3);
    let k_a = ea_a * eb - p4 * (s0 * a + s1 * a2 * b + s2 * a3 * b2 + s3 * a4 * b3);
    let k_b = ea * eb_b - p4 * (s0 * b + s1 * a * b2 + s2 * a2 * b3 + s3 * a3 * b4);
    let k_rho = p4 * (r0 + r1 * a * b + r2 * a2 * b2 + r3 * a3 * b3);

    let ([gx, gy], [qx, qy]) = (p.gradient.map(c), p.half_gradient.map(c));
    let amplitude = c(p.half) + qx * dx + qy * dy;
    let value = c(p.mean) + gx * dx + gy * dy + amplitude * k;
    let scaled = amplitude * scale;
    // ∂d/∂δ with the curvature's part; ∂t/∂x = −n_y, ∂t/∂y = n_x.
    let (u1, u2) = (two * bend1 * t1, two * bend2 * t2);
    let (sa, sb) = (scaled * k_a, scaled * k_b);
    let by_x = sa * (n1x + u1 * n1y) + sb * (n2x + u2 * n2y) + gx + qx * k;
    let by_y = sa * (n1y - u1 * n1x) + sb * (n2y - u2 * n2x) + gy + qy * k;
    // ∂d/∂θ = t·(1 + κ·n·δ); the last factor is 1 to the accuracy that κ has.
    let turn = amplitude * k_rho * c(p.rho_by_theta);
    // c goes with σ⁻⁴.
    let four = c(4.0);
    let by_sigma = scaled * four * (tail_a * eb + ea * tail_b) - (sa * a + sb * b);
    let jacobian = [
        -by_x,
        -by_y,
        sa * t1 + turn,
        sb * t2 - turn,
        by_sigma,
        one,
        dx,
        dy,
        k,
        k * dx,
        k * dy,
    ];
    (value, k, jacobian)
}

/// Registers of pixels between two rounds of products: they stay in the first-level cache.
const BLOCK: usize = 8;

struct Accumulate<'a> {
    patch: &'a Patch,
    constants: Constants,
    products: [[f64; COLUMNS]; COLUMNS],
}

impl WithSimd for &mut Accumulate<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, _) = S::as_simd_f32s(&self.patch.x);
        let (y, _) = S::as_simd_f32s(&self.patch.y);
        let (value, _) = S::as_simd_f32s(&self.patch.value);
        let (weight, _) = S::as_simd_f32s(&self.patch.weight);
        let zero = Lanes::splat(simd, 0.0);
        let mut sums = [[zero; COLUMNS]; COLUMNS];
        let mut block = [[zero; COLUMNS]; BLOCK];
        let n = x.len();
        let mut start = 0;
        while start < n {
            let count = BLOCK.min(n - start);
            let pixels = x[start..start + count]
                .iter()
                .zip(&y[start..start + count])
                .zip(&value[start..start + count])
                .zip(&weight[start..start + count]);
            for (columns, (((&x, &y), &value), &weight)) in block.iter_mut().zip(pixels) {
                let (model, _, jacobian) = evaluate(simd, &self.constants, x, y);
                let weight = Lanes::new(simd, weight);
                for (column, j) in columns.iter_mut().zip(jacobian) {
                    *column = j * weight;
                }
                columns[FREE] = (Lanes::new(simd, value) - model) * weight;
            }
            let block = &block[..count];
            row::<S, 0>(block, &mut sums);
            row::<S, 1>(block, &mut sums);
            row::<S, 2>(block, &mut sums);
            row::<S, 3>(block, &mut sums);
            row::<S, 4>(block, &mut sums);
            row::<S, 5>(block, &mut sums);
            row::<S, 6>(block, &mut sums);
            row::<S, 7>(block, &mut sums);
            row::<S, 8>(block, &mut sums);
            row::<S, 9>(block, &mut sums);
            row::<S, 10>(block, &mut sums);
            row::<S, 11>(block, &mut sums);
            start += count;
        }
        for i in 0..COLUMNS {
            for j in i..COLUMNS {
                let sum = f64::from(sums[i][j].sum());
                self.products[i][j] = sum;
                self.products[j][i] = sum;
            }
        }
    }
}

/// Column I times columns I to the last: one sum a register.
#[inline(always)]
fn row<S: Simd, const I: usize>(
    block: &[[Lanes<S>; COLUMNS]],
    sums: &mut [[Lanes<S>; COLUMNS]; COLUMNS],
) {
    let mut sum = sums[I];
    for columns in block {
        for j in I..COLUMNS {
            sum[j] = columns[I].times_plus(columns[j], sum[j]);
        }
    }
    sums[I] = sum;
}

/// The normal equations of a patch at `p`.
pub(super) fn accumulate(patch: &Patch, p: &Parameters) -> Normal {
    let mut work = Accumulate {
        patch,
        constants: Constants::new(p),
        products: [[0.0; COLUMNS]; COLUMNS],
    };
    pulp::Arch::new().dispatch(&mut work);
    Normal {
        products: work.products,
    }
}

struct Residuals<'a> {
    patch: &'a Patch,
    constants: Constants,
    residual: &'a mut [f32],
    k: &'a mut [f32],
}

impl WithSimd for &mut Residuals<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, _) = S::as_simd_f32s(&self.patch.x);
        let (y, _) = S::as_simd_f32s(&self.patch.y);
        let (value, _) = S::as_simd_f32s(&self.patch.value);
        let (residual, _) = S::as_mut_simd_f32s(self.residual);
        let (pattern, _) = S::as_mut_simd_f32s(self.k);
        let pixels = x.iter().zip(y).zip(value);
        for (((&x, &y), &value), (residual, pattern)) in
            pixels.zip(residual.iter_mut().zip(pattern))
        {
            let (model, k, _) = evaluate(simd, &self.constants, x, y);
            *residual = (Lanes::new(simd, value) - model).value;
            *pattern = k.value;
        }
    }
}

/// Residual (value − model) and K of every pixel of a patch, padding included.
pub(super) fn residuals(patch: &Patch, p: &Parameters, residual: &mut Vec<f32>, k: &mut Vec<f32>) {
    residual.resize(patch.x.len(), 0.0);
    k.resize(patch.x.len(), 0.0);
    pulp::Arch::new().dispatch(&mut Residuals {
        patch,
        constants: Constants::new(p),
        residual,
        k,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluate(c: &Constants, x: f32, y: f32) -> (f32, f32, [f32; FREE]) {
        let (value, k, jacobian) = super::evaluate(pulp::Scalar::new(), c, x, y);
        (value.value, k.value, jacobian.map(|j| j.value))
    }

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
                let simd = pulp::Scalar::new();
                let a_lane = Lanes::new(simd, a);
                let d_lane = density(a_lane, simd);
                let (d, e) = (d_lane.value, edge(a_lane, d_lane, simd).value);
                let exact = (-0.5 * f64::from(a).powi(2)).exp() / std::f64::consts::TAU.sqrt();
                assert!((f64::from(d) / exact - 1.0).abs() < 1e-6);
                assert!((e - erf * a.signum()).abs() < 5e-7, "{a}");
            }
        }
        let simd = pulp::Scalar::new();
        assert!(density(Lanes::new(simd, 30.0), simd).value < 1e-20);
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
