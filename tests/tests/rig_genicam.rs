//! GenICam cameras against Debian's fake GigE camera over the loopback (`.ci/cameras.sh`).
//!
//! Its pictures are a ramp that moves on with the camera's own count of frames: pixel (x, y) of frame n shows
//! (x + y + n) modulo 255, at 10 ms and 0 dB. So a picture says which frame it is, and whether it is whole.
#![cfg(feature = "aravis")]

use cannula::rig::acquisition::{AcquireError, Acquisition, Sweep};
use cannula::rig::camera::{Camera, CameraError, Exposure, Frame, Picture};
use cannula::rig::config::{self, Mode, Rig, TriggerSource};
use cannula::rig::genicam::GenicamCamera;
use cannula::rig::link::Board;
use cannula::rig::matching::Fault;
use cannula::rig::open;
use cannula::simulation::mcu::{Pin, RealTime};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// One fake camera at a time: it listens on a fixed port.
static PORT: Mutex<()> = Mutex::new(());

struct Fake(Child);

impl Fake {
    fn start(options: &[&str]) -> Self {
        let child = Command::new("arv-fake-gv-camera-0.8")
            .args(["-i", "127.0.0.1"])
            .args(options)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("arv-fake-gv-camera-0.8 is not installed: run .ci/cameras.sh");
        Self(child)
    }

    fn open(trigger: TriggerSource) -> GenicamCamera {
        Self::with(&config::Camera {
            trigger,
            region: [0, 0, SIZE.0, SIZE.1],
            ..config::Camera::default()
        })
        .expect("a sound configuration")
    }

