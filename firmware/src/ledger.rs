//! Events, kept until the host has acknowledged them. Bounded: places are reserved before a
//! trigger is armed, so that one that has fired always finds room. When no place is left, nothing
//! more is armed and the scan stops by a fault; no event is ever dropped.

use cannula_shared::message::Event;
use heapless::Deque;

/// How many events are kept.
pub const CAPACITY: usize = 256;
/// Of them, places that triggers may not take: for faults and the ends of jobs.
const CLOSING: usize = 16;

/// The queue of unacknowledged events.
#[derive(Debug, Default)]
pub struct Ledger {
    events: Deque<Event, CAPACITY>,
    /// Events acknowledged since boot; the front has this counter plus one.
    acknowledged: u32,
    reserved: usize,
}

impl Ledger {
    /// An empty ledger; the first event will have the counter 1.
    pub const fn new() -> Self {
        Ledger {
            events: Deque::new(),
            acknowledged: 0,
            reserved: 0,
        }
    }

    /// How many events wait.
    pub fn pending(&self) -> usize {
        self.events.len()
    }

    /// Counter of the oldest event, or of the next one.
    pub const fn first(&self) -> u32 {
        self.acknowledged.wrapping_add(1)
    }

    fn free(&self) -> usize {
        CAPACITY - self.events.len()
    }

    /// Whether a job may begin: its closing events have room.
    pub fn has_room(&self) -> bool {
        self.free() >= self.reserved + CLOSING
    }

    /// Takes `places` for events to come, if there are so many.
    pub fn reserve(&mut self, places: usize) -> bool {
        let fits = self.free() >= self.reserved + places + CLOSING;
        if fits {
            self.reserved += places;
        }
        fits
    }

    /// Gives places back that were not needed.
    pub fn release(&mut self, places: usize) {
        self.reserved = self.reserved.saturating_sub(places);
    }

    /// Gives all places back.
    pub fn release_all(&mut self) {
        self.reserved = 0;
    }

    /// Adds an event. False if it found no place, which reservation rules out for triggers.
    #[must_use]
    pub fn push(&mut self, event: Event) -> bool {
        self.events.push_back(event).is_ok()
    }

    /// The host has everything up to `counter`. How many events could go.
    pub fn acknowledge(&mut self, counter: u32) -> usize {
        let gone = counter.wrapping_sub(self.acknowledged) as usize;
        // Older than what is known, or of a future that has not been: not ours.
        if gone > self.events.len() {
            return 0;
        }
        for _ in 0..gone {
            self.events.pop_front();
        }
        self.acknowledged = counter;
        gone
    }

    /// The `n`th waiting event and its counter.
    pub fn get(&self, n: usize) -> Option<(u32, &Event)> {
        let event = self.events.iter().nth(n)?;
        let n = u32::try_from(n).ok()?;
        Some((self.first().wrapping_add(n), event))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reserved_places_are_there_when_needed() {
        let mut l = Ledger::new();
        let mut armed = 0;
        while l.reserve(1) {
            armed += 1;
        }
        assert_eq!(armed, CAPACITY - CLOSING);
        for _ in 0..armed {
            l.release(1);
            assert!(l.push(Event::Rearmed));
        }
        assert!(!l.reserve(1));
        for _ in 0..CLOSING {
            assert!(l.push(Event::Rearmed));
        }
        assert!(!l.push(Event::Rearmed));
        assert_eq!(l.acknowledge(10), 10);
        assert!(!l.has_room());
        assert_eq!(l.acknowledge(CLOSING as u32), 6);
        assert!(l.has_room() && !l.reserve(1));
    }

    proptest! {
        #[test]
        fn counters_stay_with_their_events(ops in proptest::collection::vec((any::<bool>(), any::<u32>()), 0..600)) {
            let mut l = Ledger::new();
            let (mut pushed, mut acknowledged) = (0u32, 0u32);
            for (push, n) in ops {
                if push {
                    if l.push(Event::Homed { job: pushed + 1, apart: 0 }) {
                        pushed += 1;
                    } else {
                        prop_assert_eq!(l.pending(), CAPACITY);
                    }
                } else {
                    // Anything from a stale acknowledgement to one from the future.
                    let claim = n % (pushed + 5);
                    l.acknowledge(claim);
                    if claim <= pushed {
                        acknowledged = acknowledged.max(claim);
                    }
                }
                prop_assert_eq!(l.first(), acknowledged + 1);
                prop_assert_eq!(l.pending() as u32, pushed - acknowledged);
                if let Some((counter, event)) = l.get(0) {
                    prop_assert_eq!(*event, Event::Homed { job: counter, apart: 0 });
                }
            }
        }
    }
}
