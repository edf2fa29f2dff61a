//! What `calibrate`, `angle` and `process` share: arguments, writing, the summary.

use super::Output;
use crate::needle;
use crate::output::{AngleSource, CalibrationFile, ResultFile, write_json, write_whole};
use crate::pipeline::{Calibrated, Measurement, Method, Stage, Times, measure};
use crate::progress::Progress;
use crate::session::Session;
use clap::ValueEnum;
use std::path::Path;
use std::time::Instant;

/// `--method`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// Maximum likelihood.
    #[default]
    Ml,
    /// The paper's algorithms as written, to compare.
    Paper,
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Ml => Self::Ml,
            MethodName::Paper => Self::Paper,
        }
    }
}

/// What is asked of the needle.
#[derive(clap::Args, Debug)]
pub struct NeedleArgs {
    /// Wanted angle between needle and plane, degrees (the puncture decision's if not given).
    #[arg(long, value_name = "DEG", value_parser = angle)]
    needle_angle: Option<f64>,
    /// How far before the entry the needle's path begins, mm.
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = length)]
    stand_off: f64,
    /// How deep under the plane it ends, mm.
    #[arg(long, value_name = "MM", default_value_t = 3.25, value_parser = length)]
    depth: f64,
    /// Write the cloud as cloud.xyz too.
    #[arg(long)]
    xyz: bool,
    /// Write the cloud as cloud.csv too, with pixels and uncertainties.
    #[arg(long)]
    csv: bool,
}

fn angle(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v > 0.0 && v <= 90.0 => Ok(v),
        _ => Err("give degrees, more than 0 and at most 90".to_owned()),
    }
}

fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=500.0).contains(&v) => Ok(v),
        _ => Err("give millimetres, 0 to 500".to_owned()),
    }
}

impl NeedleArgs {
    /// What they ask for, and who asked for the angle.
    pub fn settings(&self) -> (needle::Settings, AngleSource) {
        let (degrees, source) = match self.needle_angle {
            Some(degrees) => (degrees, AngleSource::CommandLine),
            None => (
                crate::puncture::default_decision().angle_deg,
                AngleSource::Puncture,
            ),
        };
        let settings = needle::Settings {
            angle: degrees.to_radians(),
            stand_off_mm: self.stand_off,
            depth_mm: self.depth,
            ..needle::Settings::default()
        };
        (settings, source)
    }
}

/// Where the puncture decision chose the angle, its sentence goes wherever the angle goes: the
/// paper's criterion may leave the clinical 15–30° or go through the far wall.
pub fn decision_words(source: AngleSource) -> Option<String> {
    (source == AngleSource::Puncture).then(|| crate::puncture::default_decision().sentence)
}

/// The parts that measuring needs, named before any image is opened.
pub fn needs_scan(session: &Session) -> anyhow::Result<()> {
    if session.manifest.scan.is_none() {
        return Err(session
            .missing("scan", "record the hand with `cannula scan`")
            .into());
    }
    if session.manifest.entry.is_none() {
        let remedy = "give entry pixel, vein and radius from the vein imaging";
        return Err(session.missing("entry", remedy).into());
    }
    Ok(())
}

/// Measures the hand and writes cloud and result into `folder`.
#[allow(clippy::too_many_arguments)]
pub fn measure_and_write(
    session: &Session,
    calibration: &CalibrationFile,
    method: Method,
    args: &NeedleArgs,
    folder: &Path,
    times: &Times,
    begun: Instant,
    out: &Output,
) -> anyhow::Result<(ResultFile, Measurement)> {
    let rig = calibration.rig().ok_or_else(|| {
        anyhow::anyhow!(
            "{}: no light planes in this calibration; calibrate with a session that has \"light\"",
            session.file().display()
        )
    })?;
    let (settings, source) = args.settings();
    let positions = calibration.positions();
    let mut measured = measure(session, &rig, &positions, method, &settings, times, out)?;
    if let Some(words) = decision_words(source) {
        out.warn(&words);
        measured.warnings.push(words);
    }
    let robot = session.manifest.robot_from_camera.as_ref();
    let result = write_measured(folder, &measured, method, args, robot, times, begun)?;
    Ok((result, measured))
}