    fn with(settings: &config::Camera) -> Result<GenicamCamera, CameraError> {
        let began = Instant::now();
        loop {
            let opened = GenicamCamera::open(settings);
            let starting = matches!(opened, Err(CameraError::NotFound(..)));
            if !starting || began.elapsed() > Duration::from_secs(10) {
                return opened;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

const SIZE: (u32, u32) = (640, 480);
/// The ramp is shown as it is.
const PLAIN: Exposure = Exposure {
    ms: 10.0,
    gain_db: 0.0,
};

/// Which frame a picture shows (modulo 255), from its first pixel; `None` if any pixel says otherwise.
fn phase(picture: &Picture) -> Option<u64> {
    let Picture::Eight(image) = picture else {
        panic!("Mono8 was asked for");
    };
    let (width, height) = (image.width(), image.height());
    let first = u64::from(image.at(0, 0));
    let ramp = |x: usize, y: usize| (x as u64 + y as u64 + first) % 255;
    let whole = (0..height).all(|y| (0..width).all(|x| u64::from(image.at(x, y)) == ramp(x, y)));
    whole.then_some(first)
}

#[test]
fn no_software_triggered_frame_is_lost() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let _fake = Fake::start(&[]);
    let mut camera = Fake::open(TriggerSource::Software);
    assert!(
        camera.description().contains("Aravis"),
        "{}",
        camera.description()
    );
    assert_eq!(camera.size(), SIZE);
    camera.arm(&PLAIN).unwrap();
    let mut first = None;
    let mut time = i64::MIN;
    for i in 0..300u64 {
        camera.fire().unwrap();
        let frame = camera
            .wait(Duration::from_secs(2))
            .unwrap()
            .unwrap_or_else(|| panic!("frame {i} did not come"));
        let picture = frame
            .picture
            .unwrap_or_else(|| panic!("frame {i} is broken"));
        assert_eq!(picture.size(), (640, 480));
        let shown = phase(&picture).unwrap_or_else(|| panic!("frame {i} is no ramp"));
        // Counted by the camera and shown in the picture alike: this one, and no other.
        let (sequence, began) = *first.get_or_insert((frame.sequence, shown));
        assert_eq!(frame.sequence, sequence + i);
        assert_eq!(shown, (began + i) % 255, "frame {i}");
        assert!(frame.time_us > time, "frame {i}");
        time = frame.time_us;
    }
    // Nothing came that was not asked for.
    assert!(camera.wait(Duration::from_millis(200)).unwrap().is_none());
    camera.disarm().unwrap();
}

/// Frames that wait in the camera's buffers come in the order in which they were exposed.
#[test]
fn frames_that_wait_come_in_order() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let _fake = Fake::start(&[]);
    let mut camera = Fake::open(TriggerSource::Software);
    camera.arm(&PLAIN).unwrap();
    for _ in 0..3 {
        for _ in 0..20 {
            camera.fire().unwrap();
            // It takes 25 a second.
            std::thread::sleep(Duration::from_millis(60));
        }
        let mut shown = Vec::new();
        while let Some(frame) = camera.wait(Duration::from_millis(300)).unwrap() {
            let picture = frame.picture.expect("whole");
            shown.push((frame.sequence, phase(&picture).expect("a ramp")));
        }
        assert_eq!(shown.len(), 20);
        for pair in shown.windows(2) {
            assert_eq!(pair[1].0, pair[0].0 + 1);
            assert_eq!(pair[1].1, (pair[0].1 + 1) % 255);
        }
    }
}

/// What the camera had before does not matter, and what it can't do is said.
#[test]
fn the_region_is_the_one_asked_for() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let _fake = Fake::start(&[]);
    let settings = |region| config::Camera {
        trigger: TriggerSource::Software,
        region,
        ..config::Camera::default()
    };
    // The fake camera's sensor has 2048 × 2048 pixels; it starts with 512 × 512 of them.
    for (region, size) in [
        ([0, 0, 0, 0], (2048, 2048)),
        ([64, 32, 640, 480], (640, 480)),
        ([0, 0, 0, 0], (2048, 2048)),
        ([1024, 1024, 1024, 1024], (1024, 1024)),
        ([8, 0, 2040, 2048], (2040, 2048)),
    ] {
        let mut camera = Fake::with(&settings(region)).unwrap();
        assert_eq!(camera.size(), size, "{region:?}");
        camera.arm(&PLAIN).unwrap();
        camera.fire().unwrap();
        let frame = camera
            .wait(Duration::from_secs(2))
            .unwrap()
            .expect("a frame");
        let picture = frame.picture.expect("whole");
        assert_eq!(
            picture.size(),
            (size.0 as usize, size.1 as usize),
            "{region:?}"
        );
    }
    for region in [[0, 0, 5000, 100], [2000, 0, 640, 480]] {
        let said = Fake::with(&settings(region))
            .err()
            .expect("refused")
            .to_string();
        assert!(said.contains("camera.region"), "{region:?}: {said}");
    }
}

/// A bench in real time whose slide stops at each of so many positions.
fn bench(count: u32, trigger: TriggerSource) -> (Rig, RealTime, Board) {
    let mut rig = Rig::default();
    rig.board.settle_ms = 1.0;
    rig.board.homing_fast_mm_s = 40.0;
    rig.camera.trigger = trigger;
    rig.camera.exposure_laser_ms = PLAIN.ms;
    rig.camera.timeout_ms = 300.0;
    rig.scan.mode = Mode::Stop;
    (rig.scan.start_mm, rig.scan.spacing_mm, rig.scan.count) = (1.0, 0.1, count);
    let real = RealTime::start(open::simulated_board(&rig)).unwrap();
    let board = Board::connect(real.path()).unwrap();
    open::ready(&board, &rig).unwrap();
    (rig, real, board)
}

/// A sweep with the fake camera: how it went, and each shot's position and phase.
fn sweep(fake: &[&str], count: u32) -> (Sweep, Vec<(u32, u64)>) {
    let _fake = Fake::start(fake);
    let (rig, real, board) = bench(count, TriggerSource::Software);
    let mut camera = Fake::open(TriggerSource::Software);
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&board, &mut camera, &rig, &cancel);
    acquisition.expose(rig.camera.exposure_laser_ms).unwrap();
    let mut shown = Vec::new();
    let sweep = acquisition.sweep(&rig.scan_request(), &mut |shot| {
        let expected = rig.scan.start_mm + rig.scan.spacing_mm * f64::from(shot.index);
        assert!((shot.slide_mm - expected).abs() < 1e-3 && shot.laser);
        shown.push((shot.index, phase(&shot.picture).expect("a whole ramp")));
        Ok(())
    });
    assert!(!real.board().board().level(Pin::Laser));
    (sweep.unwrap(), shown)
}

/// Board and camera together: as many frames as positions, each with its own.
#[test]
fn a_sweep_of_many_positions_loses_none() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let (sweep, shown) = sweep(&[], 120);
    assert_eq!(sweep.complaints(), [""; 0]);
    assert_eq!((sweep.planned, sweep.shots), (120, 120));
    let (_, first) = shown[0];
    for (i, &(index, phase)) in (0..).zip(&shown) {
        assert_eq!((u64::from(index), phase), (i, (first + i) % 255));
    }
    assert_eq!(shown.len(), 120);
}

