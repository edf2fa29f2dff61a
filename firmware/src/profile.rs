//! A move from rest to rest: ramp up, cruise, the ramp mirrored. Edge k of N (k from 1) comes at
//!
//! ```text
//! k ≤ R           t(k)
//! R < k ≤ N − R   t(R) + (k − R) · I
//! N − R < k       T − t(N − k)            with T = 2·t(R) + (N − 2R)·I
//! ```
//!
//! where R is the ramp's length, I the cruise interval in whole cycles (so that cruising has no
//! jitter at all), and t the ramp's absolute times. A short move is a triangle: R = ⌊N/2⌋.

use crate::ramp::Ramp;
use cannula_shared::config::{MAX_STEP_INTERVAL, MIN_STEP_INTERVAL};
use cannula_shared::units::{CLOCK_HZ, Cycles};

/// A planned move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Profile {
    ramp: Ramp,
    steps: u32,
    ramp_steps: u32,
    cruise: u32,
    /// The interval that was asked for, below which none may be.
    shortest: u32,
}

/// The cruise interval of a speed in steps/s: rounded up, so that the speed is not exceeded.
pub fn interval_of(rate: u32) -> u32 {
    CLOCK_HZ
        .div_ceil(rate.max(1))
        .clamp(MIN_STEP_INTERVAL, MAX_STEP_INTERVAL)
}

impl Profile {
    /// `steps` steps at no more than one in `interval` cycles.
    pub fn new(ramp: Ramp, steps: u32, interval: u32) -> Self {
        let to_speed = ramp.steps_to(interval);
        let ramp_steps = to_speed
            .min(steps / 2)
            .min(ramp.max_steps().saturating_sub(1));
        // Not up to speed: what is left in the middle continues the ramp.
        let cruise = if ramp_steps < to_speed {
            interval.max(ramp.time(ramp_steps + 1) - ramp.time(ramp_steps))
        } else {
            interval
        };
        Profile {
            ramp,
            steps,
            ramp_steps,
            cruise,
            shortest: interval,
        }
    }

    /// How many steps.
    pub const fn steps(&self) -> u32 {
        self.steps
    }

    /// How many of them are in either ramp.
    pub const fn ramp_steps(&self) -> u32 {
        self.ramp_steps
    }

    /// The ramp.
    pub const fn ramp(&self) -> Ramp {
        self.ramp
    }

    /// Cycles from step to step between the ramps.
    pub const fn cruise_interval(&self) -> u32 {
        self.cruise
    }

    /// The interval that was asked for. No step is faster, and none has to be as fast.
    pub const fn shortest_interval(&self) -> u32 {
        self.shortest
    }

    /// When edge `k` comes after the start (0 for k = 0).
    pub fn time(&self, k: u32) -> Cycles {
        let (n, r) = (self.steps, self.ramp_steps);
        let up = u64::from(self.ramp.time(r));
        let flat = |steps: u32| u64::from(steps) * u64::from(self.cruise);
        Cycles(if k <= r {
            u64::from(self.ramp.time(k))
        } else if k <= n - r {
            up + flat(k - r)
        } else {
            2 * up + flat(n - 2 * r) - u64::from(self.ramp.time(n.saturating_sub(k)))
        })
    }

    /// When the last edge comes.
    pub fn duration(&self) -> Cycles {
        self.time(self.steps)
    }

    /// The same move, but slowing down from step `k` on: what a stop does when `k` steps are
    /// already on their way. Where it slows down already, nothing changes.
    pub fn stopping_after(&self, k: u32) -> Self {
        let ramp_steps = self.ramp_steps.min(k);
        let steps = self.steps.min(k + ramp_steps);
        Profile {
            steps,
            ramp_steps: if steps < self.steps {
                ramp_steps
            } else {
                self.ramp_steps
            },
            ..*self
        }
    }

