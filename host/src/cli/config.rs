//! `cannula config`: the rig's configuration file, an example of it, and whether one is right.

use super::Output;
use crate::rig::config::{EXAMPLE, Rig};
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
#[group(required = true, multiple = false)]
pub struct Args {
    /// Print a configuration with every key, its meaning and its default.
    #[arg(long)]
    example: bool,
    /// Check a configuration.
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let rig = match &args.file {
        Some(path) => Rig::load(path)?,
        None => Rig::default(),
    };
    out.result(&rig, || match &args.file {
        Some(path) => format!("{}: sound", path.display()),
        None => EXAMPLE.trim_end().to_owned(),
    })
}
