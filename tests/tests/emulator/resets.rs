//! What ends the program in the middle of a lit scan: every pin safe, the chip reset, the cause in
//! the next hello and in the log.

use cannula::rig::link::Board;
use cannula_shared::hello::ResetReason;
use cannula_shared::message::ScanLaser;
use cannula_shared::units::StepsPerMm;

use crate::edges::pin;
use crate::emulator::{self, PER_MICRO};
use crate::rig::{Rig, config};
use crate::{Outcome, milliseconds, scan_cut};

/// `cause` is an emulator's command; the log after the reset must contain `detail`.
fn ends_by(cause: &str, reason: ResetReason, detail: &[u8]) -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, config(StepsPerMm::whole(800), 50_000, 800_000))?;
    let (edges, cut) = scan_cut(&rig, ScanLaser::Whole, |emulator| {
        emulator.command(cause).map(drop)
    })?;
    assert_eq!(rig.emulator.get().resets, 1, "one reset");
    let dark = *edges
        .falling(pin::LASER)
        .last()
        .expect("the laser went off");
    let more = edges.rising(pin::STEP).iter().filter(|&&s| s > cut).count();
    println!(
        "{cause}: laser off after {:.4} ms, {more} more steps",
        milliseconds(cut, dark)
    );
    assert!(dark - cut <= 100 * PER_MICRO, "dark within 100 µs");
    assert!(more <= 1);
    for (name, level) in [(pin::LASER, false), (pin::ENABLE, true)] {
        assert_eq!(edges.level(name, u64::MAX), Some(level), "pin {name}");
    }
    core::mem::forget(rig.board);
    let again = Board::over(rig.emulator.pipe())?;
    assert_eq!(again.hello().reset, reason);
    let status = again.status()?;
    assert!(!status.position_known && !status.laser && !status.driver);
    let log = rig.emulator.get().command("log")?;
    let log = decoded(log.trim_start_matches("ok").trim());
    assert!(
        log.windows(detail.len().max(1))
            .any(|w| w.starts_with(detail)),
        "{detail:?} is in the log: {log:?}"
    );
    Ok(())
}

#[test]
fn a_panic() -> Outcome {
    ends_by("panic 4242", ResetReason::Panic, &4242u32.to_le_bytes())
}

#[test]
fn a_hard_fault() -> Outcome {
    ends_by("fault", ResetReason::Panic, &[])
}

/// A fault is told to the log in words, besides the host.
#[test]
fn faults_are_logged() -> Outcome {
    let Some(found) = emulator::find() else {
        return Ok(());
    };
    let rig = Rig::start(&found, config(StepsPerMm::whole(800), 50_000, 800_000))?;
    let mut emulator = rig.emulator.get();
    emulator.command("log")?;
    emulator.command("pin 12 1")?;
    emulator.run_on(20_000)?;
    let log = emulator.command("log")?;
    let log = decoded(log.trim_start_matches("ok").trim());
    let log = String::from_utf8_lossy(&log);
    assert!(log.contains("emergency stop pressed"), "{log:?}");
    drop(emulator);
    core::mem::forget(rig.board);
    Ok(())
}

/// The bytes of defmt's log: frames end with a zero and are packed by rzCOBS (defmt's
/// default encoding), read from their ends.
fn decoded(hex: &str) -> Vec<u8> {
    let bytes: Vec<u8> = hex
        .as_bytes()
        .chunks(2)
        .filter_map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect();
    let mut all = Vec::new();
    for frame in bytes.split(|&b| b == 0) {
        let mut rest = frame.to_vec();
        let mut plain = Vec::new();
        while let Some(code) = rest.pop() {
            match code {
                // Seven bytes, a set bit for each zero.
                0..=0x7f => {
                    for i in 0..7 {
                        let zero = code & (1 << (6 - i)) != 0;
                        plain.extend(if zero { Some(0) } else { rest.pop() });
                    }
                }
                // A zero after so many others.
                0x80..=0xfe => {
                    plain.push(0);
                    for _ in 0..(code & 0x7f) + 7 {
                        plain.extend(rest.pop());
                    }
                }
                0xff => {
                    for _ in 0..134 {
                        plain.extend(rest.pop());
                    }
                }
            }
        }
        plain.reverse();
        all.append(&mut plain);
    }
    all
}
