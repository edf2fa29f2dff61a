//! The shipped ELF in the emulator, driven over its USB by the host's own link; asserted from pin
//! edges in cycles of the 125 MHz clock.
//!
//! Needs node, `npm ci` in tests/emulator, and the firmware built (`.ci/firmware.sh`); says
//! `skipped:…` and passes where one is missing, unless `CANNULA_REQUIRE_EMULATOR=1`.

mod bridge;
mod edges;
mod emulator;
mod exposures;
mod resets;
mod rig;

use cannula::rig::link::{Board, LinkError, ScanEvent};
use cannula_shared::config::Config;
use cannula_shared::hello::ResetReason;
use cannula_shared::message::{ScanLaser, ScanMode};
use cannula_shared::units::{Steps, StepsPerMm};

use edges::{pin, range};
use emulator::{Emulator, PER_MICRO};
use rig::{Rig, config, moves, nearest_step, on_the_fly, shape, triggers_on_steps};

/// Cycles from a STEP edge to its trigger: two flip-flops of the input synchroniser, and the wait,
/// count, flag, wait and set of the two machines.
const TRIGGER_OFFSET: u64 = 7;

type Outcome = Result<(), LinkError>;

/// Every trigger of 300 mm on its planned step, a constant 7 cycles after its edge, in ramps and
/// cruise; the moves as planned to a cycle.
fn exact_spacing(ratio: StepsPerMm) -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, config(ratio, 100_000, 800_000))?;
    for (spacing_um, mode, laser) in [
        (2_000, ScanMode::Ramped, ScanLaser::Off),
        (5_000, ScanMode::Ramped, ScanLaser::Timed),
    ] {
        let start_um = 1_000;
        let count = 300_000 / spacing_um + 1;
        let mark = rig.mark()?;
        let (ledger, summary) = rig.scan(&on_the_fly(start_um, spacing_um, count, mode, laser))?;
        let edges = rig.emulator.get().edges()?;

        let fired = triggers_on_steps(&edges, &mark);
        assert_eq!(fired.len(), count as usize, "triggers on the pin");
        assert_eq!(
            (summary.planned, summary.fired, ledger.len() as u32),
            (count, count, count)
        );
        let offsets = range(fired.iter().map(|f| f.0));
        assert_eq!(
            offsets,
            Some((TRIGGER_OFFSET, TRIGGER_OFFSET)),
            "cycles after the STEP edge, spread 0"
        );
        let pulses = edges.rising(pin::TRIGGER);
        for (k, (&(_, position), line)) in fired.iter().zip(&ledger).enumerate() {
            let planned = nearest_step(
                ratio,
                i64::from(start_um) + k as i64 * i64::from(spacing_um),
            );
            assert_eq!(position, planned, "trigger {k} stands on its step");
            assert_eq!(
                (line.index, i64::from(line.position.0)),
                (k as u32, planned),
                "and the ledger says so"
            );
            let late = line.time.0 as i64 - (pulses[k] / PER_MICRO) as i64;
            assert!(
                (-1..=20).contains(&late),
                "trigger {k}: noted {late} µs after its edge"
            );
        }
        // The scan's own move is the last one.
        let steps = edges.rising(pin::STEP);
        let parts = moves(&steps, rig.acceleration());
        let scan = parts.last().expect("a move");
        let seen = shape(
            scan,
            rig.acceleration(),
            scan[scan.len() / 2] - scan[scan.len() / 2 - 1],
        );
        println!("{ratio:?} {spacing_um} µm: {} steps, {seen:?}", scan.len());
        assert_eq!(seen.cruise.0, seen.cruise.1, "cruise without jitter");
        assert!(
            seen.off <= 1.0 + 1e-3,
            "ramps within a cycle of the plan: {seen:?}"
        );
        assert!(
            fired.len() > 20 && seen.ramp > 1000 && seen.cruising > 10_000,
            "ramps and cruise both took part"
        );
        if laser == ScanLaser::Timed {
            let lit = edges.level(pin::LASER, pulses[0]);
            assert_eq!(lit, Some(true), "lit at the first trigger");
            assert!(ledger.iter().all(|line| line.laser), "lit at every trigger");
            timed_light(&rig, &edges, &pulses);
        } else {
            assert!(edges.rising(pin::LASER).is_empty(), "dark as asked");
        }
    }
    Ok(())
}

