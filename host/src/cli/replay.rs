//! `cannula replay SESSION`: a recording's scan played through the acquisition as if it were live:
//! the same matching of frames to triggers, the same reconstruction while frames arrive.

use super::Output;
use super::job::{NeedleArgs, measurement_text};
use super::live::{Live, complain};
use super::rig::interrupted;
use crate::output::{CalibrationFile, ScanProvenance, read_calibration};
use crate::pipeline::{Method, Times, belong_together, calibrate, without_loss};
use crate::progress::Progress;
use crate::rig::acquisition::{Follow, Shot};
use crate::rig::folder::{self, FolderCamera, RecordedLedger, recorded_anchor, trigger_times};
use crate::session::Session;
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// Steps a millimetre for recordings that have none.
const STEPS_PER_MM: f64 = 1000.0;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The recording: a folder with session.json in it.
    session: PathBuf,
    /// The rig's calibration; made from the recording if not given.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Write cloud.ply, result.json and report.html into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    needle: NeedleArgs,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let session = Session::open(&args.session)?;
    super::job::needs_scan(&session)?;
    let (Some(scan), Some(entry)) = (&session.manifest.scan, &session.manifest.entry) else {
        anyhow::bail!("{}: no scan or no entry", session.file().display());
    };
    let calibration = match &args.calibration {
        Some(path) => read_calibration(path)?,
        None => CalibrationFile::new(
            &calibrate(&session, Method::Ml, &Times::default(), out)?,
            &session,
        ),
    };
    let model = calibration.rig().ok_or_else(|| {
        anyhow::anyhow!(
            "{}: no light planes to measure with",
            session.file().display()
        )
    })?;
    let image = session.manifest.image;
    let positions: Vec<f64> = scan.frames.iter().map(|f| f.slide_mm).collect();
    let mut weak = belong_together(
        session.file(),
        (image.width, image.height),
        &model,
        &calibration.positions(),
        &positions,
    )?;
    let mut live = Live::new(model);
    if let Some(ambient) = &scan.ambient {
        live.ambient(&folder::read(&session.path(ambient))?);
    }
    let files = scan
        .frames
        .iter()
        .zip(trigger_times(&scan.frames))
        .map(|(f, time)| (session.path(&f.image), time))
        .collect();
    let mut camera = FolderCamera::of(args.session.display().to_string(), files)?;
    let mut ledger = RecordedLedger::new(&scan.frames, STEPS_PER_MM);
    out.start("replay", scan.frames.len());
    let mut follow = Follow {
        camera: &mut camera,
        cancel: interrupted()?,
        timeout: Duration::from_millis(100),
        laser: true,
        planned: scan.frames.len(),
    };
    let played = follow.run(
        &mut ledger,
        recorded_anchor(&scan.frames),
        &mut |trigger, taken| {
            let slide_mm = scan
                .frames
                .get(trigger.index as usize)
                .map_or(0.0, |f| f.slide_mm);
            let shot = Shot {
                index: trigger.index,
                steps: trigger.position.0.into(),
                slide_mm,
                trigger_us: trigger.time.0,
                laser: trigger.laser,
                picture: taken.picture,
                arrived: taken.arrived,
            };
            live.push(&shot);
            out.step();
            Ok(())
        },
    );
    out.finish();
    let (sweep, _) = played?;
    complain(&sweep, Duration::ZERO, out);
    weak.push(without_loss(&scan.frames));
    let finished = live.decide(session.file(), entry, &args.needle, weak);
    let folder = args.out.as_deref();
    // What rig recorded it is not known; the calibration is, where one was given.
    let file = args.calibration.as_deref();
    let provenance = ScanProvenance::now(file.map(|f| (f, &calibration)), None);
    let with = provenance.clone();
    let needle = &args.needle;
    let mut finished = finished.map_err(|e| match folder {
        Some(folder) => super::live::refused(e, folder, &session, &calibration, needle, with, out),
        None => e,
    })?;
    finished.conclude(folder, &session, &calibration, needle, provenance, out)?;
    let (measured, after) = (&finished.measured, finished.after.as_secs_f64() * 1000.0);
    let object = json!({
        "frames": sweep.shots, "faults": sweep.complaints(), "points": measured.cloud.len(),
        "milliseconds_after_last_frame": after,
        "needle": { "axis": [measured.decision.needle.axis.x, measured.decision.needle.axis.y, measured.decision.needle.axis.z] },
    });
    out.result(&object, || {
        format!(
            "{}\n{} frames; the result stood {after:.1} ms after the last",
            measurement_text(measured),
            sweep.shots,
        )
    })
}
