//! Where the time goes: seconds a stage, summed over threads, so that reading can be told from
//! working.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// What time is spent on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Reading and decoding images.
    Read,
    /// Board corners.
    Corners,
    /// The stripe on the board.
    BoardStripe,
    /// Zhang's calibration.
    Camera,
    /// The light planes.
    Light,
    /// The stripe on the hand.
    HandStripe,
    /// Triangulation.
    Cloud,
    /// Plane, entry, axis.
    Needle,
    /// Force curves by the reference simulation.
    Puncture,
    /// Writing files.
    Write,
}

/// All stages in the order of a job.
const STAGES: [(Stage, &str); 10] = [
    (Stage::Read, "read"),
    (Stage::Corners, "corners"),
    (Stage::BoardStripe, "board_stripe"),
    (Stage::Camera, "camera"),
    (Stage::Light, "light"),
    (Stage::HandStripe, "hand_stripe"),
    (Stage::Cloud, "cloud"),
    (Stage::Needle, "needle"),
    (Stage::Puncture, "puncture"),
    (Stage::Write, "write"),
];

/// Nanoseconds a stage.
#[derive(Debug, Default)]
pub struct Times([AtomicU64; STAGES.len()]);

impl Times {
    /// Runs `work` on the clock of `stage`.
    pub fn time<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let spent = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.0[stage as usize].fetch_add(spent, Ordering::Relaxed);
        result
    }

    /// Name and seconds of each stage that took any.
    pub fn seconds(&self) -> Vec<(&'static str, f64)> {
        STAGES
            .iter()
            .map(|(stage, name)| (*name, self.0[*stage as usize].load(Ordering::Relaxed)))
            .filter(|(_, nanos)| *nanos > 0)
            .map(|(name, nanos)| (name, nanos as f64 * 1e-9))
            .collect()
    }
}
