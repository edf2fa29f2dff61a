//! The state machines of both PIO blocks, set up and handled: stepping, comparing, the camera's
//! pulse, the laser's lease, the inputs that must be seen at once.
//!
//! Everything here may be called from an interrupt too: single register writes, or a critical section.

use cannula_firmware::engine::HaltOn;
use cannula_shared::message::Inputs;
use embassy_rp::pac;
use embassy_rp::peripherals::{PIO0, PIO1};
use embassy_rp::pio::program::Program;
use embassy_rp::pio::{
    Common, Config, Direction, FifoJoin, Instance, LoadError, LoadedProgram, Pin, ShiftConfig,
    ShiftDirection, StateMachine,
};
use portable_atomic::{AtomicBool, AtomicU8, Ordering};

use crate::feed::{Block, Feed, Ring, ring};
use crate::programs;

/// Pins that the machines drive or look at (contract.md).
pub mod pin {
    /// STEP out.
    pub const STEP: u8 = 2;
    /// Driver enable out, low = on.
    pub const ENABLE: u8 = 4;
    /// Camera trigger out.
    pub const TRIGGER: u8 = 6;
    /// Laser out.
    pub const LASER: u8 = 7;
    /// Home switch in.
    pub const HOME: u8 = 10;
    /// Far limit switch in.
    pub const LIMIT: u8 = 11;
    /// E-stop in.
    pub const ESTOP: u8 = 12;
    /// Interlock in.
    pub const INTERLOCK: u8 = 13;
    /// Exposure active in.
    pub const EXPOSURE: u8 = 14;
}

const STEPPER: usize = 0;
const COMPARE: usize = 1;
const CAMERA: usize = 2;
const COUNTER: usize = 3;
/// The laser's machine in PIO1.
const LASER: usize = 0;
/// A program whose origin nobody jumps to.
const UNNAMED: usize = usize::MAX;

/// Step words: 4096 are 8 ms of a ramp at 500 000 steps/s, seconds of a cruise.
pub static STEPS: Feed<4096> = Feed::new(&STEP_RING, Block::First, STEPPER as u8, (0, 1));
/// Compare words.
pub static COMPARES: Feed<64> = Feed::new(&COMPARE_RING, Block::First, COMPARE as u8, (2, 3));
/// Light words.
pub static LIGHTS: Feed<256> = Feed::new(&LIGHT_RING, Block::Second, LASER as u8, (4, 5));
static STEP_RING: Ring<4096> = ring();
static COMPARE_RING: Ring<64> = ring();
static LIGHT_RING: Ring<256> = ring();
/// The laser's machine plays light words; else it holds the lease.
static PLAYS: AtomicBool = AtomicBool::new(false);

/// Where each program begins, for the jumps that restart a machine.
static ORIGIN: [AtomicU8; 6] = [const { AtomicU8::new(0) }; 6];
const ORIGIN_LASER: usize = 4;
const ORIGIN_LIGHTS: usize = 5;

fn origin(machine: usize) -> u8 {
    ORIGIN.get(machine).map_or(0, |o| o.load(Ordering::Relaxed))
}

// Instructions that the CPU injects (RP2040 datasheet, 3.4).
const SET_PINS_LOW: u16 = 0xe000;
const MOV_ISR_X: u16 = 0xa0c1;
const PUSH_NOBLOCK: u16 = 0x8000;
const PULL_NOBLOCK: u16 = 0x8080;
/// `mov x, ~null`
const MOV_X_ONES: u16 = 0xa02b;

const fn jmp(to: u8) -> u16 {
    (to & 0x1f) as u16
}

fn inject(machine: usize, instruction: u16) {
    pac::PIO0
        .sm(machine)
        .instr()
        .write(|w| w.set_instr(instruction));
}

fn set_enabled(mask: u8, on: bool) {
    critical_section::with(|_| {
        pac::PIO0.ctrl().modify(|w| {
            let now = w.sm_enable();
            w.set_sm_enable(if on { now | mask } else { now & !mask });
        });
    });
}

const fn bit(machine: usize) -> u8 {
    1 << machine
}

/// A machine as it was at power-up: FIFOs empty, shift counters cleared, at its program's start.
/// It stays disabled.
fn rewind(machine: usize) {
    set_enabled(bit(machine), false);
    let shift = pac::PIO0.sm(machine).shiftctrl();
    // Toggling a join flushes both FIFOs.
    shift.modify(|w| w.set_fjoin_rx(!w.fjoin_rx()));
    shift.modify(|w| w.set_fjoin_rx(!w.fjoin_rx()));
    critical_section::with(|_| pac::PIO0.ctrl().modify(|w| w.set_sm_restart(bit(machine))));
    inject(machine, jmp(origin(machine)));
}

