//! Closed-form light planes: rays of stripe pixels meet the board, a common normal by singular
//! values of the scatter about each position's centroid, a and b by a straight line (Eq. 9).

use super::strand::Strand;
use super::tables::fit_travel;
use crate::calibration::LightModel;
use crate::geometry::{Camera, Matrix3, Plane, Point3, Pose, Vector3};

/// Centres of a stripe that are enough for a start.
const SAMPLES: usize = 24;
/// Least ratio of the scatter across the lines to that along them: below, all lines are one.
const LEAST_SPREAD: f64 = 1e-6;

/// Common normal, a (0 without travel) and b; `None` where the stripes lie on one line.
pub fn start(
    camera: &Camera,
    strands: &[Strand],
    poses: &[Pose],
    positions: &[f64],
) -> Option<LightModel> {
    let mut points: Vec<(usize, f64, Point3)> = Vec::new();
    for strand in strands {
        let board = poses[strand.view].plane()?;
        for pixel in strand.sample(strand.len() / SAMPLES) {
            if let Some(p) = camera.ray(&pixel).and_then(|ray| board.meet(&ray)) {
                points.push((strand.position, strand.slide_mm, p));
            }
        }
    }
    // Again without the points that lie far off: reflections, borders of squares.
    for _ in 0..4 {
        let model = fit(&points, positions.len())?;
        let distance = |(_, x, p): &(usize, f64, Point3)| model.plane(*x).distance(p).abs();
        let mut all: Vec<f64> = points.iter().map(distance).collect();
        let middle = all.len() / 2;
        let (_, median, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
        let limit = 6.0 * *median + 1e-9;
        let before = points.len();
        points.retain(|p| distance(p) <= limit);
        if points.len() == before {
            break;
        }
    }
    fit(&points, positions.len())
}

fn fit(points: &[(usize, f64, Point3)], positions: usize) -> Option<LightModel> {
    let mut centre = vec![(Vector3::zeros(), 0.0, 0.0); positions];
    for (i, x, p) in points {
        let c = &mut centre[*i];
        c.0 += p.coords;
        c.1 += x;
        c.2 += 1.0;
    }
    for c in &mut centre {
        if c.2 > 0.0 {
            c.0 /= c.2;
            c.1 /= c.2;
        }
    }
    let mut scatter = Matrix3::zeros();
    for (i, _, p) in points {
        let d = p.coords - centre[*i].0;
        scatter += d * d.transpose();
    }
    let (plane, eigenvalues) = Plane::from_scatter(&Point3::origin(), &scatter)?;
    if !(eigenvalues[1] > LEAST_SPREAD * eigenvalues[2]) {
        return None;
    }
    let offsets: Vec<(f64, f64)> = centre
        .iter()
        .filter(|c| c.2 > 0.0)
        .map(|c| (c.1, -plane.normal.dot(&c.0)))
        .collect();
    let (a, b) = if positions > 1 {
        fit_travel(&offsets)?
    } else {
        (0.0, offsets.first()?.1)
    };
    Some(LightModel {
        normal: plane.normal,
        a,
        b,
    })
}
