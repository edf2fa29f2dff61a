//! `report.html` of a processed recording.

use super::model::{Puncture, Report, TruthRow, Verdict};
use super::sources;
use crate::checks::{self, Check};
use crate::output::{CalibrationFile, OutputError, all_checks, moment, write_whole};
use crate::pipeline::{Measurement, Scanned, Times};
use crate::session::{Session, SessionError};
use std::path::Path;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// An image that it shows can't be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The file can't be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// What came of the measurement.
#[derive(Debug)]
pub enum Outcome<'a> {
    /// The measured hand.
    Measured(&'a Measurement),
    /// No angle is given: why, and what was scanned all the same.
    Refused(Vec<String>, Option<&'a Scanned>),
    /// No hand was to be measured: the calibration alone, and why it is refused if it is.
    Calibrated(Vec<String>),
}

impl Outcome<'_> {
    pub(super) fn measured(&self) -> Option<&Measurement> {
        match self {
            Self::Measured(m) => Some(m),
            _ => None,
        }
    }

    /// What was scanned where no angle is given.
    pub(super) fn scanned(&self) -> Option<&Scanned> {
        match self {
            Self::Refused(_, scanned) => *scanned,
            _ => None,
        }
    }
}

/// What a report is made of. `cannula process`, `angle`, `demo` and `scan` fill it alike.
#[derive(Debug)]
pub struct Sources<'a> {
    /// The recording.
    pub session: &'a Session,
    /// The calibration's file, whose camera measured.
    pub calibration: &'a CalibrationFile,
    /// Whether the images are rendered ones, as far as that is known.
    pub simulated: bool,
    /// The measured hand, or why there is none.
    pub outcome: Outcome<'a>,
    /// Where the angle comes from, in words.
    pub angle_source: &'a str,
    /// Name and value of settings and thresholds.
    pub settings: Vec<(String, String)>,
    /// Force curves and decision.
    pub puncture: Option<Puncture>,
    /// Errors against the truth of a simulated rig.
    pub truth: Vec<TruthRow>,
    /// Time per stage.
    pub times: &'a Times,
}

/// The report's data.
///
/// # Errors
/// An image that can't be read.
pub fn assemble(s: Sources) -> Result<Report, ReportError> {
    let folder = s.session.folder();
    let robot = s.session.manifest.robot_from_camera.as_ref();
    let camera = s.calibration.camera();
    let measured = s.outcome.measured();
    let scan = s.session.manifest.recorded.scan();
    let now = jiff::Timestamp::now();
    let of_calibration = || all_checks(s.calibration, scan, now, None);
    // One list: the verdict, the warnings and the calibration's findings are read off it.
    let (checks, reasons): (Vec<Check>, &[String]) = match &s.outcome {
        Outcome::Measured(m) => (m.checks.clone(), &[]),
        Outcome::Refused(reasons, scanned) => {
            // A refusal is the calibration's own where nothing was scanned with it.
            let part = match scanned {
                Some(_) => "needle",
                None => CALIBRATION,
            };
            let scanned = scanned.iter().flat_map(|s| s.checks.iter().cloned());
            let calibration = of_calibration();
            // What the calibration's own checks refuse stands among them.
            let told = checks::refused_sentences(&calibration);
            let first = reasons.first().filter(|r| !told.contains(r));
            let checks = refusals(part, first.map_or(&[], std::slice::from_ref));
            (checks.chain(scanned).chain(calibration).collect(), reasons)
        }
        Outcome::Calibrated(refused) => {
            let checks = refusals(CALIBRATION, refused.get(..1).unwrap_or_default());
            (checks.chain(of_calibration()).collect(), refused)
        }
    };
    let verdict = Verdict {
        usable: checks.iter().all(|c| c.outcome != checks::Outcome::Refused),
        reasons: match reasons {
            [] => checks::refused_sentences(&checks),
            reasons => reasons.to_vec(),
        },
        warnings: checks
            .iter()
            .filter(|c| c.outcome != checks::Outcome::Refused)
            .filter_map(Check::sentence)
            .collect(),
    };
    let calibrations: Vec<Check> = checks
        .iter()
        .filter(|c| c.part == CALIBRATION)
        .cloned()
        .collect();
    let alone = matches!(s.outcome, Outcome::Calibrated(_));
    let headline = match &s.outcome {
        Outcome::Refused(..) => "No angle",
        Outcome::Calibrated(refused) if !refused.is_empty() => "No calibration",
        _ => "",
    };
    let ambient = match alone {
        true => None,
        false => sources::ambient(s.session, s.times)?,
    };
    let ambient = ambient.as_ref();
    let axis = s.calibration.rig().map(|rig| rig.stripe_axis());
    let axis = axis.unwrap_or_default();
    Ok(Report {
        title: title(&s),
        headline: headline.to_owned(),
        verdict: Some(verdict),
        needle: measured.map(|m| sources::needle(m, s.angle_source, robot)),
        picture: match alone {
            true => None,
            false => sources::picture(s.session, ambient, &s.outcome, &camera, s.times)?,
        },
        scene: measured.map(sources::scene).or_else(|| {
            let scanned = s.outcome.scanned()?;
            sources::scene_refused(scanned, &camera)
        }),
        calibration: Some(sources::calibration(s.calibration, &calibrations, scan)),
        checks,
        stripes: match alone {
            true => Vec::new(),
            false => sources::stripes(s.session, ambient, measured, axis, s.times)?,
        },
        puncture: s.puncture,
        truth: s.truth,
        provenance: sources::provenance(&folder.display().to_string(), s.settings, s.times),
    })
}

/// The part whose checks stand in the calibration's section too.
const CALIBRATION: &str = "calibration";

/// What refuses, as checks.
fn refusals<'a>(part: &'a str, reasons: &'a [String]) -> impl Iterator<Item = Check> + 'a {
    let refused = move |words: &String| Check::refusal(format!("{part}: refused"), words);
    checks::of(part, reasons.iter().map(refused))
}

/// What the report is about: which hand, when, where recorded.
fn title(s: &Sources) -> String {
    let recorded = &s.session.manifest.recorded;
    let (what, time) = match s.outcome {
        Outcome::Calibrated(_) => ("Calibration: board views", recorded.board.as_ref()),
        _ => ("Needle insertion: hand scan", recorded.scan.as_ref()),
    };
    let what = match s.simulated {
        true => format!("Simulated, no real hand. {what}"),
        false => what.to_owned(),
    };
    let date = time
        .and_then(|t| t.parse().ok())
        .map_or(String::new(), |t| format!(" of {}", moment(t)));
    format!("{what}{date}, session {}", s.session.name())
}

/// The report of `cannula puncture`.
pub fn of_puncture(section: Puncture, settings: Vec<(String, String)>, times: &Times) -> Report {
    Report {
        title: "Puncture: force on the needle at each angle".to_owned(),
        puncture: Some(section),
        provenance: sources::provenance("", settings, times),
        ..Report::default()
    }
}

/// Writes the page, whole or not at all.
///
/// # Errors
/// The file can't be written.
pub fn write(report: &Report, path: &Path) -> Result<(), ReportError> {
    let page = super::render(report);
    write_whole(path, |w| w.write_all(page.as_bytes()))?;
    Ok(())
}
