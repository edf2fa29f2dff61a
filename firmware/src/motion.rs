//! One move under way: feeds the engine ahead of time, arms triggers as the ledger has room, and
//! sees how it ends.
//!
//! What is fed never reaches further than [`LOOK_AHEAD`] past now by the plan's clock (or one
//! step): if the CPU dies, the step machine starves within that time.

use crate::engine::{Engine, HaltOn, MoveSetup};
use crate::laser::Lights;
use crate::ledger::Ledger;
use crate::profile::Profile;
use crate::segment::Segments;
use crate::triggers::Gaps;
use cannula_shared::error::{Doing, Fault};
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Cycles, Micros, Steps};

/// How far past now the engine is fed.
pub const LOOK_AHEAD: Micros = Micros(20_000);
const LOOK_AHEAD_CYCLES: u32 = 20_000 * 125;
const _: () = assert!(LOOK_AHEAD_CYCLES as u64 == LOOK_AHEAD.to_cycles().0);
/// The most step words in one call.
const SLICE: usize = 512;
/// A move that is this much later than planned will not end.
const OVERDUE: Micros = Micros(1_000_000);

/// How a move ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Where its profile ends.
    Arrived,
    /// At the switch that the machine watches.
    Halted,
    /// By a fault of the machinery.
    Failed(Fault),
}

/// The slide: where it is, and the move under way.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    position: Steps,
    known: bool,
    run: Option<Run>,
    /// The light that the move brings along, and when the move started.
    lights: Option<(Lights, Micros)>,
    /// Of the last move: how many steps, and whether away from home.
    last: (u32, bool),
}

/// What a pass has besides its steps.
#[derive(Clone, Copy, Debug)]
pub struct OnTheFly {
    /// The triggers.
    pub plan: TriggerPlan,
    /// Places in the ledger that each takes.
    pub places: usize,
    /// The light, where it is timed.
    pub lights: Option<Lights>,
}

/// A move under way.
#[derive(Clone, Debug)]
struct Run {
    segments: Segments,
    begin: Steps,
    away: bool,
    started: Micros,
    /// When it is overdue, from the start: roots are too dear to be taken at every poll.
    overdue: Micros,
    /// All words have been pushed.
    fed: bool,
    stopping: bool,
    pass: Option<Pass>,
}

/// Triggers on the way.
#[derive(Clone, Debug)]
struct Pass {
    gaps: Gaps,
    /// Places in the ledger for each.
    places: usize,
}

impl Motion {
    /// The commanded position, while moving as of the last edge.
    pub fn position<E: Engine>(&self, engine: &mut E) -> Steps {
        match &self.run {
            Some(run) => run.position(engine.steps_done()),
            None => self.position,
        }
    }

    /// Whether the position is known.
    pub const fn known(&self) -> bool {
        self.known
    }

    /// The position is unknown from here on.
    pub fn forget(&mut self) {
        self.known = false;
    }

    /// The slide stands here, by definition.
    pub fn set_position(&mut self, position: Steps) {
        self.position = position;
        self.known = true;
    }

    /// Whether a move is under way.
    pub const fn moving(&self) -> bool {
        self.run.is_some()
    }

    /// No further light words; those that the engine has are for [`Engine::laser`] to forget.
    pub fn darken(&mut self) {
        self.lights = None;
    }

    /// Triggers armed so far in this move.
    pub fn armed(&self) -> u32 {
        self.run
            .as_ref()
            .and_then(|run| run.pass.as_ref())
            .map_or(0, |pass| pass.gaps.index())
    }

    /// Cycles from edge to edge now, for the speed, and time to the planned end.
    pub fn pace<E: Engine>(&self, now: Micros, engine: &mut E) -> Option<(u32, Micros)> {
        let run = self.run.as_ref()?;
        let done = engine.steps_done();
        let profile = run.segments.profile();
        let left = profile
            .duration()
            .to_micros_up()
            .0
            .saturating_sub(now.since(run.started).0);
        Some((profile.interval(done), Micros(left)))
    }

