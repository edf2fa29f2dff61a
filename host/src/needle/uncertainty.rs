//! How sure plane, entry and axis are: first-order propagation of
//!
//! * the calibration's 13 × 13 covariance: each piece of surface moves with the parameters while
//!   its pixel and slide position stay (implicit differentiation of Eq. 1, 2 and 9);
//! * the stripe's noise: each centre's own variance, shared along the stripe over its grain
//!   (speckle, smoothing), and a small part that a whole stripe shares;
//! * sampling: what changes when heights run straight between the stripes instead of curved, and
//!   when what was not measured of the region is filled by the bend of the rest.
//!
//! Pixels of the entry and the vein count as given: their own error is the vein imaging's.

use super::plane::PlaneFit;
use super::surface::{Patch, Surface};
use crate::calibration::{PARAMETERS, RigModel};
use crate::geometry::{Matrix3, Plane, Point3, Vector3, tangent_basis};
use nalgebra::{SMatrix, SVector};

/// Normal, entry and the vein's line, stacked.
type Nine = SVector<f64, 9>;
type Nine9 = SMatrix<f64, 9, 9>;

/// Covariances of the decision.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Of the plane's normal (its three components).
    pub normal: Matrix3,
    /// Of the entry point, mm².
    pub entry: Matrix3,
    /// Of the needle's axis at the wanted angle.
    pub axis: Matrix3,
    /// Standard deviation of the angle between that axis and the true plane, rad.
    pub angle_sigma: f64,
    /// What the calibration, the stripes and the sampling contribute to it, rad.
    pub angle_parts: [f64; 3],
    /// The same of the entry point, mm.
    pub entry_parts_mm: [f64; 3],
}

impl Uncertainty {
    /// Standard deviation of the entry point along its worst direction, mm.
    pub fn entry_sigma_mm(&self) -> f64 {
        worst(&self.entry)
    }

    /// Standard deviation of the normal's direction along its worst direction, rad.
    pub fn normal_sigma(&self) -> f64 {
        worst(&self.normal)
    }

    /// Standard deviation of the axis's direction along its worst direction, rad.
    pub fn axis_sigma(&self) -> f64 {
        worst(&self.axis)
    }
}

fn worst(covariance: &Matrix3) -> f64 {
    covariance.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// All that the propagation needs.
pub(super) struct Inputs<'a> {
    pub surface: &'a Surface,
    pub patch: &'a Patch,
    /// The surface on which the vein's line was taken.
    pub broad: &'a Surface,
    pub fit: &'a PlaneFit,
    pub entry: &'a Point3,
    pub radius_mm: f64,
    pub vein: &'a [Point3],
    pub line: &'a Vector3,
    pub plane: &'a Plane,
    pub angle: f64,
    pub rig: &'a RigModel,
    /// Normal, entry and line with straight interpolation.
    pub coarse: Option<(Vector3, Point3, Vector3)>,
    /// The normal with the region's unmeasured part filled.
    pub filled: Option<Vector3>,
    pub stripe_bias_px: f64,
}

/// How a surface point moves with the calibration's parameters (3 × 13, their order) at a fixed
/// pixel and slide position.
pub fn displacement(p: &Point3, rig: &RigModel) -> Option<SMatrix<f64, 3, PARAMETERS>> {
    let seen = rig.camera.project_with_jacobian(p)?;
    let n = rig.light.normal;
    let mut by_point = Matrix3::zeros();
    by_point
        .fixed_view_mut::<2, 3>(0, 0)
        .copy_from(&seen.by_point);
    by_point
        .fixed_view_mut::<1, 3>(2, 0)
        .copy_from(&n.transpose());
    let inverse = by_point.try_inverse()?;
    let slide = if rig.light.a == 0.0 {
        0.0
    } else {
        (-n.dot(&p.coords) - rig.light.b) / rig.light.a
    };
    let mut by_parameters = SMatrix::<f64, 3, PARAMETERS>::zeros();
    by_parameters
        .fixed_view_mut::<2, 9>(0, 0)
        .copy_from(&seen.by_camera);
    let tangent = tangent_basis(&n);
    by_parameters[(2, 9)] = tangent.column(0).dot(&p.coords);
    by_parameters[(2, 10)] = tangent.column(1).dot(&p.coords);
    by_parameters[(2, 11)] = slide;
    by_parameters[(2, 12)] = 1.0;
    Some(-inverse * by_parameters)
}

