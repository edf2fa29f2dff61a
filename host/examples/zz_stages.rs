use cannula::board::{BoardGeometry, detect};
use cannula::image::Image;
use std::time::Instant;
fn least<T>(n: usize, mut f: impl FnMut() -> T) -> f64 {
    (0..n)
        .map(|_| {
            let t = Instant::now();
            std::hint::black_box(f());
            t.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::MAX, f64::min)
}
fn noise(n: u32, seed: u32) -> Image<u8> {
    let mut s = seed;
    let (w, h) = (1280, 960);
    Image::from_vec(
        w,
        h,
        (0..w * h)
            .map(|_| {
                s ^= s << 13;
                s ^= s >> 17;
                s ^= s << 5;
                (10 + s % (n + 1)) as u8
            })
            .collect(),
    )
    .unwrap()
}
fn main() {
    let g = BoardGeometry {
        columns: 8,
        rows: 6,
        square_mm: 10.0,
    };
    for n in [6, 30, 60, 100, 200, 245] {
        for seed in [1u32, 77] {
            let im = noise(n, seed);
            println!("noise {n} {seed}: {:.2} ms", least(40, || detect(&im, &g)));
        }
    }
    for dir in std::env::args().skip(1) {
        let mut worst = (0.0, String::new());
        let mut sum = 0.0;
        let mut k = 0;
        for f in std::fs::read_dir(&dir).unwrap() {
            let p = f.unwrap().path();
            if p.extension().is_none_or(|e| e != "png") {
                continue;
            }
            let im = image::open(&p).unwrap().to_luma8();
            let im =
                Image::from_vec(im.width() as usize, im.height() as usize, im.into_raw()).unwrap();
            let t = least(10, || detect(&im, &g));
            sum += t;
            k += 1;
            if t > worst.0 {
                worst = (t, p.display().to_string())
            }
        }
        println!(
            "{dir}: mean {:.2} worst {:.2} {}",
            sum / k as f64,
            worst.0,
            worst.1
        );
    }
}
