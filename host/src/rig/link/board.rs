//! The motion board as a thing with methods: each sends a command and waits for what it means.

use super::Result;
use super::error::LinkError;
use super::pipe::{Pipe, SerialPipe};
use super::scan::Scan;
use super::session::{Counts, Session};
use cannula_shared::config::Config;
use cannula_shared::error::{Doing, Refusal};
use cannula_shared::hello::{Hello, ResetReason};
use cannula_shared::message::{
    Command, Event, Outcome, Reply, ScanRequest, State, Status, Telemetry, Trigger,
};
use cannula_shared::units::{Micros, Steps};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// How long a greeting may take.
const GREETING: Micros = Micros(3_000_000);
/// How long a reply may take: checking a long scan before it moves takes the board a second.
const ANSWER: Micros = Micros(5_000_000);
/// How long a stop that somebody waits for may take: a busy machine holds a terminal for half a second.
const PROMPTLY: Micros = Micros(1_000_000);
/// How long a board that is dropped is asked to stop: it stops by itself without a heartbeat.
const FAREWELL: Micros = Micros(300_000);
/// The longest that the lock is held while waiting for bytes.
const SLICE: Micros = Micros(2_000);
/// The board's silence after which a running job is given up.
const SILENCE: Micros = Micros(2_000_000);

/// Session and pipe, which go together.
struct Core {
    session: Session,
    pipe: Box<dyn Pipe>,
    /// The pipe has failed; kept so that the heartbeat's thread can tell the others.
    broken: Option<LinkError>,
    backlog: VecDeque<Event>,
    over: bool,
}

impl Core {
    /// One round: send what is due, read what comes within `wait`.
    fn pump(&mut self, wait: Micros) -> Result<Micros> {
        if let Some(error) = self.broken.take() {
            self.over = true;
            return Err(error);
        }
        let now = self.pipe.now();
        self.session.poll(now);
        self.flush()?;
        let mut buffer = [0; 1024];
        let count = self.pipe.read(&mut buffer, wait)?;
        let now = self.pipe.now();
        if let Some(bytes) = buffer.get(..count) {
            self.session.receive(now, bytes);
        }
        self.session.poll(now);
        self.flush()?;
        if let Some(error) = self.session.take_failure() {
            self.over = true;
            return Err(error);
        }
        while let Some(event) = self.session.next_event() {
            self.backlog.push_back(event);
        }
        Ok(now)
    }

    fn flush(&mut self) -> Result<()> {
        let output = self.session.take_output();
        if !output.is_empty() {
            self.pipe.write(&output)?;
        }
        Ok(())
    }
}

/// A motion board.
///
/// Dropping it turns the laser off and stops whatever runs.
pub struct Board {
    core: Arc<Mutex<Core>>,
    hello: Hello,
    end: Arc<AtomicBool>,
    heartbeat: Option<JoinHandle<()>>,
    cancel: Option<&'static AtomicBool>,
}

/// What homing found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Homed {
    /// Where the slide stands: zero.
    pub position: Steps,
    /// Second touch of the switch minus the first, steps: how well it repeats.
    pub apart: i32,
}

impl Board {
    /// Opens the port at `path` (a pseudo-terminal is as good as a USB port) and greets the board.
    pub fn connect(path: &str) -> Result<Self> {
        Self::over(SerialPipe::open(path)?)
    }

    /// Greets the board behind a pipe.
    pub fn over(pipe: impl Pipe + 'static) -> Result<Self> {
        let mut pipe: Box<dyn Pipe> = Box::new(pipe);
        let real_time = pipe.real_time();
        let mut core = Core {
            session: Session::new(fresh_number()),
            broken: None,
            backlog: VecDeque::new(),
            over: false,
            pipe: {
                pipe.write(&[0])?;
                pipe
            },
        };
        let began = core.pipe.now();
        let hello = loop {
            let now = core.pump(SLICE)?;
            if let Some(hello) = core.session.hello() {
                break *hello;
            }
            if now.since(began) > GREETING {
                return Err(LinkError::NoHello {
                    seconds: GREETING.0 as f64 * 1e-6,
                });
            }
        };
        let core = Arc::new(Mutex::new(core));
        let end = Arc::new(AtomicBool::new(false));
        let heartbeat = if real_time {
            Some(heartbeat(core.clone(), end.clone())?)
        } else {
            None
        };
        Ok(Board {
            core,
            hello,
            end,
            heartbeat,
            cancel: None,
        })
    }

