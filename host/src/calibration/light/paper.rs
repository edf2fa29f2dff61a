//! The paper's way to the light planes (Section 2.2, Algorithm 1 lines 13–21, Eq. 6, 7, 9): stripe
//! points carried to the camera frame by homography and pose, optimised, a plane fitted to each
//! position by singular values, then one common normal and D = a·x + b.

use super::tables::{self, fit_travel};
use super::{LightView, SinglePlane};
use crate::board::BoardGeometry;
use crate::calibration::LightModel;
use crate::calibration::loss::{self, Measures, Settings};
use crate::geometry::{Camera, Homography, Matrix3, Plane, Point3, Pose, Vector2, Vector3};

/// The rig's light planes, as the paper finds them.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperLight {
    /// Common normal, a and b; a is 0 and b the plane's D where there is one position only.
    pub model: LightModel,
    /// Each position's plane on its own.
    pub planes: Vec<SinglePlane>,
    /// Positions without a plane of their own, mm: seen on one board alone.
    pub left_out: Vec<f64>,
    /// Table 1 for this rig: for each board pose, before and after Eq. 7 (all positions).
    pub views: Vec<(Measures, Measures)>,
    /// Figure 14 for this rig: for each position, before and after Eq. 7.
    pub positions: Vec<(Measures, Measures)>,
    /// Table 2.
    pub spacings: Vec<tables::Spacing>,
    /// Table 4.
    pub offsets: Vec<tables::Offset>,
}

/// Why there are no light planes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// No position has points on two boards that differ.
    #[error(
        "at each slide position the stripe points lie on one line: record the board in two or more poses"
    )]
    OneLine,
    /// No stripe at all.
    #[error("no stripe was found on any board")]
    NoStripe,
}

/// One stripe in the camera frame.
struct Strand {
    view: usize,
    position: usize,
    pixels: Vec<Vector2>,
    points: Vec<Point3>,
}

/// Algorithm 1 and Eq. 7, 9 over all views and positions. `poses[i]` is the board's pose in
/// `views[i]` (`solvePnP` in the paper).
pub fn calibrate(
    camera: &Camera,
    board: &BoardGeometry,
    views: &[LightView],
    poses: &[Pose],
    settings: &Settings,
) -> Result<PaperLight, Error> {
    let mut positions: Vec<f64> = views
        .iter()
        .flat_map(|v| {
            v.stripes
                .iter()
                .filter(|s| s.points.len() >= 2)
                .map(|s| s.slide_mm)
        })
        .collect();
    positions.sort_by(f64::total_cmp);
    positions.dedup();
    if positions.is_empty() {
        return Err(Error::NoStripe);
    }
    let mut strands = to_camera(board, views, poses, &positions);
    let left_out = drop_lines(&mut strands, &mut positions);
    if positions.is_empty() {
        return Err(Error::OneLine);
    }

    // Planes and points in turn: the plane of Eq. 7's third term is the one that the points define.
    let start = fit_positions(&strands, &positions)?;
    let measured = |strands: &[Strand], planes: &[SinglePlane]| -> Vec<Measures> {
        strands
            .iter()
            .map(|s| loss::measure(camera, &s.pixels, &s.points, &planes[s.position].plane))
            .collect()
    };
    let before = measured(&strands, &start);
    let mut planes = start;
    for _ in 0..3 {
        for s in &mut strands {
            let plane = planes[s.position].plane;
            loss::minimise(camera, &s.pixels, &mut s.points, &plane, true, settings);
        }
        planes = fit_positions(&strands, &positions)?;
    }
    let after = measured(&strands, &planes);

    let normal = common_normal(&strands, positions.len());
    let offsets: Vec<(f64, f64)> = positions
        .iter()
        .enumerate()
        .map(|(i, &x)| {
            (
                x,
                -normal.dot(&centroid(strands.iter().filter(|s| s.position == i)).0),
            )
        })
        .collect();
    let (a, b) = fit_travel(&offsets).unwrap_or((0.0, offsets[0].1));
    let pair_by = |key: fn(&Strand) -> usize, count: usize| -> Vec<(Measures, Measures)> {
        let mut pairs = vec![(Measures::default(), Measures::default()); count];
        for (s, (b, a)) in strands.iter().zip(before.iter().zip(&after)) {
            let pair = &mut pairs[key(s)];
            pair.0 = pool(&pair.0, b);
            pair.1 = pool(&pair.1, a);
        }
        pairs
    };
    Ok(PaperLight {
        model: LightModel { normal, a, b },
        views: pair_by(|s| s.view, views.len()),
        positions: pair_by(|s| s.position, positions.len()),
        spacings: tables::spacings(&normal, &offsets),
        offsets: tables::offsets(a, b, &offsets),
        planes,
        left_out,
    })
}

