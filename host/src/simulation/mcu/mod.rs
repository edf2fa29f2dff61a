//! The simulated motion board: the firmware's logic on virtual time, with a model of the hardware
//! around it and every pin edge recorded in cycles.
//!
//! ```text
//!  host ◄─ bytes, damaged as asked ─► firmware::Board ─► Machines (PIO, DMA, lease) ─► Carriage, switches, camera
//!                                      polled as on the chip        edges ─► Trace
//! ```
//!
//! The logic is the very code of the board. The machines follow the semantics of its PIO programs:
//! intervals exact, trigger 7 cycles after its STEP edge, the laser's lease counted in hardware,
//! the switch ahead looked at before each edge. What is not modelled is what code costs: a poll
//! takes a fixed [`POLL_COST`].

mod channel;
mod machines;
mod pipe;
#[cfg(unix)]
mod pty;
mod trace;
mod world;

pub use channel::Damage;
pub use machines::{RING_STEPS, TRIGGER_DELAY};
pub use pipe::VirtualPipe;
#[cfg(unix)]
pub use pty::{RealTime, Terminal};
pub use trace::{Edge, Pin, Trace};
pub use world::{Exposed, Rig, Switch};

use cannula_firmware::board::{Board, Reboot};
use cannula_firmware::pins::Pins;
use cannula_shared::hello::{Identity, ResetReason};
use cannula_shared::units::{CYCLES_PER_MICRO, Cycles, Micros};
use channel::Channel;
use machines::Machines;
use std::collections::VecDeque;
use world::Wire;

/// What one poll of the logic takes, whatever it does: about what the chip needs for a slice of work.
pub const POLL_COST: Cycles = Cycles(50 * CYCLES_PER_MICRO);
/// From an event to the interrupt routine that serves it.
pub const INTERRUPT_LATENCY: Cycles = Cycles(250);

/// A motion board with its slide, switches and camera.
pub struct SimulatedBoard {
    logic: Board<Wire, Wire>,
    wires: Wires,
    machines: Machines,
    /// Now, in cycles since power came on.
    now: u64,
    /// Boot of the running program: its own clock counts from here.
    booted: u64,
    next_poll: u64,
    cpu_alive: bool,
    stalled_until: u64,
    to_board: Channel,
    to_host: Channel,
    identity: Identity,
    polls: u64,
    /// Exposures that the camera begins by itself, cycles, in order.
    own_exposures: VecDeque<u64>,
    /// It runs by itself with this period, cycles; the next one.
    free_running: Option<(u64, u64)>,
}

/// The wires between logic and world.
#[derive(Clone, Default)]
struct Wires {
    direction: Wire,
    enable: Wire,
    led: Wire,
    home: Wire,
    limit: Wire,
    estop: Wire,
    interlock: Wire,
    exposure: Wire,
}

impl SimulatedBoard {
    /// A board that has just been powered, its slide where `rig` says.
    pub fn new(rig: Rig) -> Self {
        let identity = Identity {
            board: *b"SIMULATE",
            firmware: [0, 1, 0],
        };
        let wires = Wires::default();
        let mut machines = Machines::new(rig);
        machines.sense(0, &wires);
        SimulatedBoard {
            logic: Board::new(wires.pins(), identity, ResetReason::PowerOn),
            wires,
            machines,
            now: 0,
            booted: 0,
            next_poll: 0,
            cpu_alive: true,
            stalled_until: 0,
            to_board: Channel::new(1),
            to_host: Channel::new(2),
            identity,
            polls: 0,
            own_exposures: VecDeque::new(),
            free_running: None,
        }
    }

    /// Now.
    pub fn now(&self) -> Cycles {
        Cycles(self.now)
    }

    /// How often the logic was polled.
    pub fn polls(&self) -> u64 {
        self.polls
    }

    /// The logic, for a look inside.
    pub fn logic(
        &self,
    ) -> &Board<impl embedded_hal::digital::OutputPin, impl embedded_hal::digital::InputPin> {
        &self.logic
    }

