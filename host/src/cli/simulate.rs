//! `cannula simulate`: recordings of the simulated rig with their truth.

use super::Output;
use crate::simulation::{Profile, record};
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Write a whole recording with truth.json into this folder.
    #[arg(long, value_name = "DIR")]
    session: PathBuf,
    /// What the scene is drawn from: the same seed gives the same recording.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// tiny, nominal or hard.
    #[arg(long, default_value = "nominal")]
    profile: Profile,
    /// Overwrite a recording that stands there.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let file = args.session.join("session.json");
    if file.exists() && !args.force {
        anyhow::bail!(
            "{}: a recording stands there; give another folder, or --force to overwrite it",
            file.display()
        );
    }
    let truth = record(&args.session, args.profile, args.seed, out)?;
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
