//! Refusals (a command that is not carried out) and faults (a board that has stopped), each with
//! the numbers of the limit that was broken.

use crate::config::ConfigError;
use crate::plan::PlanError;
use crate::units::Steps;
use core::fmt;

wire! {
    /// Why a command was not carried out. Nothing moved and nothing was switched on.
    pub enum Refusal {
        /// No configuration has come yet.
        NotConfigured,
        /// Not in this state (it is named in the status).
        NotNow {
            /// What the board is doing.
            doing: Doing,
        },
        /// The position is unknown: home first.
        NotHomed,
        /// A field of the configuration is outside its limits.
        Config(ConfigError),
        /// Faster than the configured limit.
        SpeedTooHigh {
            /// Asked for, µm/s.
            asked_um_s: u32,
            /// Limit, µm/s.
            max_um_s: u32,
        },
        /// Slower than the board can step.
        SpeedTooLow {
            /// Asked for, µm/s.
            asked_um_s: u32,
            /// Limit, µm/s.
            min_um_s: u32,
        },
        /// The way, with its ramps, leaves the travel.
        OutOfTravel {
            /// The position that would be reached.
            position: Steps,
            /// The lowest allowed.
            min: Steps,
            /// The highest allowed.
            max: Steps,
        },
        /// Two triggers would come faster than pulse and camera allow.
        TriggersTooClose {
            /// The later of the two.
            index: u32,
            /// The time between them, µs.
            gap_us: u32,
            /// What pulse and frame time need, µs.
            needed_us: u32,
        },
        /// Two triggers would fall on the same step.
        SpacingTooFine {
            /// Asked for, µm.
            spacing_um: u32,
            /// Limit, µm.
            min_um: u32,
        },
        /// No triggers, or too many.
        Count {
            /// Asked for.
            count: u32,
            /// Limit.
            max: u32,
        },
        /// The numbers leave the range of a position.
        Range,
        /// The laser cannot be on as long before the first trigger as configured.
        LeadTooLong {
            /// Configured, µs.
            lead_us: u32,
            /// From the start of motion to the first trigger, µs.
            available_us: u32,
        },
        /// An input forbids it.
        InputActive {
            /// Which.
            input: Input,
        },
        /// The compiled step words do not say what was planned: a defect of the board's program.
        PlanCheck(CheckError),
        /// The message could not be read.
        Malformed,
    }

    /// What keeps the board from taking a command.
    pub enum Doing {
        /// Nothing yet.
        Boot,
        /// Configured, position unknown.
        Idle,
        /// Homing.
        Homing,
        /// At rest.
        Ready,
        /// Moving.
        Moving,
        /// Checking a scan before it moves.
        Checking,
        /// Scanning.
        Scanning,
        /// Stopping.
        Stopping,
        /// In fault: re-arm first.
        Fault,
    }

    /// An input that is sensed.
    pub enum Input {
        /// The home switch.
        Home,
        /// The switch at the far end.
        Limit,
        /// The emergency stop.
        EStop,
        /// The laser's interlock.
        Interlock,
    }

    /// What the check of compiled step words found.
    pub enum CheckError {
        /// A different number of steps.
        Steps {
            /// By the plan.
            planned: u32,
            /// By the words.
            found: u32,
        },
        /// A step edge at another time.
        Time {
            /// Which step.
            step: u32,
        },
        /// A step faster than the limit.
        Interval {
            /// Which step.
            step: u32,
            /// Its interval in cycles.
            cycles: u32,
            /// The least allowed.
            min: u32,
        },
        /// A different number of triggers.
        Triggers {
            /// By the plan.
            planned: u32,
            /// By the words.
            found: u32,
        },
        /// A trigger on another step.
        Position {
            /// Which trigger.
            index: u32,
            /// By the plan.
            planned: Steps,
            /// By the words.
            found: Steps,
        },
    }

    /// Why the board has stopped. Laser off; motion ended; nothing runs until a re-arm.
    pub enum Fault {
        /// The emergency stop was pressed (or its wire broke).
        EStop,
        /// The far limit switch was reached.
        Limit,
        /// The home switch was reached outside homing.
        HomeSwitch,
        /// The laser's interlock opened.
        Interlock,
        /// The host fell silent while the board was moving or the laser was on.
        HostSilent {
            /// For how long, µs.
            silent_us: u32,
        },
        /// Homing: the switch was not found.
        HomeNeverFound {
            /// How far was sought, steps.
            travelled: u32,
        },
        /// Homing: the switch stayed pressed although the slide backed off.
        HomeStuck {
            /// How far it backed off, steps.
            backed_off: u32,
        },
        /// Homing: the two touches lie too far apart.
        HomeBounced {
            /// Their distance, steps.
            apart: i32,
            /// The configured tolerance, steps.
            tolerance: u32,
        },
        /// The step machine ran out of words.
        Underrun {
            /// After how many steps.
            step: u32,
        },
        /// The hardware counted other steps than planned.
        StepCount {
            /// By the plan.
            planned: u32,
            /// By the counter.
            counted: u32,
        },
        /// The host did not acknowledge events fast enough: the scan stopped before one was lost.
        LedgerFull {
            /// The first trigger that was not fired.
            index: u32,
        },
        /// A trigger had no exposure.
        MissingExposure {
            /// Which.
            index: u32,
        },
        /// Fewer triggers fired than stood on the way.
        MissingTrigger {
            /// The first that did not.
            index: u32,
        },
        /// A trigger fired that was not planned.
        StrayTrigger,
        /// A wait took longer than it ever may.
        Timeout {
            /// While doing what.
            doing: Doing,
        },
        /// The laser was off (interlock, lease) at a trigger that needed it.
        LaserOff {
            /// Which trigger.
            index: u32,
        },
    }
}

