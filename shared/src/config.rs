//! The board's configuration: comes from the host, is checked field by field, and is echoed back.
//!
//! Lengths are in µm so that the numbers do not change with the driver's microstepping; the ratio
//! [`Config::steps_per_mm`] turns them into steps.

use crate::units::{CLOCK_HZ, Micros, StepsPerMm};
use core::fmt;

/// The fewest cycles from one STEP edge to the next that a step word can say.
pub const MIN_STEP_INTERVAL: u32 = 39;
/// The most cycles from one STEP edge to the next that a step word can say (16.8 ms).
pub const MAX_STEP_INTERVAL: u32 = MIN_STEP_INTERVAL + (1 << 21) - 1;
/// The highest step rate that the board promises to hold, steps/s.
pub const MAX_STEP_RATE: u32 = 500_000;
/// Steps/s of a ramp for which the board's CPU makes the words without falling behind: on a ramp each
/// step is a word of its own. (Cruising takes next to none.)
pub const FEED_RATE: u32 = 410_000;
/// Step words that are made ahead, from which a ramp above [`FEED_RATE`] is fed while it lasts.
pub const FEED_RESERVE: u32 = 4_096;
/// The lowest step rate that a step word can say, steps/s.
pub const MIN_STEP_RATE: u32 = CLOCK_HZ.div_ceil(MAX_STEP_INTERVAL);
/// The lowest acceleration whose first step a step word can say, steps/s²: t(1) = f·√(2/a).
pub const MIN_ACCELERATION: u32 = (2 * CLOCK_HZ as u64 * CLOCK_HZ as u64)
    .div_ceil(MAX_STEP_INTERVAL as u64 * MAX_STEP_INTERVAL as u64)
    as u32;
/// The highest acceleration, steps/s²; above it, even the first step of a ramp is a matter of microseconds.
pub const MAX_ACCELERATION: u32 = 100_000_000;
/// The longest that the laser stays on without renewal, µs.
pub const MAX_LASER_LEASE_US: u32 = 25_000;
/// The farthest that a position may lie from home, in steps.
pub const MAX_TRAVEL_STEPS: u32 = 1 << 26;

wire! {
    /// Everything that the board must know about the rig.
    pub struct Config {
        /// Microsteps per millimetre of slide travel.
        pub steps_per_mm: StepsPerMm,
        /// Turns the DIR pin around: false = high moves away from home.
        pub invert_direction: bool,
        /// How far the slide may go from home, µm.
        pub travel_um: u32,
        /// Highest speed, µm/s.
        pub max_speed_um_s: u32,
        /// Acceleration of every ramp, µm/s².
        pub acceleration_um_s2: u32,
        /// Speed of the first approach to the home switch, µm/s.
        pub homing_fast_um_s: u32,
        /// Speed of the second approach, µm/s.
        pub homing_slow_um_s: u32,
        /// How far to back off between them, µm.
        pub homing_backoff_um: u32,
        /// The longest way on which the switch is sought, µm.
        pub homing_travel_um: u32,
        /// How far the second touch may lie from the first before the switch counts as bouncing, µm.
        pub homing_tolerance_um: u32,
        /// Position zero lies this far from the switch's edge, µm.
        pub clearance_um: u32,
        /// Travel before the first trigger of a scan on the fly, to take out backlash, µm.
        pub run_up_um: u32,
        /// Width of the camera's trigger pulse, µs.
        pub trigger_pulse_us: u32,
        /// The shortest time that the camera needs from the end of one pulse to the next, µs.
        pub frame_time_us: u32,
        /// The camera's exposure, µs.
        pub exposure_us: u32,
        /// Whether the camera's exposure-active output is wired to the board.
        pub exposure_input: ExposureInput,
        /// What a trigger without an exposure means.
        pub missing_exposure: MissingExposure,
        /// How long after a trigger its exposure may begin, µs.
        pub exposure_delay_us: u32,
        /// Rest between arriving and exposing, stop and shoot, µs.
        pub settle_us: u32,
        /// How long the laser is on before the trigger, µs.
        pub laser_lead_us: u32,
        /// The laser's lease: it is off this long after the last renewal, µs.
        pub laser_lease_us: u32,
        /// A laser switched on by hand goes off after this, ms.
        pub laser_manual_ms: u32,
        /// The host is gone after this much silence, µs.
        pub heartbeat_us: u32,
        /// Time between positions reported while moving, µs; 0 = none.
        pub telemetry_us: u32,
    }

    /// The exposure-active signal.
    pub enum ExposureInput {
        /// Not wired.
        Unused,
        /// Wired: every trigger's exposure is counted.
        Counted,
    }

    /// What a missing exposure does.
    pub enum MissingExposure {
        /// The scan stops with a fault.
        Fault,
        /// It is reported and counted.
        Warning,
    }

    /// A field of [`Config`], to name it in an error.
    pub enum Field {
        /// [`Config::steps_per_mm`], the numerator.
        StepsNumerator,
        /// [`Config::steps_per_mm`], the denominator.
        StepsDenominator,
        /// [`Config::travel_um`]
        Travel,
        /// [`Config::max_speed_um_s`]
        MaxSpeed,
        /// [`Config::acceleration_um_s2`]
        Acceleration,
        /// [`Config::homing_fast_um_s`]
        HomingFast,
        /// [`Config::homing_slow_um_s`]
        HomingSlow,
        /// [`Config::homing_backoff_um`]
        HomingBackoff,
        /// [`Config::homing_travel_um`]
        HomingTravel,
        /// [`Config::homing_tolerance_um`]
        HomingTolerance,
        /// [`Config::clearance_um`]
        Clearance,
        /// [`Config::run_up_um`]
        RunUp,
        /// [`Config::trigger_pulse_us`]
        TriggerPulse,
        /// [`Config::frame_time_us`]
        FrameTime,
        /// [`Config::exposure_us`]
        Exposure,
        /// [`Config::exposure_delay_us`]
        ExposureDelay,
        /// [`Config::settle_us`]
        Settle,
        /// [`Config::laser_lead_us`]
        LaserLead,
        /// [`Config::laser_lease_us`]
        LaserLease,
        /// [`Config::laser_manual_ms`]
        LaserManual,
        /// [`Config::heartbeat_us`]
        Heartbeat,
        /// [`Config::telemetry_us`]
        Telemetry,
    }

    /// A field outside its limits.
    pub struct ConfigError {
        /// Which field.
        pub field: Field,
        /// What was given.
        pub value: u32,
        /// The least that goes, given the other fields.
        pub min: u32,
        /// The most that goes, given the other fields.
        pub max: u32,
    }
}

