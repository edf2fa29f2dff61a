//! Plain loops compiled for the widest registers of the machine at hand, and numbers that fill one.

mod lanes;

pub(crate) use lanes::Lanes;

/// Runs `body` compiled for the processor's best instruction set (AVX2 and FMA on x86-64, where it
/// has them; chosen at run time).
///
/// Write the closure as `#[inline(always)] || …`, and mark what it calls `#[inline(always)]`:
/// anything that is not inlined is compiled for the least machine. (A closure given to
/// `pulp::Arch::dispatch` itself goes through a `FnOnce` shim that is not inlined; hence this.)
#[inline]
pub fn widest(body: impl FnMut()) {
    struct Body<F>(F);
    impl<F: FnMut()> pulp::WithSimd for Body<F> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: pulp::Simd>(mut self, _: S) {
            (self.0)();
        }
    }
    pulp::Arch::new().dispatch(Body(body));
}
