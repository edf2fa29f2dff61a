//! When the steps of an acceleration come.
//!
//! From rest at constant acceleration a (steps/s²), step n is reached after t = √(2n/a). In cycles
//! of the clock f, with the constant C = ⌊2f²/a⌋ computed once:
//!
//! ```text
//! t(n) = isqrt(n · C)
//! ```
//!
//! an absolute time for every n, so that nothing adds up: exact to the cycle below. A square root
//! per step would be too slow for the CPU; [`Cursor`] walks from one root to the next by
//! correcting a guess until t² ≤ n·C < (t+1)², which is the definition of isqrt.

use cannula_shared::units::CLOCK_HZ;

/// A constant acceleration from rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ramp {
    c: u64,
    /// Beyond this, n·C leaves 64 bits (a ramp of 34 s).
    max_steps: u32,
}

impl Ramp {
    /// A ramp of `acceleration` steps/s² (0 is taken for 1).
    pub fn new(acceleration: u32) -> Self {
        let c = 2 * u64::from(CLOCK_HZ) * u64::from(CLOCK_HZ) / u64::from(acceleration.max(1));
        // For c ≥ 1: the highest acceleration leaves C = 7 276 957.
        let max_steps = u32::try_from(u64::MAX / c.max(1)).unwrap_or(u32::MAX);
        Ramp { c, max_steps }
    }

    /// C of the equation above.
    pub const fn constant(self) -> u64 {
        self.c
    }

    /// The longest ramp that can be computed.
    pub const fn max_steps(self) -> u32 {
        self.max_steps
    }

    /// t(n) in cycles, for n up to [`Self::max_steps`] (clamped to it).
    pub fn time(self, n: u32) -> u32 {
        // The root of 64 bits has 32.
        (u64::from(n.min(self.max_steps)) * self.c).isqrt() as u32
    }

    /// Whether `t` is t(n), by definition rather than by a root.
    pub fn holds(self, n: u32, t: u64) -> bool {
        let x = u128::from(n) * u128::from(self.c);
        let t = u128::from(t);
        t * t <= x && x < (t + 1) * (t + 1)
    }

    /// How many steps of the ramp have intervals of at least `interval` cycles: where the ramp
    /// meets that speed.
    ///
    /// t(n) − t(n−1) lies between √C / (2√n) and √C / (2√(n−1)): all n ≤ C / (4·interval²) qualify, and
    /// perhaps one more.
    pub fn steps_to(self, interval: u32) -> u32 {
        let square = u64::from(interval.max(1)) * u64::from(interval.max(1));
        let n = u32::try_from(self.c / square / 4).unwrap_or(u32::MAX);
        if n >= self.max_steps {
            return n;
        }
        n + u32::from(self.time(n + 1) - self.time(n) >= interval)
    }

    /// A cursor that stands on step `n`.
    pub fn at(self, n: u32) -> Cursor {
        let n = n.min(self.max_steps);
        let t = self.time(n);
        let square = u64::from(t) * u64::from(t);
        Cursor {
            c: self.c,
            rest: (u64::from(n) * self.c - square) as i64,
            t,
            interval: 0,
            square_by: 0,
            grow: 0,
        }
    }
}

/// Walks along a ramp by additions alone: the CPU has neither a long multiplication nor a division,
/// and at 500 000 steps/s there are 250 cycles for a step.
///
/// With the last interval d as the guess of the next, (t + d)² = t² + d·(2t + d); the two products
/// on the right are carried along, and mended by a few more additions where d changes (as a rule
/// by one or not at all).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cursor {
    c: u64,
    /// n·C − t², which lies from 0 to 2t when t = isqrt(n·C). All sums here stay below 4·C.
    rest: i64,
    t: u32,
    /// d
    interval: u32,
    /// d·(2t + d)
    square_by: i64,
    /// 2·d²: what [`Self::square_by`] grows by when t does by d.
    grow: i64,
}

/// A guess that is off by more than two to this many cycles is replaced by a root.
const WALK_BITS: u32 = 5;

impl Cursor {
    /// t(n) where the cursor stands.
    pub const fn time(&self) -> u32 {
        self.t
    }