/// The laser by hardware alone: on to the cycle the lead before each trigger's STEP edge, off to the
/// cycle at the latest end of its exposure.
fn timed_light(rig: &Rig, edges: &edges::Edges, pulses: &[u64]) {
    let cycles = |us: u32| u64::from(us) * PER_MICRO;
    let c = &rig.config;
    let (lead, tail) = (
        cycles(c.laser_lead_us),
        cycles(c.exposure_delay_us + c.exposure_us),
    );
    let (on, off) = (edges.rising(pin::LASER), edges.falling(pin::LASER));
    assert_eq!((on.len(), off.len()), (pulses.len(), pulses.len()));
    let leads = range(
        on.iter()
            .zip(pulses)
            .map(|(on, pulse)| pulse - TRIGGER_OFFSET - on),
    );
    let tails = range(
        off.iter()
            .zip(pulses)
            .map(|(off, pulse)| off + TRIGGER_OFFSET - pulse),
    );
    println!("laser: lead {leads:?} cycles of {lead}, tail {tails:?} of {tail}");
    assert_eq!(leads, Some((lead, lead)), "lead, spread 0");
    assert_eq!(
        tails,
        Some((tail, tail)),
        "until the exposure's end, spread 0"
    );
}

#[test]
fn triggers_at_800_steps_per_mm() -> Outcome {
    exact_spacing(StepsPerMm::whole(800))
}

#[test]
fn triggers_at_640_steps_per_mm() -> Outcome {
    exact_spacing(StepsPerMm::whole(640))
}

#[test]
fn triggers_at_409_6_steps_per_mm() -> Outcome {
    exact_spacing(StepsPerMm {
        numerator: 2048,
        denominator: 5,
    })
}

#[test]
fn triggers_at_2032_fifths_steps_per_mm() -> Outcome {
    exact_spacing(StepsPerMm {
        numerator: 2032,
        denominator: 5,
    })
}

/// 100 kHz and 500 kHz: the cruise without a cycle of jitter across all refills, the ramps as
/// planned, no step lost.
#[test]
fn full_moves_without_underrun() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    // The last is a ramp over the whole slide to the highest rate that its acceleration allows: each of
    // its steps is a word of its own, and the CPU must make them about as fast as they are stepped.
    for (rate, acceleration, distance) in [
        (100_000, 1_000_000, 40_000),
        (500_000, 10_000_000, 480_000),
        (474_000, 500_000, 480_000),
    ] {
        let rig = Rig::start(&found, config(StepsPerMm::whole(1600), rate, acceleration))?;
        let mark = rig.mark()?;
        let interval = 125_000_000u64.div_ceil(rate);
        let ended = rig.board.jog(Steps(distance), 0)?;
        let edges = rig.emulator.get().edges()?;
        let steps = edges.rising(pin::STEP);
        assert_eq!(steps.len() as i32, distance);
        assert_eq!(i64::from(ended.0), mark.position + i64::from(distance));
        let seen = shape(&steps, rig.acceleration(), interval);
        println!("{rate} steps/s: {seen:?}");
        assert_eq!(seen.cruise, (interval, interval), "not a cycle of jitter");
        assert!(seen.cruising >= 10_000);
        assert!(
            seen.off <= 1.0 + 1e-3,
            "ramps within a cycle of the plan: {seen:?}"
        );
    }
    Ok(())
}

/// A slide of 800 steps/mm at 50 000 steps/s. Its exposures overlap at 2 mm, so that the laser is on
/// throughout even where it is timed to them.
fn overlapping() -> Config {
    Config {
        exposure_us: 40_000,
        ..config(StepsPerMm::whole(800), 50_000, 800_000)
    }
}

