//! `cannula uf2 ELF OUT`: the board's program as a file to drop on its boot drive.

use super::Output;
use crate::uf2;
use anyhow::Context;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The program as cargo built it: target/…/firmware/motion-board.
    elf: PathBuf,
    /// The file to write, .uf2.
    out: PathBuf,
    /// For the Pico 2 (RP2350) instead of the Pico (RP2040).
    #[arg(long)]
    pico2: bool,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let elf = std::fs::read(&args.elf)
        .with_context(|| format!("{} cannot be read", args.elf.display()))?;
    let family = if args.pico2 {
        uf2::FAMILY_RP2350_ARM_S
    } else {
        uf2::FAMILY_RP2040
    };
    let image = uf2::from_elf(&elf, family).with_context(|| args.elf.display().to_string())?;
    std::fs::write(&args.out, &image)
        .with_context(|| format!("{} cannot be written", args.out.display()))?;
    out.detail(&format!(
        "{}: {} pages",
        args.out.display(),
        image.len() / 512
    ));
    Ok(())
}
