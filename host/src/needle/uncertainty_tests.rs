use super::*;
use crate::calibration::Covariance;
use crate::needle::scene::{Hand, cloud};
use crate::needle::{Settings, decide};
use crate::synthetic::{Noise, rig};

/// A covariance of the size that a good calibration has, with correlations.
fn covariance() -> Covariance {
    let sigma = [
        0.3, 0.3, 1.0, 1.0, 0.003, 0.03, 1e-4, 1e-4, 0.1, 2e-4, 2e-4, 1e-4, 0.03,
    ];
    let mut noise = Noise(99);
    let mix = Covariance::from_fn(|i, j| if i == j { 1.0 } else { 0.25 * noise.normal() });
    let d = Covariance::from_diagonal(&SVector::from(sigma));
    d * (mix * mix.transpose() / 1.75) * d
}

#[test]
fn the_displacement_is_the_derivative_of_triangulation() {
    let mut r = rig();
    let p = Point3::new(12.0, -21.0, 431.0);
    let pixel = r.camera.project(&p).unwrap();
    let slide = (-r.light.normal.dot(&p.coords) - r.light.b) / r.light.a;
    let d = displacement(&p, &r).unwrap();
    let nominal = r.clone();
    let steps = [
        1e-3, 1e-3, 1e-3, 1e-3, 1e-5, 1e-4, 1e-6, 1e-6, 1e-3, 1e-6, 1e-6, 1e-6, 1e-4,
    ];
    for k in 0..PARAMETERS {
        let at = |sign: f64, r: &mut RigModel| {
            *r = nominal.clone();
            if k < 9 {
                let mut q = r.camera.parameters();
                q[k] += sign * steps[k];
                r.camera = r.camera.with_parameters(&q);
            } else {
                let mut q = [0.0; 4];
                q[k - 9] = sign * steps[k];
                r.light = r.light.updated(&q);
            }
            r.light
                .plane(slide)
                .meet(&r.camera.ray(&pixel).unwrap())
                .unwrap()
        };
        let numeric = (at(1.0, &mut r) - at(-1.0, &mut r)) / (2.0 * steps[k]);
        let error = (numeric - d.column(k)).norm();
        assert!(
            error < 1e-5 * (1.0 + numeric.norm()),
            "parameter {k}: {numeric} {}",
            d.column(k)
        );
    }
}

/// The stated covariances against what really happens over many calibrations and scans drawn at
/// random: the Mahalanobis distances must have the mean that their dimension gives.
#[test]
fn stated_and_true_scatter_agree() {
    let truth = rig();
    let hand = Hand::new(&mut Noise(21));
    let request = hand.request(&truth);
    let stripes = hand.stripes(&truth);
    let covariance = covariance();
    let root = covariance.cholesky().unwrap().l();
    let settings = Settings {
        stripe_bias_px: 0.0,
        ..Settings::default()
    };
    let exact = decide(
        &cloud(&stripes, &truth, 0.0, 1, &mut Noise(1)),
        &truth,
        &request,
        &settings,
    )
    .unwrap();
    let mut noise = Noise(5);
    let draws = 120;
    // (calibration drawn, stripe noise in px)
    for (calibrated, sigma) in [(true, 0.0), (false, 0.2), (true, 0.1)] {
        let (mut angle, mut entry, mut axis) = (0.0, 0.0, 0.0);
        for _ in 0..draws {
            let mut r = truth.clone();
            if calibrated {
                let z = SVector::<f64, PARAMETERS>::from_fn(|_, _| noise.normal());
                let e = root * z;
                let mut q = r.camera.parameters();
                for k in 0..9 {
                    q[k] += e[k];
                }
                r.camera = r.camera.with_parameters(&q);
                r.light = r.light.updated(&[e[9], e[10], e[11], e[12]]);
                r.covariance = covariance;
            }
            let points = cloud(&stripes, &r, sigma, 4, &mut noise);
            let d = decide(&points, &r, &request, &settings).unwrap();
            let u = &d.uncertainty;
            let s = u.angle_parts.map(|x| x * x);
            let direction = exact.direction;
            angle += (d.plane.normal - exact.plane.normal)
                .dot(&direction)
                .powi(2)
                / (s[0] + s[1]);
            let e = d.entry - exact.entry;
            let part = u.entry_parts_mm.map(|x| x * x);
            entry += e.norm_squared() / (part[0] + part[1]);
            let a = d.needle.axis - exact.needle.axis;
            axis += a.norm_squared() / u.axis.trace();
        }
        let n = f64::from(draws);
        let ratio = [angle / n, entry / n, axis / n].map(f64::sqrt);
        println!("calibrated {calibrated}, stripe {sigma} px: true over stated {ratio:.2?}");
        // Each of 120 draws: the ratio itself scatters by 6 %. The worst direction's variance
        // stands for the entry's whole, so that may come out up to √3 for an isotropic error;
        // the axis carries the sampling term, which is the same in every draw.
        assert!((0.8..1.25).contains(&ratio[0]), "angle {ratio:?}");
        assert!((0.75..1.35).contains(&ratio[1]), "entry {ratio:?}");
        assert!((0.5..1.25).contains(&ratio[2]), "axis {ratio:?}");
    }
}

#[test]
fn the_axis_derivative_is_right() {
    let n = Vector3::new(0.07, 0.58, 0.81).normalize();
    let line = Vector3::new(0.4, -0.75, 0.52).normalize();
    let angle = 0.6f64;
    let axis = |n: &Vector3, l: &Vector3| {
        crate::needle::axis::into_plane(l, n).unwrap() * angle.cos() + n * angle.sin()
    };
    let j = axis_jacobian(&n, &line, angle);
    for k in 0..9 {
        let h = 1e-6;
        let move_by = |sign: f64| {
            let (mut n, mut l) = (n, line);
            match k {
                0..3 => n[k] += sign * h,
                6..9 => l[k - 6] += sign * h,
                _ => {}
            }
            axis(&n, &l)
        };
        let numeric = (move_by(1.0) - move_by(-1.0)) / (2.0 * h);
        assert!((numeric - j.column(k)).norm() < 1e-8, "{k}");
    }
}
