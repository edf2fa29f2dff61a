//! Checks of the solved light planes: each position on its own, the paper's Tables 1, 2, 4 and
//! Figure 14 for this rig, and each position predicted from all others.
//!
//! All from the normal equations at the solution: taking a position's stripes out of them and
//! solving again gives what the solve would have found without (to first order, and the residuals
//! are small), camera and poses included, so nothing of the position leaks into its prediction.

use super::joint::{Rig, StripeNoise, add_strand};
use super::strand::{Drawn, Strand};
use super::tables::{self, Offset, Spacing};
use super::{LightError, SinglePlane};
use crate::calibration::PARAMETERS;
use crate::calibration::loss::Measures;
use crate::calibration::solve::{Block, Cholesky, System};
use crate::geometry::{PARAMETERS as CAMERA, Pose};

/// Index of b: moving it moves the plane by as much.
const B: usize = PARAMETERS - 1;

/// A solved problem.
pub(super) struct Solution<'a> {
    pub rig: &'a Rig,
    /// Poses of the light views.
    pub poses: &'a [Pose],
    pub system: &'a System<PARAMETERS>,
    /// Index of the first light view among the system's views.
    pub first_light_view: usize,
    pub noise: &'a StripeNoise,
    pub positions: &'a [f64],
    pub travels: bool,
}

/// What the checks found.
pub(super) struct Report {
    pub planes: Vec<SinglePlane>,
    pub spacings: Vec<Spacing>,
    pub offsets: Vec<Offset>,
    pub hold_out_mm: Vec<f64>,
    pub views: Vec<(Measures, Measures)>,
    pub positions: Vec<(Measures, Measures)>,
    pub stripe_rms_px: f64,
    /// χ² (three degrees of freedom) of each own plane against the common one.
    pub disagreement: Vec<f64>,
    /// Mean distance of each strand's centres, outliers included, from its plane, mm, signed.
    pub strand_mm: Vec<f64>,
    /// Part of each strand's centres that carry weight.
    pub strand_used: Vec<f64>,
}

pub(super) fn check(
    solution: &Solution,
    strands: &mut [Strand],
    begun: &Rig,
    begun_poses: &[Pose],
) -> Result<Report, LightError> {
    let rig = solution.rig;
    let n = solution.positions.len();
    let mut blocks = Vec::with_capacity(strands.len());
    for strand in strands.iter() {
        let mut block = Block::zero();
        if !add_strand(
            strand,
            rig,
            &solution.poses[strand.view],
            solution.noise,
            &mut block,
        ) {
            return Err(LightError::NoSolution);
        }
        blocks.push(block);
    }

    let mut planes = Vec::with_capacity(n);
    let mut fitted = Vec::with_capacity(n);
    let mut disagreement = Vec::with_capacity(n);
    for (i, &x) in solution.positions.iter().enumerate() {
        let (mut h, mut g) = ([[0.0; 3]; 3], [0.0; 3]);
        let index = [CAMERA, CAMERA + 1, B];
        for (block, _) in blocks
            .iter()
            .zip(strands.iter())
            .filter(|(_, s)| s.position == i)
        {
            for (r, &p) in index.iter().enumerate() {
                for (c, &q) in index.iter().enumerate() {
                    h[r][c] += block.gg[p][q];
                }
                g[r] += block.g[p];
            }
        }
        let d = rig.light.a * x + rig.light.b;
        // With the common normal (Table 4), and with a normal of its own.
        fitted.push((
            x,
            if h[2][2] > 0.0 {
                d - g[2] / h[2][2]
            } else {
                f64::NAN
            },
        ));
        let own = Cholesky::new(&h).map(|f| f.solve(&g).map(|s| -s));
        let step = own.unwrap_or([0.0, 0.0, fitted[i].1 - d]);
        let model = rig.light.updated(&[step[0], step[1], 0.0, step[2]]);
        disagreement.push(-(0..3).map(|k| step[k] * g[k]).sum::<f64>());
        let (mut points, mut sum) = (0, 0.0);
        for strand in strands.iter().filter(|s| s.position == i) {
            for_each_mm(strand, solution, &mut |r, j| {
                let shift = j[CAMERA] * step[0] + j[CAMERA + 1] * step[1] + j[B] * step[2];
                points += 1;
                sum += ((r + shift) / j[B]).powi(2);
            });
        }
        planes.push(SinglePlane {
            slide_mm: x,
            plane: model.plane(x),
            points,
            rms_mm: (sum / points.max(1) as f64).sqrt(),
        });
    }
    fitted.retain(|f| f.1.is_finite());

    let (mut views, mut positions) = (
        vec![(Measures::default(), Measures::default()); solution.poses.len()],
        vec![(Measures::default(), Measures::default()); n],
    );
    let mut squared = 0.0;
    let mut count = 0usize;
    let mut strand_mm = Vec::with_capacity(strands.len());
    let mut strand_used = Vec::with_capacity(strands.len());
    for strand in strands.iter() {
        let (mut after, mut used) = (Measures::default(), 0usize);
        for_each_mm(strand, solution, &mut |r, j| {
            gather(&mut after, r, r / j[B]);
            used += 1;
        });
        squared += after.reprojection_px2;
        count += used;
        strand_used.push(used as f64 / strand.len().max(1) as f64);
        strand_mm.push(all_mm(strand, solution));
        add(&mut views[strand.view].1, &after);
        add(&mut positions[strand.position].1, &after);
    }
    // The same centres under the closed-form start.
    for strand in strands.iter_mut() {
        let drawn = Drawn::new(
            &begun.camera,
            &begun.light,
            strand.slide_mm,
            &begun_poses[strand.view],
        );
        if !drawn.is_some_and(|drawn| strand.measure(&drawn)) {
            continue;
        }
        let mut before = Measures::default();
        for_each_mm(strand, solution, &mut |r, j| {
            gather(&mut before, r, r / j[B])
        });
        add(&mut views[strand.view].0, &before);
        add(&mut positions[strand.position].0, &before);
    }
    for (before, after) in views.iter_mut().chain(&mut positions) {
        before.plane_mm /= before.points.max(1) as f64;
        after.plane_mm /= after.points.max(1) as f64;
    }

    let offsets = tables::offsets(rig.light.a, rig.light.b, &fitted);
    Ok(Report {
        planes,
        spacings: tables::spacings(&rig.light.normal, &fitted),
        offsets,
        hold_out_mm: hold_out(solution, strands, &blocks),
        views,
        positions,
        stripe_rms_px: (squared / count.max(1) as f64).sqrt(),
        disagreement,
        strand_mm,
        strand_used,
    })
}

