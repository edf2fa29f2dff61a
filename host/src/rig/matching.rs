//! Which frame belongs to which trigger: pure logic on time stamps.
//!
//! The board's ledger says when trigger k fired (board clock), the camera when frame j was
//! exposed (camera clock). The clocks are related by t_camera = t_board + o(t), where o changes by
//! the drift of two quartzes, at most [`MAX_DRIFT`]. An *anchor*, a single trigger fired at rest
//! whose frame is known to be its own, gives o; from there it is tracked from match to match:
//!
//! ```text
//! |t_frame − t_trigger − o| ≤ tolerance + drift · (time since the last match)   → a pair
//! ```
//!
//! A frame that fits no trigger, or could fit two, is named and left out; a trigger without a
//! frame is named too. Nothing is ever shifted on to a neighbour.

/// The most that two clocks drift apart, s/s (crystals are ten times better).
pub const MAX_DRIFT: f64 = 3e-4;
/// How exactly an exposure follows its trigger, µs.
pub const TOLERANCE_US: f64 = 1500.0;

/// A line of the board's ledger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriggerStamp {
    /// Which trigger.
    pub index: u32,
    /// When, µs of the board's clock.
    pub time_us: i64,
}

/// A frame as it arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameStamp {
    /// The camera's count.
    pub sequence: u64,
    /// When its exposure began, µs of the camera's clock.
    pub time_us: i64,
    /// Whether all of it arrived.
    pub whole: bool,
}

/// What went wrong with a frame or a trigger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The trigger has no frame.
    Lost {
        /// The trigger.
        trigger: u32,
    },
    /// Its frame arrived in part.
    Broken {
        /// The trigger.
        trigger: u32,
        /// The frame.
        sequence: u64,
    },
    /// A second frame for a trigger that has one.
    Double {
        /// The trigger.
        trigger: u32,
        /// The frame.
        sequence: u64,
    },
    /// Exposed too long after its trigger: the slide had moved on.
    Late {
        /// The nearest trigger.
        trigger: u32,
        /// The frame.
        sequence: u64,
        /// How far from where it was due, ms.
        by_ms: f64,
    },
    /// It may have been exposed before its position was reached (a camera that the board does not
    /// trigger).
    Before {
        /// The position that it was taken for.
        trigger: u32,
        /// The frame.
        sequence: u64,
        /// By how much at the most, ms.
        by_ms: f64,
    },
    /// A frame that belongs to no trigger, or might belong to two.
    Stray {
        /// The frame.
        sequence: u64,
    },
}

impl Fault {
    /// The same of a trigger that counts from `first` on.
    pub fn shifted(mut self, first: u32) -> Self {
        match &mut self {
            Self::Lost { trigger }
            | Self::Broken { trigger, .. }
            | Self::Double { trigger, .. }
            | Self::Late { trigger, .. }
            | Self::Before { trigger, .. } => *trigger += first,
            Self::Stray { .. } => {}
        }
        self
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Lost { trigger } => write!(f, "trigger {trigger} has no frame"),
            Self::Broken { trigger, sequence } => {
                write!(f, "frame {sequence} of trigger {trigger} arrived in part")
            }
            Self::Double { trigger, sequence } => {
                write!(f, "frame {sequence} is a second one for trigger {trigger}")
            }
            Self::Late {
                trigger,
                sequence,
                by_ms,
            } => {
                write!(
                    f,
                    "frame {sequence} was exposed {by_ms:.1} ms off trigger {trigger}"
                )
            }
            Self::Before {
                trigger,
                sequence,
                by_ms,
            } => {
                write!(
                    f,
                    "frame {sequence} may have been exposed {by_ms:.1} ms before position {trigger} was ready"
                )
            }
            Self::Stray { sequence } => write!(f, "frame {sequence} belongs to no trigger"),
        }
    }
}

/// How the camera's clock stands to the board's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Camera time minus board time, µs.
    pub offset_us: f64,
    /// When (board clock, µs) that was so.
    pub at_us: i64,
    /// How exactly, µs.
    pub tolerance_us: f64,
}

