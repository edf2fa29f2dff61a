//! Sweeps with a camera that the board does not trigger, with frames lost, doubled, broken and late:
//! no picture ever goes to another's position ([`sweep`] looks at each for its laser line), and what
//! is missing is named.

use cannula::rig::config::{Mode, Rig, TriggerSource};
use cannula::rig::matching::Fault;
use cannula::rig::open::{self, Opened};
use cannula::rig::simulated::Fate;
use cannula_tests::sweeps::{in_real_time, opened, rig, sweep};

const ALL: std::ops::Range<u32> = 0..12;

fn own(trigger: TriggerSource) -> Rig {
    let mut rig = rig(Mode::Stop);
    rig.camera.trigger = trigger;
    rig
}

#[test]
fn all_well_by_command_and_by_itself() {
    for trigger in [TriggerSource::Software, TriggerSource::Free] {
        let rig = own(trigger);
        let (mut opened, stage) = opened(&rig);
        let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
        assert_eq!(seen, ALL.collect::<Vec<u32>>(), "{trigger:?}");
        assert_eq!(sweep.complaints(), [""; 0], "{trigger:?}");
        let status = opened.board.status().unwrap();
        assert!(!status.laser && !status.moving);
    }
}

/// The frame of a position comes 0.2 s after its time-out; the one that was then asked for in its
/// place is still on its way when the slide has moved on.
#[test]
fn a_frame_after_its_time_out_does_not_land_on_the_next_position() {
    let rig = own(TriggerSource::Software);
    let (mut opened, stage) = opened(&rig);
    let late = 1000 * (rig.camera.timeout_ms as u64 + 200);
    stage.inject(Box::new(move |n| match n {
        3 | 4 => Fate::Delayed(late),
        _ => Fate::Fine,
    }));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen, ALL.collect::<Vec<u32>>());
    assert_eq!(sweep.reshot[0], 3);
    let named = |f: &dyn Fn(&Fault) -> bool| sweep.faults.iter().any(f);
    assert!(
        named(&|f| matches!(f, Fault::Lost { trigger: 3 })),
        "{:?}",
        sweep.faults
    );
    assert!(
        named(&|f| matches!(f, Fault::Before { trigger: 4, by_ms, .. } if *by_ms > 100.0)),
        "{:?}",
        sweep.faults
    );
}

/// The camera obeys a command so late that slide and laser have gone on.
#[test]
fn an_exposure_that_begins_late_is_left_out() {
    let rig = own(TriggerSource::Software);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(|n| match n {
        // Its position is given up for lost and shot again; then it begins, on the way to the next or there.
        2 => Fate::Late(560_000),
        _ => Fate::Fine,
    }));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen, ALL.collect::<Vec<u32>>());
    assert_eq!(sweep.reshot[0], 2);
    assert!(!sweep.faults.is_empty());
}

#[test]
fn lost_broken_and_double_frames_are_named_and_shot_again() {
    let rig = own(TriggerSource::Software);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(|n| match n {
        // From the first on, and what is shot again counts, too.
        0 => Fate::Lost,
        2 => Fate::Ignored,
        5 => Fate::Broken,
        8 => Fate::Double,
        _ => Fate::Fine,
    }));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert_eq!(seen, ALL.collect::<Vec<u32>>());
    assert!(sweep.missing.is_empty());
    assert_eq!(sweep.reshot.len(), 3, "{:?}", sweep.complaints());
    let count = |f: &dyn Fn(&Fault) -> bool| sweep.faults.iter().filter(|x| f(x)).count();
    assert!(
        count(&|f| matches!(f, Fault::Lost { .. })) >= 2,
        "{:?}",
        sweep.faults
    );
    assert_eq!(count(&|f| matches!(f, Fault::Broken { .. })), 1);
    assert_eq!(count(&|f| matches!(f, Fault::Double { .. })), 1);
}

/// Whatever comes in whatever order: every shot shows its own position, and every position is
/// either there or named.
#[test]
fn any_mixture_of_faults_shifts_nothing() {
    for trigger in [TriggerSource::Software, TriggerSource::Free] {
        for seed in 1..6u64 {
            let mut rig = own(trigger);
            rig.camera.timeout_ms = 150.0;
            let (mut opened, stage) = opened(&rig);
            let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            stage.inject(Box::new(move |_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                let (kind, size) = ((state >> 33) % 10, (state >> 40) % 600);
                match kind {
                    0 => Fate::Ignored,
                    1 => Fate::Lost,
                    2 => Fate::Broken,
                    3 => Fate::Double,
                    4 | 5 => Fate::Delayed(1000 * size),
                    6 if trigger == TriggerSource::Software => Fate::Late(1000 * size as i64),
                    _ => Fate::Fine,
                }
            }));
            let (sweep, mut seen) = sweep(&rig, &mut opened, &stage).unwrap();
            assert!(!sweep.faults.is_empty() || trigger == TriggerSource::Free);
            assert!(
                seen.len() > 6,
                "{trigger:?} {seed}: {:?}",
                sweep.complaints()
            );
            seen.extend(&sweep.missing);
            seen.sort_unstable();
            assert_eq!(seen, ALL.collect::<Vec<u32>>(), "{trigger:?} {seed}");
        }
    }
}

#[test]
fn a_camera_that_gives_nothing_leaves_every_position_out() {
    let rig = own(TriggerSource::Free);
    let (mut opened, stage) = opened(&rig);
    stage.inject(Box::new(|_| Fate::Ignored));
    let (sweep, seen) = sweep(&rig, &mut opened, &stage).unwrap();
    assert!(seen.is_empty());
    assert_eq!(sweep.missing, ALL.collect::<Vec<u32>>());
}

/// Over a pseudo-terminal in real time: host and camera each have a clock of their own.
#[cfg(unix)]
#[test]
fn over_a_pseudo_terminal_in_real_time() {
    for trigger in [TriggerSource::Software, TriggerSource::Free] {
        let rig = own(trigger);
        let (real, board, stage) = in_real_time(&rig);
        let mut opened = Opened {
            camera: Box::new(open::beside(&rig, &stage, real.board())),
            board,
            stage: None,
            virtual_board: None,
        };
        let (swept, seen) = sweep(&rig, &mut opened, &stage).unwrap();
        assert_eq!(seen.len(), 12, "{:?}", swept.complaints());
    }
}
