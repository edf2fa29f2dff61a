//! A stripe on a board as the solver sees it: its centres gathered into short pieces.
//!
//! The stripe that a light plane draws on a board is, in ideal normalised coordinates, the straight
//! line h·(x, y, 1) = 0 with h = e·n − d·m for the light plane n·P + d = 0 and the board m·P + e = 0:
//! the plane through the camera's centre and the line where the two meet. The lens bends it
//! slightly. Within a piece of 32 px its image is a parabola to a thousandth of a pixel, and the
//! derivatives hardly change, so that a hundred thousand centres cost no more than a few thousand
//! pieces: each piece is summed up as one pixel with a weight.

use super::BoardStripe;
use crate::calibration::LightModel;
use crate::calibration::solve::POSE;
use crate::geometry::{
    Camera, PARAMETERS as CAMERA, Point3, Pose, Vector2, Vector3, tangent_basis,
};
use nalgebra::Matrix3x2;

/// Length of a piece along the stripe, px.
const PIECE_PX: f64 = 32.0;
/// Where Tukey's biweight reaches zero, in standard deviations.
pub const TUKEY: f64 = 6.0;
/// A centre whose direction of measurement makes more than 60° with the stripe's normal measures
/// something else.
const LEAST_ALIGNMENT: f64 = 0.5;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "light planes: stripes summed up over",
            format!("{PIECE_PX} px"),
        ),
        (
            "light planes: Tukey’s weight zero beyond",
            format!("{TUKEY} σ"),
        ),
        (
            "light planes: largest angle of measuring to the stripe’s normal",
            format!("{:.0}°", LEAST_ALIGNMENT.acos().to_degrees()),
        ),
    ]
}

/// A measured stripe, in pieces.
#[derive(Clone, Debug)]
pub struct Strand {
    /// Index of the light view.
    pub view: usize,
    /// Index of the slide position.
    pub position: usize,
    /// Position of the slide, mm.
    pub slide_mm: f64,
    points: Vec<Point>,
    /// The pieces, in order along the stripe.
    pub pieces: Vec<Piece>,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    pixel: Vector2,
    across: Vector2,
    variance: f64,
    /// Signed distance from the stripe of the model, px, and its variance along that normal.
    residual: f64,
    normal_variance: f64,
    weight: f64,
    /// Position along the piece, from its pivot, px.
    along: f64,
}

/// A short piece of a stripe, summed up.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    first: usize,
    end: usize,
    /// Where the curve is evaluated: the mean pixel.
    pub pivot: Vector2,
    /// The pixel that stands for the piece.
    pub pixel: Vector2,
    /// Σ robust weight / variance of its centres, 1/px².
    pub information: f64,
}

/// The line that a light plane draws on a board, seen by a camera.
#[derive(Clone, Debug)]
pub struct Drawn<'a> {
    camera: &'a Camera,
    /// Interpretation plane, scaled so that (h.x, h.y) is a unit vector.
    h: Vector3,
    inverse_length: f64,
    light_normal: Vector3,
    light_tangents: Matrix3x2<f64>,
    light_d: f64,
    slide_mm: f64,
    board_normal: Vector3,
    board_e: f64,
    /// m × T.
    board_moment: Vector3,
}

/// The drawn stripe near a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Local {
    /// Point of the curve.
    pub pixel: Vector2,
    /// Unit normal in the image.
    pub normal: Vector2,
    /// Unit tangent.
    pub tangent: Vector2,
    ideal: Vector2,
}

/// Derivatives of a residual.
#[derive(Clone, Copy, Debug)]
pub struct Derivatives {
    /// By camera, normal, a and b.
    pub globals: [f64; crate::calibration::PARAMETERS],
    /// By the board's pose.
    pub pose: [f64; POSE],
}

impl<'a> Drawn<'a> {
    /// `None` where the light is parallel to the board.
    pub fn new(camera: &'a Camera, light: &LightModel, slide_mm: f64, pose: &Pose) -> Option<Self> {
        let plane = light.plane(slide_mm);
        let m = pose.rotation * Vector3::z();
        let e = -m.dot(&pose.translation);
        let h = plane.normal * e - m * plane.d;
        let length = h.xy().norm();
        (length > 1e-9 * h.z.abs().max(1.0)).then(|| Self {
            camera,
            h: h / length,
            inverse_length: 1.0 / length,
            light_normal: plane.normal,
            light_tangents: tangent_basis(&plane.normal),
            light_d: plane.d,
            slide_mm,
            board_normal: m,
            board_e: e,
            board_moment: m.cross(&pose.translation),
        })
    }

