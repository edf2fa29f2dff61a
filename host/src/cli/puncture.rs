//! `cannula puncture --angles 30,45,60 --out DIR`: force curves and the decision.

use super::Output;
use super::output::BadArgument;
use crate::output::write_whole;
use crate::pipeline::{Stage, Times};
use crate::progress::Progress;
use crate::puncture::Calibration;
use crate::puncture::basis::{Basis, Provenance};
use crate::puncture::decision::{self, Criterion, Reference};
use crate::puncture::fit;
use crate::puncture::output::{
    Convergence, PunctureReport, RunSummary, StoppedRun, curve, summary, write,
};
use crate::puncture::paper_preset;
use crate::puncture::run::{Numerics, Run, puncture};
use crate::puncture::tissue::Setup;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Angles to the skin, degrees, 10 to 80.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "30,45,60",
        value_name = "DEG,…"
    )]
    angles: Vec<f64>,
    /// Where puncture.json and the curves go.
    #[arg(long)]
    out: PathBuf,
    /// How the angle is chosen: lowest peak force (paper), or that under constraints.
    #[arg(long, default_value = "paper", value_parser = ["paper", "constrained"])]
    criterion: String,
    /// Tissue, needle, friction: a TOML file; what is missing keeps its default.
    #[arg(long, value_name = "FILE")]
    tissue: Option<PathBuf>,
    /// Friction between needle and tissue (paper: 0.7).
    #[arg(long)]
    friction: Option<f64>,
    /// The paper's layer thicknesses (from the times in its Figure 26), compared with its figures.
    #[arg(long, conflicts_with = "tissue")]
    paper_layers: bool,
    /// Go on along the vein after the puncture, lowering the needle, mm (paper: 5).
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    along: f64,
    /// Also run each angle with half the steps' size and with half the bricks' size, and print how
    /// far the peak moves. The second takes about 10 times as long as the run itself.
    #[arg(long)]
    convergence: bool,
    /// Instead of comparing angles: run the reference at all angles, frictions and toughnesses that
    /// the fast model is fitted to (minutes), fit it, and write fast_model.json with its residuals.
    #[arg(long, conflicts_with_all = ["convergence", "paper_layers"])]
    fit: bool,
    /// Size of a brick where the needle passes, mm.
    #[arg(long, value_name = "MM")]
    mesh: Option<f64>,
}

