//! The motion board's logic with time and pins as arguments, so that the same code runs on the
//! RP2040, in the simulated MCU on the host, and in tests.
//!
//! ```text
//!   bytes ─► link ─► board (state machine) ─► scan / homing / moves ─► profile ─► step words ─► Engine
//!   pins ──► safety ──┘        │                                          └ verify (before motion)
//!                     ledger ◄─┴─ triggers, exposures ◄──────────────────────────────────────── Engine
//! ```
//!
//! | module | what it does |
//! |---|---|
//! | [`words`] | what the step and compare machines are fed with |
//! | [`engine`] | the hardware that executes them, as a trait |
//! | [`pins`] | plain inputs and outputs through embedded-hal |
//! | [`board`] | all of it: what the binary and the simulation drive |
#![no_std]
#![forbid(unsafe_code)]

pub mod board;
pub mod checkin;
pub mod engine;
pub mod pins;
pub mod profile;
pub mod ramp;
pub mod segment;
pub mod triggers;
pub mod verify;
pub mod words;
