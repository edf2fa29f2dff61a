//! puncture.json and the curves beside it (contract.md).

use super::basis::Provenance;
use super::decision::Decision;
use super::events::{Event, events, smooth};
use super::paper_preset::Comparison;
use super::run::{Energy, Run};
use crate::output::write_whole;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// One run as it stands in puncture.json.
#[derive(Clone, Debug, Serialize)]
pub struct RunSummary {
    /// Angle to the surface, degrees.
    pub angle_deg: f64,
    /// Largest axial force, averaged over 0.3 mm of path, N.
    pub peak_force_n: f64,
    /// From first contact to the end, s.
    pub duration_s: f64,
    /// Path of the tip, mm.
    pub path_mm: f64,
    /// Work of the needle, N·mm.
    pub work_n_mm: f64,
    /// Contact and puncture of each layer.
    pub events: Vec<Event>,
    /// File of the curve.
    pub curve: String,
    /// Smallest distance from tip to far wall, mm.
    pub far_wall_mm: f64,
    /// The tip came to the far wall before the end.
    pub transfixed: bool,
    /// How well it was computed.
    pub quality: Quality,
}

/// How well a run was computed.
#[derive(Clone, Debug, Serialize)]
pub struct Quality {
    /// Largest missing share of energy.
    pub energy_error: f64,
    /// Largest kinetic energy as a share of internal energy.
    pub kinetic_share: f64,
    /// Bricks.
    pub bricks: usize,
    /// Steps.
    pub steps: usize,
    /// Wall time, s.
    pub seconds: f64,
    /// Brick updates per second.
    pub brick_updates_per_s: f64,
    /// Most bricks on the stabilised branch at a time.
    pub stabilised_bricks: usize,
    /// Smallest and largest det F.
    pub det_f: [f64; 2],
}

/// A point of a curve, for the report.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Since first contact, s.
    pub time_s: f64,
    /// Depth of the tip below the undeformed surface, mm.
    pub depth_mm: f64,
    /// Overall axial force, N.
    pub force_n: f64,
    /// By layer, N.
    pub skin_n: f64,
    /// By layer, N.
    pub fat_n: f64,
    /// By layer, N.
    pub vein_n: f64,
}

/// What `cannula puncture` found: everything for puncture.json and the report.
#[derive(Clone, Debug, Serialize)]
pub struct PunctureReport {
    /// "cannula-puncture/1".
    pub format: &'static str,
    /// Runs of the reference solver.
    pub runs: Vec<RunSummary>,
    /// Angles whose run stopped or was refused, with the reason.
    pub stopped: Vec<StoppedRun>,
    /// The decision.
    pub decision: Decision,
    /// Refinement, if asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub convergence: Vec<Convergence>,
    /// The paper's figures beside ours, if its layers were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<Comparison>,
    /// How it came about.
    pub provenance: Provenance,
    /// Curves of the runs, in their order (in files of their own, not in the JSON).
    #[serde(skip)]
    pub curves: Vec<Vec<CurvePoint>>,
    /// Energies of the runs at the curves' points.
    #[serde(skip)]
    pub energies: Vec<Vec<Energy>>,
}

/// How far a peak moves under refinement, and what that costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Convergence {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Brick of the run, mm.
    pub mesh_mm: f64,
    /// Its peak, N.
    pub peak_force_n: f64,
    /// With half the step (twice the steps, a quarter of the mass); None if that run stopped.
    pub peak_half_step_n: Option<f64>,
    /// With half the brick; None if that run stopped.
    pub peak_half_mesh_n: Option<f64>,
    /// Brick updates with half the brick over those of the run: 16 is the fourth power.
    pub updates_ratio: Option<f64>,
    /// Wall time with half the brick over that of the run.
    pub seconds_ratio: Option<f64>,
}

