//! The one table of what crosses the link: commands and their replies, events, telemetry.
//!
//! Encoded by postcard (varints, enums by their number). Compatibility law: *any* change here or
//! in the types used here changes [`SCHEMA`], and board and host of different schemas refuse each
//! other by the hello; so messages may change freely, while [`crate::hello`] and the frame's
//! layout ([`crate::frame`]) never do. Golden snapshots in `tests/golden.rs` make a change visible.

use crate::config::{Config, ConfigError, ExposureInput, Field, MissingExposure};
use crate::crc::Crc32;
use crate::error::{CheckError, Doing, Fault, Input, Refusal};
use crate::schema;
use crate::units::{Micros, Steps};

wire! {
    /// Host → board. Each gets one [`Reply`], at once; what takes time ends with an [`Event::JobEnd`].
    pub enum Command {
        /// Sets the configuration. Forgets the position if anything about steps changed.
        Configure(Config),
        /// Finds the home switch.
        Home,
        /// Moves to a position, at the given speed in µm/s (0 = the configured maximum).
        MoveTo {
            /// Where to.
            position: Steps,
            /// How fast, µm/s.
            speed_um_s: u32,
        },
        /// Moves by a distance; the end must lie within the travel.
        Jog {
            /// How far, with sign.
            by: Steps,
            /// How fast, µm/s.
            speed_um_s: u32,
        },
        /// Runs a scan.
        Scan(ScanRequest),
        /// Switches the laser by hand, at rest, under the lease and the host's heartbeat.
        Laser {
            /// On or off.
            on: bool,
        },
        /// Fires one trigger, at rest.
        Trigger,
        /// Ends what runs: laser off, no more triggers, down the ramp.
        Stop,
        /// Leaves a fault, if its cause is gone.
        Rearm,
        /// Cuts the driver: the slide can be moved by hand, the position becomes unknown.
        Release,
        /// Asks for the [`Status`].
        Status,
        /// Starts the board anew, at rest.
        Reboot {
            /// Into the USB bootloader, to load another program.
            bootloader: bool,
        },
    }

    /// A scan: trigger k at start + k · spacing.
    pub struct ScanRequest {
        /// Where trigger 0 stands, µm from home.
        pub start_um: i32,
        /// From one trigger to the next, µm.
        pub spacing_um: u32,
        /// How many triggers.
        pub count: u32,
        /// Speed of travel, µm/s (0 = the configured maximum).
        pub speed_um_s: u32,
        /// Standing or moving.
        pub mode: ScanMode,
        /// When the laser is on.
        pub laser: ScanLaser,
    }

    /// How a scan moves.
    pub enum ScanMode {
        /// Travel, settle, laser, trigger, wait for the exposure; as the paper does.
        StopAndShoot,
        /// All triggers in constant travel: ramps lie before the first and after the last.
        Constant,
        /// Triggers also during the ramps: needs no room outside the scan but one step.
        Ramped,
    }

    /// When the laser is on in a scan.
    pub enum ScanLaser {
        /// Never (dark or ambient frames).
        Off,
        /// From the lead time before each trigger to the end of its exposure.
        Timed,
        /// From before the first trigger to after the last.
        Whole,
    }

    /// Board → host: the answer to a command.
    pub enum Reply {
        /// Done, nothing more to say.
        Done,
        /// Begun; an [`Event::JobEnd`] with this number follows.
        Begun {
            /// The job's number.
            job: u32,
        },
        /// The configuration as the board took it.
        Configured(Config),
        /// The state of the board.
        Status(Status),
        /// Not carried out.
        Refused(Refusal),
    }

    /// The states of the board.
    pub enum State {
        /// Since power-on: laser off, driver off, waiting for a configuration.
        Boot,
        /// Configured, position unknown.
        Idle,
        /// Seeking the home switch.
        Homing,
        /// Position known; at rest or in a single move.
        Ready,
        /// In a scan.
        Scanning,
        /// Ending what ran, down the ramp.
        Stopping,
        /// Stopped by a fault, which is latched.
        Fault(Fault),
    }

    /// Levels of the inputs; true = active (reached, pressed, open, exposing).
    pub struct Inputs {
        /// Home switch reached.
        pub home: bool,
        /// Far limit switch reached.
        pub limit: bool,
        /// Emergency stop pressed.
        pub estop: bool,
        /// Laser interlock open.
        pub interlock: bool,
        /// Camera exposing.
        pub exposure: bool,
    }

    /// A look at the board.
    pub struct Status {
        /// Its state.
        pub state: State,
        /// Commanded position; meaningless unless known.
        pub position: Steps,
        /// Whether the position is known.
        pub position_known: bool,
        /// Whether the slide is moving.
        pub moving: bool,
        /// Whether the driver is on.
        pub driver: bool,
        /// Whether the laser is on.
        pub laser: bool,
        /// The inputs now.
        pub inputs: Inputs,
        /// The running job, or 0.
        pub job: u32,
        /// Triggers fired in the running scan, or in the last.
        pub triggers: u32,
        /// Events not yet acknowledged.
        pub pending: u32,
        /// Frames that came damaged.
        pub bad_frames: u32,
        /// Time since boot.
        pub uptime: Micros,
    }

    /// Board → host, kept until acknowledged.
    pub enum Event {
        /// A trigger has fired.
        Trigger(Trigger),
        /// A trigger's exposure did not come.
        MissingExposure {
            /// The scan's job number.
            job: u32,
            /// The trigger.
            index: u32,
        },
        /// A scan is over, whatever its end; comes before its [`Event::JobEnd`].
        ScanEnd(ScanSummary),
        /// A job is over.
        JobEnd {
            /// Its number.
            job: u32,
            /// How it ended.
            outcome: Outcome,
            /// Where the slide stands.
            position: Steps,
            /// Whether that is known.
            position_known: bool,
        },
        /// The home switch was found.
        Homed {
            /// The homing's job number.
            job: u32,
            /// Second touch minus first, steps: the switch's repeatability.
            apart: i32,
        },
        /// The board went into fault.
        Fault {
            /// Why.
            fault: Fault,
            /// When.
            time: Micros,
            /// Where; meaningless unless known.
            position: Steps,
            /// Whether that is known.
            position_known: bool,
        },
        /// The fault was left by a re-arm.
        Rearmed,
        /// The laser that was on by hand went off.
        LaserExpired,
    }

    /// One line of the ledger.
    pub struct Trigger {
        /// The scan's job number; 0 for a trigger fired by hand.
        pub job: u32,
        /// Which trigger of the scan, from zero.
        pub index: u32,
        /// The commanded position on which it fired.
        pub position: Steps,
        /// When, since boot.
        pub time: Micros,
        /// Whether the laser's pin was high.
        pub laser: bool,
    }

    /// The ledger's closing line.
    pub struct ScanSummary {
        /// The scan's job number.
        pub job: u32,
        /// Triggers planned.
        pub planned: u32,
        /// Triggers fired; as many [`Event::Trigger`]s were sent.
        pub fired: u32,
        /// Exposures seen (0 without that input).
        pub exposures: u32,
        /// Triggers without exposure.
        pub missing: u32,
        /// CRC-32 over the encoded [`Trigger`]s in order ([`LedgerSum`]).
        pub checksum: u32,
    }

    /// How a job ended.
    pub enum Outcome {
        /// As asked.
        Done,
        /// By a stop command.
        Stopped,
        /// By a fault.
        Failed(Fault),
    }

    /// Board → host, may be lost.
    pub struct Telemetry {
        /// When, since boot.
        pub time: Micros,
        /// Commanded position.
        pub position: Steps,
        /// Speed, µm/s (within a few per cent).
        pub speed_um_s: u32,
        /// Triggers fired in this job.
        pub triggers: u32,
        /// The expected rest of the job, ms (within a few per cent).
        pub remaining_ms: u32,
    }
}

