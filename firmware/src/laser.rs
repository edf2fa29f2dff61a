//! When a scan wants the laser on.
//!
//! *Timed*: from the lead time before each trigger to the end of its exposure. On the fly the
//! planned times of the triggers are known from the plan; the lead is kept a little longer than
//! configured, by [`GUARD`], because the CPU that switches it may be late by that much.

use crate::profile::Profile;
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Micros, Steps};

/// How much earlier than the lead time the laser is switched on: a poll that fills the rings of a
/// steep ramp takes up to 0.6 ms on the RP2040, and the one that decides may just have begun.
pub const GUARD: Micros = Micros(2_000);

/// Windows around the triggers of a pass.
#[derive(Clone, Copy, Debug)]
pub struct Windows {
    plan: TriggerPlan,
    profile: Profile,
    begin: Steps,
    lead: Micros,
    tail: Micros,
    index: u32,
    /// Opening and closing of window `index`, since the start of the pass.
    current: Option<(Micros, Micros)>,
    next: Option<(Micros, Micros)>,
}

impl Windows {
    /// Windows from `lead` before each trigger to `tail` after it.
    pub fn new(
        plan: TriggerPlan,
        profile: Profile,
        begin: Steps,
        lead: Micros,
        tail: Micros,
    ) -> Self {
        let mut windows = Windows {
            plan,
            profile,
            begin,
            lead,
            tail,
            index: 0,
            current: None,
            next: None,
        };
        windows.current = windows.window(0);
        windows.next = windows.window(1);
        windows
    }

    fn window(&self, index: u32) -> Option<(Micros, Micros)> {
        let edge = i64::from(self.plan.position(index)?.0) - i64::from(self.begin.0);
        let at = self
            .profile
            .time(u32::try_from(edge).ok()?)
            .to_micros_down();
        let open = at.since(self.lead).since(GUARD);
        Some((open, at.after(self.tail).after(Micros(1))))
    }

    /// The trigger whose window is open or comes next.
    pub const fn index(&self) -> u32 {
        self.index
    }

    /// The exposure of the current window's trigger has ended: no need to wait for its close.
    pub fn close_current(&mut self) {
        self.current = self.next;
        self.index += 1;
        self.next = self.window(self.index + 1);
    }

    /// Until when the laser is to be on, if it is to be on `since_start` into the pass.
    pub fn wanted(&mut self, since_start: Micros) -> Option<Micros> {
        while let Some((_, close)) = self.current
            && since_start >= close
        {
            self.close_current();
        }
        let (open, close) = self.current?;
        if since_start < open {
            return None;
        }
        // Where windows touch, the next one's end counts.
        match self.next {
            Some((open, later)) if since_start >= open => Some(later),
            _ => Some(close),
        }
    }

    /// When the answer changes next, since the start.
    pub fn changes_at(&self, since_start: Micros) -> Option<Micros> {
        let (open, close) = self.current?;
        if since_start < open {
            return Some(open);
        }
        Some(self.next.map_or(close, |(open, _)| {
            if open > since_start {
                open.min(close)
            } else {
                close
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ramp::Ramp;
    use cannula_shared::units::StepsPerMm;
    use proptest::prelude::*;

    proptest! {
        /// Against the definition: on if any trigger's window holds now.
        #[test]
        fn windows_are_the_union(lead in 0u64..30_000, tail in 1u64..30_000, jumps in proptest::collection::vec(1u64..20_000, 1..300)) {
            let plan = TriggerPlan::new(StepsPerMm::whole(800), 0, 1000, 20).unwrap();
            let begin = Steps(-400);
            let profile = Profile::new(Ramp::new(160_000), 16_000, 2500);
            let mut windows = Windows::new(plan, profile, begin, Micros(lead), Micros(tail));
            let all: std::vec::Vec<_> = plan.positions().map(|p| {
                let at = profile.time((p.0 - begin.0) as u32).0 / 125;
                (at.saturating_sub(lead + GUARD.0), at + tail + 1)
            }).collect();
            let mut now = 0;
            for jump in jumps {
                let on = all.iter().any(|&(open, close)| (open..close).contains(&now));
                let wanted = windows.wanted(Micros(now));
                prop_assert_eq!(wanted.is_some(), on, "at {}", now);
                if let Some(change) = windows.changes_at(Micros(now)) {
                    prop_assert!(change.0 > now);
                    // Nothing changes before that.
                    prop_assert_eq!(all.iter().any(|&(open, close)| (open..close).contains(&(change.0 - 1))), on);
                }
                if let Some(until) = wanted {
                    prop_assert!(all.iter().any(|&(_, close)| close == until.0));
                }
                now += jump;
            }
        }
    }
    extern crate std;
}
