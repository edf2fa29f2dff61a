//! What must happen at once, whatever the tasks are doing. The one file of the board with `unsafe`:
//! enabling interrupts, the fault handler that the runtime asks for in that form, and a look for the
//! boot ROM.
//!
//! | interrupt | priority | does |
//! |---|---|---|
//! | PIO1_IRQ_1 | 0 | E-stop: no further STEP edge, laser off. Interlock: noted (the laser's machine is dark already). Exposure edges: noted with their time |
//! | PIO0_IRQ_1 | 1 | a trigger was fired: noted with its time and the laser pin's level |
//! | DMA_IRQ_1 | 1 | a channel ran out: armed anew behind the other |
#![allow(unsafe_code)]

use cortex_m_rt::{ExceptionFrame, exception};
use embassy_rp::Peri;
#[cfg(feature = "rp2040")]
use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::interrupt::{self, InterruptExt, Priority};
use embassy_rp::pac;
use embassy_rp::peripherals::FLASH;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use portable_atomic::{AtomicU8, Ordering};

use crate::machines::{self, pin};
use crate::safe_state::{self, Cause};

/// A trigger as its interrupt saw it.
#[derive(Clone, Copy)]
pub struct Trigger {
    /// Microseconds since boot.
    pub micros: u64,
    /// The laser's pad was high.
    pub laser: bool,
}

/// An edge of the exposure input.
#[derive(Clone, Copy)]
pub struct Exposure {
    /// Microseconds since boot.
    pub micros: u64,
    /// The exposure began (else: it ended).
    pub active: bool,
}

/// Triggers since the board's logic last took them.
pub static TRIGGERS: Channel<CriticalSectionRawMutex, Trigger, 16> = Channel::new();
/// Exposure edges likewise.
pub static EXPOSURES: Channel<CriticalSectionRawMutex, Exposure, 16> = Channel::new();
/// Something happened that the logic should look at before its next turn.
pub static WAKE: Signal<CriticalSectionRawMutex, ()> = Signal::new();
/// Inputs seen high since they were last taken: bit 0 E-stop, bit 1 interlock.
static LATCHED: AtomicU8 = AtomicU8::new(0);

const ESTOP: u8 = 1;
const INTERLOCK: u8 = 2;

/// E-stop and interlock seen high since the last call.
pub fn take_latched() -> (bool, bool) {
    let seen = LATCHED.swap(0, Ordering::Relaxed);
    (seen & ESTOP != 0, seen & INTERLOCK != 0)
}

/// Turns the interrupts on; the machines must have been set up.
pub fn enable() {
    pac::PIO0.irqs(1).inte().write(|w| w.set_sm2_rxnempty(true));
    pac::PIO1.irqs(1).inte().write(|w| {
        w.set_sm0(true);
        w.set_sm1(true);
        w.set_sm2(true);
        w.set_sm3(true);
    });
    interrupt::PIO1_IRQ_1.set_priority(Priority::P0);
    interrupt::PIO0_IRQ_1.set_priority(Priority::P1);
    interrupt::DMA_IRQ_1.set_priority(Priority::P1);
    // SAFETY: enabling an interrupt can break a critical section that relies on it being masked.
    // None does: the sections here are `critical_section`'s, which mask all interrupts, and the
    // handlers below share nothing with the tasks but atomics, channels and such sections.
    unsafe {
        interrupt::PIO1_IRQ_1.enable();
        interrupt::PIO0_IRQ_1.enable();
        interrupt::DMA_IRQ_1.enable();
    }
}

/// The flash chip's unique number; zero where there is no boot ROM to read it with (an emulator).
/// Read once, at boot: the flash is not mapped meanwhile.
#[cfg(feature = "rp2040")]
pub fn flash_number(flash: Peri<'static, FLASH>) -> [u8; 8] {
    // SAFETY: 0x10 to 0x13 lie in the boot ROM, which is mapped always; it holds the letters "Mu"
    // and a version there (RP2040 datasheet, 2.8.3). Reading it has no effect.
    let magic = unsafe { core::ptr::without_provenance::<u32>(0x10).read_volatile() };
    let mut number = [0; 8];
    if magic.to_le_bytes().starts_with(b"Mu") {
        let mut chip = Flash::<_, Blocking, { 2 * 1024 * 1024 }>::new_blocking(flash);
        if chip.blocking_unique_id(&mut number).is_err() {
            defmt::warn!("the flash chip's number cannot be read");
        }
    }
    number
}

/// The chip's own number; zero where it cannot be read.
#[cfg(feature = "rp2350")]
pub fn flash_number(_: Peri<'static, FLASH>) -> [u8; 8] {
    embassy_rp::otp::get_chipid().map_or([0; 8], u64::to_be_bytes)
}

#[embassy_rp::interrupt]
fn PIO1_IRQ_1() {
    // Flags of the watching machines: 1 E-stop, 2 interlock, 3 exposure began, 0 exposure ended.
    let flags = pac::PIO1.irq().read().irq() & 0b1111;
    pac::PIO1.irq().write(|w| w.set_irq(flags));
    if flags & 0b0010 != 0 {
        machines::stop_stepping();
        machines::laser_off();
        LATCHED.fetch_or(ESTOP, Ordering::Relaxed);
    }
    if flags & 0b0100 != 0 {
        machines::laser_off();
        LATCHED.fetch_or(INTERLOCK, Ordering::Relaxed);
    }
    if flags & 0b1001 != 0 {
        let micros = Instant::now().as_micros();
        // Both may wait if the interrupt was held up: the start comes first then, unless the pin
        // says that the start is the newer one.
        let began = flags & 0b1000 != 0;
        let ended = flags & 0b0001 != 0;
        let high = machines::level(pin::EXPOSURE);
        let order = if began && ended && high {
            [Some(false), Some(true)]
        } else {
            [began.then_some(true), ended.then_some(false)]
        };
        for active in order.into_iter().flatten() {
            // A full queue drops it: the exposure is then missing in the logic's count, and named.
            let _ = EXPOSURES.try_send(Exposure { micros, active });
        }
    }
    WAKE.signal(());
}

#[embassy_rp::interrupt]
fn PIO0_IRQ_1() {
    let micros = Instant::now().as_micros();
    let laser = machines::level(pin::LASER);
    // The FIFO holds four; more than one only if the interrupt was held up for a whole trigger gap.
    for _ in 0..4 {
        if !machines::counted_trigger() {
            break;
        }
        let _ = TRIGGERS.try_send(Trigger { micros, laser });
    }
    WAKE.signal(());
}

#[embassy_rp::interrupt]
fn DMA_IRQ_1() {
    let done = pac::DMA.ints(1).read();
    pac::DMA.ints(1).write_value(done);
    machines::pump();
}

/// Laser off, driver off, no edges; then the watchdog resets the chip, and the hello names the cause.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    safe_state::reset(Cause::HardFault, frame.pc())
}
