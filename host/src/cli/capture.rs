//! `cannula capture camera|light|scan --out SESSION`: a recording step by step. It goes on where it
//! was broken off; nothing recorded is overwritten.

use super::Output;
use super::live::complain;
use super::rig::{RigArgs, interrupted, say_homed};
use crate::progress::Progress;
use crate::rig::acquisition::{AcquireError, Acquisition};
use crate::rig::capture::{self, LightOutcome, PoseOutcome, Step};
use crate::rig::guide::Guide;
use crate::rig::open::{self, Opened};
use crate::rig::recording::Recording;
use crate::session::Session;
use crate::simulation::{Subject, Truth};
use serde_json::json;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand, Debug)]
enum What {
    /// The checkerboard in many poses, laser off.
    Camera(Common),
    /// The checkerboard in some poses, the slide visiting all positions in each.
    Light(Common),
    /// One sweep over the hand.
    Scan(Common),
}

#[derive(clap::Args, Debug)]
struct Common {
    /// The recording: a folder, made if it is not there.
    #[arg(long, value_name = "SESSION")]
    out: PathBuf,
    /// Take so many poses without asking.
    #[arg(long, value_name = "N")]
    poses: Option<usize>,
    /// With --poses: wait so long before each.
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    every: f64,
    /// Record this part anew, if it stands there.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let rig = args.rig.load()?;
    let cancel = interrupted()?;
    let mut opened = open::open(&rig)?;
    opened.board.heed(cancel);
    out.say(&format!("camera: {}", opened.camera.description()));
    say_homed(open::ready(&opened.board, &rig)?, &rig, out);
    let size = opened.camera.size();
    let geometry = rig.geometry();
    let common = match &args.what {
        What::Camera(c) | What::Light(c) | What::Scan(c) => c,
    };
    let mut recording = Recording::open(&common.out, size, &geometry)?;
    let Opened {
        board,
        camera,
        stage,
        ..
    } = &mut opened;
    let mut acquisition = Acquisition::new(board, camera.as_mut(), &rig, cancel);
    let mut operator = Operator::new(common, cancel, out);
    match &args.what {
        What::Camera(c) => {
            if c.force {
                recording.manifest.camera.clear();
            }
            let mut guide = known(&recording, &geometry, size, out)?;
            let scene = stage.as_ref().map(|s| s.renderer().clone());
            loop {
                let next = guide.next();
                match &next {
                    Some(next) => out.say(&format!("{}; next: {next}", guide.summary())),
                    None => out.say(&format!("{}: that is enough", guide.summary())),
                }
                if !operator.go_on("take this pose", next.is_none())? {
                    break;
                }
                // On the simulated rig somebody has to move the board.
                if let (Some(stage), Some(renderer)) = (&stage, &scene) {
                    let poses = &renderer.scene().camera_poses;
                    stage.show(&Subject::Board(poses[operator.taken % poses.len()]));
                }
                let ms = rig.camera.exposure_board_ms;
                match capture::camera_pose(
                    &mut acquisition,
                    ms,
                    &mut recording,
                    &mut guide,
                    &geometry,
                )? {
                    PoseOutcome::Taken {
                        image,
                        seen,
                        warning,
                    } => {
                        out.say(&format!("{image}: board found, {seen}"));
                        if let Some(warning) = warning {
                            out.warn(&warning);
                        }
                    }
                    PoseOutcome::NotFound(why) => out.warn(&format!("not taken: {why}")),
                }
                operator.taken += 1;
            }
            let object = json!({
                "session": common.out, "poses": recording.manifest.camera.len(),
                "covered": guide.covered(), "enough": guide.next().is_none(),
            });
            out.result(&object, || {
                format!("{}: {}", common.out.display(), guide.summary())
            })
        }
        What::Light(c) => {
            if c.force {
                recording.manifest.light.clear();
            }
            let scene = stage.as_ref().map(|s| s.renderer().clone());
            loop {
                let poses = recording.manifest.light.len();
                let hint = if poses < 4 {
                    format!(
                        "{poses} poses; 6 or more, at different distances and tilts, the line crossing the board at every position"
                    )
                } else {
                    format!("{poses} poses; more at other distances and tilts do no harm")
                };
                out.say(&hint);
                if !operator.go_on("sweep over this pose (keep the board still)", poses >= 6)? {
                    break;
                }
                if let (Some(stage), Some(renderer)) = (&stage, &scene) {
                    let poses = &renderer.scene().light_poses;
                    stage.show(&Subject::Board(poses[operator.taken % poses.len()]));
                }
                out.start("slide positions", rig.light.count as usize);
                let outcome =
                    capture::light_pose(&mut acquisition, &rig, &mut recording, &mut || out.step());
                out.finish();
                match outcome? {
                    LightOutcome::Taken {
                        folder,
                        sweep,
                        waited,
                    } => {
                        out.say(&format!(
                            "{folder}: {} of {} positions",
                            sweep.shots, sweep.planned
                        ));
                        complain(&sweep, waited, out);
                    }
                    LightOutcome::NotFound(why) => out.warn(&format!("not taken: {why}")),
                }
                operator.taken += 1;
            }
            let object = json!({ "session": common.out, "poses": recording.manifest.light.len() });
            out.result(&object, || {
                format!(
                    "{}: {} poses of the light planes",
                    common.out.display(),
                    recording.manifest.light.len()
                )
            })
        }
        What::Scan(c) => {
            if let Some(stage) = &stage {
                stage.show(&Subject::Hand);
                recording.manifest.entry = Truth::new(stage.renderer().scene()).map(|t| t.entry);
            }
            out.start("scan", rig.scan.count as usize);
            let scanned = capture::scan(
                &mut acquisition,
                &rig,
                &mut recording,
                c.force,
                &mut |step| {
                    if matches!(step, Step::Shot(_)) {
                        out.step();
                    }
                    Ok(())
                },
            );
            out.finish();
            let scanned = scanned?;
            complain(&scanned.sweep, scanned.waited, out);
            let object = json!({
                "session": common.out, "frames": scanned.sweep.shots, "planned": scanned.sweep.planned,
                "faults": scanned.sweep.complaints(),
            });
            out.result(&object, || {
                format!(
                    "{}: {} of {} frames",
                    common.out.display(),
                    scanned.sweep.shots,
                    scanned.sweep.planned
                )
            })
        }
    }
}