/// Empties and stops the step, compare and counting machines for a new move.
pub fn prepare(halt_on: HaltOn) {
    stop_stepping();
    STEPS.clear();
    COMPARES.clear();
    for machine in [STEPPER, COMPARE, COUNTER] {
        rewind(machine);
    }
    pac::PIO0
        .irq()
        .write(|w| w.set_irq(1 << programs::FLAG_HALT | 1 << programs::FLAG_TRIGGER));
    pac::PIO0.sm(STEPPER).execctrl().modify(|w| {
        w.set_jmp_pin(match halt_on {
            HaltOn::Home => pin::HOME,
            HaltOn::Limit => pin::LIMIT,
        });
    });
    inject(COUNTER, MOV_X_ONES);
    set_enabled(bit(COUNTER), true);
}

/// Lets the prepared machines run, in the same cycle.
pub fn start() {
    pump();
    clear_starved();
    set_enabled(bit(STEPPER) | bit(COMPARE), true);
}

/// Gives pushed words to the hardware.
pub fn pump() {
    STEPS.pump();
    COMPARES.pump();
    pump_lights();
}

/// Light words must never reach the machine while it holds the lease: an interrupt may have
/// switched the laser off between pushing and this.
fn pump_lights() {
    critical_section::with(|_| {
        if PLAYS.load(Ordering::Relaxed) {
            LIGHTS.pump();
        }
    });
}

/// The laser's machine waits, dark, for the next STEP edge, and plays light words from there.
pub fn play_lights() {
    critical_section::with(|_| {
        laser_off();
        LIGHTS.clear();
        restart_laser(ORIGIN_LIGHTS);
        PLAYS.store(true, Ordering::Relaxed);
    });
}

/// Whether light words are played.
pub fn plays_lights() -> bool {
    PLAYS.load(Ordering::Relaxed)
}

/// No further edge: the machine is stopped and STEP low. The counter keeps what it counted.
pub fn stop_stepping() {
    set_enabled(bit(STEPPER) | bit(COMPARE), false);
    inject(STEPPER, SET_PINS_LOW);
}

/// As [`stop_stepping`], and forgets what was queued.
pub fn abort() {
    stop_stepping();
    STEPS.clear();
    COMPARES.clear();
    rewind(STEPPER);
    rewind(COMPARE);
}

/// No further trigger from STEP edges; stepping goes on.
pub fn cancel_triggers() {
    set_enabled(bit(COMPARE), false);
    COMPARES.clear();
    rewind(COMPARE);
}

/// STEP edges on the pad since [`prepare`].
pub fn steps_done() -> u32 {
    critical_section::with(|_| {
        // Injected between the machine's own instructions: its wait goes on afterwards.
        inject(COUNTER, MOV_ISR_X);
        inject(COUNTER, PUSH_NOBLOCK);
        let mut count = 0;
        // One word; the bound guards against a FIFO that would never empty.
        for _ in 0..8 {
            if pac::PIO0.fstat().read().rxempty() & bit(COUNTER) != 0 {
                break;
            }
            count = !pac::PIO0.rxf(COUNTER).read();
        }
        count
    })
}

/// Everything pushed has been stepped: the machine waits, empty, at its program's start.
pub fn idle() -> bool {
    let waiting = || {
        let empty = pac::PIO0.fstat().read().txempty() & bit(STEPPER) != 0;
        empty && pac::PIO0.sm(STEPPER).addr().read().addr() == origin(STEPPER)
    };
    // Twice: it stands there for a cycle or two at every segment's start as well.
    STEPS.drained() && waiting() && waiting() && waiting()
}

/// The hardware's own stop at its limit input.
pub fn halted() -> bool {
    pac::PIO0.irq().read().irq() & (1 << programs::FLAG_HALT) != 0
}

/// The step machine found no word when it wanted one, since [`clear_starved`].
pub fn starved() -> bool {
    pac::PIO0.fdebug().read().txstall() & bit(STEPPER) != 0
}

/// Forgets an earlier starving.
pub fn clear_starved() {
    pac::PIO0.fdebug().write(|w| w.set_txstall(bit(STEPPER)));
}

