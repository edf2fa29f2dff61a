//! Vein direction, needle axis and path (paper, Section 2.4 and Figure 23; Eq. 17–19).

use super::Settings;
use crate::geometry::{Matrix3, Plane, Point3, Vector3};

/// The needle for a wanted angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleAxis {
    /// Angle between the needle and the plane, rad.
    pub angle: f64,
    /// Unit vector in which the needle advances: in the plane of the vein and the normal, into the
    /// hand.
    pub axis: Vector3,
    /// The straight way in.
    pub path: Path,
}

/// The straight way of the needle's tip, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// Where it begins, before the hand.
    pub start: Point3,
    /// Where it meets the skin.
    pub entry: Point3,
    /// Where it ends.
    pub end: Point3,
}

/// Eq. 19: the angle between a plane and a needle vector (any length), rad, 0 to π/2.
/// `None` for a vector without length.
pub fn angle(plane: &Plane, vector: &Vector3) -> Option<f64> {
    let length = vector.norm() * plane.normal.norm();
    (length > 0.0 && length.is_finite())
        .then(|| (plane.normal.dot(vector).abs() / length).min(1.0).asin())
}

/// The line through points by orthogonal least squares, in the order in which they come; `None`
/// without a direction.
pub fn line(points: &[Point3]) -> Option<Vector3> {
    if points.len() < 2 {
        return None;
    }
    let n = points.len() as f64;
    let centre: Vector3 = points.iter().map(|p| p.coords).sum::<Vector3>() / n;
    let mut scatter = Matrix3::zeros();
    let mut order = Vector3::zeros();
    for (i, p) in points.iter().enumerate() {
        let r = p.coords - centre;
        scatter += r * r.transpose();
        order += r * (i as f64 - 0.5 * (n - 1.0));
    }
    let eigen = scatter.symmetric_eigen();
    let axis: Vector3 = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imax())
        .into_owned();
    let sign = axis.dot(&order);
    if !(scatter.trace() > 1e-12 && sign.abs() > 1e-9) {
        return None;
    }
    Some(axis.normalize() * sign.signum())
}

/// How long the points' course is along their line, mm.
pub fn length(points: &[Point3], line: &Vector3) -> f64 {
    let along = points.iter().map(|p| p.coords.dot(line));
    let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
        (a.min(x), b.max(x))
    });
    (high - low).max(0.0)
}

/// Distance of a point from the line through the points' middle, mm.
pub fn beside(points: &[Point3], line: &Vector3, point: &Point3) -> f64 {
    let centre = points.iter().map(|p| p.coords).sum::<Vector3>() / points.len().max(1) as f64;
    (point.coords - centre).cross(line).norm()
}

/// A direction laid into the plane along its normal, unit; `None` if it is the normal.
pub fn into_plane(direction: &Vector3, normal: &Vector3) -> Option<Vector3> {
    let laid = direction - normal * normal.dot(direction);
    let length = laid.norm();
    (length > 1e-3 * direction.norm()).then(|| laid / length)
}

impl NeedleAxis {
    /// The axis at the wanted angle: cos α·v + sin α·n, n pointing into the hand.
    pub fn new(plane: &Plane, direction: &Vector3, entry: &Point3, settings: &Settings) -> Self {
        let (sin, cos) = settings.angle.sin_cos();
        let axis = (direction * cos + plane.normal * sin).normalize();
        // Depth is measured at right angles to the plane.
        let inside = if sin > 1e-3 {
            settings.depth_mm / sin
        } else {
            0.0
        };
        Self {
            angle: settings.angle,
            axis,
            path: Path {
                start: entry - axis * settings.stand_off_mm,
                entry: *entry,
                end: entry + axis * inside,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eq. 20's plane of the paper with needle vectors whose angle is known by construction.
    #[test]
    fn the_angle_comes_back_by_eq_19() {
        let plane = Plane::new(Vector3::new(-0.08, -0.53, -0.84), 373.38).unwrap();
        let v = into_plane(&Vector3::new(0.4, -0.75, 0.5), &plane.normal).unwrap();
        assert!(v.dot(&plane.normal).abs() < 1e-15);
        let entry = Point3::new(2.0, -12.0, 431.0);
        for degrees in [5.0, 15.0, 30.0, 45.0, 60.0, 90.0f64] {
            let settings = Settings {
                angle: degrees.to_radians(),
                ..Settings::default()
            };
            let needle = NeedleAxis::new(&plane, &v, &entry, &settings);
            let got = angle(&plane, &(needle.axis * 7.0)).unwrap();
            // asin is flat at 90°: half the digits remain there.
            assert!((got.to_degrees() - degrees).abs() < 1e-6, "{degrees}");
            assert!(needle.axis.dot(&plane.normal) > 0.0, "into the hand");
            assert!(needle.axis.dot(&v) > -1e-12, "with the vein");
            assert!(
                needle.axis.cross(&v).dot(&plane.normal).abs() < 1e-12,
                "in the section plane"
            );
            let depth = (needle.path.end - entry).dot(&plane.normal);
            assert!((depth - settings.depth_mm).abs() < 1e-9);
            assert!(((needle.path.start - entry).norm() - settings.stand_off_mm).abs() < 1e-9);
        }
        assert_eq!(angle(&plane, &Vector3::zeros()), None);
    }

    #[test]
    fn the_line_runs_in_the_order_of_its_points() {
        let p = |i: f64| Point3::new(1.0 + 0.3 * i, 2.0 - 0.5 * i, 400.0 + 0.1 * i);
        let forth = line(&[p(0.0), p(1.0), p(3.0)]).unwrap();
        let back = line(&[p(3.0), p(1.0), p(0.0)]).unwrap();
        let truth = Vector3::new(0.3, -0.5, 0.1).normalize();
        assert!((forth - truth).norm() < 1e-9 && (back + truth).norm() < 1e-9);
        assert_eq!(line(&[p(1.0), p(1.0)]), None);
    }
}
