//! `cannula angle SESSION --calibration FILE --out DIR`: cloud, plane, angle and needle axis.

use super::Output;
use super::job::{Job, MethodName, NeedleArgs, measurement_text, needs_scan};
use crate::output::{ScanProvenance, read_calibration};
use crate::pipeline::Times;
use crate::session::Session;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// The rig's calibration.
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The folder to write into.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Which way to measure.
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    #[command(flatten)]
    needle: NeedleArgs,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let begun = Instant::now();
    let session = Session::open(&args.session)?;
    needs_scan(&session)?;
    let calibration = read_calibration(&args.calibration)?;
    if calibration.light.is_none() {
        anyhow::bail!(
            "{}: no light planes in it; calibrate with a session that has \"light\"",
            args.calibration.display()
        );
    }
    let job = Job {
        session: &session,
        calibration: &calibration,
        method: args.method.into(),
        args: &args.needle,
        folder: &args.out,
        provenance: ScanProvenance::now(Some((&args.calibration, &calibration)), None),
        times: &Times::default(),
        begun,
        out,
    };
    let (result, measured) = job.run(|_| Vec::new())?;
    out.result(&result, || {
        format!(
            "{}\nwritten: {}",
            measurement_text(&measured),
            args.out.display()
        )
    })
}
