//! Which frame was exposed after a request, where no edge of the board starts the exposures: pure
//! logic on time stamps, for cameras that expose by command or by themselves.
//!
//! Nothing ties such a camera's clock to the host's but the earliest times at which its frames can
//! have begun:
//!
//! - the n-th frame since arming cannot have begun before the n-th command (nor before arming,
//!   where the camera runs by itself);
//! - a frame that is Δ younger than another one by the camera's stamps began Δ later.
//!
//! ```text
//! b_j = max( c_j,  b_i + Δ_ij − drift · |Δ_ij| − jitter )
//! ```
//!
//! A frame may serve a request only if b_j lies after it. Every bound errs to the early side, so a
//! frame that was kept back on its way is told by its stamp, however late it arrives, and a frame
//! that cannot be told is left out.

use super::matching::{FrameStamp, MAX_DRIFT, TOLERANCE_US};
use std::collections::VecDeque;

/// What is known of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It cannot have begun before this, µs of the host's clock.
    NotBefore(i64),
    /// A frame that has come before, or an older one.
    Again,
    /// It contradicts what is known: nobody asked for it, or it would have begun after it came.
    /// The camera has to be armed anew.
    Contradiction,
}

/// What is known of an armed camera's frames.
#[derive(Clone, Debug)]
pub struct Requests {
    armed_us: i64,
    /// Commands whose frames have not come; `None`: the camera runs by itself.
    commands: Option<VecDeque<i64>>,
    /// The last frame's stamp.
    newest: Option<i64>,
    /// A stamp of the camera's clock and the earliest time, µs of the host's clock, that it can be.
    known: Option<(i64, f64)>,
}

impl Requests {
    /// A camera that was armed at `now_us` (host's clock, read before arming).
    pub fn armed(now_us: i64, by_command: bool) -> Self {
        Self {
            armed_us: now_us,
            commands: by_command.then(VecDeque::new),
            newest: None,
            known: None,
        }
    }

    /// The camera's clock was read: it showed `camera_us` at `host_us` (read before it) or later.
    pub fn clock(&mut self, camera_us: i64, host_us: i64) {
        self.know(camera_us, host_us as f64);
    }

    /// An exposure is about to be asked for.
    pub fn command(&mut self, now_us: i64) {
        if let Some(commands) = &mut self.commands {
            commands.push_back(now_us);
        }
    }

    /// A frame that came at `now_us`.
    pub fn frame(&mut self, stamp: &FrameStamp, now_us: i64) -> Verdict {
        if self.newest.is_some_and(|newest| stamp.time_us <= newest) {
            return Verdict::Again;
        }
        self.newest = Some(stamp.time_us);
        // A command that was lost leaves the count behind: earlier bounds, which are safe.
        let own = match &mut self.commands {
            None => Some(self.armed_us),
            Some(commands) => commands.pop_front(),
        };
        let Some(own) = own else {
            return Verdict::Contradiction;
        };
        let bound = (own as f64).max(self.by_stamp(stamp.time_us));
        if bound > now_us as f64 + TOLERANCE_US {
            return Verdict::Contradiction;
        }
        self.know(stamp.time_us, bound);
        Verdict::NotBefore(bound.floor() as i64)
    }

    fn by_stamp(&self, stamp_us: i64) -> f64 {
        self.known.map_or(f64::NEG_INFINITY, |(stamp, earliest)| {
            let apart = (stamp_us - stamp) as f64;
            earliest + apart - MAX_DRIFT * apart.abs() - TOLERANCE_US
        })
    }

