//! On which step trigger k stands.
//!
//! Trigger k belongs at x_k = start + k · spacing (µm), and fires on the step nearest to it:
//!
//! ```text
//! p_k = ⌊ (2 · x_k · N + 1000 · D) / (2 · 1000 · D) ⌋     with N/D steps per mm
//! ```
//!
//! computed from the absolute integers each time, never by adding up: the error is at most half
//! a step for every k. What the hardware counts is the difference of two such positions.

use crate::units::{Steps, StepsPerMm};

/// Evenly spaced triggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriggerPlan {
    steps_per_mm: StepsPerMm,
    start_um: i32,
    spacing_um: u32,
    count: u32,
}

/// Why there is no such plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanError {
    /// A scan of no triggers, or of more than can be counted.
    Count {
        /// What was asked for.
        count: u32,
        /// The most that can be.
        max: u32,
    },
    /// Two triggers would fall on the same step.
    SpacingTooFine {
        /// What was asked for, µm.
        spacing_um: u32,
        /// The least that leaves a step between triggers, µm.
        min_um: u32,
    },
    /// The ratio of steps per mm has a zero in it, or the last trigger's step is no 32-bit number.
    Range,
}

/// The most triggers in one scan.
pub const MAX_TRIGGERS: u32 = 1 << 24;

impl TriggerPlan {
    /// `count` triggers from `start_um`, `spacing_um` apart, away from home.
    pub fn new(
        steps_per_mm: StepsPerMm,
        start_um: i32,
        spacing_um: u32,
        count: u32,
    ) -> Result<Self, PlanError> {
        if steps_per_mm.numerator == 0 || steps_per_mm.denominator == 0 {
            return Err(PlanError::Range);
        }
        if count == 0 || count > MAX_TRIGGERS {
            return Err(PlanError::Count {
                count,
                max: MAX_TRIGGERS,
            });
        }
        // At one step or more between the exact places, the rounded ones differ too.
        let min_um = (u64::from(steps_per_mm.denominator) * 1000)
            .div_ceil(u64::from(steps_per_mm.numerator));
        if count > 1 && u64::from(spacing_um) < min_um {
            return Err(PlanError::SpacingTooFine {
                spacing_um,
                min_um: u32::try_from(min_um).unwrap_or(u32::MAX),
            });
        }
        let plan = TriggerPlan {
            steps_per_mm,
            start_um,
            spacing_um,
            count,
        };
        match (plan.nearest(0), plan.nearest(count - 1)) {
            (Some(_), Some(_)) => Ok(plan),
            _ => Err(PlanError::Range),
        }
    }

    fn nearest(&self, index: u32) -> Option<Steps> {
        let um = i64::from(self.start_um) + i64::from(index) * i64::from(self.spacing_um);
        self.steps_per_mm.nearest_step(um)
    }

    /// How many triggers there are.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// The step of trigger `index`, counted from zero; `None` past the last.
    pub fn position(&self, index: u32) -> Option<Steps> {
        if index < self.count {
            self.nearest(index)
        } else {
            None
        }
    }

    /// The step of the first trigger.
    pub fn first(&self) -> Steps {
        self.nearest(0).unwrap_or_default()
    }

    /// The step of the last trigger.
    pub fn last(&self) -> Steps {
        self.nearest(self.count.saturating_sub(1))
            .unwrap_or_default()
    }

    /// The exact place of trigger `index` in mm, from home.
    pub fn place_mm(&self, index: u32) -> f64 {
        (i64::from(self.start_um) + i64::from(index) * i64::from(self.spacing_um)) as f64 / 1000.0
    }

    /// Whether `position` is the nearest step for trigger `index`: |p·1000·D − x·N| ≤ 500·D. Another
    /// way round than [`Self::position`], to check it by.
    pub fn holds(&self, index: u32, position: Steps) -> bool {
        let unit = i128::from(self.steps_per_mm.denominator) * 1000;
        let um = i128::from(self.start_um) + i128::from(index) * i128::from(self.spacing_um);
        let error = i128::from(position.0) * unit - um * i128::from(self.steps_per_mm.numerator);
        index < self.count && 2 * error.abs() <= unit
    }

