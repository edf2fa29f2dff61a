//! Cannula's host library: one module per stage, from a recording to the needle.
//!
//! ```text
//! session ─► board ─► calibration::camera ─► calibration::light ─┐
//!    │                                                            ▼
//!    └─────► stripe ────────────────────────────────────────► cloud ─► needle ◄─ puncture
//! ```
//!
//! Each stage takes plain data and gives plain data. `geometry` knows no images, `calibration`
//! no files, no stage the command line.
//!
//! # Conventions
//! Millimetres; radians (degrees only in files and on the screen); pixels with the centre of the
//! top-left pixel at (0, 0), u right, v down. Camera frame: X right, Y down, Z away from the
//! camera. Distortion k1, k2, p1, p2, k3 (OpenCV's order). Light plane:
//! A·X + B·Y + C·Z + D(x) = 0 with |(A, B, C)| = 1, C > 0, D(x) = a·x + b, x the slide in mm.
#![forbid(unsafe_code)]

pub mod board;
pub mod calibration;
pub mod checks;
pub mod cli;
pub mod cloud;
pub mod doctor;
pub mod geometry;
pub mod image;
mod median;
pub mod needle;
pub mod output;
pub mod pipeline;
pub mod progress;
pub mod puncture;
pub mod report;
pub mod rig;
pub mod session;
pub mod simd;
pub mod simulation;
pub mod stripe;
#[cfg(test)]
mod synthetic;
pub mod uf2;

/// Program, version and the commit that it is built from: in every file that it writes.
pub const PROGRAM: &str = concat!(
    "cannula ",
    env!("CARGO_PKG_VERSION"),
    " (",
    env!("CANNULA_COMMIT"),
    ")"
);

/// The same without the program's name.
pub const VERSION: &str = PROGRAM.split_at("cannula ".len()).1;