impl Anchor {
    /// From a trigger and the frame that is known to be its own.
    pub fn from_pair(trigger_us: i64, frame_us: i64) -> Self {
        Self {
            offset_us: (frame_us - trigger_us) as f64,
            at_us: trigger_us,
            tolerance_us: TOLERANCE_US,
        }
    }
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision {
    /// It is the frame of the trigger at this place in the ledger.
    Pair(usize),
    /// It is left out.
    Fault(Fault),
}

/// Matches frames to triggers as both arrive.
#[derive(Clone, Debug)]
pub struct Matcher {
    triggers: Vec<TriggerStamp>,
    /// The frame of each trigger: its sequence number.
    taken: Vec<Option<u64>>,
    anchor: Anchor,
    waiting: Vec<FrameStamp>,
    complete: bool,
    /// Offsets of the pairs so far, for the clock's drift: board time, offset.
    pairs: Vec<(f64, f64)>,
}

impl Matcher {
    /// Starts from an anchor.
    pub fn new(anchor: Anchor) -> Self {
        Self {
            triggers: Vec::new(),
            taken: Vec::new(),
            anchor,
            waiting: Vec::new(),
            complete: false,
            pairs: Vec::new(),
        }
    }

    /// The next line of the ledger (in order of time).
    pub fn trigger(&mut self, stamp: TriggerStamp) {
        self.triggers.push(stamp);
        self.taken.push(None);
    }

    /// A frame has arrived. It is decided on by [`Matcher::decide`] once the ledger reaches it.
    pub fn frame(&mut self, stamp: FrameStamp) {
        self.waiting.push(stamp);
    }

    /// The ledger is complete: no trigger will come any more.
    pub fn complete(&mut self) {
        self.complete = true;
    }

    /// Triggers so far.
    pub fn triggers(&self) -> &[TriggerStamp] {
        &self.triggers
    }

    /// Whether every trigger has its frame.
    pub fn all_paired(&self) -> bool {
        self.taken.iter().all(Option::is_some)
    }

    /// Frames that wait for the ledger.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Decides on the oldest waiting frame that the ledger reaches. One whose time stamp lies far
    /// ahead of the ledger does not hold up those that came after it. Gives its place among the
    /// waiting, too.
    pub fn decide(&mut self) -> Option<(usize, FrameStamp, Decision)> {
        let newest = self.triggers.last().map(|t| t.time_us as f64);
        let at = self.waiting.iter().position(|frame| {
            let due = self.due(frame);
            // A frame may overtake its own line of the ledger.
            self.complete || newest.is_some_and(|t| t > due + self.tolerance(due))
        })?;
        let frame = self.waiting.remove(at);
        let due = self.due(&frame);
        let tolerance = self.tolerance(due);
        Some((at, frame, self.place(&frame, due, tolerance)))
    }

    /// When the frame's trigger should have fired, µs of the board's clock.
    fn due(&self, frame: &FrameStamp) -> f64 {
        frame.time_us as f64 - self.anchor.offset_us
    }

    fn tolerance(&self, board_us: f64) -> f64 {
        self.anchor.tolerance_us + MAX_DRIFT * (board_us - self.anchor.at_us as f64).abs()
    }

    fn place(&mut self, frame: &FrameStamp, due: f64, tolerance: f64) -> Decision {
        let sequence = frame.sequence;
        let distance = |i: usize| (self.triggers[i].time_us as f64 - due).abs();
        let after = self.triggers.partition_point(|t| (t.time_us as f64) < due);
        let mut near: Vec<usize> =
            (after.saturating_sub(2)..(after + 2).min(self.triggers.len())).collect();
        near.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let Some(&i) = near.first() else {
            return Decision::Fault(Fault::Stray { sequence });
        };
        let trigger = self.triggers[i].index;
        let second = near.get(1).map_or(f64::MAX, |&j| distance(j));
        // Two triggers within reach: it can't be told whose frame this is.
        if second <= tolerance {
            return Decision::Fault(Fault::Stray { sequence });
        }
        if distance(i) > tolerance {
            return Decision::Fault(if distance(i) < 0.5 * second {
                let by_ms = (due - self.triggers[i].time_us as f64) / 1000.0;
                Fault::Late {
                    trigger,
                    sequence,
                    by_ms,
                }
            } else {
                Fault::Stray { sequence }
            });
        }
        if self.taken[i].is_some() {
            return Decision::Fault(Fault::Double { trigger, sequence });
        }
        if !frame.whole {
            return Decision::Fault(Fault::Broken { trigger, sequence });
        }
        self.taken[i] = Some(sequence);
        // Follow the drift, slowly enough that one frame's jitter does not matter.
        let time = self.triggers[i].time_us;
        let offset = (frame.time_us - time) as f64;
        let share = if self.pairs.is_empty() { 0.5 } else { 0.25 };
        self.anchor.offset_us += share * (offset - self.anchor.offset_us);
        self.anchor.at_us = time;
        self.anchor.tolerance_us = TOLERANCE_US;
        self.pairs.push((time as f64, offset));
        Decision::Pair(i)
    }

