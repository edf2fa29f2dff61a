//! Calibration of whole recordings: real photographs against OpenCV's figures, rendered ones
//! against their truth.

use cannula::board::{self, BoardGeometry, Corner};
use cannula::calibration::camera;
use cannula::calibration::light::{self, BoardStripe, CameraData, LightView, Options};
use cannula::geometry::{Plane, Vector2, Vector3};
use cannula::session::{Session, decode};
use cannula::stripe;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A folder of the project's test data, or of the shared material beside the project.
fn folder(own: &str, shared: &str) -> Option<PathBuf> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let found = [
        top.join("tests/data").join(own),
        top.join("../shared").join(shared),
        top.join("../../shared").join(shared),
    ]
    .into_iter()
    .find(|p| p.is_dir());
    if found.is_none() {
        println!("skipped");
    }
    found
}

/// OpenCV 4.14 with cornerSubPix 5 × 5 and the same five coefficients: 13 of 13 boards, RMS
/// 0.1954 px, fx 532.83.
#[test]
fn real_photographs() {
    let Some(folder) = folder("opencv_left_9x6", "real/opencv_left_9x6") else {
        return;
    };
    let geometry = BoardGeometry {
        columns: 9,
        rows: 6,
        square_mm: 25.0,
    };
    let mut images: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap()
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|e| e == "jpg"))
        .collect();
    images.sort();
    assert_eq!(images.len(), 13);
    let views: Vec<Vec<Corner>> = images
        .iter()
        .map(|path| {
            let image = decode(path).unwrap().luma::<u8>().unwrap();
            let found = board::detect(&image, &geometry);
            found
                .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
                .corners
        })
        .collect();
    let found = camera::calibrate(&views, &geometry, 640, 480).unwrap();
    println!(
        "rms {:.4} px, fx {:.2} ± {:.2}, fy {:.2}, u0 {:.2}, v0 {:.2}, {:?}; views {:.3?}; {:?}",
        found.rms_px,
        found.camera.fx,
        found.covariance[(0, 0)].sqrt(),
        found.camera.fy,
        found.camera.u0,
        found.camera.v0,
        found.camera.distortion,
        found.view_rms_px,
        found.findings
    );
    assert!(found.used.iter().all(|&u| u), "{:?}", found.findings);
    assert!(found.rms_px <= 0.195, "{}", found.rms_px);
    assert!(
        (found.camera.fx / 532.8 - 1.0).abs() < 0.005,
        "{}",
        found.camera.fx
    );
}

/// What `calibrate` reaches on a recording with truth: relative errors of fx and fy, then mean and
/// largest distance (mm) of the planes from the true ones where the stripes are seen, in σ as well.
struct Figures {
    focal: [f64; 2],
    focal_sigma: f64,
    planes_mm: f64,
    a: f64,
    hold_out_mm: f64,
    offset_mm: f64,
}

fn figures(path: &Path) -> Figures {
    let session = Session::open(path).unwrap();
    let truth: Value =
        serde_json::from_slice(&std::fs::read(path.join("truth.json")).unwrap()).unwrap();
    let g = |v: &Value| v.as_f64().unwrap();
    let spec = session.manifest.board.unwrap();
    let geometry = BoardGeometry {
        columns: spec.columns,
        rows: spec.rows,
        square_mm: spec.square_mm,
    };
    let own: Vec<Vec<Corner>> = session
        .manifest
        .camera
        .iter()
        .map(|v| {
            board::detect(&session.luma::<u8>(&v.image).unwrap(), &geometry)
                .unwrap()
                .corners
        })
        .collect();
    let views: Vec<LightView> = session
        .manifest
        .light
        .iter()
        .map(|pose| {
            let off = session.luma::<u8>(pose.off.as_ref().unwrap()).unwrap();
            let corners = board::detect(&off, &geometry).unwrap().corners;
            let pixels: Vec<Vector2> = corners.iter().map(|c| c.pixel).collect();
            let stripes = pose
                .on
                .iter()
                .map(|frame| {
                    let on = session.luma::<u8>(&frame.image).unwrap();
                    let points = stripe::board::extract(
                        &on,
                        Some(&off),
                        &pixels,
                        geometry.columns,
                        geometry.rows,
                    );
                    BoardStripe {
                        slide_mm: frame.slide_mm,
                        points: points.unwrap_or_default(),
                    }
                })
                .collect();
            LightView { corners, stripes }
        })
        .collect();
    let all: Vec<Vec<Corner>> = own
        .iter()
        .cloned()
        .chain(views.iter().map(|v| v.corners.clone()))
        .collect();
    let start = camera::calibrate(
        &all,
        &geometry,
        session.manifest.image.width,
        session.manifest.image.height,
    )
    .unwrap();
    let found = light::calibrate(
        &start,
        CameraData::Views(&own),
        &views,
        &geometry,
        Options::default(),
    )
    .unwrap();

    let t = &truth["light"];
    let normal = Vector3::new(g(&t["normal"][0]), g(&t["normal"][1]), g(&t["normal"][2]));
    let (mut sum, mut count) = (0.0, 0.0);
    for (view, pose) in views.iter().zip(&found.poses) {
        let board = pose.plane().unwrap();
        for stripe in &view.stripes {
            let plane = Plane {
                normal,
                d: g(&t["a"]) * stripe.slide_mm + g(&t["b"]),
            };
            for p in stripe.points.iter().step_by(5) {
                let at = board.meet(&found.camera.ray(&p.pixel).unwrap()).unwrap();
                let on_true = at - plane.normal * plane.distance(&at);
                sum += found.model.plane(stripe.slide_mm).distance(&on_true).abs();
                count += 1.0;
            }
        }
    }
    let c = &truth["camera"];
    Figures {
        focal: [
            found.camera.fx / g(&c["fx"]) - 1.0,
            found.camera.fy / g(&c["fy"]) - 1.0,
        ],
        focal_sigma: found.covariance[(0, 0)].sqrt() / found.camera.fx,
        planes_mm: sum / count,
        a: found.model.a - g(&t["a"]),
        hold_out_mm: found.hold_out_mm.iter().copied().fold(0.0, f64::max),
        offset_mm: found.offset_error_mm,
    }
}

#[test]
fn nominal_recording() {
    let Some(folder) = folder("nominal-1001", "sessions/nominal-1001") else {
        return;
    };
    let f = figures(&folder);
    assert!(f.focal.iter().all(|e| e.abs() < 1e-4), "{:?}", f.focal);
    assert!(f.planes_mm < 0.02, "{}", f.planes_mm);
    assert!(f.a.abs() < 1e-4, "{}", f.a);
    assert!(f.hold_out_mm < 0.02, "{}", f.hold_out_mm);
    assert!(f.offset_mm < 0.01, "{}", f.offset_mm);
}

/// Small images and few poses: the errors are larger, and known to be.
#[test]
fn tiny_recording() {
    let Some(folder) = folder("tiny-1001", "sessions/tiny-1001") else {
        return;
    };
    let f = figures(&folder);
    assert!(
        f.focal.iter().all(|e| e.abs() < 4.0 * f.focal_sigma),
        "{:?} ± {}",
        f.focal,
        f.focal_sigma
    );
    assert!(f.focal_sigma < 1e-3, "{}", f.focal_sigma);
    assert!(f.planes_mm < 0.3, "{}", f.planes_mm);
    assert!(f.hold_out_mm < 0.05, "{}", f.hold_out_mm);
}
