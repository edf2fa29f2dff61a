//! Acquisition on the simulated rig with everything going wrong that can: no picture ever goes to
//! another's position, and what is missing is named.

use cannula::rig::acquisition::{AcquireError, Acquisition, Follow, Shot};
use cannula::rig::camera::{Camera, CameraError, Exposure, Frame as CameraFrame};
use cannula::rig::capture::{self, CaptureError, Step};
use cannula::rig::config::{CameraKind, Mode, Rig, TriggerSource};
use cannula::rig::folder::{FolderCamera, RecordedLedger, recorded_anchor, trigger_times};
use cannula::rig::link::{Board, LinkError, ScanEvent};
use cannula::rig::matching::{Anchor, Fault};
use cannula::rig::open::{self, Opened};
use cannula::rig::progress::{self, Part};
use cannula::rig::recording::Recording;
use cannula::rig::simulated::{Fate, SimulatedCamera};
use cannula::session::Frame;
use cannula::simulation::mcu::{Damage, Pin, VirtualPipe};
use cannula::simulation::{Renderer, Scene, Subject};
use cannula_shared::hello::ResetReason;
use cannula_shared::message::Command;
use cannula_shared::units::{Cycles, Micros, Steps};
use cannula_tests::sweeps::{in_real_time, off_by_px, opened, rig, sweep};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Two single triggers tie the clocks together before each sweep.
const ANCHORS: u64 = 2;

#[test]
fn all_well_in_every_mode() {
    for mode in [Mode::Stop, Mode::Constant] {
        let rig = rig(mode);
        let (mut opened, stage) = opened(&rig);
        let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
        assert_eq!(seen, (0..12).collect::<Vec<u32>>(), "{mode:?}");
        assert_eq!(sweep.complaints(), [""; 0], "{mode:?}");
        // Where the sheet truly was in the middle of each exposure, from the board's step edges.
        let lit: Vec<f64> = stage.take_lit().iter().map(|(mm, _)| *mm).collect();
        let moved = if mode == Mode::Stop {
            0.0
        } else {
            0.5e-3 * rig.camera.exposure_laser_ms * rig.scan.speed_mm_s
        };
        for (k, mm) in lit.iter().rev().take(12).rev().enumerate() {
            let expected = rig.scan.start_mm + rig.scan.spacing_mm * k as f64 + moved;
            assert!(
                (mm - expected).abs() < 2e-3,
                "{mode:?} {k}: {mm} {expected}"
            );
        }
        // The simulated camera's quartz runs 23 ppm fast.
        let (_, drift) = sweep.clock.unwrap();
        assert!((drift * 1e6 - 23.0).abs() < 60.0, "{drift}");
        let status = opened.board.status().unwrap();
        assert!(!status.laser && !status.moving);
    }
}

/// What comes of a scan does not wait for the slide's ramp down, and is asked for once, also where
/// frames are missing.
#[test]
fn the_last_frame_is_told_while_the_slide_slows_down() {
    for lost in [false, true] {
        let rig = rig(Mode::Constant);
        let (mut opened, stage) = opened(&rig);
        if lost {
            stage.inject(Box::new(|n| if n == 9 { Fate::Lost } else { Fate::Fine }));
        }
        let pipe = opened.virtual_board.clone().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let mut recording =
            Recording::open(dir.path(), opened.camera.size(), &rig.geometry()).unwrap();
        let cancel = AtomicBool::new(false);
        let mut acquisition =
            Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
        let (mut shots, mut swept) = (0, Vec::new());
        let scanned = capture::scan(&mut acquisition, &rig, &mut recording, false, &mut |step| {
            match step {
                Step::Shot(_) => shots += 1,
                Step::Swept => swept.push((shots, pipe.board().rig().slide)),
                Step::Ambient(_) => {}
            }
            Ok(())
        })
        .unwrap();
        let stands = pipe.board().rig().slide;
        let [(all, slide)] = swept[..] else {
            panic!("{swept:?}");
        };
        assert_eq!((all, scanned.sweep.shots), (12 - u32::from(lost), all));
        // 20 mm/s on 200 mm/s²: a millimetre to go.
        let to_go = rig.mm(stands - slide);
        assert!(if lost { to_go == 0.0 } else { to_go > 0.5 }, "{to_go} mm");
    }
}

#[test]
fn the_first_frame_lost_after_idle_costs_nothing() {
    let rig = rig(Mode::Constant);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(
        |n| if n == 0 { Fate::Ignored } else { Fate::Fine },
    ));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen.len(), 12);
    assert!(sweep.faults.is_empty());
}

