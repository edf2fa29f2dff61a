//! The hardware that the logic drives, by the semantics of the board's PIO programs: step
//! machine, compare machine, trigger pulse, laser lease; and the world that its edges move.

use super::trace::{Pin, Trace};
use super::world::{Contact, Exposed, Rig};
use super::{INTERRUPT_LATENCY, Wires};
use cannula_firmware::engine::{Engine, ExposureEdge, HaltOn, MoveSetup, TriggerEdge};
use cannula_firmware::words::{CompareWord, LIGHT_DELAY, LightWord, StepWord};
use cannula_shared::message::Inputs;
use cannula_shared::units::{CYCLES_PER_MICRO, Cycles, Micros};
use std::collections::VecDeque;

/// Cycles from a STEP edge to the trigger that it makes, as the binary's programs do it.
pub const TRIGGER_DELAY: u64 = 7;
/// Width of a STEP pulse, cycles.
const STEP_WIDTH: u64 = 32;
/// Step words that the ring holds.
pub const RING_STEPS: usize = 1024;
/// Compare words that the ring holds.
const RING_COMPARE: usize = 64;
/// Light words that the ring holds.
const RING_LIGHTS: usize = 256;
const NEVER: u64 = u64::MAX;

/// What the laser's machine makes of light words.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Playing {
    /// Nothing: it holds a lease, or is dark.
    No,
    /// It waits for the move's first STEP edge.
    Waits,
    /// It plays them.
    Plays,
}

pub(super) struct Machines {
    pub rig: Rig,
    pub trace: Trace,
    pub exposed: Vec<Exposed>,
    pub cpu_alive: bool,
    now: u64,
    booted: u64,
    // Step machine.
    running: bool,
    words: VecDeque<StepWord>,
    /// Edges left of the word under way, and its interval.
    left: u32,
    interval: u64,
    next_edge: u64,
    /// Which way the last edge moved the slide: 1 away from the switch, −1 towards it.
    heading: f64,
    last_edge: u64,
    step_fall: u64,
    steps: u32,
    halt_on: HaltOn,
    halted: bool,
    finished: bool,
    underrun: bool,
    // Compare machine and trigger.
    gaps: VecDeque<CompareWord>,
    to_trigger: Option<u64>,
    comparing: bool,
    pulse: u64,
    trigger_rise: u64,
    trigger_fall: u64,
    triggers: u64,
    // Laser.
    lease_end: u64,
    playing: Playing,
    lights: VecDeque<LightWord>,
    next_light: u64,
    // Camera.
    exposure_edges: Vec<(u64, bool)>,
    // Switches.
    home: Contact,
    limit: Contact,
    contact_change: u64,
    // What interrupts have seen.
    irq: bool,
    latched: Inputs,
    fired: VecDeque<TriggerEdge>,
    exposures: VecDeque<ExposureEdge>,
}

impl Machines {
    pub fn new(rig: Rig) -> Self {
        Machines {
            rig,
            trace: Trace::default(),
            exposed: Vec::new(),
            cpu_alive: true,
            now: 0,
            booted: 0,
            running: false,
            words: VecDeque::new(),
            left: 0,
            interval: 0,
            next_edge: NEVER,
            heading: 0.0,
            last_edge: 0,
            step_fall: NEVER,
            steps: 0,
            halt_on: HaltOn::Limit,
            halted: false,
            finished: false,
            underrun: false,
            gaps: VecDeque::new(),
            to_trigger: None,
            comparing: false,
            pulse: 0,
            trigger_rise: NEVER,
            trigger_fall: NEVER,
            triggers: 0,
            lease_end: NEVER,
            playing: Playing::No,
            lights: VecDeque::new(),
            next_light: NEVER,
            exposure_edges: Vec::new(),
            home: Contact::default(),
            limit: Contact::default(),
            contact_change: NEVER,
            irq: false,
            latched: Inputs::NONE,
            fired: VecDeque::new(),
            exposures: VecDeque::new(),
        }
    }