/// Eq. 6 after the homography: pixels to the board's plane to the camera frame. The lens's
/// distortion is not undone here, as in the paper; Eq. 7's first term takes it in.
fn to_camera(
    board: &BoardGeometry,
    views: &[LightView],
    poses: &[Pose],
    positions: &[f64],
) -> Vec<Strand> {
    let on_board: Vec<Vector2> = (0..board.corners())
        .map(|i| board.point(i).xy().coords)
        .collect();
    let mut strands = Vec::new();
    for (view, (seen, pose)) in views.iter().zip(poses).enumerate() {
        let corners: Vec<Vector2> = seen.corners.iter().map(|c| c.pixel).collect();
        let Ok(to_board) = Homography::fit(&corners, &on_board) else {
            continue;
        };
        for stripe in seen.stripes.iter().filter(|s| s.points.len() >= 2) {
            let Some(position) = positions.iter().position(|&x| x == stripe.slide_mm) else {
                continue;
            };
            let pixels: Vec<Vector2> = stripe.points.iter().map(|p| p.pixel).collect();
            let points = pixels
                .iter()
                .map(|p| {
                    let q = to_board.apply(p);
                    pose.apply(&Point3::new(q.x, q.y, 0.0))
                })
                .collect();
            strands.push(Strand {
                view,
                position,
                pixels,
                points,
            });
        }
    }
    strands
}

/// Takes out the positions whose points lie on one line; gives their slide positions, mm.
fn drop_lines(strands: &mut Vec<Strand>, positions: &mut Vec<f64>) -> Vec<f64> {
    let planar: Vec<bool> = (0..positions.len())
        .map(|i| {
            let of = || strands.iter().filter(move |s| s.position == i);
            let scatter = scatter(of(), &centroid(of()).0);
            // Two directions of spread make a plane; one makes a line.
            Plane::from_scatter(&Point3::origin(), &scatter)
                .is_some_and(|(_, values)| values[1] > 1e-6 * values[2])
        })
        .collect();
    let place = |i: usize| planar[..i].iter().filter(|&&p| p).count();
    strands.retain(|s| planar[s.position]);
    for s in strands.iter_mut() {
        s.position = place(s.position);
    }
    let mut kept = planar.iter();
    let left_out = positions
        .iter()
        .zip(&planar)
        .filter(|(_, planar)| !**planar)
        .map(|(&x, _)| x)
        .collect();
    positions.retain(|_| *kept.next().unwrap_or(&false));
    left_out
}

/// Line 21: a plane for each position.
fn fit_positions(strands: &[Strand], positions: &[f64]) -> Result<Vec<SinglePlane>, Error> {
    positions
        .iter()
        .enumerate()
        .map(|(i, &slide_mm)| {
            let of = || strands.iter().filter(move |s| s.position == i);
            let (centre, points) = centroid(of());
            let scatter = scatter(of(), &centre);
            let (plane, values) =
                Plane::from_scatter(&Point3::from(centre), &scatter).ok_or(Error::OneLine)?;
            Ok(SinglePlane {
                slide_mm,
                plane,
                points,
                rms_mm: (values[0].max(0.0) / points as f64).sqrt(),
            })
        })
        .collect()
}

/// Step 4 of Section 2.2.2: the direction of least scatter, each position about its own centroid.
fn common_normal(strands: &[Strand], positions: usize) -> Vector3 {
    let mut total = Matrix3::zeros();
    for i in 0..positions {
        let of = || strands.iter().filter(move |s| s.position == i);
        total += scatter(of(), &centroid(of()).0);
    }
    Plane::from_scatter(&Point3::origin(), &total).map_or(Vector3::z(), |(p, _)| p.normal)
}

fn centroid<'a>(strands: impl Iterator<Item = &'a Strand>) -> (Vector3, usize) {
    let (sum, n) = strands
        .flat_map(|s| &s.points)
        .fold((Vector3::zeros(), 0), |(sum, n), p| (sum + p.coords, n + 1));
    (sum / (n.max(1) as f64), n)
}

fn scatter<'a>(strands: impl Iterator<Item = &'a Strand>, centre: &Vector3) -> Matrix3 {
    strands
        .flat_map(|s| &s.points)
        .map(|p| (p.coords - centre) * (p.coords - centre).transpose())
        .sum()
}

