//! Acquisition: the board moves and triggers, the camera exposes, each frame goes to its trigger.
//!
//! Before a sweep two single triggers at rest tie the camera's clock to the board's
//! ([`Acquisition::anchor`]); they also wake a camera that loses its first frame after idling.
//! During the sweep the ledger and the frames run into the [`Matcher`]; what does not belong is
//! named and left out, and in stop-and-shoot the position is visited again.

mod by_camera;

use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::config::{Rig, TriggerSource};
use super::link::{self, LinkError, ScanEvent};
use super::matching::{Anchor, Decision, Fault, FrameStamp, Matcher, TriggerStamp};
use super::open;
use super::request::Requests;
use super::writer::WriteError;
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest, Trigger};
use cannula_shared::units::Micros;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Frames that may wait for their lines of the ledger. Further ones stay with the camera, whose
/// own buffers are bounded: memory is, too, and what they lose is found and named.
const WAITING: usize = 64;
/// How long one wait for a frame lasts while other things may happen.
const SLICE: Duration = Duration::from_millis(20);
/// How often a position or an anchor is tried before it is given up.
const TRIES: u32 = 4;
/// How far two anchors may differ beside the clocks' drift, µs.
const ANCHORS_APART_US: i64 = 1_500;
/// An anchor for single shots is taken anew after this, µs: the clocks may have drifted apart by
/// then as far as two shots by hand are.
const ANCHOR_AGE_US: i64 = 60_000_000;

/// Why an acquisition ended early.
#[derive(Debug, thiserror::Error)]
pub enum AcquireError {
    /// The board.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The disk.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Ctrl-C.
    #[error("interrupted: the laser is off and the slide stands; what was recorded is whole")]
    Interrupted,
    /// Ctrl-C, and what the board does nobody knows.
    #[error(
        "interrupted, but the motion board does not say that the laser is off and the slide stands ({0}): it turns the laser off and stops by itself within 0.3 s of the last word from this program; look at both before you reach in; what was recorded is whole"
    )]
    Unanswered(String),
    /// No frame comes.
    #[error(
        "{tries} triggers and no frame from the camera ({camera}): check the trigger cable, camera.trigger and camera.trigger_line"
    )]
    NoFrames {
        /// Triggers fired.
        tries: u32,
        /// The camera.
        camera: String,
    },
    /// Frames come, but not when triggers fire.
    #[error(
        "the camera's frames do not follow the triggers (its clock and the board's disagree by {0:.1} ms from one trigger to the next): is camera.trigger what the camera is set to?"
    )]
    Unsteady(f64),
    /// Frames come, but none that must have been exposed after it was asked for.
    #[error(
        "no frame of the camera ({0}) can be shown to have been exposed after it was asked for: is camera.trigger what the camera is set to, and do its time stamps advance?"
    )]
    Untold(String),
    /// The laser was off when it should have been on.
    #[error("the laser was off at trigger {0}: check interlock and laser supply")]
    Dark(u32),
    /// Something that takes the shots failed.
    #[error("{0}")]
    Sink(String),
}

/// A picture with what the board knows of it.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Which trigger of the sweep.
    pub index: u32,
    /// Where the slide was in the middle of the exposure.
    pub steps: i64,
    /// The same in mm.
    pub slide_mm: f64,
    /// When, µs of the board's clock.
    pub trigger_us: u64,
    /// Whether the laser was on.
    pub laser: bool,
    /// What the camera saw.
    pub picture: Picture,
    /// When the picture was taken from the camera.
    pub arrived: Instant,
}

/// A picture as it was taken from the camera.
#[derive(Clone, Debug)]
pub struct Taken {
    /// What the camera saw.
    pub picture: Picture,
    /// When it was taken from the camera.
    pub arrived: Instant,
}

