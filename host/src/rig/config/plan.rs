//! Whether the motion board would take a configuration's sweeps: its own plan and its own check, made
//! before anything moves, and what it objects to said with the key.

use super::Rig;
use cannula_firmware::scan_plan::{ScanCheck, ScanPlan};
use cannula_shared::config::Config as BoardConfig;
use cannula_shared::error::Refusal;
use cannula_shared::message::ScanRequest;
use cannula_shared::units::Steps;

/// What is wrong with a value.
pub(super) struct Objection {
    /// The key, with its table.
    pub key: &'static str,
    /// What stands there.
    pub value: String,
    /// What may stand there.
    pub wanted: String,
}

/// The keys behind a request, with their values.
struct Keys {
    start: (&'static str, f64),
    spacing: (&'static str, f64),
    count: (&'static str, u32),
    speed: (&'static str, f64),
}

/// What the board would object to in `[light]` or `[scan]`; its own configuration is sound.
pub(super) fn objection(rig: &Rig) -> Option<Objection> {
    let config = rig.board_config(rig.camera.exposure_laser_ms);
    let (light, scan) = (&rig.light, &rig.scan);
    let of_light = Keys {
        start: ("light.start_mm", light.start_mm),
        spacing: ("light.spacing_mm", light.spacing_mm),
        count: ("light.count", light.count),
        speed: ("board.max_speed_mm_s", rig.board.max_speed_mm_s),
    };
    let of_scan = Keys {
        start: ("scan.start_mm", scan.start_mm),
        spacing: ("scan.spacing_mm", scan.spacing_mm),
        count: ("scan.count", scan.count),
        speed: ("scan.speed_mm_s", scan.speed_mm_s),
    };
    let request = rig.scan_request();
    [(of_light, rig.light_request()), (of_scan, request)]
        .into_iter()
        .find_map(|(keys, request)| {
            judge(&config, request)
                .err()
                .map(|refusal| said(rig, &keys, refusal))
        })
        .or_else(|| exposure(rig, &request))
}

/// The board's way from a request to a scan, from where homing leaves the slide.
fn judge(config: &BoardConfig, request: ScanRequest) -> Result<(), Refusal> {
    let plan = ScanPlan::new(config, request)?;
    let mut check = ScanCheck::new(config, plan, Steps(0));
    while check.run()?.is_none() {}
    Ok(())
}

/// The board's refusal in the words of the file.
fn said(rig: &Rig, keys: &Keys, refusal: Refusal) -> Objection {
    let mm = |steps: Steps| rig.mm(steps.0.into());
    let speed = |wanted: String| object(keys.speed, wanted);
    match refusal {
        Refusal::SpeedTooHigh { max_um_s, .. } => {
            speed(format!("at most {}", 1e-3 * f64::from(max_um_s)))
        }
        Refusal::SpeedTooLow { min_um_s, .. } => {
            speed(format!("at least {}", 1e-3 * f64::from(min_um_s)))
        }
        Refusal::OutOfTravel { position, min, .. } if position < min => speed(format!(
            "less, or a greater {} or board.acceleration_mm_s2, or scan.mode = \"stop\": the run-up to the first position would begin at {:.3} mm, half of board.clearance_mm leaves room to {:.3} mm",
            keys.start.0,
            mm(position),
            mm(min)
        )),
        Refusal::OutOfTravel { position, max, .. } if position > max => {
            let (key, count) = keys.count;
            Objection {
                key,
                value: count.to_string(),
                wanted: format!(
                    "fewer positions: with its ramp down the slide would go to {:.3} mm, its travel (board.travel_mm) is {:.3} mm",
                    mm(position),
                    mm(max)
                ),
            }
        }
        Refusal::TriggersTooClose {
            index,
            gap_us,
            needed_us,
        } => object(
            keys.spacing,
            format!(
                "more, or a lower {}: trigger {index} would come {} ms after the one before it, the camera needs {} ms (camera.frame_time_ms and the trigger's pulse)",
                keys.speed.0,
                1e-3 * f64::from(gap_us),
                1e-3 * f64::from(needed_us)
            ),
        ),
        Refusal::SpacingTooFine { min_um, .. } => object(
            keys.spacing,
            format!(
                "at least {}: two positions would fall on the same step (board.steps_per_mm)",
                1e-3 * f64::from(min_um)
            ),
        ),
        Refusal::LeadTooLong { available_us, .. } => object(
            ("laser.lead_ms", rig.laser.lead_ms),
            format!(
                "at most {}, or a greater board.run_up_mm or a lower {}: the first position comes too soon after the slide starts",
                1e-3 * f64::from(available_us),
                keys.speed.0
            ),
        ),
        other => object(
            keys.start,
            format!(
                "{}, {} and {} that the motion board takes: {other}",
                keys.start.0, keys.spacing.0, keys.count.0
            ),
        ),
    }
}

fn object((key, value): (&'static str, f64), wanted: String) -> Objection {
    Objection {
        key,
        value: value.to_string(),
        wanted,
    }
}

/// On the fly a frame has to be exposed and read out before the next trigger: what comes in between
/// a camera does not see.
fn exposure(rig: &Rig, request: &ScanRequest) -> Option<Objection> {
    let speed = rig.travel_mm_s(request);
    let needed_ms = rig.camera.exposure_laser_ms + rig.camera.frame_time_ms;
    let spacing_mm = 1e-3 * f64::from(request.spacing_um);
    // Where it stops it waits for the frame; a count of one has no next trigger.
    let late = request.count > 1 && 1e-3 * speed * needed_ms > spacing_mm * (1.0 + 1e-9);
    late.then(|| {
        object(
            ("scan.speed_mm_s", rig.scan.speed_mm_s),
            format!(
                "at most {:.3}, or a shorter camera.exposure_laser_ms or a greater scan.spacing_mm, or scan.mode = \"stop\": exposing and reading out a frame takes {needed_ms} ms (camera.exposure_laser_ms and camera.frame_time_ms), the next trigger comes after {:.3} ms",
                1e3 * spacing_mm / needed_ms,
                1e3 * spacing_mm / speed
            ),
        )
    })
}