impl From<PlanError> for Refusal {
    fn from(e: PlanError) -> Self {
        match e {
            PlanError::Count { count, max } => Refusal::Count { count, max },
            PlanError::SpacingTooFine { spacing_um, min_um } => {
                Refusal::SpacingTooFine { spacing_um, min_um }
            }
            PlanError::Range => Refusal::Range,
        }
    }
}

impl From<ConfigError> for Refusal {
    fn from(e: ConfigError) -> Self {
        Refusal::Config(e)
    }
}

impl Doing {
    /// A word for messages.
    pub const fn name(self) -> &'static str {
        match self {
            Doing::Boot => "waiting for its configuration",
            Doing::Idle => "idle, not homed",
            Doing::Homing => "homing",
            Doing::Ready => "ready",
            Doing::Moving => "moving",
            Doing::Checking => "checking a scan",
            Doing::Scanning => "scanning",
            Doing::Stopping => "stopping",
            Doing::Fault => "in fault",
        }
    }
}

impl Input {
    /// A word for messages.
    pub const fn name(self) -> &'static str {
        match self {
            Input::Home => "home switch",
            Input::Limit => "limit switch",
            Input::EStop => "emergency stop",
            Input::Interlock => "laser interlock",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Refusal::NotConfigured => {
                f.write_str("the board has no configuration yet: send one first")
            }
            Refusal::NotNow {
                doing: Doing::Fault,
            } => f.write_str("the board is in fault: see its status, then re-arm"),
            Refusal::NotNow { doing } => {
                write!(f, "the board is {}: not possible now", doing.name())
            }
            Refusal::NotHomed => f.write_str("the position is unknown: home first"),
            Refusal::Config(e) => e.fmt(f),
            Refusal::SpeedTooHigh {
                asked_um_s,
                max_um_s,
            } => {
                write!(
                    f,
                    "a speed of {asked_um_s} µm/s is above the limit of {max_um_s} µm/s"
                )
            }
            Refusal::SpeedTooLow {
                asked_um_s,
                min_um_s,
            } => {
                write!(
                    f,
                    "a speed of {asked_um_s} µm/s is below {min_um_s} µm/s, the slowest that the board can step"
                )
            }
            Refusal::OutOfTravel { position, min, max } => {
                let by = if position < min {
                    min.0.saturating_sub(position.0)
                } else {
                    position.0.saturating_sub(max.0)
                };
                write!(
                    f,
                    "the way reaches step {}, {by} steps outside {} to {}",
                    position.0, min.0, max.0
                )
            }
            Refusal::TriggersTooClose {
                index,
                gap_us,
                needed_us,
            } => write!(
                f,
                "trigger {index} would come {gap_us} µs after the one before, but pulse and frame time need {needed_us} µs: scan slower or wider"
            ),
            Refusal::SpacingTooFine { spacing_um, min_um } => {
                write!(
                    f,
                    "a spacing of {spacing_um} µm is below one step; the least is {min_um} µm"
                )
            }
            Refusal::Count { count, max } => write!(f, "{count} triggers: a scan has 1 to {max}"),
            Refusal::Range => f.write_str("the numbers leave the range of a position"),
            Refusal::LeadTooLong {
                lead_us,
                available_us,
            } => write!(
                f,
                "the laser is to lead the trigger by {lead_us} µs, but the first trigger comes {available_us} µs after the start of motion: give more run-up"
            ),
            Refusal::InputActive { input } => write!(f, "the {} is active", input.name()),
            Refusal::PlanCheck(e) => write!(
                f,
                "the compiled scan does not match its plan ({e:?}): a defect of the board's program"
            ),
            Refusal::Malformed => f.write_str("the board could not read the command"),
        }
    }
}

