//! Board corners in a 1280 × 960 image: found, found in noise, not there, only noise.

use cannula::board::{BoardGeometry, detect};
use cannula::image::Image;
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;

const W: usize = 1280;
const H: usize = 960;

/// A turned 8 × 6 board of 46 px squares by 3 × 3 samples a pixel, with uniform noise.
fn image(board: bool, noise: u32) -> Image<u8> {
    let (sin, cos) = 0.35f64.sin_cos();
    let mut state = 1u32;
    let grey = |u: f64, v: f64| {
        let (x, y) = ((u - 600.0) / 46.0, (v - 450.0) / 46.0);
        let (x, y) = (cos * x + sin * y + 4.0, cos * y - sin * x + 3.0);
        if !board || x < -2.0 || y < -2.0 || x > 10.0 || y > 8.0 {
            10.0
        } else if x > -1.0
            && y > -1.0
            && x < 8.0
            && y < 6.0
            && (x.floor() + y.floor()).rem_euclid(2.0) == 0.0
        {
            25.0
        } else {
            180.0
        }
    };
    let pixels = (0..W * H)
        .map(|i| {
            let sum: f64 = (0..9)
                .map(|k| {
                    let (du, dv) = ((k % 3) as f64 - 1.0, (k / 3) as f64 - 1.0);
                    grey((i % W) as f64 + du / 2.0, (i / W) as f64 + dv / 2.0)
                })
                .sum();
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (sum / 9.0 + f64::from(state % (noise + 1))) as u8
        })
        .collect();
    Image::from_vec(W, H, pixels).unwrap_or_else(|| Image::new(W, H, 0))
}

fn board(c: &mut Criterion) {
    let geometry = BoardGeometry {
        columns: 8,
        rows: 6,
        square_mm: 10.0,
    };
    for (name, image) in [
        ("found", image(true, 6)),
        ("found in noise", image(true, 30)),
        ("not there", image(false, 6)),
        ("only noise", image(false, 200)),
    ] {
        c.bench_function(&format!("board/{name}"), |b| {
            b.iter(|| detect(black_box(&image), &geometry));
        });
    }
}

criterion_group!(benches, board);
criterion_main!(benches);