impl Convergence {
    /// A run beside the same with half the step and with half the brick (None: it stopped).
    pub fn of(
        run: &RunSummary,
        mesh_mm: f64,
        half_step: Option<&Run>,
        half_mesh: Option<&Run>,
    ) -> Self {
        let (half_step, half_mesh) = (half_step.map(summary), half_mesh.map(summary));
        let updates = |q: &Quality| q.bricks as f64 * q.steps as f64;
        let ratio = |f: &dyn Fn(&Quality) -> f64| {
            let finer = half_mesh.as_ref()?;
            Some(f(&finer.quality) / f(&run.quality).max(1e-12))
        };
        Self {
            angle_deg: run.angle_deg,
            mesh_mm,
            peak_force_n: run.peak_force_n,
            peak_half_step_n: half_step.map(|r| r.peak_force_n),
            updates_ratio: ratio(&updates),
            seconds_ratio: ratio(&|q| q.seconds),
            peak_half_mesh_n: half_mesh.map(|r| r.peak_force_n),
        }
    }

    /// Head of the table.
    pub const HEAD: &str = "angle   mesh mm  peak N   half step        half mesh        cost";

    /// A line of the table.
    pub fn say(&self) -> String {
        let part = |peak: Option<f64>| match peak {
            Some(p) => format!(
                "{p:.3} ({:+.1} %)",
                100.0 * (p / self.peak_force_n.max(1e-12) - 1.0)
            ),
            None => "stopped".to_owned(),
        };
        let cost = match (self.updates_ratio, self.seconds_ratio) {
            (Some(u), Some(s)) => format!("×{u:.1} brick updates, ×{s:.1} seconds"),
            _ => String::new(),
        };
        format!(
            "{:>5}°  {:<7}  {:<7.3}  {:<15}  {:<15}  {cost}",
            self.angle_deg,
            self.mesh_mm,
            self.peak_force_n,
            part(self.peak_half_step_n),
            part(self.peak_half_mesh_n)
        )
    }
}

/// A run that stopped, or whose energy does not close.
#[derive(Clone, Debug, Serialize)]
pub struct StoppedRun {
    /// Its angle, degrees.
    pub angle_deg: f64,
    /// Why it stopped.
    pub reason: String,
}

/// Name of an angle's curve: curve_30.csv, curve_22.5.csv.
pub fn curve_name(angle_deg: f64) -> String {
    format!("curve_{angle_deg}.csv")
}

/// A run's summary.
pub fn summary(run: &Run) -> RunSummary {
    let smooth = smooth(&run.samples);
    let last = run.samples.last().copied().unwrap_or_default();
    RunSummary {
        angle_deg: run.angle_deg,
        peak_force_n: smooth.iter().map(|s| s.force_n).fold(0.0, f64::max),
        duration_s: last.time_s,
        path_mm: last.path_mm,
        work_n_mm: last.energy.needle,
        events: events(run),
        curve: curve_name(run.angle_deg),
        far_wall_mm: run.far_wall_mm,
        transfixed: run.transfixed,
        quality: Quality {
            energy_error: run.energy_error(),
            kinetic_share: run.kinetic_share(),
            bricks: run.bricks,
            steps: run.steps,
            seconds: run.seconds,
            brick_updates_per_s: run.bricks as f64 * run.steps as f64 / run.seconds.max(1e-9),
            stabilised_bricks: run.stabilised,
            det_f: [run.j_range.0, run.j_range.1],
        },
    }
}

/// A run's curve.
pub fn curve(run: &Run) -> Vec<CurvePoint> {
    run.samples
        .iter()
        .map(|s| CurvePoint {
            time_s: s.time_s,
            depth_mm: s.depth_mm,
            force_n: s.force_n,
            skin_n: s.by_region[0],
            fat_n: s.by_region[1],
            vein_n: s.by_region[2] + s.by_region[3],
        })
        .collect()
}

/// Writes puncture.json and the curves, each whole or not at all.
///
/// # Errors
/// A file can't be written.
pub fn write(report: &PunctureReport, dir: &Path) -> anyhow::Result<()> {
    for (run, curve) in report.runs.iter().zip(&report.curves) {
        let mut text = String::from("time_s,depth_mm,force_n,skin_n,fat_n,vein_n\n");
        for p in curve {
            writeln!(
                text,
                "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6}",
                p.time_s, p.depth_mm, p.force_n, p.skin_n, p.fat_n, p.vein_n
            )?;
        }
        write_whole(&dir.join(&run.curve), |f| f.write_all(text.as_bytes()))?;
    }
    let json = serde_json::to_string_pretty(report)? + "\n";
    write_whole(&dir.join("puncture.json"), |f| f.write_all(json.as_bytes()))?;
    Ok(())
}