    fn know(&mut self, stamp_us: i64, earliest: f64) {
        if earliest > self.by_stamp(stamp_us) {
            self.known = Some((stamp_us, earliest));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stamp(sequence: u64, time_us: i64) -> FrameStamp {
        FrameStamp {
            sequence,
            time_us,
            whole: true,
        }
    }

    /// What becomes of an exposure.
    #[derive(Clone, Copy, Debug)]
    enum Fate {
        Fine,
        NotTaken,
        Lost,
        Double,
        Begins(i64),
        Arrives(i64),
    }

    fn fate() -> impl Strategy<Value = Fate> {
        prop_oneof![
            6 => Just(Fate::Fine),
            1 => Just(Fate::NotTaken),
            1 => Just(Fate::Lost),
            1 => Just(Fate::Double),
            1 => (1_000..900_000i64).prop_map(Fate::Begins),
            2 => (1_000..900_000i64).prop_map(Fate::Arrives),
        ]
    }

    proptest! {
        /// Whatever is lost, doubled or late: no bound lies after the frame's true beginning.
        #[test]
        fn no_frame_is_said_to_have_begun_later_than_it_did(
            steps in prop::collection::vec((fate(), 5_000..600_000i64, 0..1_000i64), 1..40),
            by_command in any::<bool>(),
            offset in -1_000_000_000_000..1_000_000_000_000i64,
            drift in -2e-4..2e-4f64,
        ) {
            let armed = 1_000_000;
            let mut requests = Requests::armed(armed, by_command);
            // Begins (host's clock), arrives.
            let mut frames: Vec<(i64, i64)> = Vec::new();
            let mut commands = Vec::new();
            let mut now = armed;
            for (fate, gap, delay) in steps {
                now += gap;
                commands.push(now);
                let begins = now + delay;
                let latency = 12_000;
                match fate {
                    Fate::NotTaken | Fate::Lost => {}
                    Fate::Fine => frames.push((begins, begins + latency)),
                    Fate::Double => {
                        frames.push((begins, begins + latency));
                        frames.push((begins, begins + latency + 100));
                    }
                    Fate::Begins(late) => frames.push((begins + late, begins + late + latency)),
                    Fate::Arrives(late) => frames.push((begins, begins + latency + late)),
                }
            }
            frames.sort_by_key(|f| f.1);
            let mut next = commands.into_iter().peekable();
            for (sequence, (begins, arrives)) in (1..).zip(frames) {
                while let Some(at) = next.next_if(|at| *at <= arrives) {
                    requests.command(at);
                }
                let camera = begins + offset + ((begins - armed) as f64 * drift) as i64;
                if let Verdict::NotBefore(bound) = requests.frame(&stamp(sequence, camera), arrives) {
                    prop_assert!(bound <= begins, "{bound} {begins}");
                }
            }
        }
    }

    #[test]
    fn each_command_has_its_frame_and_the_late_one_is_told() {
        let mut r = Requests::armed(0, true);
        for k in 0..5 {
            let at = 1_000_000 + 100_000 * k;
            r.command(at);
            assert_eq!(
                r.frame(&stamp(k as u64, at + 7_000_500), at + 20_000),
                Verdict::NotBefore(at)
            );
        }
        // The frame of this command comes after the next one was given.
        r.command(2_000_000);
        r.command(2_500_000);
        assert_eq!(
            r.frame(&stamp(5, 9_000_500), 2_501_000),
            Verdict::NotBefore(2_000_000)
        );
        assert_eq!(
            r.frame(&stamp(6, 9_500_500), 2_520_000),
            Verdict::NotBefore(2_500_000)
        );
        assert_eq!(r.frame(&stamp(6, 9_500_500), 2_521_000), Verdict::Again);
        // One that nobody asked for.
        assert_eq!(
            r.frame(&stamp(7, 9_600_500), 2_700_000),
            Verdict::Contradiction
        );
    }

    #[test]
    fn a_lost_frame_leaves_the_stamps_to_tell() {
        let mut r = Requests::armed(0, true);
        r.command(1_000_000);
        assert_eq!(
            r.frame(&stamp(1, 8_000_000), 1_020_000),
            Verdict::NotBefore(1_000_000)
        );
        r.command(2_000_000); // lost
        r.command(2_500_000);
        let Verdict::NotBefore(bound) = r.frame(&stamp(3, 9_500_000), 2_520_000) else {
            panic!("a bound");
        };
        // By the count it might be the lost one's; by its stamp it is not: within drift and jitter.
        assert!((2_497_500..=2_500_000).contains(&bound), "{bound}");
    }

    #[test]
    fn a_camera_that_runs_by_itself_is_bound_by_its_arming_or_its_clock() {
        let mut r = Requests::armed(1_000_000, false);
        // The stream takes 300 ms to start: bounds are early by so much.
        assert_eq!(
            r.frame(&stamp(1, 50_000), 1_320_000),
            Verdict::NotBefore(1_000_000)
        );
        let Verdict::NotBefore(bound) = r.frame(&stamp(2, 350_000), 1_620_000) else {
            panic!("a bound");
        };
        assert!((1_298_000..=1_300_000).contains(&bound), "{bound}");
        // Its clock can be asked: the bounds are close.
        r.clock(400_000, 1_650_000);
        let Verdict::NotBefore(bound) = r.frame(&stamp(3, 450_000), 1_720_000) else {
            panic!("a bound");
        };
        assert!((1_698_000..=1_700_000).contains(&bound), "{bound}");
        // A stamp from the future, as after the camera's clock was set.
        assert_eq!(
            r.frame(&stamp(4, 90_000_000), 1_800_000),
            Verdict::Contradiction
        );
    }
}