    /// From now on, once `cancel` is true, whatever moves is stopped (and [`LinkError::Stopped`]
    /// returned).
    pub fn heed(&mut self, cancel: &'static AtomicBool) {
        self.cancel = Some(cancel);
    }

    fn core(&self) -> MutexGuard<'_, Core> {
        // A thread that panicked while pumping leaves the session usable or failed, not torn.
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The board's greeting.
    pub fn hello(&self) -> Hello {
        self.hello
    }

    /// Frames counted so far.
    pub fn counts(&self) -> Counts {
        self.core().session.counts()
    }

    /// One round of the link; needed only on virtual time, when nothing else is called for long.
    pub fn keep_alive(&self) -> Result<()> {
        self.core().pump(SLICE).map(drop)
    }

    /// The time of the pipe's clock.
    pub fn now(&self) -> Micros {
        self.core().pipe.now()
    }

    /// Sends a command and waits for its reply.
    pub fn command(&self, command: Command) -> Result<Reply> {
        match self.command_within(command, ANSWER) {
            // Which fault, the refusal does not say.
            Err(LinkError::Refused(Refusal::NotNow {
                doing: Doing::Fault,
            })) => Err(match self.status()?.state {
                State::Fault(fault) => LinkError::InFault(fault),
                _ => LinkError::Refused(Refusal::NotNow {
                    doing: Doing::Fault,
                }),
            }),
            other => other,
        }
    }

    fn command_within(&self, command: Command, limit: Micros) -> Result<Reply> {
        let began = {
            let mut core = self.core();
            let now = core.pipe.now();
            core.session.command(now, command)?;
            now
        };
        loop {
            let mut core = self.core();
            let now = core.pump(SLICE)?;
            if let Some(reply) = core.session.take_reply() {
                return match reply {
                    Reply::Refused(refusal) => Err(LinkError::Refused(refusal)),
                    reply => Ok(reply),
                };
            }
            if now.since(began) > limit {
                core.session.give_up();
                return Err(LinkError::Timeout {
                    doing: name(&command),
                    seconds: limit.0 as f64 * 1e-6,
                });
            }
        }
    }

    fn done(&self, command: Command) -> Result<()> {
        match self.command(command)? {
            Reply::Done => Ok(()),
            reply => Err(LinkError::Unexpected(format!(
                "{reply:?} to {}",
                name(&command)
            ))),
        }
    }

    /// Begins a job: its number.
    pub(super) fn begin(&self, command: Command) -> Result<u32> {
        match self.command(command)? {
            Reply::Begun { job } => Ok(job),
            reply => Err(LinkError::Unexpected(format!(
                "{reply:?} to {}",
                name(&command)
            ))),
        }
    }

    /// The next event or position, waiting up to `wait` for it.
    pub(super) fn next(&self, wait: Micros) -> Result<Incoming> {
        let began = self.now();
        loop {
            let mut core = self.core();
            if let Some(event) = core.backlog.pop_front() {
                return Ok(Incoming::Event(event));
            }
            let now = core.pump(SLICE)?;
            if let Some(event) = core.backlog.pop_front() {
                return Ok(Incoming::Event(event));
            }
            if let Some(telemetry) = core.session.take_telemetry() {
                return Ok(Incoming::Position(telemetry));
            }
            if now.since(began) >= wait {
                let silent = core
                    .session
                    .last_heard()
                    .map_or(now, |heard| now.since(heard));
                return Ok(Incoming::Nothing { silent });
            }
        }
    }

