//! What `calibrate`, `angle` and `process` share: arguments, writing, the summary.

use super::Output;
pub use super::summary::{calibration as calibration_text, measurement as measurement_text};
use crate::needle;
use crate::output::{
    AngleSource, CalibrationFile, Doubt, OutputError, ResultFile, ScanProvenance, age,
    doubts as doubts_of, loose_here, write_json, write_whole,
};
use crate::pipeline::{Calibrated, Measurement, Method, PipelineError, Stage, Times, measure};
use crate::progress::Progress;
use crate::report;
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
    doubt(calibration, &mut measured, begun, out);
    if let Some(words) = decision_words(source) {
        out.warn(&words);
        measured.warnings.push(words);
    }
    let robot = session.manifest.robot_from_camera.as_ref();
    let result = write_measured(folder, &measured, method, args, robot, None, times, begun)?;
    out.detail(&super::summary::times(times));
    if out.verbose > 1 {
        for (name, value) in report::settings(method, &settings) {
            out.detail(&format!("{name}: {value}"));
        }
    }
    Ok((result, measured))
}

/// Writes cloud and result of a measurement into `folder`; `provenance` if a rig scanned it.
#[allow(clippy::too_many_arguments)]
pub fn write_measured(
    folder: &Path,
    measured: &Measurement,
    method: Method,
    args: &NeedleArgs,
    robot: Option<&[[f64; 4]; 4]>,
    provenance: Option<ScanProvenance>,
    times: &Times,
    begun: Instant,
) -> anyhow::Result<ResultFile> {
    let source = args.settings().1;
    let mut result = ResultFile::new(measured, "cloud.ply", source, method, robot);
    result.provenance = provenance;
    times.time(Stage::Write, || -> anyhow::Result<()> {
        Ok(write_cloud(folder, &measured.cloud, args)?)
    })?;
    result.seconds = seconds(times, begun);
    // The result last: where it stands, all else stands.
    write_json(&folder.join("result.json"), &result)?;
    Ok(result)
}

/// Writes cloud.ply, and cloud.xyz and cloud.csv where asked for.
pub fn write_cloud(
    folder: &Path,
    points: &[crate::cloud::CloudPoint],
    args: &NeedleArgs,
) -> Result<(), OutputError> {
    use crate::cloud::{write_csv, write_ply, write_xyz};
    let comment = format!("cannula {}", env!("CARGO_PKG_VERSION"));
    write_whole(&folder.join("cloud.ply"), |w| {
        write_ply(w, points, &comment)
    })?;
    if args.xyz {
        write_whole(&folder.join("cloud.xyz"), |w| write_xyz(w, points))?;
    }
    if args.csv {
        write_whole(&folder.join("cloud.csv"), |w| write_csv(w, points))?;
    }
    Ok(())
}

/// Adds to a measurement's warnings what speaks against the calibration that it was made with: its
/// age, how loose it is, what it said itself. What this run has already said (a calibration made
/// since `begun`) is not said again on the terminal.
pub fn doubt(calibration: &CalibrationFile, m: &mut Measurement, begun: Instant, out: &Output) {
    let now = jiff::Timestamp::now();
    let fresh = age(calibration).is_some_and(|then| {
        now.duration_since(then).as_secs_f64() <= begun.elapsed().as_secs_f64() + 1.0
    });
    let u = &m.decision.uncertainty;
    let here = loose_here(u.entry_parts_mm[0], u.angle_parts[0]);
    let mut doubts: Vec<String> = here.iter().map(Doubt::sentence).collect();
    for words in &doubts {
        out.warn(words);
    }
    for words in doubts_of(calibration, now).iter().map(Doubt::sentence) {
        if !fresh {
            out.warn(&words);
        }
        doubts.push(words);
    }
    m.warnings.extend(doubts);
}

/// Writes report.html of a measured hand into `folder`; `calibrated` if the calibration was made in
/// the same run (its residuals are then shown corner by corner), `truth` on a simulated rig.
#[allow(clippy::too_many_arguments)]
pub fn write_report(
    session: &Session,
    calibrated: Option<&Calibrated>,
    calibration: &CalibrationFile,
    measured: &Measurement,
    method: Method,
    args: &NeedleArgs,
    truth: Vec<report::TruthRow>,
    times: &Times,
    folder: &Path,
) -> anyhow::Result<()> {
    let (settings, source) = args.settings();
    let page = report::assemble(report::Sources {
        session,
        calibrated,
        calibration,
        outcome: report::Outcome::Measured(measured),
        angle_source: source.words(),
        settings: report::settings(method, &settings),
        puncture: Some(report::decided(
            &crate::puncture::default_decision(),
            &crate::puncture::tissue::Setup::default(),
        )),
        truth,
        times,
    })?;
    Ok(report::write(&page, &folder.join("report.html"))?)
}

/// Writes a report that says why there is no angle, and shows what there is. The error itself goes
/// on to the user.
#[allow(clippy::too_many_arguments)]
pub fn report_refusal(
    session: &Session,
    calibrated: Option<&Calibrated>,
    calibration: &CalibrationFile,
    error: &anyhow::Error,
    method: Method,
    args: &NeedleArgs,
    times: &Times,
    folder: &Path,
) -> anyhow::Result<()> {
    // Only what the gates refuse: a file that can't be read leaves nothing to show.
    let Some(PipelineError::Needle { source, .. }) = error.downcast_ref() else {
        return Ok(());
    };
    let (settings, words) = args.settings();
    let mut reasons = vec![source.to_string()];
    if folder.join("result.json").exists() {
        reasons.push(
            "result.json and cloud.ply in this folder are of an earlier run: do not use them"
                .to_owned(),
        );
    }
    let page = report::assemble(report::Sources {
        session,
        calibrated,
        calibration,
        outcome: report::Outcome::Refused(reasons),
        angle_source: words.words(),
        settings: report::settings(method, &settings),
        puncture: None,
        truth: Vec::new(),
        times,
    })?;
    Ok(report::write(&page, &folder.join("report.html"))?)
}

/// Seconds a stage (summed over threads), and of the clock on the wall.
fn seconds(times: &Times, begun: Instant) -> std::collections::BTreeMap<String, f64> {
    let stages = times.seconds().into_iter();
    let mut all: std::collections::BTreeMap<String, f64> =
        stages.map(|(name, s)| (name.to_owned(), s)).collect();
    all.insert("wall".to_owned(), begun.elapsed().as_secs_f64());
    all
}
