//! The motion board's binary for the Raspberry Pi Pico: the library's logic on real pins.
//!
//! | file | what |
//! |---|---|
//! | [`programs`] | the PIO programs |
//! | [`machines`] | setting up and handling the state machines |
//! | [`feed`] | words into a machine without gaps, by DMA |
//! | [`interrupts`] | what must happen at once (and all `unsafe`) |
//! | [`engine`] | the library's view of the above |
//! | [`usb`] | bytes to and from the host |
//! | [`roll`] | watchdog and reset reason |
//! | [`safe_state`] | panic: pins forced safe, then a reset |
#![no_std]
#![no_main]
#![deny(unsafe_code)]

mod engine;
mod feed;
mod interrupts;
mod machines;
mod programs;
mod roll;
mod safe_state;
mod usb;

use cannula_firmware::board::{Board, Reboot};
use cannula_firmware::pins::Pins;
use cannula_shared::hello::Identity;
use cannula_shared::message::State;
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_futures::select::select;
use embassy_futures::yield_now;
use embassy_rp::bind_interrupts;
use embassy_rp::gpio::{Input, Level, Output, Pull};
use embassy_rp::peripherals::{PIO0, PIO1, USB};
use embassy_rp::pio::{self, Pio};
use embassy_rp::watchdog::Watchdog;
use embassy_time::{Instant, Timer};
use static_cell::StaticCell;

use engine::{Hardware, now};
use interrupts::WAKE;
use safe_state::Cause;
use usb::{FROM_HOST, PACKET, Packet, TO_HOST};

bind_interrupts!(struct Irqs {
    USBCTRL_IRQ => embassy_rp::usb::InterruptHandler<USB>;
    PIO0_IRQ_0 => pio::InterruptHandler<PIO0>;
    PIO1_IRQ_0 => pio::InterruptHandler<PIO1>;
});

type BoardPins = Pins<Output<'static>, Input<'static>>;

/// The most reads of the receive pipe, and the most packets given to USB, in one turn.
const MOST_PER_TURN: usize = 8;

/// The logic's task: bytes in, one turn, words to the machines, bytes out.
#[embassy_executor::task]
async fn control(
    mut board: Board<Output<'static>, Input<'static>>,
    mut hardware: Hardware,
    mut keeper: roll::Keeper,
) -> ! {
    let mut bytes = [0; 128];
    let mut state = board.state();
    loop {
        for _ in 0..MOST_PER_TURN {
            let Ok(length) = FROM_HOST.try_read(&mut bytes) else {
                break;
            };
            board.receive(now(), bytes.get(..length).unwrap_or_default());
        }
        if usb::take_link_lost() {
            board.link_reset();
        }
        let next = board.poll(now(), &mut hardware);
        hardware.pump();
        if board.state() != state {
            state = board.state();
            log(state);
        }
        for _ in 0..MOST_PER_TURN {
            if TO_HOST.is_full() {
                break;
            }
            let mut packet = [0; PACKET];
            let length = board.transmit(now(), &mut packet);
            let Ok(packet) = Packet::from_slice(packet.get(..length).unwrap_or_default()) else {
                break;
            };
            if packet.is_empty() || TO_HOST.try_send(packet).is_err() {
                break;
            }
        }
        roll::check_in(roll::CONTROL);
        keeper.keep();
        match board.reboot_requested() {
            Some(Reboot::Program) => safe_state::reset(Cause::Requested, 0),
            Some(Reboot::Bootloader) => safe_state::bootloader(),
            None => {}
        }
        // USB has its turn even when the logic has more to do at once.
        yield_now().await;
        select(WAKE.wait(), Timer::at(Instant::from_micros(next.0))).await;
    }
}

