//! Sweeps over the hand of the simulated rig, each shot checked against where the laser's line truly
//! belongs: what the acquisition's tests share.

use cannula::rig::acquisition::{AcquireError, Acquisition, Shot, Sweep};
use cannula::rig::camera::Picture;
use cannula::rig::config::{Mode, Rig};
#[cfg(unix)]
use cannula::rig::link::Board;
use cannula::rig::open::{self, Opened};
use cannula::rig::simulated::Stage;
#[cfg(unix)]
use cannula::simulation::mcu::RealTime;
use cannula::simulation::{Renderer, Scene, Subject, scan_stripe};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// rig.toml of a simulated rig with a small camera, seven slide positions for the light planes.
pub const SMALL_RIG: &str = "[board]\nport = \"simulated\"\nsettle_ms = 20.0\n\
                             [light]\nspacing_mm = 10.0\ncount = 7\n\
                             [simulation]\nseed = 6\nprofile = \"tiny\"\n";

/// A rig whose twelve positions all show the hand.
pub fn rig(mode: Mode) -> Rig {
    let mut rig = Rig::default();
    rig.board.port = open::SIMULATED.into();
    rig.board.settle_ms = 20.0;
    rig.simulation.seed = 11;
    rig.simulation.profile = "tiny".into();
    rig.scan.start_mm = 16.0;
    rig.scan.count = 12;
    rig.scan.mode = mode;
    rig
}

/// A homed rig with the hand before its camera.
pub fn opened(rig: &Rig) -> (Opened, Stage) {
    let opened = open::open(rig).unwrap();
    open::ready(&opened.board, rig).unwrap();
    let stage = opened.stage.clone().unwrap();
    stage.show(&Subject::Hand);
    (opened, stage)
}

/// The same board in real time behind a pseudo-terminal, homed, with the hand on a stage before no
/// camera yet.
#[cfg(unix)]
pub fn in_real_time(rig: &Rig) -> (RealTime, Board, Stage) {
    let real = RealTime::start(open::simulated_board(rig)).unwrap();
    let scene = Scene::new(rig.profile(), rig.simulation.seed);
    let renderer = Arc::new(Renderer::new(scene).unwrap());
    let stage = Stage::new(renderer, rig.camera.exposure_laser_ms);
    stage.show(&Subject::Hand);
    let board = Board::connect(real.path()).unwrap();
    assert!(open::ready(&board, rig).unwrap().is_some());
    (real, board, stage)
}

/// How far the brightest row of each column lies from where the laser's line belongs with the
/// slide at that position: the median, px. The line moves by about 3 px from one to the next.
pub fn off_by_px(renderer: &Renderer, shot: &Shot) -> f64 {
    let Picture::Eight(image) = &shot.picture else {
        panic!("8 bits expected");
    };
    let line = scan_stripe(renderer, &renderer.scene().laser.plane(shot.slide_mm));
    let mut off: Vec<f64> = line
        .iter()
        .enumerate()
        .filter_map(|(u, v)| {
            let brightest = (0..image.height()).max_by_key(|&y| image.at(u, y))?;
            Some((brightest as f64 - (*v)?).abs())
        })
        .collect();
    assert!(
        off.len() > 40,
        "the hand shows in {} columns at {} mm",
        off.len(),
        shot.slide_mm
    );
    off.sort_by(f64::total_cmp);
    off[off.len() / 2]
}

/// A sweep whose every shot is checked to show its own position.
pub fn sweep(
    rig: &Rig,
    opened: &mut Opened,
    stage: &Stage,
) -> Result<(Sweep, Vec<u32>), AcquireError> {
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), rig, &cancel);
    acquisition.expose(rig.camera.exposure_laser_ms)?;
    let mut seen = Vec::new();
    let sweep = acquisition.sweep(&rig.scan_request(), &mut |shot| {
        // The middle of the exposure: on the fly the slide has moved on since the trigger.
        let moved = 0.5e-3
            * rig.camera.exposure_laser_ms
            * match rig.scan.mode {
                Mode::Stop => 0.0,
                Mode::Constant => rig.scan.speed_mm_s,
            };
        let expected = rig.scan.start_mm + rig.scan.spacing_mm * f64::from(shot.index) + moved;
        assert!(
            (shot.slide_mm - expected).abs() < 1e-3,
            "{} {expected}",
            shot.slide_mm
        );
        let off = off_by_px(stage.renderer(), &shot);
        assert!(
            off < 1.2,
            "trigger {} shows a line {off} px off",
            shot.index
        );
        seen.push(shot.index);
        Ok(())
    })?;
    Ok((sweep, seen))
}
