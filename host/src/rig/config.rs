//! The rig's configuration file (TOML). [`EXAMPLE`] is the documentation: every key with its
//! meaning and its default. Each value is checked, and what is wrong is said with its key.

use crate::board::BoardGeometry;
use crate::simulation::Profile;
use cannula_shared::config::{Config as BoardConfig, ExposureInput, Field, MissingExposure};
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest};
use cannula_shared::units::StepsPerMm;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A configuration with every key and its meaning.
pub const EXAMPLE: &str = include_str!("example.toml");

/// What is wrong with a configuration: the file, the key, what to do.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// There is none.
    #[error("{path}: there is no such file; `cannula config --example > {path}` writes one to begin with", path = path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// It can't be read.
    #[error("{path}: can't be read", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is no TOML, or has a key that there is not, or a value of the wrong kind.
    #[error("{path}: {reason}", path = path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line and reason in one sentence.
        reason: String,
    },
    /// A value can't be.
    #[error("{path}: {key} is {value}: give {wanted}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key, with its table.
        key: &'static str,
        /// What stands there.
        value: String,
        /// What may stand there.
        wanted: String,
    },
}

/// The rig.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rig {
    /// The motion board and its slide.
    pub board: Board,
    /// The camera.
    pub camera: Camera,
    /// The laser.
    pub laser: Laser,
    /// The calibration target.
    pub checkerboard: Checkerboard,
    /// Slide positions of the light planes.
    pub light: Light,
    /// Slide positions of the scan.
    pub scan: Scan,
    /// The simulated rig.
    pub simulation: Simulation,
}

/// `[board]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Board {
    pub port: String,
    #[serde(deserialize_with = "syntax::exactly")]
    pub steps_per_mm: [u32; 2],
    pub invert_direction: bool,
    pub travel_mm: f64,
    pub max_speed_mm_s: f64,
    pub acceleration_mm_s2: f64,
    pub homing_fast_mm_s: f64,
    pub homing_slow_mm_s: f64,
    pub clearance_mm: f64,
    pub run_up_mm: f64,
    pub settle_ms: f64,
    pub exposure_wired: bool,
}

/// `[camera]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Camera {
    pub kind: CameraKind,
    pub device: String,
    pub pixel_format: String,
    #[serde(deserialize_with = "syntax::exactly")]
    pub region: [u32; 4],
    pub trigger: TriggerSource,
    pub trigger_line: String,
    pub exposure_board_ms: f64,
    pub exposure_laser_ms: f64,
    pub gain_db: f64,
    pub frame_time_ms: f64,
    pub timeout_ms: f64,
}

/// What kind of camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraKind {
    /// Industrial, by aravis.
    Genicam,
    /// UVC, by Video4Linux.
    V4l,
    /// Rendered.
    Simulated,
}

/// Most that the sheet may travel while the shutter is open, mm: about a stripe's own width.
const MOST_SMEAR_MM: f64 = 0.2;

/// What starts an exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TriggerSource {
    /// The motion board's pin.
    Board,
    /// A command to the camera.
    Software,
    /// Nothing: the camera runs by itself.
    Free,
}

/// `[laser]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Laser {
    pub lead_ms: f64,
    pub manual_s: f64,
}

/// `[checkerboard]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Checkerboard {
    pub columns: usize,
    pub rows: usize,
    pub square_mm: f64,
}

/// `[light]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Light {
    pub start_mm: f64,
    pub spacing_mm: f64,
    pub count: u32,
}

/// `[scan]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Scan {
    pub start_mm: f64,
    pub spacing_mm: f64,
    pub count: u32,
    pub speed_mm_s: f64,
    pub mode: Mode,
}

/// How a scan moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Travel, settle, expose.
    Stop,
    /// On the fly at constant speed.
    Constant,
}

/// `[simulation]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(missing_docs, reason = "documented in EXAMPLE, key by key")]
pub struct Simulation {
    pub seed: u64,
    pub profile: String,
}