    /// The recorded edges.
    pub fn trace(&mut self) -> &mut Trace {
        &mut self.machines.trace
    }

    /// The level of an output pin now.
    pub fn level(&self, pin: Pin) -> bool {
        self.machines.trace.level(pin)
    }

    /// The rig around the board: switches, camera, where the slide is.
    pub fn rig(&mut self) -> &mut Rig {
        &mut self.machines.rig
    }

    /// Frames that the camera has exposed since the last call.
    pub fn take_exposed(&mut self) -> Vec<Exposed> {
        std::mem::take(&mut self.machines.exposed)
    }

    /// The camera exposes by itself after so long (a command to it).
    pub fn expose_after(&mut self, time: Micros) {
        let at = self.now + time.to_cycles().0;
        let place = self.own_exposures.partition_point(|&t| t <= at);
        self.own_exposures.insert(place, at);
    }

    /// From now on the camera exposes by itself with this period, or no more.
    pub fn expose_every(&mut self, period: Option<Micros>) {
        self.free_running = period.map(|p| {
            let cycles = p.to_cycles().0.max(1);
            (cycles, self.now + cycles)
        });
    }

    /// The next exposure that the camera begins by itself.
    fn next_own(&self) -> Option<u64> {
        let free = self.free_running.map(|(_, next)| next);
        free.into_iter()
            .chain(self.own_exposures.front().copied())
            .min()
    }

    /// Begins exposures that are due.
    fn expose_due(&mut self) {
        while let Some(at) = self.next_own().filter(|&at| at <= self.now) {
            self.machines.expose(at);
            match &mut self.free_running {
                Some((period, next)) if *next == at => *next += *period,
                _ => {
                    self.own_exposures.pop_front();
                }
            }
        }
    }

    /// What happens to bytes on their way to the board.
    pub fn damage_to_board(&mut self, damage: Damage) {
        self.to_board.damage = damage;
    }

    /// What happens to bytes on their way to the host.
    pub fn damage_to_host(&mut self, damage: Damage) {
        self.to_host.damage = damage;
    }

    /// Presses or releases the emergency stop.
    pub fn set_estop(&mut self, pressed: bool) {
        self.machines.rig.estop = pressed;
        self.sense();
    }

    /// Opens or closes the laser's interlock.
    pub fn set_interlock(&mut self, open: bool) {
        self.machines.rig.interlock_open = open;
        self.sense();
    }

    /// Changes a switch; it takes effect at once.
    pub fn set_switch(&mut self, change: impl FnOnce(&mut Rig)) {
        change(&mut self.machines.rig);
        self.sense();
    }

    fn sense(&mut self) {
        self.machines.sense(self.now, &self.wires);
        if self.cpu_alive && self.machines.interrupt() {
            self.interrupt_at(self.now);
        }
    }

    /// The CPU stops dead: no polls, no interrupts, no bytes; the machines go on with what they have.
    pub fn kill_cpu(&mut self) {
        self.cpu_alive = false;
        self.machines.cpu_alive = false;
    }

    /// The CPU is held up for so long (a critical section that got out of hand), then goes on.
    pub fn stall_cpu(&mut self, time: Micros) {
        self.stalled_until = self.now + time.to_cycles().0;
    }

    /// The program starts anew (a watchdog, a reset pin); the slide stays where it is.
    pub fn restart(&mut self, reason: ResetReason) {
        self.machines.reset(self.now);
        self.wires.direction.set(false);
        // A reset pin is an input: the external pull-up keeps the driver off.
        self.wires.enable.set(true);
        self.logic = Board::new(self.wires.pins(), self.identity, reason);
        self.booted = self.now;
        self.next_poll = self.now;
        self.cpu_alive = true;
        self.record_outputs();
    }

