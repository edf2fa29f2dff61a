//! What the hardware is fed with: step words, compare words and light words.
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
//! from one trigger to the next, less one. A light word is a stretch of light or of darkness:
//!
//! ```text
//! bit   0        1 = lit
//! bits  1..=6    cycles − 75, modulo 64
//! bits  7..=19   cycles − 75, in 64ths       75 to 524 362 cycles
//! ```
//!
//! The stretches follow each other without a gap. The first begins [`LIGHT_DELAY`] after the move's
//! first STEP edge; where no word follows, the machine is dark. No word can light longer than 4.2 ms.

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

/// The fewest cycles of a light word: the program's own length.
pub const MIN_LIGHT_CYCLES: u32 = 75;
/// The most cycles of a light word.
pub const MAX_LIGHT_CYCLES: u32 =
    MIN_LIGHT_CYCLES + (1 << (LIGHT_FINE_BITS + LIGHT_COARSE_BITS)) - 1;
/// Cycles from the move's first STEP edge to the beginning of the first light word, pad to pad.
pub const LIGHT_DELAY: u32 = 9;
const LIGHT_FINE_BITS: u32 = 6;
const LIGHT_COARSE_BITS: u32 = 13;

/// A stretch of light or of darkness, as the laser's machine takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LightWord(u32);

impl LightWord {
    /// `cycles` of light or of darkness; `None` if a word cannot say so.
    pub const fn new(lit: bool, cycles: u32) -> Option<Self> {
        if cycles < MIN_LIGHT_CYCLES || cycles > MAX_LIGHT_CYCLES {
            return None;
        }
        Some(LightWord((cycles - MIN_LIGHT_CYCLES) << 1 | lit as u32))
    }

    /// From the bits that the machine takes; it ignores those above the 20th.
    pub const fn from_raw(raw: u32) -> Self {
        LightWord(raw & ((1 << (1 + LIGHT_FINE_BITS + LIGHT_COARSE_BITS)) - 1))
    }

    /// The bits that the machine takes.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Whether the laser is on.
    pub const fn lit(self) -> bool {
        self.0 & 1 != 0
    }

    /// For how long.
    pub const fn cycles(self) -> u32 {
        (self.0 >> 1) + MIN_LIGHT_CYCLES
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
        assert_eq!(LightWord::new(true, 74), None);
        assert_eq!(LightWord::new(true, 75 + (1 << 19)), None);
        assert_eq!(
            LightWord::new(true, 75 + 2 + 3 * 64).map(LightWord::raw),
            Some(1 | 2 << 1 | 3 << 7)
        );
        assert_eq!(
            LightWord::new(true, MAX_LIGHT_CYCLES).map(LightWord::raw),
            Some((1 << 20) - 1)
        );
        assert_eq!(LightWord::from_raw(u32::MAX).cycles(), MAX_LIGHT_CYCLES);
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
