//! Homing: fast to the switch, back off, slowly to it again, and off to zero.
//!
//! ```text
//!            fast ──►│           The switch's edge by the slow touch is at −clearance;
//!     back off ◄─────│           the slide then goes to 0, clear of the switch.
//!            slow ──►│
//!     ◄── to zero ───│
//! ```
//!
//! Each leg is bounded. What can go wrong is told apart: the switch is not found, it stays
//! pressed, or its two touches lie too far apart.

use crate::motion::Ended;
use crate::profile::{Profile, interval_of};
use crate::ramp::Ramp;
use cannula_shared::config::Config;
use cannula_shared::error::Fault;
use cannula_shared::units::{Micros, Steps};

/// After each leg the slide rests: contacts and mechanics stop ringing.
const REST: Micros = Micros(20_000);

/// A leg of the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leg {
    /// The driver has been switched on and takes hold.
    Begin,
    /// Off a switch that was pressed from the start.
    Free,
    Fast,
    BackOff,
    Slow,
    ToZero,
}

/// Homing under way.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    leg: Leg,
    rest_until: Option<Micros>,
    apart: i32,
}

/// What homing wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing yet; ask again by then.
    Rest(Micros),
    /// Start this move.
    Move {
        /// Its profile.
        profile: Profile,
        /// Away from home or towards it.
        away: bool,
    },
    /// Wait for the move under way.
    Wait,
    /// Done; second touch minus first, steps.
    Homed {
        /// Steps.
        apart: i32,
    },
    /// Failed.
    Failed(Fault),
}

impl Homing {
    /// Begins; the driver has just been switched on.
    pub fn new(now: Micros) -> Self {
        Homing {
            leg: Leg::Begin,
            rest_until: Some(now.after(REST)),
            apart: 0,
        }
    }

    /// The leg's move has ended after `steps` steps; `position` is where the slide stands by the
    /// caller's count, which homing sets at the second touch.
    pub fn ended(
        &mut self,
        now: Micros,
        config: &Config,
        ended: Ended,
        steps: u32,
    ) -> Result<Option<Steps>, Fault> {
        self.rest_until = Some(now.after(REST));
        let r = config.steps_per_mm;
        let fault = match (self.leg, ended) {
            (_, Ended::Failed(fault)) => fault,
            (Leg::Fast | Leg::Slow, Ended::Arrived) => Fault::HomeNeverFound { travelled: steps },
            (Leg::Fast, Ended::Halted) => return Ok(None),
            (Leg::Slow, Ended::Halted) => {
                let backed_off = self.back_off(config);
                self.apart =
                    i32::try_from(i64::from(steps) - i64::from(backed_off)).unwrap_or(i32::MAX);
                let tolerance =
                    u32::try_from(r.steps_up(config.homing_tolerance_um)).unwrap_or(u32::MAX);
                if self.apart.unsigned_abs() <= tolerance {
                    let clearance = i32::try_from(config.clearance_steps()).unwrap_or(i32::MAX);
                    return Ok(Some(Steps(-clearance)));
                }
                Fault::HomeBounced {
                    apart: self.apart,
                    tolerance,
                }
            }
            (Leg::Free | Leg::BackOff | Leg::ToZero, Ended::Arrived) => return Ok(None),
            // Moving away, the machine watches the far switch.
            (_, Ended::Halted) => Fault::Limit,
            (Leg::Begin, Ended::Arrived) => Fault::Timeout {
                doing: cannula_shared::error::Doing::Homing,
            },
        };
        Err(fault)
    }

    /// A slide that starts on the switch may stand deep in it.
    fn free(&self, config: &Config) -> u32 {
        self.back_off(config)
            .max(config.clearance_steps())
            .saturating_mul(4)
    }

    fn back_off(&self, config: &Config) -> u32 {
        u32::try_from(config.steps_per_mm.steps_up(config.homing_backoff_um)).unwrap_or(u32::MAX)
    }

    /// What to do at rest.
    pub fn next(&mut self, now: Micros, config: &Config, home: bool, moving: bool) -> Next {
        if moving {
            return Next::Wait;
        }
        match self.rest_until {
            Some(until) if now < until => return Next::Rest(until),
            _ => {}
        }
        let backed_off = self.back_off(config);
        let steps = |um: u32| u32::try_from(config.steps_per_mm.steps_up(um)).unwrap_or(u32::MAX);
        let (leg, distance, speed, away) = match self.leg {
            Leg::Begin if home => (Leg::Free, self.free(config), config.homing_fast_um_s, true),
            Leg::Free if home => {
                return Next::Failed(Fault::HomeStuck {
                    backed_off: self.free(config),
                });
            }
            Leg::BackOff | Leg::ToZero if home => {
                return Next::Failed(Fault::HomeStuck { backed_off });
            }
            Leg::Begin | Leg::Free => (
                Leg::Fast,
                steps(config.homing_travel_um),
                config.homing_fast_um_s,
                false,
            ),
            Leg::Fast => (Leg::BackOff, backed_off, config.homing_fast_um_s, true),
            Leg::BackOff => {
                // Beyond this, the touches would lie too far apart anyway.
                let farthest = backed_off
                    .saturating_add(steps(config.homing_tolerance_um))
                    .saturating_add(1);
                (Leg::Slow, farthest, config.homing_slow_um_s, false)
            }
            Leg::Slow => (
                Leg::ToZero,
                config.clearance_steps(),
                config.homing_fast_um_s,
                true,
            ),
            Leg::ToZero => return Next::Homed { apart: self.apart },
        };
        self.leg = leg;
        self.rest_until = None;
        let interval = interval_of(config.step_rate(speed));
        Next::Move {
            profile: Profile::new(Ramp::new(config.acceleration()), distance, interval),
            away,
        }
    }
}
