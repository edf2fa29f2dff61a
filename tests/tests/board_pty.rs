//! The host's real serial code against the simulated board, in step with real time, over a
//! pseudo-terminal.
#![cfg(unix)]

use cannula::rig::link::{Board, LinkError, ScanEvent};
use cannula::simulation::mcu::{Damage, Pin, RealTime, SimulatedBoard};
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest, State};
use cannula_shared::units::{Micros, Steps};
use cannula_tests::bench::{RATIOS, config, rig};
use std::time::{Duration, Instant};

#[test]
fn homing_scanning_and_silence_over_a_pseudo_terminal() {
    let r = RATIOS[1];
    let mut near = rig(r);
    near.slide = 2_000;
    let simulated = RealTime::start(SimulatedBoard::new(near)).expect("a pseudo-terminal");
    let board = Board::connect(simulated.path()).expect("answers");
    let mut c = config(r);
    c.homing_fast_um_s = 40_000;
    c.max_speed_um_s = 100_000;
    c.acceleration_um_s2 = 2_000_000;
    c.settle_us = 2_000;
    board.configure(&c).expect("sound");
    assert_eq!(board.home().expect("homes").position, Steps(0));

    let request = ScanRequest {
        start_um: 2_000,
        spacing_um: 2_000,
        count: 12,
        speed_um_s: 40_000,
        mode: ScanMode::Constant,
        laser: ScanLaser::Timed,
    };
    let mut positions = Vec::new();
    let began = Instant::now();
    // 24 mm at 40 mm/s: 0.6 s.
    let summary = board
        .scan(&ScanRequest {
            start_um: 4_000,
            ..request
        })
        .expect("begins")
        .run(|e| {
            if let ScanEvent::Trigger(t) = e {
                positions.push(t.position.0);
            }
        })
        .expect("completes");
    assert_eq!(summary.fired, 12);
    let planned: Vec<i32> = (0..12).map(|k| (4 + 2 * k) * 640).collect();
    assert_eq!(positions, planned);
    assert!(
        began.elapsed() > Duration::from_millis(550),
        "in step with real time"
    );

    // Nobody calls for a while: the heartbeat's thread keeps the laser on.
    board.laser(true).expect("at rest");
    std::thread::sleep(Duration::from_millis(700));
    assert!(simulated.board().board().level(Pin::Laser));
    assert_eq!(board.status().expect("answers").state, State::Ready);

    // The cable is cut: off within 300 ms.
    simulated.board().board().damage_to_board(Damage::CUT);
    let cut = simulated.board().board().now().0;
    std::thread::sleep(Duration::from_millis(600));
    let off = simulated
        .board()
        .board()
        .trace()
        .falls(Pin::Laser)
        .last()
        .expect("off");
    assert!(off > cut && off - cut <= Micros::from_millis(300).to_cycles().0);
    simulated.board().board().damage_to_board(Damage::NONE);
    let state = board.status().expect("answers again").state;
    assert!(matches!(state, State::Fault(_)), "{state:?}");
    board.rearm().expect("re-arms");
    drop(board);

    // A second client finds the board as it was left; a dead board is told from a wrong port.
    let board = Board::connect(simulated.path()).expect("answers again");
    assert_eq!(board.status().expect("answers").state, State::Idle);
    simulated.board().board().kill_cpu();
    let error = board.status().unwrap_err();
    assert!(matches!(error, LinkError::Timeout { .. }), "{error}");
    drop(board);
    let error = Board::connect(simulated.path())
        .err()
        .expect("nobody there");
    assert!(matches!(error, LinkError::NoHello { .. }), "{error}");
}