    /// Triggers that have no frame.
    pub fn unpaired(&self) -> impl Iterator<Item = &TriggerStamp> {
        self.triggers
            .iter()
            .zip(&self.taken)
            .filter(|(_, taken)| taken.is_none())
            .map(|(trigger, _)| trigger)
    }

    /// The clock as the pairs show it: offset in µs at the first pair and drift (s/s), by the
    /// median of slopes and offsets (Theil and Sen); `None` with fewer than three pairs.
    pub fn clock(&self) -> Option<(f64, f64)> {
        let n = self.pairs.len();
        if n < 3 {
            return None;
        }
        // Pairs half the scan apart give the steadiest slopes, and few enough of them.
        let half = n / 2;
        let mut slopes: Vec<f64> = (0..n - half)
            .map(|i| {
                let (a, b) = (self.pairs[i], self.pairs[i + half]);
                (b.1 - a.1) / (b.0 - a.0)
            })
            .filter(|slope| slope.is_finite())
            .collect();
        let drift = median(&mut slopes)?;
        let start = self.pairs[0].0;
        let mut offsets: Vec<f64> = self
            .pairs
            .iter()
            .map(|p| p.1 - drift * (p.0 - start))
            .collect();
        Some((median(&mut offsets)?, drift))
    }
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Why a whole recording can't be matched.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unmatched {
    /// Shifted by a trigger, the frames would fit as well.
    #[error(
        "{frames} frames fit {triggers} triggers in more than one way; record again with an anchor (a trigger before the scan whose frame is known)"
    )]
    Ambiguous {
        /// Frames.
        frames: usize,
        /// Triggers.
        triggers: usize,
    },
    /// Nothing fits.
    #[error("none of {frames} frames fits any of {triggers} triggers")]
    Nothing {
        /// Frames.
        frames: usize,
        /// Triggers.
        triggers: usize,
    },
}

