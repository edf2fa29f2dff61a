//! Recorded scans that are broken off, by Ctrl-C, a disk that fails or a power cut: what was written is whole,
//! and the same scan goes on where it was, no other.

use cannula::rig::acquisition::{AcquireError, Acquisition};
use cannula::rig::capture::{self, CaptureError, Step};
use cannula::rig::config::{CameraKind, Mode, Rig};
use cannula::rig::open::Opened;
use cannula::rig::progress::{self, Part};
use cannula::rig::recording::Recording;
use cannula::simulation::Subject;
use cannula::simulation::mcu::Pin;
use cannula_tests::sweeps::{opened, rig};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Ctrl-C, or a disk that fails, in the middle of a recorded scan.
fn broken_off(disk: bool) {
    let rig = rig(Mode::Constant);
    let (mut opened, stage) = opened(&rig);
    let pipe = opened.virtual_board.clone().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let cancel = AtomicBool::new(false);
    let mut recording = Recording::open(dir.path(), opened.camera.size(), &rig.geometry()).unwrap();
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    let outcome = capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |step| {
        if matches!(step, Step::Shot(s) if s.index == 3) {
            if disk {
                // From here on nothing can be written below "scan".
                std::fs::rename(dir.path().join("scan"), dir.path().join("moved")).unwrap();
                std::fs::write(dir.path().join("scan"), "").unwrap();
            } else {
                cancel.store(true, Ordering::Relaxed);
            }
        }
        if disk {
            // Time for the background writer to meet the failure.
            std::thread::sleep(Duration::from_millis(30));
        }
        Ok(())
    });
    let error = outcome.unwrap_err();
    match (&error, disk) {
        (CaptureError::Acquire(AcquireError::Interrupted), false) => {}
        (CaptureError::Acquire(AcquireError::Write(e)), true) => {
            assert!(e.to_string().contains("scan/0"), "{e}");
        }
        _ => panic!("{error}"),
    }
    // Laser off at once, slide at rest after its ramp, and the board still answers.
    assert!(!pipe.board().level(Pin::Laser));
    // Ctrl-C says that the slide stands, so it does.
    let said = pipe.board().rig().slide;
    for _ in 0..500 {
        opened.board.keep_alive().unwrap();
    }
    let status = opened.board.status().unwrap();
    assert!(
        !status.moving && !status.laser && status.position_known,
        "{status:?}"
    );
    assert!(disk || pipe.board().rig().slide == said);
    // What was written is whole, and no session.json names a part of a scan.
    let folder = dir.path().join(if disk { "moved" } else { "scan" });
    let mut files = 0;
    let mut first = Vec::new();
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.ends_with("progress.jsonl") {
            continue;
        }
        if !path.ends_with("ambient.png") {
            first.push(std::fs::read(&path).unwrap());
        }
        cannula::session::decode(&path).unwrap_or_else(|e| panic!("{e}"));
        files += 1;
    }
    assert!(files >= 2, "{files}");
    assert!(!dir.path().join("session.json").exists());
    // The next attempt overwrites nothing and is complete.
    cancel.store(false, Ordering::Relaxed);
    stage.show(&Subject::Hand);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |_| {
        Ok(())
    })
    .unwrap();
    let session = cannula::session::Session::open(dir.path()).unwrap();
    let scan = session.manifest.scan.unwrap();
    // Where the folder was there it has gone on in it, with what stood: no image lies about.
    let went_on = if disk { "scan_1" } else { "scan" };
    let positions: Vec<i64> = scan.frames.iter().filter_map(|f| f.slide_steps).collect();
    // 20 mm/s for half of 5 ms: the middle of an exposure lies 40 steps after its trigger.
    let unbroken: Vec<i64> = (0..12).map(|k| 800 * (16 + 2 * k) + 40).collect();
    assert_eq!(positions, unbroken);
    for (frame, k) in scan.frames.iter().zip(0..) {
        assert_eq!(frame.image, format!("{went_on}/{k:03}.png"));
    }
    let there = std::fs::read_dir(dir.path().join(went_on)).unwrap().count();
    assert_eq!(there, 13, "twelve and the ambient one");
    if !disk {
        let again = scan.frames[..3].iter().zip(&first);
        assert!(
            first.len() >= 3
                && again
                    .into_iter()
                    .all(|(f, image)| image == &session_image(dir.path(), f))
        );
    }
}

/// Everything in a folder, byte by byte.
fn bytes(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(bytes(&path));
        } else {
            all.insert(path.clone(), std::fs::read(&path).unwrap());
        }
    }
    all
}

