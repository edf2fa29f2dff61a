use super::joint::{Rig, StripeNoise, add_strand};
use super::strand::Strand;
use super::*;
use crate::calibration::PARAMETERS;
use crate::calibration::camera;
use crate::calibration::finding::{Cause, Severity};
use crate::calibration::solve::{Block, POSE, moved};
use crate::calibration::synthetic::{
    BOARD, Noise, StripeErrors, corners, light, light_poses, poses, stripe,
};
use crate::geometry::tangent_basis;
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
    let camera = crate::calibration::synthetic::camera();
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
    let camera = crate::calibration::synthetic::camera();
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
        crate::calibration::synthetic::camera().parameters(),
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
        Err(LightError::Refused(findings)) => findings
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
    let camera = crate::calibration::synthetic::camera();
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
        (0.8, "8.000 mm"),
    ] {
        let mut views = s.light_views.clone();
        for stripe in views.iter_mut().flat_map(|v| &mut v.stripes) {
            stripe.slide_mm *= factor;
        }
        let result = solve_with(&s, &views, Options::default());
        match &result {
            Err(LightError::Refused(findings)) => {
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
            oblique_travel: true,
        },
    )
    .unwrap();
    assert!((found.model.a + 0.79994).abs() < 2e-4);
    assert!(
        found
            .findings
            .iter()
            .any(|f| f.cause == Cause::ObliqueTravel)
    );
}
