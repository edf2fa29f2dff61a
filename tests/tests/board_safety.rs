//! What must not go on: dead CPU, silent host, switches, emergency stop, interlock, lost
//! exposures, homing that fails. Judged by pin edges on the simulated motion board.

use cannula::rig::link::{Board, LinkError, ScanEvent};
use cannula::simulation::mcu::{Damage, Pin, Rig, SimulatedBoard, Switch, VirtualPipe};
use cannula_shared::config::{Config, MissingExposure};
use cannula_shared::error::{Fault, Input, Refusal};
use cannula_shared::hello::ResetReason;
use cannula_shared::message::{Event, ScanLaser, ScanMode, State};
use cannula_shared::units::{Micros, Steps};
use cannula_tests::bench::{RATIOS, config, connect, rig, scan_of_300_mm};

const R: cannula_shared::units::StepsPerMm = RATIOS[0];

fn ms(ms: u64) -> u64 {
    Micros::from_millis(ms).to_cycles().0
}

/// A board in the middle of a scan: after its 10th trigger, laser on.
fn in_mid_scan(config: &Config, mode: ScanMode, rig: Rig) -> (Board, VirtualPipe) {
    let (board, pipe) = connect(config, rig);
    board.home().expect("homes");
    let mut scan = board
        .scan(&scan_of_300_mm(2000, mode, ScanLaser::Whole))
        .expect("begins");
    loop {
        if let Some(ScanEvent::Trigger(t)) = scan.next_event().expect("goes on")
            && t.index == 9
        {
            break;
        }
    }
    std::mem::forget(scan);
    assert!(pipe.board().level(Pin::Laser));
    (board, pipe)
}

/// The last edge of STEP and the fall of LASER, after `since`.
fn end(pipe: &VirtualPipe, since: u64) -> (Option<u64>, Option<u64>) {
    let mut board = pipe.board();
    let trace = board.trace();
    let last = trace.rises(Pin::Step).filter(|&c| c > since).last();
    let off = trace.falls(Pin::Laser).find(|&c| c > since);
    (last, off)
}

#[test]
fn a_dead_cpu_leaves_neither_light_nor_motion() {
    for mode in [ScanMode::Constant, ScanMode::Ramped] {
        let (board, pipe) = in_mid_scan(&config(R), mode, rig(R));
        let died = pipe.board().now().0;
        pipe.board().kill_cpu();
        pipe.board().run_for(Micros::from_millis(2000));
        let (last, off) = end(&pipe, died);
        assert!(!pipe.board().level(Pin::Laser));
        let off = off.expect("it was on") - died;
        assert!(off <= ms(25), "laser off after {off} cycles");
        let moved = last.map_or(0, |last| last - died);
        assert!(moved <= ms(25), "motion ended after {moved} cycles");
        std::mem::forget(board);
    }
}

#[test]
fn a_silent_host_ends_light_and_motion() {
    for mode in [ScanMode::Constant, ScanMode::StopAndShoot] {
        let (board, pipe) = in_mid_scan(&config(R), mode, rig(R));
        let silent = pipe.board().now().0;
        pipe.board().damage_to_board(Damage::CUT);
        pipe.board().run_for(Micros::from_millis(2000));
        let (last, off) = end(&pipe, silent);
        let off = off.expect("it was on") - silent;
        assert!(off <= ms(300), "{mode:?}: laser off after {off} cycles");
        // Heartbeat, look-ahead and the ramp (20 mm/s at 200 mm/s²: 100 ms).
        let moved = last.map_or(0, |last| last - silent);
        assert!(
            moved <= ms(200 + 40 + 20 + 100),
            "{mode:?}: motion ended after {moved} cycles"
        );
        assert!(pipe.board().level(Pin::Enable), "driver off");
        // The host comes back and learns what happened, without a gap in the ledger.
        pipe.board().damage_to_board(Damage::NONE);
        let status = board.status().expect("answers again");
        assert!(
            matches!(status.state, State::Fault(Fault::HostSilent { .. })),
            "{:?}",
            status.state
        );
        assert!(!status.position_known && !status.driver && !status.laser);
        let events = board.take_events();
        assert!(events.iter().any(|e| matches!(
            e,
            Event::Fault {
                fault: Fault::HostSilent { .. },
                ..
            }
        )));
        // Only an explicit re-arm and homing lead on.
        assert!(matches!(
            board.home().err(),
            Some(LinkError::InFault(Fault::HostSilent { .. }))
        ));
        board.rearm().expect("the cause is gone");
        board.home().expect("homes again");
    }
}

