//! How long the calibration takes after the corners and stripes are found, one thread.

use cannula::board::{BoardGeometry, Corner};
use cannula::calibration::camera;
use cannula::calibration::light::{self, BoardStripe, CameraData, LightView, Options};
use cannula::geometry::{Camera, Distortion, Matrix2, Point3, Pose, Vector2, Vector3};
use cannula::stripe::StripePoint;
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

/// Nine board poses crossed by thirteen light planes, 40 000 stripe centres.
fn light_views() -> Vec<LightView> {
    let camera = rig_camera();
    let n = Vector3::new(0.0238, -0.8793, 0.4757).normalize();
    (0..9)
        .map(|view| {
            let tilt = Vector3::new(wave(7 * view), wave(7 * view + 1), 0.0) * 0.4;
            let rotation = Rotation3::new(tilt) * Rotation3::new(Vector3::z() * 1.57);
            let pose = Pose {
                rotation,
                translation: Vector3::new(0.0, -12.0, 425.0 + 20.0 * wave(7 * view + 2))
                    - rotation * Vector3::new(35.0, 25.0, 0.0),
            };
            let pixel = |p: Point3| camera.project(&pose.apply(&p)).unwrap_or_default();
            let corners = (0..BOARD.corners())
                .map(|i| Corner {
                    pixel: pixel(BOARD.point(i))
                        + Vector2::new(wave(2 * i + view), wave(2 * i + 1 + view)) * 0.01,
                    covariance: Matrix2::identity() * 4e-5,
                })
                .collect();
            let stripes = (0..13)
                .map(|k| {
                    let slide_mm = 5.0 * f64::from(k);
                    let g = rotation.inverse_transform_vector(&n);
                    let d = n.dot(&pose.translation) - 189.5 - slide_mm;
                    let foot = Vector2::new(g.x, g.y) * (-d / g.xy().norm_squared());
                    let along = Vector2::new(-g.y, g.x).normalize();
                    let points = (-400..400)
                        .map(|i| (i, foot + along * (0.15 * f64::from(i))))
                        .filter(|(_, p)| (-9.0..79.0).contains(&p.x) && (-9.0..59.0).contains(&p.y))
                        .map(|(i, p)| StripePoint {
                            pixel: pixel(Point3::new(p.x, p.y, 0.0))
                                + Vector2::y() * (0.1 * wave((i + 5000) as usize * 13 + view)),
                            across: Vector2::y(),
                            variance: 0.0025,
                            intensity: 100.0,
                            width_px: 2.0,
                            quality: 1.0,
                        })
                        .collect();
                    BoardStripe { slide_mm, points }
                })
                .collect();
            LightView { corners, stripes }
        })
        .collect()
}

fn light_bench(c: &mut Criterion) {
    let own = views(15);
    let light_views = light_views();
    let all: Vec<_> = own
        .iter()
        .cloned()
        .chain(light_views.iter().map(|v| v.corners.clone()))
        .collect();
    let start = camera::calibrate(&all, &BOARD, 1280, 960);
    let count: usize = light_views
        .iter()
        .flat_map(|v| &v.stripes)
        .map(|s| s.points.len())
        .sum();
    if let Ok(start) = start {
        c.bench_function(
            &format!("light/joint, 24 views, {count} stripe centres"),
            |b| {
                b.iter(|| {
                    light::calibrate(
                        black_box(&start),
                        CameraData::Views(&own),
                        &light_views,
                        &BOARD,
                        Options::default(),
                    )
                });
            },
        );
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = camera_bench, light_bench
}
criterion_main!(benches);
