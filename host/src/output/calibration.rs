//! calibration.json: what the contract fixes, and beside it how it came about and how sure it is.

use super::{OutputError, three};
use crate::calibration::{Covariance, LightModel, PARAMETERS, RigModel};
use crate::checks::Check;
use crate::geometry::{Camera, Distortion, Pose, Vector3};
use crate::pipeline::Calibrated;
use crate::session::{RecordingDigest, Session};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The value of `format`.
const FORMAT: &str = "cannula-calibration/1";

/// calibration.json.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFile {
    /// "cannula-calibration/1".
    pub format: String,
    /// The camera.
    pub camera: CameraFile,
    /// The light planes; absent when the session had none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<LightFile>,
    /// "ml" or "paper".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<String>,
    /// Covariance of fx, fy, u0, v0, k1, k2, p1, p2, k3, the normal's two tangent directions, a
    /// and b, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Vec<Vec<f64>>>,
    /// The board that was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub board: Option<crate::session::BoardSpec>,
    /// What is weak, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Every check that was made, with value, limit and outcome.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub checks: Vec<Check>,
    /// How it came about.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Provenance>,
}

/// How a calibration came about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program and version.
    pub program: String,
    /// The recording.
    pub session: String,
    /// Its session.json and the board's images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingDigest>,
    /// When, ISO 8601 in UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// When its boards were recorded, where the recording says so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
}

/// The camera's part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFile {
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    /// Focal length along u, px.
    pub fx: f64,
    /// Focal length along v, px.
    pub fy: f64,
    /// Principal point, u.
    pub u0: f64,
    /// Principal point, v.
    pub v0: f64,
    /// Eq. 2.
    pub distortion: DistortionFile,
    /// Reprojection error over all views, px.
    pub rms_px: f64,
    /// The views.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub views: Vec<ViewFile>,
}

/// Distortion coefficients, as named in the contract.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DistortionFile {
    /// r².
    pub k1: f64,
    /// r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// r⁶.
    pub k3: f64,
}

/// One view of the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewFile {
    /// Its image.
    pub image: String,
    /// Reprojection error, px.
    pub rms_px: f64,
    /// Whether it took part.
    pub used: bool,
    /// Tilt of the board about the image's horizontal and vertical axis, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt_deg: Option<[f64; 2]>,
    /// Distance of the board's first corner from the camera, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_mm: Option<f64>,
    /// The corners in the board's order: u, v of each, px.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub corners_px: Vec<f64>,
    /// Observed minus reprojected, in the same order: du, dv of each, px.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub residuals_px: Vec<f64>,
}

/// The light planes' part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightFile {
    /// (A, B, C).
    pub normal: [f64; 3],
    /// a; null where the slide stood at one position.
    pub a: Option<f64>,
    /// b, mm; null where the slide stood at one position.
    pub b: Option<f64>,
    /// Each position on its own.
    pub planes: Vec<PlaneFile>,
    /// Mean |distance between neighbouring planes − distance travelled|, mm.
    #[serde(default)]
    pub spacing_error_mm: Option<f64>,
    /// Mean |D predicted − D fitted|, mm.
    #[serde(default)]
    pub offset_error_mm: Option<f64>,
    /// Mean |D predicted from the other positions − D fitted|, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out_error_mm: Option<f64>,
    /// The joint solve's stripe residual, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stripe_rms_px: Option<f64>,
    /// Table 1: for each light pose, Σ‖u_o − u_c‖² before and after, px².
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub table_1: Vec<BeforeAfter>,
    /// Table 2.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub table_2: Vec<SpacingRow>,
    /// Table 4.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub table_4: Vec<OffsetRow>,
    /// Figure 14: for each position, mean distance from its plane before and after, mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub figure_14: Vec<PositionBeforeAfter>,
}

/// A single position's plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaneFile {
    /// Slide, mm.
    pub slide_mm: f64,
    /// Its own normal.
    pub normal: [f64; 3],
    /// Its own D, mm.
    pub d: f64,
    /// Points.
    #[serde(default)]
    pub points: usize,
    /// Root mean square distance of the points, mm.
    #[serde(default)]
    pub rms_mm: f64,
}

/// A row of Table 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// The pose's image.
    pub image: String,
    /// Before, px².
    pub before_px2: f64,
    /// After, px².
    pub after_px2: f64,
}

/// A bar pair of Figure 14.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PositionBeforeAfter {
    /// Slide, mm.
    pub slide_mm: f64,
    /// Before, mm.
    pub before_mm: f64,
    /// After, mm.
    pub after_mm: f64,
}

/// A row of Table 2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpacingRow {
    /// Slide position of the later plane, mm.
    pub slide_mm: f64,
    /// Travelled since the plane before, mm.
    pub travelled_mm: f64,
    /// Distance between the two (Eq. 10), mm.
    pub distance_mm: f64,
}

/// A row of Table 4.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetRow {
    /// Slide, mm.
    pub slide_mm: f64,
    /// a·x + b, mm.
    pub predicted_mm: f64,
    /// D fitted, mm.
    pub fitted_mm: f64,
    /// |D predicted from the other positions − D fitted|, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_out_mm: Option<f64>,
}