    /// Starts a move away from home (or towards it), with triggers on the way if given.
    /// The direction already stands on its pin.
    pub fn start<E: Engine>(
        &mut self,
        engine: &mut E,
        ledger: &mut Ledger,
        profile: Profile,
        away: bool,
        pulse: Cycles,
        on_the_fly: Option<OnTheFly>,
    ) {
        engine.prepare(MoveSetup {
            halt_on: if away { HaltOn::Limit } else { HaltOn::Home },
            pulse,
            lights: on_the_fly.is_some_and(|o| o.lights.is_some()),
        });
        let begin = self.position;
        let pass = on_the_fly.map(|o| Pass {
            gaps: Gaps::new(o.plan, begin),
            places: o.places,
        });
        let mut run = Run {
            segments: Segments::new(profile),
            begin,
            away,
            started: Micros(0),
            overdue: profile.duration().to_micros_up().after(OVERDUE),
            fed: false,
            stopping: false,
            pass,
        };
        run.arm(engine, ledger);
        run.feed(engine, LOOK_AHEAD.to_cycles());
        let mut lights = on_the_fly.and_then(|o| o.lights);
        if let Some(lights) = &mut lights {
            light(engine, lights, LOOK_AHEAD.to_cycles());
        }
        run.started = engine.start();
        self.lights = lights.map(|lights| (lights, run.started));
        self.run = Some(run);
    }

    /// Slows down and ends; no more triggers.
    pub fn stop<E: Engine>(&mut self, engine: &mut E) {
        engine.cancel_triggers();
        self.darken();
        if let Some(run) = &mut self.run {
            run.pass = None;
            run.slow_down();
        }
    }

    /// Ends at once. Where the slide stands is known to the step; whether it followed is not.
    pub fn abort<E: Engine>(&mut self, engine: &mut E) {
        engine.cancel_triggers();
        self.darken();
        engine.abort();
        self.close(engine);
    }

    fn close<E: Engine>(&mut self, engine: &mut E) {
        if let Some(run) = self.run.take() {
            let done = engine.steps_done();
            self.position = run.position(done);
            self.last = (done, run.away);
        }
    }

    /// How many steps the last move took.
    pub const fn travelled(&self) -> u32 {
        self.last.0
    }

    /// Whether the last move led away from home.
    pub const fn went_away(&self) -> bool {
        self.last.1
    }

    /// Feeds the engine; how the move ended, if it did. When the ledger has no place for the next
    /// trigger, `full` is set, nothing more fires, and the move slows down.
    pub fn poll<E: Engine>(
        &mut self,
        now: Micros,
        engine: &mut E,
        ledger: &mut Ledger,
        full: &mut bool,
    ) -> Option<Ended> {
        let in_time = self.feed_lights(now, engine);
        let run = self.run.as_mut()?;
        if engine.halted() {
            self.close(engine);
            return Some(Ended::Halted);
        }
        if engine.underrun() || !in_time {
            let step = engine.steps_done();
            self.abort(engine);
            return Some(Ended::Failed(Fault::Underrun { step }));
        }
        if !run.fed {
            run.arm(engine, ledger);
            if run.unarmed_within_reach() {
                *full = true;
                engine.cancel_triggers();
                run.pass = None;
                run.slow_down();
            }
            let elapsed = now.since(run.started).after(LOOK_AHEAD);
            run.feed(engine, elapsed.to_cycles());
        }
        if run.fed && engine.idle() {
            let planned = run.segments.steps();
            let counted = engine.steps_done();
            self.close(engine);
            return Some(if planned == counted {
                Ended::Arrived
            } else {
                Ended::Failed(Fault::StepCount { planned, counted })
            });
        }
        if now.since(run.started) > run.overdue {
            self.abort(engine);
            return Some(Ended::Failed(Fault::Timeout {
                doing: Doing::Moving,
            }));
        }
        None
    }

