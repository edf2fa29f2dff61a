//! The PIO programs: what the hardware does without the CPU.
//!
//! PIO0 (27 of 32 words)
//!
//! | machine | program | job |
//! |---|---|---|
//! | SM0 | [`step`] | STEP pulses from segment words; one limit input is looked at before every edge |
//! | SM1 | [`compare`] | counts STEP edges on the pad and raises flag 4 at the trigger's position |
//! | SM2 | [`camera`] | makes the camera's pulse from flag 4, counts it, hands the count to the CPU |
//! | SM3 | [`count`] | counts STEP edges on the pad: where the slide is, whatever the CPU believes |
//!
//! PIO1 (31 of 32 words)
//!
//! | machine | program | job |
//! |---|---|---|
//! | SM0 | [`lease`] | the laser is on only while this machine counts down |
//! | SM0, instead | [`lights`] | in a scan on the fly: light and darkness by the clock of the steps |
//! | SM1, SM2 | [`watch`] | E-stop and interlock: an interrupt at the edge, not at the next poll |
//! | SM3 | [`exposure`] | both edges of the camera's exposure-active output |
//!
//! All machines run at the system clock, undivided: an integer divider (1) keeps every interval exact.

use embassy_rp::pio::program::{Program, pio_asm};

/// Cycles of one step besides the delay loop's count: `mov`, the loop's last round, `jmp pin`,
/// `set [31]`, `set`, `jmp x--`, and two for either the next segment's `out`s or the `jmp step [1]`.
const STEP_OVERHEAD: u32 = 39;
const _: () = assert!(
    STEP_OVERHEAD == cannula_shared::config::MIN_STEP_INTERVAL,
    "the step words' shortest interval is the program's own length"
);
/// Flag by which [`step`] says that its limit input stopped it.
pub const FLAG_HALT: u8 = 0;
/// Flag from [`compare`] (or the CPU, in stop and shoot) to [`camera`].
pub const FLAG_TRIGGER: u8 = 4;
/// Cycles of the camera's pulse besides its loop's count.
pub const PULSE_OVERHEAD: u32 = 6;
/// Cycles of one tick of the laser's lease.
pub const LEASE_TICK: u32 = 130;
/// One word a segment: bits 0..=10 steps − 1, bits 11..=31 interval − [`STEP_OVERHEAD`].
/// Every edge comes one interval after the edge before it, over segment borders too: a segment's
/// last round spends in `out`, `out` the two cycles that the other rounds spend in `pad`.
pub fn step() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    out x, 11",
        "    out isr, 21",
        "step:",
        "    mov y, isr",
        "delay:",
        "    jmp y-- delay",
        "    jmp pin halt",
        "    set pins, 1 [31]",
        "    set pins, 0",
        "    jmp x-- pad",
        ".wrap",
        "pad:",
        "    jmp step [1]",
        "halt:",
        "    irq wait 0",
        "stuck:",
        "    jmp stuck",
    )
    .program
}

/// One word a trigger: STEP edges to the next trigger − 1. Positions are differences of absolute
/// ones, so no error adds up; the gap comes from the pad itself, so it cannot slip against the motor.
pub fn compare() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    out x, 32",
        "edge:",
        "    wait 0 pin 0",
        "    wait 1 pin 0",
        "    jmp x-- edge",
        "    irq set 4",
        ".wrap",
    )
    .program
}

/// OSR holds the pulse's width, X counts down from all ones; X after each pulse goes to the CPU.
pub fn camera() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    wait 1 irq 4",
        "    set pins, 1",
        "    jmp x-- counted",
        "counted:",
        "    mov isr, x",
        "    push noblock",
        "    mov y, osr",
        "high:",
        "    jmp y-- high",
        "    set pins, 0",
        ".wrap",
    )
    .program
}

/// X counts down from all ones, once an edge; the CPU reads it by an injected instruction.
pub fn count() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    wait 1 pin 0",
        "    jmp x-- low",
        "low:",
        "    wait 0 pin 0",
        ".wrap",
    )
    .program
}

/// The laser's lease. A word is the number of ticks for which the laser may stay on from now; the
/// next word replaces what is left; no word is longer than 34 ms, whatever its other bits. Without words the machine runs down and blocks, dark. The jump
/// pin is the interlock: open (high) is dark within a tick, and only a new word lights it again.
pub fn lease() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "dark:",
        "    set pins, 0",
        "    pull block",
        "    out x, 15",
        "lit:",
        "    jmp !x dark",
        "    jmp pin dark",
        "    set pins, 1 [31]",
        "    pull noblock [31]", // with no word waiting this copies X to OSR
        "    out x, 15 [31]",
        "    jmp x-- lit [31]",
        ".wrap",
    )
    .program
}

/// Light words, played from the first STEP edge of a move on. Each takes 75 cycles, its fine and 64
/// times its coarse count; its level is on the pin 5 cycles after its beginning. Where no word
/// waits, the scratch register's zero is played, which is a short darkness. The jump pin is the
/// interlock, looked at every 64 cycles. The same machine as [`lease`]'s: one of them drives the laser.
pub fn lights() -> Program<32> {
    pio_asm!(
        "    wait 1 pin 0",
        "word:",
        "    set x, 0",
        "    pull noblock", // with no word waiting this copies X to OSR
        "    out y, 1",
        "    jmp pin dark",
        "    jmp !y dark",
        "    set pins, 1",
        "    jmp fine",
        "dark:",
        "    set pins, 0 [1]",
        "fine:",
        "    out y, 6",
        "count:",
        "    jmp y-- count",
        "    out x, 13",
        "coarse:",
        "    jmp pin dark [31]",
        "    jmp x-- coarse [31]",
        "    jmp word",
    )
    .program
}

/// Flag 1 for SM1, flag 2 for SM2, at every rising edge, and at once if the input is high already.
pub fn watch() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    wait 1 pin 0",
        "    irq set 0 rel",
        "    wait 0 pin 0",
        ".wrap",
    )
    .program
}

/// Flag 3 at the exposure's start, flag 0 at its end.
pub fn exposure() -> Program<32> {
    pio_asm!(
        ".wrap_target",
        "    wait 1 pin 0",
        "    irq set 3",
        "    wait 0 pin 0",
        "    irq set 0",
        ".wrap",
    )
    .program
}