/// The log of what the host is told as well; a fault with its cause in words.
fn log(state: State) {
    match state {
        State::Fault(fault) => defmt::error!("fault: {}", defmt::Display2Format(&fault)),
        _ => defmt::info!("state: {}", defmt::Debug2Format(&state)),
    }
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let p = embassy_rp::init(chip());
    // Driver off before anything else; the laser's pin is low by its pull-down since power-on.
    let pins: BoardPins = Pins {
        enable: Output::new(p.PIN_4, Level::High),
        direction: Output::new(p.PIN_3, Level::Low),
        led: Output::new(p.PIN_25, Level::Low),
        home: Input::new(p.PIN_10, Pull::Up),
        limit: Input::new(p.PIN_11, Pull::Up),
        estop: Input::new(p.PIN_12, Pull::Up),
        interlock: Input::new(p.PIN_13, Pull::Up),
        exposure: Input::new(p.PIN_14, Pull::Down),
    };
    let mut first = Pio::new(p.PIO0, Irqs);
    let mut second = Pio::new(p.PIO1, Irqs);
    let pads = machines::Pads {
        step: first.common.make_pio_pin(p.PIN_2),
        trigger: first.common.make_pio_pin(p.PIN_6),
        laser: second.common.make_pio_pin(p.PIN_7),
    };
    let steppers = (first.sm0, first.sm1, first.sm2, first.sm3);
    let watchers = (second.sm0, second.sm1, second.sm2, second.sm3);
    if machines::set_up(
        &mut first.common,
        &mut second.common,
        &pads,
        steppers,
        watchers,
    )
    .is_err()
    {
        safe_state::reset(Cause::Panic, 0);
    }
    // Dropping these would give the pins back.
    core::mem::forget((first.common, second.common, pads));
    let reason = roll::reset_reason();
    let identity = Identity {
        board: interrupts::flash_number(p.FLASH),
        firmware: [
            version(env!("CARGO_PKG_VERSION_MAJOR")),
            version(env!("CARGO_PKG_VERSION_MINOR")),
            version(env!("CARGO_PKG_VERSION_PATCH")),
        ],
    };
    interrupts::enable();
    defmt::info!(
        "boot: clock {=u32} Hz, reset reason {=u8}",
        embassy_rp::clocks::clk_sys_freq(),
        reason as u8
    );
    usb::start(
        spawner,
        embassy_rp::usb::Driver::new(p.USB, Irqs),
        serial(identity.board),
    );
    let board = Board::new(pins, identity, reason);
    let keeper = roll::Keeper::start(Watchdog::new(p.WATCHDOG));
    // One place, taken once.
    let _ = control(board, Hardware::new(), keeper).map(|task| spawner.spawn(task));
}

/// The chip's clocks: 125 MHz, to which every time on the wire and in the plans refers.
#[cfg(feature = "rp2040")]
fn chip() -> embassy_rp::config::Config {
    embassy_rp::config::Config::default()
}

/// The same: a Pico 2 would run at 150 MHz by itself.
#[cfg(feature = "rp2350")]
fn chip() -> embassy_rp::config::Config {
    match embassy_rp::clocks::ClockConfig::system_freq(cannula_shared::units::CLOCK_HZ) {
        Ok(clocks) => embassy_rp::config::Config::new(clocks),
        Err(_) => safe_state::reset(Cause::Panic, line!()),
    }
}

/// A part of the version, which is a small decimal number.
const fn version(part: &str) -> u8 {
    let mut value = 0u8;
    let mut rest = part.as_bytes();
    while let [digit, tail @ ..] = rest {
        value = value
            .wrapping_mul(10)
            .wrapping_add(digit.wrapping_sub(b'0'));
        rest = tail;
    }
    value
}

/// The board's number as the serial number of the USB device.
fn serial(number: [u8; 8]) -> &'static str {
    static TEXT: StaticCell<heapless::String<16>> = StaticCell::new();
    let text = TEXT.init(heapless::String::new());
    for byte in number {
        for nibble in [byte >> 4, byte & 15] {
            let digit = char::from_digit(u32::from(nibble), 16).unwrap_or('0');
            let _ = text.push(digit);
        }
    }
    text
}