    /// Feeds the laser's machine ahead of time; false if it has run dry before its words ended, so
    /// that the light would come late.
    fn feed_lights<E: Engine>(&mut self, now: Micros, engine: &mut E) -> bool {
        let Some((lights, started)) = &mut self.lights else {
            return true;
        };
        let elapsed = now.since(*started);
        let in_time = lights.ended() || elapsed.to_cycles() < lights.time();
        light(engine, lights, elapsed.after(LOOK_AHEAD).to_cycles());
        in_time
    }

    /// When [`Self::poll`] must be called again at the latest.
    pub fn wake<E: Engine>(&self, now: Micros, engine: &mut E) -> Option<Micros> {
        let soon = now.after(Micros(1000));
        let Some(run) = self.run.as_ref() else {
            // The last exposure's light outlasts the move.
            return self.lights.is_some_and(|(l, _)| !l.ended()).then_some(soon);
        };
        let fed_until = run.started.after(run.segments.time().to_micros_down());
        // Half the look-ahead is left then; at once if the last slice was not enough.
        let due = Micros(fed_until.0.saturating_sub(LOOK_AHEAD.0 / 2));
        Some(if run.fed {
            soon
        } else if engine.step_room() == 0 {
            now.after(Micros(200))
        } else {
            due.clamp(now, soon)
        })
    }
}

/// Pushes light words that begin before `until` (cycles since the start), a slice at most.
fn light<E: Engine>(engine: &mut E, lights: &mut Lights, until: Cycles) {
    let mut room = engine.light_room().min(SLICE);
    while room > 0 && lights.time() < until {
        let Some(word) = lights.next() else { return };
        engine.push_light(word);
        room -= 1;
    }
}

impl Run {
    fn position(&self, done: u32) -> Steps {
        let done = i32::try_from(done).unwrap_or(i32::MAX);
        let at = if self.away {
            self.begin.0.saturating_add(done)
        } else {
            self.begin.0.saturating_sub(done)
        };
        Steps(at)
    }

    fn slow_down(&mut self) {
        if !self.stopping && !self.fed {
            self.segments.stop();
        }
        self.stopping = true;
    }

    /// Arms triggers as far as the compare machine and the ledger take them.
    fn arm<E: Engine>(&mut self, engine: &mut E, ledger: &mut Ledger) {
        let Some(pass) = &mut self.pass else { return };
        while pass.gaps.position().is_some() && engine.compare_room() > 0 {
            if !ledger.reserve(pass.places) {
                return;
            }
            match pass.gaps.next() {
                Some(word) => engine.push_compare(word),
                None => return ledger.release(pass.places),
            }
        }
    }

    /// Whether the next trigger is not armed although the next words would take the slide past it.
    fn unarmed_within_reach(&self) -> bool {
        let Some(position) = self.pass.as_ref().and_then(|pass| pass.gaps.position()) else {
            return false;
        };
        let distance = i64::from(position.0) - i64::from(self.begin.0);
        distance <= i64::from(self.segments.steps()) + i64::from(self.reach())
    }

    /// Steps that the look-ahead can add in one call: at the fastest interval of the move.
    fn reach(&self) -> u32 {
        LOOK_AHEAD_CYCLES / self.segments.profile().cruise_interval().max(1)
    }

    /// Pushes words that begin before `until` (cycles since the start), a slice at most.
    fn feed<E: Engine>(&mut self, engine: &mut E, until: Cycles) {
        let mut room = engine.step_room().min(SLICE);
        while !self.fed && room > 0 && self.segments.time() < until {
            if let Some(word) = self.segments.next() {
                engine.push_step(word);
            }
            if self.segments.steps() >= self.segments.profile().steps() {
                self.fed = true;
                engine.finish();
            }
            room -= 1;
        }
    }
}
