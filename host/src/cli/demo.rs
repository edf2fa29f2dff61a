//! `cannula demo --out DIR`: the whole job on the simulated rig, from homing to the needle: the
//! simulated board behind the real link, the rendered camera on its trigger pin, the same capture
//! and the same pipeline as with hardware; then the errors against the truth.

use super::Output;
use super::job::{Job, NeedleArgs, calibration_text, measurement_text};
use super::live::complain;
use super::rig::{interrupted, make_way, say_homed};
use crate::calibration::LightModel;
use crate::output::{CalibrationFile, ScanProvenance, write_json};
use crate::pipeline::{Calibrated, Measurement, Method, Times, calibrate};
use crate::progress::Progress;
use crate::report;
use crate::rig::acquisition::Acquisition;
use crate::rig::capture::{LightOutcome, PoseOutcome, Step, camera_pose, light_pose, scan};
use crate::rig::config::Rig;
use crate::rig::guide::Guide;
use crate::rig::light_guide::LightGuide;
use crate::rig::open::{self, SIMULATED};
use crate::rig::progress::Part;
use crate::rig::recording::Recording;
use crate::session::Session;
use crate::simulation::compare::{self, Measured, errors, table};
use crate::simulation::mark;
use crate::simulation::{Lit, Profile, Recorded, Subject, Truth, write_truth};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// The folder to write into: session/, calibration.json, cloud.ply, result.json, errors.json,
    /// report.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What the scene is drawn from.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// tiny, nominal or hard.
    #[arg(long, default_value = "nominal")]
    profile: Profile,
    /// Replace a demo that stands there; anything else is left alone.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    needle: NeedleArgs,
}

/// What it writes beside the recording.
const RESULTS: [&str; 7] = [
    "calibration.json",
    "cloud.ply",
    "cloud.xyz",
    "cloud.csv",
    "result.json",
    "errors.json",
    "report.html",
];

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let begun = Instant::now();
    let folder = args.out.join("session");
    let results = RESULTS.map(|name| args.out.join(name));
    let _lock = make_way(&folder, &results, args.force, "demo", || {
        match mark::used(&folder) {
            true => Some(folder.clone()),
            false => results.iter().find(|p| p.exists()).cloned(),
        }
    })?;
    let rig = demo_rig(&args);
    let (truth, renderer) = record(&rig, &folder, out)?;
    let recorded_s = begun.elapsed().as_secs_f64();

    let session = Session::open(&folder)?;
    let times = Times::default();
    let calibrated = calibrate(&session, Method::Ml, &times, out)?;
    let calibration = CalibrationFile::new(&calibrated, &session);
    write_json(&args.out.join("calibration.json"), &calibration)?;
    let job = Job {
        session: &session,
        calibration: &calibration,
        method: Method::Ml,
        args: &args.needle,
        folder: &args.out,
        provenance: ScanProvenance::now(None, Some(&rig)),
        times: &times,
        begun,
        out,
    };
    let mut against_truth = Vec::new();
    let (result, measured) = job.run(|measured| {
        against_truth = against(&renderer, &truth, &calibrated, measured);
        let rows = against_truth.iter().map(|e| report::TruthRow {
            what: e.quantity.to_owned(),
            error: e.error,
            unit: e.unit.to_owned(),
            limit: None,
        });
        rows.collect()
    })?;
    let errors = against_truth;
    let seconds = begun.elapsed().as_secs_f64();
    let object = serde_json::json!({
        "seed": args.seed, "profile": args.profile.name(),
        "seconds": seconds, "seconds_recording": recorded_s,
        "errors": errors, "result": result,
    });
    write_json(&args.out.join("errors.json"), &object)?;
    mark::complete(&folder, &results)?;
    out.result(&object, || {
        format!(
            "{}\n{}\n{}\nwritten: {} ({seconds:.1} s, {recorded_s:.1} of them recording)",
            calibration_text(&calibrated),
            measurement_text(&measured),
            table(&errors),
            args.out.display()
        )
    })
}

/// The errors of calibration and measurement against the truth.
fn against(
    renderer: &crate::simulation::Renderer,
    truth: &Truth,
    calibrated: &Calibrated,
    measured: &Measurement,
) -> Vec<compare::Error> {
    let light = calibrated.light.as_ref().map_or(
        LightModel {
            normal: nalgebra::Vector3::z(),
            a: 0.0,
            b: 0.0,
        },
        |l| l.model,
    );
    let d = &measured.decision;
    let cloud: Vec<_> = measured.cloud.iter().map(|p| p.position).collect();
    errors(
        renderer.scene(),
        truth,
        &Measured {
            camera: calibrated.camera,
            light,
            plane: d.plane,
            entry: d.entry,
            vein: d.direction,
            axis: (d.needle.axis, d.needle.angle),
            cloud: &cloud,
        },
    )
}

