//! A lane: one number, or a SIMD register of them. The solver's kernels are written once over
//! [`Lane`]; `f64` is the second, scalar implementation that tests compare with.

use pulp::Simd;
use std::ops::{Add, Mul, Neg, Sub};

/// Numbers that the kernels work on.
pub trait Lane:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// How many numbers it holds.
    const LANES: usize;
    /// All equal to `x`. `self` says which instruction set; its value does not matter.
    fn splat(self, x: f64) -> Self;
    /// The first `LANES` of a slice (zeros if the slice is too short).
    fn load(self, slice: &[f64]) -> Self;
    /// Into the first `LANES` of a slice.
    fn store(self, slice: &mut [f64]);
    /// self · b + c.
    fn fma(self, b: Self, c: Self) -> Self;
    /// The smaller.
    fn min(self, other: Self) -> Self;
    /// The larger.
    fn max(self, other: Self) -> Self;
    /// self / b.
    fn div(self, b: Self) -> Self;
    /// The sum over the register.
    fn sum(self) -> f64;
    /// The smallest of the register.
    fn least(self) -> f64;
    /// The largest of the register.
    fn largest(self) -> f64;
}

impl Lane for f64 {
    const LANES: usize = 1;
    #[inline(always)]
    fn splat(self, x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn load(self, slice: &[f64]) -> Self {
        slice.first().copied().unwrap_or(0.0)
    }
    #[inline(always)]
    fn store(self, slice: &mut [f64]) {
        if let Some(place) = slice.first_mut() {
            *place = self;
        }
    }
    #[inline(always)]
    fn fma(self, b: Self, c: Self) -> Self {
        self * b + c
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        f64::min(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        f64::max(self, other)
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        self / b
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        self
    }
    #[inline(always)]
    fn least(self) -> f64 {
        self
    }
    #[inline(always)]
    fn largest(self) -> f64 {
        self
    }
}

/// A register of the instruction set `S`.
#[derive(Clone, Copy)]
pub struct Wide<S: Simd> {
    simd: S,
    v: S::f64s,
}

impl<S: Simd> Wide<S> {
    /// Zeros, to splat and load from.
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self {
            simd,
            v: simd.splat_f64s(0.0),
        }
    }
}

impl<S: Simd> Add for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self {
            v: self.simd.add_f64s(self.v, o.v),
            ..self
        }
    }
}

impl<S: Simd> Sub for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self {
            v: self.simd.sub_f64s(self.v, o.v),
            ..self
        }
    }
}

impl<S: Simd> Mul for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self {
            v: self.simd.mul_f64s(self.v, o.v),
            ..self
        }
    }
}

impl<S: Simd> Neg for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self {
            v: self.simd.neg_f64s(self.v),
            ..self
        }
    }
}

impl<S: Simd> Lane for Wide<S> {
    const LANES: usize = S::F64_LANES;
    #[inline(always)]
    fn splat(self, x: f64) -> Self {
        Self {
            v: self.simd.splat_f64s(x),
            ..self
        }
    }
    #[inline(always)]
    fn load(self, slice: &[f64]) -> Self {
        let v = match S::as_simd_f64s(slice).0.first() {
            Some(&v) => v,
            None => self.simd.splat_f64s(0.0),
        };
        Self { v, ..self }
    }
    #[inline(always)]
    fn store(self, slice: &mut [f64]) {
        if let Some(place) = S::as_mut_simd_f64s(slice).0.first_mut() {
            *place = self.v;
        }
    }
    #[inline(always)]
    fn fma(self, b: Self, c: Self) -> Self {
        Self {
            v: self.simd.mul_add_e_f64s(self.v, b.v, c.v),
            ..self
        }
    }
    #[inline(always)]
    fn min(self, o: Self) -> Self {
        Self {
            v: self.simd.min_f64s(self.v, o.v),
            ..self
        }
    }
    #[inline(always)]
    fn max(self, o: Self) -> Self {
        Self {
            v: self.simd.max_f64s(self.v, o.v),
            ..self
        }
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        Self {
            v: self.simd.div_f64s(self.v, o.v),
            ..self
        }
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        self.simd.reduce_sum_f64s(self.v)
    }
    #[inline(always)]
    fn least(self) -> f64 {
        self.simd.reduce_min_f64s(self.v)
    }
    #[inline(always)]
    fn largest(self) -> f64 {
        self.simd.reduce_max_f64s(self.v)
    }
}
