//! Zhang's camera calibration (paper, Section 2.1; Eq. 1, 2): closed-form start, then maximum
//! likelihood over the nine parameters of the camera and all board poses.
//!
//! Minimises Σ ρ(‖Σᵢ^(−1/2)·(π(R·P + T) − p)‖²/s²) over all corners, Σᵢ a corner's covariance,
//! ρ Huber's loss and s a scale that the residuals themselves give.

mod gate;

pub use gate::{REFUSE_RMS_PX, limits};

use super::corners::{CornerView, Residuals};
use super::finding::{Finding, Severity, refusals};
use super::solve::{Block, Problem, Stop, minimise};
use super::{plane_pose, zhang};
use crate::board::{BoardGeometry, Corner};
use crate::checks::Check;
use crate::geometry::{Camera, Homography, PARAMETERS, Pose, Vector2};
use nalgebra::SMatrix;

/// Views that the solve needs: two give as many equations as unknowns and no check.
pub const LEAST_VIEWS: usize = 3;

/// Prior standard deviations of k1, k2, p1, p2, k3: what each term may shift a pixel at the
/// image's corner, relative to its distance from the middle. Ten times what a real lens does, so
/// it decides only where no board reached and the data says nothing.
const PRIOR_RELATIVE_SHIFT: f64 = 1.0;

/// A fit of camera and poses to the corners of several views.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibration {
    /// The camera.
    pub camera: Camera,
    /// Covariance of its parameters, order of [`PARAMETERS`], scaled by `variance_factor`.
    pub covariance: SMatrix<f64, PARAMETERS, PARAMETERS>,
    /// The board's pose in each view.
    pub poses: Vec<Pose>,
    /// Which views took part; the others are named in `findings`.
    pub used: Vec<bool>,
    /// Root mean square reprojection error (distance) per view, px.
    pub view_rms_px: Vec<f64>,
    /// The same over all views that took part, px.
    pub rms_px: f64,
    /// Variance of the residuals in units of the corners' own covariances (a posteriori).
    pub variance_factor: f64,
    /// What the gate has to say; nothing of [`Severity::Refuse`] in what is given as good.
    pub findings: Vec<Finding>,
    /// Every check that the gate made.
    pub checks: Vec<Check>,
}

/// Why a camera can't be calibrated from these views.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// Fewer views than the solve needs.
    #[error(
        "{views} views of the board; {needed} or more are needed, each with the board tilted differently"
    )]
    TooFewViews {
        /// Views given.
        views: usize,
        /// Views needed.
        needed: usize,
    },
    /// A view has another number of corners than the board.
    #[error("view {view} has {found} corners where the board has {needed}")]
    WrongCornerCount {
        /// Index of the view.
        view: usize,
        /// Corners given.
        found: usize,
        /// Corners of the board.
        needed: usize,
    },
    /// A corner's position or covariance is not a number, or no covariance.
    #[error("view {view} has a corner without a usable position or covariance")]
    BadCorner {
        /// Index of the view.
        view: usize,
    },
    /// The board's description or the image's size makes no sense.
    #[error(
        "a board of {columns} × {rows} corners with {square_mm} mm squares in an image of {width} × {height} pixels can't be used"
    )]
    BadBoard {
        /// Corners along the long side.
        columns: usize,
        /// Corners along the short side.
        rows: usize,
        /// Side of a square, mm.
        square_mm: f64,
        /// Image width, pixels.
        width: u32,
        /// Image height, pixels.
        height: u32,
    },
    /// No camera puts the corners where they were seen.
    #[error("no camera fits these views; check that the board is flat and its corners in order")]
    NoSolution,
    /// The gate refuses.
    #[error("{}", refusals(.0))]
    Refused(
        /// All findings, warnings included.
        Vec<Finding>,
        /// What was found all the same, to be looked at and not to be used.
        Box<CameraCalibration>,
    ),
}

/// Calibrates the camera from the corners of several views (each in the board's corner order).
pub fn calibrate(
    views: &[Vec<Corner>],
    board: &BoardGeometry,
    width: u32,
    height: u32,
) -> Result<CameraCalibration, CameraError> {
    let input = Input::new(views, board, width, height)?;
    let mut used = gate::homographies_fit(&input.homographies, &input.plane, &input.pixels);
    let mut start = None;
    // Once more without the views that do not fit, until all fit (each round drops at least one).
    for _ in 0..views.len() {
        let solved = solve(&input, &used, start)?;
        let bad = gate::bad_views(&solved.view_scale, &used);
        if bad.is_empty() || used.iter().filter(|&&u| u).count() < LEAST_VIEWS + bad.len() {
            return finish(views, &input, solved, used);
        }
        for view in bad {
            used[view] = false;
        }
        start = Some(solved.camera);
    }
    Err(CameraError::NoSolution)
}

