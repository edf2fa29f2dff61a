//! Acquisition on the simulated rig with everything going wrong that can: no picture ever goes to
//! another's position, and what is missing is named.

use cannula::rig::acquisition::{AcquireError, Acquisition, Follow, Shot};
use cannula::rig::camera::{Camera, CameraError, Exposure, Frame as CameraFrame};
use cannula::rig::capture::{self, Step};
use cannula::rig::config::{Mode, TriggerSource};
use cannula::rig::folder::{FolderCamera, RecordedLedger, recorded_anchor, trigger_times};
use cannula::rig::link::{Board, LinkError, ScanEvent};
use cannula::rig::matching::{Anchor, Fault};
use cannula::rig::open::{self, Opened};
use cannula::rig::recording::Recording;
use cannula::rig::simulated::{Fate, SimulatedCamera};
use cannula::session::Frame;
use cannula::simulation::mcu::{Damage, Pin, VirtualPipe};
use cannula::simulation::{Renderer, Scene};
use cannula_shared::hello::ResetReason;
use cannula_shared::message::Command;
use cannula_shared::units::{Cycles, Micros, Steps};
use cannula_tests::sweeps::{in_real_time, off_by_px, opened, rig, sweep};
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
