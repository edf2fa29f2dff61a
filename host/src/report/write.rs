//! `report.html` of a processed recording.

use super::model::{Puncture, Report, TruthRow, Verdict};
use super::sources;
use crate::output::{CalibrationFile, OutputError, write_whole};
use crate::pipeline::{Calibrated, Measurement, Times};
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
    /// No angle is given, and why.
    Refused(Vec<String>),
}

/// What a report is made of. `cannula process`, `angle`, `demo` and `scan` fill it alike.
#[derive(Debug)]
pub struct Sources<'a> {
    /// The recording.
    pub session: &'a Session,
    /// Its calibration with all residuals, if it was made in the same run.
    pub calibrated: Option<&'a Calibrated>,
    /// The calibration's file, whose camera measured.
    pub calibration: &'a CalibrationFile,
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
    let folder = s.session.file().parent().unwrap_or(Path::new("."));
    let title = folder
        .canonicalize()
        .ok()
        .and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()))
        .unwrap_or_else(|| folder.display().to_string());
    let robot = s.session.manifest.robot_from_camera.as_ref();
    let measured = match &s.outcome {
        Outcome::Measured(m) => Some(*m),
        Outcome::Refused(_) => None,
    };
    let verdict = match &s.outcome {
        Outcome::Measured(m) => sources::verdict(m),
        Outcome::Refused(reasons) => Verdict {
            usable: false,
            reasons: reasons.clone(),
            warnings: s.calibration.warnings.clone(),
        },
    };
    Ok(Report {
        title,
        verdict: Some(verdict),
        needle: measured.map(|m| sources::needle(m, s.angle_source, robot)),
        picture: sources::picture(s.session, measured, &s.calibration.camera())?,
        scene: measured.map(sources::scene),
        calibration: Some(match s.calibrated {
            Some(c) => sources::calibration(c),
            None => sources::of_file(s.calibration),
        }),
        stripes: sources::stripes(s.session, measured)?,
        puncture: s.puncture,
        truth: s.truth,
        provenance: sources::provenance(&folder.display().to_string(), s.settings, s.times),
    })
}

/// The report of `cannula puncture`.
pub fn of_puncture(section: Puncture, settings: Vec<(String, String)>) -> Report {
    Report {
        title: "puncture".to_owned(),
        puncture: Some(section),
        provenance: sources::provenance("", settings, &Times::default()),
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
