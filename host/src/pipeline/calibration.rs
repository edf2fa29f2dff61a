//! From the board's images to camera and light planes.

use super::Method;
use super::error::PipelineError;
use super::times::{Stage, Times};
use super::views::{Looker, Seen, Swept, light_view};
use crate::board::{BoardGeometry, Corner, Summable};
use crate::calibration::camera::{self, CameraCalibration, CameraError};
use crate::calibration::light::{self, CameraData, LightError, LightView, tables};
use crate::calibration::loss::{self, Measures};
use crate::calibration::{Covariance, Finding, LightModel, RigModel, Severity};
use crate::checks::{Check, Limit};
use crate::geometry::{Camera, Pose};
use crate::progress::Progress;
use crate::session::{Depth, Session};
use crate::stripe::paper;
use rayon::prelude::*;

/// Settings of the paper's steps (its defaults).
#[derive(Clone, Debug, Default)]
pub(super) struct Settings {
    pub paper_board: paper::board::Settings,
    pub loss: loss::Settings,
}

/// The light planes, by either way.
#[derive(Clone, Debug)]
pub struct Light {
    /// Common normal, a and b.
    pub model: LightModel,
    /// Whether the slide stood at more than one position.
    pub travels: bool,
    /// Each position on its own.
    pub planes: Vec<light::SinglePlane>,
    /// Table 2.
    pub spacings: Vec<tables::Spacing>,
    /// Mean |distance − travel|, mm.
    pub spacing_error_mm: f64,
    /// Table 4.
    pub offsets: Vec<tables::Offset>,
    /// Mean |D predicted − D fitted|, mm.
    pub offset_error_mm: f64,
    /// Each position predicted from the others, mm; empty in the paper's way.
    pub hold_out_mm: Vec<f64>,
    /// Table 1: board pose (its image), before and after.
    pub table_1: Vec<(String, Measures, Measures)>,
    /// Figure 14: slide position, before and after.
    pub figure_14: Vec<(f64, Measures, Measures)>,
    /// The board's pose in each light view that took part.
    pub poses: Vec<Pose>,
    /// Root mean square distance of the centres from the drawn stripes, px; the joint solve's.
    pub stripe_rms_px: Option<f64>,
}

/// A calibrated rig and how it came about.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// Which way.
    pub method: Method,
    /// The target.
    pub board: BoardGeometry,
    /// Zhang's calibration.
    pub zhang: CameraCalibration,
    /// Names of its views.
    pub views: Vec<String>,
    /// Their corners.
    pub corners: Vec<Vec<Corner>>,
    /// The camera to use: refined by the light views in the maximum-likelihood way.
    pub camera: Camera,
    /// Covariance of camera, normal, a and b; zero where not known.
    pub covariance: Covariance,
    /// The light planes, where the session has any.
    pub light: Option<Light>,
    /// What is weak, a sentence each.
    pub warnings: Vec<String>,
    /// Every check that was made.
    pub checks: Vec<Check>,
}

impl Calibrated {
    /// What triangulation needs.
    pub fn rig(&self) -> Option<RigModel> {
        self.light.as_ref().map(|light| RigModel {
            camera: self.camera,
            light: light.model,
            covariance: self.covariance,
        })
    }
}

/// Calibrates the rig from a recording.
///
/// # Errors
/// What is wrong with the recording, or what the gates find lacking.
pub fn calibrate(
    session: &Session,
    method: Method,
    times: &Times,
    progress: &dyn Progress,
) -> Result<Calibrated, PipelineError> {
    match session.depth {
        Depth::Eight => run::<u8>(session, method, times, progress),
        Depth::Sixteen => run::<u16>(session, method, times, progress),
    }
}

