//! `cannula capture camera|light|scan --out SESSION`: a recording step by step. It goes on where it
//! was broken off; nothing recorded is overwritten.

use super::Output;
use super::live::complain;
use super::rig::{RigArgs, interrupted, say_homed};
use crate::board::{BoardGeometry, Detection};
use crate::geometry::Pose;
use crate::pipeline::{Method, Times, calibrate};
use crate::progress::{Progress, Silent};
use crate::rig::acquisition::{AcquireError, Acquisition};
use crate::rig::capture::{self, LightOutcome, PoseOutcome, Step};
use crate::rig::guide::Guide;
use crate::rig::light_guide::LightGuide;
use crate::rig::lock::Lock;
use crate::rig::open::{self, Opened};
use crate::rig::progress::Part;
use crate::rig::recording::Recording;
use crate::rig::simulated::Stage;
use crate::session::{Entry, Session};
use crate::simulation::{Subject, Truth, mark};
use serde_json::json;
use std::path::PathBuf;
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
    Camera(PosesArgs),
    /// The checkerboard in some poses, the slide visiting all positions in each.
    Light(PosesArgs),
    /// One sweep over the hand; one that was broken off goes on (hand and light must not have moved).
    Scan(ScanArgs),
}

#[derive(clap::Args, Debug)]
struct ScanArgs {
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    entry: EntryArgs,
}

/// Where the needle is to go in.
#[derive(clap::Args, Debug)]
struct EntryArgs {
    /// Entry pixel, recorded into session.json; with --vein.
    #[arg(long, value_name = "U,V", value_parser = pixel, requires = "vein")]
    entry: Option<[f64; 2]>,
    /// Two or more pixels along the vein, in the direction of the needle.
    #[arg(long, value_name = "U,V", value_parser = pixel, num_args = 2.., requires = "entry")]
    vein: Vec<[f64; 2]>,
    /// Radius of the region to which the plane is fitted; with --entry.
    #[arg(long, value_name = "MM", default_value_t = 12.0, requires = "entry")]
    radius: f64,
}

fn pixel(text: &str) -> Result<[f64; 2], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([u, v]) if u.is_finite() && v.is_finite() => Ok([*u, *v]),
        _ => Err("give two numbers with a comma between: U,V in pixels".to_owned()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(s) if (0.0..=3600.0).contains(&s) => Ok(s),
        _ => Err("give seconds, 0 to 3600".to_owned()),
    }
}

impl EntryArgs {
    /// The entry that they give.
    fn entry(&self) -> Option<Entry> {
        self.entry.map(|pixel| Entry {
            pixel,
            vein: self.vein.clone(),
            radius_mm: self.radius,
        })
    }
}

#[derive(clap::Args, Debug)]
struct Common {
    /// The recording: a folder, made if it is not there.
    #[arg(long, value_name = "SESSION")]
    out: PathBuf,
    /// Record this part anew, if it stands there. (A scan anew that was broken off goes on where it was,
    /// if settings and scene are the same.)
    #[arg(long)]
    force: bool,
}

