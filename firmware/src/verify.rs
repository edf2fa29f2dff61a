//! The compiled words, decoded again and held against the plan before anything moves.
//!
//! The decoder below knows the word formats and the definition of the plan, not the compiler:
//! edge times of a ramp are checked by t² ≤ n·C < (t+1)², cruise by its interval, trigger steps
//! by |p·1000·D − x·N| ≤ 500·D. It works in slices, so that the link stays alive meanwhile.

use crate::profile::Profile;
use crate::segment::Segments;
use crate::triggers::Gaps;
use crate::words::{CompareWord, StepWord};
use cannula_shared::error::CheckError;
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Cycles, Steps};

/// What a checked pass does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// Steps.
    pub steps: u32,
    /// Triggers.
    pub triggers: u32,
    /// From the start to the first trigger.
    pub first_trigger: Cycles,
    /// The shortest time between two triggers, and the later of the two.
    pub closest: Option<(Cycles, u32)>,
    /// From the start to the last edge.
    pub duration: Cycles,
}

/// A check under way.
#[derive(Clone, Copy, Debug)]
pub struct Check {
    profile: Profile,
    words: Segments,
    /// Edges decoded, and when the last came.
    step: u32,
    time: u64,
    /// The compare side: where the pass begins, the plan, its words, the next trigger's step by the words.
    triggers: Option<TriggerSide>,
    last_trigger: Option<u64>,
    done: Checked,
}

#[derive(Clone, Copy, Debug)]
struct TriggerSide {
    begin: Steps,
    plan: TriggerPlan,
    gaps: Gaps,
    next: Option<u64>,
}

impl Check {
    /// A check of a move without triggers.
    pub fn of_move(profile: Profile) -> Self {
        Check {
            profile,
            words: Segments::new(profile),
            step: 0,
            time: 0,
            triggers: None,
            last_trigger: None,
            done: Checked::default(),
        }
    }

    /// A check of a pass away from home, from `begin`, with triggers on the way.
    pub fn of_pass(profile: Profile, begin: Steps, plan: TriggerPlan) -> Self {
        let mut gaps = Gaps::new(plan, begin);
        let next = gaps.next().map(CompareWord::gap);
        Check {
            triggers: Some(TriggerSide {
                begin,
                plan,
                gaps,
                next,
            }),
            ..Self::of_move(profile)
        }
    }

    /// Decodes and checks up to about `budget` edges more; the result once all are done.
    pub fn run(&mut self, budget: u32) -> Result<Option<Checked>, CheckError> {
        let mut spent = 0;
        while spent < budget {
            let Some(word) = self.words.next() else {
                return self.close().map(Some);
            };
            // Through the bits, as the machine sees it.
            spent += self.word(StepWord::from_raw(word.raw()))? + 8;
        }
        Ok(None)
    }

    /// Checks one word; how many edges had to be looked at one by one.
    fn word(&mut self, word: StepWord) -> Result<u32, CheckError> {
        let (n, r) = (self.profile.steps(), self.profile.ramp_steps());
        let (from, to) = (self.step, self.step.saturating_add(word.steps()));
        if to > n {
            return Err(CheckError::Steps {
                planned: n,
                found: to,
            });
        }
        let interval = word.interval();
        // (Not the cruise's: where a ramp ends before its speed is reached, whole cycles let the step
        // before the middle be one cycle shorter than the middle.)
        if interval < self.profile.shortest_interval() {
            return Err(CheckError::Interval {
                step: from + 1,
                cycles: interval,
                min: self.profile.shortest_interval(),
            });
        }
        let cruise = from >= r && to <= n - r;
        if cruise {
            if interval != self.profile.cruise_interval() {
                return Err(CheckError::Time { step: from + 1 });
            }
        } else {
            for k in from + 1..=to {
                let t = self.time + u64::from(k - from) * u64::from(interval);
                let holds = if k <= r {
                    self.profile.ramp().holds(k, t)
                } else {
                    self.profile
                        .duration()
                        .0
                        .checked_sub(t)
                        .is_some_and(|left| self.profile.ramp().holds(n - k, left))
                };
                if !holds {
                    return Err(CheckError::Time { step: k });
                }
            }
        }
        self.pass_triggers(from, to, interval)?;
        self.step = to;
        self.time += word.cycles().0;
        Ok(if cruise { 0 } else { to - from })
    }

    fn pass_triggers(&mut self, from: u32, to: u32, interval: u32) -> Result<(), CheckError> {
        let Some(side) = &mut self.triggers else {
            return Ok(());
        };
        while let Some(next) = side.next.filter(|&next| next <= u64::from(to)) {
            let index = self.done.triggers;
            let found = i64::from(side.begin.0) + i64::try_from(next).unwrap_or(i64::MAX);
            let found = Steps(i32::try_from(found).unwrap_or(i32::MAX));
            if !side.plan.holds(index, found) {
                let planned = side.plan.position(index).unwrap_or_default();
                return Err(CheckError::Position {
                    index,
                    planned,
                    found,
                });
            }
            let time = self.time + next.saturating_sub(u64::from(from)) * u64::from(interval);
            match self.last_trigger {
                None => self.done.first_trigger = Cycles(time),
                Some(last) => {
                    let gap = Cycles(time.saturating_sub(last));
                    if self.done.closest.is_none_or(|(least, _)| gap < least) {
                        self.done.closest = Some((gap, index));
                    }
                }
            }
            self.last_trigger = Some(time);
            self.done.triggers += 1;
            side.next = side
                .gaps
                .next()
                .map(|w| next + CompareWord::from_raw(w.raw()).gap());
        }
        Ok(())
    }