    /// Waits for the end of a job; `other` sees the events and positions on the way.
    pub(super) fn finish(
        &self,
        job: u32,
        doing: &'static str,
        mut other: impl FnMut(Incoming),
    ) -> Result<Steps> {
        let mut stopped = false;
        loop {
            if !stopped && self.cancel.is_some_and(|c| c.load(Ordering::Relaxed)) {
                stopped = true;
                self.ask_to_stop().map_err(|e| match e {
                    LinkError::Timeout { seconds, .. } => LinkError::Mute { doing, seconds },
                    other => other,
                })?;
            }
            match self.next(Micros(20_000))? {
                Incoming::Event(Event::JobEnd {
                    job: ended,
                    outcome,
                    position,
                    ..
                }) if ended == job => {
                    return match outcome {
                        Outcome::Done => Ok(position),
                        Outcome::Stopped => Err(LinkError::Stopped),
                        Outcome::Failed(fault) => Err(LinkError::Fault(fault)),
                    };
                }
                Incoming::Nothing { silent } => self.check_silence(silent, doing)?,
                incoming => other(incoming),
            }
        }
    }

    /// A board that moves reports itself; one that says nothing for long is asked, and given up
    /// if it does not answer.
    pub(super) fn check_silence(&self, silent: Micros, doing: &'static str) -> Result<()> {
        if silent < SILENCE {
            return Ok(());
        }
        match self.command_within(Command::Status, SILENCE) {
            Ok(_) => Ok(()),
            Err(LinkError::Timeout { .. }) => Err(LinkError::Mute {
                doing,
                seconds: (silent.0 + SILENCE.0) as f64 * 1e-6,
            }),
            Err(error) => Err(error),
        }
    }

    /// Sends the configuration; the board's echo of it.
    pub fn configure(&self, config: &Config) -> Result<Config> {
        match self.command(Command::Configure(*config))? {
            Reply::Configured(echo) if echo == *config => Ok(echo),
            reply => Err(LinkError::Unexpected(format!(
                "{reply:?} to the configuration"
            ))),
        }
    }

    /// A look at the board.
    pub fn status(&self) -> Result<Status> {
        self.status_within(ANSWER)
    }

    /// The same for who has no time to wait for a board that may not answer.
    pub fn status_promptly(&self) -> Result<Status> {
        self.status_within(PROMPTLY)
    }

    fn status_within(&self, limit: Micros) -> Result<Status> {
        match self.command_within(Command::Status, limit)? {
            Reply::Status(status) => Ok(status),
            reply => Err(LinkError::Unexpected(format!(
                "{reply:?} to a question for the status"
            ))),
        }
    }

    /// Finds the home switch and goes to zero.
    pub fn home(&self) -> Result<Homed> {
        self.home_with(|_| {})
    }

    /// As [`Self::home`]; `position` sees where the slide is on the way.
    pub fn home_with(&self, mut position: impl FnMut(&Telemetry)) -> Result<Homed> {
        let job = self.begin(Command::Home)?;
        let mut found = None;
        let stands = self.finish(job, "homing", |incoming| match incoming {
            Incoming::Event(Event::Homed { job: of, apart }) if of == job => found = Some(apart),
            Incoming::Position(telemetry) => position(&telemetry),
            _ => {}
        })?;
        match found {
            Some(apart) => Ok(Homed {
                position: stands,
                apart,
            }),
            None => Err(LinkError::Ledger("homing ended without its event".into())),
        }
    }

    /// Moves to a position, at `speed_um_s` (0 = the configured maximum); where it ended.
    pub fn move_to(&self, position: Steps, speed_um_s: u32) -> Result<Steps> {
        self.move_with(
            Command::MoveTo {
                position,
                speed_um_s,
            },
            |_| {},
        )
    }

    /// Moves by a distance; where it ended.
    pub fn jog(&self, by: Steps, speed_um_s: u32) -> Result<Steps> {
        self.move_with(Command::Jog { by, speed_um_s }, |_| {})
    }

    /// Carries out a move; `position` sees where the slide is on the way.
    pub fn move_with(
        &self,
        command: Command,
        mut position: impl FnMut(&Telemetry),
    ) -> Result<Steps> {
        let job = self.begin(command)?;
        self.finish(job, "moving", |incoming| {
            if let Incoming::Position(telemetry) = incoming {
                position(&telemetry);
            }
        })
    }

