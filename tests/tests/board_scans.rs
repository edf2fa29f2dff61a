//! Scans on the simulated motion board, judged by its pin edges: every trigger on its planned
//! step, a constant offset to the STEP edge, ramps as planned, the laser around the triggers.

use cannula::rig::link::{LinkError, ScanEvent};
use cannula::simulation::mcu::{Pin, TRIGGER_DELAY};
use cannula_shared::error::Refusal;
use cannula_shared::message::{ScanLaser, ScanMode, Trigger};
use cannula_shared::units::{Micros, Steps, StepsPerMm};
use cannula_tests::bench::{RATIOS, config, connect, rig, scan_of_300_mm};

/// The step nearest to trigger k, in floating point: another way than the board's.
fn nearest(r: StepsPerMm, um: f64) -> i64 {
    (um / 1000.0 * f64::from(r.numerator) / f64::from(r.denominator) + 0.5).floor() as i64
}

/// Runs a scan; the ledger, and the edges of the pass.
fn run(
    r: StepsPerMm,
    spacing_um: u32,
    mode: ScanMode,
    laser: ScanLaser,
) -> (Vec<Trigger>, cannula::simulation::mcu::Trace) {
    let (board, pipe) = connect(&config(r), rig(r));
    board.home().expect("homes");
    pipe.board().trace().clear();
    let request = scan_of_300_mm(spacing_um, mode, laser);
    let mut triggers = Vec::new();
    let summary = board
        .scan(&request)
        .expect("begins")
        .run(|event| {
            if let ScanEvent::Trigger(t) = event {
                triggers.push(*t);
            }
        })
        .expect("completes");
    assert_eq!(summary.fired, request.count);
    assert_eq!((summary.exposures, summary.missing), (request.count, 0));
    let trace = pipe.board().trace().clone();
    (triggers, trace)
}

#[test]
fn on_the_fly_every_trigger_stands_on_its_step() {
    for r in RATIOS {
        for spacing in [2000, 5000] {
            for mode in [ScanMode::Constant, ScanMode::Ramped] {
                let (triggers, trace) = run(r, spacing, mode, ScanLaser::Timed);
                let steps: Vec<u64> = trace.rises(Pin::Step).collect();
                let fires: Vec<u64> = trace.rises(Pin::Trigger).collect();
                assert_eq!(fires.len(), triggers.len());
                // All moves of the scan lead away from home, from zero: edge n is step n.
                for (k, (fire, line)) in fires.iter().zip(&triggers).enumerate() {
                    let step = steps.partition_point(|s| s < fire) as i64;
                    let planned = nearest(r, 10_000.0 + k as f64 * f64::from(spacing));
                    assert_eq!(step, planned, "{r} {spacing} {mode:?} trigger {k}");
                    assert_eq!(i64::from(line.position.0), planned);
                    assert_eq!(
                        fire - steps[step as usize - 1],
                        TRIGGER_DELAY,
                        "offset of trigger {k}"
                    );
                    // The ledger's time is the interrupt's, some microseconds later.
                    assert!((0..=5).contains(&(line.time.0 as i64 - (fire / 125) as i64)));
                    assert!(line.laser);
                }
            }
        }
    }
}

