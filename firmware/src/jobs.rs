//! How jobs go on and end, and what a fault does.

use crate::board::{Board, Job, Stop};
use crate::commands::{fastest, pulse};
use crate::engine::Engine;
use crate::homing;
use crate::motion::{Ended, OnTheFly};
use crate::scan::{self, Scan};
use cannula_shared::config::MissingExposure;
use cannula_shared::error::{Doing, Fault};
use cannula_shared::message::{Event, Outcome, State, Trigger};
use cannula_shared::units::{Micros, Steps};
use embedded_hal::digital::{InputPin, OutputPin};

impl<O: OutputPin, I: InputPin> Board<O, I> {
    /// Puts the triggers that have fired into the ledger; their places are reserved.
    pub(crate) fn take_triggers<E: Engine>(&mut self, now: Micros, engine: &mut E) {
        while let Some(edge) = engine.next_trigger() {
            let line = match &mut self.job {
                Job::Scan(scan) => scan.trigger(edge),
                _ if self.by_hand.0 != self.by_hand.1 => {
                    let index = self.by_hand.1;
                    self.by_hand.1 = index.wrapping_add(1);
                    let position = self.motion.position(engine);
                    Some((
                        Trigger {
                            job: 0,
                            index,
                            position,
                            time: edge.time,
                            laser: edge.laser,
                        },
                        None,
                    ))
                }
                _ => None,
            };
            let Some((trigger, dark)) = line else {
                self.fault(now, engine, Fault::StrayTrigger);
                continue;
            };
            if trigger.job != 0 {
                self.triggers = trigger.index.wrapping_add(1);
            }
            self.link.ledger.release(1);
            if !self.link.event(Event::Trigger(trigger)) {
                self.fault(
                    now,
                    engine,
                    Fault::LedgerFull {
                        index: trigger.index,
                    },
                );
            }
            if let Some(fault) = dark {
                self.fault(now, engine, fault);
            }
        }
    }

    /// Counts exposures against triggers.
    pub(crate) fn take_exposures<E: Engine>(&mut self, now: Micros, engine: &mut E) {
        while let Some(edge) = engine.next_exposure() {
            if let Some(exposures) = self.exposures() {
                exposures.edge(edge);
            }
        }
        let strict = self
            .config
            .is_some_and(|c| c.missing_exposure == MissingExposure::Fault);
        while let Some(index) = self.exposures().and_then(|e| e.overdue(now)) {
            let job = self.job_number;
            let _ = self.link.event(Event::MissingExposure { job, index });
            if strict {
                self.fault(now, engine, Fault::MissingExposure { index });
            }
        }
        // Accounts that are settled give their second place in the ledger back.
        if let Some(closed) = self.exposures().map(|e| e.seen() + e.missing()) {
            let newly = closed.saturating_sub(self.accounts_closed);
            self.accounts_closed = closed;
            self.link
                .ledger
                .release(usize::try_from(newly).unwrap_or(0));
        }
    }

    /// A move has ended.
    pub(crate) fn ended<E: Engine>(&mut self, now: Micros, engine: &mut E, ended: Ended) {
        // (A fault that ends motion at once has closed the job already.)
        if let Some(stop) = self.stop {
            match ended {
                Ended::Arrived => self.finish_stop(now, engine, stop),
                Ended::Halted => self.fault(now, engine, self.switch_fault()),
                Ended::Failed(fault) => self.fault(now, engine, fault),
            }
            return;
        }
        let Some(config) = self.config else { return };
        let travelled = self.motion.travelled();
        let fault = match (&mut self.job, ended) {
            (Job::Home(homing), ended) => match homing.ended(now, &config, ended, travelled) {
                Ok(Some(position)) => {
                    self.motion.set_position(position);
                    None
                }
                Ok(None) => None,
                Err(fault) => Some(fault),
            },
            (_, Ended::Failed(fault)) => Some(fault),
            (_, Ended::Halted) => Some(self.switch_fault()),
            (Job::Move, Ended::Arrived) => {
                self.end_job(engine, Outcome::Done);
                None
            }
            (Job::Scan(scan), Ended::Arrived) => scan.arrived(now, &config).err(),
            (Job::None, Ended::Arrived) => None,
        };
        if let Some(fault) = fault {
            self.fault(now, engine, fault);
        }
    }

    /// The machine halted at the switch that lies in the direction of travel.
    fn switch_fault(&self) -> Fault {
        if self.motion.went_away() {
            Fault::Limit
        } else {
            Fault::HomeSwitch
        }
    }

