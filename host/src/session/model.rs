//! `session.json` (format cannula-session/1) as data: what a recording holds. Read and written by
//! the same types; keys that are not known are ignored.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The value of `format`.
pub const FORMAT: &str = "cannula-session/1";

/// `session.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// Size of every image.
    pub image: ImageSize,
    /// The calibration target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<BoardSpec>,
    /// Board poses for Zhang's method, laser off.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub camera: Vec<CameraView>,
    /// Board poses with the stripe on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub light: Vec<LightPose>,
    /// The scan of the hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<Scan>,
    /// Where the needle is to go in, from the vein-imaging stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub entry: Option<Entry>,
    /// What is known of the laser.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laser: Option<Laser>,
    /// 4 × 4, row by row, mm: camera frame to robot frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_from_camera: Option<[[f64; 4]; 4]>,
    /// When its parts were recorded.
    #[serde(default, skip_serializing_if = "Recorded::is_empty")]
    pub recorded: Recorded,
}

/// When a session's parts were recorded, ISO 8601 in UTC, and with which settings.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    /// The latest board pose, with or without laser.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<String>,
    /// The scan of the hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<String>,
    /// What each part's images depend on: keys of the rig's configuration with their values.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, BTreeMap<String, serde_json::Value>>,
}

impl Recorded {
    /// When the scan was recorded.
    pub fn scan(&self) -> Option<jiff::Timestamp> {
        self.scan.as_ref()?.parse().ok()
    }

    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Size of every image of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageSize {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// The calibration target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoardSpec {
    /// Inner corners along the long side.
    pub columns: usize,
    /// Inner corners along the short side.
    pub rows: usize,
    /// Side of a square, mm.
    pub square_mm: f64,
}

/// A board pose for Zhang's method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraView {
    /// Name of the image, relative to `session.json`.
    pub image: String,
}

/// A board pose that the slide swept over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightPose {
    /// The pose with the laser off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub off: Option<String>,
    /// The pose with the laser on.
    pub on: Vec<Frame>,
}

/// An image taken with the laser on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Position of the slide, mm.
    pub slide_mm: f64,
    /// The same in the motion board's steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slide_steps: Option<i64>,
    /// When the motion board raised the trigger, µs of its clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trigger_us: Option<u64>,
    /// Name of the image, relative to `session.json`.
    pub image: String,
}

/// The scan of the hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// The hand with the laser off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ambient: Option<String>,
    /// In the order of travel.
    pub frames: Vec<Frame>,
}

/// Where the needle is to go in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The entry pixel (u, v).
    pub pixel: [f64; 2],
    /// Pixels along the vein, in the direction in which the needle is to advance.
    pub vein: Vec<[f64; 2]>,
    /// Radius of the region to which the plane is fitted, mm.
    pub radius_mm: f64,
}

/// What is known of the laser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Laser {
    /// Its colour: the stripe in RGB images is then sought in that channel's excess.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colour: Option<Colour>,
    /// Angle between the light plane's normal and the slide's travel where the rig has it on
    /// purpose, degrees; 0 if not given. The travel seen in the planes is checked against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub travel_angle_deg: Option<f64>,
}

/// Colour of a laser line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// 620–660 nm.
    Red,
    /// 515–532 nm.
    Green,
    /// 405–450 nm.
    Blue,
}

impl Manifest {
    /// An empty session of one image size.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            format: FORMAT.to_owned(),
            image: ImageSize { width, height },
            board: None,
            camera: Vec::new(),
            light: Vec::new(),
            scan: None,
            entry: None,
            laser: None,
            robot_from_camera: None,
            recorded: Recorded::default(),
        }
    }

    /// Every image that is named, in the order of the file.
    pub fn images(&self) -> impl Iterator<Item = &str> {
        self.board_images().chain(self.scan_images())
    }

    /// Those of the board.
    pub fn board_images(&self) -> impl Iterator<Item = &str> {
        self.camera
            .iter()
            .map(|c| c.image.as_str())
            .chain(self.light.iter().flat_map(|l| {
                l.off
                    .as_deref()
                    .into_iter()
                    .chain(l.on.iter().map(|f| f.image.as_str()))
            }))
    }

    /// Those of the scan.
    pub fn scan_images(&self) -> impl Iterator<Item = &str> {
        self.scan.iter().flat_map(|s| {
            s.ambient
                .as_deref()
                .into_iter()
                .chain(s.frames.iter().map(|f| f.image.as_str()))
        })
    }
}

impl From<BoardSpec> for crate::board::BoardGeometry {
    fn from(spec: BoardSpec) -> Self {
        Self {
            columns: spec.columns,
            rows: spec.rows,
            square_mm: spec.square_mm,
        }
    }
}