fn run<P: Summable>(
    session: &Session,
    method: Method,
    times: &Times,
    progress: &dyn Progress,
) -> Result<Calibrated, PipelineError> {
    let manifest = &session.manifest;
    let board: BoardGeometry = manifest
        .board
        .ok_or_else(|| session.missing("board", "describe the checkerboard there"))?
        .into();
    if manifest.camera.is_empty() && manifest.light.is_empty() {
        return Err(session
            .missing("camera", "record the checkerboard in ten or more poses")
            .into());
    }
    let settings = Settings::default();
    let looker = Looker {
        session,
        board,
        method,
        times,
        progress,
        settings: &settings,
    };
    let images = manifest.camera.len()
        + manifest
            .light
            .iter()
            .map(|l| l.on.len() + usize::from(l.off.is_some()))
            .sum::<usize>();
    progress.start("calibration images", images);
    let looked = rayon::join(
        || {
            manifest
                .camera
                .par_iter()
                .map(|view| looker.camera::<P>(&view.image))
                .collect::<Result<Vec<Seen>, _>>()
        },
        || {
            manifest
                .light
                .par_iter()
                .map(|pose| looker.light::<P>(pose))
                .collect::<Result<Vec<Swept>, _>>()
        },
    );
    progress.finish();
    let (seen, swept) = (looked.0?, looked.1?);

    let mut warnings = Vec::new();
    let (names, corners, of_camera) = camera_views(session, &seen, &swept, &mut warnings)?;
    let zhang = times
        .time(Stage::Camera, || {
            camera::calibrate(
                &corners,
                &board,
                manifest.image.width,
                manifest.image.height,
            )
        })
        .map_err(|e| camera_error(session, e, method, board, (&names, &corners)))?;
    warnings.extend(sentences(&zhang.findings, &names));
    for warning in &warnings {
        progress.warn(warning);
    }
    let mut calibrated = Calibrated {
        method,
        board,
        camera: zhang.camera,
        covariance: camera_covariance(&zhang),
        checks: zhang.checks.clone(),
        zhang,
        views: names,
        corners,
        light: None,
        warnings,
    };
    if !manifest.light.is_empty() {
        let told = calibrated.warnings.len();
        times
            .time(Stage::Light, || {
                light_planes(session, &swept, of_camera, &settings, &mut calibrated)
            })
            .map_err(|e| with_found(e, &calibrated))?;
        for warning in &calibrated.warnings[told..] {
            progress.warn(warning);
        }
    }
    Ok(calibrated)
}

/// The views for Zhang's method: `camera`, then the poses of `light`; and how many of the first.
#[allow(clippy::type_complexity)]
fn camera_views(
    session: &Session,
    seen: &[Seen],
    swept: &[Swept],
    warnings: &mut Vec<String>,
) -> Result<(Vec<String>, Vec<Vec<Corner>>, usize), PipelineError> {
    let (mut names, mut corners) = (Vec::new(), Vec::new());
    let mut of_camera = 0;
    let mut failed = Vec::new();
    for (i, view) in seen.iter().chain(swept.iter().map(|s| &s.seen)).enumerate() {
        match &view.board {
            Ok(found) => {
                names.push(view.name.clone());
                corners.push(found.corners.clone());
                of_camera += usize::from(i < seen.len());
            }
            Err(reason) => failed.push((&view.name, reason.to_string())),
        }
    }
    let of = seen.len() + swept.len();
    // A few bad images are life; a recording whose boards are mostly not seen is a wrong one.
    if let Some((name, reason)) = failed.first()
        && (2 * failed.len() > of || names.len() < camera::LEAST_VIEWS)
    {
        return Err(PipelineError::NoBoard {
            path: session.path(name),
            reason: reason.clone(),
            failed: failed.len(),
            of,
        });
    }
    warnings.extend(
        failed
            .iter()
            .map(|(name, reason)| format!("{name}: left out: {reason}")),
    );
    Ok((names, corners, of_camera))
}

/// The same error with what stood when it came.
fn with_found(mut e: PipelineError, calibrated: &Calibrated) -> PipelineError {
    match &mut e {
        PipelineError::Light { found, .. } | PipelineError::NoStripe { found, .. } => {
            *found = Some(Box::new(calibrated.clone()));
        }
        _ => {}
    }
    e
}

fn camera_error(
    session: &Session,
    e: CameraError,
    method: Method,
    board: BoardGeometry,
    (names, corners): (&[String], &[Vec<Corner>]),
) -> PipelineError {
    let name = |view: &usize| names.get(*view).map_or("a view", String::as_str);
    let reason = match &e {
        CameraError::Refused(findings, _) => refusals(findings, names),
        CameraError::WrongCornerCount { view, .. } | CameraError::BadCorner { view } => {
            format!("{}: {e}", name(view))
        }
        _ => e.to_string(),
    };
    let found = match e {
        CameraError::Refused(_, zhang) => Some(Box::new(Calibrated {
            method,
            board,
            camera: zhang.camera,
            covariance: camera_covariance(&zhang),
            views: names.to_vec(),
            corners: corners.to_vec(),
            light: None,
            warnings: sentences(&zhang.findings, names),
            checks: zhang.checks.clone(),
            zhang: *zhang,
        })),
        _ => None,
    };
    PipelineError::Camera {
        path: session.file().to_owned(),
        reason,
        found,
    }
}