#[test]
fn the_laser_by_hand_lives_on_lease_and_heartbeat() {
    let (board, pipe) = connect(&config(R), rig(R));
    board.laser(true).expect("at rest, closed");
    pipe.board().run_for(Micros::from_millis(100));
    assert!(pipe.board().level(Pin::Laser));
    board.keep_alive().expect("lives");
    let silent = pipe.board().now().0;
    pipe.board().run_for(Micros::from_millis(1000));
    let (_, off) = end(&pipe, silent);
    assert!(
        off.is_some_and(|off| off - silent <= ms(250)),
        "silent host"
    );
    board.rearm().expect("rearms");

    board.laser(true).expect("again");
    pipe.board().run_for(Micros::from_millis(50));
    let died = pipe.board().now().0;
    pipe.board().kill_cpu();
    pipe.board().run_for(Micros::from_millis(1000));
    let (_, off) = end(&pipe, died);
    assert!(off.is_some_and(|off| off - died <= ms(25)), "dead CPU");
    std::mem::forget(board);

    // And it ends by itself.
    let mut c = config(R);
    c.laser_manual_ms = 500;
    let (board, pipe) = connect(&c, rig(R));
    board.laser(true).expect("at rest");
    let on = pipe.board().now().0;
    for _ in 0..400 {
        board.keep_alive().expect("lives");
    }
    let (_, off) = end(&pipe, on);
    assert!(off.is_some_and(|off| (ms(499)..=ms(502)).contains(&(off - on))));
    assert!(board.take_events().contains(&Event::LaserExpired));
    // Dropping the board turns it off.
    board.laser(true).expect("again");
    board.keep_alive().expect("lives");
    assert!(pipe.board().level(Pin::Laser));
    drop(board);
    assert!(!pipe.board().level(Pin::Laser));
}

#[test]
fn a_limit_switch_lets_at_most_one_more_step_through() {
    // The far switch stands in the middle of the way; and the home switch comes early.
    let mut r = rig(R);
    r.far = 100_000;
    let (board, pipe) = connect(&config(R), r);
    board.home().expect("homes");
    let e = board.move_to(Steps(240_000), 0).unwrap_err();
    assert!(matches!(e, LinkError::Fault(Fault::Limit)), "{e}");
    let hit = {
        let mut b = pipe.board();
        let hit = b.trace().rises(Pin::Limit).next().expect("reached");
        let after = b.trace().rises(Pin::Step).filter(|&c| c > hit).count();
        assert!(after <= 1, "{after} steps after the switch");
        assert_eq!(b.rig().slide, 100_000);
        hit
    };
    assert!(hit > 0);
    let status = board.status().expect("answers");
    assert_eq!(status.state, State::Fault(Fault::Limit));
    assert!(!status.position_known && !status.driver && status.inputs.limit);
    // Away from it by homing, which watches the other switch.
    board.rearm().expect("rearms");
    board.home().expect("homes off the switch");

    let (board, pipe) = connect(&config(R), rig(R));
    board.home().expect("homes");
    board.move_to(Steps(20_000), 0).expect("moves");
    pipe.board().rig().home = Switch::Loose { by: 0 };
    pipe.board().rig().slide -= 15_000; // somebody pushed the slide, or steps were lost
    let e = board.move_to(Steps(0), 0).unwrap_err();
    assert!(matches!(e, LinkError::Fault(Fault::HomeSwitch)), "{e}");
    let mut b = pipe.board();
    let hit = b.trace().rises(Pin::Home).last().expect("reached");
    assert!(b.trace().rises(Pin::Step).filter(|&c| c > hit).count() <= 1);
}

#[test]
fn emergency_stop_and_interlock_are_latched() {
    // E-stop: motion and light end within the interrupt, the position is lost.
    let (board, pipe) = in_mid_scan(&config(R), ScanMode::Constant, rig(R));
    let pressed = pipe.board().now().0;
    pipe.board().set_estop(true);
    pipe.board().run_for(Micros(100));
    pipe.board().set_estop(false);
    pipe.board().run_for(Micros::from_millis(100));
    let (last, off) = end(&pipe, pressed - 1);
    assert!(off.is_some_and(|off| off - pressed < 1000) && last.is_none());
    let status = board.status().expect("answers");
    assert_eq!(
        status.state,
        State::Fault(Fault::EStop),
        "latched though released"
    );
    assert!(!status.position_known && !status.driver);
    board.rearm().expect("released");
    assert_eq!(board.status().unwrap().state, State::Idle);

    pipe.board().set_estop(true);
    board.keep_alive().unwrap();
    assert!(matches!(
        board.rearm().err(),
        Some(LinkError::Refused(Refusal::InputActive {
            input: Input::EStop
        }))
    ));
    pipe.board().set_estop(false);
    board.rearm().expect("released");

    // Interlock: light at once, motion by the ramp, the position stays.
    let (board, pipe) = in_mid_scan(&config(R), ScanMode::Constant, rig(R));
    let opened = pipe.board().now().0;
    pipe.board().set_interlock(true);
    let (_, off) = end(&pipe, opened - 1);
    assert_eq!(off, Some(opened), "in hardware");
    pipe.board().run_for(Micros::from_millis(150));
    assert!(matches!(
        board.rearm().err(),
        Some(LinkError::Refused(Refusal::InputActive {
            input: Input::Interlock
        }))
    ));
    pipe.board().set_interlock(false);
    assert!(
        matches!(
            board.laser(true).err(),
            Some(LinkError::InFault(Fault::Interlock))
        ),
        "latched"
    );
    let status = board.status().expect("answers");
    assert_eq!(status.state, State::Fault(Fault::Interlock));
    assert!(status.position_known && status.driver);
    board.rearm().expect("closed");
    assert_eq!(board.status().unwrap().state, State::Ready);
    assert_eq!(
        board.move_to(Steps(0), 0).expect("still knows where it is"),
        Steps(0)
    );
    assert_eq!(pipe.board().rig().slide, 800);
}

