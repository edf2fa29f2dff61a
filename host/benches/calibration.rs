//! How long the calibration takes after the corners and stripes are found, one thread.

use cannula::board::Corner;
use cannula::calibration::camera;
use cannula::calibration::light::{self, CameraData, LightView, Options};
// The made-up rig's own imports go by these.
use cannula::{board, calibration, geometry, stripe};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use synthetic::{BOARD, Noise, StripeErrors};

#[path = "../src/synthetic.rs"]
#[allow(dead_code)] // the tests use all of it
mod synthetic;

/// Corner noise, px.
const SIGMA: f64 = 0.006;

fn views(n: usize) -> Vec<Vec<Corner>> {
    let (camera, mut noise) = (synthetic::camera(), Noise(1));
    synthetic::poses(&camera, n, 0.6, &mut noise)
        .iter()
        .map(|pose| synthetic::corners(&camera, pose, SIGMA, &mut noise))
        .collect()
}

fn camera_bench(c: &mut Criterion) {
    let views = views(15);
    c.bench_function("camera/15 views of 48 corners", |b| {
        b.iter(|| camera::calibrate(black_box(&views), &BOARD, 1280, 960));
    });
}

/// Nine board poses crossed by thirteen light planes.
fn light_views() -> Vec<LightView> {
    let (camera, light, mut noise) = (synthetic::camera(), synthetic::light(), Noise(2));
    let errors = StripeErrors {
        centre: 0.05,
        slide: 0.0,
        speckle: 0.0,
        correlation: 1.0,
    };
    synthetic::light_poses(&camera, 9, &mut noise)
        .iter()
        .map(|pose| LightView {
            corners: synthetic::corners(&camera, pose, SIGMA, &mut noise),
            stripes: (0..13)
                .map(|k| {
                    let slide_mm = 5.0 * f64::from(k);
                    synthetic::stripe(&camera, &light, slide_mm, pose, &errors, &mut noise)
                })
                .collect(),
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
