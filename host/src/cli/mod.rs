//! The command line: one file per command, each with its `Args` and `run(args, &Output)`. This one
//! only lists them.
//!
//! Exit status 0 when the job is done, 2 for bad arguments, 1 for anything else with one sentence
//! on standard error. `--json` prints the result object to standard output, and nothing else there.

mod angle;
mod calibrate;
mod capture;
mod config;
mod demo;
mod doctor;
mod examples;
mod job;
mod live;
mod motion;
mod output;
mod plot;
mod ports;
mod process;
mod puncture;
mod replay;
mod rig;
mod scan;
mod shell;
mod simulate;
mod summary;
mod uf2;

pub use output::{BadArgument, Output};

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;

/// Laser-line scanner and needle-angle decision for venipuncture-robot research.
#[derive(Parser, Debug)]
#[command(name = "cannula", version = crate::VERSION, propagate_version = true)]
struct Cli {
    #[command(flatten)]
    global: output::Options,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Calibrate camera and light planes from a session.
    Calibrate(calibrate::Args),
    /// Cloud, plane, angle and needle axis from a session and a calibration.
    Angle(angle::Args),
    /// Calibrate and angle in one go, with the report.
    Process(process::Args),
    /// Force curves of the puncture per angle, and the decision.
    Puncture(puncture::Args),
    /// Charts for a paper or a talk, as SVG or PNG.
    Plot(plot::Args),
    /// The whole job on the simulated rig, from homing to the needle, with the errors.
    Demo(demo::Args),
    /// Record board poses for the camera, for the light planes, or a scan, step by step.
    Capture(capture::Args),
    /// Scan the hand and reconstruct while frames arrive.
    Scan(scan::Args),
    /// Play a recording through the acquisition as if it were live.
    Replay(replay::Args),
    /// Hands on the motion board: status, home, move, laser, trigger …
    Motion(motion::Args),
    /// The serial ports and the motion boards behind them.
    Ports(ports::Args),
    /// The rig's configuration: an example, or whether one is sound.
    Config(config::Args),
    /// The simulated rig: a recording with its truth, or a board behind a pseudo-terminal.
    Simulate(simulate::Args),
    /// The board's program as a file for its USB boot loader.
    Uf2(uf2::Args),
    /// Is everything fit for work: machine, board, camera, configuration, calibration.
    ///
    /// Nothing moves and the laser stays off; each finding comes with its remedy. Exit status 1 if
    /// something is wrong.
    Doctor(doctor::Args),
    /// Completions for a shell, on standard output.
    Completions(shell::CompletionArgs),
    /// The manual's pages.
    Man(shell::ManArgs),
}

/// The commands with their examples, as they are parsed, completed and described.
fn command() -> clap::Command {
    examples::add(Cli::command())
}

fn run(command: Command, out: &Output) -> anyhow::Result<()> {
    match command {
        Command::Calibrate(args) => calibrate::run(args, out),
        Command::Angle(args) => angle::run(args, out),
        Command::Process(args) => process::run(args, out),
        Command::Puncture(args) => puncture::run(args, out),
        Command::Plot(args) => plot::run(args, out),
        Command::Demo(args) => demo::run(args, out),
        Command::Capture(args) => capture::run(args, out),
        Command::Scan(args) => scan::run(args, out),
        Command::Replay(args) => replay::run(args, out),
        Command::Motion(args) => motion::run(args, out),
        Command::Ports(args) => ports::run(args, out),
        Command::Config(args) => config::run(args, out),
        Command::Simulate(args) => simulate::run(args, out),
        Command::Uf2(args) => uf2::run(args, out),
        Command::Doctor(args) => doctor::run(args, out),
        Command::Completions(args) => shell::completions(&args, out),
        Command::Man(args) => shell::man(&args, out),
    }
}

/// Runs the program with its arguments (the first is its name); gives the exit status.
pub fn main(args: impl IntoIterator<Item = OsString>) -> u8 {
    let parsed = command()
        .try_get_matches_from(args)
        .and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(e) => {
            // Help and version are no errors: clap knows where each goes.
            let _ = e.print();
            return if e.use_stderr() { 2 } else { 0 };
        }
    };
    let out = Output::new(&cli.global);
    if let Err(e) = cli.global.apply() {
        out.error(&e);
        return 2;
    }
    match run(cli.command, &out) {
        Ok(()) => 0,
        Err(e) => {
            out.error(&e);
            if e.is::<output::BadArgument>() { 2 } else { 1 }
        }
    }
}
