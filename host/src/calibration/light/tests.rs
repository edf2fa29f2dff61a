use super::joint::{Rig, StripeNoise, add_strand};
use super::strand::Strand;
use super::*;
use crate::calibration::PARAMETERS;
use crate::calibration::camera;
use crate::calibration::finding::{Cause, Severity};
use crate::calibration::solve::{Block, POSE, moved};
use crate::geometry::tangent_basis;
use crate::synthetic::{BOARD, Noise, StripeErrors, corners, light, light_poses, poses, stripe};
use nalgebra::SVector;

const EXACT: StripeErrors = StripeErrors {
    centre: 0.0,
    slide: 0.0,
    speckle: 0.0,
    correlation: 1.0,
};

struct Session {
    camera_views: Vec<Vec<Corner>>,
    light_views: Vec<LightView>,
}

/// A session as the contract describes it, of exact projections and these errors.
fn session(
    camera_poses: &[Pose],
    board_poses: &[Pose],
    slide: &[f64],
    corner_px: f64,
    errors: &StripeErrors,
    noise: &mut Noise,
) -> Session {
    let camera = crate::synthetic::camera();
    Session {
        camera_views: camera_poses
            .iter()
            .map(|p| corners(&camera, p, corner_px, noise))
            .collect(),
        light_views: board_poses
            .iter()
            .map(|p| LightView {
                corners: corners(&camera, p, corner_px, noise),
                stripes: slide
                    .iter()
                    .map(|&x| stripe(&camera, &light(), x, p, errors, noise))
                    .collect(),
            })
            .collect(),
    }
}

fn standard(seed: u64, corner_px: f64, errors: &StripeErrors) -> Session {
    let mut noise = Noise(seed);
    let camera = crate::synthetic::camera();
    let camera_poses = poses(&camera, 15, 0.6, &mut noise);
    let board_poses = light_poses(&camera, 9, &mut noise);
    let slide: Vec<f64> = (0..13).map(|i| 5.0 * f64::from(i)).collect();
    session(
        &camera_poses,
        &board_poses,
        &slide,
        corner_px,
        errors,
        &mut noise,
    )
}

fn solve(s: &Session) -> Result<LightCalibration, LightError> {
    solve_with(s, &s.light_views, Options::default())
}

fn solve_with(
    s: &Session,
    views: &[LightView],
    options: Options,
) -> Result<LightCalibration, LightError> {
    let mut all = s.camera_views.clone();
    all.extend(s.light_views.iter().map(|v| v.corners.clone()));
    let start = camera::calibrate(&all, &BOARD, 1280, 960).unwrap();
    calibrate(
        &start,
        CameraData::Views(&s.camera_views),
        views,
        &BOARD,
        options,
    )
}

/// Errors of the thirteen parameters.
fn errors(found: &LightCalibration) -> SVector<f64, PARAMETERS> {
    let (p, q) = (
        found.camera.parameters(),
        crate::synthetic::camera().parameters(),
    );
    // The normal's error in the frame of the covariance: that of the normal found.
    let t = tangent_basis(&found.model.normal).transpose() * (found.model.normal - light().normal);
    SVector::from_fn(|i, _| match i {
        0..9 => p[i] - q[i],
        9 | 10 => t[i - 9],
        11 => found.model.a - light().a,
        _ => found.model.b - light().b,
    })
}

