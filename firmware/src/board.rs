//! The board: link, state machine, motion and laser in one place, driven by [`Board::poll`].
//!
//! ```text
//! Boot ─configure─► Idle ─home─► Homing ─► Ready ◄──────────── Stopping ◄─ stop
//!                     ▲                      ├─ scan ─► Scanning ─┘
//!                     └─ re-arm ── Fault ◄───┴── any state but Boot
//! ```
//!
//! Commands are carried out in `commands`, jobs and faults in `jobs`.

use crate::engine::Engine;
use crate::exposure::Exposures;
use crate::homing::Homing;
use crate::link::Link;
use crate::motion::Motion;
use crate::pins::Pins;
use crate::safety::{LaserWish, fault_of, laser_permitted};
use crate::scan::{Light, Scan};
use crate::scan_plan::ScanCheck;
use cannula_shared::config::Config;
use cannula_shared::error::{Doing, Fault};
use cannula_shared::hello::{Identity, ResetReason};
use cannula_shared::message::{Event, Inputs, State, Telemetry};
use cannula_shared::units::{CLOCK_HZ, Micros};
use embedded_hal::digital::{InputPin, OutputPin};

/// The longest time from one poll to the next.
pub const POLL: Micros = Micros(5_000);

/// How the board is to start anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reboot {
    /// The same program.
    Program,
    /// The USB bootloader.
    Bootloader,
}

/// What takes time.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and no heap to put it on"
)]
pub(crate) enum Job {
    None,
    Home(Homing),
    Move,
    Scan(Scan),
}

/// Why the board is slowing down, and what it will be then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stop {
    Command,
    Fault(Fault),
}

/// The motion board's logic.
#[derive(Debug)]
pub struct Board<O, I> {
    pub(crate) pins: Pins<O, I>,
    pub(crate) link: Link,
    pub(crate) state: State,
    pub(crate) config: Option<Config>,
    pub(crate) motion: Motion,
    pub(crate) job: Job,
    pub(crate) job_number: u32,
    pub(crate) stop: Option<Stop>,
    pub(crate) check: Option<ScanCheck>,
    /// Triggers fired in the running scan or the last.
    pub(crate) triggers: u32,
    /// Triggers fired by hand: asked for, and seen.
    pub(crate) by_hand: (u32, u32),
    pub(crate) laser_by_hand: Option<Micros>,
    pub(crate) driver: bool,
    pub(crate) inputs: Inputs,
    pub(crate) reboot: Option<Reboot>,
    reported: Micros,
    /// Accounts of exposures that gave their place in the ledger back.
    pub(crate) accounts_closed: u32,
}

impl<O: OutputPin, I: InputPin> Board<O, I> {
    /// A board that has just started: driver off before this returns.
    pub fn new(mut pins: Pins<O, I>, identity: Identity, reset: ResetReason) -> Self {
        pins.drive(false);
        Board {
            pins,
            link: Link::new(identity, reset),
            state: State::Boot,
            config: None,
            motion: Motion::default(),
            job: Job::None,
            job_number: 0,
            stop: None,
            check: None,
            triggers: 0,
            by_hand: (0, 0),
            laser_by_hand: None,
            driver: false,
            inputs: Inputs::NONE,
            reboot: None,
            reported: Micros(0),
            accounts_closed: 0,
        }
    }

    /// Takes bytes from the link, in any pieces.
    pub fn receive(&mut self, now: Micros, bytes: &[u8]) {
        self.link.receive(now, bytes);
    }

    /// Puts bytes for the link into `out`; how many (0 = nothing to say now).
    pub fn transmit(&mut self, now: Micros, out: &mut [u8]) -> usize {
        self.link.transmit(now, out)
    }

    /// The link was cut (USB unplugged).
    pub fn link_reset(&mut self) {
        self.link.disconnected();
    }

    /// The state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Whether a restart was asked for and its reply has left.
    pub fn reboot_requested(&self) -> Option<Reboot> {
        if self.link.answered() {
            self.reboot
        } else {
            None
        }
    }

    /// Everything into its safe state, whatever was going on: laser off, no more steps, driver off.
    pub fn make_safe<E: Engine>(&mut self, engine: &mut E) {
        engine.laser(Micros(0));
        engine.cancel_triggers();
        engine.abort();
        self.set_driver(false);
        self.motion.forget();
    }

    pub(crate) fn set_driver(&mut self, on: bool) {
        self.driver = self.pins.drive(on) && on;
    }

