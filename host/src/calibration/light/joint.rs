//! The joint maximum-likelihood solve: camera, board poses, common normal, a and b from corners and
//! stripes at once (bundle adjustment of camera views and light views).

use super::check::{self, Solution};
use super::strand::{Drawn, Strand};
use super::{
    CameraData, LightCalibration, LightError, LightView, NoiseLevels, Options, gate, start,
};
use crate::board::BoardGeometry;
use crate::calibration::camera::{
    CameraCalibration, add_distortion_prior, board_points, distortion_prior,
};
use crate::calibration::corners::{CornerView, Residuals};
use crate::calibration::finding::Severity;
use crate::calibration::plane_pose::pose_through;
use crate::calibration::solve::{Block, Cholesky, POSE, Problem, Stop, System, minimise};
use crate::calibration::{Covariance, LightModel, PARAMETERS};
use crate::geometry::{Camera, PARAMETERS as CAMERA, Pose};
use crate::simd::widest;

/// Board poses with a stripe that a plane needs.
const LEAST_VIEWS: usize = 2;
/// Positions that differ by less than this part of the whole travel are the same one.
const SAME_POSITION: f64 = 1e-3;
/// Travel below which the slide stood still, mm (or whatever the positions were given in).
const LEAST_TRAVEL: f64 = 0.005;
/// Median of a χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936_4;
/// Index of b among the parameters: the offset of the plane.
const B: usize = PARAMETERS - 1;

/// Camera and light together.
#[derive(Clone, Debug)]
pub(super) struct Rig {
    pub camera: Camera,
    pub light: LightModel,
}

/// Errors of the stripes: variances in units of the centres' own, and in px².
#[derive(Clone, Copy, Debug)]
pub(super) struct StripeNoise {
    /// Of a centre, in units of its own variance.
    pub centre: f64,
    /// Common to a piece, px².
    pub piece: f64,
    /// Common to a stripe, px².
    pub stripe: f64,
}

impl StripeNoise {
    /// Information of a piece's pixel beside the stripe's common error, 1/px².
    pub fn piece_information(&self, information: f64) -> f64 {
        if information > 0.0 {
            1.0 / (self.centre / information + self.piece)
        } else {
            0.0
        }
    }
}

/// Adds a stripe's pieces to the normal equations of its view; false if it can't be drawn.
///
/// The common error is eliminated (Sherman & Morrison): with C = diag(1/ω) + τ²·1·1ᵀ,
/// JᵀC⁻¹J = Σ ω·JᵀJ − κ·(Σ ω·J)ᵀ(Σ ω·J), κ = τ²/(1 + τ²·Σ ω).
pub(super) fn add_strand(
    strand: &Strand,
    rig: &Rig,
    pose: &Pose,
    noise: &StripeNoise,
    block: &mut Block<PARAMETERS>,
) -> bool {
    let mut done = false;
    widest(
        #[inline(always)]
        || done = add_pieces(strand, rig, pose, noise, block),
    );
    done
}

#[inline(always)]
fn add_pieces(
    strand: &Strand,
    rig: &Rig,
    pose: &Pose,
    noise: &StripeNoise,
    block: &mut Block<PARAMETERS>,
) -> bool {
    let Some(drawn) = Drawn::new(&rig.camera, &rig.light, strand.slide_mm, pose) else {
        return false;
    };
    let mut sum_globals = [0.0; PARAMETERS];
    let mut sum_pose = [0.0; POSE];
    let (mut sum, mut sum_r) = (0.0, 0.0);
    for piece in &strand.pieces {
        let w = noise.piece_information(piece.information);
        if w <= 0.0 {
            continue;
        }
        let Some(local) = drawn.near(&piece.pixel) else {
            return false;
        };
        let Some(j) = drawn.derivatives(&local) else {
            return false;
        };
        let r = local.normal.dot(&(piece.pixel - local.pixel));
        block.add_row(&j.globals, &j.pose, r, w);
        block.cost += w * r * r;
        for (s, j) in sum_globals.iter_mut().zip(&j.globals) {
            *s += w * j;
        }
        for (s, j) in sum_pose.iter_mut().zip(&j.pose) {
            *s += w * j;
        }
        sum += w;
        sum_r += w * r;
    }
    if sum > 0.0 && noise.stripe > 0.0 {
        let kappa = noise.stripe / (1.0 + noise.stripe * sum);
        // One row of weight −κ with everything divided by its own residual would do the same.
        block.add_row(&sum_globals, &sum_pose, sum_r, -kappa);
        block.cost -= kappa * sum_r * sum_r;
    }
    true
}

