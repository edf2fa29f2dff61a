//! `cannula doctor`: is everything fit for work, and if not, how to mend it. Exit status 1 if
//! something is wrong.

use super::Output;
use super::rig::RigArgs;
use crate::doctor::{self, Check, State};
use crate::progress::Progress;
use crate::rig::config::Rig;
use serde_json::json;
use std::path::PathBuf;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,
    /// Look at this calibration too.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Where recordings will go.
    #[arg(long, value_name = "DIR", default_value = ".")]
    folder: PathBuf,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let loaded = args.rig.load().map_err(|e| format!("{e:#}"));
    let file = args.rig.file().map(|p| p.display().to_string());
    let rig = loaded.as_ref().ok();
    out.start("checks", 4);
    let mut checks = doctor::machine(&args.folder, rig.map_or(0.0, bytes_per_s));
    out.step();
    checks.extend(doctor::configuration(&loaded, file.as_deref()));
    out.step();
    let mut size = None;
    if let Some(rig) = rig {
        let (found, camera) = doctor::rig(rig);
        checks.extend(found);
        size = camera;
    }
    out.step();
    checks.extend(doctor::calibration(args.calibration.as_deref(), size, rig));
    out.finish();
    let wrong: Vec<&Check> = checks.iter().filter(|c| c.state == State::Wrong).collect();
    let object = json!({
        "format": "cannula-doctor/1", "fit": doctor::fit(&checks), "checks": checks,
    });
    out.result(&object, || table(&checks))?;
    if let Some(first) = wrong.first() {
        anyhow::bail!(
            "{} of {} checks failed, the first: {}, {}: {}",
            wrong.len(),
            checks.len(),
            first.part,
            first.what,
            first.found
        );
    }
    Ok(())
}

/// What a scan writes at most, uncompressed.
fn bytes_per_s(rig: &Rig) -> f64 {
    let [_, _, width, height] = rig.camera.region;
    let pixels = if width > 0 {
        f64::from(width) * f64::from(height)
    } else {
        1280.0 * 960.0
    };
    let depth = if rig.camera.pixel_format == "Mono8" {
        1.0
    } else {
        2.0
    };
    let fastest = (1e3 / rig.camera.frame_time_ms.max(1.0))
        .min(rig.scan.speed_mm_s / rig.scan.spacing_mm.max(1e-3));
    pixels * depth * fastest
}

fn table(checks: &[Check]) -> String {
    let mut text = String::new();
    let mut part = "";
    for c in checks {
        let head = if c.part == part { "" } else { c.part };
        part = c.part;
        let state = match c.state {
            State::Good => console::style("ok   ").green(),
            State::Weak => console::style("weak ").yellow(),
            State::Wrong => console::style("WRONG").red().bold(),
            State::Skipped => console::style("–    ").dim(),
        };
        text += &format!("{head:13}  {state}  {:13}  {}\n", c.what, c.found);
        if !c.remedy.is_empty() {
            text += &format!("{:37}→ {}\n", "", c.remedy);
        }
    }
    let count = |s: State| checks.iter().filter(|c| c.state == s).count();
    text + &format!(
        "{} ok, {} weak, {} wrong, {} not looked at",
        count(State::Good),
        count(State::Weak),
        count(State::Wrong),
        count(State::Skipped)
    )
}