    /// Gives the board bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_board.send(self.now, bytes);
    }

    /// Bytes of the board that have arrived by now.
    pub fn receive(&mut self) -> Vec<u8> {
        self.to_host.take(self.now)
    }

    /// At most `limit` bytes of the board that have arrived by now.
    pub fn receive_up_to(&mut self, limit: usize) -> Vec<u8> {
        self.to_host.take_up_to(self.now, limit)
    }

    /// Whether bytes for the host have arrived.
    pub fn has_bytes(&self) -> bool {
        self.to_host.next().is_some_and(|at| at <= self.now)
    }

    /// Runs for a time.
    pub fn run_for(&mut self, time: Micros) {
        self.run_until(Cycles(self.now + time.to_cycles().0));
    }

    /// Runs until a time.
    pub fn run_until(&mut self, until: Cycles) {
        while self.now < until.0 {
            self.step(until.0);
        }
    }

    /// Runs until bytes for the host have come, or a time.
    pub fn run_until_bytes(&mut self, until: Cycles) {
        while self.now < until.0 && !self.has_bytes() {
            self.step(until.0);
        }
    }

    /// To the next thing that happens, `until` at the latest.
    fn step(&mut self, until: u64) {
        let mut next = until;
        if self.cpu_alive {
            next = next.min(self.next_poll.max(self.now));
            if let Some(at) = self.to_board.next() {
                next = next.min(at.max(self.now));
            }
        }
        if let Some(at) = self.to_host.next().filter(|&at| at > self.now) {
            next = next.min(at);
        }
        if let Some(at) = self.next_own() {
            next = next.min(at.max(self.now));
        }
        // Edges up to there; an interrupt ends the stretch early.
        self.now = self
            .machines
            .advance(self.now, next, &self.wires, self.cpu_alive);
        self.expose_due();
        if !self.cpu_alive {
            self.to_board.discard(self.now);
            return;
        }
        if self.machines.interrupt() {
            self.interrupt_at(self.now);
        }
        let bytes = self.to_board.take(self.now);
        if !bytes.is_empty() {
            self.logic.receive(self.clock(), &bytes);
            self.next_poll = self.now;
        }
        if self.now < self.stalled_until {
            self.next_poll = self.stalled_until;
        } else if self.now >= self.next_poll {
            self.poll();
        }
    }

    fn interrupt_at(&mut self, at: u64) {
        self.next_poll = self.next_poll.min(at + INTERRUPT_LATENCY.0);
    }

    /// The program's clock.
    fn clock(&self) -> Micros {
        Cycles(self.now - self.booted).to_micros_down()
    }

    fn poll(&mut self) {
        self.polls += 1;
        let clock = self.clock();
        self.machines.begin_poll(self.now, self.booted);
        let wake = self.logic.poll(clock, &mut self.machines);
        self.record_outputs();
        let mut packet = [0; 64];
        // USB full speed carries 19 packets in a millisecond at best.
        loop {
            let count = self.logic.transmit(clock, &mut packet);
            if count == 0 {
                break;
            }
            self.to_host
                .send(self.now, packet.get(..count).unwrap_or(&[]));
        }
        match self.logic.reboot_requested() {
            Some(Reboot::Program) => self.restart(ResetReason::Software),
            // No program of ours runs there, so nobody answers on this port any more.
            Some(Reboot::Bootloader) => {
                self.restart(ResetReason::Software);
                self.kill_cpu();
            }
            None => {
                let wake = self.booted + wake.to_cycles().0;
                self.next_poll = wake.max(self.now + POLL_COST.0);
            }
        }
    }

    fn record_outputs(&mut self) {
        let trace = &mut self.machines.trace;
        trace.record(self.now, Pin::Direction, self.wires.direction.get());
        trace.record(self.now, Pin::Enable, self.wires.enable.get());
        trace.record(self.now, Pin::Led, self.wires.led.get());
    }
}

impl Wires {
    fn pins(&self) -> Pins<Wire, Wire> {
        let w = self.clone();
        Pins {
            direction: w.direction,
            enable: w.enable,
            led: w.led,
            home: w.home,
            limit: w.limit,
            estop: w.estop,
            interlock: w.interlock,
            exposure: w.exposure,
        }
    }
}