/// A scan that has the laser on throughout, stopped half-way by `stop`; the edges afterwards, and the
/// cycle at which it was stopped.
fn scan_cut(
    rig: &Rig,
    laser: ScanLaser,
    mut stop: impl FnMut(&mut Emulator) -> std::io::Result<()>,
) -> Result<(edges::Edges, u64), LinkError> {
    rig.mark()?;
    let request = on_the_fly(3_000, 2_000, 100, ScanMode::Constant, laser);
    let mut scan = rig.board.scan(&request)?;
    let mut seen = 0;
    while seen < 20 {
        match scan.next_event()? {
            Some(ScanEvent::Trigger(_)) => seen += 1,
            Some(_) => {}
            None => panic!("the scan ended early"),
        }
    }
    let mut emulator = rig.emulator.get();
    assert_eq!(
        emulator.edges()?.level(pin::LASER, u64::MAX),
        Some(true),
        "lit in mid-scan"
    );
    let cut = emulator.cycle;
    stop(&mut emulator)?;
    emulator.run_on(600_000)?;
    let edges = emulator.edges()?;
    drop(emulator);
    // The scan's guard would talk to a dead board.
    core::mem::forget(scan);
    Ok((edges, cut))
}

fn milliseconds(from: u64, to: u64) -> f64 {
    (to.saturating_sub(from)) as f64 / 125e3
}

/// The CPU dies in mid-scan: the laser's lease runs out and the motion starves, by hardware alone.
#[test]
fn dead_cpu() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    for laser in [ScanLaser::Whole, ScanLaser::Timed] {
        let rig = Rig::start(&found, overlapping())?;
        let (edges, cut) = scan_cut(&rig, laser, |emulator| emulator.command("freeze").map(drop))?;
        let dark = *edges
            .falling(pin::LASER)
            .last()
            .expect("the laser went off");
        let last = *edges.rising(pin::STEP).last().expect("steps");
        let (dark, last) = (milliseconds(cut, dark), milliseconds(cut, last));
        println!(
            "CPU dead, laser {laser:?}: laser off after {dark:.2} ms, last step after {last:.2} ms"
        );
        assert_eq!(edges.level(pin::LASER, u64::MAX), Some(false));
        assert!(dark <= 50.0, "laser off within 50 ms");
        assert!(last <= 50.0, "motion ended within the look-ahead");
        core::mem::forget(rig.board);
    }
    Ok(())
}

/// The host falls silent in mid-scan: laser off within 300 ms, motion stopped, and the board says
/// so when the host is back.
#[test]
fn silent_host() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    for laser in [ScanLaser::Whole, ScanLaser::Timed] {
        let rig = Rig::start(&found, overlapping())?;
        let (edges, cut) = scan_cut(&rig, laser, |_| Ok(()))?;
        let dark = *edges
            .falling(pin::LASER)
            .last()
            .expect("the laser went off");
        let last = *edges.rising(pin::STEP).last().expect("steps");
        let (dark, last) = (milliseconds(cut, dark), milliseconds(cut, last));
        println!(
            "host silent, laser {laser:?}: laser off after {dark:.2} ms, last step after {last:.2} ms"
        );
        assert_eq!(edges.level(pin::LASER, u64::MAX), Some(false));
        assert!(dark <= 300.0, "laser off within 300 ms");
        assert!(last <= 600.0, "stopped");
        core::mem::forget(rig.board);
    }
    Ok(())
}

/// The program hangs: the watchdog resets the chip, every pin is safe, and the hello says why.
#[test]
fn hung_program() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, config(StepsPerMm::whole(800), 50_000, 800_000))?;
    let (edges, cut) = scan_cut(&rig, ScanLaser::Whole, |emulator| {
        emulator.command("hang").map(drop)
    })?;
    assert_eq!(rig.emulator.get().resets, 1, "one reset");
    let dark = *edges
        .falling(pin::LASER)
        .last()
        .expect("the laser went off");
    println!("hung: laser off after {:.2} ms", milliseconds(cut, dark));
    assert!(milliseconds(cut, dark) <= 50.0);
    assert_eq!(edges.level(pin::ENABLE, u64::MAX), Some(true), "driver off");
    core::mem::forget(rig.board);
    let again = Board::over(rig.emulator.pipe())?;
    assert_eq!(again.hello().reset, ResetReason::Watchdog);
    assert!(
        !again.status()?.position_known,
        "position unknown after a reset"
    );
    Ok(())
}

