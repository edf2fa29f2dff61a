//! Stated against true errors over whole recordings, each of another rig, hand and noise: the sums
//! of squared normalised errors must lie in the band that chi-square gives them.

use cannula::needle;
use cannula::output::{AngleSource, CalibrationFile, ResultFile};
use cannula::pipeline::{Method, Times, calibrate, measure};
use cannula::progress::Silent;
use cannula::session::Session;
use cannula::simulation::{Profile, record};
use cannula_tests::truth::{Truth, three};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

/// Recordings; a second of processor each.
const SEEDS: u64 = 10;
/// The band's two ends, in deviates of a normal distribution: one honest run in a thousand of this
/// whole test falls outside (eight ends of 1.25e-4).
const DEVIATE: f64 = 3.662;

/// A quantile of chi-square over its degrees of freedom (Wilson and Hilferty 1931; at 10 degrees
/// right to 3 %).
fn band(degrees: f64, deviate: f64) -> f64 {
    let s = 2.0 / (9.0 * degrees);
    (1.0 - s + deviate * s.sqrt()).max(0.0).powi(3)
}

#[test]
fn the_band_is_chi_squares() {
    // Tabulated: 10 degrees 2.156 and 25.188 at 0.5 %, 30 degrees 14.953 and 50.892 at 1 %.
    for (degrees, deviate, quantile) in [
        (10.0, -2.5758, 2.156),
        (10.0, 2.5758, 25.188),
        (30.0, -2.3263, 14.953),
        (30.0, 2.3263, 50.892),
    ] {
        let found = degrees * band(degrees, deviate);
        assert!((found / quantile - 1.0).abs() < 0.03, "{found} {quantile}");
    }
}

fn matrix(value: &Value) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| value[i][j].as_f64().expect("a number"))
}

/// Squared Mahalanobis length of the difference of two unit vectors: two degrees.
fn turned(found: &Value, truth: Vector3<f64>, covariance: &Value) -> f64 {
    let u = truth.cross(&Vector3::x()).normalize();
    let plane = nalgebra::Matrix3x2::from_columns(&[u, truth.cross(&u)]);
    let d = plane.transpose() * (three(found) - truth);
    let c = plane.transpose() * matrix(covariance) * plane;
    (d.transpose() * c.try_inverse().expect("a covariance") * d)[0]
}

#[test]
fn stated_uncertainties_are_true() {
    // Degrees of freedom and sum of: focal length, normal, entry, axis.
    let names = ["focal length", "normal", "entry", "axis"];
    let degrees = [1.0, 2.0, 3.0, 2.0].map(|d| d * SEEDS as f64);
    let mut sums = [0.0; 4];
    for seed in 1..=SEEDS {
        let folder = tempfile::tempdir().unwrap();
        record(folder.path(), Profile::Tiny, seed, &Silent).unwrap();
        let truth = Truth::read(folder.path());
        let session = Session::open(folder.path()).unwrap();
        let times = Times::default();
        let calibrated = calibrate(&session, Method::Ml, &times, &Silent).unwrap();
        let file = CalibrationFile::new(&calibrated, &session);
        let (rig, positions) = (file.rig().unwrap(), file.positions());
        let settings = needle::Settings::default();
        let method = Method::Ml;
        let measured = measure(
            &session, &rig, &positions, method, &settings, &times, &Silent,
        )
        .unwrap();
        let result = ResultFile::new(&measured, "cloud.ply", AngleSource::Default, method, None);
        let r = serde_json::to_value(&result).unwrap();

        let fx = (rig.camera.fx - truth.fx()).powi(2) / rig.covariance[(0, 0)];
        let plane = &r["plane"];
        let normal = turned(
            &plane["normal"],
            truth.normal(),
            &plane["normal_covariance"],
        );
        let miss = three(&r["entry"]["point_mm"]) - truth.entry();
        let entry = matrix(&r["entry"]["covariance_mm2"]).try_inverse().unwrap() * miss;
        let needle = &r["needle"];
        let angle = needle["angle_deg"].as_f64().unwrap();
        let axis = turned(
            &needle["axis"],
            truth.axis(angle),
            &needle["axis_covariance"],
        );
        for (sum, part) in sums.iter_mut().zip([fx, normal, miss.dot(&entry), axis]) {
            *sum += part;
        }
    }
    for ((name, sum), degrees) in names.iter().zip(sums).zip(degrees) {
        let (found, low, high) = (
            sum / degrees,
            band(degrees, -DEVIATE),
            band(degrees, DEVIATE),
        );
        println!("{name}: {found:.2} where {low:.2} to {high:.2} is honest");
        assert!((low..high).contains(&found), "{name}");
    }
}