#[test]
fn the_pass_keeps_its_plan_to_the_cycle() {
    let r = RATIOS[2];
    let (_, trace) = run(r, 2000, ScanMode::Ramped, ScanLaser::Whole);
    let steps: Vec<u64> = trace.rises(Pin::Step).collect();
    let begin = (nearest(r, 10_000.0) - 205) as usize;
    // The pass begins 0.5 mm (205 steps, rounded up) before the first trigger.
    let pass = &steps[begin..];
    let n = pass.len();
    assert_eq!(begin as i64 + n as i64, nearest(r, 310_000.0));
    let intervals: Vec<u64> = pass.windows(2).map(|w| w[1] - w[0]).collect();
    // 20 mm/s = 8192 steps/s: ⌈125e6 / 8192⌉ cycles; 200 mm/s² = 81 920 steps/s².
    let cruise = 15_259;
    let c = (2.0 * 125e6f64 * 125e6 / 81_920.0).floor();
    let t = |k: usize| (k as f64 * c).sqrt().floor() as u64;
    let ramp = intervals.iter().position(|&i| i == cruise).unwrap() + 1;
    assert!(
        (405..=410).contains(&ramp),
        "v²/2a = 409.6 steps, not {ramp}"
    );
    for k in 2..ramp {
        assert_eq!(intervals[k - 2], t(k) - t(k - 1), "step {k} of the ramp");
    }
    let mirrored: Vec<u64> = intervals.iter().rev().take(ramp - 2).copied().collect();
    // The first interval of the move precedes its first edge; at the end it stands before the last.
    assert_eq!(mirrored[0], t(1));
    assert!((2..ramp - 1).all(|k| mirrored[k - 1] == t(k) - t(k - 1)));
    let flat = &intervals[ramp..n - 1 - ramp];
    assert!(flat.len() > 100_000);
    assert!(flat.iter().all(|&i| i == cruise), "cruise has no jitter");
}

#[test]
fn a_hundred_thousand_steps_per_second_without_a_gap() {
    // 125 mm/s at 800 steps/mm = 100 000 steps/s; and the promised maximum of 500 000.
    for (um_s, interval) in [(125_000, 1250u64), (625_000, 250)] {
        let mut c = config(RATIOS[0]);
        c.max_speed_um_s = um_s;
        c.acceleration_um_s2 = 5_000_000;
        c.telemetry_us = 0;
        let (board, pipe) = connect(&c, rig(RATIOS[0]));
        board.home().expect("homes");
        pipe.board().trace().clear();
        assert_eq!(
            board.move_to(Steps(240_000), 0).expect("arrives"),
            Steps(240_000)
        );
        let steps: Vec<u64> = pipe.board().trace().rises(Pin::Step).collect();
        assert_eq!(steps.len(), 240_000);
        let intervals: Vec<u64> = steps.windows(2).map(|w| w[1] - w[0]).collect();
        // Where the ramp meets the cruise, its whole cycles alternate; then not one differs.
        let flat = intervals
            .chunk_by(|a, b| a == b)
            .map(<[u64]>::len)
            .max()
            .unwrap();
        assert!(flat > 150_000, "{flat} equal intervals");
        assert_eq!(*intervals.iter().min().unwrap(), interval);
    }
}

#[test]
fn stop_and_shoot_stands_settles_and_lights() {
    let r = RATIOS[3];
    let (triggers, trace) = run(r, 5000, ScanMode::StopAndShoot, ScanLaser::Timed);
    let steps: Vec<u64> = trace.rises(Pin::Step).collect();
    let fires: Vec<u64> = trace.rises(Pin::Trigger).collect();
    let (on, off): (Vec<u64>, Vec<u64>) = (
        trace.rises(Pin::Laser).collect(),
        trace.falls(Pin::Laser).collect(),
    );
    let exposed: Vec<u64> = trace.falls(Pin::Exposure).collect();
    assert_eq!([fires.len(), on.len(), off.len(), exposed.len()], [61; 4]);
    for (k, fire) in fires.iter().enumerate() {
        let step = steps.partition_point(|s| s < fire);
        assert_eq!(step as i64, nearest(r, 10_000.0 + 5000.0 * k as f64));
        assert_eq!(triggers[k].position, Steps(step as i32));
        // Settled, then lit for the lead time, and no step until the exposure has ended.
        let lead = Micros(2_000).to_cycles().0;
        assert!(on[k] >= steps[step - 1] + Micros(100_000).to_cycles().0);
        assert!(
            (lead..lead + 50_000).contains(&(fire - on[k])),
            "lead {}",
            fire - on[k]
        );
        assert!(off[k] >= exposed[k] && off[k] - exposed[k] < Micros(1_200).to_cycles().0);
        assert!(steps.get(step).is_none_or(|next| *next > exposed[k]));
    }
}