#[test]
fn every_second_trigger_lost_is_named_on_the_fly_and_shot_again_at_rest() {
    for mode in [Mode::Constant, Mode::Stop] {
        let rig = rig(mode);
        let (mut opened, stage) = opened(&rig);
        stage.inject(Box::new(|n| {
            if n % 2 == 1 {
                Fate::Ignored
            } else {
                Fate::Fine
            }
        }));
        let (sweep, mut seen) = sweep(&rig, &mut opened, &stage).unwrap();
        let lost: Vec<u32> = sweep
            .faults
            .iter()
            .map(|f| match f {
                Fault::Lost { trigger } => *trigger,
                other => panic!("{other}"),
            })
            .collect();
        assert_eq!(lost.len(), 6, "{mode:?}: {lost:?}");
        if mode == Mode::Constant {
            assert_eq!(sweep.missing, lost);
            assert!(seen.iter().all(|k| !lost.contains(k)) && seen.len() == 6);
        } else {
            assert_eq!(sweep.reshot, lost);
            assert!(sweep.missing.is_empty());
            seen.sort_unstable();
            assert_eq!(seen, (0..12).collect::<Vec<u32>>());
        }
    }
}

#[test]
fn lost_broken_double_and_late_frames_are_each_named() {
    let rig = rig(Mode::Constant);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(|n| match n.wrapping_sub(ANCHORS) {
        2 => Fate::Lost,
        4 => Fate::Broken,
        6 => Fate::Double,
        8 => Fate::Late(9_000),
        _ => Fate::Fine,
    }));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen, [0, 1, 3, 5, 6, 7, 9, 10, 11]);
    assert_eq!(sweep.missing, [2, 4, 8]);
    assert_eq!(sweep.faults.len(), 4, "{:?}", sweep.faults);
    let named = |f: &dyn Fn(&Fault) -> bool| sweep.faults.iter().any(f);
    assert!(named(&|f| matches!(f, Fault::Lost { trigger: 2 })));
    assert!(named(&|f| matches!(f, Fault::Broken { trigger: 4, .. })));
    assert!(named(&|f| matches!(f, Fault::Double { trigger: 6, .. })));
    assert!(named(
        &|f| matches!(f, Fault::Late { trigger: 8, by_ms, .. } if (*by_ms - 9.0).abs() < 1.0)
    ));
}

#[test]
fn a_camera_that_stalls_for_two_seconds_loses_nothing_if_one_may_wait() {
    let mut rig = rig(Mode::Constant);
    rig.camera.timeout_ms = 3000.0;
    let (mut opened, stage) = opened(&rig);
    // Two seconds of waits of 20 ms.
    stage.inject(Box::new(|n| {
        if n == ANCHORS + 5 {
            Fate::Held(100)
        } else {
            Fate::Fine
        }
    }));
    let (whole, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen.len(), 12);
    assert!(whole.faults.is_empty());

    // If not, what is late is named, and does not leak into the next sweep.
    rig.camera.timeout_ms = 500.0;
    stage.inject(Box::new(|n| {
        if n == ANCHORS + 5 {
            Fate::Held(100)
        } else {
            Fate::Fine
        }
    }));
    let (cut, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen, [0, 1, 2, 3, 4]);
    assert_eq!(cut.missing, [5, 6, 7, 8, 9, 10, 11]);
    stage.inject(Box::new(|_| Fate::Fine));
    let (again, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen.len(), 12, "{:?}", again.complaints());
}

#[test]
fn no_frame_at_all_ends_with_advice() {
    let rig = rig(Mode::Constant);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(|_| Fate::Ignored));
    let said = sweep(&rig, &mut opened, &stage).unwrap_err().to_string();
    assert!(
        said.contains("no frame") && said.contains("trigger cable"),
        "{said}"
    );
}

#[test]
fn a_reset_in_mid_scan_ends_it_with_the_laser_off() {
    let rig = rig(Mode::Constant);
    let (mut opened, _stage) = opened(&rig);
    let pipe = opened.virtual_board.clone().unwrap();
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
    acquisition.expose(5.0).unwrap();
    let outcome = acquisition.sweep(&rig.scan_request(), &mut |shot| {
        if shot.index == 4 {
            pipe.board().restart(ResetReason::Watchdog);
        }
        Ok(())
    });
    let Err(AcquireError::Link(LinkError::Restarted(ResetReason::Watchdog))) = outcome else {
        panic!("{outcome:?}");
    };
    assert!(!pipe.board().level(Pin::Laser));
}