#[test]
fn a_line_that_never_fires_ends_in_a_time_out() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let _fake = Fake::start(&[]);
    let mut camera = Fake::open(TriggerSource::Board);
    camera.arm(&PLAIN).unwrap();
    for _ in 0..3 {
        let began = Instant::now();
        assert!(camera.wait(Duration::from_millis(300)).unwrap().is_none());
        let waited = began.elapsed();
        assert!(
            waited >= Duration::from_millis(290) && waited < Duration::from_secs(2),
            "{waited:?}"
        );
        assert!(camera.wait(Duration::ZERO).unwrap().is_none());
    }

    // The rig says so, names the camera, and leaves the laser off.
    let (rig, real, board) = bench(10, TriggerSource::Board);
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&board, &mut camera, &rig, &cancel);
    acquisition.expose(rig.camera.exposure_laser_ms).unwrap();
    let began = Instant::now();
    let outcome = acquisition.sweep(&rig.scan_request(), &mut |shot| panic!("{}", shot.index));
    let Err(AcquireError::NoFrames { tries, camera }) = outcome else {
        panic!("{outcome:?}");
    };
    assert!(camera.contains("Aravis"), "{camera}");
    let fired = real.board().board().trace().rises(Pin::Trigger).count();
    assert_eq!(fired, tries as usize);
    let patience = Duration::from_secs_f64(1e-3 * rig.camera.timeout_ms) * tries;
    assert!(began.elapsed() >= patience && began.elapsed() < 5 * patience);
    let mut board = real.board().board();
    assert!(!board.level(Pin::Laser));
    assert_eq!(board.trace().rises(Pin::Laser).count(), 0);
}

/// Frames that are asked for one by one of a camera that loses so many of a thousand packets; `None` for
/// those that do not come within `patience`. By its count each is the one just asked for, whatever
/// became of those before.
fn lossy(per_mille: &str, frames: u64, patience: Duration) -> Vec<Option<Frame>> {
    let _fake = Fake::start(&["-r", per_mille]);
    let mut camera = Fake::open(TriggerSource::Software);
    camera.arm(&PLAIN).unwrap();
    let mut first = None;
    let mut ask = |i: u64| {
        camera.fire().unwrap();
        let frame = camera.wait(patience).unwrap()?;
        let count = frame.sequence.wrapping_sub(i);
        assert_eq!(count, *first.get_or_insert(count), "frame {i}");
        Some(frame)
    };
    (0..frames).map(&mut ask).collect()
}

#[test]
fn lost_packets_never_make_a_wrong_picture() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut whole, mut broken, mut missing) = (0, 0, 0);
    let mut began = None;
    // Three packets in a thousand are lost; a picture takes some 220.
    for (i, frame) in (0..).zip(lossy("3", 60, Duration::from_secs(2))) {
        let Some(frame) = frame else {
            missing += 1;
            continue;
        };
        match &frame.picture {
            Some(picture) => {
                let shown = phase(picture).unwrap_or_else(|| panic!("frame {i}: passes for whole"));
                let began = *began.get_or_insert((shown + 255 * 255 - i) % 255);
                assert_eq!(shown, (began + i) % 255, "frame {i}");
                whole += 1;
            }
            None => broken += 1,
        }
    }
    // A picture comes whole with 0.997^220 = 52 %.
    println!("{whole} whole, {broken} broken, {missing} missing");
    assert!((14..49).contains(&whole), "{whole}");
}

/// A frame's first packet says which one it is. Where that is lost, too, nobody may guess.
#[test]
fn a_frame_without_its_first_packet_takes_no_other_s_number() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut broken, mut missing, mut newest) = (0, 0, i64::MIN);
    // Two packets in five: no picture comes whole, and some without their first one. More frames than
    // there are buffers, so that each was used before.
    for (i, frame) in (0..80).zip(lossy("400", 80, Duration::from_millis(600))) {
        let Some(frame) = frame else {
            missing += 1;
            continue;
        };
        assert!(frame.picture.is_none(), "frame {i}: passes for whole");
        assert!(frame.time_us > newest, "frame {i}");
        newest = frame.time_us;
        broken += 1;
    }
    println!("{broken} broken, {missing} missing");
    assert!((10..70).contains(&missing), "{missing}");
}

/// In a scan every loss is named, and its position is taken again or left out, named as well.
#[test]
fn a_sweep_over_a_bad_cable_names_every_loss() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let (sweep, shown) = sweep(&["-r", "3"], 40);
    println!("{:?}", sweep.complaints());
    // Every position is there once, or named as missing.
    let mut all: Vec<u32> = shown.iter().map(|(index, _)| *index).collect();
    assert_eq!(all.len(), sweep.shots as usize);
    all.extend(&sweep.missing);
    all.sort_unstable();
    assert_eq!(all, (0..40).collect::<Vec<u32>>());
    // Each frame in the order of its request: the ramps move on, by one more for each that was lost.
    let lost: u64 = shown
        .windows(2)
        .map(|w| (w[1].1 + 254 - w[0].1) % 255)
        .sum();
    assert!(lost > 10, "{lost}");
    assert!(!sweep.reshot.is_empty());
    for position in sweep.reshot.iter().chain(&sweep.missing) {
        let named = sweep.faults.iter().any(|f| {
            matches!(f, Fault::Lost { trigger } | Fault::Broken { trigger, .. } if trigger == position)
        });
        assert!(named, "{position}: {:?}", sweep.faults);
    }
}