/// Finds an anchor where none was taken, by trying every frame against every trigger: the one
/// that pairs most. Refused where two do equally well.
pub fn find_anchor(triggers: &[TriggerStamp], frames: &[FrameStamp]) -> Result<Anchor, Unmatched> {
    // The right pairing shows among the first few of each unless nearly all were lost.
    const TRIED: usize = 24;
    let count = |anchor: Anchor| {
        let mut m = Matcher::new(anchor);
        triggers.iter().for_each(|t| m.trigger(*t));
        m.complete();
        frames.iter().for_each(|f| m.frame(*f));
        while m.decide().is_some() {}
        m.pairs.len()
    };
    let mut best: Option<(usize, Anchor)> = None;
    let mut rival = 0;
    for t in triggers.iter().take(TRIED) {
        for f in frames.iter().take(TRIED) {
            let anchor = Anchor::from_pair(t.time_us, f.time_us);
            let pairs = count(anchor);
            match best {
                Some((most, b)) if (b.offset_us - anchor.offset_us).abs() > 2.0 * TOLERANCE_US => {
                    if pairs > most {
                        rival = most;
                        best = Some((pairs, anchor));
                    } else {
                        rival = rival.max(pairs);
                    }
                }
                Some((most, _)) if pairs <= most => {}
                _ => best = Some((pairs, anchor)),
            }
        }
    }
    let (frames, triggers) = (frames.len(), triggers.len());
    match best {
        Some((pairs, anchor)) if pairs > 0 && pairs > rival => Ok(anchor),
        Some((pairs, _)) if pairs > 0 => Err(Unmatched::Ambiguous { frames, triggers }),
        _ => Err(Unmatched::Nothing { frames, triggers }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What happens to the frame of a trigger.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Fate {
        Fine,
        Lost,
        Broken,
        Double,
        Late(f64),
    }

    fn fate() -> impl Strategy<Value = Fate> {
        prop_oneof![
            8 => Just(Fate::Fine),
            2 => Just(Fate::Lost),
            1 => Just(Fate::Broken),
            1 => Just(Fate::Double),
            1 => (4_000.0..8_000.0f64).prop_map(Fate::Late),
        ]
    }

    #[derive(Debug, Clone)]
    struct Case {
        triggers: Vec<TriggerStamp>,
        fates: Vec<Fate>,
        /// Frames with the trigger that each truly belongs to.
        frames: Vec<(FrameStamp, usize)>,
        anchor: Anchor,
    }

    fn case() -> impl Strategy<Value = Case> {
        (
            prop::collection::vec((fate(), 20_000i64..60_000, -300i64..300), 1..60),
            -1e12..1e12f64,
            -1.5e-4..1.5e-4f64,
            any::<u32>(),
        )
            .prop_map(|(steps, offset, drift, start)| {
                let start = i64::from(start);
                let camera = |t: i64, jitter: i64| {
                    t + offset as i64 + ((t - start) as f64 * drift) as i64 + jitter
                };
                let mut time = start + 500_000;
                let anchor = Anchor::from_pair(start, camera(start, 120));
                let (mut triggers, mut frames) = (Vec::new(), Vec::new());
                let mut sequence = 17;
                let mut push = |time_us: i64, whole: bool, k: usize, again: bool| {
                    if !again {
                        sequence += 1;
                    }
                    frames.push((
                        FrameStamp {
                            sequence,
                            time_us,
                            whole,
                        },
                        k,
                    ));
                };
                for (k, &(fate, gap, jitter)) in steps.iter().enumerate() {
                    triggers.push(TriggerStamp {
                        index: k as u32,
                        time_us: time,
                    });
                    let stamp = camera(time, jitter);
                    match fate {
                        Fate::Fine => push(stamp, true, k, false),
                        Fate::Lost => {}
                        Fate::Broken => push(stamp, false, k, false),
                        Fate::Double => {
                            push(stamp, true, k, false);
                            push(stamp, true, k, true);
                        }
                        Fate::Late(by) => push(stamp + by as i64, true, k, false),
                    }
                    time += gap;
                }
                let fates = steps.iter().map(|s| s.0).collect();
                Case {
                    triggers,
                    fates,
                    frames,
                    anchor,
                }
            })
    }

    proptest! {
        /// Whatever is lost, doubled, broken or late: no frame goes to another's trigger, and
        /// everything is named.
        #[test]
        fn no_frame_is_ever_shifted(case in case(), behind in 0usize..5) {
            let mut m = Matcher::new(case.anchor);
            let mut decisions = Vec::new();
            let mut frames = case.frames.iter();
            // Ledger and frames arrive interleaved, the ledger up to `behind` lines late.
            for (k, trigger) in case.triggers.iter().enumerate() {
                m.trigger(*trigger);
                while let Some((frame, _)) = frames.clone().next().filter(|f| f.1 <= k + behind) {
                    m.frame(*frame);
                    frames.next();
                }
                while let Some(d) = m.decide() {
                    decisions.push(d);
                }
            }
            frames.for_each(|f| m.frame(f.0));
            m.complete();
            while let Some(d) = m.decide() {
                decisions.push(d);
            }
            prop_assert_eq!(decisions.len(), case.frames.len());
            let mut paired = vec![false; case.triggers.len()];
            for ((_, stamp, decision), (frame, k)) in decisions.iter().zip(&case.frames) {
                prop_assert_eq!(stamp, frame);
                let k32 = *k as u32;
                match (decision, case.fates[*k]) {
                    (Decision::Pair(i), Fate::Fine | Fate::Double) => {
                        prop_assert_eq!(i, k);
                        paired[*k] = true;
                    }
                    (Decision::Fault(Fault::Double { trigger, .. }), Fate::Double) => prop_assert_eq!(*trigger, k32),
                    (Decision::Fault(Fault::Broken { trigger, .. }), Fate::Broken) => prop_assert_eq!(*trigger, k32),
                    (Decision::Fault(Fault::Late { trigger, by_ms, .. }), Fate::Late(by)) => {
                        prop_assert_eq!(*trigger, k32);
                        prop_assert!((by_ms * 1000.0 - by).abs() < 1500.0);
                    }
                    // A late frame may lie as far from one trigger as from the next.
                    (Decision::Fault(Fault::Stray { .. }), Fate::Late(_)) => {}
                    (decision, fate) => prop_assert!(false, "{:?} for {:?}", decision, fate),
                }
            }
            for (k, fate) in case.fates.iter().enumerate() {
                prop_assert_eq!(paired[k], matches!(fate, Fate::Fine | Fate::Double), "trigger {}", k);
            }
            let unpaired: Vec<u32> = m.unpaired().map(|t| t.index).collect();
            let expected: Vec<u32> = (0..paired.len()).filter(|&k| !paired[k]).map(|k| k as u32).collect();
            prop_assert_eq!(unpaired, expected);
        }
    }

    fn even(n: usize, gap: i64, from: i64) -> Vec<TriggerStamp> {
        (0..n)
            .map(|k| TriggerStamp {
                index: k as u32,
                time_us: from + k as i64 * gap,
            })
            .collect()
    }

    fn frames_of(triggers: &[TriggerStamp], keep: impl Fn(usize) -> bool) -> Vec<FrameStamp> {
        triggers
            .iter()
            .enumerate()
            .filter(|(k, _)| keep(*k))
            .enumerate()
            .map(|(j, (_, t))| FrameStamp {
                sequence: j as u64,
                time_us: t.time_us + 5_000_000,
                whole: true,
            })
            .collect()
    }

    #[test]
    fn even_triggers_with_one_frame_lost_need_an_anchor() {
        let triggers = even(31, 40_000, 1_000_000);
        // The first or the last was lost: both fit, so neither may be assumed.
        for lost in [0, 30] {
            let frames = frames_of(&triggers, |k| k != lost);
            assert_eq!(
                find_anchor(&triggers, &frames),
                Err(Unmatched::Ambiguous {
                    frames: 30,
                    triggers: 31
                })
            );
        }
        // One in the middle leaves a gap that fits in one way.
        let frames = frames_of(&triggers, |k| k != 12);
        assert_eq!(
            find_anchor(&triggers, &frames).unwrap().offset_us,
            5_000_000.0
        );
        assert_eq!(
            find_anchor(&triggers, &frames_of(&triggers, |_| true))
                .unwrap()
                .offset_us,
            5_000_000.0
        );
        assert!(find_anchor(&triggers, &[]).is_err());
    }

    #[test]
    fn every_second_lost_is_seen_with_an_anchor() {
        let triggers = even(31, 40_000, 1_000_000);
        for odd in [0, 1] {
            let mut m = Matcher::new(Anchor::from_pair(700_000, 5_700_200));
            triggers.iter().for_each(|t| m.trigger(*t));
            m.complete();
            frames_of(&triggers, |k| k % 2 == odd)
                .into_iter()
                .for_each(|f| m.frame(f));
            while let Some((_, frame, decision)) = m.decide() {
                assert_eq!(decision, Decision::Pair(2 * frame.sequence as usize + odd));
            }
            assert!(m.unpaired().all(|t| t.index as usize % 2 != odd));
        }
    }

    #[test]
    fn a_stamp_far_ahead_holds_up_nobody() {
        let triggers = even(8, 40_000, 1_000_000);
        let mut m = Matcher::new(Anchor::from_pair(900_000, 5_900_000));
        let wild = FrameStamp {
            sequence: 99,
            time_us: 60_000_000,
            whole: true,
        };
        m.frame(wild);
        for (t, f) in triggers.iter().zip(frames_of(&triggers, |_| true)) {
            m.trigger(*t);
            m.frame(f);
        }
        // All but the last, which the ledger has not passed, while the scan still runs.
        for k in 0..7 {
            let (at, _, decision) = m.decide().unwrap();
            assert_eq!((at, decision), (1, Decision::Pair(k)));
        }
        assert!(m.decide().is_none());
        m.complete();
        let stray = Decision::Fault(Fault::Stray { sequence: 99 });
        assert_eq!(m.decide(), Some((0, wild, stray)));
        assert!(matches!(m.decide(), Some((0, _, Decision::Pair(7)))));
    }

    #[test]
    fn an_anchor_that_is_too_old_is_not_trusted() {
        // After 100 s without a match the clocks may be 30 ms apart: with triggers every 20 ms it
        // can't be told whose frame is whose.
        let triggers = even(31, 20_000, 101_000_000);
        let mut m = Matcher::new(Anchor::from_pair(0, 5_000_000));
        triggers.iter().for_each(|t| m.trigger(*t));
        m.complete();
        frames_of(&triggers, |_| true)
            .into_iter()
            .for_each(|f| m.frame(f));
        let mut strays = 0;
        while let Some((_, _, decision)) = m.decide() {
            strays += usize::from(matches!(decision, Decision::Fault(Fault::Stray { .. })));
        }
        assert!(strays >= 29, "{strays}");
    }

    #[test]
    fn the_drift_comes_out() {
        let triggers = even(60, 40_000, 0);
        let mut m = Matcher::new(Anchor::from_pair(-100_000, -100_000 + 77));
        for (j, t) in triggers.iter().enumerate() {
            m.trigger(*t);
            let time_us =
                t.time_us + 77 + (t.time_us as f64 * 1e-4) as i64 + (j as i64 % 3 - 1) * 20;
            m.frame(FrameStamp {
                sequence: j as u64,
                time_us,
                whole: true,
            });
        }
        m.complete();
        while m.decide().is_some() {}
        let (offset, drift) = m.clock().unwrap();
        assert!(
            (drift - 1e-4).abs() < 2e-5 && (offset - 77.0).abs() < 60.0,
            "{offset} {drift}"
        );
    }
}
