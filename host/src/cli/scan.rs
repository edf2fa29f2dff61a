//! `cannula scan --out DIR --calibration FILE`: captures the hand and reconstructs while frames
//! arrive; the result stands within milliseconds of the last frame.

use super::Output;
use super::job::{NeedleArgs, measurement_text};
use super::live::{Live, complain};
use super::rig::{RigArgs, interrupted, say_homed};
use crate::checks::refused_sentences;
use crate::output::{ScanProvenance, all_checks, read_calibration};
use crate::pipeline::belong_together;
use crate::progress::Progress;
use crate::rig::acquisition::Acquisition;
use crate::rig::capture::{self, Step};
use crate::rig::lock::Lock;
use crate::rig::open::{self, Opened};
use crate::rig::progress::Part;
use crate::rig::recording::Recording;
use crate::session::{Entry, Session};
use crate::simulation::{Subject, Truth, mark};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,
    /// The folder to write into: session/, cloud.ply, result.json, report.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The rig's calibration.
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// Entry pixel, vein pixels and radius from the vein imaging: a JSON file that holds the
    /// "entry" object of a session.json, or a session.json.
    #[arg(long, value_name = "FILE")]
    entry: Option<PathBuf>,
    /// Record anew, if a scan stands there. (One that was broken off while it was recorded anew goes on
    /// where it was, if settings and scene are the same.)
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    needle: NeedleArgs,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let rig = args.rig.load()?;
    let calibration = read_calibration(&args.calibration)?;
    let model = calibration.rig().ok_or_else(|| {
        anyhow::anyhow!(
            "{}: no light planes in this calibration; calibrate with a session that has \"light\"",
            args.calibration.display()
        )
    })?;
    // What would be refused then is not worth the sweep.
    let now = jiff::Timestamp::now();
    let checks = all_checks(&calibration, Some(now), now, None);
    let refused = refused_sentences(&checks);
    anyhow::ensure!(
        refused.is_empty(),
        "{}: {}",
        args.calibration.display(),
        refused.join("; ")
    );
    let mut entry = args.entry.as_deref().map(read_entry).transpose()?;
    let cancel = interrupted()?;
    // Before the rig is touched, which another process may be driving.
    let folder = args.out.join("session");
    let _lock = Lock::take(&folder)?;
    let mut opened = open::open(&rig)?;
    opened.board.heed(cancel);
    let Opened {
        board,
        camera,
        stage,
        ..
    } = &mut opened;
    if let Some(stage) = &stage {
        stage.show(&Subject::Hand);
        entry = entry.or_else(|| Truth::new(stage.renderer().scene()).map(|t| t.entry));
    }
    let Some(entry) = entry else {
        return Err(super::BadArgument(
            "--entry is needed: entry pixel, vein and radius from the vein imaging".into(),
        )
        .into());
    };
    let size = camera.size();
    anyhow::ensure!(
        (model.camera.width, model.camera.height) == size,
        "{}: made for images of {} × {}, the camera gives {} × {}; calibrate with this camera and region",
        args.calibration.display(),
        model.camera.width,
        model.camera.height,
        size.0,
        size.1
    );
    // Before anything moves: are the positions of the scan those that were calibrated?
    let weak = belong_together(
        &args.calibration,
        size,
        &model,
        &calibration.positions(),
        &rig.scan.positions(),
    )?;
    let mut recording = Recording::open(&folder, size, &rig.geometry())?;
    let file = recording.folder().join("session.json");
    let given = args.entry.as_deref().unwrap_or(&file);
    recording.set_entry(entry.clone(), given)?;
    recording.scan_folder(args.force)?;
    recording.bind(Part::Scan, &rig, args.force)?;
    say_homed(open::ready(board, &rig)?, &rig, out);
    mark::lift(recording.folder())?;
    let mut live = Some(Live::new(model));
    let mut finished = None;
    let mut acquisition = Acquisition::new(board, camera.as_mut(), &rig, cancel);
    out.start("scan", rig.scan.count as usize);
    let scanned = capture::scan(
        &mut acquisition,
        &rig,
        &mut recording,
        args.force,
        &mut |step| {
            match (step, &mut live) {
                (Step::Ambient(picture), Some(live)) => live.ambient(picture),
                (Step::Shot(shot), Some(live)) => {
                    live.push(shot);
                    out.step();
                }
                (Step::Swept, live) => {
                    finished = live
                        .take()
                        .map(|live| live.decide(&file, &entry, &args.needle, weak.clone()));
                }
                (_, None) => {}
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
    // The recording stands; now whether it gave an angle.
    let finished = finished.unwrap_or_else(|| Err(anyhow::anyhow!("no frame arrived")));
    let session = Session::open(recording.folder())?;
    let provenance = ScanProvenance::now(Some((&args.calibration, &calibration)), Some(&rig));
    let with = provenance.clone();
    let mut finished = finished.map_err(|e| {
        super::live::refused(
            e,
            &args.out,
            &session,
            &calibration,
            &args.needle,
            with,
            out,
        )
    })?;
    let result = finished.conclude(
        Some(&args.out),
        &session,
        &calibration,
        &args.needle,
        provenance,
        out,
    )?;
    let after = finished.after.as_secs_f64() * 1000.0;
    let object = json!({
        "frames": scanned.sweep.shots, "planned": scanned.sweep.planned, "stood": scanned.stood,
        "faults": scanned.sweep.complaints(),
        "clock": scanned.sweep.clock.map(|(offset_us, drift)| json!({ "offset_us": offset_us, "drift_ppm": drift * 1e6 })),
        "milliseconds_after_last_frame": after,
        "result": result,
    });
    out.result(&object, || {
        format!(
            "{}\n{} of {} frames; the result stood {after:.1} ms after the last\nwritten: {}",
            measurement_text(&finished.measured),
            scanned.sweep.shots,
            scanned.sweep.planned,
            args.out.display()
        )
    })
}

/// An entry object, or the one of a session.json.
fn read_entry(path: &Path) -> anyhow::Result<Entry> {
    let text = std::fs::read(path).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?;
    let mut value: serde_json::Value =
        serde_json::from_slice(&text).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?;
    if let Some(entry) = value.get_mut("entry") {
        value = entry.take();
    }
    serde_json::from_value(value).map_err(|e| {
        anyhow::anyhow!(
            "{}: {e}; give pixel, vein and radius_mm as in a session.json",
            path.display()
        )
    })
}
