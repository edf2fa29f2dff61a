//! What the commands that drive a rig share: its configuration, Ctrl-C, getting ready.

use super::Output;
use crate::rig::config::Rig;
use crate::rig::lock::Lock;
use crate::simulation::mark;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

/// Which rig.
#[derive(clap::Args, Debug)]
pub struct RigArgs {
    /// The rig's configuration (see `cannula config --example`); defaults if not given.
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// The motion board's port, instead of the configuration's; "simulated" needs no hardware.
    #[arg(long, value_name = "PATH", global = true)]
    port: Option<String>,
}

impl RigArgs {
    /// The configuration's file, if one was given.
    pub fn file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// The configuration, checked.
    pub fn load(&self) -> anyhow::Result<Rig> {
        let mut rig = match &self.config {
            Some(path) => Rig::load(path)?,
            None => Rig::default(),
        };
        if let Some(port) = &self.port {
            rig.board.port.clone_from(port);
        }
        rig.check(
            self.config
                .as_deref()
                .unwrap_or(Path::new("the rig's defaults")),
        )?;
        Ok(rig)
    }
}

/// Becomes true at Ctrl-C (or a termination signal): everything then stops in order.
pub fn interrupted() -> anyhow::Result<&'static AtomicBool> {
    static FLAG: AtomicBool = AtomicBool::new(false);
    static HANDLER: OnceLock<bool> = OnceLock::new();
    let set = HANDLER.get_or_init(|| {
        ctrlc::set_handler(|| FLAG.store(true, std::sync::atomic::Ordering::Relaxed)).is_ok()
    });
    anyhow::ensure!(set, "Ctrl-C can't be caught, so the rig is not driven");
    Ok(&FLAG)
}

/// Connects nothing, but says what a homing found.
pub fn say_homed(homed: Option<crate::rig::link::Homed>, rig: &Rig, out: &Output) {
    if let Some(homed) = homed {
        out.say(&format!(
            "homed: the switch repeated within {:.1} µm",
            1000.0 * rig.mm(i64::from(homed.apart)).abs()
        ));
    }
}

/// Takes the lock of a folder that a simulation is to be recorded into, and clears the one that stands
/// there. `stands` tells what is in the way, `what` is it that `force` replaces, with the `results` beside.
pub fn make_way(
    folder: &Path,
    results: &[PathBuf],
    force: bool,
    what: &str,
    stands: impl Fn() -> Option<PathBuf>,
) -> anyhow::Result<Lock> {
    let replace = || {
        let Some(path) = stands() else {
            return Ok(false);
        };
        anyhow::ensure!(
            force,
            "{}: stands there; give another folder, or --force to replace a {what}",
            path.display()
        );
        mark::clearable(folder, results)?;
        Ok(true)
    };
    // Where nothing is to be written, not even a lock; and what stands once it is taken counts.
    replace()?;
    let lock = Lock::take(folder)?;
    if replace()? {
        mark::clear(folder, results)?;
    }
    Ok(lock)
}