fn sentence(finding: &Finding, names: &[String]) -> String {
    finding.sentence(finding.view.and_then(|v| names.get(v)).map(String::as_str))
}

/// What warns; what refuses is the error itself.
fn sentences(findings: &[Finding], names: &[String]) -> Vec<String> {
    findings
        .iter()
        .filter(|f| f.severity == Severity::Warn)
        .map(|f| sentence(f, names))
        .collect()
}

fn refusals(findings: &[Finding], names: &[String]) -> String {
    let all: Vec<String> = findings
        .iter()
        .filter(|f| f.severity == Severity::Refuse)
        .map(|f| sentence(f, names))
        .collect();
    all.join("; ")
}

fn camera_covariance(zhang: &CameraCalibration) -> Covariance {
    let mut covariance = Covariance::zeros();
    covariance
        .fixed_view_mut::<9, 9>(0, 0)
        .copy_from(&zhang.covariance);
    covariance
}

fn light_planes(
    session: &Session,
    swept: &[Swept],
    of_camera: usize,
    settings: &Settings,
    calibrated: &mut Calibrated,
) -> Result<(), PipelineError> {
    stripes_found(session, swept, calibrated)?;
    let (mut names, mut views): (Vec<String>, Vec<LightView>) = (Vec::new(), Vec::new());
    for pose in swept {
        if let Some(view) = light_view(pose) {
            names.push(pose.seen.name.clone());
            views.push(view);
        }
    }
    // A pose without a board may be the reason for what is lacking.
    let lost = |pose: &Swept| {
        Some(format!(
            "{}: {}",
            pose.seen.name,
            pose.seen.board.as_ref().err()?
        ))
    };
    let lost: Vec<String> = swept.iter().filter_map(lost).collect();
    let lost = lost.first().map_or(String::new(), |first| {
        format!(
            "; {} of {} poses are left out, {first}",
            lost.len(),
            swept.len()
        )
    });
    let fail = |reason: String| PipelineError::Light {
        path: session.file().to_owned(),
        reason: reason + &lost,
        found: None,
    };
    let light = match calibrated.method {
        Method::Ml => {
            let options = light::Options {
                travel_angle: travel_angle(session),
            };
            let found = light::calibrate(
                &calibrated.zhang,
                CameraData::Views(&calibrated.corners[..of_camera]),
                &views,
                &calibrated.board,
                options,
            );
            let (found, refused) = match found {
                Ok(found) => (found, None),
                Err(e) => {
                    let refused = fail(light_error(&e, &names));
                    let LightError::Refused(_, found) = e else {
                        return Err(refused);
                    };
                    (*found, Some(refused))
                }
            };
            calibrated
                .warnings
                .extend(sentences(&found.findings, &names));
            calibrated.checks.extend_from_slice(&found.checks);
            calibrated.camera = found.camera;
            calibrated.covariance = found.covariance;
            let light = of_joint(names, found);
            if let Some(refused) = refused {
                calibrated.light = Some(light);
                return Err(refused);
            }
            light
        }
        Method::Paper => {
            let poses = calibrated.zhang.poses[of_camera..].to_vec();
            let found = light::paper::calibrate(
                &calibrated.camera,
                &calibrated.board,
                &views,
                &poses,
                &settings.loss,
            )
            .map_err(|e| fail(e.to_string()))?;
            calibrated.warnings.extend(found.left_out.iter().map(|x| {
                format!("the light plane at {x} mm is left out: one board alone shows it")
            }));
            let positions: Vec<f64> = found.planes.iter().map(|p| p.slide_mm).collect();
            Light {
                model: found.model,
                travels: found.planes.len() > 1,
                spacing_error_mm: tables::spacing_error(&found.spacings),
                offset_error_mm: tables::offset_error(&found.offsets),
                planes: found.planes,
                spacings: found.spacings,
                offsets: found.offsets,
                hold_out_mm: Vec::new(),
                table_1: named(names, found.views),
                figure_14: named(positions, found.positions),
                poses,
                stripe_rms_px: None,
            }
        }
    };
    // The joint solve has a gate of its own.
    let fits = match calibrated.method {
        Method::Ml => Ok(()),
        Method::Paper => travel_fits(session, &light, &mut calibrated.checks).map_err(fail),
    };
    calibrated.light = Some(light);
    fits
}

