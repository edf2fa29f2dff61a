//! What each command does, and when it is refused.

use crate::board::{Board, Job, Reboot, Stop};
use crate::engine::Engine;
use crate::homing::Homing;
use crate::profile::interval_of;
use crate::safety::{LaserWish, laser_permitted};
use crate::scan::Scan;
use crate::scan_plan::{ScanCheck, ScanPlan, interval_for, move_profile};
use cannula_shared::config::Config;
use cannula_shared::error::{Input, Refusal};
use cannula_shared::message::{Command, Event, Reply, ScanRequest, State, Status};
use cannula_shared::units::{Cycles, Micros, Steps};
use embedded_hal::digital::{InputPin, OutputPin};

impl<O: OutputPin, I: InputPin> Board<O, I> {
    /// Carries a command out and answers it; only a scan is answered later, when it is checked.
    pub(crate) fn command<E: Engine>(&mut self, now: Micros, engine: &mut E, command: Command) {
        let reply = match command {
            Command::Status => Ok(Reply::Status(self.status(now, engine))),
            Command::Configure(config) => self.configure(config),
            Command::Stop => {
                self.laser_by_hand = None;
                self.stop_job(now, engine, Stop::Command);
                Ok(Reply::Done)
            }
            Command::Rearm => self.rearm(),
            Command::Home => self.home(now, engine),
            Command::MoveTo {
                position,
                speed_um_s,
            } => self.move_to(engine, position, speed_um_s),
            Command::Jog { by, speed_um_s } => {
                let target = i64::from(self.motion.position(engine).0) + i64::from(by.0);
                let clamped = target.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
                // (In range of i32 by the line above.)
                self.move_to(
                    engine,
                    Steps(i32::try_from(clamped).unwrap_or_default()),
                    speed_um_s,
                )
            }
            Command::Scan(request) => match self.scan(engine, request) {
                Ok(()) => return,
                Err(refusal) => Err(refusal),
            },
            Command::Laser { on } => self.laser(now, on),
            Command::Trigger => self.trigger(engine),
            Command::Release => self.release(),
            Command::Reboot { bootloader } => self.at_rest().map(|_| {
                self.reboot = Some(if bootloader {
                    Reboot::Bootloader
                } else {
                    Reboot::Program
                });
                self.laser_by_hand = None;
                self.set_driver(false);
                self.motion.forget();
                Reply::Done
            }),
        };
        self.link.answer(reply.unwrap_or_else(Reply::Refused));
    }

    fn not_now(&self) -> Refusal {
        Refusal::NotNow {
            doing: self.doing(),
        }
    }

    /// Nothing under way (in any state).
    fn at_rest(&self) -> Result<(), Refusal> {
        if matches!(self.job, Job::None)
            && !self.motion.moving()
            && self.check.is_none()
            && self.state != State::Stopping
        {
            Ok(())
        } else {
            Err(self.not_now())
        }
    }

    /// Configured, at rest, not in fault, and room in the ledger for a job's events.
    fn available(&self) -> Result<Config, Refusal> {
        let config = self.config.ok_or(Refusal::NotConfigured)?;
        self.at_rest()?;
        if !matches!(self.state, State::Idle | State::Ready)
            || self.reboot.is_some()
            || !self.link.ledger.has_room()
        {
            return Err(self.not_now());
        }
        Ok(config)
    }

    /// As [`Self::available`], and the position is known.
    fn ready(&self) -> Result<Config, Refusal> {
        let config = self.available()?;
        if self.state != State::Ready || !self.motion.known() {
            Err(Refusal::NotHomed)
        } else {
            Ok(config)
        }
    }

    fn configure(&mut self, config: Config) -> Result<Reply, Refusal> {
        self.at_rest()?;
        if matches!(self.state, State::Fault(_)) {
            return Err(self.not_now());
        }
        config.validate()?;
        let same_steps = self.config.is_some_and(|old| {
            old.steps_per_mm == config.steps_per_mm
                && old.invert_direction == config.invert_direction
                && old.clearance_um == config.clearance_um
        });
        if !same_steps {
            self.motion.forget();
            self.set_driver(false);
        }
        self.laser_by_hand = None;
        self.config = Some(config);
        self.settle();
        Ok(Reply::Configured(config))
    }

    /// The state at rest: ready where the position is known and held.
    pub(crate) fn settle(&mut self) {
        self.state = if self.motion.known() && self.driver {
            State::Ready
        } else {
            State::Idle
        };
    }

    fn rearm(&mut self) -> Result<Reply, Refusal> {
        let State::Fault(_) = self.state else {
            return Err(self.not_now());
        };
        if self.inputs.estop {
            return Err(Refusal::InputActive {
                input: Input::EStop,
            });
        }
        if self.inputs.interlock {
            return Err(Refusal::InputActive {
                input: Input::Interlock,
            });
        }
        self.settle();
        let _ = self.link.event(Event::Rearmed);
        Ok(Reply::Done)
    }

    pub(crate) fn begin(&mut self, job: Job, state: State) -> Reply {
        self.job_number = self.job_number.wrapping_add(1).max(1);
        self.job = job;
        self.state = state;
        self.laser_by_hand = None;
        Reply::Begun {
            job: self.job_number,
        }
    }