/// The program would go on for good: after a minute of the test's own time it is told to end.
fn guarded<T>(run: impl FnOnce(&AtomicBool) -> T) -> T {
    let cancel = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (done, ended) = std::sync::mpsc::channel::<()>();
        let cancel = &cancel;
        scope.spawn(move || {
            if ended.recv_timeout(Duration::from_secs(60)) == Err(RecvTimeoutError::Timeout) {
                cancel.store(true, Ordering::Relaxed);
            }
        });
        let outcome = run(cancel);
        drop(done);
        outcome
    })
}

/// Both directions of the link swallow what they are given, from now on.
fn cut(pipe: &VirtualPipe) {
    let mut board = pipe.board();
    board.damage_to_board(Damage::CUT);
    board.damage_to_host(Damage::CUT);
}

/// The port still takes bytes, so nothing but the silence tells.
#[test]
fn a_board_that_falls_silent_ends_a_sweep_and_is_named() {
    for mode in [Mode::Constant, Mode::Stop] {
        for dead in [false, true] {
            let rig = rig(mode);
            let (mut opened, _stage) = opened(&rig);
            let pipe = opened.virtual_board.clone().unwrap();
            let mut since = 0;
            let outcome = guarded(|cancel| {
                let (board, camera) = (&opened.board, opened.camera.as_mut());
                let mut acquisition = Acquisition::new(board, camera, &rig, cancel);
                acquisition.expose(5.0).unwrap();
                acquisition.sweep(&rig.scan_request(), &mut |shot| {
                    if shot.index == 4 {
                        since = pipe.board().now().0;
                        if dead {
                            pipe.board().kill_cpu();
                        } else {
                            cut(&pipe);
                        }
                    }
                    Ok(())
                })
            });
            let error = outcome.unwrap_err();
            assert!(
                matches!(error, AcquireError::Link(LinkError::Mute { .. })),
                "{error}"
            );
            let said = error.to_string();
            assert!(
                said.starts_with("the motion board has said nothing for 4.")
                    && said.contains("scanning"),
                "{said}"
            );
            let after = Cycles(pipe.board().now().0 - since).to_micros_down();
            assert!(after < Micros(5_000_000), "{after:?}");
            drop(opened);
            assert!(!pipe.board().level(Pin::Laser));
        }
    }
}

/// A camera that runs by itself whatever its trigger says: one frame after the other, none of them due.
struct Chatter(u64);

impl Camera for Chatter {
    fn description(&self) -> String {
        "one that never stops".into()
    }

    fn size(&self) -> (u32, u32) {
        (16, 16)
    }

    fn arm(&mut self, _: &Exposure) -> Result<(), CameraError> {
        Ok(())
    }

    fn wait(&mut self, timeout: Duration) -> Result<Option<CameraFrame>, CameraError> {
        if timeout.is_zero() {
            return Ok(None);
        }
        std::thread::sleep(Duration::from_millis(2));
        self.0 += 1;
        Ok(Some(CameraFrame {
            sequence: self.0,
            time_us: 900_000_000 + 2_000 * self.0 as i64,
            picture: None,
        }))
    }
}

#[test]
fn a_camera_that_never_stops_does_not_keep_a_sweep_from_its_end() {
    let frames: Vec<Frame> = (0..3)
        .map(|k| Frame {
            slide_mm: f64::from(k),
            slide_steps: None,
            trigger_us: None,
            image: String::new(),
        })
        .collect();
    let began = Instant::now();
    let (swept, lost) = guarded(|cancel| {
        let mut follow = Follow {
            camera: &mut Chatter(0),
            cancel,
            timeout: Duration::from_millis(200),
            laser: true,
            planned: 3,
        };
        let mut ledger = RecordedLedger::new(&frames, 800.0);
        follow.run(&mut ledger, Anchor::from_pair(0, 0), &mut |_, _| Ok(()))
    })
    .unwrap();
    assert_eq!((swept.shots, lost.len()), (0, 3));
    assert!(began.elapsed() < Duration::from_secs(10));
}