#[derive(clap::Args, Debug)]
struct PosesArgs {
    #[command(flatten)]
    common: Common,
    /// Take poses without asking until the recording has so many.
    #[arg(long, value_name = "N")]
    poses: Option<usize>,
    /// With --poses: wait so long before each.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = seconds, requires = "poses")]
    every: f64,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let rig = args.rig.load()?;
    let cancel = interrupted()?;
    let (part, common) = match &args.what {
        What::Camera(p) => (Part::Camera, &p.common),
        What::Light(p) => (Part::Light, &p.common),
        What::Scan(s) => (Part::Scan, &s.common),
    };
    // Before the rig is touched, which another process may be driving.
    let _lock = Lock::take(&common.out)?;
    let mut opened = open::open(&rig)?;
    opened.board.heed(cancel);
    out.say(&format!("camera: {}", opened.camera.description()));
    let size = opened.camera.size();
    let geometry = rig.geometry();
    let mut recording = Recording::open(&common.out, size, &geometry)?;
    // Before anything moves.
    if let What::Scan(s) = &args.what {
        recording.scan_folder(common.force)?;
        if let Some(entry) = s.entry.entry() {
            let file = recording.folder().join("session.json");
            recording.set_entry(entry, &file)?;
        }
    }
    recording.bind(part, &rig, common.force)?;
    say_homed(open::ready(&opened.board, &rig)?, &rig, out);
    mark::lift(recording.folder())?;
    let Opened {
        board,
        camera,
        stage,
        ..
    } = &mut opened;
    let mut acquisition = Acquisition::new(board, camera.as_mut(), &rig, cancel);
    match &args.what {
        What::Camera(p) => {
            let mut operator = Operator::new(p, out);
            if common.force {
                recording.manifest.camera.clear();
            }
            let mut guide = known(&recording, &geometry, size, out)?;
            let scene = stage.as_ref().map(|s| s.renderer().clone());
            let wanted = |guide: &Guide, recording: &Recording| match guide.next() {
                Some(next) => anyhow::Ok(Some(next)),
                None => lacking(recording, false, out),
            };
            let mut next = wanted(&guide, &recording)?;
            loop {
                match &next {
                    Some(next) => out.say(&format!("{}; next: {next}", guide.summary())),
                    None => out.say(&format!("{}: that is enough", guide.summary())),
                }
                let have = recording.manifest.camera.len();
                if !operator.go_on(
                    &|| acquisition.go_on(),
                    "take this pose",
                    next.is_none(),
                    have,
                )? {
                    break;
                }
                // On the simulated rig somebody has to move the board.
                if let (Some(stage), Some(renderer)) = (stage.as_ref(), &scene)
                    && !operator.show(stage, &renderer.scene().camera_poses, have)
                {
                    break;
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
                        operator.found();
                        out.say(&format!("{image}: board found, {seen}"));
                        if let Some(warning) = warning {
                            out.warn(&warning);
                        }
                        next = wanted(&guide, &recording)?;
                    }
                    PoseOutcome::NotFound(why) => operator.missed(&why.to_string())?,
                }
            }
            let object = json!({
                "session": common.out, "poses": recording.manifest.camera.len(),
                "covered": guide.covered(), "enough": next.is_none(), "next": next,
            });
            out.result(&object, || {
                format!("{}: {}", common.out.display(), guide.summary())
            })
        }
        What::Light(p) => {
            let mut operator = Operator::new(p, out);
            if common.force {
                recording.manifest.light.clear();
            }
            let scene = stage.as_ref().map(|s| s.renderer().clone());
            let mut guide = known_light(&recording, &geometry, size, out)?;
            let wanted = |guide: &LightGuide, recording: &Recording| match guide.next() {
                Some(next) => anyhow::Ok(Some(next)),
                None => lacking(recording, true, out),
            };
            let mut next = wanted(&guide, &recording)?;
            loop {
                match &next {
                    Some(next) => out.say(&format!("{}; next: {next}", guide.summary())),
                    None => out.say(&format!("{}: that is enough", guide.summary())),
                }
                let have = recording.manifest.light.len();
                let what = "sweep over this pose (keep the board still)";
                if !operator.go_on(&|| acquisition.go_on(), what, next.is_none(), have)? {
                    break;
                }
                if let (Some(stage), Some(renderer)) = (stage.as_ref(), &scene)
                    && !operator.show(stage, &renderer.scene().light_poses, have)
                {
                    break;
                }
                out.start("slide positions", rig.light.count as usize);
                let outcome = capture::light_pose(
                    &mut acquisition,
                    &rig,
                    &mut recording,
                    &mut guide,
                    &mut || out.step(),
                );
                out.finish();
                match outcome? {
                    LightOutcome::Taken {
                        folder,
                        seen,
                        sweep,
                        waited,
                    } => {
                        operator.found();
                        out.say(&format!(
                            "{folder}: {} of {} positions, board {seen}",
                            sweep.shots, sweep.planned
                        ));
                        complain(&sweep, waited, out);
                        next = wanted(&guide, &recording)?;
                    }
                    LightOutcome::NotFound(why) => operator.missed(&why.to_string())?,
                }
            }
            let object = json!({
                "session": common.out, "poses": recording.manifest.light.len(),
                "depth_spread": guide.depth(), "enough": next.is_none(), "next": next,
            });
            out.result(&object, || {
                format!("{}: {}", common.out.display(), guide.summary())
            })
        }
        What::Scan(s) => {
            if let Some(stage) = &stage {
                stage.show(&Subject::Hand);
                let truth = || Truth::new(stage.renderer().scene()).map(|t| t.entry);
                let given = recording.manifest.entry.take();
                recording.manifest.entry = given.or_else(truth);
            }
            out.start("scan", rig.scan.count as usize);
            let scanned = capture::scan(
                &mut acquisition,
                &rig,
                &mut recording,
                s.common.force,
                &mut |step| {
                    if matches!(step, Step::Shot(_)) {
                        out.step();
                    }
                    Ok(())
                },
            );
            out.finish();
            let scanned = scanned?;
            if scanned.stood > 0 {
                out.say(&format!(
                    "{} frames stood from before; the scan went on",
                    scanned.stood
                ));
            }
            complain(&scanned.sweep, scanned.waited, out);
            let object = json!({
                "session": common.out, "frames": scanned.sweep.shots, "planned": scanned.sweep.planned,
                "stood": scanned.stood, "faults": scanned.sweep.complaints(),
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
    geometry: &BoardGeometry,
    size: (u32, u32),
    out: &Output,
) -> anyhow::Result<Guide> {
    let mut guide = Guide::new(size.0, size.1);
    let images = recording.manifest.camera.iter().map(|view| &view.image);
    earlier(recording, images.collect(), geometry, out, |detection| {
        guide.add(detection, geometry);
    })?;
    Ok(guide)
}

/// The same of the light planes.
fn known_light(
    recording: &Recording,
    geometry: &BoardGeometry,
    size: (u32, u32),
    out: &Output,
) -> anyhow::Result<LightGuide> {
    let mut guide = LightGuide::new(size.0, size.1);
    let poses = recording.manifest.light.iter();
    let images = poses.filter_map(|p| p.off.as_ref().or(p.on.first().map(|f| &f.image)));
    earlier(recording, images.collect(), geometry, out, |detection| {
        guide.add(detection, geometry);
    })?;
    Ok(guide)
}

fn earlier(
    recording: &Recording,
    images: Vec<&String>,
    geometry: &BoardGeometry,
    out: &Output,
    mut found: impl FnMut(&Detection),
) -> anyhow::Result<()> {
    if images.is_empty() {
        return Ok(());
    }
    out.start("earlier poses", images.len());
    for image in images {
        let picture = crate::rig::folder::read(&recording.path(image))?;
        if let Ok(detection) = capture::detect(&picture, geometry) {
            found(&detection);
        }
        out.step();
    }
    out.finish();
    Ok(())
}

/// Where the spread is enough, the calibration itself has the last word: what its own gates find
/// lacking in what is recorded; `None` if it stands. `light`: with the light planes.
fn lacking(recording: &Recording, light: bool, out: &Output) -> anyhow::Result<Option<String>> {
    let mut session = Session::open(recording.folder())?;
    if !light {
        session.manifest.light.clear();
    }
    Ok(
        match calibrate(&session, Method::Ml, &Times::default(), &Silent) {
            Ok(calibrated) => {
                for warning in &calibrated.warnings {
                    out.warn(warning);
                }
                None
            }
            Err(e) => Some(format!("it would not calibrate yet: {e}")),
        },
    )
}

/// Pictures in a row without a board after which one that nobody watches ends.
const MISSES: usize = 5;

/// Who says when a pose is ready: somebody at the keyboard, or a number given beforehand.
struct Operator<'a> {
    poses: Option<usize>,
    every: Duration,
    /// Poses in which no board was found: all, and in a row.
    missed: usize,
    in_a_row: usize,
    /// Lines from the keyboard: read elsewhere, so that Ctrl-C is heeded meanwhile.
    keyboard: Option<Receiver<std::io::Result<String>>>,
    out: &'a Output,
}

impl<'a> Operator<'a> {
    fn new(args: &PosesArgs, out: &'a Output) -> Self {
        Self {
            poses: args.poses,
            every: Duration::from_secs_f64(args.every),
            missed: 0,
            in_a_row: 0,
            keyboard: None,
            out,
        }
    }

    fn found(&mut self) {
        self.in_a_row = 0;
    }

    /// No board in the picture.
    fn missed(&mut self, why: &str) -> anyhow::Result<()> {
        self.missed += 1;
        self.in_a_row += 1;
        self.out.warn(&format!("not taken: {why}"));
        anyhow::ensure!(
            self.poses.is_none() || self.in_a_row < MISSES,
            "no board in {MISSES} pictures in a row, the last one: {why}; what was recorded before stands"
        );
        Ok(())
    }

    /// Moves the simulated board to its next pose; false when the scene has no further one. A
    /// recording that has `have` poses goes on with those that follow.
    fn show(&self, stage: &Stage, poses: &[Pose], have: usize) -> bool {
        let Some(pose) = poses.get(have + self.missed) else {
            self.out.say(&format!(
                "the simulated scene has these {} poses",
                poses.len()
            ));
            return false;
        };
        stage.show(&Subject::Board(*pose));
        true
    }

    /// Whether to take another pose beside the `have` of the recording. `enough`: it would be the
    /// user's own wish.
    fn go_on(
        &mut self,
        heed: &dyn Fn() -> Result<(), AcquireError>,
        what: &str,
        enough: bool,
        have: usize,
    ) -> anyhow::Result<bool> {
        if let Some(poses) = self.poses {
            let began = Instant::now();
            while have < poses && began.elapsed() < self.every {
                heed()?;
                std::thread::sleep(Duration::from_millis(10));
            }
            return Ok(have < poses);
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
                Err(RecvTimeoutError::Timeout) => heed()?,
            }
        };
        Ok(!line.trim().eq_ignore_ascii_case("q"))
    }
}
