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
//! | [`ramp`] | t(n) = isqrt(n·2f²/a), exact to the cycle |
//! | [`profile`] | a move: ramp up, cruise, ramp down, as absolute edge times |
//! | [`words`] | what the step and compare machines are fed with |
//! | [`segment`], [`triggers`] | a profile as step words, a trigger plan as compare words, streamed |
//! | [`verify`] | the words decoded again and held against the plan |
//! | [`motion`] | one move under way: feeding, arming, its end |
//! | [`homing`], [`scan_plan`], [`scan`] | the jobs |
//! | [`exposure`], [`laser`] | exposures counted; when a scan wants light |
//! | [`safety`] | whether the laser may be on; what is a fault |
//! | [`ledger`], [`link`] | events kept until acknowledged; commands executed once |
//! | [`checkin`] | the watchdog's roll call |
//! | [`engine`] | the hardware that executes them, as a trait |
//! | [`pins`] | plain inputs and outputs through embedded-hal |
//! | [`board`] | all of it: what the binary and the simulation drive |
#![no_std]
#![forbid(unsafe_code)]
// No panics on the board: what can fail says so.
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::todo,
        clippy::indexing_slicing
    )
)]

pub mod board;
pub mod checkin;
mod commands;
pub mod engine;
pub mod exposure;
pub mod homing;
mod jobs;
pub mod laser;
pub mod ledger;
pub mod link;
pub mod motion;
pub mod pins;
pub mod profile;
pub mod ramp;
pub mod safety;
pub mod scan;
pub mod scan_plan;
pub mod segment;
pub mod triggers;
pub mod verify;
pub mod words;