/// Calls f(residual in px, derivatives by the globals) for each centre in use.
fn for_each_mm(strand: &Strand, solution: &Solution, f: &mut impl FnMut(f64, &[f64; PARAMETERS])) {
    let derivatives = derivatives(strand, solution);
    strand.each(|k, r| {
        if let Some(j) = &derivatives[k] {
            f(r, j);
        }
    });
}

fn derivatives(strand: &Strand, solution: &Solution) -> Vec<Option<[f64; PARAMETERS]>> {
    let rig = solution.rig;
    let drawn = Drawn::new(
        &rig.camera,
        &rig.light,
        strand.slide_mm,
        &solution.poses[strand.view],
    );
    strand
        .pieces
        .iter()
        .map(|piece| {
            let drawn = drawn.as_ref()?;
            let j = drawn.derivatives(&drawn.near(&piece.pixel)?)?.globals;
            (j[B] != 0.0).then_some(j)
        })
        .collect()
}

/// Mean signed distance of all centres, whatever their weight, mm.
fn all_mm(strand: &Strand, solution: &Solution) -> f64 {
    let rig = solution.rig;
    let Some(drawn) = Drawn::new(
        &rig.camera,
        &rig.light,
        strand.slide_mm,
        &solution.poses[strand.view],
    ) else {
        return f64::NAN;
    };
    let distances: Vec<f64> = strand
        .pieces
        .iter()
        .filter_map(|piece| {
            let local = drawn.near(&piece.pivot)?;
            let j = drawn.derivatives(&local)?.globals[B];
            Some(-local.normal.dot(&(piece.pivot - local.pixel)) / j)
        })
        .collect();
    distances.iter().sum::<f64>() / distances.len().max(1) as f64
}

fn gather(m: &mut Measures, r: f64, mm: f64) {
    m.points += 1;
    m.reprojection_px2 += r * r;
    m.plane_mm += mm.abs(); // a sum until the end
}

fn add(to: &mut Measures, from: &Measures) {
    to.points += from.points;
    to.reprojection_px2 += from.reprojection_px2;
    to.plane_mm += from.plane_mm;
}

/// |D predicted − D fitted| of each position, the prediction made without it.
fn hold_out(solution: &Solution, strands: &[Strand], blocks: &[Block<PARAMETERS>]) -> Vec<f64> {
    if solution.positions.len() < 3 {
        return Vec::new();
    }
    let mut out = Vec::with_capacity(solution.positions.len());
    for i in 0..solution.positions.len() {
        let mine = || strands.iter().zip(blocks).filter(|(s, _)| s.position == i);
        let mut without = solution.system.clone();
        for (strand, block) in mine() {
            without.views[solution.first_light_view + strand.view].add(block, -1.0);
        }
        let Some(step) = without.step(0.0) else {
            continue;
        };
        let (mut gradient, mut curvature) = (0.0, 0.0);
        for (strand, block) in mine() {
            let pose = &step.poses[solution.first_light_view + strand.view];
            gradient += block.g[B];
            for (h, s) in block.gg[B].iter().zip(&step.globals) {
                gradient += h * s;
            }
            for (h, s) in block.gp[B].iter().zip(pose) {
                gradient += h * s;
            }
            curvature += block.gg[B][B];
        }
        if curvature > 0.0 {
            out.push((gradient / curvature).abs());
        }
    }
    out
}
