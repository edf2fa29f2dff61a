//! Counts the camera's exposures against the triggers.
//!
//! Every trigger opens an account with a deadline; a rising edge of exposure-active settles the
//! oldest. An account that is not settled by its deadline is a missing exposure.

use crate::engine::ExposureEdge;
use cannula_shared::units::Micros;
use heapless::Deque;

/// More open accounts than triggers can be under way in one exposure delay.
const OPEN: usize = 32;

/// The state of the count.
#[derive(Clone, Debug, Default)]
pub struct Exposures {
    counted: bool,
    delay: Micros,
    length: Micros,
    open: Deque<(u32, Micros), OPEN>,
    /// An edge that was seen before its trigger: interrupts may overtake each other by microseconds.
    early: Option<Micros>,
    active: bool,
    /// When the exposure under way ends by the clock.
    end: Micros,
    seen: u32,
    missing: u32,
}

impl Exposures {
    /// A fresh count. Without the input (`counted` false), every exposure is taken to begin as late as
    /// it may: it ends `delay` and `length` after its trigger.
    pub fn new(counted: bool, delay: Micros, length: Micros) -> Self {
        Exposures {
            counted,
            delay,
            length,
            ..Self::default()
        }
    }

    /// A trigger has fired.
    pub fn trigger(&mut self, index: u32, time: Micros) {
        self.end = time.after(self.length);
        if !self.counted {
            self.end = self.end.after(self.delay);
            return;
        }
        if self
            .early
            .take()
            .is_some_and(|edge| time.since(edge) <= self.delay)
        {
            self.seen += 1;
            return;
        }
        let deadline = time.after(self.delay);
        if self.open.push_back((index, deadline)).is_err() {
            // Cannot be: triggers are farther apart than that. Count it rather than lose it.
            self.missing += 1;
        }
    }

    /// The exposure signal has changed.
    pub fn edge(&mut self, edge: ExposureEdge) {
        if !self.counted {
            return;
        }
        self.active = edge.active;
        if edge.active {
            self.end = edge.time.after(self.length);
            match self.open.pop_front() {
                Some(_) => self.seen += 1,
                None => self.early = Some(edge.time),
            }
        } else {
            self.end = edge.time;
        }
    }

    /// A trigger whose exposure is overdue.
    pub fn overdue(&mut self, now: Micros) -> Option<u32> {
        let &(index, deadline) = self.open.front()?;
        if now <= deadline {
            return None;
        }
        self.open.pop_front();
        self.missing += 1;
        Some(index)
    }

    /// Whether every exposure has ended or been given up.
    pub fn settled(&self, now: Micros) -> bool {
        self.open.is_empty() && !self.active && now >= self.end
    }

    /// When that will be, as far as can be said now.
    pub fn settles_at(&self) -> Micros {
        self.open
            .back()
            .map_or(self.end, |&(_, deadline)| deadline.max(self.end))
    }

    /// Whether the signal says that the camera exposes.
    pub const fn active(&self) -> bool {
        self.active
    }

    /// Exposures seen.
    pub const fn seen(&self) -> u32 {
        self.seen
    }

    /// Triggers without exposure.
    pub const fn missing(&self) -> u32 {
        self.missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn edge(time: u64, active: bool) -> ExposureEdge {
        ExposureEdge {
            time: Micros(time),
            active,
        }
    }

    #[test]
    fn counts_and_misses() {
        let mut e = Exposures::new(true, Micros(2000), Micros(5000));
        e.trigger(0, Micros(10_000));
        assert!(!e.settled(Micros(20_000)));
        e.edge(edge(10_100, true));
        assert!(!e.settled(Micros(20_000)), "still exposing");
        e.edge(edge(15_100, false));
        assert!(e.settled(Micros(15_100)));
        e.trigger(1, Micros(30_000));
        assert_eq!(e.overdue(Micros(32_000)), None);
        assert_eq!(e.overdue(Micros(32_001)), Some(1));
        assert_eq!(e.overdue(Micros(40_000)), None);
        // Seen before its trigger, by an interrupt.
        e.edge(edge(50_000, true));
        e.trigger(2, Micros(50_003));
        e.edge(edge(55_000, false));
        assert_eq!(e.overdue(Micros(90_000)), None);
        assert_eq!((e.seen(), e.missing()), (2, 1));
        // Light leaking in long before a trigger does not count for it.
        e.edge(edge(100_000, true));
        e.edge(edge(101_000, false));
        e.trigger(3, Micros(110_000));
        assert_eq!(e.overdue(Micros(113_000)), Some(3));
    }

    #[test]
    fn without_the_input_the_clock_counts() {
        let mut e = Exposures::new(false, Micros(2000), Micros(5000));
        e.trigger(0, Micros(10_000));
        e.edge(edge(11_000, true));
        assert!(!e.settled(Micros(16_999)));
        assert!(e.settled(Micros(17_000)));
        assert_eq!(
            (e.seen(), e.missing(), e.overdue(Micros(90_000))),
            (0, 0, None)
        );
    }
}