impl Shot {
    /// Of a trigger and its picture; `index` counts the positions of the sweep (a position that is
    /// visited again has a trigger of its own).
    /// `moved_mm`: how far the slide came from the trigger to the middle of the exposure.
    fn new(rig: &Rig, index: u32, trigger: &Trigger, moved_mm: f64, taken: Taken) -> Self {
        let moved = (moved_mm / rig.mm(1)).round() as i64;
        let steps = i64::from(trigger.position.0) + moved;
        Self {
            index,
            steps,
            slide_mm: rig.mm(steps),
            trigger_us: trigger.time.0,
            laser: trigger.laser,
            picture: taken.picture,
            arrived: taken.arrived,
        }
    }
}

/// How a sweep went.
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    /// Triggers planned.
    pub planned: u32,
    /// Shots handed out.
    pub shots: u32,
    /// What was lost, doubled, late or broken.
    pub faults: Vec<Fault>,
    /// Triggers that were shot again.
    pub reshot: Vec<u32>,
    /// Triggers left out.
    pub missing: Vec<u32>,
    /// Camera clock against board clock: offset in µs and drift, if enough pairs show it.
    pub clock: Option<(f64, f64)>,
}

/// Where the ledger comes from: a board, or a recording.
pub trait Ledger {
    /// What comes next within `wait`; `None` if nothing did.
    fn next(&mut self, wait: Micros) -> Result<Option<LedgerEvent>, LinkError>;
    /// Ends it early.
    fn stop(&mut self) -> Result<(), LinkError>;
}

/// What a ledger says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LedgerEvent {
    /// A trigger has fired.
    Trigger(Trigger),
    /// Something else: it goes on.
    Other,
    /// It is complete.
    End,
}

impl Ledger for link::Scan<'_> {
    fn next(&mut self, wait: Micros) -> Result<Option<LedgerEvent>, LinkError> {
        Ok(self.next_within(wait)?.map(|event| match event {
            Some(ScanEvent::Trigger(trigger)) => LedgerEvent::Trigger(trigger),
            Some(ScanEvent::End(_)) | None => LedgerEvent::End,
            Some(_) => LedgerEvent::Other,
        }))
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.abandon()
    }
}

/// Takes the shots as they are matched. An error ends the sweep.
pub type Sink<'s> = dyn FnMut(Shot) -> Result<(), AcquireError> + 's;

/// Board and camera together.
pub struct Acquisition<'a> {
    board: &'a link::Board,
    camera: &'a mut dyn Camera,
    rig: &'a Rig,
    cancel: &'a AtomicBool,
    anchor: Option<Anchor>,
    armed: Option<Exposure>,
    /// Of a camera that the board does not trigger.
    requests: Option<Requests>,
}

impl<'a> Acquisition<'a> {
    /// `cancel` is looked at all the time: once true, the laser goes off and the slide stops.
    pub fn new(
        board: &'a link::Board,
        camera: &'a mut dyn Camera,
        rig: &'a Rig,
        cancel: &'a AtomicBool,
    ) -> Self {
        Self {
            board,
            camera,
            rig,
            cancel,
            anchor: None,
            armed: None,
            requests: None,
        }
    }

    /// The camera.
    pub fn camera(&mut self) -> &mut dyn Camera {
        self.camera
    }

    /// Tells board and camera how long exposures are, if that has changed.
    pub fn expose(&mut self, ms: f64) -> Result<(), AcquireError> {
        let exposure = Exposure {
            ms,
            gain_db: self.rig.camera.gain_db,
        };
        if self.armed != Some(exposure) {
            self.board.configure(&self.rig.board_config(ms))?;
            let now = self.board.now().0 as i64;
            self.camera.arm(&exposure)?;
            self.armed = Some(exposure);
            self.anchor = None;
            let by_command = self.rig.camera.trigger == TriggerSource::Software;
            self.requests = Some(Requests::armed(now, by_command));
        }
        Ok(())
    }

    /// Between shots: whether it was told to end, and then what can be said of laser and slide.
    ///
    /// # Errors
    /// [`AcquireError::Interrupted`], or [`AcquireError::Unanswered`] where nobody has seen it.
    pub fn go_on(&self) -> Result<(), AcquireError> {
        if self.cancel.load(Ordering::Relaxed) {
            return Err(self.interrupted());
        }
        Ok(())
    }

