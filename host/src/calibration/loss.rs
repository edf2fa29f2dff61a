//! The paper's error function over points in space: Eq. 7 (calibration: reprojection, straight
//! line, plane) and Eq. 11 (measurement: without the straight line), with Eq. 8's angle.
//!
//! As printed, ln‖u_o − u_c‖² has no lower bound: the loss is least, −∞, wherever one point
//! reprojects exactly, whatever the rest does. A guard ε is added under the logarithm,
//! ln(‖u_o − u_c‖² + ε). And ln‖n‖² is zero here, since the plane is kept at unit length: left
//! free, ‖n‖ < 1 would cancel the distance term instead of reducing it.

use crate::geometry::{Camera, Matrix3, Plane, Point3, Vector2, Vector3};
use nalgebra::{Cholesky, RowVector3};
use serde::Serialize;

/// How to minimise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// ε, px².
    #[serde(rename = "guard ε / px²")]
    pub guard_px2: f64,
    /// Most sweeps over all points.
    #[serde(rename = "most sweeps")]
    pub sweeps: usize,
    /// A sweep that moves no point by more ends the minimisation, mm.
    #[serde(rename = "ends when no point moves by more / mm")]
    pub tolerance_mm: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            guard_px2: 1e-6,
            sweeps: 50,
            tolerance_mm: 1e-7,
        }
    }
}

/// The sums that the paper's tables and figures show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measures {
    /// Points.
    pub points: usize,
    /// Σ‖u_o − u_c‖², px² (Table 1).
    pub reprojection_px2: f64,
    /// Mean distance from the plane, mm (Figure 14).
    pub plane_mm: f64,
}

/// Measures points against their pixels and a plane.
pub fn measure(camera: &Camera, pixels: &[Vector2], points: &[Point3], plane: &Plane) -> Measures {
    let n = points.len();
    Measures {
        points: n,
        reprojection_px2: points
            .iter()
            .zip(pixels)
            .filter_map(|(p, u)| Some((camera.project(p)? - u).norm_squared()))
            .sum(),
        plane_mm: points.iter().map(|p| plane.distance(p).abs()).sum::<f64>() / n.max(1) as f64,
    }
}

/// Moves the points of one stripe (in order along it) so that Eq. 7 (`straight`) or Eq. 11 is
/// least, the plane standing still: Gauss–Newton with damping, point after point. The logarithm is
/// majorised by its tangent, so that no accepted step raises the loss.
pub fn minimise(
    camera: &Camera,
    pixels: &[Vector2],
    points: &mut [Point3],
    plane: &Plane,
    straight: bool,
    settings: &Settings,
) {
    for _ in 0..settings.sweeps {
        let mut largest: f64 = 0.0;
        for i in 0..points.len().min(pixels.len()) {
            largest = largest.max(step(
                camera, &pixels[i], points, i, plane, straight, settings,
            ));
        }
        if largest <= settings.tolerance_mm {
            break;
        }
    }
}

/// One damped Gauss–Newton step of point i; how far it moved, mm.
fn step(
    camera: &Camera,
    pixel: &Vector2,
    points: &mut [Point3],
    i: usize,
    plane: &Plane,
    straight: bool,
    settings: &Settings,
) -> f64 {
    let Some(projection) = camera.project_with_jacobian(&points[i]) else {
        return 0.0;
    };
    let miss = projection.pixel - pixel;
    let weight = 1.0 / (miss.norm_squared() + settings.guard_px2);
    let mut hessian: Matrix3 = weight * projection.by_point.transpose() * projection.by_point;
    let mut gradient: Vector3 = weight * projection.by_point.transpose() * miss;
    let mut add = |residual: f64, slope: RowVector3<f64>| {
        hessian += slope.transpose() * slope;
        gradient += slope.transpose() * residual;
    };
    let distance = plane.distance(&points[i]);
    add(
        distance.abs().ln_1p(),
        plane.normal.transpose() * (distance.signum() / (1.0 + distance.abs())),
    );
    if straight {
        for (first, role) in triples(i, points.len()) {
            let (residual, slopes) = bend(&points[first], &points[first + 1], &points[first + 2]);
            add(residual, slopes[role]);
        }
    }
    let loss = |points: &[Point3]| local_loss(camera, pixel, points, i, plane, straight, settings);
    let (start, before) = (points[i], loss(points));
    let mut damping = 1e-9 * hessian.trace();
    for _ in 0..12 {
        let Some(cholesky) = Cholesky::new(hessian + Matrix3::identity() * damping) else {
            damping *= 100.0;
            continue;
        };
        let move_by = cholesky.solve(&gradient);
        points[i] = start - move_by;
        if loss(points) <= before {
            return move_by.norm();
        }
        damping *= 100.0;
    }
    points[i] = start;
    0.0
}

