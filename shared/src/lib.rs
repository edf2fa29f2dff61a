//! What the motion board and the host must agree on: units, messages, framing, the trigger plan
//! and error codes. `no_std`, no allocation; knows neither the firmware nor the host.
//!
//! | module | what it holds |
//! |---|---|
//! | [`units`] | steps, micrometres, microseconds, cycles, steps per mm as a ratio |
//! | [`plan`] | on which step trigger k stands |
//! | [`message`] | the one table of commands, replies, events and telemetry |
//! | [`config`] | the board's configuration and its limits, field by field |
//! | [`error`] | refusals and faults, each with the limit that was broken |
//! | [`frame`] | COBS frames with kind, session, sequence, acknowledgement and CRC-32 |
//! | [`hello`] | the greeting that never changes |
//! | [`schema`] | the hash over the message table |
//! | [`crc`] | CRC-32 |
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

#[macro_use]
pub mod schema;
pub mod cobs;
pub mod config;
pub mod crc;
pub mod error;
pub mod frame;
pub mod hello;
pub mod message;
pub mod plan;
pub mod units;
