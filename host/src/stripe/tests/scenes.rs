//! What spoils a stripe, one thing at a time, on drawn images whose centres are known.

use super::super::hand::{self, HandSettings, Segment, Surface};
use super::super::{StripeError, board};
use crate::geometry::Vector2;
use crate::image::Image;
use crate::synthetic::Noise;

const WIDTH: usize = 400;
const HEIGHT: usize = 240;
/// Black level and noise, grey values.
const BLACK: f64 = 5.0;
const NOISE: f64 = 0.8;

/// An image of a brightness at (column, row), with noise, clipped at 255.
fn image(seed: u64, light: impl Fn(usize, usize) -> f64) -> Image<u8> {
    let mut noise = Noise(seed);
    let mut image = Image::new(WIDTH, HEIGHT, 0_u8);
    for (i, p) in image.pixels_mut().iter_mut().enumerate() {
        let clean = BLACK + light(i % WIDTH, i / WIDTH);
        *p = (clean + NOISE * noise.normal()).round().clamp(0.0, 255.0) as u8;
    }
    image
}

/// The stripe's row: a slow bow that takes every place between two pixels.
fn bow(u: usize) -> f64 {
    let x = (u as f64 - 200.0) / 200.0;
    110.3 + 14.0 * x * x + 0.3 * x
}

fn gauss(d: f64, sigma: f64) -> f64 {
    (-0.5 * (d / sigma).powi(2)).exp()
}

/// Frame and ambient image of a skin of reflectance `albedo`, the stripe of peak `peak` along `row`,
/// with `more` laser light beside it.
fn pair(
    albedo: impl Fn(usize, usize) -> f64,
    peak: f64,
    row: impl Fn(usize) -> f64,
    more: impl Fn(usize, usize) -> f64,
) -> (Image<u8>, Image<u8>) {
    let ambient = |u: usize, v: usize| 45.0 * albedo(u, v);
    let frame = image(1, |u, v| {
        let line = peak * gauss(v as f64 - row(u), 1.6);
        ambient(u, v) + albedo(u, v) * line + more(u, v)
    });
    (frame, image(2, ambient))
}

fn extract(frame: &Image<u8>, ambient: &Image<u8>) -> Vec<Segment> {
    hand::extract(frame, Some(ambient), &HandSettings::default()).unwrap()
}

/// Errors of the hand's points, px, by column.
fn errors(segments: &[Segment], row: impl Fn(usize) -> f64) -> Vec<(usize, f64)> {
    segments
        .iter()
        .filter(|s| s.surface == Surface::Hand)
        .flat_map(|s| &s.points)
        .map(|p| (p.pixel.x as usize, p.pixel.y - row(p.pixel.x as usize)))
        .collect()
}

fn rms(errors: &[(usize, f64)]) -> f64 {
    (errors.iter().map(|e| e.1 * e.1).sum::<f64>() / errors.len() as f64).sqrt()
}

fn worst(errors: &[(usize, f64)]) -> f64 {
    errors.iter().fold(0.0, |a, e| a.max(e.1.abs()))
}

fn quality(segments: &[Segment]) -> f64 {
    let all: Vec<f64> = segments
        .iter()
        .flat_map(|s| &s.points)
        .map(|p| f64::from(p.quality))
        .collect();
    all.iter().sum::<f64>() / all.len() as f64
}

#[test]
fn a_saturated_stripe_keeps_its_centre() {
    let (clean, ambient) = pair(|_, _| 1.0, 120.0, bow, |_, _| 0.0);
    let clean = extract(&clean, &ambient);
    // Four times what the sensor holds: about five pixels of every column are clipped.
    let (clipped, ambient) = pair(|_, _| 1.0, 900.0, bow, |_, _| 0.0);
    let clipped = extract(&clipped, &ambient);
    for segments in [&clean, &clipped] {
        let e = errors(segments, bow);
        assert!(e.len() > 380, "{}", e.len());
        assert!(
            rms(&e) < 0.03 && worst(&e) < 0.1,
            "{} {}",
            rms(&e),
            worst(&e)
        );
    }
    assert!(
        quality(&clipped) < 0.8 * quality(&clean),
        "it must show in the quality"
    );
}

#[test]
fn glow_does_not_move_the_stripe() {
    // Light from inside the skin: a third of the peak, wider by far; on half of the columns the
    // skin ends 9 px below the stripe, so that it glows on one side only.
    let glow = |u: usize, v: usize| {
        let d = v as f64 - bow(u);
        if u > 200 && d > 9.0 {
            0.0
        } else {
            40.0 * gauss(d, 7.0)
        }
    };
    let (frame, ambient) = pair(|_, _| 1.0, 120.0, bow, glow);
    let e = errors(&extract(&frame, &ambient), bow);
    let whole: Vec<_> = e.iter().copied().filter(|e| e.0 < 190).collect();
    let half: Vec<_> = e.iter().copied().filter(|e| e.0 > 210).collect();
    assert!(whole.len() > 180 && half.len() > 180);
    assert!(rms(&whole) < 0.03, "{}", rms(&whole));
    let mean = half.iter().map(|e| e.1).sum::<f64>() / half.len() as f64;
    assert!(
        mean.abs() < 0.08 && worst(&half) < 0.2,
        "{mean} {}",
        worst(&half)
    );
}