/// Angles that the reference can run at, degrees.
pub const SIMULATED_DEG: std::ops::RangeInclusive<f64> = 10.0..=80.0;

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let bad = |s: String| anyhow::Error::new(BadArgument(s));
    let mut setup = match &args.tissue {
        Some(file) => Setup::read(file)?,
        None if args.paper_layers => paper_preset::setup(),
        None => Setup::default(),
    };
    if let Some(f) = args.friction {
        setup.friction = f;
    }
    setup.check().map_err(|e| bad(e.to_string()))?;
    let mut numerics = Numerics::default();
    if args.paper_layers {
        numerics.h_mm = paper_preset::MESH_MM;
    }
    if !(0.0..=20.0).contains(&args.along) {
        return Err(bad(format!("--along {}: give 0 to 20 mm", args.along)));
    }
    numerics.along_vein_mm = args.along;
    if let Some(h) = args.mesh {
        if !(0.08..=0.5).contains(&h) {
            return Err(bad(format!("--mesh {h}: give 0.08 to 0.5 mm")));
        }
        numerics.h_mm = h;
    }
    let usual = Calibration::stored().mesh_mm;
    if numerics.h_mm > 1.01 * usual {
        out.warn(&format!(
            "bricks of {} mm are coarser than the {usual} mm for which the error of the forces was \
             found: it may be several times larger",
            numerics.h_mm
        ));
    }
    if args.fit {
        return fit_fast_model(&setup, &numerics, &args.out, out);
    }
    let mut angles = args.angles.clone();
    if let Some(a) = angles.iter().find(|a| !SIMULATED_DEG.contains(*a)) {
        return Err(bad(format!("--angles {a}: give angles from 10° to 80°")));
    }
    // The longest path first: the cores finish together.
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    let criterion = match args.criterion.as_str() {
        "constrained" => Criterion::Constrained,
        _ => Criterion::Paper,
    };
    let times = Times::default();
    let mut report = times.time(Stage::Puncture, || {
        simulate(&setup, &angles, &numerics, criterion, out)
    })?;
    if args.convergence {
        report.convergence = refine(&setup, &report.runs, &numerics, out);
    }
    report.paper = args
        .paper_layers
        .then(|| paper_preset::compare(&report.runs));
    write(&report, &args.out)?;
    let section = crate::report::punctured(&report, &setup);
    let page = crate::report::of_puncture(section, settings(&report), &times);
    crate::report::write(&page, &args.out.join("report.html"))?;
    out.result(&report, || {
        let mut text = String::new();
        for r in &report.runs {
            text += &format!(
                "{:>5}°  peak {:.2} N  path {:.2} mm  work {:.2} N·mm  energy error {:.2} %  kinetic {:.1} %  {:.0} M brick updates/s\n",
                r.angle_deg,
                r.peak_force_n,
                r.path_mm,
                r.work_n_mm,
                100.0 * r.quality.energy_error,
                100.0 * r.quality.kinetic_share,
                r.quality.brick_updates_per_s * 1e-6,
            );
        }
        text += &report.decision.sentence;
        if !report.convergence.is_empty() {
            text += &format!("\n{}", Convergence::HEAD);
        }
        for c in &report.convergence {
            text += &format!("\n{}", c.say());
        }
        if let Some(paper) = &report.paper {
            for e in &paper.events {
                let ours = e.ours_s.map_or("-".to_owned(), |t| format!("{t:.2}"));
                text += &format!("\n{:>14}  ours {ours} s, paper {:.2} s", e.event, e.paper_s);
            }
            for d in &paper.differences {
                text += &format!("\n{d}");
            }
        }
        text
    })
}

/// The reference simulation at these angles, and the decision between them.
pub fn simulate(
    setup: &Setup,
    angles: &[f64],
    numerics: &Numerics,
    criterion: Criterion,
    out: &Output,
) -> anyhow::Result<PunctureReport> {
    let jobs: Vec<_> = angles.iter().map(|&a| (*setup, a, *numerics)).collect();
    let results = run_all(&jobs, out);
    let (mut runs, mut curves, mut energies) = (Vec::new(), Vec::new(), Vec::new());
    let mut stopped = Vec::new();
    for (&angle_deg, result) in angles.iter().zip(results) {
        match result {
            Ok(run) => {
                runs.push(summary(&run));
                curves.push(curve(&run));
                energies.push(run.samples.iter().map(|s| s.energy).collect());
            }
            Err(e) => {
                out.warn(&format!("{angle_deg}°: {e}"));
                stopped.push(StoppedRun {
                    angle_deg,
                    reason: e,
                });
            }
        }
    }
    let reference: Vec<Reference> = runs
        .iter()
        .map(|r| Reference {
            mesh_mm: numerics.h_mm,
            angle_deg: r.angle_deg,
            peak_force_n: r.peak_force_n,
            work_n_mm: r.work_n_mm,
        })
        .collect();
    let done: Vec<f64> = runs.iter().map(|r| r.angle_deg).collect();
    let fast = Calibration::stored();
    let Some(decision) = decision::decide(setup, fast, &done, &reference, criterion) else {
        let reasons: Vec<&str> = stopped.iter().map(|s| s.reason.as_str()).collect();
        anyhow::bail!("no angle could be computed: {}", reasons.join("; "));
    };
    Ok(PunctureReport {
        convergence: Vec::new(),
        paper: None,
        format: "cannula-puncture/1",
        runs,
        stopped,
        decision,
        provenance: Provenance::now(Basis::new(setup, &done, criterion, true), *numerics),
        curves,
        energies,
    })
}