#[test]
fn a_missing_exposure_is_a_fault_or_a_counted_warning() {
    let mut r = rig(R);
    r.lost_exposures = vec![4, 7];
    let (board, _pipe) = connect(&config(R), r.clone());
    board.home().expect("homes");
    let request = scan_of_300_mm(5000, ScanMode::StopAndShoot, ScanLaser::Timed);
    let mut scan = board.scan(&request).expect("begins");
    let error = loop {
        match scan.next_event() {
            Ok(Some(_)) => {}
            Ok(None) => panic!("must fail"),
            Err(e) => break e,
        }
    };
    assert!(
        matches!(error, LinkError::Fault(Fault::MissingExposure { index: 4 })),
        "{error}"
    );
    let summary = scan.summary().expect("closed all the same");
    assert_eq!(
        (summary.fired, summary.exposures, summary.missing),
        (5, 4, 1)
    );
    drop(scan);
    // Nothing was lost but the frame: the position stands.
    assert!(board.status().unwrap().position_known);

    for mode in [ScanMode::StopAndShoot, ScanMode::Constant] {
        let mut c = config(R);
        c.missing_exposure = MissingExposure::Warning;
        let (board, _pipe) = connect(&c, r.clone());
        board.home().expect("homes");
        let mut missing = Vec::new();
        let summary = board
            .scan(&scan_of_300_mm(5000, mode, ScanLaser::Timed))
            .expect("begins")
            .run(|e| {
                if let ScanEvent::MissingExposure { index } = e {
                    missing.push(*index);
                }
            })
            .expect("completes");
        assert_eq!(missing, [4, 7], "{mode:?}");
        assert_eq!(
            (summary.fired, summary.exposures, summary.missing),
            (61, 59, 2)
        );
    }
}

#[test]
fn homing_names_what_is_wrong() {
    let failure = |change: fn(&mut Rig)| {
        let mut r = rig(R);
        change(&mut r);
        let (board, pipe) = connect(&config(R), r);
        let error = board.home().expect_err("cannot");
        let state = board.status().expect("answers").state;
        let slide = pipe.board().rig().slide;
        match error {
            LinkError::Fault(fault) => {
                assert_eq!(state, State::Fault(fault));
                assert!(!board.status().unwrap().position_known);
                (fault, slide)
            }
            other => panic!("{other}"),
        }
    };
    // Never: the way is bounded by the configured 400 mm.
    let (fault, slide) = failure(|r| r.home = Switch::Stuck(false));
    assert_eq!(fault, Fault::HomeNeverFound { travelled: 320_000 });
    assert_eq!(slide, 16_000 - 320_000);
    // Stuck from the start: backs off 8 mm, no more.
    let (fault, slide) = failure(|r| r.home = Switch::Stuck(true));
    assert_eq!(
        (fault, slide),
        (Fault::HomeStuck { backed_off: 6400 }, 16_000 + 6400)
    );
    // Loose: the second touch comes 1 mm early.
    let (fault, _) = failure(|r| r.home = Switch::Loose { by: 800 });
    assert_eq!(
        fault,
        Fault::HomeBounced {
            apart: -800,
            tolerance: 200
        }
    );
    // Both wires broken: there is no way out.
    let (fault, slide) = failure(|r| {
        r.home = Switch::Stuck(true);
        r.limit = Switch::Stuck(true);
    });
    assert_eq!((fault, slide), (Fault::Limit, 16_000));

    // A contact that bounces for 3 ms, and a slide that starts on the switch, home well.
    for (slide, bounce) in [(16_000, 3_000), (-2000, 0), (-3000, 3_000)] {
        let mut r = rig(R);
        r.slide = slide;
        r.home = Switch::Working {
            bounce: Micros(bounce),
        };
        let (board, pipe) = connect(&config(R), r);
        let homed = board.home().expect("homes");
        assert_eq!(homed.position, Steps(0));
        assert!(homed.apart.abs() <= 8, "{}", homed.apart);
        // The clearance of 1 mm, from where the slow touch saw the edge.
        assert!(
            (pipe.board().rig().slide - 800).abs() <= 8,
            "{}",
            pipe.board().rig().slide
        );
    }
}

