//! Golden snapshots of what crosses the wire. If one of these differs, board and host of before
//! and after do not understand each other: then the schema hash must differ too (it does, if the
//! change was made in the table), and both sides must be built anew.

use cannula_shared::config::{Config, ConfigError, ExposureInput, Field, MissingExposure};
use cannula_shared::error::{CheckError, Doing, Fault, Input, Refusal};
use cannula_shared::frame::{self, Header, Kind, MAX_WIRE};
use cannula_shared::hello::{HELLO_LEN, Hello, Identity, PROTOCOL, ResetReason};
use cannula_shared::message::*;
use cannula_shared::units::{Micros, Steps, StepsPerMm};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn encoded(message: &impl serde::Serialize) -> String {
    let mut buffer = [0; 256];
    hex(postcard::to_slice(message, &mut buffer).expect("fits"))
}

const CONFIG: Config = Config {
    steps_per_mm: StepsPerMm {
        numerator: 2048,
        denominator: 5,
    },
    invert_direction: true,
    travel_um: 300_000,
    max_speed_um_s: 50_000,
    acceleration_um_s2: 200_000,
    homing_fast_um_s: 10_000,
    homing_slow_um_s: 1_000,
    homing_backoff_um: 2_000,
    homing_travel_um: 320_000,
    homing_tolerance_um: 250,
    clearance_um: 1_000,
    run_up_um: 500,
    trigger_pulse_us: 100,
    frame_time_us: 20_000,
    exposure_us: 5_000,
    exposure_input: ExposureInput::Counted,
    missing_exposure: MissingExposure::Warning,
    exposure_delay_us: 2_000,
    settle_us: 100_000,
    laser_lead_us: 2_000,
    laser_lease_us: 20_000,
    laser_manual_ms: 60_000,
    heartbeat_us: 200_000,
    telemetry_us: 50_000,
};

const SCAN: ScanRequest = ScanRequest {
    start_um: -5,
    spacing_um: 2000,
    count: 151,
    speed_um_s: 20_000,
    mode: ScanMode::Constant,
    laser: ScanLaser::Timed,
};

const INPUTS: Inputs = Inputs {
    home: true,
    limit: false,
    estop: true,
    interlock: false,
    exposure: true,
};
const TRIGGER: Trigger = Trigger {
    job: 3,
    index: 150,
    position: Steps(-122_880),
    time: Micros(12_345_678_901),
    laser: true,
};

#[test]
fn the_table_as_a_whole() {
    assert_eq!(PROTOCOL, 1);
    assert_eq!(
        format!("{SCHEMA:016x}"),
        include_str!("golden/schema.txt").trim()
    );
    // The layouts that never change.
    assert_eq!((frame::LAYOUT, HELLO_LEN), (1, 42));
}

