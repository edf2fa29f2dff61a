//! A board in the emulator on a slide, homed and configured, and what its pins must show.

use cannula::rig::link::{Board, Result, ScanEvent};
use cannula_shared::config::Config;
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest, ScanSummary, Trigger};
use cannula_shared::units::StepsPerMm;

use crate::edges::{Edges, intervals, pin};
use crate::emulator::{Emulator, Shared, UsbPipe};
use std::path::PathBuf;

/// The clock.
pub const HZ: f64 = 125e6;

/// A board under test.
pub struct Rig {
    pub emulator: Shared,
    pub board: Board,
    pub config: Config,
}

/// A quick camera and a stiff slide: `rate` steps/s at most, `acceleration` steps/s².
pub fn config(steps_per_mm: StepsPerMm, rate: u64, acceleration: u64) -> Config {
    let per_m = |steps: u64| {
        // µm for so many steps, rounded down: a speed that the board reaches without exceeding.
        (steps * 1000 * u64::from(steps_per_mm.denominator) / u64::from(steps_per_mm.numerator))
            as u32
    };
    Config {
        steps_per_mm,
        travel_um: 305_000,
        max_speed_um_s: per_m(rate),
        acceleration_um_s2: per_m(acceleration),
        homing_fast_um_s: 20_000.min(per_m(rate)),
        homing_slow_um_s: 5_000,
        homing_backoff_um: 500,
        homing_travel_um: 20_000,
        homing_tolerance_um: 250,
        clearance_um: 100,
        run_up_um: 200,
        trigger_pulse_us: 100,
        frame_time_us: 500,
        exposure_us: 500,
        settle_us: 2_000,
        laser_lead_us: 300,
        telemetry_us: 20_000,
        ..Config::default()
    }
}

impl Rig {
    /// Powers up, configures and homes.
    pub fn start(found: &(PathBuf, PathBuf), config: Config) -> Result<Self> {
        Self::start_over(found, config, Shared::pipe)
    }

    /// As [`Self::start`], over a pipe of one's own.
    pub fn start_over(
        found: &(PathBuf, PathBuf),
        config: Config,
        pipe: impl FnOnce(&Shared) -> UsbPipe,
    ) -> Result<Self> {
        let mut emulator = Emulator::start(found)?;
        let steps = |um: u64| {
            um * u64::from(config.steps_per_mm.numerator)
                / (1000 * u64::from(config.steps_per_mm.denominator))
        };
        emulator.command(&format!("slide {} {}", steps(1_500), steps(320_000)))?;
        let emulator = Shared::new(emulator);
        let board = Board::over(pipe(&emulator))?;
        board.configure(&config)?;
        board.home()?;
        Ok(Self {
            emulator,
            board,
            config,
        })
    }

    /// Forgets the edges so far; what DIR is and where the slide stands.
    pub fn mark(&self) -> Result<Mark> {
        let status = self.board.status()?;
        assert!(
            status.position_known && !status.moving,
            "at rest, at a known place: {status:?}"
        );
        let mut emulator = self.emulator.get();
        let away = emulator.edges()?.level(pin::DIR, u64::MAX).unwrap_or(false);
        emulator.command("mark")?;
        Ok(Mark {
            position: i64::from(status.position.0),
            away,
        })
    }

    /// Runs a scan to its end: the ledger's lines and its summary.
    pub fn scan(&self, request: &ScanRequest) -> Result<(Vec<Trigger>, ScanSummary)> {
        let mut scan = self.board.scan(request)?;
        let (mut triggers, mut end) = (Vec::new(), None);
        while let Some(event) = scan.next_event()? {
            match event {
                ScanEvent::Trigger(trigger) => triggers.push(trigger),
                ScanEvent::End(summary) => end = Some(summary),
                ScanEvent::Position(_) | ScanEvent::MissingExposure { .. } => {}
            }
        }
        Ok((triggers, end.expect("a scan that ends well has a summary")))
    }

