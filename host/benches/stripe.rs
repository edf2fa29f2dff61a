//! Stripe extraction from 1280 × 960 frames of 8 bits, one core (aim: at most 1 ms each).

use cannula::geometry::Vector2;
use cannula::image::Image;
use cannula::stripe::{board, hand};
use criterion::{Criterion, criterion_group, criterion_main};

const WIDTH: usize = 1280;
const HEIGHT: usize = 960;

/// A small deterministic noise, −1 to 1.
fn noise(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as f32 / 8_388_608.0 - 1.0
}

/// A frame of albedo(u, v) with the stripe along centre(u).
fn frame(albedo: impl Fn(usize, usize) -> f32, centre: impl Fn(f32) -> f32, on: f32) -> Image<u8> {
    let mut state = 1;
    let mut image = Image::new(WIDTH, HEIGHT, 0_u8);
    for (i, p) in image.pixels_mut().iter_mut().enumerate() {
        let (u, v) = (i % WIDTH, i / WIDTH);
        let d = (v as f32 - centre(u as f32)) / 1.3;
        let stripe = on * (-0.5 * d * d).exp();
        let clean = 5.0 + albedo(u, v) * (40.0 + stripe);
        *p = (clean + 2.0 * noise(&mut state)).round() as u8;
    }
    image
}

fn benches(c: &mut Criterion) {
    let skin = |u: usize, _: usize| if (250..1030).contains(&u) { 0.9 } else { 0.06 };
    let bow = |u: f32| {
        let x = (u - 640.0) / 390.0;
        if x.abs() < 1.0 {
            420.0 + 60.0 * x * x
        } else {
            540.0
        }
    };
    let on = frame(skin, bow, 130.0);
    let off = frame(skin, bow, 0.0);
    let settings = hand::HandSettings::default();
    let found = hand::extract(&on, Some(&off), &settings).map_or(0, |s| s.len());
    assert!(found > 0, "nothing to measure");
    c.bench_function("stripe hand 1280x960 u8", |b| {
        b.iter(|| hand::extract(&on, Some(&off), &settings));
    });
    c.bench_function("stripe hand 1280x960 u8 without ambient", |b| {
        b.iter(|| hand::extract(&on, None, &settings));
    });

    let (u0, v0, side) = (380_usize, 250_usize, 60_usize);
    let squares = |u: usize, v: usize| {
        let (x, y) = ((u + side).wrapping_sub(u0), (v + side).wrapping_sub(v0));
        match x < 9 * side && y < 7 * side && (x / side + y / side).is_multiple_of(2) {
            true => 0.1,
            false => 1.0,
        }
    };
    let line = |u: f32| 400.0 + 0.1 * (u - 640.0);
    let on = frame(squares, line, 130.0);
    let off = frame(squares, line, 0.0);
    let corners: Vec<Vector2> = (0..48)
        .map(|i| {
            let (x, y) = (i % 8, i / 8);
            Vector2::new((u0 + x * side) as f64 - 0.5, (v0 + y * side) as f64 - 0.5)
        })
        .collect();
    let found = board::extract(&on, Some(&off), &corners, 8, 6).map_or(0, |p| p.len());
    assert!(found > 80, "nothing to measure");
    c.bench_function("stripe board 1280x960 u8", |b| {
        b.iter(|| board::extract(&on, Some(&off), &corners, 8, 6));
    });
}

criterion_group!(all, benches);
criterion_main!(all);