/// What earlier poses of the recording have covered.
fn known(
    recording: &Recording,
    geometry: &crate::board::BoardGeometry,
    size: (u32, u32),
    out: &Output,
) -> anyhow::Result<Guide> {
    let mut guide = Guide::new(size.0, size.1);
    if recording.manifest.camera.is_empty() {
        return Ok(guide);
    }
    let session = Session::open(recording.folder())?;
    out.start("earlier poses", session.manifest.camera.len());
    for view in &session.manifest.camera {
        let picture = crate::rig::folder::read(&recording.path(&view.image))?;
        if let Ok(detection) = capture::detect(&picture, geometry) {
            guide.add(&detection, geometry);
        }
        out.step();
    }
    out.finish();
    Ok(guide)
}

/// Who says when a pose is ready: somebody at the keyboard, or a number given beforehand.
struct Operator<'a> {
    poses: Option<usize>,
    every: Duration,
    taken: usize,
    cancel: &'a AtomicBool,
    /// Lines from the keyboard: read elsewhere, so that Ctrl-C is heeded meanwhile.
    keyboard: Option<Receiver<std::io::Result<String>>>,
    out: &'a Output,
}

impl<'a> Operator<'a> {
    fn new(common: &Common, cancel: &'a AtomicBool, out: &'a Output) -> Self {
        Self {
            poses: common.poses,
            every: Duration::from_secs_f64(common.every.clamp(0.0, 3600.0)),
            taken: 0,
            cancel,
            keyboard: None,
            out,
        }
    }

    /// Whether to take another pose. `enough`: it would be the user's own wish.
    fn go_on(&mut self, what: &str, enough: bool) -> anyhow::Result<bool> {
        if let Some(poses) = self.poses {
            let began = Instant::now();
            while self.taken < poses && began.elapsed() < self.every {
                heed(self.cancel)?;
                std::thread::sleep(Duration::from_millis(10));
            }
            return Ok(self.taken < poses);
        }
        let end = if enough {
            "q or end of input to finish"
        } else {
            "q to leave off; it goes on later"
        };
        self.out.say(&format!("Enter to {what}, {end}"));
        let keyboard = self.keyboard.get_or_insert_with(|| {
            let (send, receive) = channel();
            // It ends with the program, or when nobody listens any more.
            std::thread::spawn(move || {
                for line in std::io::stdin().lines() {
                    if send.send(line).is_err() {
                        break;
                    }
                }
            });
            receive
        });
        let line = loop {
            match keyboard.recv_timeout(Duration::from_millis(50)) {
                Ok(line) => break line?,
                Err(RecvTimeoutError::Disconnected) => return Ok(false),
                Err(RecvTimeoutError::Timeout) => heed(self.cancel)?,
            }
        };
        Ok(!line.trim().eq_ignore_ascii_case("q"))
    }
}

fn heed(cancel: &AtomicBool) -> anyhow::Result<()> {
    if cancel.load(Ordering::Relaxed) {
        return Err(AcquireError::Interrupted.into());
    }
    Ok(())
}