    /// Acceleration as the board takes it: whole steps/s², rounded down.
    pub fn acceleration(&self) -> f64 {
        let ratio = self.config.steps_per_mm;
        let product = u64::from(self.config.acceleration_um_s2) * u64::from(ratio.numerator);
        (product / (1000 * u64::from(ratio.denominator))) as f64
    }
}

/// Where things stood when the edges were forgotten.
pub struct Mark {
    pub position: i64,
    pub away: bool,
}

/// A scan on the fly at full speed.
pub fn on_the_fly(
    start_um: i32,
    spacing_um: u32,
    count: u32,
    mode: ScanMode,
    laser: ScanLaser,
) -> ScanRequest {
    ScanRequest {
        start_um,
        spacing_um,
        count,
        speed_um_s: 0,
        mode,
        laser,
    }
}

/// The step nearest to a position in µm, in exact arithmetic: ⌊(2·µm·N + 1000·D) / (2000·D)⌋.
pub fn nearest_step(ratio: StepsPerMm, um: i64) -> i64 {
    let (n, d) = (i128::from(ratio.numerator), i128::from(ratio.denominator));
    (2 * i128::from(um) * n + 1000 * d).div_euclid(2000 * d) as i64
}

/// STEP edges as moves from rest to rest. Within a move no interval is longer than t(1), its last; from
/// one move to the next there is t(1) and the rest between them.
pub fn moves(steps: &[u64], acceleration: f64) -> Vec<&[u64]> {
    let first = HZ * (2.0 / acceleration).sqrt();
    steps
        .chunk_by(|a, b| ((b - a) as f64) < first + 100.0)
        .collect()
}

/// What a move looked like beside the plan t(n) = f·√(2n/a), constant cruise, the same mirrored.
#[derive(Debug)]
pub struct Shape {
    /// Edges in either ramp.
    pub ramp: usize,
    /// Cycles from edge to edge in the cruise.
    pub cruise: (u64, u64),
    /// Edges in the cruise.
    pub cruising: usize,
    /// The farthest that an edge of a ramp lies from the plan, cycles.
    pub off: f64,
}

/// Compares a move with its plan, computed in floating point from the closed form.
pub fn shape(edges: &[u64], acceleration: f64, cruise: u64) -> Shape {
    let plan = |n: usize| HZ * (2.0 * n as f64 / acceleration).sqrt();
    // The ramp is over where its next interval would be shorter than the cruise's.
    let ramp = (1..=edges.len() / 2)
        .take_while(|&n| plan(n).floor() - plan(n - 1).floor() >= cruise as f64)
        .count();
    let n = edges.len();
    let mut off = 0.0f64;
    for k in 1..=ramp {
        // Up: against the first edge, which is the plan's n = 1. Down: against the last, its n = 0.
        let up = (edges[k - 1] - edges[0]) as f64 - (plan(k) - plan(1));
        let down = (edges[n - 1] - edges[n - 1 - k]) as f64 - plan(k);
        off = off.max(up.abs()).max(if k < n { down.abs() } else { 0.0 });
    }
    let flat = intervals(&edges[ramp.saturating_sub(1)..n - ramp]);
    let range = crate::edges::range(flat.iter().copied()).unwrap_or((0, 0));
    Shape {
        ramp,
        cruise: range,
        cruising: flat.len(),
        off,
    }
}

/// Each trigger's cycles after its STEP edge, and the position on which it fired.
pub fn triggers_on_steps(edges: &Edges, mark: &Mark) -> Vec<(u64, i64)> {
    let positions = edges.positions(mark.position, mark.away);
    edges
        .rising(pin::TRIGGER)
        .into_iter()
        .map(|trigger| {
            let before = positions.partition_point(|&(cycle, _)| cycle <= trigger);
            let (cycle, position) = positions[before
                .checked_sub(1)
                .expect("a STEP edge before the first trigger")];
            (trigger - cycle, position)
        })
        .collect()
}