/// The hash over everything that crosses the link.
pub const SCHEMA: u64 = schema::fold(&[
    "StepsPerMm{numerator:u32;denominator:u32;} Steps(i32) Micros(u64)",
    Config::SHAPE,
    ExposureInput::SHAPE,
    MissingExposure::SHAPE,
    Field::SHAPE,
    ConfigError::SHAPE,
    Refusal::SHAPE,
    Doing::SHAPE,
    Input::SHAPE,
    CheckError::SHAPE,
    Fault::SHAPE,
    Command::SHAPE,
    ScanRequest::SHAPE,
    ScanMode::SHAPE,
    ScanLaser::SHAPE,
    Reply::SHAPE,
    State::SHAPE,
    Inputs::SHAPE,
    Status::SHAPE,
    Event::SHAPE,
    Trigger::SHAPE,
    ScanSummary::SHAPE,
    Outcome::SHAPE,
    Telemetry::SHAPE,
]);

impl Inputs {
    /// Nothing active.
    pub const NONE: Inputs = Inputs {
        home: false,
        limit: false,
        estop: false,
        interlock: false,
        exposure: false,
    };

    /// Active in either.
    pub const fn or(self, other: Inputs) -> Inputs {
        Inputs {
            home: self.home | other.home,
            limit: self.limit | other.limit,
            estop: self.estop | other.estop,
            interlock: self.interlock | other.interlock,
            exposure: self.exposure | other.exposure,
        }
    }
}

/// The checksum that closes the ledger; both sides run it over the triggers in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LedgerSum {
    crc: Crc32,
    count: u32,
}

impl LedgerSum {
    /// Takes in the next trigger.
    pub fn add(&mut self, trigger: &Trigger) {
        let mut bytes = [0; 32];
        // 5 + 5 + 5 + 10 + 1 bytes at most.
        if let Ok(used) = postcard::to_slice(trigger, &mut bytes) {
            self.crc.update(used);
        }
        self.count = self.count.wrapping_add(1);
    }

    /// The checksum.
    pub const fn value(&self) -> u32 {
        self.crc.value()
    }

    /// How many triggers went in.
    pub const fn count(&self) -> u32 {
        self.count
    }
}

// The board keeps a few hundred events: their size is RAM.
const _: () = {
    assert!(size_of::<Trigger>() == 24);
    assert!(size_of::<Event>() <= 40);
    assert!(size_of::<Fault>() <= 12);
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ledger_sum_depends_on_every_field_and_on_order() {
        let t = Trigger {
            job: 1,
            index: 2,
            position: Steps(3),
            time: Micros(4),
            laser: true,
        };
        let others = [
            Trigger { job: 2, ..t },
            Trigger { index: 3, ..t },
            Trigger {
                position: Steps(-3),
                ..t
            },
            Trigger {
                time: Micros(5),
                ..t
            },
            Trigger { laser: false, ..t },
        ];
        let sum = |ts: &[Trigger]| {
            let mut s = LedgerSum::default();
            ts.iter().for_each(|t| s.add(t));
            (s.value(), s.count())
        };
        for o in others {
            assert_ne!(sum(&[t]), sum(&[o]));
            assert_ne!(sum(&[t, o]), sum(&[o, t]));
        }
        assert_eq!(sum(&[t, t]).1, 2);
        let most = Trigger {
            job: u32::MAX,
            index: u32::MAX,
            position: Steps(i32::MIN),
            time: Micros(u64::MAX),
            laser: true,
        };
        assert_ne!(sum(&[most]).0, sum(&[]).0);
    }
}