    /// The chip's reset: machines stopped, outputs released.
    pub fn reset(&mut self, now: u64) {
        self.now = now;
        self.stop_steps();
        self.stop_compare();
        self.trigger_rise = NEVER;
        self.trigger_fall = NEVER;
        self.step_fall = NEVER;
        self.trace.record(now, Pin::Step, false);
        self.trace.record(now, Pin::Trigger, false);
        self.laser_off(now);
        self.fired.clear();
        self.exposures.clear();
        self.latched = Inputs::NONE;
        self.halted = false;
        self.underrun = false;
        self.steps = 0;
        self.cpu_alive = true;
    }

    pub fn begin_poll(&mut self, now: u64, booted: u64) {
        self.now = now;
        self.booted = booted;
    }

    /// Whether an interrupt has come since the last call.
    pub fn interrupt(&mut self) -> bool {
        std::mem::take(&mut self.irq)
    }

    fn clock(&self, cycle: u64) -> Micros {
        Cycles(cycle.saturating_sub(self.booted)).to_micros_down()
    }

    /// Reads the switches and buttons into the wires.
    pub fn sense(&mut self, now: u64, wires: &Wires) {
        let home = self.home.level(self.rig.home, -self.rig.slide, now);
        let limit = self
            .limit
            .level(self.rig.limit, self.rig.slide - self.rig.far, now);
        let (estop, interlock) = (self.rig.estop, self.rig.interlock_open);
        let contacts = [self.home.next_change(now), self.limit.next_change(now)];
        self.contact_change = contacts.into_iter().flatten().min().unwrap_or(NEVER);
        for (wire, pin, level) in [
            (&wires.home, Pin::Home, home),
            (&wires.limit, Pin::Limit, limit),
            (&wires.estop, Pin::EStop, estop),
            (&wires.interlock, Pin::Interlock, interlock),
        ] {
            if wire.get() != level {
                wire.set(level);
                self.irq = true;
            }
            self.trace.record(now, pin, level);
        }
        self.latched = self.latched.or(Inputs {
            home,
            limit,
            estop,
            interlock,
            exposure: false,
        });
        if interlock {
            // Wired into the laser's own machine: no CPU needed.
            self.laser_off(now);
        }
        if estop && self.cpu_alive {
            // The interrupt routine.
            self.laser_off(now);
            self.stop_steps();
            self.stop_compare();
        }
    }

    fn laser_forget_lights(&mut self) {
        self.playing = Playing::No;
        self.lights.clear();
        self.next_light = NEVER;
    }

    fn laser_off(&mut self, now: u64) {
        self.lease_end = NEVER;
        self.laser_forget_lights();
        self.trace.record(now, Pin::Laser, false);
    }

    fn stop_steps(&mut self) {
        self.running = false;
        self.words.clear();
        self.left = 0;
        self.next_edge = NEVER;
    }

    fn stop_compare(&mut self) {
        self.gaps.clear();
        self.to_trigger = None;
        self.comparing = false;
    }

    /// Lets time pass from `now` to `until`, or to the first interrupt; returns where it is then.
    pub fn advance(&mut self, now: u64, until: u64, wires: &Wires, cpu_alive: bool) -> u64 {
        self.now = now;
        loop {
            let next = self
                .next_edge
                .min(self.trigger_rise)
                .min(self.trigger_fall)
                .min(self.step_fall)
                .min(self.lease_end)
                .min(self.next_light)
                .min(self.contact_change)
                .min(self.exposure_edges.first().map_or(NEVER, |e| e.0));
            if next > until {
                self.now = until;
                return until;
            }
            self.now = next.max(now);
            self.event(next, wires);
            if self.irq && cpu_alive {
                return self.now;
            }
        }
    }

