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
        Cursor {
            c: self.c,
            x: u64::from(n) * self.c,
            t: self.time(n),
            interval: 0,
        }
    }
}

/// Walks along a ramp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cursor {
    c: u64,
    /// n · C
    x: u64,
    /// isqrt(x)
    t: u32,
    /// The last interval, for the guess of the next.
    interval: u32,
}

impl Cursor {
    /// t(n) where the cursor stands.
    pub const fn time(&self) -> u32 {
        self.t
    }

    /// To step n + 1: the interval to it. Not past [`Ramp::max_steps`].
    pub fn up(&mut self) -> u32 {
        let before = self.t;
        self.x = self.x.saturating_add(self.c);
        self.t = root_near(self.x, self.t.saturating_add(self.interval));
        self.interval = self.t - before;
        self.interval
    }

    /// To step n − 1: the interval from it, which is the one that a mirrored ramp needs next. Not below 0.
    pub fn down(&mut self) -> u32 {
        let before = self.t;
        self.x = self.x.saturating_sub(self.c);
        self.t = root_near(self.x, self.t.saturating_sub(self.interval));
        self.interval = before - self.t;
        self.interval
    }
}

/// isqrt(x) from a guess: Newton's step where the guess is far off (there the intervals are long
/// and a division affordable), then by ones.
fn root_near(x: u64, guess: u32) -> u32 {
    let mut t = guess;
    // Each round squares the relative error; three cover any guess that is of the right order.
    for _ in 0..3 {
        let square = u64::from(t) * u64::from(t);
        let off = x.abs_diff(square);
        if off <= 8 * u64::from(t) {
            // Within four of the root: walk.
            loop {
                let square = u64::from(t) * u64::from(t);
                if square > x {
                    t -= 1;
                } else if x - square > 2 * u64::from(t) {
                    t += 1;
                } else {
                    return t;
                }
            }
        }
        let by = off / (2 * u64::from(t.max(1)));
        let by = u32::try_from(by).unwrap_or(u32::MAX);
        t = if square > x {
            t.saturating_sub(by)
        } else {
            t.saturating_add(by)
        };
    }
    x.isqrt() as u32
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

        #[test]
        fn any_guess_leads_to_the_root(x in any::<u64>(), guess in any::<u32>()) {
            prop_assert_eq!(u64::from(root_near(x, guess)), x.isqrt());
        }
    }
}