impl Default for Board {
    fn default() -> Self {
        Self {
            port: "auto".into(),
            steps_per_mm: [800, 1],
            invert_direction: false,
            travel_mm: 300.0,
            max_speed_mm_s: 50.0,
            acceleration_mm_s2: 200.0,
            homing_fast_mm_s: 10.0,
            homing_slow_mm_s: 1.0,
            clearance_mm: 4.0,
            run_up_mm: 0.5,
            settle_ms: 100.0,
            exposure_wired: false,
        }
    }
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            kind: CameraKind::Simulated,
            device: String::new(),
            pixel_format: "Mono8".into(),
            region: [0; 4],
            trigger: TriggerSource::Board,
            trigger_line: "Line0".into(),
            exposure_board_ms: 10.0,
            exposure_laser_ms: 5.0,
            gain_db: 0.0,
            frame_time_ms: 20.0,
            timeout_ms: 500.0,
        }
    }
}

impl Default for Laser {
    fn default() -> Self {
        Self {
            lead_ms: 2.0,
            manual_s: 60.0,
        }
    }
}

impl Default for Checkerboard {
    fn default() -> Self {
        Self {
            columns: 8,
            rows: 6,
            square_mm: 10.0,
        }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self {
            start_mm: 0.0,
            spacing_mm: 5.0,
            count: 13,
        }
    }
}

impl Default for Scan {
    fn default() -> Self {
        Self {
            start_mm: 0.0,
            spacing_mm: 2.0,
            count: 31,
            speed_mm_s: 20.0,
            mode: Mode::Constant,
        }
    }
}

impl Scan {
    /// The slide's positions, mm.
    pub fn positions(&self) -> Vec<f64> {
        (0..self.count)
            .map(|k| self.start_mm + self.spacing_mm * f64::from(k))
            .collect()
    }
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            seed: 1,
            profile: "nominal".into(),
        }
    }
}

