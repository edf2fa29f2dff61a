//! Whole images: boards rendered here with exact truth, the recordings, real photographs.

use super::*;
use crate::geometry::{Homography, Matrix3};

const BOARD: BoardGeometry = BoardGeometry {
    columns: 8,
    rows: 6,
    square_mm: 10.0,
};

/// Uniform numbers in 0..1 (xorshift64*), and normal ones from them.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        let r = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        r * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// What a rendered image is like.
#[derive(Clone, Copy)]
struct Look {
    width: usize,
    height: usize,
    blur: f64,
    noise: f64,
    white: f64,
    black: f64,
    /// Light at the right edge against the left, as a factor.
    falloff: f64,
    /// Samples a pixel in each direction.
    fine: usize,
}

const CLEAN: Look = Look {
    width: 640,
    height: 480,
    blur: 0.6,
    noise: 0.0,
    white: 180.0,
    black: 25.0,
    falloff: 1.0,
    fine: 4,
};
const NOMINAL: Look = Look {
    noise: 1.5,
    ..CLEAN
};
const HARD: Look = Look {
    blur: 1.0,
    noise: 3.0,
    white: 120.0,
    black: 20.0,
    falloff: 0.5,
    ..CLEAN
};

/// Board to image: a pinhole at `focal` px, the board turned and tilted about its centre.
fn pose(
    look: &Look,
    board: &BoardGeometry,
    size: f64,
    tilt: f64,
    towards: f64,
    roll: f64,
) -> Homography {
    let focal = 2.0 * look.width as f64;
    let span = board.columns as f64 * board.square_mm;
    let distance = focal * span / size;
    let axis = nalgebra::Vector3::new(towards.cos(), towards.sin(), 0.0);
    let turn = nalgebra::Rotation3::new(axis * tilt)
        * nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), roll);
    let middle = nalgebra::Vector3::new(
        (board.columns as f64 - 1.0) / 2.0 * board.square_mm,
        (board.rows as f64 - 1.0) / 2.0 * board.square_mm,
        0.0,
    );
    let t = nalgebra::Vector3::new(0.0, 0.0, distance) - turn * middle;
    let camera = Matrix3::new(
        focal,
        0.0,
        look.width as f64 / 2.0 - 0.37,
        0.0,
        focal,
        look.height as f64 / 2.0 + 0.21,
        0.0,
        0.0,
        1.0,
    );
    let r = turn.matrix();
    let h = Matrix3::from_columns(&[r.column(0).into(), r.column(1).into(), t]);
    Homography(camera * h)
}

fn truth(map: &Homography, board: &BoardGeometry) -> Vec<Vector2> {
    (0..board.corners())
        .map(|i| map.apply(&board.point(i).coords.xy()))
        .collect()
}

