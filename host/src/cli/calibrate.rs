//! `cannula calibrate SESSION --out FILE`: camera and light planes from a recording.

use super::Output;
use super::job::{MethodName, calibration_text};
use crate::output::{CalibrationFile, write_json};
use crate::pipeline::{Times, calibrate};
use crate::session::Session;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// The calibration to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Which way to calibrate.
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let session = Session::open(&args.session)?;
    let calibrated = calibrate(&session, args.method.into(), &Times::default(), out)?;
    let file = CalibrationFile::new(&calibrated, &args.session);
    write_json(&args.out, &file)?;
    out.result(&file, || {
        format!(
            "{}\nwritten: {}",
            calibration_text(&calibrated),
            args.out.display()
        )
    })
}