/// The joint solve's, as the report and the file want it.
fn of_joint(names: Vec<String>, found: light::LightCalibration) -> Light {
    let positions: Vec<f64> = found.planes.iter().map(|p| p.slide_mm).collect();
    Light {
        model: found.model,
        travels: found.travels,
        planes: found.planes,
        spacings: found.spacings,
        spacing_error_mm: found.spacing_error_mm,
        offsets: found.offsets,
        offset_error_mm: found.offset_error_mm,
        hold_out_mm: found.hold_out_mm,
        table_1: named(names, found.view_measures),
        figure_14: named(positions, found.position_measures),
        poses: found.poses,
        stripe_rms_px: Some(found.stripe_rms_px),
    }
}

fn named<N>(names: Vec<N>, pairs: Vec<(Measures, Measures)>) -> Vec<(N, Measures, Measures)> {
    names
        .into_iter()
        .zip(pairs)
        .map(|(name, (before, after))| (name, before, after))
        .collect()
}

/// Angle between the slide's travel and the light plane's normal that the rig is built with, rad.
fn travel_angle(session: &Session) -> f64 {
    let laser = session.manifest.laser.unwrap_or_default();
    laser.travel_angle_deg.unwrap_or(0.0).to_radians()
}

/// The planes must move as fast as the slide says: |a| is the cosine of the angle between travel
/// and normal. Anything else is another unit, another screw, or another board than was described.
fn travel_fits(session: &Session, light: &Light, checks: &mut Vec<Check>) -> Result<(), String> {
    if !light.travels {
        return Ok(());
    }
    let expected = travel_angle(session).cos();
    let seen = light.model.a.abs();
    // 0.9 at right angles: a travel up to 25° off its normal.
    let (low, high) = (
        0.9 * expected,
        (1.03 * expected).clamp(1.03 * expected, 1.03),
    );
    let limit = Limit::Between([low, high]);
    let check = Check::held(
        "light planes: |a|, their travel over the slide’s",
        seen,
        limit,
        "",
    );
    let fits = check.sound();
    checks.push(check);
    if fits {
        return Ok(());
    }
    Err(format!(
        "the light planes move {seen:.4} mm for each mm of the slide where {low:.2} to {high:.2} can be; check the unit of slide_mm, the steps per millimetre and square_mm (or give laser.travel_angle_deg if the slide is oblique to the laser)"
    ))
}

/// Warns of images without a stripe; an error where most are.
fn stripes_found(
    session: &Session,
    swept: &[Swept],
    calibrated: &mut Calibrated,
) -> Result<(), PipelineError> {
    let all = swept.iter().flat_map(|s| &s.stripes);
    let of = all.clone().count();
    let failed: Vec<(&String, &String)> = all
        .filter_map(|(name, _, points)| points.as_ref().err().map(|reason| (name, reason)))
        .collect();
    if let Some((name, reason)) = failed.first()
        && 2 * failed.len() > of
    {
        return Err(PipelineError::NoStripe {
            path: session.path(name),
            reason: (*reason).clone(),
            failed: failed.len(),
            of,
            found: None,
        });
    }
    calibrated.checks.push(Check::held(
        "light planes: images left out",
        failed.len() as f64,
        Limit::AtMost(0.0),
        "",
    ));
    calibrated.warnings.extend(
        failed
            .iter()
            .map(|(name, reason)| format!("{name}: left out: {reason}")),
    );
    Ok(())
}

fn light_error(e: &LightError, names: &[String]) -> String {
    let name = |view: &usize| names.get(*view).map_or("a light view", String::as_str);
    match e {
        LightError::Refused(findings, _) => refusals(findings, names),
        LightError::BadCorners { view, .. } | LightError::BadPosition { view } => {
            format!("{}: {e}", name(view))
        }
        _ => e.to_string(),
    }
}