/// Grey values by supersampling: several samples a pixel, each the mean over its own area (to first
/// order in the distance to the squares' borders), then the point spread on that fine grid.
fn shine(look: &Look, map: &Homography, board: &BoardGeometry) -> Vec<f64> {
    let per = look.fine;
    let (w, h) = (look.width * per, look.height * per);
    let back = map.inverse().unwrap();
    let (c, r) = (board.columns as f64, board.rows as f64);
    let fine: Vec<f32> = (0..w * h)
        .map(|i| {
            let u = ((i % w) as f64 + 0.5) / per as f64 - 0.5;
            let v = ((i / w) as f64 + 0.5) / per as f64 - 0.5;
            let at = |du: f64, dv: f64| back.apply(&Vector2::new(u + du, v + dv)) / board.square_mm;
            let p = at(0.0, 0.0);
            let step = 1.0 / per as f64;
            let (pu, pv) = (at(step, 0.0) - p, at(0.0, step) - p);
            // Part of the sample on the positive side of a line at `x` board squares.
            let side = |d: f64, gu: f64, gv: f64| (d / gu.hypot(gv) + 0.5).clamp(0.0, 1.0);
            let grey = if p.x < -2.0 || p.y < -2.0 || p.x > c + 1.0 || p.y > r + 1.0 {
                8.0
            } else {
                // From −1 to 1 across the nearest line; the board's own border included.
                let sign = |x: f64, gu: f64, gv: f64| {
                    let line = x.round();
                    let s = 2.0 * side(x - line, gu, gv) - 1.0;
                    if line.rem_euclid(2.0) == 0.0 { s } else { -s }
                };
                let within =
                    |x: f64, n: f64, gu: f64, gv: f64| side(x + 1.0, gu, gv) * side(n - x, gu, gv);
                let pattern = sign(p.x, pu.x, pv.x) * sign(p.y, pu.y, pv.y);
                let black = 0.5 * (1.0 + pattern);
                let inside = within(p.x, c, pu.x, pv.x) * within(p.y, r, pu.y, pv.y);
                // On the border the pattern is even along it; only one of the two factors fades.
                let (sx, sy) = (p.x.clamp(-0.75, c - 0.25), p.y.clamp(-0.75, r - 0.25));
                let black = if inside < 1.0 {
                    0.5 * (1.0 + sign(sx, pu.x, pv.x) * sign(sy, pu.y, pv.y))
                } else {
                    black
                };
                look.white + (look.black - look.white) * black * inside
            };
            (grey * (1.0 + (look.falloff - 1.0) * u / look.width as f64)) as f32
        })
        .collect();
    let sigma = look.blur * per as f64;
    let reach = (4.0 * sigma).ceil() as isize;
    let kernel: Vec<f32> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32)
        .collect();
    let total: f32 = kernel.iter().sum();
    let kernel: Vec<f32> = kernel.iter().map(|k| k / total).collect();
    let blurred = |source: &[f32], n: usize, stride: usize, lines: usize, step: usize| {
        let mut out = vec![0f32; source.len()];
        for line in 0..lines {
            for i in 0..n {
                let sum: f32 = kernel
                    .iter()
                    .enumerate()
                    .map(|(k, g)| {
                        let j = (i as isize + k as isize - reach).clamp(0, n as isize - 1) as usize;
                        g * source[line * step + j * stride]
                    })
                    .sum();
                out[line * step + i * stride] = sum;
            }
        }
        out
    };
    let fine = blurred(&fine, w, 1, h, w);
    let fine = blurred(&fine, h, w, w, 1);
    (0..look.width * look.height)
        .map(|i| {
            let (u, v) = (i % look.width * per, i / look.width * per);
            let sum: f32 = (0..per * per)
                .map(|k| fine[(v + k / per) * w + u + k % per])
                .sum();
            f64::from(sum) / (per * per) as f64
        })
        .collect()
}

fn expose(look: &Look, grey: &[f64], random: &mut Random) -> Image<u8> {
    let pixels = grey
        .iter()
        .map(|g| u8::from_f32((g + look.noise * random.normal()) as f32))
        .collect();
    Image::from_vec(look.width, look.height, pixels).unwrap()
}

/// Squared errors against the better of the two numberings, and the squares normalised by the
/// covariances.
fn errors(found: &Detection, truth: &[Vector2]) -> (Vec<f64>, Vec<f64>) {
    let of = |turned: bool| -> (Vec<f64>, Vec<f64>) {
        let n = truth.len();
        (0..n)
            .map(|i| {
                let c = &found.corners[if turned { n - 1 - i } else { i }];
                let e = c.pixel - truth[i];
                let inverse = c.covariance.try_inverse().unwrap();
                (e.norm_squared(), (e.transpose() * inverse * e).x)
            })
            .unzip()
    };
    let (a, b) = (of(false), of(true));
    let sum = |v: &(Vec<f64>, Vec<f64>)| v.0.iter().sum::<f64>();
    if sum(&a) < sum(&b) { a } else { b }
}

