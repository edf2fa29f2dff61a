//! What the hardware is fed with: step words and compare words.
//!
//! A step word is one run of equally spaced STEP edges:
//!
//! ```text
//! bits  0..=10   steps − 1              1 to 2048 steps
//! bits 11..=31   interval − 39 cycles   39 to 2 097 190 cycles
//! ```
//!
//! Each edge comes exactly `interval` cycles after the one before it, across words too; the first
//! edge of a move comes `interval` after the start. A compare word is the number of STEP edges
//! from one trigger to the next, less one.

use cannula_shared::config::{MAX_STEP_INTERVAL, MIN_STEP_INTERVAL};
use cannula_shared::units::Cycles;

const STEPS_BITS: u32 = 11;
const STEPS_MASK: u32 = (1 << STEPS_BITS) - 1;

/// The most steps that one word can hold.
pub const MAX_WORD_STEPS: u32 = 1 << STEPS_BITS;
/// A word lasts no longer than this unless it is a single step: it bounds what runs on when the
/// CPU is dead. 4 ms.
pub const MAX_WORD_CYCLES: Cycles = Cycles(500_000);

/// A run of equally spaced STEP edges, as the step machine takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StepWord(u32);

impl StepWord {
    /// `steps` edges, each `interval` cycles after the one before; `None` if a word cannot say so.
    pub const fn new(steps: u32, interval: u32) -> Option<Self> {
        if steps == 0
            || steps > MAX_WORD_STEPS
            || interval < MIN_STEP_INTERVAL
            || interval > MAX_STEP_INTERVAL
        {
            return None;
        }
        Some(StepWord(
            (interval - MIN_STEP_INTERVAL) << STEPS_BITS | (steps - 1),
        ))
    }

    /// From the bits that the machine takes; every value is a word.
    pub const fn from_raw(raw: u32) -> Self {
        StepWord(raw)
    }

    /// The bits that the machine takes.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// How many edges.
    pub const fn steps(self) -> u32 {
        (self.0 & STEPS_MASK) + 1
    }

    /// Cycles from edge to edge.
    pub const fn interval(self) -> u32 {
        (self.0 >> STEPS_BITS) + MIN_STEP_INTERVAL
    }

    /// How long it lasts.
    pub const fn cycles(self) -> Cycles {
        Cycles(self.steps() as u64 * self.interval() as u64)
    }
}

/// The number of STEP edges to the next trigger, as the compare machine takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CompareWord(u32);

impl CompareWord {
    /// The trigger after next stands `gap` edges on; `None` for a gap of zero.
    pub const fn new(gap: u32) -> Option<Self> {
        match gap.checked_sub(1) {
            Some(word) => Some(CompareWord(word)),
            None => None,
        }
    }

    /// From the bits that the machine takes.
    pub const fn from_raw(raw: u32) -> Self {
        CompareWord(raw)
    }

    /// The bits that the machine takes.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Edges from the trigger before (or the start).
    pub const fn gap(self) -> u64 {
        self.0 as u64 + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn limits() {
        assert_eq!(StepWord::new(0, 100), None);
        assert_eq!(StepWord::new(2049, 100), None);
        assert_eq!(StepWord::new(1, 38), None);
        assert_eq!(StepWord::new(1, 2_097_191), None);
        assert_eq!(StepWord::new(1, 39).map(StepWord::raw), Some(0));
        assert_eq!(
            StepWord::new(2048, 2_097_190).map(StepWord::raw),
            Some(u32::MAX)
        );
        assert_eq!(CompareWord::new(0), None);
    }

    proptest! {
        #[test]
        fn round_trip(steps in 1..=MAX_WORD_STEPS, interval in MIN_STEP_INTERVAL..=MAX_STEP_INTERVAL) {
            let word = StepWord::new(steps, interval).unwrap();
            prop_assert_eq!((word.steps(), word.interval()), (steps, interval));
            prop_assert_eq!(word.cycles().0, u64::from(steps) * u64::from(interval));
            prop_assert_eq!(StepWord::from_raw(word.raw()), word);
        }
    }
}
