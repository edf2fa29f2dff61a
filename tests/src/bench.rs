//! A bench with a simulated motion board: the set-up that the board's tests share.

use cannula::rig::link::Board;
use cannula::simulation::mcu::{Rig, SimulatedBoard, VirtualPipe};
use cannula_shared::config::{Config, ExposureInput};
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest};
use cannula_shared::units::StepsPerMm;

/// The ratios that the board is tested with: 800, 640, 409.6 and 406.4 steps per mm.
pub const RATIOS: [StepsPerMm; 4] = [
    StepsPerMm {
        numerator: 800,
        denominator: 1,
    },
    StepsPerMm {
        numerator: 640,
        denominator: 1,
    },
    StepsPerMm {
        numerator: 2048,
        denominator: 5,
    },
    StepsPerMm {
        numerator: 2032,
        denominator: 5,
    },
];

/// A configuration for a slide of 320 mm, with the camera's exposure counted.
pub fn config(steps_per_mm: StepsPerMm) -> Config {
    Config {
        steps_per_mm,
        travel_um: 320_000,
        homing_travel_um: 400_000,
        exposure_input: ExposureInput::Counted,
        ..Config::default()
    }
}

/// The rig that belongs to it: far switch 2 mm behind the travel.
pub fn rig(steps_per_mm: StepsPerMm) -> Rig {
    let mm = |mm: i64| mm * i64::from(steps_per_mm.numerator) / i64::from(steps_per_mm.denominator);
    Rig {
        slide: mm(20),
        far: mm(324),
        ..Rig::default()
    }
}

/// A board that has been greeted and configured, and the pipe to look at it.
pub fn connect(config: &Config, rig: Rig) -> (Board, VirtualPipe) {
    let pipe = VirtualPipe::new(SimulatedBoard::new(rig));
    let board = Board::over(pipe.clone()).expect("the simulated board answers");
    board.configure(config).expect("a sound configuration");
    (board, pipe)
}

/// 300 mm with the given spacing, from 10 mm.
pub fn scan_of_300_mm(spacing_um: u32, mode: ScanMode, laser: ScanLaser) -> ScanRequest {
    ScanRequest {
        start_um: 10_000,
        spacing_um,
        count: 300_000 / spacing_um + 1,
        speed_um_s: 20_000,
        mode,
        laser,
    }
}