    /// Moves the running job on.
    pub(crate) fn advance<E: Engine>(&mut self, now: Micros, engine: &mut E, wake: &mut Micros) {
        let Some(config) = self.config else { return };
        if self.stop.is_some() {
            return;
        }
        let moving = self.motion.moving();
        let position = self.motion.position(engine);
        match &mut self.job {
            Job::None | Job::Move => {}
            Job::Home(homing) => match homing.next(now, &config, self.inputs.home, moving) {
                homing::Next::Rest(until) => *wake = (*wake).min(until),
                homing::Next::Wait => {}
                homing::Next::Move { profile, away } => {
                    self.start_profile(engine, &config, profile, away);
                    *wake = now;
                }
                homing::Next::Homed { apart } => {
                    let job = self.job_number;
                    let _ = self.link.event(Event::Homed { job, apart });
                    self.state = State::Ready;
                    self.end_job(engine, Outcome::Done);
                }
                homing::Next::Failed(fault) => self.fault(now, engine, fault),
            },
            Job::Scan(scan) => match scan.next(now, &config, position, moving) {
                scan::Next::Rest(until) => *wake = (*wake).min(until),
                scan::Next::Wait => {}
                scan::Next::MoveTo(target) => {
                    let interval = if scan.fired() == 0 {
                        fastest(&config)
                    } else {
                        scan.plan().interval
                    };
                    // Dark before it moves: preparing a move takes a while.
                    if scan.laser(Micros(config.laser_lease_us.into())) == scan::Light::Off {
                        engine.laser(Micros(0));
                    }
                    self.start_move(engine, &config, target, interval);
                    *wake = now;
                }
                scan::Next::Pass(profile) => {
                    let on_the_fly = OnTheFly {
                        plan: scan.plan().triggers,
                        places: Scan::places(&config),
                        lights: scan.lights(&config, profile),
                    };
                    self.pins.direct(!config.invert_direction);
                    self.motion.start(
                        engine,
                        &mut self.link.ledger,
                        profile,
                        true,
                        pulse(&config),
                        Some(on_the_fly),
                    );
                    *wake = now;
                }
                scan::Next::Fire(_) => {
                    if self.link.ledger.reserve(Scan::places(&config)) {
                        scan.firing(now);
                        engine.fire(pulse(&config));
                        *wake = now;
                    } else {
                        match scan.held_up(now) {
                            Ok(until) => *wake = (*wake).min(until),
                            Err(fault) => self.fault(now, engine, fault),
                        }
                    }
                }
                scan::Next::Done => {
                    self.state = State::Ready;
                    self.end_job(engine, Outcome::Done);
                }
                scan::Next::Failed(fault) => self.fault(now, engine, fault),
            },
        }
    }

    /// Ends the job with its events.
    fn end_job<E: Engine>(&mut self, engine: &mut E, outcome: Outcome) {
        let job = core::mem::replace(&mut self.job, Job::None);
        self.link.ledger.release_all();
        // A trigger fired by hand keeps its place.
        if self.by_hand.0 != self.by_hand.1 {
            self.link.ledger.reserve(1);
        }
        if let Job::Scan(scan) = &job {
            let _ = self.link.event(Event::ScanEnd(scan.summary()));
        }
        if !matches!(job, Job::None) {
            let (position, position_known) = (self.motion.position(engine), self.motion.known());
            let _ = self.link.event(Event::JobEnd {
                job: self.job_number,
                outcome,
                position,
                position_known,
            });
        }
    }

    /// Ends what runs, by the ramp.
    pub(crate) fn stop_job<E: Engine>(&mut self, now: Micros, engine: &mut E, stop: Stop) {
        engine.laser(Micros(0));
        if matches!(self.job, Job::None) && !self.motion.moving() {
            return;
        }
        if self.stop.is_none() {
            self.stop = Some(stop);
        }
        if self.motion.moving() {
            self.motion.stop(engine);
            self.state = State::Stopping;
        } else {
            engine.cancel_triggers();
            self.finish_stop(now, engine, stop);
        }
    }

    /// Motion has ended as it should: now what was stopped for.
    fn finish_stop<E: Engine>(&mut self, now: Micros, engine: &mut E, stop: Stop) {
        self.stop = None;
        match stop {
            Stop::Command => {
                self.settle();
                self.end_job(engine, Outcome::Stopped);
            }
            Stop::Fault(fault) => self.enter_fault(now, engine, fault),
        }
    }

    /// A fault: laser off at once, motion ended at once or by the ramp, then latched.
    pub(crate) fn fault<E: Engine>(&mut self, now: Micros, engine: &mut E, fault: Fault) {
        engine.laser(Micros(0));
        engine.cancel_triggers();
        self.laser_by_hand = None;
        if self.check.take().is_some() {
            let refusal = cannula_shared::error::Refusal::NotNow {
                doing: Doing::Fault,
            };
            self.link
                .answer(cannula_shared::message::Reply::Refused(refusal));
        }
        if matches!(self.state, State::Fault(_)) {
            return;
        }
        if !self.motion.moving() {
            self.stop = None;
            self.enter_fault(now, engine, fault);
        } else if fault.ends_motion_at_once() {
            self.motion.abort(engine);
            self.stop = None;
            // What has fired until now belongs into the ledger before it is closed.
            self.take_triggers(now, engine);
            self.enter_fault(now, engine, fault);
        } else {
            // The first fault is the cause; one that loses the position weighs more.
            match self.stop {
                Some(Stop::Fault(first)) if first.loses_position() || !fault.loses_position() => {}
                _ => self.stop = Some(Stop::Fault(fault)),
            }
            self.motion.stop(engine);
            self.state = State::Stopping;
        }
    }

    fn enter_fault<E: Engine>(&mut self, now: Micros, engine: &mut E, fault: Fault) {
        if fault.loses_position() {
            self.motion.forget();
            self.set_driver(false);
        }
        self.state = State::Fault(fault);
        let (position, position_known): (Steps, bool) =
            (self.motion.position(engine), self.motion.known());
        let _ = self.link.event(Event::Fault {
            fault,
            time: now,
            position,
            position_known,
        });
        self.end_job(engine, Outcome::Failed(fault));
    }
}