impl Field {
    /// The field's name as it stands in [`Config`].
    pub const fn name(self) -> &'static str {
        match self {
            Field::StepsNumerator => "steps_per_mm.numerator",
            Field::StepsDenominator => "steps_per_mm.denominator",
            Field::Travel => "travel_um",
            Field::MaxSpeed => "max_speed_um_s",
            Field::Acceleration => "acceleration_um_s2",
            Field::HomingFast => "homing_fast_um_s",
            Field::HomingSlow => "homing_slow_um_s",
            Field::HomingBackoff => "homing_backoff_um",
            Field::HomingTravel => "homing_travel_um",
            Field::HomingTolerance => "homing_tolerance_um",
            Field::Clearance => "clearance_um",
            Field::RunUp => "run_up_um",
            Field::TriggerPulse => "trigger_pulse_us",
            Field::FrameTime => "frame_time_us",
            Field::Exposure => "exposure_us",
            Field::ExposureDelay => "exposure_delay_us",
            Field::Settle => "settle_us",
            Field::LaserLead => "laser_lead_us",
            Field::LaserLease => "laser_lease_us",
            Field::LaserManual => "laser_manual_ms",
            Field::Heartbeat => "heartbeat_us",
            Field::Telemetry => "telemetry_us",
        }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ConfigError {
            field,
            value,
            min,
            max,
        } = self;
        write!(f, "{} is {value}, but must be {min} to {max}", field.name())
    }
}

impl core::error::Error for ConfigError {}

impl Default for Config {
    /// A bench slide: 800 steps/mm (2 mm lead screw, 200 full steps, 8 microsteps), 300 mm of travel.
    fn default() -> Self {
        Config {
            steps_per_mm: StepsPerMm::whole(800),
            invert_direction: false,
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
            exposure_input: ExposureInput::Unused,
            missing_exposure: MissingExposure::Fault,
            exposure_delay_us: 2_000,
            settle_us: 100_000,
            laser_lead_us: 2_000,
            laser_lease_us: 20_000,
            laser_manual_ms: 60_000,
            heartbeat_us: 200_000,
            telemetry_us: 50_000,
        }
    }
}

/// The highest rate to which a ramp of `acceleration` steps/s² can be fed. Above [`FEED_RATE`] R it eats
/// into the reserve B for as long as it lasts: (v − R)² / 2a words up to rate v, so v ≤ R + √(2aB).
pub fn max_rate(acceleration: u32) -> u32 {
    let above = (2 * u64::from(acceleration) * u64::from(FEED_RESERVE)).isqrt();
    MAX_STEP_RATE.min(FEED_RATE.saturating_add(saturate(above)))
}

fn saturate(value: u64) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