/// RMS error (two-dimensional), the mean normalised square a degree of freedom, over random poses.
fn accuracy(look: &Look, board: &BoardGeometry, poses: usize, seed: u64) -> (f64, f64) {
    let mut random = Random(seed);
    let (mut squares, mut normalised) = (Vec::new(), Vec::new());
    for _ in 0..poses {
        let size = random.within(0.42, 0.6) * look.width as f64;
        let tilt = random.within(0.0, 0.85);
        let map = pose(
            look,
            board,
            size,
            tilt,
            random.within(0.0, std::f64::consts::TAU),
            random.within(0.0, std::f64::consts::TAU),
        );
        let image = expose(look, &shine(look, &map, board), &mut random);
        let found = detect(&image, board).unwrap_or_else(|e| panic!("tilt {tilt:.2}: {e}"));
        let (s, n) = errors(&found, &truth(&map, board));
        squares.extend(s);
        normalised.extend(n);
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    (mean(&squares).sqrt(), mean(&normalised) / 2.0)
}

#[test]
fn corners_are_accurate_and_know_how_much() {
    for (name, look, limit) in [
        ("clean", CLEAN, 0.003),
        ("nominal", NOMINAL, 0.010),
        ("hard", HARD, 0.035),
    ] {
        let (rms, normalised) = accuracy(&look, &BOARD, 6, 11);
        println!("{name}: {rms:.4} px RMS, normalised {normalised:.2}");
        assert!(rms < limit, "{name}: {rms:.4} px");
        if look.noise > 0.0 {
            // 288 corners, 576 degrees of freedom: 1 ± 0.06 by chance alone.
            assert!((0.6..1.3).contains(&normalised), "{name}: {normalised:.2}");
        }
    }
}

#[test]
fn other_boards_and_sixteen_bits() {
    for (columns, rows) in [(9, 6), (7, 5), (10, 6), (5, 4)] {
        let board = BoardGeometry {
            columns,
            rows,
            ..BOARD
        };
        let (rms, _) = accuracy(&NOMINAL, &board, 2, 5);
        assert!(rms < 0.012, "{columns} × {rows}: {rms:.4} px");
    }
    // Twelve bits in sixteen.
    let map = pose(&NOMINAL, &BOARD, 300.0, 0.5, 1.0, 0.4);
    let pixels = shine(&NOMINAL, &map, &BOARD)
        .iter()
        .map(|g| u16::from_f32((g * 16.0) as f32))
        .collect();
    let image = Image::from_vec(640, 480, pixels).unwrap();
    let (squares, _) = errors(&detect(&image, &BOARD).unwrap(), &truth(&map, &BOARD));
    assert!((squares.iter().sum::<f64>() / 48.0).sqrt() < 0.003);
}

/// x × y points into the board, and 9 × 6 has one numbering whatever the turn.
#[test]
fn numbering_is_handed_and_unique_where_it_can_be() {
    let board = BoardGeometry {
        columns: 9,
        ..BOARD
    };
    for roll in [0.0, 1.0, 2.0, 3.0, 4.0, 5.0] {
        let map = pose(&CLEAN, &board, 300.0, 0.3, 1.0, roll);
        let image = expose(&CLEAN, &shine(&CLEAN, &map, &board), &mut Random(1));
        let found = detect(&image, &board).unwrap();
        for (c, t) in found.corners.iter().zip(truth(&map, &board)) {
            assert!((c.pixel - t).norm() < 0.05, "roll {roll}");
        }
    }
}

#[test]
fn align_undoes_a_half_turn() {
    let map = pose(&CLEAN, &BOARD, 300.0, 0.3, 1.0, 0.2);
    let image = expose(&CLEAN, &shine(&CLEAN, &map, &BOARD), &mut Random(1));
    let reference = detect(&image, &BOARD).unwrap();
    let mut turned = reference.clone();
    turned.corners.reverse();
    turned.quality.misfit.reverse();
    turned.quality.masked.reverse();
    align(&mut turned, &reference);
    assert_eq!(turned, reference);
}

/// Turned about its middle by an angle under which its squares look the same, a board gives the
/// same image with another numbering: whichever the reference has, `align` finds it.
#[test]
fn align_knows_the_symmetries_of_the_squares() {
    use std::f64::consts::{FRAC_PI_2, PI};
    let look = Look { fine: 2, ..NOMINAL };
    let half: &[f64] = &[0.0, PI];
    let quarter: &[f64] = &[0.0, FRAC_PI_2, PI, -FRAC_PI_2];
    // 5 × 5 has a quarter turn of its corners, but it swaps black and white.
    for (columns, rows, turns) in [(8, 6, half), (7, 5, half), (6, 6, quarter), (5, 5, half)] {
        let board = BoardGeometry {
            columns,
            rows,
            ..BOARD
        };
        let at = |roll: f64| pose(&look, &board, 260.0, 0.4, 1.0, roll);
        let image = expose(&look, &shine(&look, &at(0.7), &board), &mut Random(2));
        let found = detect(&image, &board).unwrap();
        // Largest distance from the truth of a board held with that turn.
        let distance = |turn: f64| {
            let corner = |pixel| Corner {
                pixel,
                ..found.corners[0]
            };
            let held = truth(&at(0.7 + turn), &board).into_iter().map(corner);
            let reference = Detection {
                corners: held.collect(),
                ..found.clone()
            };
            let mut aligned = found.clone();
            align(&mut aligned, &reference);
            let pairs = aligned.corners.iter().zip(&reference.corners);
            pairs
                .map(|(a, b)| (a.pixel - b.pixel).norm())
                .fold(0.0, f64::max)
        };
        for &turn in turns {
            let d = distance(turn);
            assert!(d < 0.1, "{columns} × {rows} turned by {turn:.2}: {d} px");
        }
        if turns.len() == 2 && columns == rows {
            assert!(distance(FRAC_PI_2) > 20.0, "{columns} × {rows}");
        }
    }
}

/// x points neither right nor left: noise alone decides the numbering of each image, and `align`
/// makes the images of the pose agree.
#[test]
fn images_of_one_pose_are_numbered_alike() {
    let look = Look { fine: 2, ..HARD };
    let map = pose(&look, &BOARD, 260.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2);
    let grey = shine(&look, &map, &BOARD);
    let mut random = Random(8);
    let mut images: Vec<Detection> = (0..12)
        .map(|_| detect(&expose(&look, &grey, &mut random), &BOARD).unwrap())
        .collect();
    let apart = |images: &[Detection]| -> usize {
        let other =
            |d: &&Detection| (d.corners[0].pixel - images[0].corners[0].pixel).norm() > 100.0;
        images.iter().filter(other).count()
    };
    let before = apart(&images);
    assert!(before > 0, "no image to settle");
    let reference = images[0].clone();
    images.iter_mut().for_each(|d| align(d, &reference));
    for image in &images {
        for (a, b) in image.corners.iter().zip(&reference.corners) {
            assert!((a.pixel - b.pixel).norm() < 0.3);
        }
    }
}

/// 3840 × 2160: squares of 190 px and of 40 px.
#[test]
fn boards_in_a_large_image() {
    let look = Look {
        width: 3840,
        height: 2160,
        blur: 1.0,
        fine: 1, // a point spread of a pixel leaves nothing for finer samples
        ..NOMINAL
    };
    for size in [0.4, 0.085] {
        let map = pose(&look, &BOARD, size * 3840.0, 0.5, 1.0, 0.3);
        let image = expose(&look, &shine(&look, &map, &BOARD), &mut Random(4));
        let found = detect(&image, &BOARD).unwrap();
        let (squares, _) = errors(&found, &truth(&map, &BOARD));
        let rms = (squares.iter().sum::<f64>() / 48.0).sqrt();
        println!("{size}: {rms:.4} px, blur {:.3} px", found.blur_px);
        assert!(rms < 0.012, "{size}: {rms:.4} px");
        assert!((found.blur_px - 1.0).abs() < 0.03, "{}", found.blur_px);
    }
}

fn board_image(look: &Look, map: &Homography, board: &BoardGeometry) -> Image<u8> {
    expose(look, &shine(look, map, board), &mut Random(3))
}

#[test]
fn reasons_for_no_board() {
    let centred = pose(&NOMINAL, &BOARD, 300.0, 0.3, 1.0, 0.1);
    // Shifted until three columns are cut off.
    let shift = |dx: f64, dy: f64| {
        Homography(Matrix3::new(1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0) * centred.0)
    };
    match detect(&board_image(&NOMINAL, &shift(-270.0, 0.0), &BOARD), &BOARD) {
        Err(NotFound::PartlyOutside { sides, seen }) => {
            assert!(sides.left && !sides.right && seen > 12, "{sides} {seen}");
        }
        other => panic!("{other:?}"),
    }
    match detect(&board_image(&NOMINAL, &shift(0.0, 230.0), &BOARD), &BOARD) {
        Err(NotFound::PartlyOutside { sides, .. }) => assert!(sides.bottom && !sides.top),
        other => panic!("{other:?}"),
    }
    let larger = BoardGeometry {
        columns: 9,
        rows: 7,
        ..BOARD
    };
    let image = board_image(
        &NOMINAL,
        &pose(&NOMINAL, &larger, 320.0, 0.2, 1.0, 0.1),
        &larger,
    );
    match detect(&image, &BOARD) {
        Err(NotFound::WrongCount {
            found_columns: 9,
            found_rows: 7,
            columns: 8,
            rows: 6,
        }) => {}
        other => panic!("{other:?}"),
    }
    let smaller = BoardGeometry {
        columns: 7,
        rows: 5,
        ..BOARD
    };
    let image = board_image(
        &NOMINAL,
        &pose(&NOMINAL, &smaller, 300.0, 0.2, 1.0, 0.1),
        &smaller,
    );
    match detect(&image, &BOARD) {
        Err(NotFound::WrongCount {
            found_columns: 7,
            found_rows: 5,
            ..
        }) => {}
        other => panic!("{other:?}"),
    }
    let soft = Look {
        blur: 9.0,
        ..NOMINAL
    };
    match detect(&board_image(&soft, &centred, &BOARD), &BOARD) {
        Err(NotFound::TooBlurred { blur_px, limit_px }) => {
            println!("blur 9: {blur_px} of {limit_px}");
            assert!((4.0..14.0).contains(&blur_px), "{blur_px}");
        }
        other => panic!("{other:?}"),
    }
    // A saturated spot, and a grey hand, over the same corners.
    for (cover, glare) in [(255u8, true), (60, false)] {
        let mut image = board_image(&NOMINAL, &centred, &BOARD);
        for (i, p) in image.pixels_mut().iter_mut().enumerate() {
            let (u, v) = ((i % 640) as f64 - 300.0, (i / 640) as f64 - 230.0);
            if u.hypot(v) < 70.0 {
                *p = cover;
            }
        }
        match (detect(&image, &BOARD), glare) {
            (Err(NotFound::Glare { hidden }), true) => assert!((4..20).contains(&hidden)),
            (Err(NotFound::Hidden { hidden, .. }), false) => assert!((4..20).contains(&hidden)),
            (other, _) => panic!("cover {cover}: {other:?}"),
        }
    }
}

#[test]
fn images_without_a_board() {
    let (w, h) = (640, 480);
    let from = |f: &mut dyn FnMut(usize, usize) -> u8| {
        let pixels = (0..w * h).map(|i| f(i % w, i / w)).collect();
        Image::from_vec(w, h, pixels).unwrap()
    };
    for grey in [0, 255] {
        let image = from(&mut |_, _| grey);
        assert!(matches!(
            detect(&image, &BOARD),
            Err(NotFound::NoContrast { .. })
        ));
    }
    let mut random = Random(9);
    let noise = from(&mut |_, _| (random.uniform() * 256.0) as u8);
    assert!(matches!(
        detect(&noise, &BOARD),
        Err(NotFound::NoCorners { .. })
    ));
    let stripes = from(&mut |u, v| if (u + v / 3) / 12 % 2 == 0 { 20 } else { 200 });
    assert!(matches!(
        detect(&stripes, &BOARD),
        Err(NotFound::NoCorners { .. })
    ));
    let tiny = Image::<u8>::new(3, 2, 7);
    assert!(matches!(
        detect(&tiny, &BOARD),
        Err(NotFound::NoCorners { .. })
    ));
    // Squares over the whole image: a checkerboard, but not this one.
    let endless = from(&mut |u, v| if (u / 40 + v / 40) % 2 == 0 { 20 } else { 200 });
    assert!(detect(&endless, &BOARD).is_err());
}

/// Blotches of all sizes: thousands of chance corners and neighbours, never a panic or a board.
#[test]
fn textures_are_no_boards() {
    let (w, h) = (320usize, 240usize);
    for seed in 1..40 {
        let mut random = Random(seed);
        let reach = 1 + (seed % 7) as usize;
        let white: Vec<f64> = (0..w * h).map(|_| random.normal()).collect();
        let mean = |source: &[f64], stride: usize, n: usize| -> Vec<f64> {
            (0..w * h)
                .map(|i| {
                    let at = i / stride % n;
                    let (low, high) = (at.saturating_sub(reach), (at + reach).min(n - 1));
                    (low..=high)
                        .map(|k| source[i + k * stride - at * stride])
                        .sum::<f64>()
                        / (high - low + 1) as f64
                })
                .collect()
        };
        let smooth = mean(&mean(&white, 1, w), w, h);
        let contrast = 90.0 * (2 * reach + 1) as f64;
        let pixels = smooth
            .iter()
            .map(|s| u8::from_f32((100.0 + contrast * s) as f32))
            .collect();
        let image = Image::from_vec(w, h, pixels).unwrap();
        assert!(detect(&image, &BOARD).is_err(), "seed {seed}");
        let small = BoardGeometry {
            columns: 3,
            rows: 3,
            ..BOARD
        };
        let _ = detect(&image, &small); // chance may lay nine corners in a grid
    }
}

fn load(path: &std::path::Path) -> Image<u8> {
    let image = ::image::open(path).unwrap().into_luma8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    Image::from_vec(w, h, image.into_raw()).unwrap()
}

#[test]
fn recordings_agree_with_their_truth() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for (folder, limit) in [
        ("../shared/sessions/nominal-1001", 0.006),
        ("../shared/sessions/tiny-1001", 0.010),
        ("tests/data/tiny-1001", 0.010),
    ] {
        let folder = root.join(folder);
        let Ok(text) = std::fs::read_to_string(folder.join("truth.json")) else {
            println!("skipped: {}", folder.display());
            continue;
        };
        let truth: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut all = (Vec::new(), Vec::new());
        let views = [("camera_images", "image"), ("light_poses", "off")];
        for (list, key) in views {
            for view in truth[list].as_array().unwrap() {
                let file = folder.join(view[key].as_str().unwrap());
                if !file.exists() {
                    continue; // the project's copy holds a part of the recording
                }
                let corners: Vec<Vector2> = view["corners"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|c| Vector2::new(c[0].as_f64().unwrap(), c[1].as_f64().unwrap()))
                    .collect();
                let found = detect(&load(&file), &BOARD).unwrap();
                let (s, n) = errors(&found, &corners);
                all.0.extend(s);
                all.1.extend(n);
                assert!((found.blur_px - truth["psf_px"].as_f64().unwrap()).abs() < 0.01);
            }
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let (rms, normalised) = (mean(&all.0).sqrt(), mean(&all.1) / 2.0);
        println!(
            "{}: {rms:.4} px RMS, normalised {normalised:.2}",
            folder.display()
        );
        assert!(rms < limit, "{rms}");
        assert!((0.6..1.3).contains(&normalised), "{normalised}");
    }
}

#[test]
fn all_real_photographs_are_found() {
    let folder =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/opencv_left_9x6");
    let board = BoardGeometry {
        columns: 9,
        rows: 6,
        square_mm: 25.0,
    };
    let mut found = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "jpg") {
            let detection =
                detect(&load(&path), &board).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert!(detection.quality.misfit.iter().all(|&m| m < 2.0));
            found += 1;
        }
    }
    assert_eq!(found, 13);
}

