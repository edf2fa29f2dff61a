//! What `calibrate`, `angle` and `process` share: arguments, writing, the summary.

use super::Output;
use super::puncture::SIMULATED_DEG;
pub use super::summary::{calibration as calibration_text, measurement as measurement_text};
use crate::checks::{Check, Outcome, of, refused_sentences};
use crate::needle;
use crate::output::{
    AngleSource, CalibrationFile, OutputError, ResultFile, ScanProvenance, all_checks, write_json,
    write_whole,
};
use crate::pipeline::{Measurement, Method, PipelineError, Scanned, Stage, Times, measure};
use crate::progress::Progress;
use crate::report;
use crate::rig::config::CameraKind;
use crate::session::{Session, SessionError};
use clap::ValueEnum;
use std::path::{Path, PathBuf};
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
    /// Simulate the puncture at 30, 45 and 60° and at a given angle for the report instead of drawing
    /// the fast model's curves: about 4 s an angle on two idle cores, up to 20 s on a busy or an older
    /// machine; a bar shows how far it is.
    #[arg(long)]
    puncture: bool,
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

/// The checks of the angle. What the puncture model says of it goes wherever the angle goes, whoever
/// chose it: it may leave the clinical 15–30° or go through the far wall. One sentence says it all.
fn angle_checks(source: AngleSource, angle_deg: f64) -> Vec<Check> {
    let setup = crate::puncture::Setup::default();
    let mut checks = crate::puncture::decision::checks(&setup, angle_deg);
    let words = match source {
        AngleSource::Puncture => {
            let decision = crate::puncture::default_decision();
            checks.push(Check::is(
                "needle angle: forces differ by more than the model’s error",
                decision.preference,
            ));
            Some(decision.sentence)
        }
        AngleSource::CommandLine | AngleSource::Default => {
            crate::puncture::decision::against(&setup, angle_deg)
        }
    };
    for check in &mut checks {
        check.words.clear();
    }
    if let Some(first) = checks.iter_mut().find(|c| !c.sound()) {
        first.words = words.unwrap_or_default();
    }
    checks
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

/// A hand was measured, and what measured it is not to be trusted: no angle is given.
#[derive(Debug, thiserror::Error)]
#[error("{}: {}", file.display(), reasons.join("; "))]
struct NotUsable {
    /// The calibration, or the recording that it is of.
    file: PathBuf,
    reasons: Vec<String>,
    scanned: Scanned,
}

/// A hand to be measured: what with, how, and where the results go.
pub struct Job<'a> {
    /// The recording.
    pub session: &'a Session,
    /// The rig's calibration.
    pub calibration: &'a CalibrationFile,
    /// Which way to measure.
    pub method: Method,
    /// What is asked of the needle.
    pub args: &'a NeedleArgs,
    /// The folder to write into.
    pub folder: &'a Path,
    /// What it is measured with.
    pub provenance: ScanProvenance,
    /// Where the time went.
    pub times: &'a Times,
    /// When the command began.
    pub begun: Instant,
    /// Where to speak.
    pub out: &'a Output,
}