#[test]
fn the_laser_is_on_around_the_triggers_only() {
    let (_, trace) = run(RATIOS[0], 2000, ScanMode::Constant, ScanLaser::Timed);
    let fires: Vec<u64> = trace.rises(Pin::Trigger).collect();
    let (on, off): (Vec<u64>, Vec<u64>) = (
        trace.rises(Pin::Laser).collect(),
        trace.falls(Pin::Laser).collect(),
    );
    let ends: Vec<u64> = trace.falls(Pin::Exposure).collect();
    assert_eq!((on.len(), off.len()), (fires.len(), fires.len()));
    for k in 0..fires.len() {
        let step = fires[k] - TRIGGER_DELAY;
        // The lead, and the latest end of an exposure that begins within 2 ms and lasts 5: to the cycle.
        assert_eq!(step - on[k], Micros(2_000).to_cycles().0, "trigger {k}");
        assert_eq!(off[k] - step, Micros(7_000).to_cycles().0, "trigger {k}");
        assert!(off[k] >= ends[k], "trigger {k}");
    }

    let (_, trace) = run(RATIOS[0], 2000, ScanMode::Constant, ScanLaser::Whole);
    let fires: Vec<u64> = trace.rises(Pin::Trigger).collect();
    let (on, off): (Vec<u64>, Vec<u64>) = (
        trace.rises(Pin::Laser).collect(),
        trace.falls(Pin::Laser).collect(),
    );
    assert_eq!((on.len(), off.len()), (1, 1), "on for the whole scan");
    assert!(on[0] + Micros(2_000).to_cycles().0 <= fires[0]);
    assert!(
        off[0]
            >= *trace
                .falls(Pin::Exposure)
                .collect::<Vec<_>>()
                .last()
                .unwrap()
    );
}

#[test]
fn a_dark_scan_keeps_the_laser_off() {
    let r = RATIOS[0];
    for mode in [ScanMode::Constant, ScanMode::StopAndShoot] {
        let (triggers, trace) = run(r, 5000, mode, ScanLaser::Off);
        assert_eq!(trace.rises(Pin::Laser).count(), 0);
        assert!(triggers.iter().all(|t| !t.laser));
    }
}

#[test]
fn what_cannot_be_met_is_refused_and_nothing_moves() {
    let r = RATIOS[0];
    let (board, pipe) = connect(&config(r), rig(r));
    let request = scan_of_300_mm(2000, ScanMode::Constant, ScanLaser::Timed);
    assert!(matches!(
        board.scan(&request).err(),
        Some(LinkError::Refused(Refusal::NotHomed))
    ));
    board.home().expect("homes");
    let steps = pipe.board().trace().steps();
    let refused = |request| match board.scan(&request).err() {
        Some(LinkError::Refused(refusal)) => refusal,
        other => panic!("{other:?}"),
    };
    use cannula_shared::message::ScanRequest;
    assert_eq!(
        refused(ScanRequest {
            speed_um_s: 50_001,
            ..request
        }),
        Refusal::SpeedTooHigh {
            asked_um_s: 50_001,
            max_um_s: 50_000
        }
    );
    assert!(matches!(
        refused(ScanRequest {
            spacing_um: 400,
            ..request
        }),
        Refusal::TriggersTooClose {
            gap_us: 20_001,
            needed_us: 20_100,
            ..
        }
    ));
    assert_eq!(
        refused(ScanRequest {
            count: 157,
            ..request
        }),
        Refusal::OutOfTravel {
            position: Steps(800 * 322),
            min: Steps(0),
            max: Steps(256_000)
        }
    );
    assert!(matches!(
        refused(ScanRequest {
            start_um: -1000,
            ..request
        }),
        Refusal::OutOfTravel { .. }
    ));
    assert!(matches!(
        refused(ScanRequest {
            count: 0,
            ..request
        }),
        Refusal::Count { .. }
    ));
    assert_eq!(pipe.board().trace().steps(), steps, "nothing moved");
    assert!(!pipe.board().level(Pin::Laser));
}