    fn event(&mut self, at: u64, wires: &Wires) {
        if at == self.step_fall {
            self.step_fall = NEVER;
            self.trace.record(at, Pin::Step, false);
        } else if at == self.trigger_rise {
            self.trigger_rise = NEVER;
            self.trigger(at);
        } else if at == self.trigger_fall {
            self.trigger_fall = NEVER;
            self.trace.record(at, Pin::Trigger, false);
        } else if at == self.lease_end {
            self.laser_off(at);
        } else if at == self.next_light {
            self.light(at);
        } else if at == self.contact_change {
            self.sense(at, wires);
        } else if self.exposure_edges.first().is_some_and(|e| e.0 == at) {
            let (_, active) = self.exposure_edges.remove(0);
            wires.exposure.set(active);
            self.trace.record(at, Pin::Exposure, active);
            self.exposures.push_back(ExposureEdge {
                time: self.clock(at + INTERRUPT_LATENCY.0),
                active,
            });
            self.irq = true;
        } else if at == self.next_edge {
            self.edge(at, wires);
        }
    }

    /// A STEP edge is due.
    fn edge(&mut self, at: u64, wires: &Wires) {
        let ahead = match self.halt_on {
            HaltOn::Home => wires.home.get(),
            HaltOn::Limit => wires.limit.get(),
        };
        if ahead {
            self.halted = true;
            self.stop_steps();
            self.stop_compare();
            self.irq = true;
            return;
        }
        self.trace.record(at, Pin::Step, true);
        self.step_fall = at + STEP_WIDTH;
        self.steps = self.steps.wrapping_add(1);
        self.heading = 0.0;
        if !wires.enable.get() {
            let away = wires.direction.get();
            self.rig.slide += if away { 1 } else { -1 };
            self.heading = if away { 1.0 } else { -1.0 };
        }
        if self.comparing {
            if self.to_trigger.is_none() {
                self.to_trigger = self.gaps.pop_front().map(CompareWord::gap);
            }
            if let Some(gap) = &mut self.to_trigger {
                *gap -= 1;
                if *gap == 0 {
                    self.to_trigger = None;
                    self.trigger_rise = at + TRIGGER_DELAY;
                }
            }
        }
        if self.playing == Playing::Waits {
            self.playing = Playing::Plays;
            self.next_light = at + u64::from(LIGHT_DELAY);
        }
        self.last_edge = at;
        self.left -= 1;
        self.next_edge = NEVER;
        self.load(at);
        // The switches move under the slide.
        let near = |distance: i64| distance.abs() <= 4096;
        if near(self.rig.slide) || near(self.rig.slide - self.rig.far) {
            self.sense(at, wires);
        }
    }

    /// The next light word, or darkness where there is none.
    fn light(&mut self, at: u64) {
        let word = self.lights.pop_front();
        let lit = word.is_some_and(LightWord::lit) && !self.rig.interlock_open;
        self.trace.record(at, Pin::Laser, lit);
        self.next_light = word.map_or(NEVER, |w| at + u64::from(w.cycles()));
    }

    /// The next edge's time, from the word under way or the next one; `from` is the edge before
    /// (or the moment at which a starved machine gets its word).
    fn load(&mut self, from: u64) {
        if self.left == 0 {
            match self.words.pop_front() {
                Some(word) => {
                    self.left = word.steps();
                    self.interval = u64::from(word.interval());
                }
                None => {
                    self.underrun |= !self.finished;
                    return;
                }
            }
        }
        self.next_edge = from + self.interval;
    }

    /// An exposure that no trigger has begun.
    pub fn expose(&mut self, at: u64) {
        let laser = self.trace.level(Pin::Laser);
        self.exposed.push(Exposed {
            trigger: None,
            cycle: at,
            slide: self.rig.slide,
            speed: self.speed(),
            laser,
        });
    }

    /// Of the slide between the edge before and the one to come, steps/s.
    fn speed(&self) -> f64 {
        if self.next_edge == NEVER || self.halted {
            return 0.0;
        }
        let interval = self.next_edge.saturating_sub(self.last_edge).max(1);
        self.heading * 1e6 * CYCLES_PER_MICRO as f64 / interval as f64
    }