impl Config {
    /// Checks every field; the first that does not hold is named with its limits.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let r = self.steps_per_mm;
        check(Field::StepsNumerator, r.numerator, 1, 1_000_000)?;
        check(Field::StepsDenominator, r.denominator, 1, 10_000)?;
        // One step/mm at least, and no more than 100 000: beyond that is a slip of the pen.
        let d = r.denominator;
        check(
            Field::StepsNumerator,
            r.numerator,
            d,
            d.saturating_mul(100_000).min(1_000_000),
        )?;
        // Limits in steps, said in the field's own unit: the least µm whose steps reach a bound, the most whose stay below.
        let least = |steps: u32| {
            saturate((u64::from(steps) * u64::from(d) * 1000).div_ceil(u64::from(r.numerator)))
        };
        let most =
            |steps: u32| saturate(u64::from(steps) * u64::from(d) * 1000 / u64::from(r.numerator));

        check(
            Field::Travel,
            self.travel_um,
            least(2),
            most(MAX_TRAVEL_STEPS).min(i32::MAX as u32 / 2),
        )?;
        check(
            Field::Acceleration,
            self.acceleration_um_s2,
            least(MIN_ACCELERATION),
            most(MAX_ACCELERATION),
        )?;
        let (slowest, fastest) = (least(MIN_STEP_RATE), most(max_rate(self.acceleration())));
        check(Field::MaxSpeed, self.max_speed_um_s, slowest, fastest)?;
        check(
            Field::HomingFast,
            self.homing_fast_um_s,
            slowest,
            self.max_speed_um_s,
        )?;
        check(
            Field::HomingSlow,
            self.homing_slow_um_s,
            slowest,
            self.homing_fast_um_s,
        )?;
        check(
            Field::HomingBackoff,
            self.homing_backoff_um,
            least(1),
            self.travel_um,
        )?;
        check(
            Field::HomingTravel,
            self.homing_travel_um,
            self.homing_backoff_um,
            saturate(u64::from(self.travel_um) * 2),
        )?;
        check(
            Field::HomingTolerance,
            self.homing_tolerance_um,
            least(1),
            self.homing_backoff_um,
        )?;
        check(
            Field::Clearance,
            self.clearance_um,
            least(4),
            self.travel_um,
        )?;
        check(Field::RunUp, self.run_up_um, 0, self.travel_um)?;
        check(Field::TriggerPulse, self.trigger_pulse_us, 1, 10_000)?;
        check(Field::FrameTime, self.frame_time_us, 0, 10_000_000)?;
        check(Field::Exposure, self.exposure_us, 1, 1_000_000)?;
        check(Field::ExposureDelay, self.exposure_delay_us, 1, 1_000_000)?;
        check(Field::Settle, self.settle_us, 0, 10_000_000)?;
        check(Field::LaserLead, self.laser_lead_us, 0, 1_000_000)?;
        // Renewed at every poll, of which there is one in 5 ms at the latest.
        check(
            Field::LaserLease,
            self.laser_lease_us,
            10_000,
            MAX_LASER_LEASE_US,
        )?;
        check(Field::LaserManual, self.laser_manual_ms, 1, 3_600_000)?;
        // With the lease on top, the laser must be off within 300 ms of the host's last word.
        check(Field::Heartbeat, self.heartbeat_us, 20_000, 250_000)?;
        check(Field::Telemetry, self.telemetry_us, 0, 10_000_000)
    }

    /// Travel in steps, rounded down.
    pub fn travel_steps(&self) -> u32 {
        saturate(self.steps_per_mm.steps_down(self.travel_um))
    }

    /// Clearance in steps, rounded up.
    pub fn clearance_steps(&self) -> u32 {
        saturate(self.steps_per_mm.steps_up(self.clearance_um))
    }

    /// Steps/s of a speed in µm/s, rounded down.
    pub fn step_rate(&self, um_s: u32) -> u32 {
        saturate(self.steps_per_mm.steps_down(um_s))
    }

    /// Acceleration in steps/s², rounded down.
    pub fn acceleration(&self) -> u32 {
        saturate(self.steps_per_mm.steps_down(self.acceleration_um_s2))
    }

    /// The shortest time from one trigger to the next that pulse and camera allow.
    pub fn min_trigger_gap(&self) -> Micros {
        Micros(u64::from(self.trigger_pulse_us) + u64::from(self.frame_time_us))
    }
}