/// The change of the vein's line per displacement of each of its points (least-squares slope over
/// their places on the line).
struct LineTurn {
    factors: Vec<f64>,
    line: Vector3,
}

impl LineTurn {
    fn new(vein: &[Point3], line: &Vector3) -> Self {
        let places: Vec<f64> = vein.iter().map(|p| p.coords.dot(line)).collect();
        let mean = places.iter().sum::<f64>() / places.len().max(1) as f64;
        let spread: f64 = places.iter().map(|x| (x - mean).powi(2)).sum();
        let factors = places
            .iter()
            .map(|x| {
                if spread > 0.0 {
                    (x - mean) / spread
                } else {
                    0.0
                }
            })
            .collect();
        Self {
            factors,
            line: *line,
        }
    }

    fn turn(&self, i: usize, step: &Vector3) -> Vector3 {
        (step - self.line * self.line.dot(step)) * self.factors[i]
    }
}

/// What hangs on a surface besides the normal.
enum Part<'a> {
    Entry,
    Line(&'a LineTurn),
}

fn stack(normal: &Vector3, entry: &Vector3, line: &Vector3) -> Nine {
    let mut v = Nine::zeros();
    v.fixed_rows_mut::<3>(0).copy_from(normal);
    v.fixed_rows_mut::<3>(3).copy_from(entry);
    v.fixed_rows_mut::<3>(6).copy_from(line);
    v
}

pub(super) fn propagate(i: &Inputs<'_>) -> Uncertainty {
    let line = LineTurn::new(i.vein, i.line);
    // The entry's surface and the vein's have nodes of their own; the normal, a mean over the region, is the
    // same function of either. Only normal and line meet again, in the axis.
    let mut stripes = stripe_noise(i, i.surface, i.patch, Part::Entry);
    let broad = i
        .broad
        .patch(i.entry, i.radius_mm, super::surface::Interpolation::Cubic);
    let vein = stripe_noise(i, i.broad, &broad, Part::Line(&line));
    for at in [(0, 6), (6, 0), (6, 6)] {
        let block = vein.fixed_view::<3, 3>(at.0, at.1);
        stripes.fixed_view_mut::<3, 3>(at.0, at.1).copy_from(&block);
    }
    let parts = [calibration(i, &line), stripes, sampling(i)];
    let total: Nine9 = parts.iter().sum();
    let n = i.plane.normal;
    let axis_by = axis_jacobian(&n, i.line, i.angle);
    let direction = super::axis::into_plane(i.line, &n).unwrap_or(*i.line);
    let block = |c: &Nine9, at: usize| -> Matrix3 { c.fixed_view::<3, 3>(at, at).into_owned() };
    // α = asin(n·s): with the needle where it is, the plane's tilt about the axis across the vein.
    let angle = |c: &Nine9| (block(c, 0) * direction).dot(&direction).max(0.0).sqrt();
    Uncertainty {
        normal: block(&total, 0),
        entry: block(&total, 3),
        axis: axis_by * total * axis_by.transpose(),
        angle_sigma: angle(&total),
        angle_parts: [angle(&parts[0]), angle(&parts[1]), angle(&parts[2])],
        entry_parts_mm: [0, 1, 2].map(|k| worst(&block(&parts[k], 3))),
    }
}

fn calibration(i: &Inputs<'_>, line: &LineTurn) -> Nine9 {
    if i.rig.covariance.iter().all(|v| *v == 0.0) {
        return Nine9::zeros();
    }
    let mut by = SMatrix::<f64, 9, PARAMETERS>::zeros();
    // The field is smooth: every third piece, weighted threefold, shows it well enough.
    const EVERY: usize = 3;
    for cell in i.patch.cells.iter().step_by(EVERY) {
        let Some(d) = displacement(&cell.position, i.rig) else {
            continue;
        };
        for k in 0..PARAMETERS {
            let turn = i.fit.turn(cell, &d.column(k).into_owned()) * EVERY as f64;
            let mut place = by.fixed_view_mut::<3, 1>(0, k);
            place += turn;
        }
    }
    if let Some(d) = displacement(i.entry, i.rig) {
        by.fixed_view_mut::<3, PARAMETERS>(3, 0).copy_from(&d);
    }
    for (j, p) in i.vein.iter().enumerate() {
        let Some(d) = displacement(p, i.rig) else {
            continue;
        };
        for k in 0..PARAMETERS {
            let turn = line.turn(j, &d.column(k).into_owned());
            let mut place = by.fixed_view_mut::<3, 1>(6, k);
            place += turn;
        }
    }
    by * i.rig.covariance * by.transpose()
}