/// What is known of the camera besides the light views.
enum Known {
    /// Its own views, and a weak prior on the distortion.
    Views([f64; 5]),
    /// A prior: the camera and its information matrix.
    Prior(Box<(Camera, [[f64; CAMERA]; CAMERA])>),
}

/// Camera views first, then light views.
struct JointProblem<'a> {
    camera_views: &'a [CornerView],
    light_views: &'a [CornerView],
    strands: &'a [Strand],
    /// Strands of each light view.
    of_view: &'a [Vec<usize>],
    corner_scale: f64,
    noise: StripeNoise,
    known: &'a Known,
    travels: bool,
}

impl Problem<PARAMETERS> for JointProblem<'_> {
    type Globals = Rig;

    fn views(&self) -> usize {
        self.camera_views.len() + self.light_views.len()
    }

    fn linearise(
        &self,
        view: usize,
        rig: &Rig,
        pose: &Pose,
        block: &mut Block<PARAMETERS>,
    ) -> bool {
        let own = self.camera_views.len();
        if view < own {
            return self.camera_views[view].linearise(&rig.camera, pose, self.corner_scale, block);
        }
        let view = view - own;
        self.light_views[view].linearise(&rig.camera, pose, self.corner_scale, block)
            && self.of_view[view]
                .iter()
                .all(|&k| add_strand(&self.strands[k], rig, pose, &self.noise, block))
    }

    fn prior(&self, rig: &Rig, block: &mut Block<PARAMETERS>) {
        match self.known {
            Known::Views(sigma) => add_distortion_prior(&rig.camera, sigma, block),
            Known::Prior(known) => {
                let (camera, information) = &**known;
                let (p, q) = (rig.camera.parameters(), camera.parameters());
                for i in 0..CAMERA {
                    for k in 0..CAMERA {
                        let d = information[i][k] * (p[k] - q[k]);
                        block.gg[i][k] += information[i][k];
                        block.g[i] += d;
                        block.cost += (p[i] - q[i]) * d;
                    }
                }
            }
        }
    }

    fn updated(&self, rig: &Rig, step: &[f64; PARAMETERS]) -> Rig {
        let mut p = rig.camera.parameters();
        for (p, s) in p.iter_mut().zip(step) {
            *p += s;
        }
        Rig {
            camera: rig.camera.with_parameters(&p),
            light: rig
                .light
                .updated(&[step[CAMERA], step[CAMERA + 1], step[CAMERA + 2], step[B]]),
        }
    }

    fn held(&self) -> [bool; PARAMETERS] {
        let mut held = [false; PARAMETERS];
        held[CAMERA + 2] = !self.travels;
        held
    }
}