    /// Does what is due: a bounded amount of work. Returns when it wants to be called again at
    /// the latest; earlier after any interrupt or received bytes.
    pub fn poll<E: Engine>(&mut self, now: Micros, engine: &mut E) -> Micros {
        self.inputs = self.pins.read();
        let sensed = self.inputs.or(engine.latched());

        // What has happened.
        let mut full = false;
        let ended = self
            .motion
            .poll(now, engine, &mut self.link.ledger, &mut full);
        self.take_triggers(now, engine);
        self.take_exposures(now, engine);
        if let Some(ended) = ended {
            self.ended(now, engine, ended);
        }
        if full {
            // What was armed and had not fired by then will not.
            self.fault(
                now,
                engine,
                Fault::LedgerFull {
                    index: self.triggers,
                },
            );
        }

        // What must not go on.
        if let Some(fault) = fault_of(self.state, sensed) {
            self.fault(now, engine, fault);
        }
        self.watch_host(now, engine);

        // What is asked for, and what comes next.
        if let Some(command) = self.link.take_command() {
            self.command(now, engine, command);
        }
        let mut wake = now.after(POLL);
        self.run_check(now, engine, &mut wake);
        self.advance(now, engine, &mut wake);

        self.set_laser(now, engine, &mut wake);
        self.report(now, engine, &mut wake);
        self.blink(now);
        if let Some(due) = self.motion.wake(now, engine) {
            wake = wake.min(due);
        }
        wake.max(now)
    }

    /// Nobody there while something goes on: stop. A new host that takes over ends the old one's job too.
    fn watch_host<E: Engine>(&mut self, now: Micros, engine: &mut E) {
        let busy =
            self.motion.moving() || !matches!(self.job, Job::None) || self.laser_by_hand.is_some();
        if self.link.take_new_session() {
            self.check = None;
            self.laser_by_hand = None;
            if busy {
                self.stop_job(now, engine, Stop::Command);
            }
        }
        let limit = self.config.map_or(0, |c| c.heartbeat_us);
        let silence = self.link.silence(now);
        if busy && silence > Micros(limit.into()) {
            self.laser_by_hand = None;
            let silent_us = u32::try_from(silence.0).unwrap_or(u32::MAX);
            self.fault(now, engine, Fault::HostSilent { silent_us });
        }
    }

    fn host_alive(&self, now: Micros) -> bool {
        self.config
            .is_some_and(|c| self.link.silence(now) <= Micros(c.heartbeat_us.into()))
    }

    /// Renews the laser's lease, leaves it to its light words, or switches it off.
    fn set_laser<E: Engine>(&mut self, now: Micros, engine: &mut E, wake: &mut Micros) {
        let lease = Micros(self.config.map_or(0, |c| c.laser_lease_us).into());
        let (wish, light) = match (&self.job, self.laser_by_hand) {
            (Job::Scan(scan), _) => (LaserWish::Scan, scan.laser(lease)),
            (Job::None, Some(until)) if now < until => {
                (LaserWish::Hand, Light::Lease(until.since(now).min(lease)))
            }
            (Job::None, Some(_)) => {
                self.laser_by_hand = None;
                let _ = self.link.event(Event::LaserExpired);
                (LaserWish::Off, Light::Off)
            }
            _ => (LaserWish::Off, Light::Off),
        };
        let permitted = laser_permitted(
            self.state,
            self.inputs,
            self.host_alive(now),
            self.motion.moving(),
            wish,
        );
        match light {
            Light::Lease(on_for) if permitted => {
                engine.laser(on_for);
                *wake = (*wake).min(now.after(Micros((on_for.0 / 2).max(200))));
            }
            Light::Planned if permitted => {}
            // Off is said again each time: it costs little, and nothing can have missed it.
            _ => {
                self.motion.darken();
                engine.laser(Micros(0));
            }
        }
    }

    /// Where the slide is, at the configured rate.
    fn report<E: Engine>(&mut self, now: Micros, engine: &mut E, wake: &mut Micros) {
        let Some(config) = self.config else { return };
        let every = Micros(config.telemetry_us.into());
        let Some((interval, remaining)) = self.motion.pace(now, engine) else {
            return;
        };
        if every.0 == 0 {
            return;
        }
        let due = self.reported.after(every);
        if now < due {
            *wake = (*wake).min(due);
            return;
        }
        self.reported = now;
        let rate = CLOCK_HZ / interval.max(1);
        let speed = config.steps_per_mm.to_micrometres(i64::from(rate));
        self.link.report(Telemetry {
            time: now,
            position: self.motion.position(engine),
            speed_um_s: u32::try_from(speed).unwrap_or(u32::MAX),
            triggers: self.triggers,
            remaining_ms: u32::try_from(remaining.0 / 1000).unwrap_or(u32::MAX),
        });
    }

    /// The heartbeat LED: slow when well, fast in fault.
    fn blink(&mut self, now: Micros) {
        let half = if matches!(self.state, State::Fault(_)) {
            100_000
        } else {
            500_000
        };
        self.pins.light((now.0 / half) & 1 == 0);
    }

    /// What the board is at, for refusals.
    pub(crate) fn doing(&self) -> Doing {
        match self.state {
            State::Boot => Doing::Boot,
            _ if self.check.is_some() => Doing::Checking,
            State::Idle => Doing::Idle,
            State::Homing => Doing::Homing,
            State::Ready if matches!(self.job, Job::None) => Doing::Ready,
            State::Ready => Doing::Moving,
            State::Scanning => Doing::Scanning,
            State::Stopping => Doing::Stopping,
            State::Fault(_) => Doing::Fault,
        }
    }

    pub(crate) fn exposures(&mut self) -> Option<&mut Exposures> {
        match &mut self.job {
            Job::Scan(scan) => Some(scan.exposures()),
            _ => None,
        }
    }
}