impl core::error::Error for Refusal {}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Fault::EStop => f.write_str("emergency stop pressed, or its wire broken"),
            Fault::Limit => f.write_str("far limit switch reached, or its wire broken"),
            Fault::HomeSwitch => {
                f.write_str("home switch reached outside homing, or its wire broken")
            }
            Fault::Interlock => f.write_str("laser interlock open"),
            Fault::HostSilent { silent_us } => {
                write!(f, "no word from the host for {} ms", silent_us / 1000)
            }
            Fault::HomeNeverFound { travelled } => {
                write!(f, "home switch not found within {travelled} steps")
            }
            Fault::HomeStuck { backed_off } => {
                write!(
                    f,
                    "home switch still pressed after backing off {backed_off} steps: stuck, or its wire broken"
                )
            }
            Fault::HomeBounced { apart, tolerance } => {
                write!(
                    f,
                    "home switch found at two places {apart} steps apart (tolerance {tolerance}): bouncing or loose"
                )
            }
            Fault::Underrun { step } => write!(f, "step words ran out after step {step}"),
            Fault::StepCount { planned, counted } => {
                write!(f, "{counted} steps counted where {planned} were planned")
            }
            Fault::LedgerFull { index } => {
                write!(
                    f,
                    "events were not acknowledged in time: stopped before trigger {index}, none lost"
                )
            }
            Fault::MissingExposure { index } => {
                write!(f, "the camera did not expose for trigger {index}")
            }
            Fault::MissingTrigger { index } => {
                write!(f, "trigger {index} did not fire on its step")
            }
            Fault::StrayTrigger => f.write_str("a trigger fired that was not planned"),
            Fault::Timeout { doing } => write!(f, "no end in sight while {}", doing.name()),
            Fault::LaserOff { index } => write!(f, "the laser was off at trigger {index}"),
        }
    }
}

impl core::error::Error for Fault {}

impl Fault {
    /// Whether steps may have been lost or the driver is cut, so that the slide must be homed again.
    pub const fn loses_position(self) -> bool {
        match self {
            Fault::LedgerFull { .. }
            | Fault::MissingExposure { .. }
            | Fault::Interlock
            | Fault::LaserOff { .. } => false,
            Fault::EStop
            | Fault::Limit
            | Fault::HomeSwitch
            | Fault::HostSilent { .. }
            | Fault::HomeNeverFound { .. }
            | Fault::HomeStuck { .. }
            | Fault::HomeBounced { .. }
            | Fault::Underrun { .. }
            | Fault::StepCount { .. }
            | Fault::MissingTrigger { .. }
            | Fault::StrayTrigger
            | Fault::Timeout { .. } => true,
        }
    }

    /// Whether motion ends at once rather than by a ramp.
    pub const fn ends_motion_at_once(self) -> bool {
        matches!(
            self,
            Fault::EStop
                | Fault::Limit
                | Fault::HomeSwitch
                | Fault::Underrun { .. }
                | Fault::StepCount { .. }
                | Fault::Timeout { .. }
        )
    }
}
