//! The library's [`Engine`], on the state machines.

use cannula_firmware::engine::{Engine, ExposureEdge, HaltOn, MoveSetup, TriggerEdge};
use cannula_firmware::words::{CompareWord, LightWord, StepWord};
use cannula_shared::message::Inputs;
use cannula_shared::units::{Cycles, Micros};
use embassy_time::Instant;

use crate::interrupts::{self, EXPOSURES, TRIGGERS};
use crate::machines::{self, COMPARES, LIGHTS, STEPS, pin};

/// The longest lease that the laser's machine is given.
const LONGEST_LEASE: Micros = Micros(25_000);

/// Microseconds since boot.
pub fn now() -> Micros {
    Micros(Instant::now().as_micros())
}

/// Stepping, triggering and the laser's lease.
pub struct Hardware {
    halt_on: HaltOn,
    pulse: Cycles,
    running: bool,
    finished: bool,
    underrun: bool,
}

impl Hardware {
    /// The machines must have been set up.
    pub const fn new() -> Self {
        Self {
            halt_on: HaltOn::Limit,
            pulse: Cycles(0),
            running: false,
            finished: true,
            underrun: false,
        }
    }

    /// Gives what the logic has pushed to the hardware; after every turn of the logic.
    pub fn pump(&mut self) {
        if self.running {
            machines::pump();
        }
    }

    fn set_pulse(&mut self, pulse: Cycles) {
        // A pulse that is under way would be cut: only when the width changes.
        if self.pulse != pulse {
            self.pulse = pulse;
            machines::set_pulse(u32::try_from(pulse.0).unwrap_or(u32::MAX));
        }
    }
}

impl Engine for Hardware {
    fn prepare(&mut self, setup: MoveSetup) {
        machines::prepare(setup.halt_on);
        if setup.lights {
            machines::play_lights();
        }
        self.set_pulse(setup.pulse);
        self.halt_on = setup.halt_on;
        self.running = false;
        self.finished = false;
        self.underrun = false;
    }

    fn step_room(&mut self) -> usize {
        STEPS.room()
    }

    fn push_step(&mut self, word: StepWord) {
        // Only called when there is room; a word lost all the same shows as a short count of steps.
        let _ = STEPS.push(word.raw());
    }

    fn compare_room(&mut self) -> usize {
        COMPARES.room()
    }

    fn push_compare(&mut self, word: CompareWord) {
        let _ = COMPARES.push(word.raw());
    }

    fn light_room(&mut self) -> usize {
        LIGHTS.room()
    }

    fn push_light(&mut self, word: LightWord) {
        if machines::plays_lights() {
            let _ = LIGHTS.push(word.raw());
        }
    }

    fn start(&mut self) -> Micros {
        self.running = true;
        machines::start();
        now()
    }

    fn finish(&mut self) {
        // The last word may not have reached the machine yet, but if it had starved before, it shows.
        let _ = self.underrun();
        self.finished = true;
    }

    fn abort(&mut self) {
        self.running = false;
        self.finished = true;
        machines::abort();
    }

    fn cancel_triggers(&mut self) {
        machines::cancel_triggers();
    }

    fn steps_done(&mut self) -> u32 {
        machines::steps_done()
    }

    fn idle(&mut self) -> bool {
        !self.running || machines::halted() || machines::idle()
    }

    fn halted(&mut self) -> bool {
        machines::halted()
    }

    fn underrun(&mut self) -> bool {
        if self.running && !self.finished && machines::starved() {
            self.underrun = true;
        }
        self.underrun
    }

    fn fire(&mut self, pulse: Cycles) {
        self.set_pulse(pulse);
        machines::fire();
    }

    fn next_trigger(&mut self) -> Option<TriggerEdge> {
        let seen = TRIGGERS.try_receive().ok()?;
        Some(TriggerEdge {
            time: Micros(seen.micros),
            laser: seen.laser,
        })
    }

    fn next_exposure(&mut self) -> Option<ExposureEdge> {
        let seen = EXPOSURES.try_receive().ok()?;
        Some(ExposureEdge {
            time: Micros(seen.micros),
            active: seen.active,
        })
    }

    fn laser(&mut self, on_for: Micros) {
        let on_for = on_for.min(LONGEST_LEASE);
        machines::lease_laser(u32::try_from(on_for.0).unwrap_or(0));
    }

    fn lit(&mut self) -> bool {
        machines::level(pin::LASER)
    }

    fn latched(&mut self) -> Inputs {
        let seen = machines::take_input_edges();
        let (estop, interlock) = interrupts::take_latched();
        let halted = machines::halted();
        Inputs {
            home: seen.home || (halted && self.halt_on == HaltOn::Home),
            limit: seen.limit || (halted && self.halt_on == HaltOn::Limit),
            estop: seen.estop || estop,
            interlock: seen.interlock || interlock,
            exposure: false,
        }
    }
}
