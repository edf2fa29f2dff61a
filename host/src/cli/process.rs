//! `cannula process SESSION --out DIR`: calibration, angle and the report in one go.

use super::Output;
use super::job::{
    MethodName, NeedleArgs, calibration_text, measure_and_write, measurement_text, needs_scan,
    report_refusal, write_report,
};
use crate::output::{CalibrationFile, write_json};
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
    let calibrated = calibrate(&session, method, &times, out)?;
    let calibration = CalibrationFile::new(&calibrated, &args.session);
    times.time(Stage::Write, || {
        write_json(&args.out.join("calibration.json"), &calibration)
    })?;
    let (result, measured) = measure_and_write(
        &session,
        &calibration,
        method,
        &args.needle,
        &args.out,
        &times,
        begun,
        out,
    )
    .inspect_err(|e| {
        let told = report_refusal(
            &session,
            Some(&calibrated),
            &calibration,
            e,
            method,
            &args.needle,
            &times,
            &args.out,
        );
        if let Err(e) = told {
            out.error(&e);
        }
    })?;
    write_report(
        &session,
        Some(&calibrated),
        &calibration,
        &measured,
        method,
        &args.needle,
        Vec::new(),
        &times,
        &args.out,
    )?;
    out.result(&result, || {
        format!(
            "{}\n{}\nwritten: {}",
            calibration_text(&calibrated),
            measurement_text(&measured),
            args.out.display()
        )
    })
}