#[test]
fn a_stop_ends_by_the_ramp_and_keeps_the_position() {
    let (board, pipe) = in_mid_scan(&config(R), ScanMode::Constant, rig(R));
    let asked = pipe.board().now().0;
    board.stop().expect("stops");
    pipe.board().run_for(Micros::from_millis(150));
    let (last, off) = end(&pipe, asked);
    assert!(off.is_some_and(|off| off - asked < ms(5)));
    assert!(last.is_some_and(|last| last - asked < ms(5 + 20 + 100 + 5)));
    let status = board.status().expect("answers");
    assert_eq!(status.state, State::Ready);
    assert!(status.position_known);
    assert_eq!(i64::from(status.position.0) + 800, pipe.board().rig().slide);
    // No trigger after the stop was taken.
    let fired = pipe
        .board()
        .trace()
        .rises(Pin::Trigger)
        .filter(|&c| c > asked + ms(2))
        .count();
    assert_eq!(fired, 0);
    assert_eq!(board.move_to(Steps(0), 0).expect("goes on"), Steps(0));
    assert_eq!(pipe.board().rig().slide, 800);
}

#[test]
fn a_restart_in_mid_session_is_noticed() {
    let (board, pipe) = in_mid_scan(&config(R), ScanMode::Constant, rig(R));
    pipe.board().restart(ResetReason::Watchdog);
    assert!(!pipe.board().level(Pin::Laser) && pipe.board().level(Pin::Enable));
    let steps = pipe.board().trace().steps();
    pipe.board().run_for(Micros::from_millis(100));
    assert_eq!(pipe.board().trace().steps(), steps);
    let error = board.status().unwrap_err();
    assert!(
        matches!(error, LinkError::Restarted(ResetReason::Watchdog)),
        "{error}"
    );
    drop(board);
    let board = Board::over(pipe.clone()).expect("greets again");
    assert_eq!(board.hello().reset, ResetReason::Watchdog);
    assert_eq!(board.status().unwrap().state, State::Boot);
    assert!(matches!(
        board.home().err(),
        Some(LinkError::Refused(Refusal::NotConfigured))
    ));
}

#[test]
fn everything_boots_safe() {
    let mut board = SimulatedBoard::new(rig(R));
    board.run_for(Micros::from_millis(500));
    assert!(!board.level(Pin::Laser) && !board.level(Pin::Step) && !board.level(Pin::Trigger));
    assert!(board.level(Pin::Enable), "driver off");
    assert_eq!(
        board.trace().rises(Pin::Laser).count() + board.trace().rises(Pin::Step).count(),
        0
    );
    assert_eq!(board.trace().falls(Pin::Enable).count(), 0);
}

#[test]
fn a_cpu_that_was_held_up_is_an_underrun_not_a_wrong_position() {
    let (board, pipe) = in_mid_scan(&config(R), ScanMode::Constant, rig(R));
    let held = pipe.board().now().0;
    pipe.board().stall_cpu(Micros::from_millis(100));
    pipe.board().run_for(Micros::from_millis(99));
    let (last, off) = end(&pipe, held);
    assert!(
        last.is_some_and(|last| last - held <= ms(25)),
        "motion starved"
    );
    assert!(
        off.is_some_and(|off| off - held <= ms(25)),
        "the lease ran out"
    );
    pipe.board().run_for(Micros::from_millis(10));
    let status = board.status().expect("answers again");
    assert!(
        matches!(status.state, State::Fault(Fault::Underrun { .. })),
        "{:?}",
        status.state
    );
    assert!(!status.position_known && !status.driver);
    let (later, _) = end(&pipe, held + ms(30));
    assert_eq!(later, None, "nothing is replayed");
    // The ledger is closed with what had fired.
    let pulses = pipe.board().trace().rises(Pin::Trigger).count();
    let summary = board.take_events().into_iter().find_map(|e| match e {
        Event::ScanEnd(summary) => Some(summary),
        _ => None,
    });
    assert_eq!(summary.map(|s| s.fired as usize), Some(pulses));
}
