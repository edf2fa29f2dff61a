//! The hardware that steps, triggers and holds the laser's lease, as the logic sees it.
//!
//! On the RP2040 these are PIO machines, DMA rings and interrupts; in the simulation a model of
//! them. Timing that matters is inside: the logic feeds words ahead and reads counts afterwards.

use crate::words::{CompareWord, LightWord, StepWord};
use cannula_shared::message::Inputs;
use cannula_shared::units::{Cycles, Micros};

/// The switch that the step machine itself looks at before each edge; while it is high, no
/// further edge comes and the machine is halted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HaltOn {
    /// The home switch: travelling towards home.
    Home,
    /// The far limit switch: travelling away.
    Limit,
}

/// What a move needs before its first word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MoveSetup {
    /// Which switch ends it in hardware.
    pub halt_on: HaltOn,
    /// Width of the trigger pulses.
    pub pulse: Cycles,
    /// The laser follows light words, from the first STEP edge on, until [`Engine::laser`] is called.
    pub lights: bool,
}

/// A trigger that has fired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriggerEdge {
    /// When its interrupt was served.
    pub time: Micros,
    /// Level of the laser's pad then.
    pub laser: bool,
}

/// A change of the camera's exposure-active signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExposureEdge {
    /// When.
    pub time: Micros,
    /// True as exposing begins.
    pub active: bool,
}

/// Step machine, compare machine, trigger pulse, laser lease, and inputs that interrupts have seen.
///
/// All calls return at once.
pub trait Engine {
    /// A move begins. The direction already stands on its pin. Empties the machines and rings,
    /// clears the step counter, `halted` and `underrun`.
    fn prepare(&mut self, setup: MoveSetup);
    /// How many step words can be pushed now.
    fn step_room(&mut self) -> usize;
    /// Adds a step word; only called when there is room.
    fn push_step(&mut self, word: StepWord);
    /// How many compare words can be pushed now.
    fn compare_room(&mut self) -> usize;
    /// Adds a compare word; only called when there is room.
    fn push_compare(&mut self, word: CompareWord);
    /// How many light words can be pushed now.
    fn light_room(&mut self) -> usize;
    /// Adds a light word; only called when there is room. Has no effect once the laser has been
    /// switched off by [`Engine::laser`], an interrupt or a fault.
    fn push_light(&mut self, word: LightWord);
    /// Step and compare machine start on what has been pushed. Returns now, from which the
    /// planned times count (a constant handful of cycles beside the truth).
    fn start(&mut self) -> Micros;
    /// The last word of the move has been pushed: from here on an empty step machine is no underrun.
    fn finish(&mut self);
    /// No more edges, at once; rings emptied; the counter stays readable.
    fn abort(&mut self);
    /// No more triggers, at once; steps go on.
    fn cancel_triggers(&mut self);
    /// STEP edges since `prepare`; exact when idle or halted.
    fn steps_done(&mut self) -> u32;
    /// Everything pushed has been executed, or the move was aborted or halted.
    fn idle(&mut self) -> bool;
    /// The machine's own stop at the switch given by `prepare`.
    fn halted(&mut self) -> bool;
    /// The step machine starved between `start` and `finish`.
    fn underrun(&mut self) -> bool;
    /// Fires one trigger pulse now; reported by `next_trigger` as any other.
    fn fire(&mut self, pulse: Cycles);
    /// The next trigger that has fired, oldest first.
    fn next_trigger(&mut self) -> Option<TriggerEdge>;
    /// The next change of the exposure-active signal, oldest first.
    fn next_exposure(&mut self) -> Option<ExposureEdge>;
    /// The laser stays on for this long from now, whatever was left before; zero = off now. Light
    /// words are forgotten.
    fn laser(&mut self, on_for: Micros);
    /// The level of the laser's pad.
    fn lit(&mut self) -> bool;
    /// Inputs seen active since the last call, however short (E-stop, interlock, and both switches).
    fn latched(&mut self) -> Inputs;
}
