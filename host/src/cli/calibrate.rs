//! `cannula calibrate SESSION --out FILE`: camera and light planes from a recording.

use super::Output;
use super::job::{MethodName, calibration_text};
use crate::output::{CalibrationFile, moment, read_calibration, write_json};
use crate::pipeline::{Stage, Times, calibrate};
use crate::report;
use crate::session::Session;
use std::path::{Path, PathBuf};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// The calibration to write; its report stands beside it, as .html.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Which way to calibrate.
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let session = Session::open(&args.session)?;
    let times = Times::default();
    let method = args.method.into();
    let page = page_beside(&args.out);
    let report = |file: &CalibrationFile, refused: Vec<String>| -> anyhow::Result<()> {
        let mut settings = report::calibration_settings(method);
        let made = file.provenance.as_ref().and_then(|p| p.recording.as_ref());
        settings.extend(made.iter().flat_map(|r| report::under("recording", r)));
        let sources = report::Sources {
            session: &session,
            calibration: file,
            simulated: false,
            outcome: report::Outcome::Calibrated(refused),
            angle_source: "",
            settings,
            puncture: None,
            truth: Vec::new(),
            times: &times,
        };
        Ok(report::write(&report::assemble(sources)?, &page)?)
    };
    let calibrated = calibrate(&session, method, &times, out).inspect_err(|e| {
        // What there is, so that one sees why.
        let Some(found) = e.calibrated() else { return };
        let reasons = [Some(e.to_string()), earlier(&args.out)];
        let reasons = reasons.into_iter().flatten().collect();
        match report(&CalibrationFile::new(found, &session), reasons) {
            Ok(()) => out.say(&format!("why, to be seen: {}", page.display())),
            Err(e) => out.error(&e),
        }
    })?;
    let file = CalibrationFile::new(&calibrated, &session);
    times.time(Stage::Write, || write_json(&args.out, &file))?;
    report(&file, Vec::new())?;
    out.result(&file, || {
        format!(
            "{}\nwritten: {}, {}",
            calibration_text(&calibrated),
            args.out.display(),
            page.display()
        )
    })
}

/// Where a calibration stands that this run does not replace: it must not be taken for this
/// recording's.
fn earlier(file: &Path) -> Option<String> {
    let written = std::fs::metadata(file).ok()?.modified().ok();
    let said = read_calibration(file).ok().and_then(|f| f.provenance);
    let (time, session) = match said {
        Some(p) => (
            p.time.and_then(|t| t.parse().ok()),
            format!(", from the recording {}", p.session),
        ),
        None => (None, String::new()),
    };
    let time: Option<jiff::Timestamp> = time.or_else(|| written?.try_into().ok());
    let of = time.map_or(String::new(), |t| format!(" of {}", moment(t)));
    Some(format!(
        "{}{of} is an earlier run's calibration{session}: it was not replaced, and this page is not about it",
        file.display()
    ))
}

/// The report's place beside the calibration: its name with .html.
fn page_beside(file: &Path) -> PathBuf {
    let page = file.with_extension("html");
    if page == file {
        return file.with_extension("report.html");
    }
    page
}