impl CalibrationFile {
    /// From a calibration of this recording.
    pub fn new(calibrated: &Calibrated, session: &Session) -> Self {
        let c = &calibrated.camera;
        let d = c.distortion;
        let zhang = &calibrated.zhang;
        let known = calibrated.covariance.iter().any(|v| *v != 0.0);
        let size = if calibrated.light.is_some() {
            PARAMETERS
        } else {
            9
        };
        Self {
            format: FORMAT.to_owned(),
            camera: CameraFile {
                width: c.width,
                height: c.height,
                fx: c.fx,
                fy: c.fy,
                u0: c.u0,
                v0: c.v0,
                distortion: DistortionFile {
                    k1: d.k1,
                    k2: d.k2,
                    p1: d.p1,
                    p2: d.p2,
                    k3: d.k3,
                },
                rms_px: zhang.rms_px,
                views: calibrated
                    .views
                    .iter()
                    .enumerate()
                    .map(|(i, image)| ViewFile::new(calibrated, i, image))
                    .collect(),
            },
            light: calibrated.light.as_ref().map(LightFile::new),
            method: Some(calibrated.method.name().to_owned()),
            covariance: known.then(|| {
                (0..size)
                    .map(|i| (0..size).map(|j| calibrated.covariance[(i, j)]).collect())
                    .collect()
            }),
            board: Some(crate::session::BoardSpec {
                columns: calibrated.board.columns,
                rows: calibrated.board.rows,
                square_mm: calibrated.board.square_mm,
            }),
            warnings: calibrated.warnings.clone(),
            checks: calibrated.checks.clone(),
            provenance: Some(Provenance {
                program: crate::PROGRAM.to_owned(),
                session: session.folder().display().to_string(),
                recording: session.digest(session.manifest.board_images()).ok(),
                time: Some(super::seconds(jiff::Timestamp::now())),
                recorded: session.manifest.recorded.board.clone(),
            }),
        }
    }

    /// The camera.
    pub fn camera(&self) -> Camera {
        let (c, d) = (&self.camera, self.camera.distortion);
        Camera {
            width: c.width,
            height: c.height,
            fx: c.fx,
            fy: c.fy,
            u0: c.u0,
            v0: c.v0,
            distortion: Distortion {
                k1: d.k1,
                k2: d.k2,
                p1: d.p1,
                p2: d.p2,
                k3: d.k3,
            },
        }
    }

    /// Camera and light planes; `None` for a calibration of the camera alone.
    pub fn rig(&self) -> Option<RigModel> {
        let light = self.light.as_ref()?;
        let normal = Vector3::from(light.normal).normalize();
        let (a, b) = match (light.a, light.b) {
            (Some(a), Some(b)) => (a, b),
            // One position: its own plane is all there is.
            _ => (0.0, light.planes.first()?.d),
        };
        let covariance = match &self.covariance {
            Some(rows) if rows.len() == PARAMETERS => Covariance::from_fn(|i, j| rows[i][j]),
            _ => Covariance::zeros(),
        };
        Some(RigModel {
            camera: self.camera(),
            light: LightModel { normal, a, b },
            covariance,
        })
    }

    /// Slide positions at which planes were measured, mm.
    pub fn positions(&self) -> Vec<f64> {
        self.light
            .iter()
            .flat_map(|l| l.planes.iter().map(|p| p.slide_mm))
            .collect()
    }

    /// Whether all values can be; gives what can't.
    fn check(&self) -> Result<(), String> {
        let c = &self.camera;
        let d = &c.distortion;
        if self.format != FORMAT {
            return Err(format!(
                "\"format\" is {:?} where {FORMAT:?} is read",
                self.format
            ));
        }
        let numbers = [c.fx, c.fy, c.u0, c.v0, d.k1, d.k2, d.p1, d.p2, d.k3];
        if c.width == 0 || c.height == 0 || numbers.iter().any(|v| !v.is_finite()) {
            return Err("the camera's parameters are not all numbers".to_owned());
        }
        if !(c.fx > 0.0 && c.fy > 0.0) {
            return Err(format!("the focal lengths are {} and {}", c.fx, c.fy));
        }
        if let Some(light) = &self.light {
            let n = Vector3::from(light.normal);
            if !((n.norm() - 1.0).abs() < 1e-3 && n.z > 0.0) {
                return Err(format!(
                    "the light normal {:?} is no unit vector with C > 0",
                    light.normal
                ));
            }
            match (light.a, light.b) {
                (Some(a), Some(b)) if a.is_finite() && b.is_finite() => {}
                (None, None) if light.planes.len() == 1 => {}
                _ => return Err("light.a and light.b do not describe planes".to_owned()),
            }
            if light
                .planes
                .iter()
                .any(|p| !(p.d.is_finite() && p.slide_mm.is_finite()))
            {
                return Err("light.planes has a plane that is not all numbers".to_owned());
            }
        }
        let views = &self.camera.views;
        if let Some(view) = views.iter().find(|v| {
            let n = v.corners_px.len();
            n % 2 != 0 || ![0, n].contains(&v.residuals_px.len())
        }) {
            return Err(format!(
                "corners and residuals of {} do not pair",
                view.image
            ));
        }
        if let Some(rows) = &self.covariance {
            let n = rows.len();
            let square = rows.iter().all(|r| r.len() == n);
            let size = n == PARAMETERS || n == 9;
            let sound = square
                && size
                && (0..n).all(|i| rows[i][i] >= 0.0)
                && rows.iter().flatten().all(|v| v.is_finite());
            if !sound {
                return Err("\"covariance\" is none".to_owned());
            }
        }
        Ok(())
    }
}