/// Every message with every variant, in the table's order: one line each.
fn lines() -> Vec<(String, String)> {
    let mut out = Vec::new();
    macro_rules! all {
        ($($message:expr),* $(,)?) => { $( out.push((format!("{:?}", $message), encoded(&$message))); )* };
    }
    all![
        Command::Configure(CONFIG),
        Command::Home,
        Command::MoveTo {
            position: Steps(-70_000),
            speed_um_s: 300
        },
        Command::Jog {
            by: Steps(64),
            speed_um_s: 0
        },
        Command::Scan(SCAN),
        Command::Scan(ScanRequest {
            mode: ScanMode::StopAndShoot,
            laser: ScanLaser::Off,
            ..SCAN
        }),
        Command::Scan(ScanRequest {
            mode: ScanMode::Ramped,
            laser: ScanLaser::Whole,
            ..SCAN
        }),
        Command::Laser { on: true },
        Command::Trigger,
        Command::Stop,
        Command::Rearm,
        Command::Release,
        Command::Status,
        Command::Reboot { bootloader: true },
        Reply::Done,
        Reply::Begun { job: 300 },
        Reply::Configured(CONFIG),
    ];
    let status = Status {
        state: State::Boot,
        position: Steps(-1),
        position_known: true,
        moving: false,
        driver: true,
        laser: false,
        inputs: INPUTS,
        job: 7,
        triggers: 151,
        pending: 256,
        bad_frames: 2,
        uptime: Micros(u64::MAX),
    };
    for state in [
        State::Boot,
        State::Idle,
        State::Homing,
        State::Ready,
        State::Scanning,
        State::Stopping,
        State::Fault(Fault::EStop),
    ] {
        all![Reply::Status(Status { state, ..status })];
    }
    for refusal in [
        Refusal::NotConfigured,
        Refusal::NotNow {
            doing: Doing::Fault,
        },
        Refusal::NotHomed,
        Refusal::Config(ConfigError {
            field: Field::Telemetry,
            value: 1,
            min: 2,
            max: 300,
        }),
        Refusal::SpeedTooHigh {
            asked_um_s: 60_000,
            max_um_s: 50_000,
        },
        Refusal::SpeedTooLow {
            asked_um_s: 1,
            min_um_s: 75,
        },
        Refusal::OutOfTravel {
            position: Steps(-801),
            min: Steps(-400),
            max: Steps(240_000),
        },
        Refusal::TriggersTooClose {
            index: 1,
            gap_us: 20_001,
            needed_us: 20_100,
        },
        Refusal::SpacingTooFine {
            spacing_um: 1,
            min_um: 2,
        },
        Refusal::Count {
            count: 0,
            max: 1 << 24,
        },
        Refusal::Range,
        Refusal::LeadTooLong {
            lead_us: 80_000,
            available_us: 70_000,
        },
        Refusal::InputActive {
            input: Input::Interlock,
        },
        Refusal::PlanCheck(CheckError::Steps {
            planned: 1,
            found: 2,
        }),
        Refusal::PlanCheck(CheckError::Time { step: 3 }),
        Refusal::PlanCheck(CheckError::Interval {
            step: 3,
            cycles: 38,
            min: 39,
        }),
        Refusal::PlanCheck(CheckError::Triggers {
            planned: 6,
            found: 5,
        }),
        Refusal::PlanCheck(CheckError::Position {
            index: 0,
            planned: Steps(1),
            found: Steps(0),
        }),
        Refusal::Malformed,
    ] {
        all![Reply::Refused(refusal)];
    }
    all![
        Event::Trigger(TRIGGER),
        Event::MissingExposure { job: 3, index: 4 },
        Event::ScanEnd(ScanSummary {
            job: 3,
            planned: 151,
            fired: 150,
            exposures: 149,
            missing: 1,
            checksum: 0xdead_beef
        }),
        Event::JobEnd {
            job: 3,
            outcome: Outcome::Done,
            position: Steps(9),
            position_known: true
        },
        Event::JobEnd {
            job: 3,
            outcome: Outcome::Stopped,
            position: Steps(9),
            position_known: false
        },
        Event::Homed { job: 2, apart: -3 },
        Event::Rearmed,
        Event::LaserExpired,
    ];
    for fault in [
        Fault::EStop,
        Fault::Limit,
        Fault::HomeSwitch,
        Fault::Interlock,
        Fault::HostSilent { silent_us: 200_001 },
        Fault::HomeNeverFound { travelled: 320_000 },
        Fault::HomeStuck { backed_off: 1600 },
        Fault::HomeBounced {
            apart: -800,
            tolerance: 200,
        },
        Fault::Underrun { step: 5 },
        Fault::StepCount {
            planned: 6,
            counted: 5,
        },
        Fault::LedgerFull { index: 230 },
        Fault::MissingExposure { index: 4 },
        Fault::MissingTrigger { index: 150 },
        Fault::StrayTrigger,
        Fault::Timeout {
            doing: Doing::Scanning,
        },
        Fault::LaserOff { index: 8 },
    ] {
        all![Event::Fault {
            fault,
            time: Micros(1),
            position: Steps(2),
            position_known: false
        }];
        all![Event::JobEnd {
            job: 1,
            outcome: Outcome::Failed(fault),
            position: Steps(0),
            position_known: false
        }];
    }
    all![Telemetry {
        time: Micros(9),
        position: Steps(-1),
        speed_um_s: 20_000,
        triggers: 12,
        remaining_ms: 4_000
    }];
    out
}

