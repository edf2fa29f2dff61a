//! The watchdog and the roll call by which it is fed.

use core::cell::Cell;

use cannula_firmware::checkin::{CheckIns, Task};
use cannula_shared::hello::ResetReason;
use critical_section::Mutex;
use embassy_rp::pac;
use embassy_rp::watchdog::Watchdog;
use embassy_time::{Duration, Instant};

use crate::safe_state::{self, Cause};

/// The board's logic.
pub const CONTROL: Task = Task(0);
/// The USB device.
pub const DEVICE: Task = Task(1);
/// Bytes from the host.
pub const RECEIVE: Task = Task(2);
/// Bytes to the host.
pub const SEND: Task = Task(3);

static ROLL: Mutex<Cell<CheckIns>> = Mutex::new(Cell::new(CheckIns::new(4)));

/// How often a task that has nothing to do still checks in.
pub const CHECK_IN: Duration = Duration::from_millis(50);
/// The chip is reset when the roll has not been complete for this long.
const PATIENCE: Duration = Duration::from_millis(400);
/// When somebody has been missing for so long, who it is gets noted for the next hello's log.
const SUSPICION: Duration = Duration::from_millis(300);

fn with_roll<R>(f: impl FnOnce(&mut CheckIns) -> R) -> R {
    critical_section::with(|cs| {
        let cell = ROLL.borrow(cs);
        let mut roll = cell.get();
        let result = f(&mut roll);
        cell.set(roll);
        result
    })
}

/// `task` is alive.
pub fn check_in(task: Task) {
    with_roll(|roll| roll.check_in(task));
}

/// The watchdog, and when the roll was last complete.
pub struct Keeper {
    watchdog: Watchdog,
    complete: Instant,
}

impl Keeper {
    /// Starts the watchdog.
    pub fn start(mut watchdog: Watchdog) -> Self {
        watchdog.pause_on_debug(true);
        watchdog.start(PATIENCE);
        Self {
            watchdog,
            complete: Instant::now(),
        }
    }

    /// Feeds the watchdog if every task has checked in since it was last fed.
    pub fn keep(&mut self) {
        if with_roll(CheckIns::complete) {
            self.complete = Instant::now();
            self.watchdog.feed(PATIENCE);
        } else if self.complete.elapsed() > SUSPICION {
            safe_state::note(Cause::Watchdog, with_roll(|roll| roll.missing()));
        }
    }
}

/// Why the chip started, from its registers and what was noted before the reset.
pub fn reset_reason() -> ResetReason {
    if let Some((cause, detail)) = safe_state::take_note() {
        defmt::warn!("last reset: {}, detail {=u32:#x}", cause, detail);
        return match cause {
            Cause::Panic | Cause::HardFault => ResetReason::Panic,
            Cause::Requested => ResetReason::Software,
            Cause::Watchdog => ResetReason::Watchdog,
        };
    }
    let watchdog = pac::WATCHDOG.reason().read();
    if watchdog.timer() {
        return ResetReason::Watchdog;
    }
    if watchdog.force() {
        return ResetReason::Software;
    }
    #[cfg(feature = "rp2040")]
    let (debugger, pin, power) = {
        let chip = pac::VREG_AND_CHIP_RESET.chip_reset().read();
        (chip.had_psm_restart(), chip.had_run(), chip.had_por())
    };
    #[cfg(feature = "rp2350")]
    let (debugger, pin, power) = {
        let chip = pac::POWMAN.chip_reset().read();
        (
            chip.had_dp_reset_req() || chip.had_hzd_sys_reset_req(),
            chip.had_run_low() || chip.had_bor(),
            chip.had_por(),
        )
    };
    if debugger {
        ResetReason::Debugger
    } else if pin {
        ResetReason::Pin
    } else if power {
        ResetReason::PowerOn
    } else {
        ResetReason::Unknown
    }
}