/// Sets the camera's pulse, in cycles, and zeroes its count.
pub fn set_pulse(cycles: u32) {
    rewind(CAMERA);
    inject(CAMERA, SET_PINS_LOW);
    inject(CAMERA, MOV_X_ONES);
    pac::PIO0
        .txf(CAMERA)
        .write_value(cycles.saturating_sub(programs::PULSE_OVERHEAD));
    inject(CAMERA, PULL_NOBLOCK);
    pac::PIO0
        .irq()
        .write(|w| w.set_irq(1 << programs::FLAG_TRIGGER));
    set_enabled(bit(CAMERA), true);
}

/// One trigger now, by the CPU (stop and shoot).
pub fn fire() {
    pac::PIO0
        .irq_force()
        .write(|w| w.set_irq_force(1 << programs::FLAG_TRIGGER));
}

/// The next trigger that the camera's machine has counted, for its interrupt.
pub fn counted_trigger() -> bool {
    if pac::PIO0.fstat().read().rxempty() & bit(CAMERA) != 0 {
        return false;
    }
    let _ = pac::PIO0.rxf(CAMERA).read();
    true
}

/// The laser may be on for so many microseconds from now, whatever was granted before; 0 is off now.
pub fn lease_laser(us: u32) {
    if us == 0 {
        laser_off();
        return;
    }
    if plays_lights() {
        laser_off();
    }
    let cycles = us.saturating_mul(125);
    pac::PIO1
        .txf(LASER)
        .write_value(cycles / programs::LEASE_TICK);
}

/// The laser off within a few cycles, its lease and its light words forgotten.
pub fn laser_off() {
    critical_section::with(|_| {
        quench();
        if PLAYS.swap(false, Ordering::Relaxed) {
            LIGHTS.clear();
        }
        restart_laser(ORIGIN_LASER);
    });
}

/// The laser's machine stopped, its pin low.
fn quench() {
    set_laser_enabled(false);
    instruct_laser(SET_PINS_LOW);
}

fn instruct_laser(instruction: u16) {
    pac::PIO1
        .sm(LASER)
        .instr()
        .write(|w| w.set_instr(instruction));
}

fn set_laser_enabled(on: bool) {
    pac::PIO1.ctrl().modify(|w| {
        let now = w.sm_enable();
        w.set_sm_enable(if on {
            now | bit(LASER)
        } else {
            now & !bit(LASER)
        });
    });
}

/// The laser's machine dark, its FIFO empty, and on from the start of a program. In a critical section.
fn restart_laser(program: usize) {
    quench();
    let shift = pac::PIO1.sm(LASER).shiftctrl();
    // Toggling a join flushes both FIFOs.
    shift.modify(|w| w.set_fjoin_rx(!w.fjoin_rx()));
    shift.modify(|w| w.set_fjoin_rx(!w.fjoin_rx()));
    pac::PIO1.ctrl().modify(|w| w.set_sm_restart(bit(LASER)));
    instruct_laser(jmp(origin(program)));
    set_laser_enabled(true);
}

/// Inputs that have had a rising edge since the last call, or are high now. The pads' edge detectors
/// latch whatever the CPU is doing; their interrupts stay off.
pub fn take_input_edges() -> Inputs {
    // Four bits a pin: level low, level high, edge low, edge high.
    const EDGE_HIGH: u32 = 1 << 3;
    let register = pac::IO_BANK0.intr(usize::from(pin::HOME / 8));
    let seen = register.read().0;
    let edge = |pin: u8| EDGE_HIGH << (4 * (pin % 8));
    let mine = edge(pin::HOME) | edge(pin::LIMIT) | edge(pin::ESTOP) | edge(pin::INTERLOCK);
    register.write_value(pac::io::regs::Int(seen & mine));
    let active = |pin: u8| seen & edge(pin) != 0 || level(pin);
    Inputs {
        home: active(pin::HOME),
        limit: active(pin::LIMIT),
        estop: active(pin::ESTOP),
        interlock: active(pin::INTERLOCK),
        exposure: level(pin::EXPOSURE),
    }
}

/// The level of a pad, as the pad reads.
pub fn level(pin: u8) -> bool {
    pac::SIO.gpio_in(0).read() >> pin & 1 != 0
}

/// What the set-up consumes; the machines run for ever afterwards.
pub struct Pads<'d> {
    pub step: Pin<'d, PIO0>,
    pub trigger: Pin<'d, PIO0>,
    pub laser: Pin<'d, PIO1>,
}

