//! How long the calibration takes after the corners and stripes are found, one thread.

use cannula::board::{BoardGeometry, Corner};
use cannula::calibration::camera;
use cannula::geometry::{Camera, Distortion, Matrix2, Point3, Pose, Vector2, Vector3};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Rotation3;
use std::hint::black_box;

const BOARD: BoardGeometry = BoardGeometry {
    columns: 8,
    rows: 6,
    square_mm: 10.0,
};

fn rig_camera() -> Camera {
    Camera {
        width: 1280,
        height: 960,
        fx: 2197.8,
        fy: 2204.8,
        u0: 626.6,
        v0: 487.3,
        distortion: Distortion {
            k1: -0.144,
            k2: -0.039,
            p1: -0.0006,
            p2: -0.0003,
            k3: -0.295,
        },
    }
}

/// A sequence in [−1, 1] without a period that matters here.
fn wave(i: usize) -> f64 {
    let x = (i as f64 * 12.9898).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

fn views(n: usize) -> Vec<Vec<Corner>> {
    let camera = rig_camera();
    (0..n)
        .map(|view| {
            let turn = Vector3::new(wave(5 * view), wave(5 * view + 1), wave(5 * view + 2)) * 0.5;
            let rotation = Rotation3::new(turn);
            let pixel = Vector2::new(
                640.0 + 250.0 * wave(5 * view + 3),
                480.0 + 150.0 * wave(5 * view + 4),
            );
            let middle = Point3::from(camera.ray(&pixel).unwrap_or_default() * 430.0);
            let pose = Pose {
                rotation,
                translation: middle.coords - rotation * Vector3::new(35.0, 25.0, 0.0),
            };
            (0..BOARD.corners())
                .map(|i| Corner {
                    pixel: camera
                        .project(&pose.apply(&BOARD.point(i)))
                        .unwrap_or_default()
                        + Vector2::new(wave(1000 * view + 2 * i), wave(1000 * view + 2 * i + 1))
                            * 0.01,
                    covariance: Matrix2::identity() * 4e-5,
                })
                .collect()
        })
        .collect()
}

fn camera_bench(c: &mut Criterion) {
    let views = views(15);
    c.bench_function("camera/15 views of 48 corners", |b| {
        b.iter(|| camera::calibrate(black_box(&views), &BOARD, 1280, 960));
    });
}

criterion_group!(benches, camera_bench);
criterion_main!(benches);