    fn trigger(&mut self, at: u64) {
        self.trace.record(at, Pin::Trigger, true);
        self.trigger_fall = at + self.pulse;
        let number = self.triggers;
        self.triggers += 1;
        let laser = self.trace.level(Pin::Laser);
        self.fired.push_back(TriggerEdge {
            time: self.clock(at + INTERRUPT_LATENCY.0),
            laser,
        });
        self.irq = true;
        if self.rig.lost_exposures.contains(&number) {
            return;
        }
        self.exposed.push(Exposed {
            trigger: Some(number),
            cycle: at,
            slide: self.rig.slide,
            speed: self.speed(),
            laser,
        });
        if let Some(delay) = self.rig.exposure_delay {
            let begin = at + delay.to_cycles().0;
            self.exposure_edges.push((begin, true));
            self.exposure_edges
                .push((begin + self.rig.exposure.to_cycles().0, false));
            self.exposure_edges.sort_by_key(|e| e.0);
        }
    }
}

impl Engine for Machines {
    fn prepare(&mut self, setup: MoveSetup) {
        self.stop_steps();
        self.stop_compare();
        self.halt_on = setup.halt_on;
        self.pulse = setup.pulse.0;
        self.steps = 0;
        self.halted = false;
        self.finished = false;
        self.underrun = false;
        if setup.lights {
            self.laser_off(self.now);
            self.playing = Playing::Waits;
        }
    }

    fn step_room(&mut self) -> usize {
        RING_STEPS - self.words.len().min(RING_STEPS)
    }

    fn push_step(&mut self, word: StepWord) {
        // Through the bits, as the machine gets it.
        self.words.push_back(StepWord::from_raw(word.raw()));
        if self.running && self.next_edge == NEVER && !self.halted {
            self.load(self.now);
        }
    }

    fn compare_room(&mut self) -> usize {
        RING_COMPARE - self.gaps.len().min(RING_COMPARE)
    }

    fn push_compare(&mut self, word: CompareWord) {
        self.gaps.push_back(CompareWord::from_raw(word.raw()));
    }

    fn light_room(&mut self) -> usize {
        RING_LIGHTS - self.lights.len().min(RING_LIGHTS)
    }

    fn push_light(&mut self, word: LightWord) {
        if self.playing == Playing::No {
            return;
        }
        self.lights.push_back(LightWord::from_raw(word.raw()));
        if self.playing == Playing::Plays && self.next_light == NEVER {
            self.light(self.now);
        }
    }

    fn start(&mut self) -> Micros {
        self.running = true;
        self.comparing = true;
        if self.left == 0 && !self.words.is_empty() {
            self.load(self.now);
        }
        self.clock(self.now)
    }

    fn finish(&mut self) {
        self.finished = true;
    }

    fn abort(&mut self) {
        self.stop_steps();
        self.stop_compare();
        self.finished = true;
    }

    fn cancel_triggers(&mut self) {
        self.stop_compare();
    }

    fn steps_done(&mut self) -> u32 {
        self.steps
    }

    fn idle(&mut self) -> bool {
        self.next_edge == NEVER && self.words.is_empty() && self.step_fall == NEVER
    }

    fn halted(&mut self) -> bool {
        self.halted
    }

    fn underrun(&mut self) -> bool {
        self.underrun
    }

    fn fire(&mut self, pulse: Cycles) {
        self.pulse = pulse.0;
        self.trigger_rise = self.now + TRIGGER_DELAY;
    }

    fn next_trigger(&mut self) -> Option<TriggerEdge> {
        self.fired.pop_front()
    }

    fn next_exposure(&mut self) -> Option<ExposureEdge> {
        self.exposures.pop_front()
    }

    fn laser(&mut self, on_for: Micros) {
        if on_for.0 == 0 || self.rig.interlock_open {
            self.laser_off(self.now);
        } else {
            self.laser_forget_lights();
            self.lease_end = self.now + on_for.to_cycles().0;
            self.trace.record(self.now, Pin::Laser, true);
        }
    }

    fn lit(&mut self) -> bool {
        self.trace.level(Pin::Laser)
    }

    fn latched(&mut self) -> Inputs {
        // Levels that still stand are read from the pins.
        std::mem::replace(&mut self.latched, Inputs::NONE)
    }
}
