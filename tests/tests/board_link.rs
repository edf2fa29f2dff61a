//! The link under damage: a hundred scans over a line that drops, flips, doubles, splits and
//! delays. No trigger event is lost or comes twice, no command is executed twice.

use cannula::rig::link::{Board, LinkError, Pipe, ScanEvent};
use cannula::simulation::mcu::{Damage, Pin, SimulatedBoard, VirtualPipe};
use cannula_shared::config::Config;
use cannula_shared::error::Fault;
use cannula_shared::frame::{self, Header, Kind, MAX_WIRE};
use cannula_shared::hello::{Hello, PROTOCOL};
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest, State};
use cannula_shared::units::{Micros, Steps};
use cannula_tests::bench::{RATIOS, config, connect, rig};
use std::io;

const R: cannula_shared::units::StepsPerMm = RATIOS[2];

/// Fast enough that a hundred scans are a matter of seconds; a heartbeat that survives the damage.
fn brisk() -> Config {
    Config {
        settle_us: 1_000,
        max_speed_um_s: 100_000,
        acceleration_um_s2: 1_000_000,
        heartbeat_us: 250_000,
        ..config(R)
    }
}

#[test]
fn a_hundred_scans_over_a_lossy_line() {
    let (board, pipe) = connect(&brisk(), rig(R));
    pipe.board().damage_to_board(Damage::LOSSY);
    pipe.board().damage_to_host(Damage::LOSSY);
    board.home().expect("homes");
    pipe.board().trace().keep_steps = false;
    for n in 0..100u32 {
        let mode = [ScanMode::Constant, ScanMode::Ramped, ScanMode::StopAndShoot][n as usize % 3];
        let request = ScanRequest {
            start_um: 10_000 + 7 * n as i32,
            spacing_um: 2000,
            count: 20 + n % 7,
            speed_um_s: 50_000,
            mode,
            laser: ScanLaser::Timed,
        };
        let steps = {
            let mut b = pipe.board();
            b.trace().clear();
            b.trace().steps()
        };
        let before = board.status().expect("answers").position;
        let mut triggers = Vec::new();
        let summary = board
            .scan(&request)
            .unwrap_or_else(|e| panic!("scan {n}: {e}"))
            .run(|event| {
                if let ScanEvent::Trigger(t) = event {
                    triggers.push(*t);
                }
            })
            .unwrap_or_else(|e| panic!("scan {n}: {e}"));
        // Not lost, not doubled: exactly the pulses on the pin, in order.
        assert_eq!(triggers.len() as u32, request.count);
        assert!(
            triggers
                .iter()
                .enumerate()
                .all(|(k, t)| t.index as usize == k)
        );
        assert_eq!(summary.fired, request.count);
        let mut b = pipe.board();
        let pulses: Vec<u64> = b.trace().rises(Pin::Trigger).collect();
        assert_eq!(pulses.len() as u32, request.count, "executed once");
        for (pulse, line) in pulses.iter().zip(&triggers) {
            assert!((line.time.0 as i64 - (pulse / 125) as i64).abs() <= 5);
        }
        // Executed once: the steps are those of one scan, from where the slide stood.
        let first = triggers[0].position.0;
        let end = triggers.last().unwrap().position.0;
        let walked = (b.trace().steps() - steps) as i64;
        let least = i64::from((before.0 - first).abs()) + i64::from(end - first);
        // Run-up and run-down of a constant pass: the ramp of 50 mm/s at 1 m/s², 512 steps, thrice at most.
        assert!(
            walked >= least - 3 * 520 && walked <= least + 3 * 520,
            "scan {n}: {walked} steps, {least} planned"
        );
        let slide = b.rig().slide;
        drop(b);
        let status = board.status().expect("answers");
        assert_eq!(
            i64::from(status.position.0),
            slide - 410,
            "scan {n}: clearance of 1 mm, 409.6 steps"
        );
        assert_eq!(status.state, State::Ready);
    }
    let counts = board.counts();
    let bad = board.status().unwrap().bad_frames;
    assert!(
        counts.repeated > 20 && counts.bad > 100 && bad > 100,
        "the line was lossy: {counts:?} {bad}"
    );
    println!("100 scans: {counts:?}, {bad} damaged frames at the board");
}

#[test]
fn moves_over_a_bad_line_are_executed_once() {
    // Every reply is lost half of the time: jogs must not add up twice.
    let (board, pipe) = connect(&brisk(), rig(R));
    board.home().expect("homes");
    let half = Damage {
        drop: 0.01,
        duplicate: 0.5,
        ..Damage::LOSSY
    };
    pipe.board().damage_to_host(half);
    pipe.board().damage_to_board(half);
    for k in 1..=50 {
        assert_eq!(board.jog(Steps(100), 0).expect("moves"), Steps(100 * k));
    }
    assert_eq!(pipe.board().rig().slide, 410 + 5000);
    // And triggers by hand.
    pipe.board().trace().clear();
    for k in 0..20 {
        assert_eq!(board.trigger().expect("fires").index, k);
    }
    assert_eq!(pipe.board().trace().rises(Pin::Trigger).count(), 20);
}