/// A recording whose scan ended after its sixth shot.
fn broken_off_at_six(opened: &mut Opened, rig: &Rig, folder: &Path) -> Recording {
    let mut recording = Recording::open(folder, opened.camera.size(), &rig.geometry()).unwrap();
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), rig, &cancel);
    let begun = capture::scan(&mut acquisition, rig, &mut recording, false, &mut |step| {
        if matches!(step, Step::Shot(s) if s.index == 5) {
            cancel.store(true, Ordering::Relaxed);
        }
        Ok(())
    });
    assert!(begun.is_err());
    recording
}

/// A scan that was broken off does not go on with anything that its images depend on changed, nor
/// before another scene; and what stands is left as it is.
#[test]
fn another_rig_or_scene_does_not_go_on_with_a_scan() {
    let rig = rig(Mode::Stop);
    let (mut opened, stage) = opened(&rig);
    let dir = tempfile::tempdir().unwrap();
    let mut recording = broken_off_at_six(&mut opened, &rig, dir.path());
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    let before = bytes(dir.path());
    assert!(before.len() >= 6, "{:?}", before.keys());

    type Change = fn(&mut Rig);
    let changes: [(&str, Change); 14] = [
        ("board.steps_per_mm", |r| r.board.steps_per_mm = [801, 1]),
        ("board.invert_direction", |r| {
            r.board.invert_direction = true
        }),
        ("board.clearance_mm", |r| r.board.clearance_mm = 5.0),
        ("camera.kind", |r| r.camera.kind = CameraKind::Genicam),
        ("camera.device", |r| r.camera.device = "another".into()),
        ("camera.pixel_format", |r| {
            r.camera.pixel_format = "Mono16".into()
        }),
        ("camera.region", |r| r.camera.region = [8, 8, 64, 64]),
        ("camera.exposure_laser_ms", |r| {
            r.camera.exposure_laser_ms = 4.0
        }),
        ("camera.gain_db", |r| r.camera.gain_db = 3.0),
        ("scan.start_mm", |r| r.scan.start_mm = 15.0),
        ("scan.spacing_mm", |r| r.scan.spacing_mm = 1.5),
        ("scan.count", |r| r.scan.count = 11),
        ("simulation.seed", |r| r.simulation.seed += 1),
        ("simulation.profile", |r| {
            r.simulation.profile = "nominal".into()
        }),
    ];
    // None is forgotten.
    let named: Vec<String> = progress::settings(&rig, Part::Scan).into_keys().collect();
    let mut changed = changes.map(|(key, _)| key);
    changed.sort_unstable();
    assert_eq!(named, changed);
    for (key, change) in changes {
        let mut other = rig.clone();
        change(&mut other);
        let refused = capture::scan(&mut acquisition, &other, &mut recording, false, &mut |_| {
            Ok(())
        });
        let said = refused.unwrap_err().to_string();
        assert!(
            said.contains(&format!("{key} = ")) && said.contains("--force"),
            "{key}: {said}"
        );
        assert_eq!(bytes(dir.path()), before, "{key}");
    }

    // The hand has gone, a board lies there; or the light has changed. Nothing was recorded since.
    let triggers = |opened: &Opened| {
        let pipe = opened.virtual_board.clone().unwrap();
        let mut board = pipe.board();
        board.trace().rises(Pin::Laser).count()
    };
    let lit = triggers(&opened);
    let scene = stage.renderer().scene();
    stage.show(&Subject::Board(scene.camera_poses[0]));
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    let refused = capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |_| {
        Ok(())
    });
    let said = refused.unwrap_err().to_string();
    assert!(
        said.contains("the scene has changed") && said.contains("--force"),
        "{said}"
    );
    assert_eq!(bytes(dir.path()), before);
    assert_eq!(triggers(&opened), lit, "the laser stayed off");

    // As it was: it goes on, and what stood is untouched.
    stage.show(&Subject::Hand);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    let scanned = capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |_| {
        Ok(())
    })
    .unwrap();
    assert!(
        scanned.stood >= 5 && scanned.sweep.shots == 12,
        "{scanned:?}"
    );
    let after = bytes(dir.path());
    for (path, image) in before
        .iter()
        .filter(|(path, _)| path.extension().is_some_and(|e| e == "png"))
    {
        assert_eq!(after.get(path), Some(image), "{}", path.display());
    }
}