    /// Ends motion and laser and waits until the slide stands; what can then be said.
    fn interrupted(&self) -> AcquireError {
        match open::stand(self.board) {
            Ok(()) => AcquireError::Interrupted,
            // The lease does the same, but nobody has seen it.
            Err(why) => AcquireError::Unanswered(why.to_string()),
        }
    }

    fn timeout(&self) -> Duration {
        Duration::from_secs_f64(self.rig.camera.timeout_ms / 1000.0)
    }

    /// Waits for a frame up to the configured time-out, link and Ctrl-C served meanwhile.
    fn wait_frame(&mut self) -> Result<Option<Frame>, AcquireError> {
        let slices = (self.timeout().as_secs_f64() / SLICE.as_secs_f64()).ceil() as u32;
        for _ in 0..slices.max(1) {
            self.go_on()?;
            if let Some(frame) = self.camera.wait(SLICE)? {
                return Ok(Some(frame));
            }
            self.board.keep_alive()?;
        }
        Ok(None)
    }

    /// Fires one trigger and takes the frame that follows; `None` if none does.
    fn single(&mut self) -> Result<Option<(Trigger, Frame)>, AcquireError> {
        // What still comes from before belongs to nobody.
        while self.camera.wait(Duration::ZERO)?.is_some() {}
        let trigger = self.board.trigger()?;
        self.camera.ledger(&trigger);
        Ok(self.wait_frame()?.map(|frame| (trigger, frame)))
    }

    /// Finds the home switch anew.
    pub fn home(&mut self) -> Result<(), AcquireError> {
        self.board.home()?;
        Ok(())
    }

    /// Ties the camera's clock to the board's: two single triggers whose frames follow them by the
    /// same time. One alone could be answered by the frame of an earlier one.
    pub fn anchor(&mut self) -> Result<Anchor, AcquireError> {
        let mut last: Option<(i64, i64)> = None;
        let mut apart = 0;
        let (mut fired, mut frames) = (0, 0);
        while fired < 2 * TRIES {
            fired += 1;
            let Some((trigger, frame)) = self.single()? else {
                if frames == 0 && fired >= TRIES {
                    break;
                }
                continue;
            };
            frames += 1;
            let now = (trigger.time.0 as i64, frame.time_us);
            if let Some(before) = last {
                apart = (now.1 - before.1) - (now.0 - before.0);
                if apart.abs() < ANCHORS_APART_US {
                    let anchor = Anchor::from_pair(now.0, now.1);
                    self.anchor = Some(anchor);
                    return Ok(anchor);
                }
            }
            last = Some(now);
        }
        if frames < 2 {
            return Err(AcquireError::NoFrames {
                tries: fired,
                camera: self.camera.description(),
            });
        }
        Err(AcquireError::Unsteady(apart as f64 / 1000.0))
    }

    /// A picture at rest, where the slide stands.
    pub fn still(&mut self, index: u32, laser: bool) -> Result<Shot, AcquireError> {
        if self.rig.camera.trigger != TriggerSource::Board {
            let told = self.still_by_camera(index, laser, &mut Vec::new());
            return told.map(|(shot, _)| shot);
        }
        for _ in 0..TRIES {
            self.go_on()?;
            let now = self.board.status()?.uptime.0 as i64;
            if self.anchor.is_none_or(|a| now - a.at_us > ANCHOR_AGE_US) {
                self.anchor()?;
            }
            if laser {
                self.board.laser(true)?;
                self.rest(self.rig.laser.lead_ms)?;
            }
            let taken = self.single();
            let off = if laser {
                self.board.laser(false)
            } else {
                Ok(())
            };
            // Why there was no frame comes first.
            let taken = taken?;
            off?;
            let (Some((trigger, frame)), Some(anchor)) = (taken, self.anchor) else {
                continue;
            };
            let mut matcher = Matcher::new(anchor);
            matcher.trigger(stamp_of(&trigger));
            matcher.complete();
            matcher.frame(frame_stamp(&frame));
            let pair = matches!(matcher.decide(), Some((_, _, Decision::Pair(0))));
            match frame.picture {
                Some(picture) if pair => {
                    self.anchor = Some(Anchor::from_pair(trigger.time.0 as i64, frame.time_us));
                    if trigger.laser != laser {
                        return Err(AcquireError::Dark(index));
                    }
                    return Ok(self.shot(index, &trigger, picture));
                }
                _ => self.anchor = None,
            }
        }
        Err(AcquireError::NoFrames {
            tries: TRIES,
            camera: self.camera.description(),
        })
    }

