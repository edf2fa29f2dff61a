//! The rig: what moves, lights and looks.
//!
//! ```text
//!  link::Board ── ledger ──┐
//!                          ├─► acquisition (matching: frame ↔ trigger) ─► writer, pipeline
//!  Camera ─────── frames ──┘
//! ```

pub mod acquisition;
pub mod camera;
pub mod capture;
pub mod config;
pub mod folder;
#[cfg(feature = "aravis")]
pub mod genicam;
pub mod guide;
mod kept;
pub mod light_guide;
pub mod link;
pub mod lock;
pub mod matching;
pub mod open;
pub mod progress;
pub mod recording;
pub mod request;
pub mod simulated;
#[cfg(feature = "v4l")]
pub mod uvc;
pub mod writer;