/// Writes cloud and result of a measurement into `folder`.
pub fn write_measured(
    folder: &Path,
    measured: &Measurement,
    method: Method,
    args: &NeedleArgs,
    robot: Option<&[[f64; 4]; 4]>,
    times: &Times,
    begun: Instant,
) -> anyhow::Result<ResultFile> {
    let source = args.settings().1;
    let mut result = ResultFile::new(measured, "cloud.ply", source, method, robot);
    times.time(Stage::Write, || -> anyhow::Result<()> {
        let comment = format!("cannula {}", env!("CARGO_PKG_VERSION"));
        let points = &measured.cloud;
        write_whole(&folder.join("cloud.ply"), |w| {
            crate::cloud::write_ply(w, points, &comment)
        })?;
        if args.xyz {
            write_whole(&folder.join("cloud.xyz"), |w| {
                crate::cloud::write_xyz(w, points)
            })?;
        }
        if args.csv {
            write_whole(&folder.join("cloud.csv"), |w| {
                crate::cloud::write_csv(w, points)
            })?;
        }
        Ok(())
    })?;
    result.seconds = seconds(times, begun);
    // The result last: where it stands, all else stands.
    write_json(&folder.join("result.json"), &result)?;
    Ok(result)
}

/// Seconds a stage (summed over threads), and of the clock on the wall.
fn seconds(times: &Times, begun: Instant) -> std::collections::BTreeMap<String, f64> {
    let stages = times.seconds().into_iter();
    let mut all: std::collections::BTreeMap<String, f64> =
        stages.map(|(name, s)| (name.to_owned(), s)).collect();
    all.insert("wall".to_owned(), begun.elapsed().as_secs_f64());
    all
}

/// A calibration in a few lines.
pub fn calibration_text(c: &Calibrated) -> String {
    let mut text = format!(
        "camera  fx {:.2}  fy {:.2}  u0 {:.2}  v0 {:.2}  reprojection {:.4} px over {} views",
        c.camera.fx,
        c.camera.fy,
        c.camera.u0,
        c.camera.v0,
        c.zhang.rms_px,
        c.views.len()
    );
    if let Some(light) = &c.light {
        let n = light.model.normal;
        text += &format!("\nlight   normal ({:.5}, {:.5}, {:.5})", n.x, n.y, n.z);
        if light.travels {
            text += &format!(
                "  D = {:.5}·x {:+.4} mm  spacing error {:.4} mm  offset error {:.4} mm",
                light.model.a, light.model.b, light.spacing_error_mm, light.offset_error_mm
            );
        } else {
            text += "  one position: no travel";
        }
    }
    text
}

/// A measurement in a few lines.
pub fn measurement_text(m: &Measurement) -> String {
    let d = &m.decision;
    let (n, e, a) = (d.plane.normal, d.entry, d.needle.axis);
    let u = &d.uncertainty;
    format!(
        "cloud   {} points on the hand\n\
         plane   normal ({:.5}, {:.5}, {:.5})  ±{:.3}°  {} points, {:.3} mm RMS\n\
         entry   ({:.3}, {:.3}, {:.3}) mm  ±{:.3} mm\n\
         needle  {:.1}° ±{:.3}°  axis ({:.5}, {:.5}, {:.5})  ±{:.3}°",
        m.cloud.len(),
        n.x,
        n.y,
        n.z,
        u.normal_sigma().to_degrees(),
        d.points,
        d.rms_mm,
        e.x,
        e.y,
        e.z,
        u.entry_sigma_mm(),
        d.needle.angle.to_degrees(),
        u.angle_sigma.to_degrees(),
        a.x,
        a.y,
        a.z,
        u.axis_sigma().to_degrees()
    )
}