/// The terms of the loss that point i takes part in.
fn local_loss(
    camera: &Camera,
    pixel: &Vector2,
    points: &[Point3],
    i: usize,
    plane: &Plane,
    straight: bool,
    settings: &Settings,
) -> f64 {
    let Some(projected) = camera.project(&points[i]) else {
        return f64::INFINITY;
    };
    let mut loss = ((projected - pixel).norm_squared() + settings.guard_px2).ln();
    loss += plane.distance(&points[i]).abs().ln_1p().powi(2);
    if straight {
        for (first, _) in triples(i, points.len()) {
            loss += bend(&points[first], &points[first + 1], &points[first + 2])
                .0
                .powi(2);
        }
    }
    loss
}

/// The triples of neighbours with point i in them: where each begins, and i's place in it.
fn triples(i: usize, n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..3)
        .filter_map(move |role| Some((i.checked_sub(role)?, role)))
        .filter(move |(first, _)| first + 2 < n)
}

/// Eq. 8: 1 − |cos θ| between ab and ac, with its slopes by a, b and c. Zero for coincident points.
fn bend(a: &Point3, b: &Point3, c: &Point3) -> (f64, [RowVector3<f64>; 3]) {
    let (ab, ac) = (b - a, c - a);
    let (lab, lac) = (ab.norm(), ac.norm());
    if lab < 1e-9 || lac < 1e-9 {
        return (0.0, [RowVector3::zeros(); 3]);
    }
    let (eb, ec) = (ab / lab, ac / lac);
    let cos = eb.dot(&ec);
    // 1 − |cos| without cancellation: |e_b ∓ e_c|²/2.
    let sign = cos.signum();
    let residual = (eb * sign - ec).norm_squared() / 2.0;
    let by_b = -sign * (ec - eb * cos) / lab;
    let by_c = -sign * (eb - ec * cos) / lac;
    (
        residual,
        [
            -(by_b + by_c).transpose(),
            by_b.transpose(),
            by_c.transpose(),
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::pinhole;

    /// A stripe on the plane, its points pushed off by a known pattern, and its true pixels.
    fn stripe() -> (Plane, Vec<Vector2>, Vec<Point3>) {
        let plane = Plane::new(Vector3::new(0.02, -0.87, 0.48), -190.0).unwrap();
        let camera = pinhole();
        let mut pixels = Vec::new();
        let mut points = Vec::new();
        for i in 0..60 {
            let on = plane
                .meet(&Vector3::new(-0.1 + 0.003 * i as f64, 0.01, 1.0))
                .unwrap();
            pixels.push(camera.project(&on).unwrap());
            let push = 0.05 * ((i * 7 % 11) as f64 - 5.0) / 5.0;
            points.push(on + Vector3::new(push, -push, 3.0 * push));
        }
        (plane, pixels, points)
    }

    #[test]
    fn the_angle_and_its_slopes() {
        let p = [
            Point3::new(0.0, 0.0, 400.0),
            Point3::new(1.0, 0.1, 400.3),
            Point3::new(2.0, 0.0, 400.5),
        ];
        let (residual, slopes) = bend(&p[0], &p[1], &p[2]);
        let (ab, ac) = (p[1] - p[0], p[2] - p[0]);
        let expected = 1.0 - (ab.dot(&ac) / (ab.norm() * ac.norm())).abs();
        assert!((residual - expected).abs() < 1e-14);
        for k in 0..3 {
            for axis in 0..3 {
                let h = 1e-5;
                let (mut hi, mut lo) = (p, p);
                hi[k][axis] += h;
                lo[k][axis] -= h;
                let numeric =
                    (bend(&hi[0], &hi[1], &hi[2]).0 - bend(&lo[0], &lo[1], &lo[2]).0) / (2.0 * h);
                assert!((slopes[k][axis] - numeric).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn both_losses_bring_points_to_their_ray_and_nearer_to_their_plane() {
        let (plane, pixels, start) = stripe();
        let before = measure(&pinhole(), &pixels, &start, &plane);
        for straight in [true, false] {
            let mut points = start.clone();
            minimise(
                &pinhole(),
                &pixels,
                &mut points,
                &plane,
                straight,
                &Settings::default(),
            );
            let after = measure(&pinhole(), &pixels, &points, &plane);
            assert!(before.reprojection_px2 > 0.1);
            assert!(after.reprojection_px2 < 1e-9, "{after:?}");
            assert!(after.plane_mm < before.plane_mm);
        }
    }

    #[test]
    fn points_that_satisfy_everything_stay() {
        let plane = stripe().0;
        let mut points: Vec<Point3> = (0..20)
            .map(|i| {
                plane
                    .meet(&Vector3::new(-0.1 + 0.01 * i as f64, 0.01, 1.0))
                    .unwrap()
            })
            .collect();
        let pixels: Vec<Vector2> = points
            .iter()
            .map(|p| pinhole().project(p).unwrap())
            .collect();
        let start = points.clone();
        minimise(
            &pinhole(),
            &pixels,
            &mut points,
            &plane,
            true,
            &Settings::default(),
        );
        for (p, q) in points.iter().zip(&start) {
            assert!((p - q).norm() < 1e-6);
        }
    }
}