    /// Lets time pass on the board's clock.
    fn rest(&self, ms: f64) -> Result<(), AcquireError> {
        let until = self.board.now().0 + (ms * 1000.0) as u64;
        while self.board.now().0 < until {
            self.go_on()?;
            self.board.keep_alive()?;
        }
        Ok(())
    }

    fn shot(&self, index: u32, trigger: &Trigger, picture: Picture) -> Shot {
        let arrived = Instant::now();
        Shot::new(self.rig, index, trigger, 0.0, Taken { picture, arrived })
    }

    /// Carries out a sweep; `sink` sees each shot as soon as it is matched (re-shot ones last).
    pub fn sweep(&mut self, request: &ScanRequest, sink: &mut Sink) -> Result<Sweep, AcquireError> {
        if self.rig.camera.trigger != TriggerSource::Board {
            let all: Vec<u32> = (0..request.count).collect();
            return self.visit(request, &all, sink);
        }
        let anchor = self.anchor()?;
        let mut scan = self.board.scan(request)?;
        let rig = self.rig;
        let mut follow = Follow {
            camera: self.camera,
            cancel: self.cancel,
            timeout: Duration::from_secs_f64(rig.camera.timeout_ms / 1000.0),
            laser: request.laser != ScanLaser::Off,
            planned: request.count as usize,
        };
        // On the fly the sheet sweeps on while the shutter is open; its middle is where the stripe's is.
        let moved_mm = 0.5e-3 * self.armed.map_or(0.0, |e| e.ms) * rig.travel_mm_s(request);
        let mut make = |trigger: &Trigger, taken: Taken| {
            sink(Shot::new(rig, trigger.index, trigger, moved_mm, taken))
        };
        let followed = follow.run(&mut scan, anchor, &mut make);
        drop(scan);
        let (mut sweep, unpaired) = match followed {
            Err(AcquireError::Interrupted) => return Err(self.interrupted()),
            other => other?,
        };
        sweep.planned = request.count;
        let lost: Vec<u32> = unpaired.iter().map(|t| t.index).collect();
        if request.mode == ScanMode::StopAndShoot {
            self.visit_into(request, &lost, &mut sweep, true, sink)?;
        } else {
            sweep.missing = lost;
        }
        Ok(sweep)
    }
}

/// The part of a sweep that a replay shares: ledger and frames into the matcher, shots out.
pub struct Follow<'a> {
    /// Where frames come from.
    pub camera: &'a mut dyn Camera,
    /// Ends it once true.
    pub cancel: &'a AtomicBool,
    /// How long after the ledger's end the last frames may come.
    pub timeout: Duration,
    /// Whether the laser is to be on at every trigger.
    pub laser: bool,
    /// Triggers that there will be, if the ledger is not broken off: after the last one its frame need
    /// not wait for the ledger's end, which comes when the slide stands.
    pub planned: usize,
}