    /// The curve at the foot of a pixel. `None` where the lens has no inverse.
    pub fn near(&self, pixel: &Vector2) -> Option<Local> {
        let ray = self.camera.ray(pixel)?;
        let nu = self.h.xy();
        let ideal = ray.xy() - nu * self.h.dot(&ray);
        let along = Vector2::new(-nu.y, nu.x);
        let (x, y) = self.camera.distortion.distort(ideal.x, ideal.y);
        let j = self.camera.distortion.jacobian(ideal.x, ideal.y);
        let t = j * along;
        let tangent =
            Vector2::new(self.camera.fx * t.x, self.camera.fy * t.y).try_normalize(1e-12)?;
        Some(Local {
            pixel: Vector2::new(
                self.camera.fx * x + self.camera.u0,
                self.camera.fy * y + self.camera.v0,
            ),
            normal: Vector2::new(-tangent.y, tangent.x),
            tangent,
            ideal,
        })
    }

    /// Curvature of the drawn stripe at a point of it, towards its normal, 1/px.
    fn curvature(&self, at: &Local) -> f64 {
        let nu = self.h.xy();
        let step = Vector2::new(-nu.y, nu.x) * (0.5 * PIECE_PX / self.camera.fx);
        let image = |p: Vector2| {
            let (x, y) = self.camera.distortion.distort(p.x, p.y);
            Vector2::new(
                self.camera.fx * x + self.camera.u0,
                self.camera.fy * y + self.camera.v0,
            )
        };
        let (a, b) = (image(at.ideal - step), image(at.ideal + step));
        let half = (b - a).norm() / 2.0;
        at.normal.dot(&(a + b - at.pixel * 2.0)) / (half * half)
    }

    /// Derivatives of r = N·(p − curve) at a point of the curve. Moving along the curve changes
    /// nothing at first order, so the point may be held at its place along the line.
    pub fn derivatives(&self, at: &Local) -> Option<Derivatives> {
        let q = Vector3::new(at.ideal.x, at.ideal.y, 1.0);
        let j = self.camera.project_with_jacobian(&Point3::from(q))?;
        let mut globals = [0.0; crate::calibration::PARAMETERS];
        for (i, g) in globals.iter_mut().take(CAMERA).enumerate() {
            *g = -(at.normal.x * j.by_camera[(0, i)] + at.normal.y * j.by_camera[(1, i)]);
        }
        let across = j.by_point.fixed_columns::<2>(0) * self.h.xy();
        let scale = at.normal.dot(&across) * self.inverse_length;
        let (nq, mq) = (self.light_normal.dot(&q), self.board_normal.dot(&q));
        let turned = self.light_tangents.transpose() * q * (self.board_e * scale);
        globals[CAMERA] = turned.x;
        globals[CAMERA + 1] = turned.y;
        globals[CAMERA + 2] = -mq * self.slide_mm * scale;
        globals[CAMERA + 3] = -mq * scale;
        let omega = (self.board_moment * -nq - self.board_normal.cross(&q) * self.light_d) * scale;
        let tau = self.board_normal * (-nq * scale);
        Some(Derivatives {
            globals,
            pose: [omega.x, omega.y, omega.z, tau.x, tau.y, tau.z],
        })
    }
}