    /// The interval that leads to edge `k`, in cycles (for the speed in telemetry).
    pub fn interval(&self, k: u32) -> u32 {
        let k = k.clamp(1, self.steps.max(1));
        if k > self.ramp_steps && k <= self.steps.saturating_sub(self.ramp_steps) {
            return self.cruise;
        }
        u32::try_from(self.time(k).0 - self.time(k - 1).0).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use cannula_shared::config::{MAX_ACCELERATION, MIN_ACCELERATION};
    use proptest::prelude::*;

    fn intervals(p: &Profile) -> impl Iterator<Item = u64> + '_ {
        (1..=p.steps()).map(|k| p.time(k).0 - p.time(k - 1).0)
    }

    #[test]
    fn a_trapezoid_by_hand() {
        // 1000 steps/s² up to 1000 … too slow for a word; take 1e6 steps/s² and 10 000 steps/s.
        let p = Profile::new(Ramp::new(1_000_000), 1000, 12_500);
        // v²/2a = 50 steps.
        assert_eq!(p.ramp_steps(), 50);
        assert_eq!(p.cruise_interval(), 12_500);
        // Twice 10 ms of ramp and 900 steps of 100 µs: 110 ms.
        assert_eq!(p.duration(), Cycles(2 * 1_250_000 + 900 * 12_500));
        assert_eq!(p.time(1), Cycles(176_776));
        assert_eq!(p.time(1000).0 - p.time(999).0, 176_776);
    }

    #[test]
    fn short_moves_are_triangles() {
        let ramp = Ramp::new(1_000_000);
        for (n, r) in [
            (0, 0),
            (1, 0),
            (2, 1),
            (3, 1),
            (99, 49),
            (100, 50),
            (101, 50),
        ] {
            let p = Profile::new(ramp, n, 12_500);
            assert_eq!((p.steps(), p.ramp_steps()), (n, r));
            assert!(intervals(&p).all(|i| i >= 12_500));
        }
        assert_eq!(Profile::new(ramp, 1, 12_500).duration(), Cycles(176_776));
        assert_eq!(Profile::new(ramp, 0, 12_500).duration(), Cycles(0));
    }

    proptest! {
        #[test]
        fn symmetric_monotone_and_within_the_limits(
            a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 0u32..3000, interval in 250u32..MAX_STEP_INTERVAL
        ) {
            let p = Profile::new(Ramp::new(a), n, interval);
            let first = u64::from(Ramp::new(a).time(1));
            let mut fastest = u64::MAX;
            for (up, down) in intervals(&p).zip(intervals(&p).collect::<std::vec::Vec<_>>().into_iter().rev()) {
                prop_assert_eq!(up, down);
                prop_assert!(up >= u64::from(interval) && up <= first.max(u64::from(interval)));
                fastest = fastest.min(up);
            }
            // No interval is shorter than what the acceleration allows after its number of steps.
            for (k, i) in intervals(&p).enumerate() {
                let k = (k as u32).min(n - 1 - k as u32);
                let allowed = Ramp::new(a).time(k + 1) - Ramp::new(a).time(k);
                // (Whole cycles: where the ramp meets the cruise, rounding may decide by one.)
                prop_assert!(i + 1 >= u64::from(allowed), "step {} {} {}", k, i, allowed);
            }
        }

        #[test]
        fn a_stop_keeps_the_past_and_ends_soon(
            a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 1u32..5000, interval in 250u32..100_000, at in any::<prop::sample::Index>()
        ) {
            let p = Profile::new(Ramp::new(a), n, interval);
            let k = at.index(n as usize + 1) as u32;
            let s = p.stopping_after(k);
            prop_assert!(s.steps() >= k && s.steps() <= n);
            prop_assert!(s.steps() - k <= p.ramp_steps());
            prop_assert!((0..=k).all(|j| s.time(j) == p.time(j)), "what is under way stays");
            let last = u64::from(Ramp::new(a).time(1));
            for j in k + 1..=s.steps() {
                // Mirrored ramp: never harder than the acceleration.
                let left = s.steps() - j;
                let allowed = Ramp::new(a).time(left + 1) - Ramp::new(a).time(left);
                prop_assert!(s.time(j).0 - s.time(j - 1).0 + 1 >= u64::from(allowed));
            }
            if s.steps() > k && s.ramp_steps() > 0 {
                prop_assert_eq!(s.time(s.steps()).0 - s.time(s.steps() - 1).0, last);
            }
        }
    }
}
