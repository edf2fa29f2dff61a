//! Single-precision numbers, as many at once as a register holds, with ordinary operators.

use pulp::Simd;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// One register.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd> {
    simd: S,
    pub value: S::f32s,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub fn new(simd: S, value: S::f32s) -> Self {
        Self { simd, value }
    }

    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self::new(simd, simd.splat_f32s(value))
    }

    /// self·b + c, fused where that is fast.
    #[inline(always)]
    pub fn times_plus(self, b: Self, c: Self) -> Self {
        let value = self.simd.mul_add_e_f32s(self.value, b.value, c.value);
        Self::new(self.simd, value)
    }

    /// c₀ + self·(c₁ + self·(…)).
    #[inline(always)]
    pub fn polynomial<const N: usize>(self, c: [f32; N]) -> Self {
        let mut sum = Self::splat(self.simd, c[N - 1]);
        for k in (0..N - 1).rev() {
            sum = sum.times_plus(self, Self::splat(self.simd, c[k]));
        }
        sum
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self::new(self.simd, self.simd.abs_f32s(self.value))
    }

    #[inline(always)]
    pub fn at_least(self, low: f32) -> Self {
        let low = self.simd.splat_f32s(low);
        Self::new(self.simd, self.simd.max_f32s(self.value, low))
    }

    /// NaN stays NaN where the processor's minimum is that of x86.
    #[inline(always)]
    pub fn between(self, low: Self, high: Self) -> Self {
        let value = self.simd.max_f32s(low.value, self.value);
        Self::new(self.simd, self.simd.min_f32s(high.value, value))
    }

    #[inline(always)]
    pub fn larger(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.max_f32s(self.value, other.value))
    }

    #[inline(always)]
    pub fn smaller(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.min_f32s(self.value, other.value))
    }

    /// self where `a` ≥ `b`, else 0.
    #[inline(always)]
    pub fn where_at_least(self, a: Self, b: Self) -> Self {
        let simd = self.simd;
        let mask = simd.greater_than_or_equal_f32s(a.value, b.value);
        let zero = simd.splat_f32s(0.0);
        Self::new(simd, simd.select_f32s(mask, self.value, zero))
    }

    #[inline(always)]
    pub fn square_root(self) -> Self {
        Self::new(self.simd, self.simd.sqrt_f32s(self.value))
    }

    #[inline(always)]
    pub fn reciprocal(self) -> Self {
        let one = self.simd.splat_f32s(1.0);
        Self::new(self.simd, self.simd.div_f32s(one, self.value))
    }

    /// self ≥ 0 given the sign of `other`.
    #[inline(always)]
    pub fn with_sign_of(self, other: Self) -> Self {
        let simd = self.simd;
        let sign = simd.and_u32s(
            simd.transmute_u32s_f32s(other.value),
            simd.splat_u32s(0x8000_0000),
        );
        let bits = simd.or_u32s(simd.transmute_u32s_f32s(self.value), sign);
        Self::new(simd, simd.transmute_f32s_u32s(bits))
    }

    /// 2 to the power of self, for self in −100..100; relative error below 2e-7.
    #[inline(always)]
    pub fn power_of_two(self) -> Self {
        const MAGIC: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to an integer in the low bits
        let simd = self.simd;
        let rounded = self + Self::splat(simd, MAGIC);
        let f = self - (rounded - Self::splat(simd, MAGIC));
        let power = f.polynomial([
            1.0,
            std::f32::consts::LN_2,
            0.240_226_5,
            0.055_504_11,
            0.009_618_13,
            0.001_333_36,
            0.000_154_03,
        ]);
        let exponent = simd
            .wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(rounded.value), simd.splat_u32s(23));
        let bits = simd.add_u32s(exponent, simd.splat_u32s(0x3f80_0000));
        power * Self::new(simd, simd.transmute_f32s_u32s(bits))
    }

    #[inline(always)]
    pub fn maximum(self) -> f32 {
        self.simd.reduce_max_f32s(self.value)
    }

    #[inline(always)]
    pub fn sum(self) -> f32 {
        self.simd.reduce_sum_f32s(self.value)
    }
}

impl<S: Simd> Add for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.add_f32s(self.value, other.value))
    }
}

impl<S: Simd> Sub for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.sub_f32s(self.value, other.value))
    }
}

impl<S: Simd> Mul for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.mul_f32s(self.value, other.value))
    }
}

impl<S: Simd> Div for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self::new(self.simd, self.simd.div_f32s(self.value, other.value))
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(self.simd, self.simd.neg_f32s(self.value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_two_are_those_of_the_library() {
        let simd = pulp::Scalar::new();
        for i in -9999..=9999 {
            let x = i as f32 * 0.01;
            let (ours, exact) = (
                Lanes::new(simd, x).power_of_two().value,
                f64::from(x).exp2(),
            );
            assert!(
                (f64::from(ours) / exact - 1.0).abs() < 2e-7,
                "2^{x}: {ours}"
            );
        }
    }

    #[test]
    fn limits_and_masks() {
        let simd = pulp::Scalar::new();
        let l = |x: f32| Lanes::new(simd, x);
        for (x, clamped) in [(-2.0, -1.0), (0.5, 0.5), (7.0, 3.0)] {
            assert_eq!(l(x).between(l(-1.0), l(3.0)).value, clamped);
        }
        assert_eq!(l(4.0).where_at_least(l(1.0), l(1.0)).value, 4.0);
        assert_eq!(l(4.0).where_at_least(l(0.9), l(1.0)).value, 0.0);
    }
}
