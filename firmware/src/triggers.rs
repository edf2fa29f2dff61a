//! From a trigger plan to compare words: differences of absolute positions.

use crate::words::CompareWord;
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::Steps;

/// Streams the compare words of a plan for a pass that begins at a given step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gaps {
    plan: TriggerPlan,
    last: Steps,
    index: u32,
}

impl Gaps {
    /// The words of `plan` for a pass away from home that begins on step `begin`, below trigger 0.
    pub const fn new(plan: TriggerPlan, begin: Steps) -> Self {
        Gaps {
            plan,
            last: begin,
            index: 0,
        }
    }

    /// How many words were given out: the index of the next trigger.
    pub const fn index(&self) -> u32 {
        self.index
    }

    /// The step of the next trigger.
    pub fn position(&self) -> Option<Steps> {
        self.plan.position(self.index)
    }
}

impl Iterator for Gaps {
    type Item = CompareWord;

    fn next(&mut self) -> Option<CompareWord> {
        let position = self.plan.position(self.index)?;
        let gap = u32::try_from(i64::from(position.0) - i64::from(self.last.0)).ok()?;
        let word = CompareWord::new(gap)?;
        self.last = position;
        self.index += 1;
        Some(word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cannula_shared::units::StepsPerMm;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn words_add_up_to_the_positions(n in 100u32..1_000_000, d in 1u32..20, start in -100_000i32..100_000, spacing in 50u32..10_000, before in 1u32..100_000) {
            let r = StepsPerMm { numerator: n, denominator: d };
            if let Ok(plan) = TriggerPlan::new(r, start, spacing, 300) {
                let begin = Steps(plan.first().0 - before as i32);
                let mut at = i64::from(begin.0);
                let mut count = 0;
                for (k, word) in Gaps::new(plan, begin).enumerate() {
                    at += word.gap() as i64;
                    prop_assert_eq!(Some(Steps(at as i32)), plan.position(k as u32));
                    count += 1;
                }
                prop_assert_eq!(count, 300);
            }
        }
    }

    #[test]
    fn a_trigger_where_the_pass_begins_cannot_be() {
        let plan = TriggerPlan::new(StepsPerMm::whole(800), 0, 2000, 3).unwrap();
        assert_eq!(Gaps::new(plan, Steps(0)).count(), 0);
        assert_eq!(Gaps::new(plan, Steps(1)).count(), 0);
    }
}
