//! `cannula puncture --angles 30,45,60 --out DIR`: force curves and the decision.

use super::Output;
use super::output::BadArgument;
use crate::progress::Progress;
use crate::puncture::Calibration;
use crate::puncture::decision::{self, Criterion, Reference};
use crate::puncture::output::{PunctureReport, StoppedRun, curve, summary, write};
use crate::puncture::paper_preset;
use crate::puncture::run::{Numerics, puncture};
use crate::puncture::tissue::Setup;
use rayon::prelude::*;
use std::path::PathBuf;
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
    /// Size of a brick where the needle passes, mm.
    #[arg(long, value_name = "MM")]
    mesh: Option<f64>,
}

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
    let mut angles = args.angles.clone();
    if let Some(a) = angles.iter().find(|a| !(10.0..=80.0).contains(*a)) {
        return Err(bad(format!("--angles {a}: give angles from 10° to 80°")));
    }
    // The longest path first: the cores finish together.
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    const PARTS: usize = 50;
    out.start("puncture", PARTS * angles.len());
    let results: Vec<_> = angles
        .par_iter()
        .with_max_len(1)
        .map(|&angle| {
            let told = AtomicUsize::new(0);
            let progress = |share: f64| {
                let now = (share * PARTS as f64) as usize;
                while told.load(Ordering::Relaxed) < now {
                    told.fetch_add(1, Ordering::Relaxed);
                    out.step();
                }
            };
            puncture(&setup, angle, &numerics, &progress)
        })
        .collect();
    out.finish();
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
                    reason: e.to_string(),
                });
            }
        }
    }
    let criterion = match args.criterion.as_str() {
        "constrained" => Criterion::Constrained,
        _ => Criterion::Paper,
    };
    let reference: Vec<Reference> = runs
        .iter()
        .map(|r| Reference {
            angle_deg: r.angle_deg,
            peak_force_n: r.peak_force_n,
            work_n_mm: r.work_n_mm,
        })
        .collect();
    let done: Vec<f64> = runs.iter().map(|r| r.angle_deg).collect();
    let fast = Calibration::stored();
    let Some(decision) = decision::decide(&setup, fast, &done, &reference, criterion) else {
        let reasons: Vec<&str> = stopped.iter().map(|s| s.reason.as_str()).collect();
        anyhow::bail!("no angle could be computed: {}", reasons.join("; "));
    };
    let paper = args.paper_layers.then(|| paper_preset::compare(&runs));
    let report = PunctureReport {
        paper,
        format: "cannula-puncture/1",
        runs,
        stopped,
        decision,
        curves,
        energies,
    };
    write(&report, &args.out)?;
    out.result(&report, || {
        let mut text = String::new();
        for r in &report.runs {
            text += &format!(
                "{:>5}°  peak {:.2} N  path {:.2} mm  work {:.2} N·mm  energy error {:.2} %  kinetic {:.1} %\n",
                r.angle_deg,
                r.peak_force_n,
                r.path_mm,
                r.work_n_mm,
                100.0 * r.quality.energy_error,
                100.0 * r.quality.kinetic_share,
            );
        }
        text += &report.decision.sentence;
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