#[test]
fn a_host_that_does_not_acknowledge_stops_the_scan_before_an_event_is_lost() {
    // Frames of the board are cut off, the host's heartbeat goes on: the ledger fills up.
    let mut c = brisk();
    c.frame_time_us = 1000;
    c.exposure_us = 500;
    c.exposure_delay_us = 200;
    let mut r = rig(R);
    r.exposure = Micros(500);
    let (board, pipe) = connect(&c, r);
    board.home().expect("homes");
    pipe.board().trace().clear();
    let request = ScanRequest {
        start_um: 10_000,
        spacing_um: 200,
        count: 1000,
        speed_um_s: 50_000,
        mode: ScanMode::Constant,
        laser: ScanLaser::Whole,
    };
    let mut scan = board.scan(&request).expect("begins");
    pipe.board().damage_to_host(Damage::CUT);
    // 1000 triggers at 4 ms: the ledger of 256 is full after a second.
    let waited = scan.next_within(Micros(1_900_000));
    assert!(matches!(waited, Ok(None)), "{waited:?}");
    pipe.board().damage_to_host(Damage::NONE);
    let mut triggers = Vec::new();
    let error = loop {
        match scan.next_event() {
            Ok(Some(ScanEvent::Trigger(t))) => triggers.push(t),
            Ok(Some(_)) => {}
            Ok(None) => panic!("must end by a fault"),
            Err(e) => break e,
        }
    };
    let summary = scan.summary().expect("closed");
    assert!(
        matches!(error, LinkError::Fault(Fault::LedgerFull { index }) if index == summary.fired),
        "{error}"
    );
    // Every pulse that was given is in the ledger.
    let pulses = pipe.board().trace().rises(Pin::Trigger).count();
    assert_eq!(triggers.len(), pulses);
    assert!(pulses >= 100, "{pulses}");
    drop(scan);
    let status = board.status().expect("answers");
    assert!(status.position_known, "stopped by the ramp");
    assert_eq!(i64::from(status.position.0) + 410, pipe.board().rig().slide);
}

#[test]
fn a_new_host_takes_over_and_the_old_one_learns_it() {
    let (old, pipe) = connect(&brisk(), rig(R));
    old.home().expect("homes");
    old.laser(true).expect("on");
    let new = Board::over(pipe.clone()).expect("greets");
    new.keep_alive().unwrap();
    assert!(
        !pipe.board().level(Pin::Laser),
        "the old host's laser went with it"
    );
    assert_eq!(new.status().expect("answers").state, State::Ready);
    let error = old.status().unwrap_err();
    assert!(matches!(error, LinkError::TakenOver), "{error}");
}

/// A pipe whose other end answers the greeting with whatever it is told.
struct Stranger(Option<Hello>, Vec<u8>);

impl Pipe for Stranger {
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize> {
        self.1 = self.1.drain(..).collect();
        std::thread::sleep(std::time::Duration::from_micros(wait.0.min(10)));
        let n = self.1.len().min(buffer.len());
        buffer[..n].copy_from_slice(&self.1[..n]);
        self.1.drain(..n);
        Ok(n)
    }
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut decoder = frame::Decoder::new();
        for &byte in bytes {
            if let (Some((header, _)), Some(hello)) = (decoder.push(byte), self.0) {
                let mut out = [0; MAX_WIRE];
                let answer = Header {
                    kind: Kind::Hello,
                    sequence: 0,
                    acknowledge: 0,
                    ..header
                };
                let n = frame::encode(answer, &hello.encode(), &mut out).unwrap();
                self.1.extend_from_slice(&out[..n]);
            }
        }
        Ok(())
    }
    fn now(&mut self) -> Micros {
        static T: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
        Micros(T.fetch_add(1000, std::sync::atomic::Ordering::Relaxed))
    }
    fn real_time(&self) -> bool {
        false
    }
}

#[test]
fn boards_of_another_time_are_told_apart() {
    let identity = cannula_shared::hello::Identity {
        board: [7; 8],
        firmware: [0, 9, 3],
    };
    let ours = Hello::of(
        identity,
        cannula_shared::hello::ResetReason::PowerOn,
        Micros(5),
        1,
    );
    let error = |hello| {
        Board::over(Stranger(hello, Vec::new()))
            .err()
            .expect("no board of ours")
    };
    let e = error(Some(Hello {
        protocol: PROTOCOL + 1,
        ..ours
    }));
    assert!(matches!(e, LinkError::Version { board: 2, host: 1 }));
    assert!(e.to_string().contains("flash the firmware"), "{e}");
    let e = error(Some(Hello { schema: 42, ..ours }));
    assert!(matches!(
        e,
        LinkError::Schema {
            board: 42,
            firmware: [0, 9, 3],
            ..
        }
    ));
    assert!(e.to_string().contains("0.9.3"), "{e}");
    let e = error(None);
    assert!(matches!(e, LinkError::NoHello { .. }), "{e}");
    // A board that is just not there.
    let e = Board::connect("/dev/does-not-exist").err().expect("cannot");
    assert!(
        e.to_string()
            .starts_with("/dev/does-not-exist: cannot open"),
        "{e}"
    );
}

#[test]
fn a_greeting_gets_through_a_bad_line() {
    for _ in 0..20 {
        let mut simulated = SimulatedBoard::new(rig(R));
        let bad = Damage {
            drop: 0.01,
            ..Damage::LOSSY
        };
        simulated.damage_to_board(bad);
        simulated.damage_to_host(bad);
        let pipe = VirtualPipe::new(simulated);
        let board = Board::over(pipe.clone()).expect("gets through");
        board.configure(&brisk()).expect("gets through");
    }
}
