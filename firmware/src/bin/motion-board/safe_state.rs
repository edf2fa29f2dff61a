//! The board's last resort: pins forced safe by the pads' overrides, which no state machine and no
//! peripheral can undo, the cause kept over the reset in the watchdog's scratch registers.

use core::panic::PanicInfo;

use embassy_rp::pac;
use embassy_rp::pac::io::vals::{Oeover, Outover};

use crate::machines::pin;

/// Why the board reset itself.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u32)]
pub enum Cause {
    /// A panic; the detail is the line.
    Panic = 1,
    /// A hard fault; the detail is the program counter.
    HardFault = 2,
    /// Asked for by the host.
    Requested = 3,
    /// A task missed its check-in; the detail is the mask of tasks that did not come.
    Watchdog = 4,
}

/// Marks a scratch register as written by this firmware.
const MAGIC: u32 = 0xca11_0000;

/// Laser low, STEP low, driver off, trigger low, by the pads.
pub fn force_pins() {
    let force = |number: u8, level: Outover| {
        pac::IO_BANK0.gpio(usize::from(number)).ctrl().modify(|w| {
            w.set_outover(level);
            w.set_oeover(Oeover::ENABLE);
        });
    };
    force(pin::LASER, Outover::LOW);
    force(pin::STEP, Outover::LOW);
    force(pin::ENABLE, Outover::HIGH);
    force(pin::TRIGGER, Outover::LOW);
}

/// Notes why a reset is about to come.
pub fn note(cause: Cause, detail: u32) {
    pac::WATCHDOG.scratch0().write_value(MAGIC | cause as u32);
    pac::WATCHDOG.scratch1().write_value(detail);
}

/// What was noted before the last reset, and forgets it.
pub fn take_note() -> Option<(Cause, u32)> {
    let word = pac::WATCHDOG.scratch0().read();
    let detail = pac::WATCHDOG.scratch1().read();
    pac::WATCHDOG.scratch0().write_value(0);
    if word & 0xffff_0000 != MAGIC {
        return None;
    }
    let cause = match word & 0xffff {
        1 => Cause::Panic,
        2 => Cause::HardFault,
        3 => Cause::Requested,
        4 => Cause::Watchdog,
        _ => return None,
    };
    Some((cause, detail))
}

/// Everything safe, then a reset of the chip.
pub fn reset(cause: Cause, detail: u32) -> ! {
    cortex_m::interrupt::disable();
    force_pins();
    note(cause, detail);
    // All but the oscillators.
    #[cfg(feature = "rp2040")]
    const ALL: u32 = 0x0001_fffc;
    #[cfg(feature = "rp2350")]
    const ALL: u32 = 0x01ff_fff3;
    pac::PSM.wdsel().write_value(pac::psm::regs::Wdsel(ALL));
    pac::WATCHDOG.ctrl().write(|w| w.set_trigger(true));
    loop {
        cortex_m::asm::nop();
    }
}

/// Everything safe, then the boot ROM's USB loader.
pub fn bootloader() -> ! {
    cortex_m::interrupt::disable();
    force_pins();
    embassy_rp::rom_data::reset_to_usb_boot(0, 0);
    loop {
        cortex_m::asm::nop();
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    force_pins();
    let line = info.location().map_or(0, core::panic::Location::line);
    defmt::error!("panic at line {=u32}", line);
    reset(Cause::Panic, line)
}
