//! `report.html` of a processed recording.

use super::model::{Calibration, Puncture, Report, TruthRow, Verdict};
use super::sources;
use crate::output::{CalibrationFile, Doubt, OutputError, all_doubts, moment, write_whole};
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
    let weak: Vec<String> = all_doubts(
        s.calibration,
        scan,
        jiff::Timestamp::now(),
        measured.map(|m| &m.decision.uncertainty),
    )
    .iter()
    .map(Doubt::sentence)
    .collect();
    let verdict = match &s.outcome {
        Outcome::Measured(m) => Some(sources::verdict(m)),
        Outcome::Refused(reasons, scanned) => Some(Verdict {
            usable: false,
            reasons: reasons.clone(),
            warnings: scanned
                .iter()
                .flat_map(|s| s.warnings.iter())
                .chain(&weak)
                .cloned()
                .collect(),
        }),
        Outcome::Calibrated(refused) => Some(Verdict {
            usable: refused.is_empty(),
            reasons: refused.clone(),
            warnings: weak.clone(),
        }),
    };
    let checked = sources::checked(s.calibration, measured.is_some());
    // A refusal is the calibration's own where nothing was scanned with it.
    let refusal = match &s.outcome {
        Outcome::Calibrated(refused) => refused.as_slice(),
        Outcome::Refused(reasons, None) => reasons.get(..1).unwrap_or_default(),
        _ => &[],
    };
    let findings = refusal.iter().cloned().chain(weak).collect();
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
    Ok(Report {
        title: title(&s),
        headline: headline.to_owned(),
        verdict,
        needle: measured.map(|m| sources::needle(m, s.angle_source, robot)),
        picture: match alone {
            true => None,
            false => sources::picture(s.session, ambient, &s.outcome, &camera, s.times)?,
        },
        scene: measured.map(sources::scene).or_else(|| {
            let scanned = s.outcome.scanned()?;
            sources::scene_refused(scanned, &camera)
        }),
        calibration: Some(Calibration {
            checked,
            ..sources::calibration(s.calibration, findings, scan)
        }),
        stripes: match alone {
            true => Vec::new(),
            false => sources::stripes(s.session, ambient, measured, s.times)?,
        },
        puncture: s.puncture,
        truth: s.truth,
        provenance: sources::provenance(&folder.display().to_string(), s.settings, s.times),
    })
}

/// What the report is about: which hand, when, where recorded.
fn title(s: &Sources) -> String {
    let recorded = &s.session.manifest.recorded;
    let (what, time) = match s.outcome {
        Outcome::Calibrated(_) => ("Calibration: board views", recorded.board.as_ref()),
        _ => ("Needle insertion: hand scan", recorded.scan.as_ref()),
    };
    let date = time
        .and_then(|t| t.parse().ok())
        .map_or(String::new(), |t| format!(" of {}", moment(t)));
    format!("{what}{date}, session {}", s.session.name())
}

/// The report of `cannula puncture`.
pub fn of_puncture(section: Puncture, settings: Vec<(String, String)>) -> Report {
    Report {
        title: "Puncture: force on the needle at each angle".to_owned(),
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
