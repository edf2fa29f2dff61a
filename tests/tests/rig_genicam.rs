//! GenICam cameras against Debian's fake GigE camera over the loopback (`.ci/cameras.sh`).
#![cfg(feature = "aravis")]

use cannula::rig::camera::{Camera, Exposure, Picture};
use cannula::rig::config::{self, TriggerSource};
use cannula::rig::genicam::GenicamCamera;
use std::process::{Child, Command, Stdio};
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
        let settings = config::Camera {
            trigger,
            region: [0, 0, 640, 480],
            ..config::Camera::default()
        };
        let began = Instant::now();
        loop {
            match GenicamCamera::open(&settings) {
                Ok(camera) => return camera,
                Err(e) => assert!(began.elapsed() < Duration::from_secs(10), "{e}"),
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

const SHORT: Exposure = Exposure {
    ms: 1.0,
    gain_db: 0.0,
};

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
    assert_eq!(camera.size(), (640, 480));
    camera.arm(&SHORT).unwrap();
    let mut last = None;
    for i in 0..300u32 {
        camera.fire().unwrap();
        let frame = camera
            .wait(Duration::from_secs(2))
            .unwrap()
            .unwrap_or_else(|| panic!("frame {i} did not come"));
        match frame.picture {
            Some(Picture::Eight(image)) => assert_eq!((image.width(), image.height()), (640, 480)),
            other => panic!("frame {i}: {:?}", other.is_some()),
        }
        if let Some((sequence, time)) = last {
            assert_eq!(frame.sequence, sequence + 1, "frame {i}");
            assert!(frame.time_us > time, "frame {i}");
        }
        last = Some((frame.sequence, frame.time_us));
    }
    // Nothing came that was not asked for.
    assert!(camera.wait(Duration::from_millis(200)).unwrap().is_none());
    camera.disarm().unwrap();
}

#[test]
fn a_line_that_never_fires_ends_in_a_time_out() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    let _fake = Fake::start(&[]);
    let mut camera = Fake::open(TriggerSource::Board);
    camera.arm(&SHORT).unwrap();
    let began = Instant::now();
    assert!(camera.wait(Duration::from_millis(300)).unwrap().is_none());
    let waited = began.elapsed();
    assert!(
        waited >= Duration::from_millis(290) && waited < Duration::from_secs(2),
        "{waited:?}"
    );
    assert!(camera.wait(Duration::ZERO).unwrap().is_none());
}

#[test]
fn lost_packets_never_make_a_wrong_picture() {
    let _one = PORT.lock().unwrap_or_else(PoisonError::into_inner);
    // Three packets in a thousand are lost; a picture takes some 220.
    let _fake = Fake::start(&["-r", "3"]);
    let mut camera = Fake::open(TriggerSource::Software);
    camera.arm(&SHORT).unwrap();
    let (mut whole, mut broken, mut missing) = (0, 0, 0);
    for _ in 0..60 {
        camera.fire().unwrap();
        match camera.wait(Duration::from_secs(2)).unwrap() {
            Some(frame) => match frame.picture {
                Some(Picture::Eight(image)) => {
                    assert_eq!(image.pixels().len(), 640 * 480);
                    whole += 1;
                }
                Some(Picture::Sixteen(_)) => panic!("Mono8 was asked for"),
                None => broken += 1,
            },
            None => missing += 1,
        }
    }
    // Each is accounted for, and the loss shows: no frame passes as whole that is not.
    println!("{whole} whole, {broken} broken, {missing} missing");
    assert_eq!(whole + broken + missing, 60);
    assert!(whole > 0 && broken + missing > 0);
}
