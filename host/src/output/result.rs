//! result.json: what the contract fixes, and beside it how sure it is.

use super::{CalibrationFile, rows, three};
use crate::checks::{self, Check};
use crate::geometry::{Matrix3, Point3, Vector3};
use crate::needle::Decision;
use crate::pipeline::Measurement;
use crate::puncture::{Basis, default_decision};
use crate::rig::config::Rig;
use crate::session::{RecordingDigest, sha256_of};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The value of `format`.
const FORMAT: &str = "cannula-result/1";

/// Where the wanted angle comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum AngleSource {
    /// `--needle-angle`.
    CommandLine,
    /// The puncture decision.
    Puncture,
    /// Nobody asked: the program's default.
    Default,
}

impl AngleSource {
    /// For a reader.
    pub fn words(self) -> &'static str {
        match self {
            Self::CommandLine => "--needle-angle",
            Self::Puncture => "the puncture decision",
            Self::Default => "the program's default",
        }
    }
}

/// result.json.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResultFile {
    format: &'static str,
    cloud: Cloud,
    plane: Plane,
    entry: Entry,
    vein: Vein,
    needle: Needle,
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<Robot>,
    method: &'static str,
    /// "usable", or "usable with caution" where one of `checks` is not sound. (What is not usable has
    /// no result.)
    verdict: &'static str,
    /// Every check that was made, with value, limit and outcome.
    checks: Vec<Check>,
    /// What is weak, a sentence each: those of `checks`.
    pub warnings: Vec<String>,
    /// What it was measured with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub provenance: Option<ScanProvenance>,
    /// Seconds a stage, summed over threads, and "wall".
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub seconds: BTreeMap<String, f64>,
}

/// What a scan was measured with ("provenance" of result.json).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScanProvenance {
    /// Program and version.
    pub program: &'static str,
    /// When, ISO 8601 in UTC.
    pub time: String,
    /// session.json and the images that took part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingDigest>,
    /// The calibration, if it came from a file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationSource>,
    /// The rig's configuration as it was used: port, speeds, exposures, trigger, positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rig: Option<Rig>,
    /// What the wanted angle was compared by.
    pub puncture: Basis,
}

/// Which calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationSource {
    /// Its file.
    pub file: PathBuf,
    /// When it was made, ISO 8601 in UTC, if it says so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// Its file's SHA-256, in hexadecimal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

