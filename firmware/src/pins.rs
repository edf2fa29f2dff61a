//! Plain inputs and outputs, through embedded-hal's traits.

use cannula_shared::message::Inputs;
use embedded_hal::digital::{InputPin, OutputPin};

/// The pins that the logic itself sets and reads; STEP, TRIGGER and LASER belong to the engine.
#[derive(Debug)]
pub struct Pins<O, I> {
    /// DIR: high = away from home (before the configured inversion).
    pub direction: O,
    /// ENABLE: low = driver on.
    pub enable: O,
    /// The heartbeat LED.
    pub led: O,
    /// Home switch: high = reached, or a broken wire.
    pub home: I,
    /// Far limit switch: the same.
    pub limit: I,
    /// Emergency stop: high = stop.
    pub estop: I,
    /// Laser interlock: high = open.
    pub interlock: I,
    /// Camera's exposure-active: high while exposing.
    pub exposure: I,
}

impl<O: OutputPin, I: InputPin> Pins<O, I> {
    /// The inputs as they are now. A pin that cannot be read counts as active (its safe side).
    pub fn read(&mut self) -> Inputs {
        Inputs {
            home: self.home.is_high().unwrap_or(true),
            limit: self.limit.is_high().unwrap_or(true),
            estop: self.estop.is_high().unwrap_or(true),
            interlock: self.interlock.is_high().unwrap_or(true),
            exposure: self.exposure.is_high().unwrap_or(false),
        }
    }

    /// Driver on or off. Whether the pin took it.
    pub fn drive(&mut self, on: bool) -> bool {
        let set = if on {
            self.enable.set_low()
        } else {
            self.enable.set_high()
        };
        set.is_ok()
    }

    /// Sets the DIR pin. Whether the pin took it.
    pub fn direct(&mut self, high: bool) -> bool {
        let set = if high {
            self.direction.set_high()
        } else {
            self.direction.set_low()
        };
        set.is_ok()
    }

    /// Sets the LED; a dead LED harms nobody.
    pub fn light(&mut self, on: bool) {
        let _ = if on {
            self.led.set_high()
        } else {
            self.led.set_low()
        };
    }
}