/// Ctrl-C when the board does not answer: soon over, and nothing is said that nobody knows.
#[test]
fn ctrl_c_before_a_silent_board_does_not_say_that_the_laser_is_off() {
    for trigger in [TriggerSource::Board, TriggerSource::Software] {
        let mut rig = rig(Mode::Constant);
        rig.camera.trigger = trigger;
        let (mut opened, _stage) = opened(&rig);
        let pipe = opened.virtual_board.clone().unwrap();
        let cancel = AtomicBool::new(false);
        let mut acquisition =
            Acquisition::new(&opened.board, opened.camera.as_mut(), &rig, &cancel);
        acquisition.expose(5.0).unwrap();
        let mut since = 0;
        let outcome = acquisition.sweep(&rig.scan_request(), &mut |shot| {
            if shot.index == 4 {
                since = pipe.board().now().0;
                cut(&pipe);
                cancel.store(true, Ordering::Relaxed);
            }
            Ok(())
        });
        let error = outcome.unwrap_err();
        assert!(matches!(error, AcquireError::Unanswered(_)), "{error}");
        let said = error.to_string();
        assert!(
            said.contains("interrupted, but the motion board does not say")
                && said.contains("look at both")
                && !said.contains("the laser is off and the slide stands;"),
            "{said}"
        );
        drop(opened);
        let after = Cycles(pipe.board().now().0 - since).to_micros_down();
        assert!(after < Micros(3_000_000), "{trigger:?}: {after:?}");
        // What it says of the board is so.
        let mut board = pipe.board();
        assert!(!board.level(Pin::Laser));
        let off = board.trace().falls(Pin::Laser).last().unwrap_or(0);
        assert!(off < since + Micros(300_000).to_cycles().0);
    }
}

#[test]
fn a_board_that_falls_silent_on_a_move_is_named_at_once_after_ctrl_c() {
    for interrupted in [false, true] {
        let rig = rig(Mode::Stop);
        let (mut opened, _stage) = opened(&rig);
        let pipe = opened.virtual_board.clone().unwrap();
        let cancel: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
        opened.board.heed(cancel);
        let far = Command::MoveTo {
            position: Steps(160_000),
            speed_um_s: 0,
        };
        let mut since = 0;
        let error = opened
            .board
            .move_with(far, |_| {
                if since == 0 {
                    since = pipe.board().now().0;
                    cut(&pipe);
                    cancel.store(interrupted, Ordering::Relaxed);
                }
            })
            .unwrap_err();
        assert!(
            matches!(
                error,
                LinkError::Mute {
                    doing: "moving",
                    ..
                }
            ),
            "{error}"
        );
        let after = Cycles(pipe.board().now().0 - since).to_micros_down();
        let limit = Micros(if interrupted { 1_500_000 } else { 4_500_000 });
        assert!(since > 0 && after < limit, "{interrupted}: {after:?}");
    }
}

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

/// A scan that ends after its sixth shot.
fn break_off(opened: &mut Opened, rig: &Rig, recording: &mut Recording) {
    let cancel = AtomicBool::new(false);
    let mut acquisition = Acquisition::new(&opened.board, opened.camera.as_mut(), rig, &cancel);
    let begun = capture::scan(&mut acquisition, rig, recording, false, &mut |step| {
        if matches!(step, Step::Shot(s) if s.index == 5) {
            cancel.store(true, Ordering::Relaxed);
        }
        Ok(())
    });
    assert!(begun.is_err());
}

