//! `cannula motion`: hands on the motion board. Each command is safe by default: the laser is on
//! only with `--laser` and while the command runs.

use super::rig::{RigArgs, interrupted};
use super::{BadArgument, Output};
use crate::rig::config::Rig;
use crate::rig::link::Board;
use crate::rig::open;
use anyhow::Context;
use cannula_shared::message::{State, Status};
use cannula_shared::units::Steps;
use serde_json::{Value, json};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand, Debug)]
enum Command {
    /// What the board is doing, its position, its inputs.
    Status,
    /// Find the home switch and go to zero.
    Home,
    /// Move to a position.
    Move {
        /// Where to, mm from home.
        #[arg(value_name = "MM", allow_negative_numbers = true)]
        to: f64,
        /// How fast, mm/s (the configured maximum if not given).
        #[arg(long, value_name = "MM/S", default_value_t = 0.0)]
        speed: f64,
    },
    /// Move by a distance.
    Jog {
        /// How far, mm; negative towards home.
        #[arg(value_name = "MM", allow_negative_numbers = true)]
        by: f64,
        /// How fast, mm/s (the configured maximum if not given).
        #[arg(long, value_name = "MM/S", default_value_t = 0.0)]
        speed: f64,
    },
    /// Switch the laser on while this command runs (until Ctrl-C, or --seconds).
    Laser {
        /// Confirms that the laser may go on.
        #[arg(long)]
        laser: bool,
        /// For how long.
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
    },
    /// Fire one trigger.
    Trigger,
    /// Send the configuration and show what the board took.
    Config,
    /// Stop whatever runs: laser off, down the ramp.
    Stop,
    /// Leave a fault whose cause is gone.
    Rearm,
    /// Cut the driver, so that the slide can be moved by hand.
    Release,
    /// Start the board anew.
    Reboot {
        /// Into its USB bootloader, to load another program.
        #[arg(long)]
        bootloader: bool,
    },
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let rig = args.rig.load()?;
    if let Command::Laser { laser: false, .. } = args.command {
        return Err(BadArgument("the laser goes on only with --laser".into()).into());
    }
    let stop = interrupted()?;
    let mut board = open::board(&rig)?;
    board.heed(stop);
    let config = rig.board_config(rig.camera.exposure_laser_ms);
    // A question or a stop must change nothing; what moves needs the configuration.
    let needs_config = matches!(
        args.command,
        Command::Home
            | Command::Move { .. }
            | Command::Jog { .. }
            | Command::Laser { .. }
            | Command::Trigger
            | Command::Config
    );
    if needs_config {
        open::at_rest(&board)?;
        board.configure(&config)?;
    }
    let done = |what: &str, status: &Status| {
        let object = status_json(status, &rig);
        out.result(&object, || format!("{what}{}", status_text(status, &rig)))
    };
    match args.command {
        Command::Status => done("", &board.status()?),
        Command::Home => {
            let homed = board.home()?;
            let um = 1000.0 * rig.mm(i64::from(homed.apart));
            done(
                &format!("the switch repeated within {:.1} µm\n", um.abs()),
                &board.status()?,
            )
        }
        Command::Move { to, speed } => {
            board.move_to(steps(&rig, to)?, speed_um_s(speed)?)?;
            done("", &board.status()?)
        }
        Command::Jog { by, speed } => {
            board.jog(steps(&rig, by)?, speed_um_s(speed)?)?;
            done("", &board.status()?)
        }
        Command::Laser { seconds, .. } => {
            let limit = seconds.unwrap_or(f64::INFINITY);
            anyhow::ensure!(
                limit > 0.0,
                BadArgument(format!("--seconds {limit}: give more than 0"))
            );
            board.laser(true)?;
            out.say("laser on; Ctrl-C turns it off");
            let began = Instant::now();
            // Whoever stands beside it must know that it may still be on.
            let ask = || {
                board.status_promptly().context(
                    "the laser was on, and goes off by itself once its lease is over: look at it",
                )
            };
            let mut status = ask()?;
            while status.laser
                && !stop.load(Ordering::Relaxed)
                && began.elapsed().as_secs_f64() < limit
            {
                std::thread::sleep(Duration::from_millis(20));
                status = ask()?;
            }
            if !status.laser {
                out.say(
                    "the board has turned the laser off (its own limit, the interlock, or a fault)",
                );
            }
            board.laser(false)?;
            done("laser off\n", &board.status()?)
        }
        Command::Trigger => {
            let trigger = board.trigger()?;
            let object = json!({
                "time_us": trigger.time.0, "position_steps": trigger.position.0, "laser": trigger.laser,
            });
            out.result(&object, || {
                format!(
                    "trigger at {} µs, {:.3} mm",
                    trigger.time.0,
                    rig.mm(trigger.position.0.into())
                )
            })
        }
        Command::Config => {
            let object = json!({ "configuration": config });
            out.result(&object, || taken(&object["configuration"]))
        }
        Command::Stop => finish(&board, board.stop(), &done),
        Command::Rearm => finish(&board, board.rearm(), &done),
        Command::Release => finish(&board, board.release(), &done),
        Command::Reboot { bootloader } => {
            board.reboot(bootloader)?;
            out.result(&json!({ "rebooted": true }), || {
                "the board starts anew".into()
            })
        }
    }
}