    /// Begins a scan.
    pub fn scan(&self, request: &ScanRequest) -> Result<Scan<'_>> {
        let job = self.begin(Command::Scan(*request))?;
        Ok(Scan::new(self, job, request.count))
    }

    /// Switches the laser by hand, at rest.
    pub fn laser(&self, on: bool) -> Result<()> {
        self.done(Command::Laser { on })
    }

    /// Fires one trigger, at rest; its line in the ledger.
    pub fn trigger(&self) -> Result<Trigger> {
        self.done(Command::Trigger)?;
        let began = self.now();
        loop {
            match self.next(Micros(20_000))? {
                Incoming::Event(Event::Trigger(trigger)) if trigger.job == 0 => return Ok(trigger),
                _ if self.now().since(began) > ANSWER => {
                    return Err(LinkError::Timeout {
                        doing: "firing a trigger",
                        seconds: ANSWER.0 as f64 * 1e-6,
                    });
                }
                _ => {}
            }
        }
    }

    /// Ends what runs: laser off, no more triggers, down the ramp.
    pub fn stop(&self) -> Result<()> {
        self.done(Command::Stop)
    }

    /// As [`Self::stop`], but one short try: for who has no time to wait for a board that may not answer.
    pub fn ask_to_stop(&self) -> Result<()> {
        match self.command_within(Command::Stop, PROMPTLY)? {
            Reply::Done => Ok(()),
            reply => Err(LinkError::Unexpected(format!("{reply:?} to stopping"))),
        }
    }

    /// Leaves a fault, if its cause is gone.
    pub fn rearm(&self) -> Result<()> {
        self.done(Command::Rearm)
    }

    /// Cuts the driver; the position becomes unknown.
    pub fn release(&self) -> Result<()> {
        self.done(Command::Release)
    }

    /// Starts the board anew, into the USB bootloader if asked. The session is over.
    pub fn reboot(&self, bootloader: bool) -> Result<()> {
        match self.done(Command::Reboot { bootloader }) {
            // It is up again before its answer was looked at: what was asked for.
            Err(LinkError::Restarted(ResetReason::Software)) => Ok(()),
            other => other,
        }
    }

    /// Events that nobody has waited for (faults at rest, remains of an earlier session).
    pub fn take_events(&self) -> Vec<Event> {
        self.core().backlog.drain(..).collect()
    }
}

/// What comes while one waits.
#[derive(Clone, Copy, Debug)]
pub(super) enum Incoming {
    Event(Event),
    Position(Telemetry),
    Nothing { silent: Micros },
}

impl Drop for Board {
    fn drop(&mut self) {
        // Stop ends jobs and the laser alike. Whether it arrives or not: without a heartbeat the
        // board does the same by itself.
        let over = self.core().over;
        if !over {
            let _ = self.command_within(Command::Stop, FAREWELL);
        }
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.heartbeat.take() {
            let _ = thread.join();
        }
    }
}

fn heartbeat(core: Arc<Mutex<Core>>, end: Arc<AtomicBool>) -> Result<JoinHandle<()>> {
    let run = move || {
        while !end.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(15));
            // Somebody who waits holds the lock and pumps.
            if let Ok(mut core) = core.try_lock()
                && !core.over
                && core.broken.is_none()
                && let Err(error) = core.pump(Micros(0))
            {
                core.broken = Some(error);
                return;
            }
        }
    };
    Ok(std::thread::Builder::new()
        .name("board heartbeat".into())
        .spawn(run)?)
}

/// A session number that differs from the last one's, also across processes.
fn fresh_number() -> u16 {
    use std::hash::{BuildHasher, RandomState};
    let random = RandomState::new().hash_one(std::process::id());
    u16::try_from(random % 65_535).unwrap_or(0) + 1
}

fn name(command: &Command) -> &'static str {
    match command {
        Command::Configure(_) => "configuring",
        Command::Home => "homing",
        Command::MoveTo { .. } | Command::Jog { .. } => "moving",
        Command::Scan(_) => "beginning a scan",
        Command::Laser { .. } => "switching the laser",
        Command::Trigger => "firing a trigger",
        Command::Stop => "stopping",
        Command::Rearm => "re-arming",
        Command::Release => "releasing the driver",
        Command::Status => "asking for the status",
        Command::Reboot { .. } => "rebooting",
    }
}