/// The board's corners as points of its plane, mm.
pub(super) fn board_points(board: &BoardGeometry) -> Vec<Vector2> {
    (0..board.corners())
        .map(|i| board.point(i).xy().coords)
        .collect()
}

/// The prior standard deviations of k1, k2, p1, p2, k3 for a camera of this field of view.
pub(super) fn distortion_prior(camera: &Camera) -> [f64; 5] {
    let (w, h) = (
        f64::from(camera.width) / 2.0,
        f64::from(camera.height) / 2.0,
    );
    let r = (w / camera.fx).hypot(h / camera.fy);
    let s = PRIOR_RELATIVE_SHIFT;
    [s / r.powi(2), s / r.powi(4), s / r, s / r, s / r.powi(6)]
}

/// Adds the prior on the distortion (parameters 4 to 8) to a block.
pub(super) fn add_distortion_prior<const G: usize>(
    camera: &Camera,
    sigma: &[f64; 5],
    block: &mut Block<G>,
) {
    let p = camera.parameters();
    for (i, sigma) in sigma.iter().enumerate() {
        let information = 1.0 / (sigma * sigma);
        let k = i + 4;
        block.cost += p[k] * p[k] * information;
        block.gg[k][k] += information;
        block.g[k] += p[k] * information;
    }
}

/// The corners made ready for the solve.
struct Input {
    corners: Vec<CornerView>,
    plane: Vec<Vector2>,
    pixels: Vec<Vec<Vector2>>,
    homographies: Vec<Option<Homography>>,
    width: u32,
    height: u32,
}

impl Input {
    fn new(
        views: &[Vec<Corner>],
        board: &BoardGeometry,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        if board.columns < 2
            || board.rows < 2
            || !(board.square_mm > 0.0 && board.square_mm.is_finite())
            || width == 0
            || height == 0
        {
            return Err(CameraError::BadBoard {
                columns: board.columns,
                rows: board.rows,
                square_mm: board.square_mm,
                width,
                height,
            });
        }
        let mut corners = Vec::with_capacity(views.len());
        for (view, measured) in views.iter().enumerate() {
            if measured.len() != board.corners() {
                return Err(CameraError::WrongCornerCount {
                    view,
                    found: measured.len(),
                    needed: board.corners(),
                });
            }
            let prepared = CornerView::new(measured, board);
            corners.push(prepared.ok_or(CameraError::BadCorner { view })?);
        }
        if views.len() < LEAST_VIEWS {
            return Err(CameraError::TooFewViews {
                views: views.len(),
                needed: LEAST_VIEWS,
            });
        }
        let plane = board_points(board);
        let pixels: Vec<Vec<Vector2>> = views
            .iter()
            .map(|corners| corners.iter().map(|c| c.pixel).collect())
            .collect();
        let homographies = pixels
            .iter()
            .map(|image| Homography::fit(&plane, image).ok())
            .collect();
        Ok(Self {
            corners,
            plane,
            pixels,
            homographies,
            width,
            height,
        })
    }
}

/// The maximum-likelihood camera of the views in use.
struct Solved {
    camera: Camera,
    /// Poses of the views in use, in their order.
    poses: Vec<Pose>,
    covariance: Option<SMatrix<f64, PARAMETERS, PARAMETERS>>,
    variance_factor: f64,
    rms_px: f64,
    /// Root mean square whitened residual of each view; NaN for those not in use.
    view_scale: Vec<f64>,
}