fn causes(result: Result<LightCalibration, LightError>) -> Vec<Cause> {
    match result {
        Err(LightError::Refused(findings, _)) => findings
            .iter()
            .filter(|f| f.severity == Severity::Refuse)
            .map(|f| f.cause)
            .collect(),
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn gradient_agrees_with_differences() {
    let mut noise = Noise(1);
    let camera = crate::synthetic::camera();
    let pose = light_poses(&camera, 1, &mut noise)[0];
    let wide = StripeErrors {
        centre: 0.1,
        ..EXACT
    };
    let measured = stripe(&camera, &light(), 20.0, &pose, &wide, &mut noise);
    let mut strand = Strand::new(0, 0, &measured);
    let rig = Rig {
        camera,
        light: light(),
    };
    let drawn = super::strand::Drawn::new(&rig.camera, &rig.light, 20.0, &pose).unwrap();
    assert!(strand.measure(&drawn));
    strand.sum_up(&drawn, 1.0);
    let levels = StripeNoise {
        centre: 1.3,
        piece: 1e-4,
        stripe: 3e-4,
    };
    let at = |rig: &Rig, pose: &Pose| {
        let mut block = Block::zero();
        assert!(add_strand(&strand, rig, pose, &levels, &mut block));
        block
    };
    // Away from the minimum, so that the gradient is large.
    let rig = Rig {
        camera,
        light: light().updated(&[2e-4, 1e-4, 1e-3, 0.02]),
    };
    let block = at(&rig, &pose);
    let compare = |numeric: f64, exact: f64, curvature: f64, name: &str| {
        let size = curvature.sqrt() * block.cost.sqrt();
        assert!(
            (numeric - exact).abs() < 2e-5 * size,
            "{name}: {numeric} for {exact} of {size}"
        );
    };
    for i in 0..PARAMETERS {
        let h = [
            1e-2, 1e-2, 1e-2, 1e-2, 1e-4, 1e-3, 1e-6, 1e-6, 1e-2, 1e-6, 1e-6, 1e-5, 1e-4,
        ][i];
        let cost = |s: f64| {
            let mut p = rig.camera.parameters();
            let mut l = [0.0; 4];
            if i < 9 {
                p[i] += s
            } else {
                l[i - 9] = s
            }
            let moved = Rig {
                camera: camera.with_parameters(&p),
                light: rig.light.updated(&l),
            };
            at(&moved, &pose).cost
        };
        compare(
            (cost(h) - cost(-h)) / (4.0 * h),
            block.g[i],
            block.gg[i][i],
            &format!("global {i}"),
        );
    }
    for i in 0..POSE {
        let h = if i < 3 { 1e-6 } else { 1e-4 };
        let cost = |s: f64| {
            let mut step = [0.0; POSE];
            step[i] = s;
            at(&rig, &moved(&pose, &step)).cost
        };
        compare(
            (cost(h) - cost(-h)) / (4.0 * h),
            block.p[i],
            block.pp[i][i],
            &format!("pose {i}"),
        );
    }
}

#[test]
fn exact_data_gives_the_rig_back() {
    let found = solve(&standard(2, 0.0, &EXACT)).unwrap();
    assert!(found.model.normal.angle(&light().normal) < 1e-7);
    assert!(
        (found.model.a - light().a).abs() < 1e-6,
        "{}",
        found.model.a
    );
    assert!(
        (found.model.b - light().b).abs() < 1e-4,
        "{}",
        found.model.b
    );
    assert!((found.camera.fx - 2197.8).abs() < 1e-3);
    assert!(found.stripe_rms_px < 1e-3, "{}", found.stripe_rms_px);
    assert!(found.travels && found.planes.len() == 13);
    assert!(found.spacing_error_mm < 1e-3 && found.offset_error_mm < 1e-3);
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

/// Errors divided by their covariance: χ² of thirteen degrees of freedom, for white noise and for
/// noise that is common to pieces and to whole stripes.
#[test]
fn the_covariance_is_honest() {
    let trials = 40;
    let cases = [
        StripeErrors {
            centre: 0.08,
            ..EXACT
        },
        StripeErrors {
            centre: 0.05,
            slide: 0.004,
            speckle: 0.05,
            correlation: 12.0,
        },
    ];
    for (case, stripes) in cases.iter().enumerate() {
        let (mut sum, mut light_sum, mut b_sum) = (0.0, 0.0, 0.0);
        for trial in 0..trials {
            let s = standard(100 + trial, 0.01, stripes);
            let found = solve(&s).unwrap();
            let e = errors(&found);
            sum += (e.transpose() * found.covariance.try_inverse().unwrap() * e)[0];
            let l = e.fixed_rows::<4>(9).into_owned();
            let c = found.covariance.fixed_view::<4, 4>(9, 9).into_owned();
            light_sum += (l.transpose() * c.try_inverse().unwrap() * l)[0];
            b_sum += e[12] * e[12] / found.covariance[(12, 12)];
        }
        let n = trials as f64;
        let (mean, light_mean, b) = (sum / n, light_sum / n, b_sum / n);
        println!("case {case}: {mean:.2} of 13, light {light_mean:.2} of 4, b {b:.2} of 1");
        assert!(
            (mean - 13.0).abs() < 4.0 * (26.0 / n).sqrt(),
            "case {case}: χ² {mean}"
        );
        assert!(
            (light_mean - 4.0).abs() < 4.0 * (8.0 / n).sqrt(),
            "case {case}: χ² {light_mean}"
        );
    }
}

fn few(seed: u64) -> Session {
    standard(
        seed,
        0.01,
        &StripeErrors {
            centre: 0.06,
            ..EXACT
        },
    )
}

#[test]
fn positions_in_a_wrong_unit_are_named() {
    let s = few(3);
    for (factor, says) in [
        (1e-3, "metres"),
        (1.0 / 25.4, "inches"),
        (0.1, "centimetres"),
        (1e3, "micrometres"),
        (400.0, "steps per mm"),
        (0.8, "are 8.00"),
    ] {
        let mut views = s.light_views.clone();
        for stripe in views.iter_mut().flat_map(|v| &mut v.stripes) {
            stripe.slide_mm *= factor;
        }
        let result = solve_with(&s, &views, Options::default());
        match &result {
            Err(LightError::Refused(findings, _)) => {
                assert!(
                    findings
                        .iter()
                        .any(|f| f.cause == Cause::TravelUnit && f.what.contains(says)),
                    "{factor}: {findings:?}"
                );
            }
            other => panic!("{factor}: {other:?}"),
        }
        assert!(causes(result).contains(&Cause::TravelUnit));
    }
}

#[test]
fn an_oblique_slide_may_be_declared() {
    let s = few(4);
    let mut views = s.light_views.clone();
    for stripe in views.iter_mut().flat_map(|v| &mut v.stripes) {
        stripe.slide_mm /= 0.8; // the slide travels 1 mm for 0.8 mm of the plane
    }
    assert!(causes(solve_with(&s, &views, Options::default())).contains(&Cause::TravelUnit));
    let found = solve_with(
        &s,
        &views,
        Options {
            travel_angle: 0.8f64.acos(),
        },
    )
    .unwrap();
    assert!((found.model.a + 0.79994).abs() < 2e-4);
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

#[test]
fn one_position_gives_one_plane() {
    let mut s = few(5);
    for view in &mut s.light_views {
        view.stripes.truncate(5);
        view.stripes.drain(..4); // the one at 20 mm
    }
    let found = solve(&s).unwrap();
    assert!(!found.travels);
    assert_eq!(found.model.a, 0.0);
    assert_eq!(found.planes.len(), 1);
    assert!(found.hold_out_mm.is_empty() && found.spacings.is_empty());
    let truth = light().plane(20.0);
    let middle = crate::geometry::Point3::new(0.0, -20.0, 430.0);
    let on_plane = middle - truth.normal * truth.distance(&middle);
    assert!(found.model.plane(20.0).distance(&on_plane).abs() < 0.05);
    assert_eq!(found.covariance[(11, 11)], 0.0);
    assert!(found.covariance[(12, 12)] > 0.0);
    // Readings of an encoder that scatter by a micrometre are still one position.
    for (i, view) in s.light_views.iter_mut().enumerate() {
        view.stripes[0].slide_mm += 1e-3 * (i as f64).sin();
    }
    assert!(!solve(&s).unwrap().travels);
}

#[test]
fn a_stripe_from_another_position_is_named_and_does_little() {
    let clean = few(6);
    let good = solve(&clean).unwrap();
    let mut s = few(6);
    // Two images of view 3 swapped.
    let (a, b) = (
        s.light_views[3].stripes[4].points.clone(),
        s.light_views[3].stripes[5].points.clone(),
    );
    s.light_views[3].stripes[4].points = b;
    s.light_views[3].stripes[5].points = a;
    let found = solve(&s).unwrap();
    let named: Vec<_> = found.findings.iter().map(|f| (f.cause, f.view)).collect();
    assert_eq!(
        named,
        [(Cause::BadStripe, Some(3)), (Cause::BadStripe, Some(3))]
    );
    assert!(
        found.findings[0].what.contains("20 mm lies 5.0"),
        "{}",
        found.findings[0].what
    );
    let sigma = good.covariance[(12, 12)].sqrt();
    assert!((found.model.b - good.model.b).abs() < sigma);
}

#[test]
fn a_wrong_position_is_refused_by_name() {
    let mut s = few(7);
    for view in &mut s.light_views {
        view.stripes[6].slide_mm = 33.0; // the images are those of 30 mm
    }
    match solve(&s) {
        Err(LightError::Refused(findings, _)) => {
            assert!(
                findings
                    .iter()
                    .any(|f| f.severity == Severity::Refuse && f.what.contains("33 mm")),
                "{findings:?}"
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn reflections_do_little() {
    let clean = few(8);
    let good = solve(&clean).unwrap();
    let mut s = few(8);
    let mut noise = Noise(88);
    for stripe in s.light_views.iter_mut().flat_map(|v| &mut v.stripes) {
        for p in &mut stripe.points {
            if noise.uniform() < 0.1 {
                p.pixel.y += noise.between(-30.0, 30.0);
            }
        }
    }
    let found = solve(&s).unwrap();
    let sigma = good.covariance[(12, 12)].sqrt();
    assert!((found.model.b - good.model.b).abs() < 0.5 * sigma);
    assert!(
        (found.noise.stripe_scale - 1.0).abs() < 0.2,
        "{:?}",
        found.noise
    );
}

#[test]
fn without_variety_there_is_no_plane() {
    // One board pose alone; the same pose again and again.
    let s = few(9);
    assert!(matches!(
        solve_with(&s, &s.light_views[..1], Options::default()),
        Err(LightError::TooFewViews {
            views: 1,
            needed: 2
        })
    ));
    let mut noise = Noise(9);
    let camera = crate::synthetic::camera();
    let camera_poses = poses(&camera, 15, 0.6, &mut noise);
    let board_pose = light_poses(&camera, 1, &mut noise)[0];
    let slide: Vec<f64> = (0..13).map(|i| 5.0 * f64::from(i)).collect();
    for corner_px in [0.0, 0.01, 0.1] {
        let white = StripeErrors {
            centre: 0.06,
            ..EXACT
        };
        let s = session(
            &camera_poses,
            &[board_pose; 6],
            &slide,
            corner_px,
            &white,
            &mut noise,
        );
        match solve(&s) {
            Err(LightError::OneLine) => {}
            Err(LightError::Refused(findings, _)) => {
                assert!(
                    findings.iter().any(|f| f.cause == Cause::LightGeometry),
                    "{findings:?}"
                );
            }
            other => panic!("{corner_px}: {other:?}"),
        }
    }
}

#[test]
fn broken_input_is_an_error() {
    let s = few(10);
    let mut views = s.light_views.clone();
    views[2].stripes[3].slide_mm = f64::NAN;
    assert!(matches!(
        solve_with(&s, &views, Options::default()),
        Err(LightError::BadPosition { view: 2 })
    ));
    let mut views = s.light_views.clone();
    views[1].corners.pop();
    assert!(matches!(
        solve_with(&s, &views, Options::default()),
        Err(LightError::BadCorners {
            view: 1,
            needed: 48
        })
    ));
    let mut views = s.light_views.clone();
    for stripe in views.iter_mut().flat_map(|v| &mut v.stripes) {
        stripe.points.clear();
    }
    assert!(matches!(
        solve_with(&s, &views, Options::default()),
        Err(LightError::TooFewViews { .. })
    ));
    let mut views = s.light_views.clone();
    for p in views
        .iter_mut()
        .flat_map(|v| &mut v.stripes)
        .flat_map(|s| &mut s.points)
    {
        p.pixel.x = f64::NAN;
    }
    assert!(solve_with(&s, &views, Options::default()).is_err());
}

/// The camera as a prior, from views that are not given: the planes agree with the full solve.
#[test]
fn a_camera_calibrated_before_serves() {
    let s = few(11);
    let alone = camera::calibrate(&s.camera_views, &BOARD, 1280, 960).unwrap();
    let by_prior = calibrate(
        &alone,
        CameraData::Prior,
        &s.light_views,
        &BOARD,
        Options::default(),
    )
    .unwrap();
    let in_full = calibrate(
        &alone,
        CameraData::Views(&s.camera_views),
        &s.light_views,
        &BOARD,
        Options::default(),
    )
    .unwrap();
    for i in 0..PARAMETERS {
        let sigma = in_full.covariance[(i, i)].sqrt();
        let (a, b) = (errors(&by_prior)[i], errors(&in_full)[i]);
        // The same information, but for the prior's straight line and its scale.
        assert!(
            (a - b).abs() < 0.2 * sigma,
            "{i}: {a} against {b} ± {sigma}"
        );
        assert!(
            (by_prior.covariance[(i, i)].sqrt() / sigma - 1.0).abs() < 0.15,
            "{i}"
        );
    }
}

/// Residuals by another road: the stripe point's ray meets the board, and the column is found in
/// which the light plane crosses it; dense Gauss–Newton with derivatives by differences.
#[test]
fn agrees_with_a_dense_solver() {
    let camera = crate::synthetic::camera();
    let mut noise = Noise(12);
    let camera_poses = poses(&camera, 4, 0.6, &mut noise);
    let board_poses = light_poses(&camera, 3, &mut noise);
    let white = StripeErrors {
        centre: 0.06,
        ..EXACT
    };
    let s = session(
        &camera_poses,
        &board_poses,
        &[0.0, 20.0, 40.0],
        0.01,
        &white,
        &mut noise,
    );
    let found = solve(&s).unwrap();
    let all: Vec<&Vec<Corner>> = s
        .camera_views
        .iter()
        .chain(s.light_views.iter().map(|v| &v.corners))
        .collect();
    let start: Vec<Pose> = camera_poses.iter().chain(&board_poses).copied().collect();
    let prior = camera::distortion_prior(&found.camera);
    let residual = |x: &[f64]| -> Vec<f64> {
        let p: [f64; 9] = std::array::from_fn(|i| x[i]);
        let camera = camera.with_parameters(&p);
        let rig = light().updated(&std::array::from_fn(|i| x[9 + i]));
        let pose: Vec<Pose> = start
            .iter()
            .enumerate()
            .map(|(v, pose)| moved(pose, &std::array::from_fn(|i| x[13 + 6 * v + i])))
            .collect();
        let mut out = Vec::new();
        for (corners, pose) in all.iter().zip(&pose) {
            for (i, c) in corners.iter().enumerate() {
                let e = (camera.project(&pose.apply(&BOARD.point(i))).unwrap() - c.pixel)
                    / (c.covariance.m11.sqrt() * found.noise.corner_scale);
                out.extend([e.x, e.y]);
            }
        }
        for (view, pose) in s.light_views.iter().zip(&pose[camera_poses.len()..]) {
            let board = pose.plane().unwrap();
            for stripe in &view.stripes {
                let plane = rig.plane(stripe.slide_mm);
                for point in &stripe.points {
                    // Secant steps down the column to where the ray meets both planes.
                    let miss = |v: f64| {
                        let pixel = crate::geometry::Vector2::new(point.pixel.x, v);
                        plane.distance(&board.meet(&camera.ray(&pixel).unwrap()).unwrap())
                    };
                    let (mut v0, mut v1) = (point.pixel.y - 0.5, point.pixel.y + 0.5);
                    let (mut m0, mut m1) = (miss(v0), miss(v1));
                    for _ in 0..6 {
                        if (m1 - m0).abs() < 1e-13 {
                            break;
                        }
                        let next = v1 - m1 * (v1 - v0) / (m1 - m0);
                        (v0, m0) = (v1, m1);
                        v1 = next;
                        m1 = miss(v1);
                    }
                    out.push(
                        (point.pixel.y - v1) / (point.variance.sqrt() * found.noise.stripe_scale),
                    );
                }
            }
        }
        for i in 0..5 {
            out.push(p[4 + i] / prior[i]);
        }
        out
    };
    let unknowns = 13 + 6 * start.len();
    let mut x = vec![0.0; unknowns];
    x[..9].copy_from_slice(&camera.parameters());
    for _ in 0..4 {
        let r = residual(&x);
        let mut jacobian = nalgebra::DMatrix::zeros(r.len(), unknowns);
        for k in 0..unknowns {
            let h = if k < 4 { 1e-3 } else { 1e-6 };
            let (mut a, mut b) = (x.clone(), x.clone());
            a[k] += h;
            b[k] -= h;
            for (i, (ra, rb)) in residual(&a).iter().zip(residual(&b)).enumerate() {
                jacobian[(i, k)] = (ra - rb) / (2.0 * h);
            }
        }
        let normal = jacobian.transpose() * &jacobian;
        let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
        let scaled = nalgebra::DMatrix::from_fn(unknowns, unknowns, |i, k| {
            normal[(i, k)] * scale[i] * scale[k]
        });
        let rhs = (jacobian.transpose() * nalgebra::DVector::from_vec(r)).component_mul(&scale);
        let step = scaled.cholesky().unwrap().solve(&rhs).component_mul(&scale);
        for (x, s) in x.iter_mut().zip(step.iter()) {
            *x -= s;
        }
    }
    let oracle = light().updated(&std::array::from_fn(|i| x[9 + i]));
    for i in 0..9 {
        let sigma = found.covariance[(i, i)].sqrt();
        let p = found.camera.parameters()[i];
        assert!(
            (p - x[i]).abs() < 0.1 * sigma,
            "{i}: {p} against {} ± {sigma}",
            x[i]
        );
    }
    let t = tangent_basis(&found.model.normal).transpose() * (oracle.normal - found.model.normal);
    let differences = [t.x, t.y, oracle.a - found.model.a, oracle.b - found.model.b];
    for (i, d) in differences.into_iter().enumerate() {
        let sigma = found.covariance[(9 + i, 9 + i)].sqrt();
        assert!(d.abs() < 0.1 * sigma, "light {i}: {d} of {sigma}");
    }
}

#[test]
fn a_light_view_that_moved_is_left_out() {
    let clean = few(13);
    let good = solve(&clean).unwrap();
    let mut s = few(13);
    // The board bent in the image that gave the corners.
    for (i, corner) in s.light_views[4].corners.iter_mut().enumerate() {
        let x = (i % 8) as f64 - 3.5;
        corner.pixel.x += 0.4 * x * x;
    }
    let found = solve(&s).unwrap();
    for i in [0, 1, 12] {
        let sigma = good.covariance[(i, i)].sqrt();
        let (a, b) = (errors(&found)[i], errors(&good)[i]);
        assert!(
            (a - b).abs() < 1.5 * sigma,
            "{i}: {a} against {b} ± {sigma}"
        );
    }
    assert_eq!(found.view_measures[4].1.points, 0);
    assert_eq!(found.poses.len(), 9);
}
