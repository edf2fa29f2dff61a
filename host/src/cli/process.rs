//! `cannula process SESSION --out DIR`: calibration, angle and the report in one go.

use super::Output;
use super::job::{Job, MethodName, NeedleArgs, calibration_text, measurement_text, needs_scan};
use crate::output::{CalibrationFile, ScanProvenance, write_json};
use crate::pipeline::{Stage, Times, calibrate};
use crate::session::Session;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// The folder to write into.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Which way to work.
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    #[command(flatten)]
    needle: NeedleArgs,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let begun = Instant::now();
    let times = Times::default();
    let session = Session::open(&args.session)?;
    needs_scan(&session)?;
    if session.manifest.light.is_empty() {
        let remedy =
            "record the board with the laser on it, or use `cannula angle` with a calibration";
        return Err(session.missing("light", remedy).into());
    }
    let method = args.method.into();
    let calibrated = calibrate(&session, method, &times, out);
    // What a gate refuses is shown all the same.
    let calibration = match &calibrated {
        Ok(found) => Some(CalibrationFile::new(found, &session)),
        Err(e) => e.calibrated().map(|c| CalibrationFile::new(c, &session)),
    };
    let Some(calibration) = calibration else {
        return calibrated.map(|_| ()).map_err(anyhow::Error::from);
    };
    let job = Job {
        session: &session,
        calibration: &calibration,
        method,
        args: &args.needle,
        folder: &args.out,
        provenance: ScanProvenance::now(None, None),
        times: &times,
        begun,
        out,
    };
    let calibrated = calibrated.map_err(|e| job.refused(e.into()))?;
    times.time(Stage::Write, || {
        write_json(&args.out.join("calibration.json"), &calibration)
    })?;
    let (result, measured) = job.run(|_| Vec::new())?;
    out.result(&result, || {
        format!(
            "{}\n{}\nwritten: {}",
            calibration_text(&calibrated),
            measurement_text(&measured),
            args.out.display()
        )
    })
}