/// The far limit switch opens at any moment of a step: at most one more step, at 100 kHz and 500 kHz.
#[test]
fn limit_switch() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    for rate in [100_000u64, 500_000] {
        let period = 125_000_000 / rate;
        // Just after an edge, in the pulse, in the delay, just before the next edge.
        for delay in [1, 20, period / 2, period - 5, period - 1] {
            let rig = Rig::start(&found, config(StepsPerMm::whole(1600), rate, 10_000_000))?;
            rig.mark()?;
            rig.emulator
                .get()
                .command(&format!("at 60000 {delay} pin 11 1"))?;
            let error = rig
                .board
                .jog(Steps(200_000), 0)
                .expect_err("the limit switch ends the move");
            let mut emulator = rig.emulator.get();
            emulator.run_on(50_000)?;
            let edges = emulator.edges()?;
            let steps = edges.rising(pin::STEP);
            let hit = steps[59_999] + delay;
            let more = steps.iter().filter(|&&s| s > hit).count();
            println!("{rate} steps/s, switch {delay} cycles after an edge: {more} more; {error}");
            assert!(more <= 1);
        }
    }
    Ok(())
}

/// E-stop in a scan: laser dark and motion ended by interrupt.
#[test]
fn emergency_stop() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    for laser in [ScanLaser::Whole, ScanLaser::Timed] {
        let rig = Rig::start(&found, overlapping())?;
        let (edges, cut) = scan_cut(&rig, laser, |emulator| {
            emulator.command("pin 12 1").map(drop)
        })?;
        let dark = *edges
            .falling(pin::LASER)
            .last()
            .expect("the laser went off");
        let steps = edges.rising(pin::STEP);
        let more = steps.iter().filter(|&&s| s > cut).count();
        println!(
            "E-stop: laser off after {} cycles, {more} more steps",
            dark - cut
        );
        assert!(dark - cut <= 1_250, "dark within 10 µs");
        assert!(more <= 1);
        core::mem::forget(rig.board);
    }
    Ok(())
}

/// A hundred scans over a link that damages every twentieth piece, both ways: every trigger on the pin
/// is in the ledger once, no command runs twice.
#[test]
fn hundred_scans_over_a_lossy_link() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    const SCANS: u32 = 100;
    let mut damaged = Default::default();
    let rig = Rig::start_over(
        &found,
        config(
            StepsPerMm {
                numerator: 2032,
                denominator: 5,
            },
            100_000,
            2_000_000,
        ),
        |emulator| {
            let pipe = emulator.lossy_pipe(50, 20_261_122);
            damaged = pipe.damaged();
            pipe
        },
    )?;
    let mark = rig.mark()?;
    let mut fired = 0;
    let mut jobs = Vec::new();
    for n in 0..SCANS {
        let (spacing_um, count) = (200 + 10 * (n % 7), 10 + n % 5);
        let request = on_the_fly(
            1_000 + 100 * (n % 3) as i32,
            spacing_um,
            count,
            ScanMode::Ramped,
            ScanLaser::Timed,
        );
        let (ledger, summary) = rig.scan(&request)?;
        assert_eq!(
            (summary.planned, summary.fired, ledger.len() as u32),
            (count, count, count)
        );
        for (k, line) in ledger.iter().enumerate() {
            let planned = nearest_step(
                rig.config.steps_per_mm,
                i64::from(request.start_um) + k as i64 * i64::from(spacing_um),
            );
            assert_eq!(
                (line.index as usize, i64::from(line.position.0)),
                (k, planned),
                "scan {n}"
            );
        }
        fired += ledger.len();
        jobs.push(summary.job);
    }
    let edges = rig.emulator.get().edges()?;
    let on_pin = triggers_on_steps(&edges, &mark);
    println!(
        "{SCANS} scans, {} damaged pieces, {} triggers on the pin, {fired} in the ledger",
        damaged.load(std::sync::atomic::Ordering::Relaxed),
        on_pin.len()
    );
    assert_eq!(
        on_pin.len(),
        fired,
        "no event lost or doubled, no scan run twice"
    );
    assert!(on_pin.iter().all(|t| t.0 == TRIGGER_OFFSET));
    assert!(
        jobs.windows(2).all(|w| w[1] == w[0] + 1),
        "one job a command: {jobs:?}"
    );
    assert!(
        damaged.load(std::sync::atomic::Ordering::Relaxed) > 100,
        "the link was bad enough to prove something"
    );
    Ok(())
}