/// A scan that was broken off does not go on with anything that its images depend on changed, nor
/// before another scene; and what stands is left as it is.
#[test]
fn another_rig_or_scene_does_not_go_on_with_a_scan() {
    let rig = rig(Mode::Stop);
    let (mut opened, stage) = opened(&rig);
    let dir = tempfile::tempdir().unwrap();
    let mut recording = Recording::open(dir.path(), opened.camera.size(), &rig.geometry()).unwrap();
    break_off(&mut opened, &rig, &mut recording);
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
    let mut recording = Recording::open(dir.path(), opened.camera.size(), &rig.geometry()).unwrap();
    break_off(&mut opened, &rig, &mut recording);
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

#[test]
fn an_open_interlock_is_said_not_recorded_as_dark_frames() {
    let rig = rig(Mode::Stop);
    let (mut opened, stage) = opened(&rig);
    opened
        .virtual_board
        .as_ref()
        .unwrap()
        .board()
        .set_interlock(true);
    let said = sweep(&rig, &mut opened, &stage).unwrap_err().to_string();
    assert!(
        said.contains("laser interlock open") && said.contains("rearm"),
        "{said}"
    );
}

/// A host that was killed leaves the slide in full motion; the next one comes at once.
#[test]
fn right_after_a_killed_host_the_next_one_waits_until_the_board_stands() {
    let mut rig = rig(Mode::Constant);
    // Two seconds of ramp.
    rig.board.acceleration_mm_s2 = 25.0;
    rig.scan.start_mm = 60.0;
    let board = open::simulated_board(&rig);
    let pipe = VirtualPipe::new(board);
    let killed = Board::over(pipe.clone()).unwrap();
    open::ready(&killed, &rig).unwrap();
    let mut far = rig.scan_request();
    (far.count, far.speed_um_s) = (80, 50_000);
    let mut scan = killed.scan(&far).unwrap();
    while !matches!(scan.next_event().unwrap(), Some(ScanEvent::Trigger(t)) if t.index == 20) {}
    // No farewell, as after a kill.
    std::mem::forget(scan);
    std::mem::forget(killed);
    let next = Board::over(pipe.clone()).unwrap();
    let found = next.status().unwrap();
    assert!(found.moving, "{found:?}");
    assert_eq!(
        open::ready(&next, &rig).unwrap(),
        None,
        "it knows its position"
    );
    let stands = next.status().unwrap();
    assert!(
        !stands.moving && !stands.laser && stands.position_known,
        "{stands:?}"
    );
    assert!(next.move_to(Steps(800), 0).is_ok());
}

/// The same over a pseudo-terminal, with the real serial port code and in real time.
#[cfg(unix)]
#[test]
fn over_a_pseudo_terminal_in_real_time() {
    let rig = rig(Mode::Constant);
    let (real, board, stage) = in_real_time(&rig);
    // Homed already: a second program need not home again.
    assert!(open::ready(&board, &rig).unwrap().is_none());
    let mut opened = Opened {
        camera: Box::new(SimulatedCamera::wired(
            stage.clone(),
            open::wire(&rig, real.board()),
        )),
        board,
        stage: None,
        virtual_board: None,
    };
    let (swept, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen.len(), 12, "{:?}", swept.complaints());

    // A camera that exists only here learns of triggers by the ledger.
    opened.camera = Box::new(SimulatedCamera::by_ledger(
        stage.clone(),
        rig.mm(1),
        rig.travel_mm_s(&rig.scan_request()),
    ));
    let (swept, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen.len(), 12, "{:?}", swept.complaints());
}

#[test]
fn a_recording_is_replayed_frame_by_frame() {
    let dir = tempfile::tempdir().unwrap();
    let profile = cannula::simulation::Profile::Tiny;
    cannula::simulation::record(dir.path(), profile, 5, &cannula::progress::Silent).unwrap();
    let session = cannula::session::Session::open(dir.path()).unwrap();
    let frames = session.manifest.scan.as_ref().unwrap().frames.clone();
    let renderer = Renderer::new(Scene::new(profile, 5)).unwrap();
    for missing in [None, Some(0), Some(7)] {
        let files = frames
            .iter()
            .zip(trigger_times(&frames))
            .zip(0..)
            .filter(|(_, i)| Some(*i) != missing)
            .map(|((f, time), _)| (session.path(&f.image), time))
            .collect();
        let mut camera = FolderCamera::of("replay".into(), files).unwrap();
        let mut ledger = RecordedLedger::new(&frames, 1000.0);
        let cancel = AtomicBool::new(false);
        let mut follow = Follow {
            camera: &mut camera,
            cancel: &cancel,
            timeout: Duration::from_millis(40),
            laser: true,
            planned: frames.len(),
        };
        let mut shots = 0;
        let (sweep, unpaired) = follow
            .run(
                &mut ledger,
                recorded_anchor(&frames),
                &mut |trigger, taken| {
                    shots += 1;
                    // The hand lies between these.
                    if (6..26).contains(&trigger.index) {
                        let shot = Shot {
                            index: trigger.index,
                            steps: trigger.position.0.into(),
                            slide_mm: frames[trigger.index as usize].slide_mm,
                            trigger_us: trigger.time.0,
                            laser: true,
                            picture: taken.picture,
                            arrived: taken.arrived,
                        };
                        assert!(off_by_px(&renderer, &shot) < 1.2);
                    }
                    Ok(())
                },
            )
            .unwrap();
        let expected: Vec<u32> = missing.into_iter().collect();
        assert_eq!(
            unpaired.iter().map(|t| t.index).collect::<Vec<_>>(),
            expected
        );
        assert_eq!(sweep.faults.len(), expected.len());
        assert_eq!(shots, 31 - expected.len());
    }
}