/// Loads the programs and configures the machines.
///
/// # Errors
/// When the programs do not fit (which a build that has run once rules out).
pub fn set_up<'d>(
    common0: &mut Common<'d, PIO0>,
    common1: &mut Common<'d, PIO1>,
    pads: &Pads<'d>,
    mut sm: (
        StateMachine<'d, PIO0, 0>,
        StateMachine<'d, PIO0, 1>,
        StateMachine<'d, PIO0, 2>,
        StateMachine<'d, PIO0, 3>,
    ),
    mut watchers: (
        StateMachine<'d, PIO1, 0>,
        StateMachine<'d, PIO1, 1>,
        StateMachine<'d, PIO1, 2>,
        StateMachine<'d, PIO1, 3>,
    ),
) -> Result<(), LoadError> {
    let mut load0 = |machine: usize, program: Program<32>| -> Result<Config<'d, PIO0>, LoadError> {
        let loaded = common0.try_load_program(&program)?;
        Ok(config(machine, &loaded))
    };
    let mut step = load0(STEPPER, programs::step())?;
    let mut compare = load0(COMPARE, programs::compare())?;
    let mut camera = load0(CAMERA, programs::camera())?;
    let mut count = load0(COUNTER, programs::count())?;
    step.set_set_pins(&[&pads.step]);
    step.set_jmp_pin(&pads.step);
    compare.set_in_pins(&[&pads.step]);
    camera.set_set_pins(&[&pads.trigger]);
    count.set_in_pins(&[&pads.step]);
    sm.0.set_pin_dirs(Direction::Out, &[&pads.step]);
    sm.2.set_pin_dirs(Direction::Out, &[&pads.trigger]);
    for feeding in [&mut step, &mut compare] {
        feeding.fifo_join = FifoJoin::TxOnly;
        feeding.shift_out = ShiftConfig {
            threshold: 32,
            direction: ShiftDirection::Right,
            auto_fill: true,
        };
    }
    sm.0.set_config(&step);
    sm.1.set_config(&compare);
    sm.2.set_config(&camera);
    sm.3.set_config(&count);

    let mut load1 = |machine: usize, program: Program<32>| -> Result<Config<'d, PIO1>, LoadError> {
        let loaded = common1.try_load_program(&program)?;
        Ok(config(machine, &loaded))
    };
    // Loaded beside the lease, for the same machine.
    let _ = load1(ORIGIN_LIGHTS, programs::lights())?;
    let mut lease = load1(ORIGIN_LASER, programs::lease())?;
    lease.shift_out = ShiftConfig {
        threshold: 32,
        direction: ShiftDirection::Right,
        auto_fill: false,
    };
    let watch = load1(UNNAMED, programs::watch())?;
    let exposure = load1(UNNAMED, programs::exposure())?;
    lease.set_set_pins(&[&pads.laser]);
    // Low before it becomes an output.
    watchers
        .0
        .set_pins(embassy_rp::gpio::Level::Low, &[&pads.laser]);
    watchers.0.set_pin_dirs(Direction::Out, &[&pads.laser]);
    watchers.0.set_config(&lease);
    watchers.1.set_config(&watch);
    watchers.2.set_config(&watch);
    watchers.3.set_config(&exposure);
    // Pins that other code holds as plain inputs: the machines only look at them.
    let look_at = |machine: usize, pin: u8| {
        pac::PIO1
            .sm(machine)
            .pinctrl()
            .modify(|w| w.set_in_base(pin));
    };
    pac::PIO1
        .sm(LASER)
        .execctrl()
        .modify(|w| w.set_jmp_pin(pin::INTERLOCK));
    look_at(LASER, pin::STEP);
    look_at(1, pin::ESTOP);
    look_at(2, pin::INTERLOCK);
    look_at(3, pin::EXPOSURE);
    pac::PIO1.ctrl().modify(|w| w.set_sm_enable(0b1111));
    // Dropping a handle stops its machine; these run for ever.
    core::mem::forget((sm, watchers));
    Ok(())
}

fn config<'d, P: Instance>(machine: usize, loaded: &LoadedProgram<'d, P>) -> Config<'d, P> {
    if let Some(place) = ORIGIN.get(machine) {
        place.store(loaded.origin, Ordering::Relaxed);
    }
    let mut config = Config::default();
    config.use_program(loaded, &[]);
    config
}