    fn close(&self) -> Result<Checked, CheckError> {
        let planned = self.profile.steps();
        if self.step != planned {
            return Err(CheckError::Steps {
                planned,
                found: self.step,
            });
        }
        if self.time != self.profile.duration().0 {
            return Err(CheckError::Time { step: self.step });
        }
        if let Some(side) = &self.triggers
            && (self.done.triggers != side.plan.count() || side.next.is_some())
        {
            return Err(CheckError::Triggers {
                planned: side.plan.count(),
                found: self.done.triggers,
            });
        }
        Ok(Checked {
            steps: self.step,
            duration: Cycles(self.time),
            ..self.done
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ramp::Ramp;
    use cannula_shared::config::{MAX_ACCELERATION, MAX_STEP_INTERVAL, MIN_ACCELERATION};
    use cannula_shared::units::StepsPerMm;
    use proptest::prelude::*;

    proptest! {
        /// Whatever is planned holds: a check that refuses a sound move would refuse a scan for nothing.
        #[test]
        fn every_move_passes_its_own_check(
            a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 1u32..6000, interval in 250u32..MAX_STEP_INTERVAL
        ) {
            let profile = Profile::new(Ramp::new(a), n, interval);
            let done = finish(Check::of_move(profile));
            prop_assert_eq!(done.map(|d| (d.steps, d.duration)), Ok((n, profile.duration())));
        }
    }

    /// Some of these were refused once: about 5863 steps at 200 mm/s² and 800 steps/mm never reach 50 mm/s.
    #[test]
    fn a_triangle_of_uneven_cycles_holds() {
        for n in 5800..5900 {
            let profile = Profile::new(Ramp::new(160_000), n, 3125);
            assert!(finish(Check::of_move(profile)).is_ok(), "{n} steps");
        }
    }

    fn finish(mut check: Check) -> Result<Checked, CheckError> {
        loop {
            if let Some(done) = check.run(200)? {
                return Ok(done);
            }
        }
    }

    #[test]
    fn the_papers_scans_hold() {
        for r in [
            StepsPerMm::whole(800),
            StepsPerMm::whole(640),
            StepsPerMm {
                numerator: 2048,
                denominator: 5,
            },
            StepsPerMm {
                numerator: 2032,
                denominator: 5,
            },
        ] {
            for (spacing, count) in [(2000, 151), (5000, 61)] {
                let plan = TriggerPlan::new(r, 0, spacing, count).unwrap();
                let begin = Steps(-1);
                let steps = (plan.last().0 - begin.0) as u32;
                let profile = Profile::new(Ramp::new(160_000), steps, 3125);
                let done = finish(Check::of_pass(profile, begin, plan)).unwrap();
                assert_eq!((done.steps, done.triggers), (steps, count));
                assert_eq!(done.duration, profile.duration());
                assert_eq!(done.first_trigger, profile.time(1));
                // The closest are in the cruise: the narrower of the two roundings.
                let gaps = plan
                    .positions()
                    .zip(plan.positions().skip(1))
                    .map(|(a, b)| b.0 - a.0);
                let least = u64::from(gaps.min().unwrap() as u32) * 3125;
                assert_eq!(done.closest.map(|(c, _)| c.0), Some(least));
            }
        }
    }

    #[test]
    fn what_does_not_match_is_found() {
        let ramp = Ramp::new(1_000_000);
        let profile = Profile::new(ramp, 5000, 2500);
        // Words of another move, one by one: fewer steps, more steps, another speed, another ramp.
        let others = [
            Profile::new(ramp, 4999, 2500),
            Profile::new(ramp, 5001, 2500),
            Profile::new(ramp, 5000, 2501),
            Profile::new(ramp, 5000, 2499),
            Profile::new(Ramp::new(1_000_001), 5000, 2500),
            Profile::new(Ramp::new(999_999), 5000, 2500),
        ];
        for other in others {
            let mut check = Check::of_move(profile);
            check.words = Segments::new(other);
            assert!(finish(check).is_err(), "{other:?}");
        }
        assert!(finish(Check::of_move(profile)).is_ok());

        let plan = TriggerPlan::new(
            StepsPerMm {
                numerator: 2048,
                denominator: 5,
            },
            0,
            2000,
            6,
        )
        .unwrap();
        // 4096 steps from trigger 0 to 5.
        let pass = |steps| Profile::new(ramp, steps, 2500);
        assert!(finish(Check::of_pass(pass(4097), Steps(-1), plan)).is_ok());
        assert_eq!(
            finish(Check::of_pass(pass(4096), Steps(-1), plan)),
            Err(CheckError::Triggers {
                planned: 6,
                found: 5
            })
        );
        let shifted = TriggerPlan::new(
            StepsPerMm {
                numerator: 2048,
                denominator: 5,
            },
            3,
            2000,
            6,
        )
        .unwrap();
        let mut check = Check::of_pass(pass(4097), Steps(-1), plan);
        if let Some(side) = &mut check.triggers {
            side.plan = shifted;
        }
        assert_eq!(
            finish(check),
            Err(CheckError::Position {
                index: 0,
                planned: Steps(1),
                found: Steps(0)
            })
        );
    }
}