    /// All steps in order.
    pub fn positions(&self) -> impl Iterator<Item = Steps> + '_ {
        (0..self.count).filter_map(|k| self.nearest(k))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// |p − x·N/(1000·D)| ≤ ½, as integers.
    fn within_half(p: Steps, um: i64, r: StepsPerMm) -> bool {
        let unit = i128::from(r.denominator) * 1000;
        let error = i128::from(p.0) * unit - i128::from(um) * i128::from(r.numerator);
        2 * error.abs() <= unit
    }

    #[test]
    fn the_papers_spacings() {
        for (r, spacing, expected) in [
            (StepsPerMm::whole(800), 2000, [0, 1600, 3200, 4800]),
            (
                StepsPerMm {
                    numerator: 2048,
                    denominator: 5,
                },
                2000,
                [0, 819, 1638, 2458],
            ),
            (
                StepsPerMm {
                    numerator: 2032,
                    denominator: 5,
                },
                5000,
                [0, 2032, 4064, 6096],
            ),
            (
                StepsPerMm {
                    numerator: 2032,
                    denominator: 5,
                },
                2000,
                [0, 813, 1626, 2438],
            ),
        ] {
            let plan = TriggerPlan::new(r, 0, spacing, 4).unwrap();
            assert!(plan.positions().map(|s| s.0).eq(expected), "{r} {spacing}");
        }
    }

    #[test]
    fn no_drift_over_a_million_triggers() {
        let r = StepsPerMm {
            numerator: 2048,
            denominator: 5,
        };
        let plan = TriggerPlan::new(r, -350, 1003, 1_000_000).unwrap();
        let mut before = None;
        let mut n = 0u32;
        for (k, p) in plan.positions().enumerate() {
            assert!(within_half(p, -350 + 1003 * k as i64, r), "trigger {k}");
            assert!(before.is_none_or(|b| p > b));
            before = Some(p);
            n += 1;
        }
        assert_eq!(n, 1_000_000);
    }

    #[test]
    fn what_cannot_be_is_refused_with_the_limit() {
        let r = StepsPerMm::whole(80);
        assert_eq!(
            TriggerPlan::new(r, 0, 2000, 0),
            Err(PlanError::Count {
                count: 0,
                max: MAX_TRIGGERS
            })
        );
        assert_eq!(
            TriggerPlan::new(r, 0, 12, 2),
            Err(PlanError::SpacingTooFine {
                spacing_um: 12,
                min_um: 13
            })
        );
        assert_eq!(
            TriggerPlan::new(r, 0, u32::MAX, 1 << 20),
            Err(PlanError::Range)
        );
        assert!(TriggerPlan::new(r, 0, 0, 1).is_ok());
    }

    proptest! {
        #[test]
        fn every_trigger_is_within_half_a_step_and_in_order(
            n in 1u32.., d in 1u32.., start in any::<i32>(), spacing in 1u32.., count in 1..MAX_TRIGGERS, probe in any::<prop::sample::Index>()
        ) {
            let r = StepsPerMm { numerator: n, denominator: d };
            if let Ok(plan) = TriggerPlan::new(r, start, spacing, count) {
                let k = probe.index(count as usize) as u32;
                for k in [0, k, count - 1] {
                    let p = plan.position(k).unwrap();
                    prop_assert!(plan.holds(k, p) && !plan.holds(k, Steps(p.0 - 2)) && !plan.holds(count, p));
                    prop_assert!(within_half(p, i64::from(start) + i64::from(k) * i64::from(spacing), r));
                    if k > 0 {
                        prop_assert!(plan.position(k - 1).unwrap() < p);
                    }
                }
                prop_assert_eq!(plan.position(count), None);
            }
        }

        #[test]
        fn realistic_plans_always_stand(n in 1_000u32..10_000, d in 1u32..10, spacing in 100u32..10_000, count in 1u32..5000) {
            let r = StepsPerMm { numerator: n * d + 1, denominator: d };
            let plan = TriggerPlan::new(r, 0, spacing, count).unwrap();
            prop_assert_eq!(plan.positions().count() as u32, count);
        }
    }
}
