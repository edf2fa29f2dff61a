//! Pictures arrive faster than they can be written: memory stays bounded, nothing is dropped, and
//! the wait is told. One test alone in its process: it looks at the process's peak of memory.

use cannula::image::Image;
use cannula::rig::camera::Picture;
use cannula::rig::writer::Writer;
use std::time::Duration;

const WIDTH: usize = 1280;
const HEIGHT: usize = 960;

/// A frame that a camera might give: shades, and noise that can't be foretold.
fn picture(seed: u32) -> Image<u8> {
    let mut state = seed.wrapping_mul(0x9E37_79B9) | 1;
    let pixels = (0..WIDTH * HEIGHT)
        .map(|i| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (60 + i % WIDTH / 16 + (state % 7) as usize) as u8
        })
        .collect();
    Image::from_vec(WIDTH, HEIGHT, pixels).unwrap()
}

/// The most memory that this process has had, bytes; `None` where the system does not tell.
fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

#[test]
fn memory_stays_bounded_and_the_wait_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = |i: u32| dir.path().join(format!("{i:03}.png"));
    let originals: Vec<Image<u8>> = (0..4).map(picture).collect();
    let (count, threads, queue) = (250u32, 2, 8);
    let before = peak();
    let mut writer = Writer::new(threads, queue).unwrap();
    for (i, image) in (0..count).zip(originals.iter().cycle()) {
        writer.push(path(i), Picture::Eight(image.clone())).unwrap();
    }
    let written = writer.finish().unwrap();
    assert_eq!(written.files, u64::from(count));
    assert!(written.waited > Duration::ZERO);
    match before.zip(peak()) {
        None => println!("skipped:no-peak-memory"),
        Some((before, after)) => {
            // Queue, the one at the door, and with each thread a picture, its bytes and its code.
            let pictures = (queue + 1 + 3 * threads) as u64;
            let grown = after - before;
            println!(
                "{} MB of {} MB",
                grown >> 20,
                (u64::from(count) * 1280 * 960) >> 20
            );
            assert!(grown < 2 * pictures * (WIDTH * HEIGHT) as u64, "{grown}");
        }
    }
    for i in [0, 1, 2, count - 1] {
        let read: Image<u8> = cannula::session::decode(&path(i)).unwrap().luma().unwrap();
        assert!(read == originals[i as usize % originals.len()], "{i}");
    }
}
