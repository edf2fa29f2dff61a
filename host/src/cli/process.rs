//! `cannula process SESSION --out DIR`: calibration, angle and the report in one go.

use super::Output;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// What to write.
    #[arg(long)]
    out: PathBuf,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let session = crate::session::Session::open(&args.session)?;
    out.detail(&format!("{} images", session.manifest.images().count()));
    anyhow::bail!("{}: not written", args.out.display())
}