/// Fourteen exposures of one pose, a stripe over thirteen of them, have a quarter of the noise of
/// one; a board that moved in between is not measured again.
#[test]
fn a_stack_measures_corners_better_than_one_image() {
    let look = Look { fine: 2, ..HARD };
    let map = pose(&look, &BOARD, 330.0, 0.3, 0.8, 0.2);
    let grey = shine(&look, &map, &BOARD);
    let exact = truth(&map, &BOARD);
    let mut random = Random(5);
    let first = expose(&look, &grey, &mut random);
    let found = detect(&first, &BOARD).unwrap();
    let middle = found.corners[20].pixel;
    let mut stack = Stack::new(&first, &found);
    let striped = |image: &mut Image<u8>, k: usize| -> Vec<Vector2> {
        let (w, h) = (image.width(), image.height());
        let line = |u: usize| middle.y - 160.0 + 25.0 * k as f64 + 0.1 * u as f64 - 0.1 * middle.x;
        for (i, p) in image.pixels_mut().iter_mut().enumerate() {
            let d = (i / w) as f64 - line(i % w);
            *p = p.saturating_add((150.0 * (-0.5 * d * d / 4.0).exp()) as u8);
        }
        let points = (0..w).step_by(4).map(|u| Vector2::new(u as f64, line(u)));
        points.filter(|p| p.y > 0.0 && p.y < h as f64).collect()
    };
    for k in 0..13 {
        let mut image = expose(&look, &grey, &mut random);
        let points = striped(&mut image, k);
        stack.add(&image, &points, 20.0);
    }
    let again = stack.measure(&found, &BOARD).unwrap();
    let rms = |d: &Detection| {
        let (squares, normalised) = errors(d, &exact);
        let n = squares.len() as f64;
        let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
        (mean(&squares).sqrt(), mean(&normalised))
    };
    let ((one, _), (many, chi)) = (rms(&found), rms(&again));
    println!("{one:.4} px, stacked {many:.4} px, normalised {chi:.2}");
    assert!(many < 0.4 * one, "{many:.4} px of {one:.4} px");
    assert!(
        again
            .corners
            .iter()
            .zip(&found.corners)
            .all(|(a, b)| { a.covariance.trace() < 0.3 * b.covariance.trace() })
    );

    let moved = pose(&look, &BOARD, 330.0, 0.3, 0.8, 0.23);
    let mut image = expose(&look, &shine(&look, &moved, &BOARD), &mut random);
    let mut stack = Stack::new(&first, &found);
    for k in 0..13 {
        let points = striped(&mut image, k);
        stack.add(&image, &points, 20.0);
    }
    assert!(stack.measure(&found, &BOARD).is_err());
}