    /// To step n + 1: the interval to it. Not past [`Ramp::max_steps`].
    #[inline]
    pub fn up(&mut self) -> u32 {
        let before = self.t;
        self.rest = self
            .rest
            .wrapping_add(self.c as i64)
            .wrapping_sub(self.square_by);
        self.t = self.t.wrapping_add(self.interval);
        self.square_by = self.square_by.wrapping_add(self.grow);
        if !self.near() {
            return self.take_root(before);
        }
        while self.rest < 0 {
            self.shift_down();
            self.shorten();
        }
        while self.rest > (i64::from(self.t) << 1) {
            self.shift_up();
            self.lengthen();
        }
        self.interval
    }

    /// To step n − 1: the interval from it, which is the one that a mirrored ramp needs next. Not below 0.
    #[inline]
    pub fn down(&mut self) -> u32 {
        let before = self.t;
        self.square_by = self.square_by.wrapping_sub(self.grow);
        self.rest = self
            .rest
            .wrapping_sub(self.c as i64)
            .wrapping_add(self.square_by);
        self.t = self.t.wrapping_sub(self.interval);
        if before < self.interval || !self.near() {
            return self.take_root(before);
        }
        while self.rest < 0 {
            self.shift_down();
            self.lengthen();
        }
        while self.rest > (i64::from(self.t) << 1) {
            self.shift_up();
            self.shorten();
        }
        self.interval
    }

    /// t is within 2^[`WALK_BITS`] of the root: a cycle changes t² by 2t.
    #[inline]
    fn near(&self) -> bool {
        let reach = i64::from(self.t) << (1 + WALK_BITS);
        -reach <= self.rest && self.rest <= reach
    }

    /// t by one less.
    #[inline]
    fn shift_down(&mut self) {
        self.t = self.t.wrapping_sub(1);
        self.rest = self.rest.wrapping_add((i64::from(self.t) << 1) + 1);
        self.square_by = self.square_by.wrapping_sub(i64::from(self.interval) << 1);
    }

    /// t by one more.
    #[inline]
    fn shift_up(&mut self) {
        self.rest = self.rest.wrapping_sub((i64::from(self.t) << 1) + 1);
        self.t = self.t.wrapping_add(1);
        self.square_by = self.square_by.wrapping_add(i64::from(self.interval) << 1);
    }

    /// d by one less.
    #[inline]
    fn shorten(&mut self) {
        let d = i64::from(self.interval);
        self.square_by = self
            .square_by
            .wrapping_sub((i64::from(self.t) << 1) + 2 * d - 1);
        self.grow = self.grow.wrapping_sub(4 * d - 2);
        self.interval = self.interval.wrapping_sub(1);
    }

    /// d by one more.
    #[inline]
    fn lengthen(&mut self) {
        let d = i64::from(self.interval);
        self.square_by = self
            .square_by
            .wrapping_add((i64::from(self.t) << 1) + 2 * d + 1);
        self.grow = self.grow.wrapping_add(4 * d + 2);
        self.interval = self.interval.wrapping_add(1);
    }