    fn home<E: Engine>(&mut self, now: Micros, engine: &mut E) -> Result<Reply, Refusal> {
        self.available()?;
        engine.laser(Micros(0));
        self.motion.forget();
        self.set_driver(true);
        Ok(self.begin(Job::Home(Homing::new(now)), State::Homing))
    }

    fn move_to<E: Engine>(
        &mut self,
        engine: &mut E,
        target: Steps,
        speed_um_s: u32,
    ) -> Result<Reply, Refusal> {
        let config = self.ready()?;
        let max = Steps(i32::try_from(config.travel_steps()).unwrap_or(i32::MAX));
        if target.0 < 0 || target > max {
            return Err(Refusal::OutOfTravel {
                position: target,
                min: Steps(0),
                max,
            });
        }
        let interval = interval_for(&config, speed_um_s)?;
        engine.laser(Micros(0));
        let reply = self.begin(Job::Move, State::Ready);
        self.start_move(engine, &config, target, interval);
        Ok(reply)
    }

    /// Starts a move to a step.
    pub(crate) fn start_move<E: Engine>(
        &mut self,
        engine: &mut E,
        config: &Config,
        target: Steps,
        interval: u32,
    ) {
        let from = self.motion.position(engine);
        let profile = move_profile(config, from.0.abs_diff(target.0), interval);
        self.start_profile(engine, config, profile, target > from);
    }

    /// Starts a move without triggers.
    pub(crate) fn start_profile<E: Engine>(
        &mut self,
        engine: &mut E,
        config: &Config,
        profile: crate::profile::Profile,
        away: bool,
    ) {
        self.pins.direct(away != config.invert_direction);
        self.motion.start(
            engine,
            &mut self.link.ledger,
            profile,
            away,
            pulse(config),
            None,
        );
    }

    /// Plans a scan; it is answered when it has been checked.
    fn scan<E: Engine>(&mut self, engine: &mut E, request: ScanRequest) -> Result<(), Refusal> {
        let config = self.ready()?;
        let plan = ScanPlan::new(&config, request)?;
        self.check = Some(ScanCheck::new(&config, plan, self.motion.position(engine)));
        Ok(())
    }

    /// Checks a slice of the scan that is to come, and begins it when all is checked.
    pub(crate) fn run_check<E: Engine>(&mut self, now: Micros, engine: &mut E, wake: &mut Micros) {
        let (Some(check), Some(config)) = (&mut self.check, self.config) else {
            return;
        };
        let result = check.run();
        let plan = *check.plan();
        match result {
            Ok(None) => *wake = now,
            Err(refusal) => {
                self.check = None;
                self.link.answer(Reply::Refused(refusal));
            }
            Ok(Some(_)) => {
                self.check = None;
                // Much may have happened meanwhile.
                let reply = match self.ready() {
                    Err(refusal) => Reply::Refused(refusal),
                    Ok(_) => {
                        engine.laser(Micros(0));
                        self.triggers = 0;
                        self.accounts_closed = 0;
                        let number = self.job_number.wrapping_add(1).max(1);
                        self.begin(Job::Scan(Scan::new(&config, plan, number)), State::Scanning)
                    }
                };
                self.link.answer(reply);
            }
        }
    }

    fn laser(&mut self, now: Micros, on: bool) -> Result<Reply, Refusal> {
        if !on {
            self.laser_by_hand = None;
            return Ok(Reply::Done);
        }
        let config = self.available()?;
        if self.inputs.interlock {
            return Err(Refusal::InputActive {
                input: Input::Interlock,
            });
        }
        if !laser_permitted(self.state, self.inputs, true, false, LaserWish::Hand) {
            return Err(self.not_now());
        }
        self.laser_by_hand = Some(now.after(Micros::from_millis(config.laser_manual_ms.into())));
        Ok(Reply::Done)
    }

    fn trigger<E: Engine>(&mut self, engine: &mut E) -> Result<Reply, Refusal> {
        let config = self.available()?;
        if self.by_hand.0 != self.by_hand.1 || !self.link.ledger.reserve(1) {
            return Err(self.not_now());
        }
        self.by_hand.0 = self.by_hand.0.wrapping_add(1);
        engine.fire(pulse(&config));
        Ok(Reply::Done)
    }

    fn release(&mut self) -> Result<Reply, Refusal> {
        self.at_rest()?;
        self.laser_by_hand = None;
        self.set_driver(false);
        self.motion.forget();
        if self.state == State::Ready {
            self.state = State::Idle;
        }
        Ok(Reply::Done)
    }

    fn status<E: Engine>(&mut self, now: Micros, engine: &mut E) -> Status {
        Status {
            state: self.state,
            position: self.motion.position(engine),
            position_known: self.motion.known(),
            moving: self.motion.moving(),
            driver: self.driver,
            laser: engine.lit(),
            inputs: self.inputs,
            job: if matches!(self.job, Job::None) {
                0
            } else {
                self.job_number
            },
            triggers: self.triggers,
            pending: u32::try_from(self.link.ledger.pending()).unwrap_or(u32::MAX),
            bad_frames: self.link.bad_frames(),
            uptime: now,
        }
    }
}

/// The configured trigger pulse.
pub(crate) fn pulse(config: &Config) -> Cycles {
    Micros(config.trigger_pulse_us.into()).to_cycles()
}

/// The cruise interval of the highest speed.
pub(crate) fn fastest(config: &Config) -> u32 {
    interval_of(config.step_rate(config.max_speed_um_s))
}
