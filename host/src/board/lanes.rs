//! Single-precision numbers, as many at once as a register holds, with ordinary operators.

use pulp::Simd;
use std::ops::{Add, Mul, Neg, Sub};

/// One register.
#[derive(Clone, Copy)]
pub(super) struct Lanes<S: Simd> {
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

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(self.simd, self.simd.neg_f32s(self.value))
    }
}
