//! `cannula simulate`: recordings of the simulated rig with their truth, or the simulated board
//! behind a pseudo-terminal for other programs.

use super::rig::{RigArgs, interrupted, make_way};
use super::{BadArgument, Output};
use crate::rig::open::{scene, simulated_board};
use crate::simulation::{Profile, mark, record_scene};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,
    /// Write a whole recording with truth.json into this folder.
    #[arg(long, value_name = "DIR", required_unless_present = "pty")]
    session: Option<PathBuf>,
    /// Show a simulated board as a serial port, until Ctrl-C.
    #[arg(long, conflicts_with = "session")]
    pty: bool,
    /// With --pty: end after so long.
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// What the scene is drawn from: the same seed gives the same recording.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// tiny, nominal or hard.
    #[arg(long, default_value = "nominal")]
    profile: Profile,
    /// Replace a simulated recording that stands there; anything else is left alone.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    match &args.session {
        Some(folder) => session(folder, &args, out),
        None => pty(&args, out),
    }
}

fn session(folder: &Path, args: &Args, out: &Output) -> anyhow::Result<()> {
    let file = folder.join("session.json");
    // Its checkerboard; what else it says is of a rig that is driven.
    let scene =
        scene(&args.rig.load()?, args.profile, args.seed).map_err(|e| match args.rig.file() {
            Some(path) => anyhow::anyhow!("{}: {e}", path.display()),
            None => e.into(),
        })?;
    let _lock = make_way(folder, &[], args.force, "simulated recording", || {
        mark::stands(folder)
    })?;
    mark::begin(folder)?;
    let truth = record_scene(folder, scene, out)?;
    let n = truth.plane.normal;
    let object = serde_json::json!({
        "session": file,
        "profile": args.profile.name(),
        "seed": args.seed,
        "plane": { "normal": [n.x, n.y, n.z], "d": truth.plane.d },
    });
    out.result(&object, || {
        format!("{}: written, with truth.json beside it", file.display())
    })
}

#[cfg(unix)]
fn pty(args: &Args, out: &Output) -> anyhow::Result<()> {
    use crate::simulation::mcu::RealTime;
    let rig = args.rig.load()?;
    let stop = interrupted()?;
    let board = RealTime::start(simulated_board(&rig))?;
    let path = board.path().to_owned();
    out.result(&serde_json::json!({ "port": path }), || path.clone())?;
    out.say(&format!("a simulated motion board listens at {path}; Ctrl-C ends it. Try: cannula motion --port {path} status"));
    let began = Instant::now();
    let limit = args.seconds.unwrap_or(f64::INFINITY);
    if !(limit > 0.0) {
        return Err(BadArgument(format!("--seconds {limit}: give more than 0")).into());
    }
    while !stop.load(Ordering::Relaxed) && began.elapsed().as_secs_f64() < limit {
        std::thread::sleep(Duration::from_millis(20));
        // What it exposes is the camera's business; here is none.
        drop(board.board().board().take_exposed());
    }
    Ok(())
}

#[cfg(not(unix))]
fn pty(_args: &Args, _out: &Output) -> anyhow::Result<()> {
    Err(BadArgument("--pty: this system has no pseudo-terminals".into()).into())
}
