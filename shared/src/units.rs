//! Units as types, so that steps are not taken for micrometres nor cycles for microseconds.
//!
//! All are integers: a position that was computed twice must be the same position. Names:
//! *steps* are STEP edges of the driver, counted from zero at home; *cycles* are periods of the
//! board's system clock (8 ns); *micros* are microseconds since the board's boot.

use core::fmt;
use serde::{Deserialize, Serialize};

/// The board's system clock, Hz.
pub const CLOCK_HZ: u32 = 125_000_000;
/// Cycles of the system clock per microsecond.
pub const CYCLES_PER_MICRO: u64 = 125;

macro_rules! unit {
    ($(#[$meta:meta])* $name:ident($inner:ty), $suffix:literal) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[repr(transparent)]
        pub struct $name(pub $inner);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!("{} ", $suffix), self.0)
            }
        }
    };
}

unit!(
    /// A position or a distance in STEP edges; zero at home, positive away from it.
    Steps(i32), "steps"
);
unit!(
    /// A position or a distance in µm.
    Micrometres(i32), "µm"
);
unit!(
    /// A time since the board's boot, or a duration, in µs.
    Micros(u64), "µs"
);
unit!(
    /// A time or a duration in periods of the 125 MHz clock.
    Cycles(u64), "cycles"
);

impl Micros {
    /// A duration given in milliseconds.
    pub const fn from_millis(ms: u64) -> Self {
        Micros(ms.saturating_mul(1000))
    }
    /// The same duration in cycles.
    pub const fn to_cycles(self) -> Cycles {
        Cycles(self.0.saturating_mul(CYCLES_PER_MICRO))
    }
    /// Later by `by`; stays at the end of time rather than wrapping.
    pub const fn after(self, by: Micros) -> Self {
        Micros(self.0.saturating_add(by.0))
    }
    /// The time since `earlier`; zero if that lies ahead.
    pub const fn since(self, earlier: Micros) -> Self {
        Micros(self.0.saturating_sub(earlier.0))
    }
}

impl Cycles {
    /// Whole microseconds, rounded up: a wait must not end early.
    pub const fn to_micros_up(self) -> Micros {
        Micros(self.0.div_ceil(CYCLES_PER_MICRO))
    }
    /// Whole microseconds, rounded down.
    pub const fn to_micros_down(self) -> Micros {
        Micros(self.0 / CYCLES_PER_MICRO)
    }
}

impl Steps {
    /// The sum, if it is a position at all.
    pub const fn offset(self, by: i32) -> Option<Self> {
        match self.0.checked_add(by) {
            Some(sum) => Some(Steps(sum)),
            None => None,
        }
    }
}

/// Steps per millimetre as a ratio, e.g. 2048/5 for 409.6: no rounding enters a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StepsPerMm {
    /// Steps in `denominator` millimetres.
    pub numerator: u32,
    /// Millimetres, at least 1.
    pub denominator: u32,
}

impl StepsPerMm {
    /// A whole number of steps per millimetre.
    pub const fn whole(steps: u32) -> Self {
        StepsPerMm {
            numerator: steps,
            denominator: 1,
        }
    }

    /// A ratio; neither side may be zero.
    pub const fn new(numerator: u32, denominator: u32) -> Option<Self> {
        if numerator == 0 || denominator == 0 {
            None
        } else {
            Some(StepsPerMm {
                numerator,
                denominator,
            })
        }
    }

    /// The step nearest to a position in µm (halves go up), if it fits.
    pub fn nearest_step(self, micrometres: i64) -> Option<Steps> {
        let denominator = i128::from(self.denominator) * 1000;
        if denominator == 0 {
            return None;
        }
        let twice = 2 * i128::from(micrometres) * i128::from(self.numerator);
        let steps = (twice + denominator).div_euclid(2 * denominator);
        i32::try_from(steps).ok().map(Steps)
    }

    /// A length, speed or acceleration in µm as steps, rounded down (a limit must not be raised).
    pub fn steps_down(self, micrometres: u32) -> u64 {
        match u64::from(self.denominator) * 1000 {
            0 => 0,
            d => u64::from(micrometres) * u64::from(self.numerator) / d,
        }
    }

    /// As [`Self::steps_down`], rounded up.
    pub fn steps_up(self, micrometres: u32) -> u64 {
        match u64::from(self.denominator) * 1000 {
            0 => 0,
            d => (u64::from(micrometres) * u64::from(self.numerator)).div_ceil(d),
        }
    }

    /// The position of a step in mm; for people and for the host's geometry, not for planning.
    pub fn to_mm(self, steps: Steps) -> f64 {
        f64::from(steps.0) * f64::from(self.denominator) / f64::from(self.numerator)
    }

    /// Micrometres of a whole number of steps, rounded down; for limits in messages.
    pub fn to_micrometres(self, steps: i64) -> i64 {
        match i128::from(self.numerator) {
            0 => 0,
            n => {
                let um = (i128::from(steps) * i128::from(self.denominator) * 1000).div_euclid(n);
                um.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
            }
        }
    }
}

impl fmt::Display for StepsPerMm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.denominator == 1 {
            write!(f, "{} steps/mm", self.numerator)
        } else {
            write!(f, "{}/{} steps/mm", self.numerator, self.denominator)
        }
    }
}

// What crosses between board and host, and what fills the board's queues, keeps its size.
const _: () = {
    assert!(size_of::<Steps>() == 4);
    assert!(size_of::<Micrometres>() == 4);
    assert!(size_of::<Micros>() == 8);
    assert!(size_of::<Cycles>() == 8);
    assert!(size_of::<StepsPerMm>() == 8);
};

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn nearest_step_rounds_as_by_hand() {
        let r = StepsPerMm {
            numerator: 2048,
            denominator: 5,
        };
        // 2 mm = 819.2 steps, 10 mm = 4096 steps exactly, −2 mm = −819.2.
        assert_eq!(r.nearest_step(2000), Some(Steps(819)));
        assert_eq!(r.nearest_step(10_000), Some(Steps(4096)));
        assert_eq!(r.nearest_step(-2000), Some(Steps(-819)));
        // Halves go up: 0.5 step at 1 step/mm.
        assert_eq!(StepsPerMm::whole(1).nearest_step(500), Some(Steps(1)));
        assert_eq!(StepsPerMm::whole(1).nearest_step(-500), Some(Steps(0)));
        assert_eq!(
            StepsPerMm {
                numerator: 1,
                denominator: 0
            }
            .nearest_step(5),
            None
        );
        assert_eq!(StepsPerMm::whole(u32::MAX).nearest_step(i64::MAX), None);
    }

    proptest! {
        #[test]
        fn rounding_brackets(um in any::<u32>(), n in 1..u32::MAX, d in 1..u32::MAX) {
            let r = StepsPerMm { numerator: n, denominator: d };
            let exact = u128::from(um) * u128::from(n);
            let unit = u128::from(d) * 1000;
            prop_assert_eq!(u128::from(r.steps_down(um)), exact / unit);
            prop_assert!(r.steps_up(um) - r.steps_down(um) <= 1);
            prop_assert!(u128::from(r.steps_up(um)) * unit >= exact);
        }
    }
}
