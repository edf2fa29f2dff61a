//! The machine: cores, clock, room and speed of the disk.

use super::{Check, Checks};
use std::io::Write;
use std::path::Path;
use std::time::Instant;

/// Less room than this is too little for a calibration's images, bytes.
const ROOM_WRONG: u64 = 300_000_000;
/// Less than this holds only a few recordings, bytes.
const ROOM_WEAK: u64 = 3_000_000_000;
/// Bytes written to time the disk.
const TRIAL: usize = 16 << 20;
/// A clock before this is not set, s since 1970: the year of this program.
const CLOCK_LEAST: i64 = 1_767_225_600;

/// Looks at the machine. `folder` is where recordings go; `bytes_per_s` what a scan writes.
pub fn machine(folder: &Path, bytes_per_s: f64) -> Vec<Check> {
    let mut c = Checks::new("machine");
    let system = format!("{} {}", std::env::consts::OS, std::env::consts::ARCH);
    match std::thread::available_parallelism().map_or(1, usize::from) {
        1 => c.weak(
            "processor",
            format!("{system}, one core"),
            "frames are worked on while they arrive; give it two cores",
        ),
        cores => c.good("processor", format!("{system}, {cores} cores")),
    }
    let now = jiff::Timestamp::now();
    if now.as_second() < CLOCK_LEAST {
        c.weak(
            "clock",
            now.to_string(),
            "set the clock: a calibration's age can't be told",
        );
    } else {
        c.good("clock", crate::output::seconds(now));
    }
    room(folder, &mut c);
    speed(folder, bytes_per_s, &mut c);
    c.list
}

#[cfg(unix)]
fn room(folder: &Path, c: &mut Checks) {
    let Ok(stat) = rustix::fs::statvfs(folder) else {
        c.skipped("room", "the system does not say");
        return;
    };
    let bytes = stat.f_bavail.saturating_mul(stat.f_frsize);
    let found = format!("{:.1} GB free in {}", bytes as f64 * 1e-9, folder.display());
    if bytes < ROOM_WRONG {
        c.wrong("room", found, "make room: a calibration takes 0.2 GB");
    } else if bytes < ROOM_WEAK {
        c.weak("room", found, "make room soon: a calibration takes 0.2 GB");
    } else {
        c.good("room", found);
    }
}

#[cfg(not(unix))]
fn room(_folder: &Path, c: &mut Checks) {
    c.skipped("room", "not looked at on this system");
}

fn speed(folder: &Path, needed: f64, c: &mut Checks) {
    let trial = || -> std::io::Result<f64> {
        let mut file = tempfile::Builder::new()
            .prefix(".cannula-")
            .tempfile_in(folder)?;
        // Not zeros: some disks store those for nothing.
        let bytes: Vec<u8> = (0..TRIAL)
            .map(|i| (i.wrapping_mul(0x9E37_79B1) >> 13) as u8)
            .collect();
        let began = Instant::now();
        file.write_all(&bytes)?;
        file.as_file().sync_all()?;
        Ok(TRIAL as f64 / began.elapsed().as_secs_f64())
    };
    match trial() {
        Ok(speed) => {
            let found = format!(
                "writes {:.0} MB/s, a scan needs {:.0} MB/s",
                speed * 1e-6,
                needed * 1e-6
            );
            if speed < needed {
                c.weak("disk", found, "record to a faster disk, or scan slower");
            } else {
                c.good("disk", found);
            }
        }
        Err(e) => c.wrong(
            "disk",
            format!("{}: {e}", folder.display()),
            "run it in a folder that you may write to",
        ),
    }
}
