//! The rig: what moves, lights and looks.
//!
//! ```text
//!  link::Board ── ledger ──┐
//!                          ├─► acquisition (matching: frame ↔ trigger) ─► writer, pipeline
//!  Camera ─────── frames ──┘
//! ```

pub mod acquisition;
pub mod camera;
pub mod config;
pub mod folder;
pub mod link;
pub mod matching;
pub mod simulated;
pub mod writer;