/// A scan that is recorded anew and broken off goes on, if it is the same scan; the one that stood is
/// named until then.
#[test]
fn a_scan_anew_that_was_broken_off_goes_on() {
    let rig = rig(Mode::Stop);
    let (mut opened, stage) = opened(&rig);
    let dir = tempfile::tempdir().unwrap();
    let mut recording = Recording::open(dir.path(), opened.camera.size(), &rig.geometry()).unwrap();
    let cancel = AtomicBool::new(false);
    let mut run = |rig: &Rig, force: bool, until: u32| {
        cancel.store(false, Ordering::Relaxed);
        let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), rig, &cancel);
        capture::scan(&mut acquisition, rig, &mut recording, force, &mut |step| {
            if matches!(step, Step::Shot(s) if s.index == until) {
                cancel.store(true, Ordering::Relaxed);
            }
            Ok(())
        })
    };
    let images = |folder: &str| bytes(&dir.path().join(folder));
    run(&rig, true, 99).unwrap();
    let first = images("scan");
    assert!(run(&rig, true, 5).is_err());
    let begun = images("scan_1");
    // With the same settings before the same scene.
    let scanned = run(&rig, true, 99).unwrap();
    assert!(
        scanned.stood >= 5 && scanned.sweep.shots == 12,
        "{scanned:?}"
    );
    for (path, image) in begun {
        if path.extension().is_some_and(|e| e == "png") {
            assert_eq!(std::fs::read(&path).unwrap(), image, "{}", path.display());
        }
    }
    assert_eq!(images("scan"), first);
    let named = || {
        let session = cannula::session::Session::open(dir.path()).unwrap();
        session.manifest.scan.unwrap().frames[0].image.clone()
    };
    assert_eq!(named(), "scan_1/000.png");

    // With other settings, or before another scene, what was begun is thrown away, and never refused.
    let mut other = rig.clone();
    other.scan.count = 11;
    assert!(run(&rig, true, 5).is_err());
    let scanned = run(&other, true, 99).unwrap();
    assert_eq!((scanned.stood, scanned.sweep.shots), (0, 11));
    assert_eq!(named(), "scan_2/000.png");
    assert!(run(&rig, true, 5).is_err());
    stage.show(&Subject::Board(stage.renderer().scene().camera_poses[0]));
    let scanned = run(&rig, true, 99).unwrap();
    assert_eq!((scanned.stood, scanned.sweep.shots), (0, 12));
    assert_eq!(named(), "scan_3/000.png");
    assert_eq!(images("scan_3").len(), 13, "twelve and the ambient one");
}

/// A power cut leaves files without their content: those positions are visited again, the others not.
#[test]
fn images_that_cannot_be_read_are_taken_again() {
    let rig = rig(Mode::Stop);
    let (mut opened, _) = opened(&rig);
    let dir = tempfile::tempdir().unwrap();
    let mut recording = broken_off_at_six(&mut opened, &rig, dir.path());
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    let before = bytes(&dir.path().join("scan"));
    let image = |k: usize| dir.path().join(format!("scan/{k:03}.png"));
    let whole = before[&image(1)].clone();
    std::fs::write(image(1), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(image(3), "").unwrap();
    let standing = (0..12).filter(|k| before.contains_key(&image(*k))).count();
    let scanned = capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |_| {
        Ok(())
    })
    .unwrap();
    assert_eq!((scanned.stood, scanned.sweep.shots), (standing - 2, 12));
    // Every header and every image is read by these.
    let session = cannula::session::Session::open(dir.path()).unwrap();
    let frames = session.manifest.scan.unwrap().frames;
    let at: Vec<_> = frames.iter().filter_map(|f| f.slide_steps).collect();
    assert_eq!(at, (0..12).map(|k| 800 * (16 + 2 * k)).collect::<Vec<_>>());
    for (k, frame) in frames.iter().enumerate() {
        assert_eq!(dir.path().join(&frame.image), image(k));
        cannula::session::decode(&image(k)).unwrap_or_else(|e| panic!("{e}"));
        if let Some(then) = before.get(&image(k)).filter(|_| k != 1 && k != 3) {
            assert_eq!(&session_image(dir.path(), frame), then, "{k}");
        }
    }
}

fn session_image(folder: &std::path::Path, frame: &cannula::session::Frame) -> Vec<u8> {
    std::fs::read(folder.join(&frame.image)).unwrap()
}

#[test]
fn ctrl_c_leaves_laser_off_slide_at_rest_files_whole() {
    broken_off(false);
}

#[test]
fn a_failing_disk_stops_the_scan_and_leaves_whole_files() {
    broken_off(true);
}
