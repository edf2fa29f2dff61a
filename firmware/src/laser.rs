//! The light of a scan on the fly: from the lead time before each trigger to the end of its exposure.
//!
//! The triggers' times are known from the plan to the cycle, so the laser's machine plays stretches
//! of light and darkness that were computed ahead, by the clock that also times the steps; the CPU
//! only keeps it fed, as it does the step machine. What is fed never reaches farther than the
//! look-ahead: if the CPU dies, the machine runs dry, and dry is dark.
//!
//! ```text
//! trigger k     time(edge k) − lead ─────────► time(edge k) + tail
//! in all        the union of these, from the first STEP edge on
//! ```

use crate::profile::Profile;
use crate::words::{LIGHT_DELAY, LightWord, MAX_LIGHT_CYCLES, MIN_LIGHT_CYCLES};
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Cycles, Micros, Steps};

/// How long after the move's first STEP edge the laser can be lit at the earliest.
pub const EARLIEST: Cycles = Cycles(LIGHT_DELAY as u64 + MIN_LIGHT_CYCLES as u64);

/// The light words of a pass, streamed.
#[derive(Clone, Copy, Debug)]
pub struct Lights {
    plan: TriggerPlan,
    profile: Profile,
    begin: Steps,
    lead: u64,
    tail: u64,
    /// The trigger after the last one that is in `current`.
    next: u32,
    /// Opening and closing of the light under way or to come, cycles since the start.
    current: Option<(u64, u64)>,
    /// Up to where words have been given out, cycles since the start.
    at: u64,
}

impl Lights {
    /// Light from `lead` before each trigger of a pass to `tail` after it.
    pub fn new(
        plan: TriggerPlan,
        profile: Profile,
        begin: Steps,
        lead: Micros,
        tail: Micros,
    ) -> Self {
        let mut lights = Lights {
            plan,
            profile,
            begin,
            lead: lead.to_cycles().0,
            tail: tail.to_cycles().0,
            next: 0,
            current: None,
            at: profile.time(1).0 + u64::from(LIGHT_DELAY),
        };
        lights.open_next();
        lights
    }

    /// Up to when words have been given out, since the start.
    pub const fn time(&self) -> Cycles {
        Cycles(self.at)
    }

    /// Whether darkness is all that is left.
    pub const fn ended(&self) -> bool {
        self.current.is_none()
    }

    /// The window of trigger `index`.
    fn window(&self, index: u32) -> Option<(u64, u64)> {
        let edge = i64::from(self.plan.position(index)?.0) - i64::from(self.begin.0);
        let at = self.profile.time(u32::try_from(edge).ok()?).0;
        Some((at.saturating_sub(self.lead), at + self.tail))
    }

    fn open_next(&mut self) {
        self.current = self.window(self.next);
        self.next = self.next.saturating_add(1);
    }

    /// Joins windows that touch the one under way, as far as the next word can reach.
    fn extend(&mut self) {
        while let Some((open, close)) = self.current
            && close < self.at + 2 * u64::from(MAX_LIGHT_CYCLES)
            && let Some((next_open, next_close)) = self.window(self.next)
            && next_open < close + 2 * u64::from(MIN_LIGHT_CYCLES)
        {
            self.current = Some((open, close.max(next_close)));
            self.next = self.next.saturating_add(1);
        }
    }

    /// A word of at most `cycles`, leaving nothing that is too short for one.
    fn word(&mut self, lit: bool, cycles: u64) -> Option<LightWord> {
        let (most, least) = (u64::from(MAX_LIGHT_CYCLES), u64::from(MIN_LIGHT_CYCLES));
        let length = if cycles <= most {
            cycles.max(least)
        } else {
            most.min(cycles - least)
        };
        self.at += length;
        LightWord::new(lit, u32::try_from(length).ok()?)
    }
}

impl Iterator for Lights {
    type Item = LightWord;

    fn next(&mut self) -> Option<LightWord> {
        let (open, _) = self.current?;
        // (Within a cycle word's length of the opening: it is open.)
        if self.at < open {
            return self.word(false, open - self.at);
        }
        self.extend();
        let (_, close) = self.current?;
        let word = self.word(true, close.saturating_sub(self.at));
        if self.at >= close {
            self.open_next();
        }
        word
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::ramp::Ramp;
    use cannula_shared::units::StepsPerMm;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// The stretches of light that the words make, in cycles since the start.
    fn played(lights: Lights) -> Vec<(u64, u64)> {
        let mut at = lights.time().0;
        let mut lit: Vec<(u64, u64)> = Vec::new();
        for word in lights {
            let end = at + u64::from(word.cycles());
            if word.lit() {
                match lit.last_mut() {
                    Some(last) if last.1 == at => last.1 = end,
                    _ => lit.push((at, end)),
                }
            }
            at = end;
        }
        lit
    }

    proptest! {
        /// Against the definition: the union of all windows, to the cycle, and nothing else.
        #[test]
        fn the_words_play_the_union_of_the_windows(
            lead in 0u64..15_000, tail in 1u64..40_000, speed in 2500u32..60_000, spacing in 300u32..3000
        ) {
            let plan = TriggerPlan::new(StepsPerMm::whole(800), 0, spacing, 20).unwrap();
            let begin = Steps(-800);
            let profile = Profile::new(Ramp::new(160_000), 60_000, speed);
            let mut expected: Vec<(u64, u64)> = Vec::new();
            for p in plan.positions() {
                let at = profile.time((p.0 - begin.0) as u32).0;
                let (open, close) = (at - lead * 125, at + tail * 125);
                match expected.last_mut() {
                    // Darkness that no word can say is lit.
                    Some(last) if open < last.1 + 150 => last.1 = close,
                    _ => expected.push((open, close)),
                }
            }
            prop_assert_eq!(played(Lights::new(plan, profile, begin, Micros(lead), Micros(tail))), expected);
        }
    }

    #[test]
    fn long_light_comes_in_words_that_end_by_themselves() {
        // 20 exposures of 100 ms that overlap: lit throughout, no word longer than 4.2 ms.
        let plan = TriggerPlan::new(StepsPerMm::whole(800), 0, 1000, 20).unwrap();
        let profile = Profile::new(Ramp::new(160_000), 16_800, 6250);
        let lights = Lights::new(plan, profile, Steps(-800), Micros(2_000), Micros(100_000));
        assert!(lights.clone().all(|w| w.cycles() <= MAX_LIGHT_CYCLES));
        assert!(lights.filter(|w| w.lit()).count() > 100);
        assert_eq!(played(lights).len(), 1);
    }
}