/// Both measures together.
fn pool(a: &Measures, b: &Measures) -> Measures {
    let points = a.points + b.points;
    Measures {
        points,
        reprojection_px2: a.reprojection_px2 + b.reprojection_px2,
        plane_mm: (a.plane_mm * a.points as f64 + b.plane_mm * b.points as f64)
            / points.max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Corner;
    use crate::calibration::light::BoardStripe;
    use crate::geometry::{Distortion, Matrix2};
    use crate::stripe::StripePoint;
    use crate::synthetic::{self, BOARD};
    use nalgebra::Rotation3;

    fn rig(distortion: Distortion) -> (Camera, LightModel, BoardGeometry, Vec<Pose>) {
        let camera = Camera {
            distortion,
            ..synthetic::camera()
        };
        let poses = [(0.2, -0.1, 0.1), (-0.3, 0.2, 0.0), (0.1, 0.35, -0.2)]
            .map(|(x, y, z)| Pose {
                rotation: Rotation3::new(Vector3::new(x, y, z)),
                translation: Vector3::new(-35.0, -25.0, 425.0 + 40.0 * x),
            })
            .to_vec();
        (camera, synthetic::light(), BOARD, poses)
    }

    /// Exact stripe pixels on each board: points of the board's plane that lie on the light plane.
    fn views(
        camera: &Camera,
        light: &LightModel,
        board: &BoardGeometry,
        poses: &[Pose],
    ) -> Vec<LightView> {
        poses
            .iter()
            .map(|pose| LightView {
                corners: (0..board.corners())
                    .map(|i| Corner {
                        pixel: camera.project(&pose.apply(&board.point(i))).unwrap(),
                        covariance: Matrix2::identity() * 1e-4,
                    })
                    .collect(),
                stripes: [0.0, 5.0, 10.0]
                    .iter()
                    .map(|&slide_mm| {
                        let plane = light.plane(slide_mm);
                        let points = (0..70)
                            .filter_map(|i| {
                                // y on the board at which the light plane cuts x = i mm.
                                let at = |y: f64| {
                                    plane.distance(&pose.apply(&Point3::new(i as f64, y, 0.0)))
                                };
                                let y = at(0.0) / (at(0.0) - at(1.0));
                                let pixel =
                                    camera.project(&pose.apply(&Point3::new(i as f64, y, 0.0)))?;
                                Some(StripePoint {
                                    pixel,
                                    across: Vector2::new(0.0, 1.0),
                                    variance: 0.01,
                                    intensity: 100.0,
                                    width_px: 2.5,
                                    quality: 1.0,
                                })
                            })
                            .collect();
                        BoardStripe { slide_mm, points }
                    })
                    .collect(),
            })
            .collect()
    }

    #[test]
    fn without_distortion_the_planes_come_out_exactly() {
        let (camera, light, board, poses) = rig(Distortion::default());
        let seen = views(&camera, &light, &board, &poses);
        let found = calibrate(&camera, &board, &seen, &poses, &Settings::default()).unwrap();
        assert!((found.model.normal - light.normal).norm() < 1e-6);
        assert!((found.model.a - light.a).abs() < 1e-6);
        assert!((found.model.b - light.b).abs() < 1e-3);
        assert_eq!(found.planes.len(), 3);
        assert_eq!(found.spacings.len(), 2);
        assert!(tables::spacing_error(&found.spacings) < 1e-3);
        assert!(tables::offset_error(&found.offsets) < 1e-4);
    }

    #[test]
    fn eq_7_takes_out_the_reprojection_error_that_distortion_leaves() {
        let (camera, light, board, poses) = rig(Distortion {
            k1: -0.15,
            ..Distortion::default()
        });
        let seen = views(&camera, &light, &board, &poses);
        let found = calibrate(&camera, &board, &seen, &poses, &Settings::default()).unwrap();
        for (before, after) in &found.views {
            assert!(before.reprojection_px2 > 0.1, "{before:?}");
            assert!(
                after.reprojection_px2 < 1e-3 * before.reprojection_px2,
                "{after:?}"
            );
        }
        assert!((found.model.normal - light.normal).norm() < 5e-3);
    }

    /// A position that one board alone shows has no plane of its own; the others stand.
    #[test]
    fn a_position_on_one_board_alone_is_left_out() {
        let (camera, light, board, poses) = rig(Distortion::default());
        let mut seen = views(&camera, &light, &board, &poses);
        for view in &mut seen[1..] {
            view.stripes.retain(|s| s.slide_mm != 5.0);
        }
        let found = calibrate(&camera, &board, &seen, &poses, &Settings::default()).unwrap();
        assert_eq!(found.left_out, [5.0]);
        let positions: Vec<f64> = found.planes.iter().map(|p| p.slide_mm).collect();
        assert_eq!(positions, [0.0, 10.0]);
        assert!((found.model.normal - light.normal).norm() < 1e-6);
        assert!((found.model.a - light.a).abs() < 1e-6);
    }

    #[test]
    fn one_board_pose_makes_no_plane() {
        let (camera, light, board, poses) = rig(Distortion::default());
        let seen = views(&camera, &light, &board, &poses[..1]);
        let error = calibrate(&camera, &board, &seen, &poses[..1], &Settings::default());
        assert_eq!(error, Err(Error::OneLine));
        let none = calibrate(&camera, &board, &[], &[], &Settings::default());
        assert_eq!(none, Err(Error::NoStripe));
    }
}
