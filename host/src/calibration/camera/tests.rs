use super::*;
use crate::calibration::finding::Cause;
use crate::geometry::{Matrix2, Vector3};
use crate::synthetic::{BOARD, Noise, camera, corners, pose_at, poses};
use nalgebra::DMatrix;

fn views(poses: &[Pose], sigma: f64, noise: &mut Noise) -> Vec<Vec<Corner>> {
    poses
        .iter()
        .map(|p| corners(&camera(), p, sigma, noise))
        .collect()
}

fn solve_views(views: &[Vec<Corner>]) -> Result<CameraCalibration, CameraError> {
    calibrate(views, &BOARD, 1280, 960)
}

fn refused_for(result: Result<CameraCalibration, CameraError>) -> Vec<Cause> {
    match result {
        Err(CameraError::Refused(findings, _)) => findings
            .iter()
            .filter(|f| f.severity == Severity::Refuse)
            .map(|f| f.cause)
            .collect(),
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn exact_corners_give_the_camera_back() {
    let mut noise = Noise(1);
    for seed in 0..5 {
        let mut rng = Noise(seed);
        let views = views(&poses(&camera(), 15, 0.6, &mut rng), 0.0, &mut noise);
        let found = solve_views(&views).unwrap();
        let (p, q) = (found.camera.parameters(), camera().parameters());
        // The weak prior on the distortion is all that is left.
        for (i, tolerance) in [1e-4, 1e-4, 1e-3, 1e-3, 1e-5, 1e-3, 1e-6, 1e-6, 5e-3]
            .into_iter()
            .enumerate()
        {
            assert!(
                (p[i] - q[i]).abs() < tolerance,
                "{i}: {} for {}",
                p[i],
                q[i]
            );
        }
        assert!(found.rms_px < 1e-4, "{}", found.rms_px);
    }
}

/// Errors divided by their covariance: a χ² of nine degrees of freedom, mean 9, variance 18.
#[test]
fn the_covariance_is_honest() {
    let trials = 150;
    let mut rng = Noise(7);
    let poses = poses(&camera(), 12, 0.6, &mut rng);
    let truth = camera().parameters();
    let (mut sum, mut factors) = (0.0, 0.0);
    let mut focal = 0.0;
    for _ in 0..trials {
        let sigma = 0.02;
        let mut views = views(&poses, sigma, &mut rng);
        // Told a wrong scale: the residuals must put it right.
        for corner in views.iter_mut().flatten() {
            corner.covariance *= 0.25;
        }
        let found = solve_views(&views).unwrap();
        let p = found.camera.parameters();
        let e = nalgebra::SVector::<f64, PARAMETERS>::from_fn(|i, _| p[i] - truth[i]);
        let inverse = found.covariance.try_inverse().unwrap();
        sum += (e.transpose() * inverse * e)[0];
        focal += e[0] * e[0] / found.covariance[(0, 0)];
        factors += found.variance_factor;
    }
    let n = f64::from(trials);
    let (mean, factor, focal) = (sum / n, factors / n, focal / n);
    // Four standard deviations of the mean.
    assert!(
        (mean - 9.0).abs() < 4.0 * (18.0 / n).sqrt() + 0.2,
        "χ² {mean}"
    );
    assert!((focal - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "fx {focal}");
    assert!((factor - 4.0).abs() < 0.1, "variance factor {factor}");
}

/// A second implementation: dense Gauss–Newton with derivatives by differences, quadratic loss.
#[test]
fn agrees_with_a_dense_solver() {
    let mut rng = Noise(11);
    let poses = poses(&camera(), 5, 0.6, &mut rng);
    let views: Vec<Vec<Corner>> = poses
        .iter()
        .map(|p| {
            let mut corners = corners(&camera(), p, 0.01, &mut rng);
            for (i, corner) in corners.iter_mut().enumerate() {
                let c = if i % 2 == 0 { 0.4 } else { -0.3 };
                corner.covariance = Matrix2::new(1.0, c, c, 0.7) * 1e-4;
            }
            corners
        })
        .collect();
    let found = solve_views(&views).unwrap();

    let unknowns = PARAMETERS + 6 * views.len();
    let rows: usize = 2 * 48 * views.len();
    let prior = distortion_prior(&found.camera);
    let residual = |x: &[f64]| -> Vec<f64> {
        let mut p = [0.0; PARAMETERS];
        p.copy_from_slice(&x[..PARAMETERS]);
        let camera = found.camera.with_parameters(&p);
        let mut out = Vec::with_capacity(rows + 5);
        for (v, corners) in views.iter().enumerate() {
            let s = &x[PARAMETERS + 6 * v..];
            let pose = poses[v].updated(
                &Vector3::new(s[0], s[1], s[2]),
                &Vector3::new(s[3], s[4], s[5]),
            );
            for (i, corner) in corners.iter().enumerate() {
                let e = camera.project(&pose.apply(&BOARD.point(i))).unwrap() - corner.pixel;
                // Whitened by the symmetric root here, by Cholesky there.
                let root = corner.covariance.symmetric_eigen();
                let w = root.eigenvectors
                    * Matrix2::from_diagonal(&root.eigenvalues.map(|l| 1.0 / l.sqrt()))
                    * root.eigenvectors.transpose();
                let e = w * e;
                out.extend([e.x, e.y]);
            }
        }
        for i in 0..5 {
            out.push(p[4 + i] / prior[i]);
        }
        out
    };
    let mut x = vec![0.0; unknowns];
    x[..PARAMETERS].copy_from_slice(&camera().parameters());
    for _ in 0..6 {
        let r = residual(&x);
        let mut jacobian = DMatrix::zeros(r.len(), unknowns);
        for k in 0..unknowns {
            let h = if k < 4 { 1e-3 } else { 1e-6 };
            let (mut a, mut b) = (x.clone(), x.clone());
            a[k] += h;
            b[k] -= h;
            let (ra, rb) = (residual(&a), residual(&b));
            for i in 0..r.len() {
                jacobian[(i, k)] = (ra[i] - rb[i]) / (2.0 * h);
            }
        }
        let r = nalgebra::DVector::from_vec(r);
        let step = jacobian.svd(true, true).solve(&r, 1e-14).unwrap();
        for (x, s) in x.iter_mut().zip(step.iter()) {
            *x -= s;
        }
    }
    let p = found.camera.parameters();
    for i in 0..PARAMETERS {
        let sigma = found.covariance[(i, i)].sqrt();
        // Equal but for the few corners beyond Huber's threshold.
        assert!(
            (p[i] - x[i]).abs() < 0.1 * sigma,
            "{i}: {} against {}",
            p[i],
            x[i]
        );
    }
}

#[test]
fn a_few_wrong_corners_do_little() {
    let mut rng = Noise(3);
    let poses = poses(&camera(), 15, 0.6, &mut rng);
    let clean = views(&poses, 0.01, &mut rng);
    let mut spoilt = clean.clone();
    for i in 0..20 {
        spoilt[i % 15][(7 * i) % 48].pixel += Vector2::new(3.0, -2.0);
    }
    let (a, b) = (solve_views(&clean).unwrap(), solve_views(&spoilt).unwrap());
    let sigma = a.covariance[(0, 0)].sqrt();
    assert!((a.camera.fx - b.camera.fx).abs() < 1.5 * sigma);
    assert!(
        (b.variance_factor - 1.0).abs() < 0.5,
        "{}",
        b.variance_factor
    );
}

#[test]
fn a_bad_view_is_left_out_by_name() {
    let mut rng = Noise(4);
    let poses = poses(&camera(), 12, 0.6, &mut rng);
    let mut views = views(&poses, 0.01, &mut rng);
    // The board bent: a smooth error that a homography hardly notices.
    for (i, corner) in views[5].iter_mut().enumerate() {
        let x = (i % 8) as f64 - 3.5;
        corner.pixel += Vector2::new(0.0, 0.05 * x * x);
    }
    // And one with its corners in another order.
    views[9].swap(0, 40);
    views[9].swap(3, 20);
    let found = solve_views(&views).unwrap();
    let named: Vec<_> = found
        .findings
        .iter()
        .filter(|f| f.cause == Cause::BadView)
        .filter_map(|f| f.view)
        .collect();
    assert_eq!(named, [5, 9]);
    let sigma = found.covariance[(0, 0)].sqrt();
    assert!((found.camera.fx - camera().fx).abs() < 4.0 * sigma);
}

#[test]
fn parallel_views_are_refused() {
    for tilt in [Vector3::zeros(), Vector3::new(0.5, 0.1, 0.0)] {
        for sigma in [0.005, 0.05, 0.3] {
            let mut rng = Noise(5);
            let views: Vec<_> = (0..12)
                .map(|i| {
                    let pixel =
                        Vector2::new(400.0 + 40.0 * f64::from(i), 350.0 + 20.0 * f64::from(i));
                    let turn = nalgebra::Rotation3::new(tilt)
                        * nalgebra::Rotation3::new(Vector3::z() * 0.1 * f64::from(i));
                    let pose = pose_at(
                        &camera(),
                        pixel,
                        400.0 + 10.0 * f64::from(i),
                        turn.scaled_axis(),
                    );
                    corners(&camera(), &pose, sigma, &mut rng)
                })
                .collect();
            let causes = refused_for(solve_views(&views));
            assert!(
                causes.contains(&Cause::ParallelViews)
                    || causes.contains(&Cause::UncertainFocalLength),
                "{causes:?}"
            );
        }
    }
}

#[test]
fn the_same_view_over_and_over_is_refused() {
    let mut rng = Noise(6);
    let pose = poses(&camera(), 1, 0.5, &mut rng)[0];
    let views = views(&[pose; 10], 0.02, &mut rng);
    refused_for(solve_views(&views));
}

#[test]
fn too_few_views_and_bad_input_are_errors() {
    let mut rng = Noise(8);
    let poses = poses(&camera(), 3, 0.6, &mut rng);
    let good = views(&poses, 0.02, &mut rng);
    assert!(matches!(
        solve_views(&good[..1]),
        Err(CameraError::TooFewViews {
            views: 1,
            needed: 3
        })
    ));
    assert!(matches!(
        solve_views(&[]),
        Err(CameraError::TooFewViews { .. })
    ));
    let mut short = good.clone();
    short[1].pop();
    assert!(matches!(
        solve_views(&short),
        Err(CameraError::WrongCornerCount {
            view: 1,
            found: 47,
            needed: 48
        })
    ));
    let mut broken = good.clone();
    broken[2][7].pixel.x = f64::NAN;
    assert!(matches!(
        solve_views(&broken),
        Err(CameraError::BadCorner { view: 2 })
    ));
    let mut point = good.clone();
    for corner in &mut point[0] {
        corner.pixel = Vector2::new(100.0, 100.0);
    }
    assert!(solve_views(&point).is_err());
}

#[test]
fn thirteen_views_of_an_unlike_camera() {
    // A short wide-angle lens as of a webcam: strong distortion, other aspect.
    let wide = Camera {
        width: 640,
        height: 480,
        fx: 533.0,
        fy: 531.0,
        u0: 342.0,
        v0: 234.0,
        distortion: crate::geometry::Distortion {
            k1: -0.281,
            k2: 0.0252,
            p1: 0.0012,
            p2: -0.0001,
            k3: 0.163,
        },
    };
    let mut rng = Noise(9);
    let mut views = Vec::new();
    while views.len() < 13 {
        let pixel = Vector2::new(rng.between(150.0, 500.0), rng.between(120.0, 360.0));
        let turn = Vector3::new(
            rng.between(-0.6, 0.6),
            rng.between(-0.6, 0.6),
            rng.between(-0.3, 0.3),
        );
        let pose = pose_at(&wide, pixel, rng.between(130.0, 220.0), turn);
        if crate::synthetic::visible(&wide, &pose) {
            views.push(corners(&wide, &pose, 0.1, &mut rng));
        }
    }
    let found = calibrate(&views, &BOARD, 640, 480).unwrap();
    let (p, q) = (found.camera.parameters(), wide.parameters());
    for i in 0..PARAMETERS {
        let sigma = found.covariance[(i, i)].sqrt();
        assert!(
            (p[i] - q[i]).abs() < 4.0 * sigma,
            "{i}: {} for {} ± {sigma}",
            p[i],
            q[i]
        );
    }
    assert!(found.covariance[(0, 0)].sqrt() < 1.0);
}
