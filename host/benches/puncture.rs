//! Brick updates per second of the puncture's solver, by mesh, and the fast model per angle.
use cannula::puncture::Calibration;
use cannula::puncture::element::{Bricks, Scratch};
use cannula::puncture::material::{Branch, Material};
use cannula::puncture::mesh::{Mesh, Region};
use cannula::puncture::tissue::Setup;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn bricks(c: &mut Criterion) {
    let setup = Setup::default();
    let mut group = c.benchmark_group("brick forces");
    group.sample_size(20);
    for h in [0.4, 0.2, 0.1] {
        let mesh = Mesh::hand(&setup, h, -1.0, 5.0);
        let law = |q: usize| match mesh.region[q] {
            Region::Skin => setup.skin.law,
            Region::Fat => setup.fat.law,
            Region::Vein | Region::FarWall => setup.vein.law,
            Region::Muscle => setup.muscle.law,
        };
        let all = Bricks::new(&mesh, |q| Material::new(law(q), Branch::Stabilised), 0.2);
        let n = mesh.section.len() * mesh.stride();
        let u: [Vec<f64>; 3] = std::array::from_fn(|c| {
            (0..n)
                .map(|i| 1e-3 * ((i * (c + 3)) as f64).sin())
                .collect()
        });
        let mut f: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; n]);
        let mut scratch = Scratch::new(&all);
        group.throughput(Throughput::Elements(all.count() as u64));
        group.bench_with_input(BenchmarkId::new("simd", h), &h, |b, _| {
            b.iter(|| all.subtract_forces(black_box(&u), &mut f, &mut scratch));
        });
        group.bench_with_input(BenchmarkId::new("scalar", h), &h, |b, _| {
            b.iter(|| all.subtract_forces_scalar(black_box(&u), &mut f, &mut scratch));
        });
    }
    group.finish();
}

fn fast(c: &mut Criterion) {
    let setup = Setup::default();
    let fast = Calibration::stored();
    c.bench_function("fast model, one angle", |b| {
        b.iter(|| fast.angle(black_box(&setup), black_box(37.0)));
    });
}

criterion_group!(benches, bricks, fast);
criterion_main!(benches);
