//! Can this machine and this disk keep up with a camera? Hands rendered frames of 1280 × 960 to the
//! background writer, first 100 a second, then as fast as it takes them.
//!
//! ```text
//! cargo run --release --example writer -- FOLDER [FRAMES A SECOND] [SECONDS]
//! ```
//!
//! The folder is made and taken away again.

use cannula::rig::camera::Picture;
use cannula::rig::recording::Recording;
use cannula::simulation::{Profile, Renderer, Scene, Subject};
use std::path::Path;
use std::time::{Duration, Instant};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().unwrap_or_else(|| "writer-trial".into());
    let mut number = |default: f64| match arguments.next() {
        Some(word) => word.parse::<f64>(),
        None => Ok(default),
    };
    let (rate, seconds) = (number(100.0)?, number(10.0)?);
    anyhow::ensure!(
        rate > 0.0 && seconds > 0.0,
        "give a rate and seconds above 0"
    );
    let folder = Path::new(&folder);
    anyhow::ensure!(
        !folder.exists(),
        "{}: there is something; name a new folder",
        folder.display()
    );
    let frames = rendered()?;
    println!(
        "{:>10} {:>8} {:>10} {:>12} {:>12}",
        "", "frames", "a second", "waited, s", "peak, MB"
    );
    let count = (rate * seconds).ceil() as u32;
    let outcome =
        run(folder, &frames, count, Some(rate)).and_then(|()| run(folder, &frames, count, None));
    let _ = std::fs::remove_dir_all(folder);
    outcome
}

/// Some frames of a scan, each with its own noise.
fn rendered() -> anyhow::Result<Vec<Picture>> {
    let scene = Scene::new(Profile::Nominal, 1);
    let renderer = Renderer::new(scene).ok_or_else(|| anyhow::anyhow!("no such scene"))?;
    let still = renderer.still(&Subject::Hand);
    Ok((0..16)
        .map(|i| {
            let plane = renderer.scene().lit_plane(4.0 * i as f64, i);
            Picture::Eight(renderer.frame(&still, 1.0, Some(&plane), i))
        })
        .collect())
}

fn run(folder: &Path, frames: &[Picture], count: u32, rate: Option<f64>) -> anyhow::Result<()> {
    let mut writer = Recording::writer()?;
    let began = Instant::now();
    for (i, picture) in (0..count).zip(frames.iter().cycle()) {
        if let Some(rate) = rate {
            let due = Duration::from_secs_f64(f64::from(i) / rate);
            std::thread::sleep(due.saturating_sub(began.elapsed()));
        }
        writer.push(folder.join(format!("{i:06}.png")), picture.clone())?;
    }
    let written = writer.finish()?;
    println!(
        "{:>10} {:>8} {:>10.1} {:>12.3} {:>12}",
        rate.map_or("unpaced".to_owned(), |r| format!("{r} / s")),
        written.files,
        written.files as f64 / began.elapsed().as_secs_f64(),
        written.waited.as_secs_f64(),
        peak_mb().map_or("unknown".to_owned(), |mb| format!("{mb:.0}")),
    );
    Ok(())
}

/// The most memory that this process has had, where the system tells (Linux).
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace()
        .nth(1)?
        .parse::<f64>()
        .ok()
        .map(|kb| kb / 1024.0)
}