#[test]
fn every_message() {
    let golden = include_str!("golden/messages.txt");
    let now: String = lines()
        .into_iter()
        .map(|(message, bytes)| format!("{bytes} {message}\n"))
        .collect();
    for (is, was) in now.lines().zip(golden.lines()) {
        assert_eq!(is, was);
    }
    assert_eq!(now.lines().count(), golden.lines().count());
}

#[test]
fn frames() {
    let wire = |header, payload: &[u8]| {
        let mut out = [0; MAX_WIRE];
        let n = frame::encode(header, payload, &mut out).expect("fits");
        hex(&out[..n])
    };
    let header = |kind, sequence, acknowledge| Header {
        kind,
        session: 0x1234,
        sequence,
        acknowledge,
    };
    let identity = Identity {
        board: *b"ABCDEFGH",
        firmware: [0, 1, 0],
    };
    let hello = Hello {
        protocol: 1,
        schema: 0x0102_0304_0506_0708,
        identity,
        clock_hz: 125_000_000,
        reset: ResetReason::PowerOn,
        uptime: Micros(1_000_000),
        first_event: 1,
    };
    assert_eq!(
        wire(header(Kind::Alive, 0, 5), &[]),
        include_str!("golden/alive.txt").trim()
    );
    assert_eq!(
        wire(header(Kind::Command, 1, 0), &[1]),
        include_str!("golden/command.txt").trim()
    );
    assert_eq!(
        wire(header(Kind::Hello, 0, 0), &hello.encode()),
        include_str!("golden/hello.txt").trim()
    );
}

/// Prints what the golden files would hold now; to be looked at, not to be run blindly.
#[test]
fn the_longest_messages_fit_a_frame() {
    let longest = lines()
        .into_iter()
        .map(|(_, bytes)| bytes.len() / 2)
        .max()
        .expect("some");
    let worst = Config {
        steps_per_mm: StepsPerMm {
            numerator: u32::MAX,
            denominator: u32::MAX,
        },
        travel_um: u32::MAX,
        max_speed_um_s: u32::MAX,
        acceleration_um_s2: u32::MAX,
        homing_fast_um_s: u32::MAX,
        homing_slow_um_s: u32::MAX,
        homing_backoff_um: u32::MAX,
        homing_travel_um: u32::MAX,
        homing_tolerance_um: u32::MAX,
        clearance_um: u32::MAX,
        run_up_um: u32::MAX,
        trigger_pulse_us: u32::MAX,
        frame_time_us: u32::MAX,
        exposure_us: u32::MAX,
        exposure_delay_us: u32::MAX,
        settle_us: u32::MAX,
        laser_lead_us: u32::MAX,
        laser_lease_us: u32::MAX,
        laser_manual_ms: u32::MAX,
        heartbeat_us: u32::MAX,
        telemetry_us: u32::MAX,
        ..CONFIG
    };
    let worst = encoded(&Reply::Configured(worst)).len() / 2;
    assert!(
        longest <= worst && worst <= frame::MAX_PAYLOAD,
        "{longest} {worst}"
    );
    if let Ok(folder) = std::env::var("CANNULA_WRITE_GOLDEN") {
        let now: String = lines()
            .into_iter()
            .map(|(message, bytes)| format!("{bytes} {message}\n"))
            .collect();
        std::fs::write(format!("{folder}/messages.txt"), now).expect("writes");
        std::fs::write(format!("{folder}/schema.txt"), format!("{SCHEMA:016x}\n")).expect("writes");
    }
}
