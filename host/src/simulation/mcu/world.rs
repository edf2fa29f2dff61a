//! What is around the board: the slide with its switches, the camera, and the wires.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use cannula_shared::units::Micros;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

/// A wire with a level.
#[derive(Clone, Debug, Default)]
pub(super) struct Wire(Arc<AtomicBool>);

impl Wire {
    pub fn get(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
    pub fn set(&self, high: bool) {
        self.0.store(high, Ordering::Relaxed);
    }
}

impl ErrorType for Wire {
    type Error = Infallible;
}

impl OutputPin for Wire {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl InputPin for Wire {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.get())
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.get())
    }
}

/// A switch at an end of the slide (normally closed: high = reached).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// Reached where it stands; its contact bounces for a while after each change.
    Working {
        /// For how long.
        bounce: Micros,
    },
    /// Always says this (a welded contact, a broken wire, a bridged input).
    Stuck(bool),
    /// Loose: after each release it has moved by so many steps towards the slide.
    Loose {
        /// How far it moves each time.
        by: i32,
    },
}

/// The rig around the board.
#[derive(Clone, Debug)]
pub struct Rig {
    /// Where the slide stands: steps away from the edge of the home switch.
    pub slide: i64,
    /// Where the far switch stands.
    pub far: i64,
    /// The home switch.
    pub home: Switch,
    /// The far switch.
    pub limit: Switch,
    /// Emergency stop pressed.
    pub estop: bool,
    /// Laser interlock open.
    pub interlock_open: bool,
    /// From trigger to exposure; `None` = the camera's output is not wired.
    pub exposure_delay: Option<Micros>,
    /// How long an exposure lasts.
    pub exposure: Micros,
    /// Triggers (counted from power-on) that the camera misses.
    pub lost_exposures: Vec<u64>,
}

impl Default for Rig {
    /// A slide of 330 mm at 800 steps/mm, standing at 20 mm; all well; exposure output wired.
    fn default() -> Self {
        Rig {
            slide: 16_000,
            far: 264_000,
            home: Switch::Working { bounce: Micros(0) },
            limit: Switch::Working { bounce: Micros(0) },
            estop: false,
            interlock_open: false,
            exposure_delay: Some(Micros(50)),
            exposure: Micros(5_000),
            lost_exposures: Vec::new(),
        }
    }
}

/// A frame that the camera has exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposed {
    /// Number of the trigger since power-on; `None`: the camera began by itself.
    pub trigger: Option<u64>,
    /// When the trigger rose (or the exposure began by itself), in cycles.
    pub cycle: u64,
    /// Where the slide stood then: steps away from the edge of the home switch.
    pub slide: i64,
    /// How fast it moved then, steps/s away from the switch; 0 at rest.
    pub speed: f64,
    /// Whether the laser was on.
    pub laser: bool,
}

/// A contact with its bouncing.
#[derive(Clone, Debug, Default)]
pub(super) struct Contact {
    reached: bool,
    /// Bounces until then.
    until: u64,
    moved: i64,
    slips: bool,
}

/// A bouncing contact changes this often: every 40 µs.
const CHATTER: u64 = 5_000;

impl Contact {
    /// Level at `now`, where the slide stands `beyond` steps past the switch's edge (≥ 0 = reached).
    pub fn level(&mut self, switch: Switch, beyond: i64, now: u64) -> bool {
        match switch {
            Switch::Stuck(level) => level,
            Switch::Working { bounce } => {
                self.change(beyond >= 0, now, bounce.to_cycles().0);
                // Alternates, ending on the new level.
                if now < self.until {
                    ((self.until - now) / CHATTER) % 2 == u64::from(!self.reached)
                } else {
                    self.reached
                }
            }
            Switch::Loose { by } => {
                let was = self.reached;
                self.change(beyond + self.moved >= 0, now, 0);
                self.slips |= was && !self.reached;
                // It slips once the slide has let go of it by more than that.
                if self.slips && beyond + self.moved + i64::from(by) < -16 {
                    self.slips = false;
                    self.moved += i64::from(by);
                }
                self.reached
            }
        }
    }

    fn change(&mut self, reached: bool, now: u64, bounce: u64) {
        if reached != self.reached {
            self.reached = reached;
            self.until = now + bounce;
        }
    }

    /// When the level changes by itself.
    pub fn next_change(&self, now: u64) -> Option<u64> {
        (now < self.until).then(|| self.until - ((self.until - now - 1) / CHATTER) * CHATTER)
    }
}