impl ViewFile {
    /// The view `i` of Zhang's calibration.
    fn new(c: &Calibrated, i: usize, image: &str) -> Self {
        // A thousandth of a pixel, and a ten-thousandth for what is left: the file stays small.
        let round = |x: f64, unit: f64| (x * unit).round() / unit;
        let zhang = &c.zhang;
        let pose = zhang.poses.get(i);
        let corners = c.corners.get(i).map_or(&[][..], Vec::as_slice);
        let (mut corners_px, mut residuals_px) = (Vec::new(), Vec::new());
        for (k, corner) in corners.iter().enumerate() {
            let seen = corner.pixel;
            corners_px.extend([round(seen.x, 1e3), round(seen.y, 1e3)]);
            let drawn = pose.and_then(|p| zhang.camera.project(&p.apply(&c.board.point(k))));
            let off = drawn.map_or([0.0; 2], |p| [seen.x - p.x, seen.y - p.y]);
            residuals_px.extend(off.map(|x| round(x, 1e4)));
        }
        Self {
            image: image.to_owned(),
            rms_px: zhang.view_rms_px.get(i).copied().unwrap_or(0.0),
            used: zhang.used.get(i).copied().unwrap_or(true),
            tilt_deg: pose.map(|p| tilt(p).map(|t| round(t, 1e2))),
            distance_mm: pose.map(|p| round(p.translation.norm(), 1e1)),
            corners_px,
            residuals_px,
        }
    }
}

/// Tilt of the board about the image's horizontal and vertical axis, degrees.
fn tilt(pose: &Pose) -> [f64; 2] {
    let n = pose.rotation * Vector3::z();
    let n = if n.z < 0.0 { -n } else { n };
    [(-n.y).atan2(n.z).to_degrees(), n.x.atan2(n.z).to_degrees()]
}

impl LightFile {
    fn new(light: &crate::pipeline::Light) -> Self {
        let hold_out = &light.hold_out_mm;
        let n = hold_out.len();
        let moves = light.travels;
        Self {
            normal: three(&light.model.normal),
            a: moves.then_some(light.model.a),
            b: moves.then_some(light.model.b),
            planes: light
                .planes
                .iter()
                .map(|p| PlaneFile {
                    slide_mm: p.slide_mm,
                    normal: three(&p.plane.normal),
                    d: p.plane.d,
                    points: p.points,
                    rms_mm: p.rms_mm,
                })
                .collect(),
            spacing_error_mm: moves.then_some(light.spacing_error_mm),
            offset_error_mm: moves.then_some(light.offset_error_mm),
            hold_out_error_mm: (n > 0)
                .then(|| hold_out.iter().map(|v| v.abs()).sum::<f64>() / n as f64),
            stripe_rms_px: light.stripe_rms_px,
            table_1: light
                .table_1
                .iter()
                .map(|(image, before, after)| BeforeAfter {
                    image: image.clone(),
                    before_px2: before.reprojection_px2,
                    after_px2: after.reprojection_px2,
                })
                .collect(),
            table_2: light
                .spacings
                .iter()
                .map(|s| SpacingRow {
                    slide_mm: s.slide_mm,
                    travelled_mm: s.travelled_mm,
                    distance_mm: s.distance_mm,
                })
                .collect(),
            table_4: light
                .offsets
                .iter()
                .enumerate()
                .map(|(i, o)| OffsetRow {
                    slide_mm: o.slide_mm,
                    predicted_mm: o.predicted_mm,
                    fitted_mm: o.fitted_mm,
                    hold_out_mm: hold_out.get(i).copied(),
                })
                .collect(),
            figure_14: light
                .figure_14
                .iter()
                .map(|(slide_mm, before, after)| PositionBeforeAfter {
                    slide_mm: *slide_mm,
                    before_mm: before.plane_mm,
                    after_mm: after.plane_mm,
                })
                .collect(),
        }
    }
}

/// Reads and checks a calibration.
///
/// # Errors
/// What is wrong with the file.
pub fn read_calibration(path: &Path) -> Result<CalibrationFile, OutputError> {
    let text = std::fs::read(path).map_err(|source| OutputError::Io {
        path: path.to_owned(),
        source,
    })?;
    let file: CalibrationFile = serde_json::from_slice(&text).map_err(|e| OutputError::Json {
        path: path.to_owned(),
        reason: e.to_string(),
    })?;
    file.check().map_err(|what| OutputError::Value {
        path: path.to_owned(),
        what,
    })?;
    Ok(file)
}