impl ScanProvenance {
    /// Of a scan that stands now; the recording's digest comes with its images.
    pub fn now(
        calibration: Option<(&std::path::Path, &CalibrationFile)>,
        rig: Option<&Rig>,
    ) -> Self {
        let decision = default_decision();
        let compared: Vec<f64> = decision.rows.iter().map(|r| r.angle_deg).collect();
        Self {
            program: crate::PROGRAM,
            recording: None,
            time: super::seconds(jiff::Timestamp::now()),
            calibration: calibration.map(|(file, made)| CalibrationSource {
                file: file.to_owned(),
                time: made.provenance.as_ref().and_then(|p| p.time.clone()),
                sha256: sha256_of(file).ok(),
            }),
            rig: rig.cloned(),
            puncture: Basis::new(
                &crate::puncture::Setup::default(),
                &compared,
                decision.criterion,
                false,
            ),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Cloud {
    points: usize,
    file: String,
    background_points: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Plane {
    normal: [f64; 3],
    d: f64,
    a: f64,
    b: f64,
    c: f64,
    points: usize,
    rms_mm: f64,
    stripes: usize,
    coverage: f64,
    /// Of the cylinder that is as far from its plane.
    bend_radius_mm: f64,
    normal_sigma_deg: f64,
    normal_covariance: [[f64; 3]; 3],
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Entry {
    point_mm: [f64; 3],
    pixel: [f64; 2],
    radius_mm: f64,
    sigma_mm: f64,
    covariance_mm2: [[f64; 3]; 3],
    parts_mm: Parts,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Vein {
    direction: [f64; 3],
    points_mm: Vec<[f64; 3]>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Needle {
    angle_deg: f64,
    axis: [f64; 3],
    /// What measuring leaves open: standard deviation by stripe, sampling and calibration.
    angle_sigma_deg: f64,
    /// What the model is known to leave open beside that: how much the angle changes at most if the
    /// plane is fitted within a smaller radius (a hand is no plane). Systematic: repeating the scan
    /// does not make it smaller.
    #[serde(skip_serializing_if = "Option::is_none")]
    angle_systematic_deg: Option<f64>,
    /// The radius to whose plane it changes so much, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    angle_systematic_radius_mm: Option<f64>,
    angle_source: AngleSource,
    /// The same needle's angle to the plane of half the region's radius.
    #[serde(skip_serializing_if = "Option::is_none")]
    angle_at_half_radius_deg: Option<f64>,
    axis_sigma_deg: f64,
    axis_covariance: [[f64; 3]; 3],
    parts_deg: Parts,
    path: Path,
}

/// What contributes to a standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Parts {
    calibration: f64,
    stripe: f64,
    sampling: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Path {
    start_mm: [f64; 3],
    entry_mm: [f64; 3],
    end_mm: [f64; 3],
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Robot {
    point_mm: [f64; 3],
    normal: [f64; 3],
    direction: [f64; 3],
    axis: [f64; 3],
    path: Path,
}

fn parts(p: [f64; 3]) -> Parts {
    Parts {
        calibration: p[0],
        stripe: p[1],
        sampling: p[2],
    }
}

fn path(d: &Decision, to: impl Fn(&Point3) -> Point3) -> Path {
    let p = &d.needle.path;
    let place = |q: &Point3| three(&to(q).coords);
    Path {
        start_mm: place(&p.start),
        entry_mm: place(&p.entry),
        end_mm: place(&p.end),
    }
}

impl ResultFile {
    /// From a measurement. `cloud` is the cloud's file name, `robot` the session's
    /// `robot_from_camera`.
    pub fn new(
        m: &Measurement,
        cloud: &str,
        source: AngleSource,
        method: crate::pipeline::Method,
        robot: Option<&[[f64; 4]; 4]>,
    ) -> Self {
        let d = &m.decision;
        let u = &d.uncertainty;
        let [a, b, c] = d.abc();
        Self {
            format: FORMAT,
            cloud: Cloud {
                points: m.cloud.len(),
                file: cloud.to_owned(),
                background_points: m.background.len(),
            },
            plane: Plane {
                normal: three(&d.plane.normal),
                d: d.plane.d,
                a,
                b,
                c,
                points: d.points,
                rms_mm: d.rms_mm,
                stripes: d.stripes,
                coverage: d.coverage,
                bend_radius_mm: d.bend_mm,
                normal_sigma_deg: u.normal_sigma().to_degrees(),
                normal_covariance: rows(&u.normal),
            },
            entry: Entry {
                point_mm: three(&d.entry.coords),
                pixel: [m.request.pixel.x, m.request.pixel.y],
                radius_mm: m.request.radius_mm,
                sigma_mm: u.entry_sigma_mm(),
                covariance_mm2: rows(&u.entry),
                parts_mm: parts(u.entry_parts_mm),
            },
            vein: Vein {
                direction: three(&d.direction),
                points_mm: d.vein.iter().map(|p| three(&p.coords)).collect(),
            },
            needle: Needle {
                angle_deg: d.needle.angle.to_degrees(),
                axis: three(&d.needle.axis),
                angle_sigma_deg: u.angle_sigma.to_degrees(),
                angle_systematic_deg: d.radius_change().map(|r| r.abs().to_degrees()),
                angle_systematic_radius_mm: d.turned.map(|(radius, _)| radius),
                angle_source: source,
                angle_at_half_radius_deg: d.inner_angle.map(f64::to_degrees),
                axis_sigma_deg: u.axis_sigma().to_degrees(),
                axis_covariance: rows(&u.axis),
                parts_deg: parts(u.angle_parts.map(f64::to_degrees)),
                path: path(d, |p| *p),
            },
            robot: robot.map(|t| Robot::new(d, t)),
            method: method.name(),
            verdict: checks::verdict(&m.checks),
            checks: m.checks.clone(),
            warnings: checks::sentences(&m.checks),
            provenance: None,
            seconds: BTreeMap::new(),
        }
    }
}

impl Robot {
    fn new(d: &Decision, t: &[[f64; 4]; 4]) -> Self {
        let rotation = Matrix3::from_fn(|i, j| t[i][j]);
        let shift = Vector3::new(t[0][3], t[1][3], t[2][3]);
        let place = |p: &Point3| Point3::from(rotation * p.coords + shift);
        let turn = |v: &Vector3| three(&(rotation * v).normalize());
        Self {
            point_mm: three(&place(&d.entry).coords),
            normal: turn(&d.plane.normal),
            direction: turn(&d.direction),
            axis: turn(&d.needle.axis),
            path: path(d, place),
        }
    }
}