/// Calibrates the light planes, and refines the camera with them.
///
/// `camera` is the result of [`crate::calibration::camera::calibrate`]; `data` says which views it
/// came from. `views` are the light poses; stripes without points are allowed.
pub fn calibrate(
    camera: &CameraCalibration,
    data: CameraData,
    views: &[LightView],
    board: &BoardGeometry,
    options: Options,
) -> Result<LightCalibration, LightError> {
    let (positions, position_of) = positions(views)?;
    let travels = positions.len() > 1;
    // A light view whose corners did not fit the camera's other views has no pose to trust.
    let good = |view: usize| match data {
        CameraData::Views(own) => camera.used.get(own.len() + view) != Some(&false),
        CameraData::Prior => true,
    };
    let light_corners = views
        .iter()
        .enumerate()
        .map(|(view, v)| {
            let needed = board.corners();
            CornerView::new(&v.corners, board)
                .filter(|c| c.len() == needed)
                .map(|c| if good(view) { c } else { c.set_aside() })
                .ok_or(LightError::BadCorners { view, needed })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let plane = board_points(board);
    let pose_of = |corners: &[crate::board::Corner]| {
        let pixels: Vec<_> = corners.iter().map(|c| c.pixel).collect();
        pose_through(&camera.camera, &plane, &pixels)
    };

    let mut strands = Vec::new();
    let mut of_view = vec![Vec::new(); views.len()];
    for (v, view) in views.iter().enumerate().filter(|(v, _)| good(*v)) {
        for (k, stripe) in view.stripes.iter().enumerate() {
            let strand = Strand::new(v, position_of[v][k], stripe);
            if strand.len() > 0 {
                of_view[v].push(strands.len());
                strands.push(strand);
            }
        }
    }
    let showing = of_view.iter().filter(|s| !s.is_empty()).count();
    if showing < LEAST_VIEWS {
        return Err(LightError::TooFewViews {
            views: showing,
            needed: LEAST_VIEWS,
        });
    }

    // Camera views and their poses.
    let mut camera_corners = Vec::new();
    let mut poses = Vec::new();
    let known = match data {
        CameraData::Views(own) => {
            for (i, corners) in own.iter().enumerate() {
                if camera.used.get(i) == Some(&false) {
                    continue;
                }
                if let Some(prepared) = CornerView::new(corners, board)
                    && prepared.len() == board.corners()
                    && let Some(pose) = pose_of(corners)
                {
                    camera_corners.push(prepared);
                    poses.push(pose);
                }
            }
            Known::Views(distortion_prior(&camera.camera))
        }
        CameraData::Prior => Known::Prior(Box::new((
            camera.camera,
            inverse(&camera.covariance).ok_or(LightError::NoSolution)?,
        ))),
    };
    let own = camera_corners.len();
    for v in views {
        poses.push(pose_of(&v.corners).ok_or(LightError::NoSolution)?);
    }

    let first = start::start(&camera.camera, &strands, &poses[own..], &positions)
        .ok_or(LightError::OneLine)?;
    let begun = (
        Rig {
            camera: camera.camera,
            light: first,
        },
        poses[own..].to_vec(),
    );
    let mut rig = begun.0.clone();
    let mut corner_scale = camera.variance_factor.sqrt().max(1e-6);
    let corner_count: usize = camera_corners
        .iter()
        .chain(&light_corners)
        .map(|c| c.len())
        .sum();
    let mut noise = StripeNoise {
        centre: 1.0,
        piece: 0.0,
        stripe: 0.0,
    };
    let mut last: Option<System<PARAMETERS>> = None;
    // Weights and noise from the residuals, then the solve; at the end only the weights.
    for (round, step_sigma) in [0.3, 0.1, 0.01].into_iter().enumerate() {
        noise.centre = refresh(&mut strands, &rig, &poses[own..])?;
        if round > 0 {
            components(&strands, &rig, &poses[own..], &mut noise);
            corner_scale =
                corner_residuals(&camera_corners, &light_corners, &rig, &poses, corner_scale)
                    .variance(PARAMETERS + POSE * poses.len())
                    .sqrt()
                    .max(1e-6);
        }
        let problem = JointProblem {
            camera_views: &camera_corners,
            light_views: &light_corners,
            strands: &strands,
            of_view: &of_view,
            corner_scale,
            noise,
            known: &known,
            travels,
        };
        let stop = Stop {
            iterations: 30,
            step_sigma,
            residuals: 2 * corner_count + strands.iter().map(|s| s.pieces.len()).sum::<usize>(),
        };
        last = minimise(&problem, &mut rig, &mut poses, &stop);
        if last.is_none() {
            return Err(LightError::NoSolution);
        }
    }
    let system = last.ok_or(LightError::NoSolution)?;
    let residuals = corner_residuals(&camera_corners, &light_corners, &rig, &poses, corner_scale);
    let covariance = system
        .covariance()
        .map(|c| Covariance::from_fn(|i, k| c[i][k]))
        .ok_or(LightError::OneLine)?;

    refresh(&mut strands, &rig, &poses[own..])?;
    let solution = Solution {
        rig: &rig,
        poses: &poses[own..],
        system: &system,
        first_light_view: own,
        noise: &noise,
        positions: &positions,
        travels,
    };
    let report = check::check(&solution, &mut strands, &begun.0, &begun.1)?;
    let gate = gate::examine(&gate::Evidence {
        solution: &solution,
        covariance: &covariance,
        report: &report,
        strands: &strands,
        board,
        options,
    });
    let refused = gate.findings.iter().any(|f| f.severity == Severity::Refuse);
    let found = LightCalibration {
        model: rig.light,
        travels,
        camera: rig.camera,
        covariance,
        planes: report.planes,
        spacing_error_mm: super::tables::spacing_error(&report.spacings),
        spacings: report.spacings,
        offset_error_mm: super::tables::offset_error(&report.offsets),
        offsets: report.offsets,
        hold_out_mm: report.hold_out_mm,
        view_measures: report.views,
        position_measures: report.positions,
        stripe_rms_px: report.stripe_rms_px,
        corner_rms_px: residuals.rms_px(),
        noise: NoiseLevels {
            corner_scale,
            stripe_scale: noise.centre.sqrt(),
            piece_px: noise.piece.sqrt(),
            stripe_px: noise.stripe.sqrt(),
        },
        poses: poses.split_off(own),
        findings: gate.findings,
        checks: gate.checks,
    };
    if refused {
        return Err(LightError::Refused(found.findings.clone(), Box::new(found)));
    }
    Ok(found)
}

/// The slide's positions, ascending, and which of them each stripe of each view belongs to.
fn positions(views: &[LightView]) -> Result<(Vec<f64>, Vec<Vec<usize>>), LightError> {
    let mut all = Vec::new();
    for (view, v) in views.iter().enumerate() {
        for stripe in &v.stripes {
            if !stripe.slide_mm.is_finite() {
                return Err(LightError::BadPosition { view });
            }
            if !stripe.points.is_empty() {
                all.push(stripe.slide_mm);
            }
        }
    }
    all.sort_by(f64::total_cmp);
    let travel = all.last().zip(all.first()).map_or(0.0, |(b, a)| b - a);
    let tolerance = if travel < LEAST_TRAVEL {
        f64::INFINITY
    } else {
        SAME_POSITION * travel
    };
    // Each position is the mean of the readings taken at it.
    let mut groups: Vec<(f64, f64, usize)> = Vec::new(); // last reading, sum, count
    for x in all {
        match groups.last_mut() {
            Some(g) if x - g.0 <= tolerance => *g = (x, g.1 + x, g.2 + 1),
            _ => groups.push((x, x, 1)),
        }
    }
    let of = views
        .iter()
        .map(|v| {
            v.stripes
                .iter()
                .map(|s| groups.partition_point(|g| g.0 < s.slide_mm))
                .collect()
        })
        .collect();
    let positions = groups.iter().map(|g| g.1 / g.2 as f64).collect();
    Ok((positions, of))
}

/// Measures all stripes under the model, weighs their centres, sums up their pieces. Returns the
/// variance of a centre in units of its own.
fn refresh(strands: &mut [Strand], rig: &Rig, poses: &[Pose]) -> Result<f64, LightError> {
    let total: usize = strands.iter().map(Strand::len).sum();
    let step = total / 8192 + 1;
    let mut whitened = Vec::with_capacity(total / step + strands.len());
    for strand in strands.iter_mut() {
        let drawn = Drawn::new(
            &rig.camera,
            &rig.light,
            strand.slide_mm,
            &poses[strand.view],
        );
        if !drawn.is_some_and(|drawn| strand.measure(&drawn)) {
            return Err(LightError::NoSolution);
        }
        strand.whitened(step, &mut whitened);
    }
    if whitened.is_empty() {
        return Err(LightError::NoSolution);
    }
    let middle = whitened.len() / 2;
    let (_, median, _) = whitened.select_nth_unstable_by(middle, f64::total_cmp);
    let variance = (*median / MEDIAN_CHI2).max(1e-10);
    for strand in strands.iter_mut() {
        if let Some(drawn) = Drawn::new(
            &rig.camera,
            &rig.light,
            strand.slide_mm,
            &poses[strand.view],
        ) {
            strand.sum_up(&drawn, variance.sqrt());
        }
    }
    Ok(variance)
}

/// Variances common to a piece and to a stripe, by moments of the pieces' residuals (DerSimonian &
/// Laird 1986): E Σ ω(r − r̄)² = n − 1 + β²·(Σω − Σω²/Σω), and the like over the stripes.
fn components(strands: &[Strand], rig: &Rig, poses: &[Pose], noise: &mut StripeNoise) {
    let mut per_strand: Vec<Vec<(f64, f64)>> = Vec::with_capacity(strands.len());
    for strand in strands {
        let mut pieces = Vec::new();
        if let Some(drawn) = Drawn::new(
            &rig.camera,
            &rig.light,
            strand.slide_mm,
            &poses[strand.view],
        ) {
            for piece in strand.pieces.iter().filter(|p| p.information > 0.0) {
                if let Some(local) = drawn.near(&piece.pixel) {
                    let r = local.normal.dot(&(piece.pixel - local.pixel));
                    pieces.push((piece.information, r));
                }
            }
        }
        per_strand.push(pieces);
    }
    let (mut excess, mut lever) = (0.0, 0.0);
    for pieces in &per_strand {
        let w = |&(information, _): &(f64, f64)| information / noise.centre;
        let sum: f64 = pieces.iter().map(w).sum();
        if pieces.len() < 3 {
            continue;
        }
        let mean = pieces.iter().map(|p| w(p) * p.1).sum::<f64>() / sum;
        let q: f64 = pieces.iter().map(|p| w(p) * (p.1 - mean).powi(2)).sum();
        excess += q - (pieces.len() - 1) as f64;
        lever += sum - pieces.iter().map(|p| w(p).powi(2)).sum::<f64>() / sum;
    }
    noise.piece = if lever > 0.0 {
        (excess / lever).max(0.0)
    } else {
        0.0
    };

    let means: Vec<(f64, f64)> = per_strand
        .iter()
        .filter_map(|pieces| {
            let w = |p: &(f64, f64)| noise.piece_information(p.0);
            let sum: f64 = pieces.iter().map(w).sum();
            (sum > 0.0).then(|| (sum, pieces.iter().map(|p| w(p) * p.1).sum::<f64>() / sum))
        })
        .collect();
    // A stripe far off (a wrong position, say) must not pass for the scatter of all.
    let mut sizes: Vec<f64> = means.iter().map(|m| m.1.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let limit = 4.0 * 1.4826 * sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let q: f64 = means
        .iter()
        .map(|(w, m)| w * m.abs().min(limit).powi(2))
        .sum();
    let sum: f64 = means.iter().map(|m| m.0).sum();
    // Normal, a and b take four degrees of freedom from the stripes.
    let freedom = means.len() as f64 - 4.0;
    noise.stripe = if freedom > 4.0 && sum > 0.0 {
        ((q - freedom) / (sum * freedom / means.len() as f64)).max(0.0)
    } else {
        0.0
    };
}

fn corner_residuals(
    camera_views: &[CornerView],
    light_views: &[CornerView],
    rig: &Rig,
    poses: &[Pose],
    scale: f64,
) -> Residuals {
    let mut out = Residuals::default();
    for (view, pose) in camera_views.iter().chain(light_views).zip(poses) {
        view.residuals(&rig.camera, pose, scale, &mut out);
    }
    out
}

fn inverse(c: &nalgebra::SMatrix<f64, CAMERA, CAMERA>) -> Option<[[f64; CAMERA]; CAMERA]> {
    let mut a = [[0.0; CAMERA]; CAMERA];
    for i in 0..CAMERA {
        for k in 0..CAMERA {
            a[i][k] = c[(i, k)];
        }
    }
    let factor = Cholesky::new(&a)?;
    let mut out = [[0.0; CAMERA]; CAMERA];
    for (i, row) in out.iter_mut().enumerate() {
        let mut unit = [0.0; CAMERA];
        unit[i] = 1.0;
        *row = factor.solve(&unit);
    }
    Some(out)
}