/// A configuration for people: a setting a line.
fn taken(configuration: &serde_json::Value) -> String {
    let mut text = "the board has taken".to_owned();
    for (key, value) in configuration.as_object().into_iter().flatten() {
        let value = value.as_str().map_or_else(|| value.to_string(), Into::into);
        text += &format!("\n  {key:<26} {value}");
    }
    text
}

fn finish(
    board: &Board,
    outcome: crate::rig::link::Result<()>,
    done: &dyn Fn(&str, &Status) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    outcome?;
    done("", &board.status()?)
}

fn steps(rig: &Rig, mm: f64) -> anyhow::Result<Steps> {
    let um = (mm * 1000.0).round();
    let ratio = rig.board_config(1.0).steps_per_mm;
    (um.abs() < 1e9)
        .then(|| ratio.nearest_step(um as i64))
        .flatten()
        .ok_or_else(|| BadArgument(format!("{mm} mm is no position on a slide")).into())
}

fn speed_um_s(mm_s: f64) -> anyhow::Result<u32> {
    if !(0.0..=1e5).contains(&mm_s) {
        return Err(BadArgument(format!("--speed {mm_s}: give mm/s, or 0 for the maximum")).into());
    }
    Ok((mm_s * 1000.0).round() as u32)
}

fn state_name(state: &State) -> String {
    match state {
        State::Boot => "boot: waiting for a configuration".into(),
        State::Idle => "idle: position unknown".into(),
        State::Homing => "homing".into(),
        State::Ready => "ready".into(),
        State::Scanning => "scanning".into(),
        State::Stopping => "stopping".into(),
        State::Fault(fault) => format!("fault: {fault}"),
    }
}

fn status_json(status: &Status, rig: &Rig) -> Value {
    let mm = rig.mm(status.position.0.into());
    json!({
        "state": state_name(&status.state),
        "position_known": status.position_known,
        "position_steps": status.position_known.then_some(status.position.0),
        "position_mm": status.position_known.then_some(mm),
        "moving": status.moving,
        "driver": status.driver,
        "laser": status.laser,
        "inputs": {
            "home": status.inputs.home, "limit": status.inputs.limit, "estop": status.inputs.estop,
            "interlock": status.inputs.interlock, "exposure": status.inputs.exposure,
        },
        "uptime_us": status.uptime.0,
        "bad_frames": status.bad_frames,
    })
}

fn status_text(status: &Status, rig: &Rig) -> String {
    let position = if status.position_known {
        format!(
            "{:.4} mm ({} steps)",
            rig.mm(status.position.0.into()),
            status.position.0
        )
    } else {
        "unknown; home first".into()
    };
    let on = |level: bool| if level { "on" } else { "off" };
    let i = &status.inputs;
    let active: Vec<&str> = [
        (i.home, "home switch"),
        (i.limit, "limit switch"),
        (i.estop, "emergency stop"),
        (i.interlock, "interlock open"),
        (i.exposure, "camera exposing"),
    ]
    .iter()
    .filter_map(|(active, name)| active.then_some(*name))
    .collect();
    format!(
        "state     {}\nposition  {position}\ndriver    {}\nlaser     {}\ninputs    {}",
        state_name(&status.state),
        on(status.driver),
        on(status.laser),
        if active.is_empty() {
            "none active".into()
        } else {
            active.join(", ")
        }
    )
}
