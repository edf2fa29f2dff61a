//! Stop and shoot, and the camera's exposure output, on the shipped ELF.

use cannula::rig::link::{LinkError, ScanEvent};
use cannula_shared::config::{Config, ExposureInput, MissingExposure};
use cannula_shared::error::Fault;
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest, State};
use cannula_shared::units::StepsPerMm;

use crate::Outcome;
use crate::edges::{pin, range};
use crate::emulator::{self, PER_MICRO};
use crate::rig::{Rig, config, nearest_step, on_the_fly, triggers_on_steps};

const RATIO: StepsPerMm = StepsPerMm {
    numerator: 2048,
    denominator: 5,
};
/// The camera begins 100 µs after the trigger and exposes for 2 ms.
const CAMERA: &str = "camera 12500 250000";

fn counted(missing_exposure: MissingExposure) -> Config {
    Config {
        exposure_input: ExposureInput::Counted,
        missing_exposure,
        exposure_us: 2_000,
        exposure_delay_us: 500,
        settle_us: 5_000,
        laser_lead_us: 1_000,
        ..config(RATIO, 50_000, 800_000)
    }
}

fn stop_and_shoot(count: u32) -> ScanRequest {
    ScanRequest {
        start_um: 5_000,
        spacing_um: 5_000,
        count,
        speed_um_s: 0,
        mode: ScanMode::StopAndShoot,
        laser: ScanLaser::Timed,
    }
}

/// Travel, settle, laser, lead, trigger, exposure, dark, next: each in its order on the pins.
#[test]
fn stop_and_shoot_as_on_the_pins() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, counted(MissingExposure::Fault))?;
    rig.emulator.get().command(CAMERA)?;
    let mark = rig.mark()?;
    let request = stop_and_shoot(8);
    let (ledger, summary) = rig.scan(&request)?;
    let edges = rig.emulator.get().edges()?;
    assert_eq!(
        (summary.fired, summary.exposures, summary.missing),
        (8, 8, 0)
    );
    let steps = edges.rising(pin::STEP);
    let (on, off) = (edges.rising(pin::LASER), edges.falling(pin::LASER));
    let fires = edges.rising(pin::TRIGGER);
    let ends = edges.falling(pin::EXPOSURE);
    assert_eq!([on.len(), off.len(), fires.len(), ends.len()], [8; 4]);
    let places = triggers_on_steps(&edges, &mark);
    for k in 0..8 {
        let planned = nearest_step(RATIO, 5_000 + 5_000 * k as i64);
        assert_eq!(
            (places[k].1, i64::from(ledger[k].position.0)),
            (planned, planned)
        );
        assert!(ledger[k].laser);
        let before = steps.partition_point(|&s| s < fires[k]);
        let settled = on[k] - steps[before - 1];
        assert!(settled >= 5_000 * PER_MICRO, "settled for {settled} cycles");
        let after = steps.get(before).copied().unwrap_or(u64::MAX);
        assert!(after > ends[k], "stands while exposing");
    }
    let leads = range(on.iter().zip(&fires).map(|(on, fire)| fire - on));
    let late = range(
        off.iter()
            .zip(&ends)
            .map(|(off, end)| off.saturating_sub(*end)),
    );
    println!(
        "stop and shoot: lead {leads:?} cycles of 125000, dark {late:?} cycles after the exposure"
    );
    assert!(leads.is_some_and(|(least, most)| least >= 125_000 && most < 250_000));
    // The CPU looks once in a millisecond, and has seen no end before the exposure's.
    assert!(late.is_some_and(|(least, most)| least > 0 && most < 187_500));
    Ok(())
}

/// A camera that misses frames: a named fault, or a warning and a count; in both modes.
#[test]
fn missing_exposures() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, counted(MissingExposure::Warning))?;
    let fly = on_the_fly(10_000, 2_000, 12, ScanMode::Constant, ScanLaser::Timed);
    for request in [stop_and_shoot(6), fly] {
        rig.emulator.get().command(&format!("{CAMERA} 2 5"))?;
        let mut missing = Vec::new();
        let summary = rig.board.scan(&request)?.run(|event| {
            if let ScanEvent::MissingExposure { index } = event {
                missing.push(*index);
            }
        })?;
        assert_eq!(missing, [2, 5], "{:?}", request.mode);
        assert_eq!(
            (summary.fired, summary.exposures, summary.missing),
            (request.count, request.count - 2, 2)
        );
    }

    rig.board.configure(&counted(MissingExposure::Fault))?;
    for request in [stop_and_shoot(6), fly] {
        rig.emulator.get().command(&format!("{CAMERA} 3"))?;
        rig.mark()?;
        let error = rig.board.scan(&request)?.run(|_| {}).err();
        assert!(
            matches!(
                error,
                Some(LinkError::Fault(Fault::MissingExposure { index: 3 }))
            ),
            "{:?}: {error:?}",
            request.mode
        );
        let edges = rig.emulator.get().edges()?;
        assert_eq!(edges.level(pin::LASER, u64::MAX), Some(false));
        let status = rig.board.status()?;
        assert_eq!(
            status.state,
            State::Fault(Fault::MissingExposure { index: 3 })
        );
        assert!(status.position_known, "a lost frame loses no position");
        rig.board.rearm()?;
    }
    Ok(())
}