fn solve(input: &Input, used: &[bool], start: Option<Camera>) -> Result<Solved, CameraError> {
    let mut indices = Vec::with_capacity(used.len());
    let mut homographies = Vec::with_capacity(used.len());
    for (i, h) in input.homographies.iter().enumerate() {
        if let (true, Some(h)) = (used[i], h) {
            indices.push(i);
            homographies.push(*h);
        }
    }
    if indices.len() < LEAST_VIEWS {
        return Err(CameraError::TooFewViews {
            views: indices.len(),
            needed: LEAST_VIEWS,
        });
    }
    let views: Vec<&CornerView> = indices.iter().map(|&i| &input.corners[i]).collect();
    let pixels: Vec<&[Vector2]> = indices
        .iter()
        .map(|&i| input.pixels[i].as_slice())
        .collect();
    // A fit with a view too many is nearer than the closed form.
    let known = start.and_then(|camera| {
        let poses = pixels
            .iter()
            .map(|p| plane_pose::pose_through(&camera, &input.plane, p))
            .collect::<Option<Vec<_>>>()?;
        Some((camera, poses))
    });
    let (mut camera, mut poses) = match known {
        Some(known) => known,
        None => zhang::start(
            &homographies,
            &input.plane,
            &pixels,
            input.width,
            input.height,
        )
        .ok_or(CameraError::NoSolution)?,
    };

    let corners: usize = views.iter().map(|v| v.len()).sum();
    let mut last = None;
    // Far, near, and with the scale of the residuals known.
    for step_sigma in [0.3, 0.03, 1e-3] {
        let scale = residuals(&views, &camera, &poses, 1.0).median_scale();
        let problem = CameraProblem {
            views: &views,
            scale,
            prior: distortion_prior(&camera),
        };
        let stop = Stop {
            iterations: 40,
            step_sigma,
            residuals: 2 * corners,
        };
        let system = minimise(&problem, &mut camera, &mut poses, &stop);
        last = Some((system.ok_or(CameraError::NoSolution)?, scale));
    }
    let (system, scale) = last.ok_or(CameraError::NoSolution)?;

    let all = residuals(&views, &camera, &poses, scale);
    let variance_factor = all.variance(PARAMETERS + 6 * views.len());
    let mut view_scale = vec![f64::NAN; input.corners.len()];
    for (k, &i) in indices.iter().enumerate() {
        let mine = residuals(&views[k..=k], &camera, &poses[k..=k], scale);
        let sum: f64 = mine.whitened.iter().sum();
        view_scale[i] = (sum / (2 * mine.whitened.len()).max(1) as f64).sqrt();
    }
    // The system's unit is `scale`; the residuals say how large it is in truth.
    let unit = variance_factor / (scale * scale);
    let covariance = system
        .covariance()
        .map(|c| SMatrix::from_fn(|i, k| c[i][k] * unit));
    Ok(Solved {
        camera,
        poses,
        covariance,
        variance_factor,
        rms_px: all.rms_px(),
        view_scale,
    })
}

/// Poses of all views (also those not used), and the gate's word.
fn finish(
    views: &[Vec<Corner>],
    input: &Input,
    solved: Solved,
    used: Vec<bool>,
) -> Result<CameraCalibration, CameraError> {
    let camera = solved.camera;
    let mut next = solved.poses.into_iter();
    let mut poses = Vec::with_capacity(views.len());
    let mut view_rms_px = Vec::with_capacity(views.len());
    for (i, view) in input.corners.iter().enumerate() {
        let pose = if used[i] {
            next.next()
        } else {
            plane_pose::pose_through(&camera, &input.plane, &input.pixels[i])
        };
        let pose = pose.unwrap_or(Pose {
            rotation: nalgebra::Rotation3::identity(),
            translation: crate::geometry::Vector3::zeros(),
        });
        view_rms_px.push(residuals(&[view], &camera, &[pose], 1.0).rms_px());
        poses.push(pose);
    }
    let gate = gate::examine(&gate::Evidence {
        camera: &camera,
        covariance: solved.covariance.as_ref(),
        poses: &poses,
        used: &used,
        views,
        view_scale: &solved.view_scale,
        view_rms_px: &view_rms_px,
        rms_px: solved.rms_px,
    });
    let refused = gate.findings.iter().any(|f| f.severity == Severity::Refuse);
    let found = CameraCalibration {
        camera,
        covariance: solved.covariance.unwrap_or_default(),
        poses,
        used,
        view_rms_px,
        rms_px: solved.rms_px,
        variance_factor: solved.variance_factor,
        findings: gate.findings,
        checks: gate.checks,
    };
    match solved.covariance {
        _ if refused => Err(CameraError::Refused(
            found.findings.clone(),
            Box::new(found),
        )),
        Some(_) => Ok(found),
        None => Err(CameraError::NoSolution),
    }
}

fn residuals(views: &[&CornerView], camera: &Camera, poses: &[Pose], scale: f64) -> Residuals {
    let mut out = Residuals::default();
    for (view, pose) in views.iter().zip(poses) {
        view.residuals(camera, pose, scale, &mut out);
    }
    out
}

/// Corners of several views under one camera.
struct CameraProblem<'a> {
    views: &'a [&'a CornerView],
    scale: f64,
    prior: [f64; 5],
}

impl Problem<PARAMETERS> for CameraProblem<'_> {
    type Globals = Camera;

    fn views(&self) -> usize {
        self.views.len()
    }

    fn linearise(
        &self,
        view: usize,
        camera: &Camera,
        pose: &Pose,
        block: &mut Block<PARAMETERS>,
    ) -> bool {
        self.views[view].linearise(camera, pose, self.scale, block)
    }

    fn prior(&self, camera: &Camera, block: &mut Block<PARAMETERS>) {
        add_distortion_prior(camera, &self.prior, block);
    }

    fn updated(&self, camera: &Camera, step: &[f64; PARAMETERS]) -> Camera {
        let mut p = camera.parameters();
        for (p, s) in p.iter_mut().zip(step) {
            *p += s;
        }
        camera.with_parameters(&p)
    }
}

#[cfg(test)]
mod tests;