/// The stripes' noise in the normal and the entry, or in the normal and the vein's line, by way of one surface.
fn stripe_noise(i: &Inputs<'_>, surface: &Surface, patch: &Patch, what: Part<'_>) -> Nine9 {
    let nodes = &surface.nodes;
    let mut influence = vec![Nine::zeros(); nodes.len()];
    // By a pixel at each node.
    for (cell, links) in patch.cells.iter().zip(&patch.links) {
        for (node, weight) in links {
            let turn = i.fit.turn(cell, &nodes[*node as usize].shift);
            let mut place = influence[*node as usize].fixed_rows_mut::<3>(0);
            place += turn * *weight;
        }
    }
    match what {
        Part::Entry => {
            for (node, weight) in surface.links(i.entry).into_iter().flatten() {
                let step = surface.along_ray(i.entry, &nodes[node as usize].shift);
                let mut place = influence[node as usize].fixed_rows_mut::<3>(3);
                place += step * weight;
            }
        }
        Part::Line(line) => {
            for (j, p) in i.vein.iter().enumerate() {
                for (node, weight) in surface.links(p).into_iter().flatten() {
                    let step = surface.along_ray(p, &nodes[node as usize].shift);
                    let mut place = influence[node as usize].fixed_rows_mut::<3>(6);
                    place += line.turn(j, &step) * weight;
                }
            }
        }
    }
    // Stripe by stripe, in the order along it.
    let mut order: Vec<usize> = (0..nodes.len())
        .filter(|k| influence[*k] != Nine::zeros())
        .collect();
    order.sort_by_key(|k| (nodes[*k].frame, nodes[*k].column));
    let step = surface.step;
    let mut total = Nine9::zeros();
    for stripe in order.chunk_by(|a, b| nodes[*a].frame == nodes[*b].frame) {
        let mut shared = Nine::zeros();
        for (at, &a) in stripe.iter().enumerate() {
            let na = &nodes[a];
            shared += influence[a] * i.stripe_bias_px;
            let sigma = |k: usize| nodes[k].sigma_px;
            for &b in &stripe[at..] {
                let apart = f64::from(nodes[b].column - na.column) * step;
                let grain = 0.5 * (na.grain_mm + nodes[b].grain_mm);
                if apart > 3.0 * grain && b != a {
                    break;
                }
                let alike = if a == b {
                    1.0
                } else {
                    (-2.0 * apart / grain).exp()
                };
                let outer = influence[a] * influence[b].transpose() * (sigma(a) * sigma(b) * alike);
                total += if a == b {
                    outer
                } else {
                    outer + outer.transpose()
                };
            }
        }
        total += shared * shared.transpose();
    }
    total
}

/// Towards a hand's edge the surface bends more than the rest of it tells: of 24 entries there the
/// true change was about twice the guessed one.
const UNSEEN: f64 = 2.0;

fn sampling(i: &Inputs<'_>) -> Nine9 {
    let unseen = i.filled.map_or_else(Nine9::zeros, |normal| {
        let turn = (normal - i.fit.plane.normal) * UNSEEN;
        let change = stack(&turn, &Vector3::zeros(), &Vector3::zeros());
        change * change.transpose()
    });
    let Some((normal, entry, line)) = i.coarse else {
        return unseen;
    };
    let change = stack(
        &(normal - i.fit.plane.normal),
        &(entry - i.entry),
        &(line - i.line),
    );
    unseen + change * change.transpose()
}

/// ∂(cos α·v + sin α·n)/∂(n, entry, line), v the line laid into the plane.
fn axis_jacobian(n: &Vector3, line: &Vector3, angle: f64) -> SMatrix<f64, 3, 9> {
    let (sin, cos) = angle.sin_cos();
    let laid = line - n * n.dot(line);
    let length = laid.norm().max(1e-9);
    let v = laid / length;
    let unit = (Matrix3::identity() - v * v.transpose()) / length;
    let by_normal = -(Matrix3::identity() * n.dot(line) + n * line.transpose());
    let by_line = Matrix3::identity() - n * n.transpose();
    let mut j = SMatrix::<f64, 3, 9>::zeros();
    j.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&(unit * by_normal * cos + Matrix3::identity() * sin));
    j.fixed_view_mut::<3, 3>(0, 6)
        .copy_from(&(unit * by_line * cos));
    j
}

#[cfg(test)]
#[path = "uncertainty_tests.rs"]
mod tests;