/// What the runs assumed, for the report.
fn settings(report: &PunctureReport) -> Vec<(String, String)> {
    let mut rows = crate::report::leaves(&report.provenance);
    rows.retain(|(name, _)| !["program", "time"].contains(&name.as_str()));
    rows
}

/// Runs angles side by side, each on one core.
/// A run that stopped, or whose energy does not close, is a reason in words.
fn run_all(jobs: &[(Setup, f64, Numerics)], out: &Output) -> Vec<Result<Run, String>> {
    const PARTS: usize = 50;
    out.start("puncture", PARTS * jobs.len());
    let results = jobs
        .par_iter()
        .with_max_len(1)
        .map(|(setup, angle, numerics)| {
            let told = AtomicUsize::new(0);
            let progress = |share: f64| {
                let now = (share * PARTS as f64) as usize;
                while told.load(Ordering::Relaxed) < now {
                    told.fetch_add(1, Ordering::Relaxed);
                    out.step();
                }
            };
            let run = puncture(setup, *angle, numerics, &progress).map_err(|e| e.to_string())?;
            match run.refusal() {
                Some(reason) => Err(reason),
                None => Ok(run),
            }
        })
        .collect();
    out.finish();
    results
}

/// Runs what the fast model is fitted to, and fits it.
fn fit_fast_model(
    setup: &Setup,
    numerics: &Numerics,
    dir: &Path,
    out: &Output,
) -> anyhow::Result<()> {
    let jobs: Vec<_> = fit::CASES
        .iter()
        .map(|&(angle, friction, toughness)| {
            (fit::setup_of(setup, friction, toughness), angle, *numerics)
        })
        .collect();
    let results = run_all(&jobs, out);
    let mut curves = Vec::new();
    for (&(angle, friction, toughness), result) in fit::CASES.iter().zip(results) {
        let case = format!("{angle}°, friction {friction}, toughness × {toughness}");
        let run = result.map_err(|e| anyhow::anyhow!("{case}: {e}"))?;
        curves.push(fit::ReferenceCurve::new(&run, friction, toughness));
    }
    let mesh_error = Calibration::stored().mesh_error;
    let fitted = fit::fit(setup, &curves, numerics.h_mm, mesh_error);
    let json = serde_json::to_string_pretty(&fitted)? + "\n";
    write_whole(&dir.join("fast_model.json"), |f| {
        f.write_all(json.as_bytes())
    })?;
    out.result(&fitted, || {
        let mut text = String::from("angle  friction  toughness  reference N  fast N\n");
        for r in &fitted.residuals {
            text += &format!(
                "{:>5}  {:<8}  {:<9}  {:<11.3}  {:.3} ({:+.1} %)\n",
                r.angle_deg,
                r.friction,
                r.toughness,
                r.peak_reference_n,
                r.peak_fast_n,
                100.0 * (r.peak_fast_n / r.peak_reference_n - 1.0)
            );
        }
        text + &format!("RMS of the peaks {:.1} %", 100.0 * fitted.peak_error)
    })
}

/// The same angles with smaller steps and smaller bricks.
fn refine(
    setup: &Setup,
    runs: &[RunSummary],
    numerics: &Numerics,
    out: &Output,
) -> Vec<Convergence> {
    let mut jobs = Vec::new();
    for r in runs {
        let finer = [
            Numerics {
                advance: 0.5 * numerics.advance,
                ..*numerics
            },
            Numerics {
                h_mm: 0.5 * numerics.h_mm,
                ..*numerics
            },
        ];
        jobs.extend(finer.map(|n| (*setup, r.angle_deg, n)));
    }
    let results = run_all(&jobs, out);
    runs.iter()
        .zip(results.chunks(2))
        .map(|(r, pair)| {
            let finer = |k: usize| pair.get(k).and_then(|p| p.as_ref().ok());
            Convergence::of(r, numerics.h_mm, finer(0), finer(1))
        })
        .collect()
}