impl Follow<'_> {
    /// Runs to the end of the ledger and the last frame; gives what happened and the triggers
    /// without a frame.
    pub fn run(
        &mut self,
        ledger: &mut dyn Ledger,
        anchor: Anchor,
        shot: &mut dyn FnMut(&Trigger, Taken) -> Result<(), AcquireError>,
    ) -> Result<(Sweep, Vec<Trigger>), AcquireError> {
        let mut matcher = Matcher::new(anchor);
        let mut triggers: Vec<Trigger> = Vec::new();
        // Beside the matcher's waiting frames, in the same order.
        let mut pictures: Vec<Option<Taken>> = Vec::new();
        let mut sweep = Sweep::default();
        let mut ended = false;
        let mut idle = Duration::ZERO;
        // Since the ledger's end, or the last pair after it.
        let mut since: Option<Instant> = None;
        loop {
            if self.cancel.load(Ordering::Relaxed) {
                let _ = ledger.stop();
                return Err(AcquireError::Interrupted);
            }
            if !ended {
                match ledger.next(Micros(2_000))? {
                    Some(LedgerEvent::Trigger(trigger)) => {
                        if self.laser && !trigger.laser {
                            let _ = ledger.stop();
                            return Err(AcquireError::Dark(trigger.index));
                        }
                        self.camera.ledger(&trigger);
                        matcher.trigger(stamp_of(&trigger));
                        triggers.push(trigger);
                        if triggers.len() >= self.planned {
                            matcher.complete();
                        }
                    }
                    Some(LedgerEvent::End) => {
                        ended = true;
                        matcher.complete();
                    }
                    Some(LedgerEvent::Other) | None => {}
                }
            }
            let wait = if ended { SLICE } else { Duration::ZERO };
            let mut any = false;
            while matcher.waiting() < WAITING
                && let Some(frame) = self.camera.wait(if any { Duration::ZERO } else { wait })?
            {
                any = true;
                matcher.frame(frame_stamp(&frame));
                let arrived = Instant::now();
                pictures.push(frame.picture.map(|picture| Taken { picture, arrived }));
            }
            while let Some((at, _, decision)) = matcher.decide() {
                let taken = pictures.remove(at);
                match (decision, taken) {
                    (Decision::Pair(i), Some(taken)) => {
                        since = None;
                        sweep.shots += 1;
                        if let Err(e) = shot(&triggers[i], taken) {
                            let _ = ledger.stop();
                            return Err(e);
                        }
                    }
                    // A frame without its picture is never a pair.
                    (Decision::Pair(_), None) => {}
                    (Decision::Fault(fault), _) => sweep.faults.push(fault),
                }
            }
            if ended {
                idle = if any { Duration::ZERO } else { idle + SLICE };
                // A camera that goes on by itself is never idle.
                let since = since.get_or_insert_with(Instant::now);
                if matcher.all_paired() || idle >= self.timeout || since.elapsed() >= self.timeout {
                    break;
                }
            }
        }
        sweep.clock = matcher.clock();
        let unpaired: Vec<Trigger> = matcher
            .unpaired()
            .filter_map(|t| triggers.iter().find(|l| l.index == t.index).copied())
            .collect();
        for t in &unpaired {
            let named = sweep.faults.iter().any(|f| {
                matches!(f, Fault::Broken { trigger, .. } | Fault::Late { trigger, .. } if *trigger == t.index)
            });
            if !named {
                sweep.faults.push(Fault::Lost { trigger: t.index });
            }
        }
        Ok((sweep, unpaired))
    }
}

fn stamp_of(trigger: &Trigger) -> TriggerStamp {
    TriggerStamp {
        index: trigger.index,
        time_us: trigger.time.0 as i64,
    }
}

fn frame_stamp(frame: &Frame) -> FrameStamp {
    FrameStamp {
        sequence: frame.sequence,
        time_us: frame.time_us,
        whole: frame.picture.is_some(),
    }
}

impl Sweep {
    /// Takes in a sweep over the positions from `first` on.
    pub fn join(&mut self, later: Self, first: u32) {
        self.planned += later.planned;
        self.shots += later.shots;
        let faults = later.faults.into_iter();
        self.faults.extend(faults.map(|f| f.shifted(first)));
        let shifted = |indices: Vec<u32>| indices.into_iter().map(move |i| i + first);
        self.reshot.extend(shifted(later.reshot));
        self.missing.extend(shifted(later.missing));
        self.clock = later.clock.or(self.clock);
    }

    /// What went wrong, a line each.
    pub fn complaints(&self) -> Vec<String> {
        let mut lines: Vec<String> = self.faults.iter().map(ToString::to_string).collect();
        if !self.reshot.is_empty() {
            lines.push(format!("positions {:?} were visited again", self.reshot));
        }
        if !self.missing.is_empty() {
            lines.push(format!("positions {:?} are left out", self.missing));
        }
        lines
    }
}