#[test]
fn hairs_and_dark_spots_do_not_move_the_stripe() {
    // Hairs of 1.5 px across the stripe at 60°, and spots whose middles lie beside it.
    let albedo = |u: usize, v: usize| {
        let (x, y) = (u as f64, v as f64);
        let mut rho = 1.0;
        for u0 in [60.0, 140.0, 260.0] {
            let across = (x - u0) * 0.87 - (y - bow(u0 as usize)) * 0.5;
            rho *= 1.0 - 0.6 * gauss(across, 0.75);
        }
        for (u0, aside) in [(100.0, 4.0), (200.0, -5.0), (320.0, 0.0)] {
            let d = (x - u0).hypot(y - bow(u0 as usize) - aside);
            rho *= 1.0 - 0.6 * gauss(d, 4.0);
        }
        rho
    };
    let (frame, ambient) = pair(albedo, 130.0, bow, |_, _| 0.0);
    let segments = extract(&frame, &ambient);
    let e = errors(&segments, bow);
    assert!(e.len() > 340, "{}", e.len());
    // A pixel is a third of a millimetre here.
    assert!(
        rms(&e) < 0.08 && worst(&e) < 1.0,
        "{} {}",
        rms(&e),
        worst(&e)
    );
}

#[test]
fn specular_spots_are_not_the_stripe() {
    // A wet spot that is bright in ambient light, one that the stripe lights up from aside, and
    // a reflection of the stripe 40 px off.
    let (frame, ambient) = {
        let wet = |u: usize, v: usize| 4.0 * gauss((u as f64 - 90.0).hypot(v as f64 - 118.0), 3.0);
        pair(
            |u, v| 1.0 + wet(u, v),
            120.0,
            bow,
            |u, v| {
                let spot = 230.0 * gauss((u as f64 - 230.0).hypot(v as f64 - bow(u) - 12.0), 2.0);
                let far = 200.0 * gauss((u as f64 - 300.0) / 6.0, 1.0);
                spot + far * gauss(v as f64 - bow(u) + 40.0, 1.6)
            },
        )
    };
    let e = errors(&extract(&frame, &ambient), bow);
    assert!(e.len() > 340, "{}", e.len());
    assert!(worst(&e) < 0.8, "{}", worst(&e));
    let clear: Vec<_> = e
        .iter()
        .copied()
        .filter(|e| e.0.abs_diff(90) > 14 && e.0.abs_diff(230) > 12)
        .collect();
    assert!(rms(&clear) < 0.05, "{}", rms(&clear));
}

#[test]
fn nothing_is_smoothed_over_a_depth_jump() {
    let row = |u: usize| bow(u) + if (150..230).contains(&u) { -14.0 } else { 0.0 };
    let (frame, ambient) = pair(|_, _| 1.0, 120.0, row, |_, _| 0.0);
    let segments = extract(&frame, &ambient);
    let e = errors(&segments, row);
    assert!(e.len() > 350, "{}", e.len());
    assert!(worst(&e) < 0.25, "{}", worst(&e));
    for s in &segments {
        let inside = s
            .points
            .iter()
            .filter(|p| (150.0..230.0).contains(&p.pixel.x));
        let n = inside.count();
        assert!(
            n == 0 || n == s.points.len(),
            "a segment runs over the jump"
        );
    }
}

#[test]
fn the_table_is_kept_apart() {
    let skin = |u: usize| (90..310).contains(&u);
    let row = |u: usize| if skin(u) { bow(u) } else { 165.0 };
    let albedo = |u: usize, _: usize| if skin(u) { 1.0 } else { 0.08 };
    let (frame, ambient) = pair(albedo, 150.0, row, |_, _| 0.0);
    let segments = extract(&frame, &ambient);
    for s in &segments {
        for p in &s.points {
            let on_skin = skin(p.pixel.x as usize);
            assert_eq!(s.surface == Surface::Hand, on_skin, "column {}", p.pixel.x);
            assert!((p.pixel.y - row(p.pixel.x as usize)).abs() < 0.6);
        }
    }
    let count = |surface| -> usize {
        let of = segments.iter().filter(|s| s.surface == surface);
        of.map(|s| s.points.len()).sum()
    };
    assert!(count(Surface::Hand) > 200, "{}", count(Surface::Hand));
    assert!(
        count(Surface::Background) > 20,
        "{}",
        count(Surface::Background)
    );
}

