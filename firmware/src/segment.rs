//! The segment compiler: a profile as step words, one at a time.
//!
//! A scan of 300 mm is some 200 000 edges; they are never stored. Runs of equal intervals become
//! one word, no longer than the step machine's field and [`MAX_WORD_CYCLES`].

use crate::profile::Profile;
use crate::ramp::Cursor;
use crate::words::{MAX_WORD_CYCLES, MAX_WORD_STEPS, StepWord};
use cannula_shared::units::Cycles;

/// [`MAX_WORD_CYCLES`], which is far below 2^32.
const LONGEST: u32 = MAX_WORD_CYCLES.0 as u32;

/// Streams the step words of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segments {
    profile: Profile,
    cursor: Cursor,
    /// The interval of the edge after the last one given out, where a ramp has already computed it.
    ahead: Option<u32>,
    steps: u32,
    time: u64,
}

impl Segments {
    /// The words of `profile` from its start.
    pub fn new(profile: Profile) -> Self {
        Self::from_step(profile, 0)
    }

    fn from_step(profile: Profile, k: u32) -> Self {
        let (n, r) = (profile.steps(), profile.ramp_steps());
        let on_ramp = if k < r {
            k
        } else if k > n - r {
            n.saturating_sub(k)
        } else {
            r
        };
        Segments {
            profile,
            cursor: profile.ramp().at(on_ramp),
            ahead: None,
            steps: k,
            time: profile.time(k).0,
        }
    }

    /// The profile that is compiled.
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Steps given out so far.
    pub const fn steps(&self) -> u32 {
        self.steps
    }

    /// When the last edge given out comes.
    pub const fn time(&self) -> Cycles {
        Cycles(self.time)
    }

    /// Slows down from here on; what was given out stays.
    pub fn stop(&mut self) {
        let profile = self.profile.stopping_after(self.steps);
        if profile != self.profile {
            *self = Self::from_step(profile, self.steps);
        }
    }

    fn interval(&mut self) -> u32 {
        if let Some(interval) = self.ahead.take() {
            return interval;
        }
        // Edge `steps + 1`; a cursor that arrives at the top turns round by itself.
        if self.steps < self.profile.ramp_steps() {
            self.cursor.up()
        } else {
            self.cursor.down()
        }
    }
}

impl Iterator for Segments {
    type Item = StepWord;

    fn next(&mut self) -> Option<StepWord> {
        let (n, r) = (self.profile.steps(), self.profile.ramp_steps());
        if self.steps >= n {
            return None;
        }
        let (interval, count, lasts) = if self.steps >= r && self.steps < n - r {
            let interval = self.profile.cruise_interval();
            let longest = LONGEST / interval;
            let count = longest.clamp(1, MAX_WORD_STEPS).min(n - r - self.steps);
            (interval, count, u64::from(count) * u64::from(interval))
        } else {
            let end = if self.steps < r { r } else { n };
            let interval = self.interval();
            let mut count = 1u32;
            // Sums instead of products: the CPU has no long multiplication.
            let mut total = interval;
            let mut lasts = interval;
            while self.steps + count < end {
                // The cursor stands on the edge `steps + count`.
                let next = if end == r {
                    self.cursor.up()
                } else {
                    self.cursor.down()
                };
                total = total.saturating_add(next);
                if next != interval || count == MAX_WORD_STEPS || total > LONGEST {
                    self.ahead = Some(next);
                    break;
                }
                count += 1;
                lasts = total;
            }
            (interval, count, u64::from(lasts))
        };
        self.steps += count;
        self.time += lasts;
        StepWord::new(count, interval)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::ramp::Ramp;
    use cannula_shared::config::{MAX_ACCELERATION, MAX_STEP_INTERVAL, MIN_ACCELERATION};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn edges(words: impl Iterator<Item = StepWord>) -> Vec<u64> {
        let mut t = 0;
        let mut out = Vec::new();
        for w in words {
            assert!(w.steps() == 1 || w.cycles() <= MAX_WORD_CYCLES);
            for _ in 0..w.steps() {
                t += u64::from(w.interval());
                out.push(t);
            }
        }
        out
    }

    proptest! {
        #[test]
        fn words_say_what_the_profile_says(
            a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 0u32..20_000, interval in 250u32..200_000
        ) {
            let p = Profile::new(Ramp::new(a), n, interval);
            let got = edges(Segments::new(p));
            prop_assert_eq!(got.len() as u32, n);
            for (k, t) in got.iter().enumerate() {
                prop_assert_eq!(*t, p.time(k as u32 + 1).0, "edge {} of {}", k + 1, n);
            }
        }

        #[test]
        fn slow_speeds_and_single_steps(a in MIN_ACCELERATION..20_000, n in 0u32..50, interval in 100_000..=MAX_STEP_INTERVAL) {
            let p = Profile::new(Ramp::new(a), n, interval);
            let got = edges(Segments::new(p));
            prop_assert!(got.iter().enumerate().all(|(k, t)| *t == p.time(k as u32 + 1).0));
            prop_assert_eq!(got.len() as u32, n);
        }

        #[test]
        fn a_stop_anywhere_follows_the_stopping_profile(
            a in MIN_ACCELERATION..=MAX_ACCELERATION, n in 1u32..5000, interval in 250u32..50_000, words in 0usize..200
        ) {
            let p = Profile::new(Ramp::new(a), n, interval);
            let mut s = Segments::new(p);
            let mut given: Vec<StepWord> = s.by_ref().take(words).collect();
            let k = s.steps();
            s.stop();
            given.extend(s);
            let expected = p.stopping_after(k);
            let got = edges(given.into_iter());
            prop_assert_eq!(got.len() as u32, expected.steps());
            prop_assert!(got.iter().enumerate().all(|(j, t)| *t == expected.time(j as u32 + 1).0));
        }
    }

    #[test]
    fn bookkeeping_follows_the_words() {
        let p = Profile::new(Ramp::new(1_000_000), 5000, 1250);
        let mut s = Segments::new(p);
        let (mut steps, mut time) = (0, 0);
        while let Some(w) = s.next() {
            steps += w.steps();
            time += w.cycles().0;
            assert_eq!((s.steps(), s.time().0), (steps, time));
        }
        assert_eq!((steps, time), (5000, p.duration().0));
    }
}