impl Job<'_> {
    /// Measures the hand and writes cloud, result and report; where no angle is given, the cloud and
    /// a report that shows why. `truth` gives the errors of a simulated rig.
    pub fn run(
        &self,
        truth: impl FnOnce(&Measurement) -> Vec<report::TruthRow>,
    ) -> anyhow::Result<(ResultFile, Measurement)> {
        let rig = self.calibration.rig().ok_or_else(|| {
            anyhow::anyhow!(
                "{}: no light planes in this calibration; calibrate with a session that has \"light\"",
                self.session.file().display()
            )
        })?;
        let settings = self.args.settings().0;
        let positions = self.calibration.positions();
        let (session, times) = (self.session, self.times);
        let mut measured = measure(
            session,
            &rig,
            &positions,
            self.method,
            &settings,
            times,
            self.out,
        )
        .map_err(|e| self.refused(e.into()))?;
        self.weigh(&mut measured).map_err(|e| self.refused(e))?;
        let result = self.write(&measured)?;
        self.report(&measured, truth(&measured))?;
        self.out.detail(&super::summary::times(times));
        if self.out.verbose > 1 {
            for (name, value) in report::settings(self.method, &settings) {
                self.out.detail(&format!("{name}: {value}"));
            }
        }
        Ok((result, measured))
    }

    /// Adds to a measurement's checks those of the calibration that it was made with (its age, how
    /// loose it is, what it said itself), of the region and of the angle, and says what is weak, in the
    /// scan too. What this run has already said (a calibration made since it began) is not said again
    /// on the terminal.
    ///
    /// # Errors
    /// What refuses the result, for [`Self::refused`].
    pub fn weigh(&self, m: &mut Measurement) -> anyhow::Result<()> {
        let now = jiff::Timestamp::now();
        let made = self
            .calibration
            .provenance
            .as_ref()
            .and_then(|p| p.time.as_ref());
        let fresh = made
            .and_then(|t| t.parse::<jiff::Timestamp>().ok())
            .is_some_and(|then| {
                now.duration_since(then).as_secs_f64() <= self.begun.elapsed().as_secs_f64() + 1.0
            });
        let scan = self.session.manifest.recorded.scan();
        let mut checks = all_checks(self.calibration, scan, now, Some(&m.decision.uncertainty));
        if self.provenance.rig.is_some() {
            let real = !self.simulated();
            checks.extend(of(
                "rig",
                [Check::is("camera: a real one", real).or(|| {
                    let words =
                        "the camera is a simulated one (camera.kind): this hand is rendered";
                    (words.to_owned(), String::new())
                })],
            ));
        }
        checks.extend(of("needle", m.decision.checks.iter().cloned()));
        let (settings, source) = self.args.settings();
        let given = self.args.needle_angle;
        let angle = given.unwrap_or(settings.angle.to_degrees());
        checks.extend(of("needle", angle_checks(source, angle)));
        let reasons = refused_sentences(&checks);
        let of_angle = |c: &&Check| c.part == "needle" && c.what.starts_with("needle angle");
        let all = m.checks.iter().chain(&checks);
        let all = all.filter(|c| !(fresh && c.said));
        // Without an angle nothing is to be said of it.
        self.say(all.filter(|c| reasons.is_empty() || !of_angle(c)));
        if !reasons.is_empty() {
            let given = self.provenance.calibration.as_ref();
            // The report adds the calibration's own.
            let of_needle = checks.iter().filter(|c| c.part == "needle" && !of_angle(c));
            return Err(anyhow::Error::new(NotUsable {
                file: given.map_or_else(|| self.session.file().to_owned(), |c| c.file.clone()),
                reasons,
                scanned: Scanned {
                    cloud: std::mem::take(&mut m.cloud),
                    request: m.request.clone(),
                    checks: m.checks.iter().chain(of_needle).cloned().collect(),
                },
            }));
        }
        m.checks.extend(checks);
        Ok(())
    }

    /// Says what is weak.
    fn say<'c>(&self, checks: impl Iterator<Item = &'c Check>) {
        let weak = checks.filter(|c| c.outcome != Outcome::Refused);
        weak.filter_map(Check::sentence)
            .for_each(|words| self.out.warn(&words));
    }

    /// Writes cloud and result of a measurement.
    pub fn write(&self, measured: &Measurement) -> anyhow::Result<ResultFile> {
        for words in self.put_aside(&self.clouds_not_asked_for())? {
            self.out.warn(&words);
        }
        let source = self.args.settings().1;
        let robot = self.session.manifest.robot_from_camera.as_ref();
        let mut result = ResultFile::new(measured, "cloud.ply", source, self.method, robot);
        self.times.time(Stage::Write, || {
            write_cloud(self.folder, &measured.cloud, self.args)
        })?;
        result.provenance = Some(self.measured_with()?);
        result.seconds = seconds(self.times, self.begun);
        // The result last: where it stands, all else stands.
        write_json(&self.folder.join("result.json"), &result)?;
        Ok(result)
    }

    /// Whether the camera is a simulated one, where the rig is known.
    fn simulated(&self) -> bool {
        let rig = self.provenance.rig.as_ref();
        rig.is_some_and(|r| r.camera.kind == CameraKind::Simulated)
    }

    /// What it is measured with, the recording told by its digest: the scan's images, and the
    /// board's where the calibration was made in the same run.
    fn measured_with(&self) -> Result<ScanProvenance, SessionError> {
        let manifest = &self.session.manifest;
        let recording = match self.provenance.calibration {
            None => self.session.digest(manifest.images())?,
            Some(_) => self.session.digest(manifest.scan_images())?,
        };
        Ok(ScanProvenance {
            recording: Some(recording),
            ..self.provenance.clone()
        })
    }

    /// Writes report.html of a measured hand.
    pub fn report(
        &self,
        measured: &Measurement,
        truth: Vec<report::TruthRow>,
    ) -> anyhow::Result<()> {
        let setup = crate::puncture::Setup::default();
        let decision = crate::puncture::default_decision();
        let given = self.args.needle_angle;
        let mut section = report::decided(&decision, &setup, given);
        if self.args.puncture {
            // The given angle too, where the reference can.
            let simulated = section.runs.iter().map(|r| r.angle_deg);
            let simulated = simulated.filter(|a| SIMULATED_DEG.contains(a));
            let angles: Vec<f64> = simulated.collect();
            let numerics = crate::puncture::Numerics::default();
            let criterion = decision.criterion;
            let found = self.times.time(Stage::Puncture, || {
                super::puncture::simulate(&setup, &angles, &numerics, criterion, self.out)
            })?;
            report::with_reference(&mut section, &found);
            section.settings = report::under("force curves", &numerics);
        }
        let outcome = report::Outcome::Measured(measured);
        self.assemble(outcome, Some(section), truth)
    }

    /// Writes what there is where no angle is given (what the gates refuse): the cloud and a report
    /// that says why. A file that can't be read leaves nothing to show. Gives the error back for the
    /// user.
    pub fn refused(&self, error: anyhow::Error) -> anyhow::Error {
        let (reasons, scanned) = match (error.downcast_ref(), error.downcast_ref::<NotUsable>()) {
            (
                Some(PipelineError::Needle {
                    source, scanned, ..
                }),
                _,
            ) => {
                self.say(scanned.checks.iter());
                (vec![source.to_string()], Some(scanned.as_ref()))
            }
            (_, Some(e)) => (e.reasons.clone(), Some(&e.scanned)),
            (Some(e), _) if e.calibrated().is_some() => (vec![e.to_string()], None),
            _ => {
                // Nobody may take an earlier run's needle for this hand's.
                let stale = ["result.json", "report.html"].iter().chain(&CLOUDS);
                match self.put_aside(&stale.copied().collect::<Vec<_>>()) {
                    Ok(said) => said.iter().for_each(|words| self.out.warn(words)),
                    Err(e) => self.out.error(&e.into()),
                }
                return error;
            }
        };
        if let Err(e) = self.write_refused(reasons, scanned) {
            self.out.error(&e);
        }
        error
    }

    fn write_refused(
        &self,
        mut reasons: Vec<String>,
        scanned: Option<&Scanned>,
    ) -> anyhow::Result<()> {
        let mut stale = vec!["result.json"];
        match scanned {
            Some(_) => stale.extend(self.clouds_not_asked_for()),
            None => stale.extend(CLOUDS),
        }
        // A calibration that was refused in this run: an earlier one is not of this recording.
        if scanned.is_none() && self.provenance.calibration.is_none() {
            stale.push("calibration.json");
        }
        for words in self.put_aside(&stale)? {
            self.out.warn(&words);
            reasons.push(words);
        }
        if let Some(s) = scanned {
            write_cloud(self.folder, &s.cloud, self.args)?;
        }
        let outcome = report::Outcome::Refused(reasons, scanned);
        self.assemble(outcome, None, Vec::new())?;
        let page = self.folder.join("report.html");
        self.out
            .say(&format!("why, to be seen: {}", page.display()));
        Ok(())
    }

    /// The clouds that this run does not write.
    fn clouds_not_asked_for(&self) -> Vec<&'static str> {
        let asked = [true, self.args.xyz, self.args.csv];
        let clouds = CLOUDS.into_iter().zip(asked);
        clouds.filter(|c| !c.1).map(|c| c.0).collect()
    }

    /// Renames what an earlier run has left in the folder, so that nobody takes it for this run's;
    /// says so, a sentence for each.
    fn put_aside(&self, files: &[&str]) -> std::io::Result<Vec<String>> {
        let mut said = Vec::new();
        for file in files {
            let path = self.folder.join(file);
            if !path.exists() {
                continue;
            }
            let (stem, extension) = file.rsplit_once('.').unwrap_or((file, ""));
            let aside = format!("{stem}-before.{extension}");
            std::fs::rename(&path, self.folder.join(&aside))?;
            said.push(format!(
                "{file} of an earlier run in this folder was put aside as {aside}: it is not this one's"
            ));
        }
        Ok(said)
    }

    fn assemble(
        &self,
        outcome: report::Outcome,
        puncture: Option<report::Puncture>,
        truth: Vec<report::TruthRow>,
    ) -> anyhow::Result<()> {
        let (settings, source) = self.args.settings();
        let mut rows = report::settings(self.method, &settings);
        let measured_with = report::leaves(&self.measured_with()?).into_iter();
        rows.extend(
            measured_with.filter(|(name, _)| !["program", "time"].contains(&name.as_str())),
        );
        rows.extend(puncture.iter().flat_map(|p| p.settings.iter().cloned()));
        let page = report::assemble(report::Sources {
            session: self.session,
            calibration: self.calibration,
            // A recording that has its truth beside it was rendered.
            simulated: self.simulated() || self.session.path("truth.json").exists(),
            outcome,
            angle_source: source.words(),
            settings: rows,
            puncture,
            truth,
            times: self.times,
        })?;
        Ok(report::write(&page, &self.folder.join("report.html"))?)
    }
}

/// The files of a cloud.
const CLOUDS: [&str; 3] = ["cloud.ply", "cloud.xyz", "cloud.csv"];

/// Writes cloud.ply, and cloud.xyz and cloud.csv where asked for.
fn write_cloud(
    folder: &Path,
    points: &[crate::cloud::CloudPoint],
    args: &NeedleArgs,
) -> Result<(), OutputError> {
    use crate::cloud::{write_csv, write_ply, write_xyz};
    write_whole(&folder.join("cloud.ply"), |w| {
        write_ply(w, points, crate::PROGRAM)
    })?;
    if args.xyz {
        write_whole(&folder.join("cloud.xyz"), |w| write_xyz(w, points))?;
    }
    if args.csv {
        write_whole(&folder.join("cloud.csv"), |w| write_csv(w, points))?;
    }
    Ok(())
}

/// Seconds a stage (summed over threads), and of the clock on the wall.
fn seconds(times: &Times, begun: Instant) -> std::collections::BTreeMap<String, f64> {
    let stages = times.seconds().into_iter();
    let mut all: std::collections::BTreeMap<String, f64> =
        stages.map(|(name, s)| (name.to_owned(), s)).collect();
    all.insert("wall".to_owned(), begun.elapsed().as_secs_f64());
    all
}