/// Stated variances against true errors on speckle of two sizes: of single centres, of smoothed
/// ones, and of means over sixty columns, which are what a plane hangs on.
#[test]
fn stated_variances_are_true_on_speckle() {
    for (contrast, grain) in [(0.36, 1.2), (0.7, 2.0)] {
        let (mut single, mut smooth, mut means) = (Vec::new(), Vec::new(), Vec::new());
        for seed in 0..12 {
            let mut normal = Noise(100 + seed);
            let cells: Vec<f64> = (0..WIDTH * HEIGHT)
                .map(|_| -normal.uniform().ln() - 1.0)
                .collect();
            // Grains between cells by straight interpolation, as a lens blurs them.
            let speckle = |x: f64, y: f64| {
                let (i, j) = ((x / grain) as usize, (y / grain) as usize);
                let (a, b) = (x / grain - i as f64, y / grain - j as f64);
                let at = |i: usize, j: usize| cells[j * WIDTH + i];
                let top = at(i, j) * (1.0 - a) + at(i + 1, j) * a;
                let bottom = at(i, j + 1) * (1.0 - a) + at(i + 1, j + 1) * a;
                1.0 + contrast * (top * (1.0 - b) + bottom * b)
            };
            let ambient = image(7 * seed + 2, |_, _| 45.0);
            let frame = image(7 * seed + 1, |u, v| {
                // Three by three samples over the pixel and a little beyond, as a lens does.
                let mut sum = 0.0;
                for k in 0..9 {
                    let (x, y) = (u as f64 + 1.0, v as f64 + 1.0);
                    let (dx, dy) = (f64::from(k % 3 - 1) * 0.6, f64::from(k / 3 - 1) * 0.6);
                    sum += gauss(v as f64 + dy - bow(u), 1.4) * speckle(x + dx, y + dy);
                }
                45.0 + 110.0 * sum / 9.0
            });
            for s in extract(&frame, &ambient) {
                let error = |y: f64, x: f64| y - bow(x as usize);
                for p in &s.measured {
                    single.push(error(p.pixel.y, p.pixel.x) / p.variance.sqrt());
                }
                for p in &s.points {
                    smooth.push(error(p.pixel.y, p.pixel.x) / p.variance.sqrt());
                }
                for block in s.measured.chunks_exact(60) {
                    let n = block.len() as f64;
                    let mean = block
                        .iter()
                        .map(|p| error(p.pixel.y, p.pixel.x))
                        .sum::<f64>()
                        / n;
                    let variance = block.iter().map(|p| p.variance).sum::<f64>() / n;
                    means.push(mean / (variance * s.grain / n).sqrt());
                }
            }
        }
        let of = |z: &[f64]| (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
        let found = [of(&single), of(&smooth), of(&means)];
        println!("contrast {contrast}, grain {grain}: true over stated {found:.2?}");
        // Some 4 500 centres, 1 500 grains, 70 means: their own scatter is 2, 5 and 8 %.
        assert!((0.85..1.2).contains(&found[0]), "{found:?}");
        // Smoothed ones are stated up to a third too large: a chance bias counts as one.
        assert!((0.7..1.35).contains(&found[1]), "{found:?}");
        assert!((0.75..1.3).contains(&found[2]), "{found:?}");
    }
}

/// A board of 5 × 4 inner corners on a white panel; the stripe runs along or down the image, on the
/// squares or a known way beside them.
#[test]
fn a_stripe_beside_the_squares_is_named_with_its_distance() {
    const SQUARE: f64 = 22.0;
    let (u0, v0) = (140.0, 85.0);
    let albedo = |u: usize, v: usize| {
        let (i, j) = (
            ((u as f64 - u0) / SQUARE).floor(),
            ((v as f64 - v0) / SQUARE).floor(),
        );
        let dark = (i + j).rem_euclid(2.0) == 0.0;
        let on = (-1.0..5.0).contains(&i) && (-1.0..4.0).contains(&j);
        if on && dark { 0.1 } else { 1.0 }
    };
    let corners: Vec<Vector2> = (0..20)
        .map(|i| Vector2::new(u0 + SQUARE * (i % 5) as f64, v0 + SQUARE * (i / 5) as f64))
        .collect();
    let off = image(1, |u, v| 60.0 * albedo(u, v));
    for down in [false, true] {
        let said = |at: f64| {
            let on = image(2, |u, v| {
                let place = if down {
                    (u as f64 - u0) / SQUARE
                } else {
                    (v as f64 - v0) / SQUARE
                };
                albedo(u, v) * (60.0 + 90.0 * gauss((place - at) * SQUARE, 1.6))
            });
            board::extract(&on, Some(&off), &corners, 5, 4)
        };
        // In the middle of a row of squares, off their borders.
        let points = said(1.5).unwrap();
        let place = if down { u0 } else { v0 } + 1.5 * SQUARE;
        for p in &points {
            let across = if down { p.pixel.x } else { p.pixel.y };
            assert!((across - place).abs() < 0.3, "{across} for {place}");
        }
        for beside in [0.6, 1.3, 2.4] {
            match said(-1.0 - beside) {
                Err(StripeError::Beside { squares }) => {
                    assert!((squares - beside).abs() < 0.05, "{squares} for {beside}");
                }
                other => panic!("{down} {beside}: {other:?}"),
            }
        }
        let nothing = said(100.0);
        assert!(
            matches!(nothing, Err(StripeError::NoStripe { .. })),
            "{nothing:?}"
        );
    }
}