/// The rig of the demo: the defaults, with the simulated board and camera.
fn demo_rig(args: &Args) -> Rig {
    let mut rig = Rig::default();
    rig.board.port = SIMULATED.into();
    rig.simulation.seed = args.seed;
    rig.simulation.profile = args.profile.name().into();
    let p = args.profile.parameters();
    rig.light.count = p.light_positions as u32;
    rig.light.spacing_mm = crate::simulation::TRAVEL_MM / (p.light_positions - 1) as f64;
    rig
}

/// Records everything with the simulated rig; gives the truth.
fn record(
    rig: &Rig,
    folder: &Path,
    out: &Output,
) -> anyhow::Result<(Truth, std::sync::Arc<crate::simulation::Renderer>)> {
    let cancel = interrupted()?;
    let mut opened = open::simulated(rig)?;
    opened.board.heed(cancel);
    let stage = opened
        .stage
        .take()
        .ok_or_else(|| anyhow::anyhow!("the simulated rig has no stage"))?;
    let renderer = stage.renderer().clone();
    let scene = renderer.scene();
    let truth = Truth::new(scene).ok_or_else(|| {
        anyhow::anyhow!(
            "seed {}: its hand is out of sight; take another",
            scene.seed
        )
    })?;
    say_homed(open::ready(&opened.board, rig)?, rig, out);

    let size = opened.camera.size();
    let geometry = rig.geometry();
    let mut recording = Recording::open(folder, size, &geometry)?;
    for part in Part::ALL {
        recording.bind(part, rig, false)?;
    }
    mark::begin(folder)?;
    let mut guide = Guide::new(size.0, size.1);
    let mut recorded = Recorded::default();
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), rig, cancel);

    out.start("board poses, camera", scene.camera_poses.len());
    for pose in &scene.camera_poses {
        stage.show(&Subject::Board(*pose));
        match camera_pose(
            &mut acquisition,
            rig.camera.exposure_board_ms,
            &mut recording,
            &mut guide,
            &geometry,
        )? {
            PoseOutcome::Taken { image, .. } => recorded.camera.push((image, *pose)),
            PoseOutcome::NotFound(why) => out.warn(&format!("a pose was left out: {why}")),
        }
        out.step();
    }
    out.finish();
    out.detail(&guide.summary());

    out.start(
        "board poses, laser",
        scene.light_poses.len() * rig.light.count as usize,
    );
    let mut guide = LightGuide::new(size.0, size.1);
    for pose in &scene.light_poses {
        stage.show(&Subject::Board(*pose));
        stage.take_lit();
        match light_pose(
            &mut acquisition,
            rig,
            &mut recording,
            &mut guide,
            &mut || out.step(),
        )? {
            LightOutcome::Taken {
                folder,
                sweep,
                waited,
                ..
            } => {
                complain(&sweep, waited, out);
                recorded
                    .light
                    .push((format!("{folder}/off.png"), *pose, lit(&stage.take_lit())));
            }
            LightOutcome::NotFound(why) => out.warn(&format!("a pose was left out: {why}")),
        }
    }
    out.finish();

    stage.show(&Subject::Hand);
    stage.take_lit();
    recording.manifest.entry = Some(truth.entry.clone());
    out.start("scan", rig.scan.count as usize);
    let scanned = scan(&mut acquisition, rig, &mut recording, false, &mut |step| {
        if matches!(step, Step::Shot(_)) {
            out.step();
        }
        Ok(())
    })?;
    out.finish();
    complain(&scanned.sweep, scanned.waited, out);
    if let Some((_, drift)) = scanned.sweep.clock {
        out.detail(&format!(
            "camera clock against board clock: {:+.1} ppm",
            drift * 1e6
        ));
    }
    recorded.scan = lit(&stage.take_lit());
    write_truth(folder, &renderer, &truth, &recorded)?;
    Ok((truth, renderer))
}

fn lit(frames: &[(f64, f64)]) -> Vec<Lit> {
    frames
        .iter()
        .map(|&(slide_mm, d)| Lit { slide_mm, d })
        .collect()
}