fn check(field: Field, value: u32, min: u32, max: u32) -> Result<(), ConfigError> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(ConfigError {
            field,
            value,
            min,
            max,
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn steep_ramps_reach_the_highest_rate_and_long_ones_what_can_be_fed() {
        // In floating point: R + √(2aB).
        for a in [MIN_ACCELERATION, 100_000, 250_000, 500_000, 900_000] {
            let rate = 410_000.0 + (2.0 * f64::from(a) * 4096.0).sqrt();
            assert_eq!(max_rate(a), rate.floor() as u32, "{a}");
        }
        assert_eq!(max_rate(1_000_000), MAX_STEP_RATE);
        let slow_ramp = Config {
            max_speed_um_s: 600_000,
            acceleration_um_s2: 250_000,
            ..Config::default()
        };
        // 200 000 steps/s²: 450 477 steps/s are 563 096.25 µm/s at 800 steps/mm.
        let error = slow_ramp.validate().unwrap_err();
        assert_eq!((error.field, error.max), (Field::MaxSpeed, 563_096));
    }

    #[test]
    fn limits_of_the_step_word() {
        assert_eq!(MAX_STEP_INTERVAL, 2_097_190);
        assert_eq!(MIN_STEP_RATE, 60);
        assert_eq!(MIN_ACCELERATION, 7106);
        assert_eq!(Config::default().validate(), Ok(()));
    }

    type Change = fn(&mut Config, u32);

    #[test]
    fn every_field_is_held_to_the_limits_that_its_error_names() {
        let fields: [(Field, Change); 22] = [
            (Field::StepsNumerator, |c, v| c.steps_per_mm.numerator = v),
            (Field::StepsDenominator, |c, v| {
                c.steps_per_mm.denominator = v
            }),
            (Field::Travel, |c, v| c.travel_um = v),
            (Field::MaxSpeed, |c, v| c.max_speed_um_s = v),
            (Field::Acceleration, |c, v| c.acceleration_um_s2 = v),
            (Field::HomingFast, |c, v| c.homing_fast_um_s = v),
            (Field::HomingSlow, |c, v| c.homing_slow_um_s = v),
            (Field::HomingBackoff, |c, v| c.homing_backoff_um = v),
            (Field::HomingTravel, |c, v| c.homing_travel_um = v),
            (Field::HomingTolerance, |c, v| c.homing_tolerance_um = v),
            (Field::Clearance, |c, v| c.clearance_um = v),
            (Field::RunUp, |c, v| c.run_up_um = v),
            (Field::TriggerPulse, |c, v| c.trigger_pulse_us = v),
            (Field::FrameTime, |c, v| c.frame_time_us = v),
            (Field::Exposure, |c, v| c.exposure_us = v),
            (Field::ExposureDelay, |c, v| c.exposure_delay_us = v),
            (Field::Settle, |c, v| c.settle_us = v),
            (Field::LaserLead, |c, v| c.laser_lead_us = v),
            (Field::LaserLease, |c, v| c.laser_lease_us = v),
            (Field::LaserManual, |c, v| c.laser_manual_ms = v),
            (Field::Heartbeat, |c, v| c.heartbeat_us = v),
            (Field::Telemetry, |c, v| c.telemetry_us = v),
        ];
        for (field, set) in fields {
            for value in [0, u32::MAX] {
                let mut c = Config::default();
                set(&mut c, value);
                let Err(e) = c.validate() else {
                    assert!(value == 0, "{field:?} takes {value}");
                    continue;
                };
                assert_eq!((e.field, e.value), (field, value));
                assert!(!(e.min..=e.max).contains(&value) && e.min <= e.max, "{e}");
                // The limits named are the limits: both ends pass as far as this field goes, one beyond does not.
                let judge = |v| {
                    let mut c = Config::default();
                    set(&mut c, v);
                    c.validate().err().filter(|e| e.field == field)
                };
                if field != Field::StepsDenominator && field != Field::StepsNumerator {
                    assert_eq!(judge(e.min), None, "{field:?} at its least");
                    assert_eq!(judge(e.max), None, "{field:?} at its most");
                    assert!(e.min == 0 || judge(e.min - 1).is_some());
                    assert!(e.max == u32::MAX || judge(e.max + 1).is_some());
                }
            }
        }
    }

    #[test]
    fn errors_read_as_sentences() {
        let c = Config {
            max_speed_um_s: 700_000,
            ..Config::default()
        };
        let e = c.validate().unwrap_err();
        assert_eq!(
            e.to_string(),
            "max_speed_um_s is 700000, but must be 75 to 557753"
        );
    }

    proptest! {
        #[test]
        fn whatever_passes_can_be_stepped(n in 1u32..1_000_000, d in 1u32..100, v in 1u32..10_000_000, a in 1u32..100_000_000) {
            let c = Config {
                steps_per_mm: StepsPerMm { numerator: n, denominator: d },
                max_speed_um_s: v, acceleration_um_s2: a, homing_fast_um_s: v, homing_slow_um_s: v,
                ..Config::default()
            };
            if c.validate().is_ok() {
                let rate = c.step_rate(v);
                prop_assert!((MIN_STEP_RATE..=MAX_STEP_RATE).contains(&rate));
                prop_assert!(c.acceleration() >= MIN_ACCELERATION);
            }
        }
    }
}