impl Rig {
    /// Reads and checks a configuration file.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|source| {
            let path = path.to_owned();
            match source.kind() {
                std::io::ErrorKind::NotFound => ConfigError::Missing { path },
                _ => ConfigError::Read { path, source },
            }
        })?;
        Self::parse(&text, path)
    }

    /// Parses and checks; `path` is for messages only.
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let rig: Self = toml::from_str(text).map_err(|e| ConfigError::Syntax {
            path: path.to_owned(),
            reason: syntax::reason(text, &e),
        })?;
        rig.check(path)?;
        Ok(rig)
    }

    /// Checks every value; `path` is for messages only.
    pub fn check(&self, path: &Path) -> Result<(), ConfigError> {
        let fail = |key: &'static str, value: String, wanted: &str| {
            Err(ConfigError::Value {
                path: path.to_owned(),
                key,
                value,
                wanted: wanted.to_owned(),
            })
        };
        // Bounds that turn into the board's integers without loss; its own limits come after.
        let bounds: [(&'static str, f64, f64, f64); 24] = [
            ("board.travel_mm", self.board.travel_mm, 1e-3, 1e6),
            ("board.max_speed_mm_s", self.board.max_speed_mm_s, 1e-3, 1e4),
            (
                "board.acceleration_mm_s2",
                self.board.acceleration_mm_s2,
                1e-3,
                1e6,
            ),
            (
                "board.homing_fast_mm_s",
                self.board.homing_fast_mm_s,
                1e-3,
                1e4,
            ),
            (
                "board.homing_slow_mm_s",
                self.board.homing_slow_mm_s,
                1e-3,
                1e4,
            ),
            ("board.clearance_mm", self.board.clearance_mm, 0.0, 1e3),
            ("board.run_up_mm", self.board.run_up_mm, 0.0, 1e3),
            ("board.settle_ms", self.board.settle_ms, 0.0, 1e4),
            (
                "camera.exposure_board_ms",
                self.camera.exposure_board_ms,
                0.001,
                1000.0,
            ),
            (
                "camera.exposure_laser_ms",
                self.camera.exposure_laser_ms,
                0.001,
                1000.0,
            ),
            ("camera.gain_db", self.camera.gain_db, -20.0, 60.0),
            (
                "camera.frame_time_ms",
                self.camera.frame_time_ms,
                0.0,
                10_000.0,
            ),
            ("camera.timeout_ms", self.camera.timeout_ms, 1.0, 60_000.0),
            ("laser.lead_ms", self.laser.lead_ms, 0.0, 1000.0),
            ("laser.manual_s", self.laser.manual_s, 0.001, 3600.0),
            (
                "checkerboard.columns",
                self.checkerboard.columns as f64,
                3.0,
                60.0,
            ),
            (
                "checkerboard.rows",
                self.checkerboard.rows as f64,
                3.0,
                60.0,
            ),
            (
                "checkerboard.square_mm",
                self.checkerboard.square_mm,
                0.5,
                500.0,
            ),
            (
                "light.start_mm",
                self.light.start_mm,
                0.0,
                self.board.travel_mm,
            ),
            ("light.spacing_mm", self.light.spacing_mm, 1e-3, 1e3),
            ("light.count", f64::from(self.light.count), 1.0, 1000.0),
            (
                "scan.start_mm",
                self.scan.start_mm,
                0.0,
                self.board.travel_mm,
            ),
            ("scan.spacing_mm", self.scan.spacing_mm, 1e-3, 1e3),
            (
                "scan.speed_mm_s",
                self.scan.speed_mm_s,
                1e-3,
                self.board.max_speed_mm_s,
            ),
        ];
        for (key, value, low, high) in bounds {
            if !(low..=high).contains(&value) {
                return fail(key, value.to_string(), &format!("{low} to {high}"));
            }
        }
        if self.scan.count == 0 || self.scan.count > 100_000 {
            return fail("scan.count", self.scan.count.to_string(), "1 to 100000");
        }
        if self.checkerboard.rows > self.checkerboard.columns {
            return fail(
                "checkerboard.rows",
                self.checkerboard.rows.to_string(),
                "the short side: at most checkerboard.columns",
            );
        }
        for (key, start, spacing, count) in [
            (
                "light.count",
                self.light.start_mm,
                self.light.spacing_mm,
                self.light.count,
            ),
            (
                "scan.count",
                self.scan.start_mm,
                self.scan.spacing_mm,
                self.scan.count,
            ),
        ] {
            let end = start + spacing * f64::from(count - 1);
            if end > self.board.travel_mm + 1e-9 {
                return fail(
                    key,
                    count.to_string(),
                    &format!(
                        "fewer positions: the last would lie at {end} mm, the slide's travel is {} mm",
                        self.board.travel_mm
                    ),
                );
            }
        }
        if self.simulation.profile.parse::<Profile>().is_err() {
            return fail(
                "simulation.profile",
                format!("{:?}", self.simulation.profile),
                "\"tiny\", \"nominal\" or \"hard\"",
            );
        }
        if self.camera.kind == CameraKind::V4l && self.camera.device.is_empty() {
            return fail(
                "camera.device",
                "\"\"".into(),
                "the device to take images from",
            );
        }
        let smear_mm =
            1e-3 * self.camera.exposure_laser_ms * self.travel_mm_s(&self.scan_request());
        if smear_mm > MOST_SMEAR_MM {
            return fail(
                "scan.speed_mm_s",
                self.scan.speed_mm_s.to_string(),
                &format!(
                    "at most {:.3}, so that the sheet travels no more than {MOST_SMEAR_MM} mm in camera.exposure_laser_ms (or scan.mode = \"stop\")",
                    1e3 * MOST_SMEAR_MM / self.camera.exposure_laser_ms
                ),
            );
        }
        let [left, top, width, height] = self.camera.region;
        if (width == 0) != (height == 0) || (width == 0 && (left, top) != (0, 0)) {
            return fail(
                "camera.region",
                format!("{:?}", self.camera.region),
                "[left, top, width, height], or [0, 0, 0, 0] for all of the sensor",
            );
        }
        if self.camera.kind == CameraKind::V4l {
            self.check_uvc(&fail)?;
        }
        if let Err(e) = self.board_config(self.camera.exposure_laser_ms).validate() {
            return fail(
                key_of(e.field),
                format!("{} ({})", e.value, e.field.name()),
                &format!("{} to {} in that unit, given the other keys", e.min, e.max),
            );
        }
        if let Some(o) = plan::objection(self) {
            return fail(o.key, o.value, &o.wanted);
        }
        for (key, exposure) in [
            ("camera.exposure_board_ms", self.camera.exposure_board_ms),
            ("camera.exposure_laser_ms", self.camera.exposure_laser_ms),
        ] {
            let needed = exposure + self.camera.frame_time_ms;
            if self.camera.timeout_ms < needed - 1e-9 {
                return fail(
                    "camera.timeout_ms",
                    self.camera.timeout_ms.to_string(),
                    &format!(
                        "at least {}: no frame comes sooner than {key} and camera.frame_time_ms after its trigger",
                        (1e3 * needed).ceil() / 1e3
                    ),
                );
            }
        }
        Ok(())
    }

    /// What a UVC camera can't do is refused rather than passed over.
    fn check_uvc(
        &self,
        fail: &dyn Fn(&'static str, String, &str) -> Result<(), ConfigError>,
    ) -> Result<(), ConfigError> {
        let c = &self.camera;
        if c.trigger != TriggerSource::Free {
            return fail(
                "camera.trigger",
                format!("{:?}", c.trigger).to_lowercase(),
                "\"free\": a UVC camera has no trigger input and no trigger command",
            );
        }
        if c.gain_db != 0.0 {
            return fail(
                "camera.gain_db",
                c.gain_db.to_string(),
                "0: a UVC camera's gain has no unit; set it with `v4l2-ctl --set-ctrl gain=…`",
            );
        }
        if c.region[..2] != [0, 0] {
            return fail(
                "camera.region",
                format!("{:?}", c.region),
                "[0, 0, width, height]: a UVC camera has sizes, and no corner to begin at",
            );
        }
        if !["Mono8", "Mono16"].contains(&c.pixel_format.as_str()) {
            return fail(
                "camera.pixel_format",
                format!("{:?}", c.pixel_format),
                "\"Mono8\" or \"Mono16\"",
            );
        }
        Ok(())
    }

    /// The motion board's configuration for an exposure.
    pub fn board_config(&self, exposure_ms: f64) -> BoardConfig {
        let micro = |x: f64| (x * 1000.0).round().clamp(0.0, u32::MAX.into()) as u32;
        let b = &self.board;
        let base = BoardConfig::default();
        BoardConfig {
            steps_per_mm: StepsPerMm {
                numerator: b.steps_per_mm[0],
                denominator: b.steps_per_mm[1],
            },
            invert_direction: b.invert_direction,
            travel_um: micro(b.travel_mm),
            max_speed_um_s: micro(b.max_speed_mm_s),
            acceleration_um_s2: micro(b.acceleration_mm_s2),
            homing_fast_um_s: micro(b.homing_fast_mm_s),
            homing_slow_um_s: micro(b.homing_slow_mm_s),
            homing_travel_um: micro(b.travel_mm * 1.07 + 1.0),
            homing_backoff_um: base.homing_backoff_um.min(micro(b.travel_mm * 0.5)),
            homing_tolerance_um: base.homing_tolerance_um.min(micro(b.travel_mm * 0.5)),
            clearance_um: micro(b.clearance_mm),
            run_up_um: micro(b.run_up_mm),
            settle_us: micro(b.settle_ms),
            exposure_input: if b.exposure_wired {
                ExposureInput::Counted
            } else {
                ExposureInput::Unused
            },
            // A frame that is missing is found, named and shot again: no reason to stop.
            missing_exposure: MissingExposure::Warning,
            frame_time_us: micro(self.camera.frame_time_ms),
            exposure_us: micro(exposure_ms),
            laser_lead_us: micro(self.laser.lead_ms),
            laser_manual_ms: micro(self.laser.manual_s),
            ..base
        }
    }

    /// The request for the scan of the hand.
    pub fn scan_request(&self) -> ScanRequest {
        let micro = |x: f64| (x * 1000.0).round() as u32;
        ScanRequest {
            start_um: micro(self.scan.start_mm) as i32,
            spacing_um: micro(self.scan.spacing_mm),
            count: self.scan.count,
            speed_um_s: micro(self.scan.speed_mm_s),
            // For a camera that the board does not trigger the slide stops at each position.
            mode: match (self.scan.mode, self.camera.trigger) {
                (Mode::Constant, TriggerSource::Board) => ScanMode::Constant,
                _ => ScanMode::StopAndShoot,
            },
            laser: ScanLaser::Timed,
        }
    }

    /// How fast the slide travels at a scan's triggers, mm/s; 0 where it stops for them.
    pub fn travel_mm_s(&self, request: &ScanRequest) -> f64 {
        match (request.mode, request.speed_um_s) {
            (ScanMode::StopAndShoot, _) => 0.0,
            (_, 0) => self.board.max_speed_mm_s,
            (_, speed) => 1e-3 * f64::from(speed),
        }
    }

    /// The request for the slide positions of one board pose.
    pub fn light_request(&self) -> ScanRequest {
        let micro = |x: f64| (x * 1000.0).round() as u32;
        ScanRequest {
            start_um: micro(self.light.start_mm) as i32,
            spacing_um: micro(self.light.spacing_mm),
            count: self.light.count,
            speed_um_s: 0,
            mode: ScanMode::StopAndShoot,
            laser: ScanLaser::Timed,
        }
    }

    /// The calibration target.
    pub fn geometry(&self) -> BoardGeometry {
        BoardGeometry {
            columns: self.checkerboard.columns,
            rows: self.checkerboard.rows,
            square_mm: self.checkerboard.square_mm,
        }
    }

    /// Steps as mm of slide.
    pub fn mm(&self, steps: i64) -> f64 {
        let [n, d] = self.board.steps_per_mm;
        steps as f64 * f64::from(d) / f64::from(n)
    }

    /// Which profile is simulated (checked by [`Rig::check`]).
    pub fn profile(&self) -> Profile {
        self.simulation.profile.parse().unwrap_or(Profile::Nominal)
    }
}

/// The key in the file behind a field of the board's configuration.
fn key_of(field: Field) -> &'static str {
    match field {
        Field::StepsNumerator | Field::StepsDenominator => "board.steps_per_mm",
        Field::Travel | Field::HomingTravel => "board.travel_mm",
        Field::MaxSpeed => "board.max_speed_mm_s",
        Field::Acceleration => "board.acceleration_mm_s2",
        Field::HomingFast => "board.homing_fast_mm_s",
        Field::HomingSlow => "board.homing_slow_mm_s",
        Field::HomingBackoff | Field::HomingTolerance => "board.travel_mm",
        Field::Clearance => "board.clearance_mm",
        Field::RunUp => "board.run_up_mm",
        Field::TriggerPulse | Field::FrameTime => "camera.frame_time_ms",
        Field::Exposure | Field::ExposureDelay => "camera.exposure_laser_ms",
        Field::Settle => "board.settle_ms",
        Field::LaserLead => "laser.lead_ms",
        Field::LaserLease | Field::LaserManual => "laser.manual_s",
        Field::Heartbeat | Field::Telemetry => "board",
    }
}

mod plan;
mod syntax;
#[cfg(test)]
mod tests;