    /// The guess was far off (a ramp's first steps, where intervals are long): t by a root.
    #[cold]
    fn take_root(&mut self, before: u32) -> u32 {
        let square = |t: u32| u64::from(t) * u64::from(t);
        let x = square(self.t).wrapping_add_signed(self.rest);
        self.t = x.isqrt() as u32;
        self.rest = x.wrapping_sub(square(self.t)) as i64;
        self.interval = self.t.abs_diff(before);
        let d = i64::from(self.interval);
        self.square_by = d.wrapping_mul((i64::from(self.t) << 1) + d);
        self.grow = d.wrapping_mul(2 * d);
        self.interval
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cannula_shared::config::{MAX_ACCELERATION, MAX_STEP_INTERVAL, MIN_ACCELERATION};
    use proptest::prelude::*;

    /// t(n) by 128-bit arithmetic without the library's root: bisection.
    fn by_bisection(a: u32, n: u32) -> u64 {
        let x = u128::from(n) * (2 * u128::from(CLOCK_HZ) * u128::from(CLOCK_HZ) / u128::from(a));
        let (mut low, mut high) = (0u128, 1 << 63);
        while high - low > 1 {
            let mid = (low + high) / 2;
            if mid * mid <= x {
                low = mid
            } else {
                high = mid
            }
        }
        low as u64
    }

    #[test]
    fn a_cursor_stands_on_the_exact_time_all_the_way_up_and_down() {
        for a in [
            MIN_ACCELERATION,
            40_000,
            163_840,
            1_000_000,
            10_000_000,
            MAX_ACCELERATION,
        ] {
            let ramp = Ramp::new(a);
            let n = 30_000.min(ramp.max_steps());
            let mut cursor = ramp.at(0);
            let mut sum = 0u64;
            for k in 1..=n {
                sum += u64::from(cursor.up());
                assert!(ramp.holds(k, sum), "a {a} step {k} up");
                assert_eq!(u64::from(cursor.time()), sum);
            }
            for k in (0..n).rev() {
                sum -= u64::from(cursor.down());
                assert!(ramp.holds(k, sum), "a {a} step {k} down");
            }
            assert_eq!(sum, 0);
        }
    }

    #[test]
    fn within_a_cycle_of_the_real_numbers() {
        for a in [8000.0f64, 163_840.0, 5e6] {
            let ramp = Ramp::new(a as u32);
            for n in [1u32, 2, 3, 10, 100, 1000, 100_000] {
                let exact = f64::from(CLOCK_HZ) * (2.0 * f64::from(n) / a).sqrt();
                let off = exact - f64::from(ramp.time(n));
                // C is rounded down too: that shortens t by n/(2t) at most.
                assert!((-1e-3..1.001).contains(&off), "a {a} n {n}: {off}");
            }
        }
    }

    #[test]
    fn extremes_fit_the_step_word() {
        assert!(Ramp::new(MIN_ACCELERATION).time(1) <= MAX_STEP_INTERVAL);
        assert!(Ramp::new(MIN_ACCELERATION - 1).time(1) > MAX_STEP_INTERVAL);
        let fast = Ramp::new(MAX_ACCELERATION);
        assert_eq!(fast.time(1), 17_677);
        assert_eq!(Ramp::new(0).constant(), Ramp::new(1).constant());
    }

    proptest! {
        #[test]
        fn time_is_the_root(a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 0u32..5_000_000) {
            let ramp = Ramp::new(a);
            let n = n.min(ramp.max_steps());
            let t = u64::from(ramp.time(n));
            prop_assert_eq!(t, by_bisection(a, n));
            prop_assert!(ramp.holds(n, t) && !ramp.holds(n, t + 1) && (t == 0 || !ramp.holds(n, t - 1)));
        }

        #[test]
        fn a_cursor_may_turn_anywhere(a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 0u32..1_000_000, legs in prop::collection::vec(1u32..200, 1..6)) {
            let ramp = Ramp::new(a);
            let mut n = n.min(ramp.max_steps() - 1200);
            let mut cursor = ramp.at(n);
            for (i, leg) in legs.into_iter().enumerate() {
                for _ in 0..leg {
                    let before = ramp.time(n);
                    let interval = if i % 2 == 0 {
                        n += 1;
                        cursor.up()
                    } else if n > 0 {
                        n -= 1;
                        cursor.down()
                    } else {
                        break;
                    };
                    prop_assert_eq!(cursor.time(), ramp.time(n));
                    prop_assert_eq!(interval, ramp.time(n).abs_diff(before));
                }
            }
        }

        #[test]
        fn a_cursor_may_start_anywhere(a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 0u32..1_000_000) {
            let ramp = Ramp::new(a);
            let n = n.min(ramp.max_steps() - 2);
            let mut up = ramp.at(n);
            let i = up.up();
            prop_assert_eq!(up.time(), ramp.time(n + 1));
            prop_assert_eq!(i, ramp.time(n + 1) - ramp.time(n));
            let mut down = ramp.at(n + 1);
            prop_assert_eq!(down.down(), i);
            prop_assert_eq!(down.time(), ramp.time(n));
        }

        #[test]
        fn no_step_of_the_ramp_is_faster_than_the_speed_it_leads_to(a in MIN_ACCELERATION..=MAX_ACCELERATION, interval in 250u32..MAX_STEP_INTERVAL) {
            let ramp = Ramp::new(a);
            let n = ramp.steps_to(interval).min(ramp.max_steps());
            for k in [1, n / 2, n].into_iter().filter(|&k| k >= 1 && k <= n) {
                prop_assert!(ramp.time(k) - ramp.time(k - 1) >= interval, "step {} of {}", k, n);
            }
            // And the ramp is not cut short: a little later it would be too fast.
            let later = n + n / 50 + 3;
            if later < ramp.max_steps() {
                prop_assert!(ramp.time(later) - ramp.time(later - 1) <= interval);
            }
        }
    }
}