impl Strand {
    /// Gathers a stripe's centres; those that are no numbers are dropped.
    pub fn new(view: usize, position: usize, stripe: &BoardStripe) -> Self {
        let mut points: Vec<Point> = stripe
            .points
            .iter()
            .filter(|p| {
                p.pixel.iter().chain(&p.across).all(|v| v.is_finite())
                    && p.variance > 0.0
                    && p.variance.is_finite()
                    && p.quality > 0.0
            })
            .map(|p| Point {
                pixel: p.pixel,
                across: p.across,
                variance: p.variance,
                residual: 0.0,
                normal_variance: p.variance,
                weight: 1.0,
                along: 0.0,
            })
            .collect();
        // Along the stripe: at right angles to the mean direction across (of either sign).
        let reference = points.first().map_or(Vector2::y(), |p| p.across);
        let across: Vector2 = points
            .iter()
            .map(|p| p.across * p.across.dot(&reference).signum())
            .sum();
        let along = Vector2::new(-across.y, across.x)
            .try_normalize(1e-12)
            .unwrap_or(Vector2::x());
        for p in &mut points {
            p.along = along.dot(&p.pixel);
        }
        points.sort_by(|p, q| p.along.total_cmp(&q.along));
        let mut pieces = Vec::new();
        let mut first = 0;
        while first < points.len() {
            let limit = points[first].along + PIECE_PX;
            let end = first + points[first..].partition_point(|p| p.along < limit);
            let members = &points[first..end];
            let pivot = members.iter().map(|p| p.pixel).sum::<Vector2>() / members.len() as f64;
            pieces.push(Piece {
                first,
                end,
                pivot,
                pixel: pivot,
                information: members.iter().map(|p| 1.0 / p.variance).sum(),
            });
            first = end;
        }
        Self {
            view,
            position,
            slide_mm: stripe.slide_mm,
            points,
            pieces,
        }
    }

    /// How many centres there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Every `step`-th centre, for the closed-form start.
    pub fn sample(&self, step: usize) -> impl Iterator<Item = Vector2> + '_ {
        self.points.iter().step_by(step.max(1)).map(|p| p.pixel)
    }

    /// Residuals of all centres under a model. False where the stripe can't be drawn at all.
    pub fn measure(&mut self, drawn: &Drawn) -> bool {
        let (points, pieces) = (&mut self.points, &mut self.pieces);
        for piece in pieces.iter_mut() {
            let Some(local) = drawn.near(&piece.pivot) else {
                return false;
            };
            let bend = 0.5 * drawn.curvature(&local);
            for p in &mut points[piece.first..piece.end] {
                let offset = p.pixel - local.pixel;
                let along = local.tangent.dot(&offset);
                p.along = along;
                p.residual = local.normal.dot(&offset) - bend * along * along;
                let aligned = p.across.dot(&local.normal);
                p.normal_variance = if aligned.abs() < LEAST_ALIGNMENT {
                    f64::INFINITY
                } else {
                    p.variance * aligned * aligned
                };
            }
        }
        true
    }

    /// Squared residuals of the centres in units of their own variances, thinned by `step`.
    pub fn whitened(&self, step: usize, out: &mut Vec<f64>) {
        out.extend(
            self.points
                .iter()
                .step_by(step.max(1))
                .filter(|p| p.normal_variance.is_finite())
                .map(|p| p.residual * p.residual / p.normal_variance),
        );
    }

    /// Sums up the pieces around the model last measured with Tukey's weights: `scale` is the
    /// standard deviation of a whitened residual.
    pub fn sum_up(&mut self, drawn: &Drawn, scale: f64) {
        let cut = 1.0 / (TUKEY * scale).powi(2);
        for piece in &mut self.pieces {
            let (mut sum, mut sum_r, mut sum_t) = (0.0, 0.0, 0.0);
            for p in &mut self.points[piece.first..piece.end] {
                let information = 1.0 / p.normal_variance;
                let u = p.residual * p.residual * information * cut;
                p.weight = if u < 1.0 { (1.0 - u) * (1.0 - u) } else { 0.0 };
                let w = p.weight * information;
                sum += w;
                sum_r += w * p.residual;
                sum_t += w * p.along;
            }
            piece.information = sum;
            if sum > 0.0
                && let Some(local) = drawn.near(&piece.pivot)
            {
                let (r, t) = (sum_r / sum, sum_t / sum);
                let bend = 0.5 * drawn.curvature(&local);
                piece.pixel = local.pixel + local.tangent * t + local.normal * (r + bend * t * t);
            }
        }
    }

    /// Folds over the centres in use: residual (px) and the piece they belong to.
    pub fn each(&self, mut f: impl FnMut(usize, f64)) {
        for (k, piece) in self.pieces.iter().enumerate() {
            for p in &self.points[piece.first..piece.end] {
                if p.weight > 0.0 {
                    f(k, p.residual);
                }
            }
        }
    }
}
