//! The board: link, state machine, motion and laser in one place, driven by `poll`.

use crate::engine::Engine;
use crate::pins::Pins;
use cannula_shared::hello::{Identity, ResetReason};
use cannula_shared::units::Micros;
use embedded_hal::digital::{InputPin, OutputPin};

/// How the board is to start anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reboot {
    /// The same program.
    Program,
    /// The USB bootloader.
    Bootloader,
}

/// The motion board's logic.
#[derive(Debug)]
pub struct Board<O, I> {
    pins: Pins<O, I>,
    identity: Identity,
    reset: ResetReason,
}

impl<O: OutputPin, I: InputPin> Board<O, I> {
    /// A board that has just started: driver off before this returns.
    pub fn new(mut pins: Pins<O, I>, identity: Identity, reset: ResetReason) -> Self {
        pins.drive(false);
        Board {
            pins,
            identity,
            reset,
        }
    }

    /// Takes bytes from the link, in any pieces.
    pub fn receive(&mut self, _now: Micros, _bytes: &[u8]) {}

    /// Puts bytes for the link into `out`; how many (0 = nothing to say now).
    pub fn transmit(&mut self, _now: Micros, _out: &mut [u8]) -> usize {
        let _ = (self.identity, self.reset);
        0
    }

    /// Does what is due: a bounded amount of work. Returns when it wants to be called again at
    /// the latest (at most 5 ms on); earlier after any interrupt or received bytes.
    pub fn poll<E: Engine>(&mut self, now: Micros, _engine: &mut E) -> Micros {
        now.after(Micros::from_millis(1))
    }

    /// The link was cut (USB unplugged).
    pub fn link_reset(&mut self) {}

    /// Everything into its safe state, whatever was going on: laser off, no more steps, driver off.
    pub fn make_safe<E: Engine>(&mut self, engine: &mut E) {
        engine.laser(Micros(0));
        engine.abort();
        self.pins.drive(false);
    }

    /// Whether a restart was asked for and its reply is on the way.
    pub fn reboot_requested(&self) -> Option<Reboot> {
        None
    }
}
