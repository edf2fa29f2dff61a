use super::*;
use crate::rig::config::TriggerSource;

fn state(checks: &[Check], part: &str, what: &str) -> State {
    let found = checks.iter().find(|c| c.part == part && c.what == what);
    found
        .unwrap_or_else(|| panic!("no {part}: {what} in {checks:#?}"))
        .state
}

fn simulated() -> Rig {
    let mut rig = Rig::default();
    rig.board.port = SIMULATED.into();
    rig.simulation.profile = "tiny".into();
    rig
}

#[test]
fn the_simulated_rig_is_fit() {
    let (checks, size) = rig(&simulated());
    assert!(fit(&checks), "{checks:#?}");
    assert_eq!(size, Some((320, 240)));
    for (part, what) in [
        ("board", "connection"),
        ("board", "firmware"),
        ("board", "state"),
        ("board", "laser"),
        ("board", "inputs"),
        ("board", "link"),
        ("board", "configuration"),
        ("camera", "trigger"),
        ("camera", "frame rate"),
        ("camera", "picture"),
    ] {
        assert_eq!(
            state(&checks, part, what),
            State::Good,
            "{part}: {what}: {checks:#?}"
        );
    }
}

#[test]
fn what_is_missing_is_named_with_a_remedy() {
    let mut away = simulated();
    away.board.port = "/no/such/port".into();
    let (checks, _) = rig(&away);
    assert!(!fit(&checks));
    assert_eq!(state(&checks, "board", "connection"), State::Wrong);
    assert_eq!(state(&checks, "camera", "trigger"), State::Skipped);
    let mut absent = simulated();
    absent.camera.kind = CameraKind::Genicam;
    absent.camera.device = "no such camera".into();
    let (checks, size) = rig(&absent);
    assert_eq!(
        (state(&checks, "camera", "found"), size),
        (State::Wrong, None)
    );
    assert_eq!(state(&checks, "board", "connection"), State::Good);
    for c in checks.iter().filter(|c| c.state != State::Good) {
        assert!(!c.remedy.is_empty() || c.state == State::Skipped, "{c:?}");
    }
}

/// Frames that get lost, and triggers that reach nobody.
#[test]
fn a_camera_that_is_too_slow_or_not_wired_is_found_out() {
    use crate::rig::simulated::Fate;
    let r = simulated();
    let mut opened = open::simulated(&r).unwrap();
    // Two anchors, then every other frame is lost.
    let stage = opened.stage.clone().unwrap();
    stage.inject(Box::new(|n| {
        if n > 3 && n % 2 == 0 {
            Fate::Lost
        } else {
            Fate::Fine
        }
    }));
    opened.board.configure(&r.board_config(5.0)).unwrap();
    let (checks, _) = camera::camera(&mut opened, &r);
    assert_eq!(
        state(&checks, "camera", "frame rate"),
        State::Wrong,
        "{checks:#?}"
    );
    stage.inject(Box::new(|_| Fate::Ignored));
    let (checks, _) = camera::camera(&mut opened, &r);
    assert_eq!(
        state(&checks, "camera", "trigger"),
        State::Wrong,
        "{checks:#?}"
    );
    let mut free = r.clone();
    free.camera.trigger = TriggerSource::Free;
    let (checks, _) = camera::camera(&mut opened, &free);
    assert_eq!(state(&checks, "camera", "trigger"), State::Weak);
    assert_eq!(state(&checks, "camera", "frame rate"), State::Wrong);
}

#[test]
fn inputs_and_faults_of_the_board_are_named() {
    let r = simulated();
    let opened = open::simulated(&r).unwrap();
    let pipe = opened.virtual_board.clone().unwrap();
    pipe.board().set_interlock(true);
    opened.board.keep_alive().unwrap();
    let checks = board::board(&opened.board, "here", &r);
    let said: Vec<&Check> = checks.iter().filter(|c| c.state == State::Wrong).collect();
    assert!(
        said.iter().any(|c| c.found.contains("interlock")),
        "{checks:#?}"
    );
}

#[test]
fn a_calibration_is_held_against_camera_and_scan() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("calibration.json");
    let checks = calibration(Some(&path), None, None);
    assert_eq!(state(&checks, "calibration", "file"), State::Wrong);
    let text = r#"{ "format": "cannula-calibration/1",
      "camera": { "width": 320, "height": 240, "fx": 550.0, "fy": 550.0, "u0": 160.0, "v0": 120.0,
                  "distortion": { "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0 }, "rms_px": 0.9 },
      "light":  { "normal": [0.0, -0.8, 0.6], "a": -1.0, "b": -190.0,
                  "planes": [ { "slide_mm": 0, "normal": [0, -0.8, 0.6], "d": -190.0, "points": 9, "rms_mm": 0.01 },
                              { "slide_mm": 20, "normal": [0, -0.8, 0.6], "d": -210.0, "points": 9, "rms_mm": 0.01 } ],
                  "spacing_error_mm": 0, "offset_error_mm": 0 },
      "provenance": { "program": "cannula", "session": "s", "time": "2020-01-01T00:00:00Z" } }"#;
    std::fs::write(&path, text).unwrap();
    let r = simulated();
    let checks = calibration(Some(&path), Some((1280, 960)), Some(&r));
    assert_eq!(state(&checks, "calibration", "camera"), State::Wrong);
    // Calibrated from 0 to 20 mm; a scan says the same of where it may go.
    for (start_mm, count, expected) in [
        (0.0, 11, State::Good),
        // A hundredth of the range is no extrapolation worth a word.
        (0.19, 11, State::Good),
        (0.21, 11, State::Weak),
        (0.0, 15, State::Weak),
        (0.0, 31, State::Wrong),
    ] {
        let mut planned = r.clone();
        (planned.scan.start_mm, planned.scan.count) = (start_mm, count);
        let checks = calibration(Some(&path), None, Some(&planned));
        assert_eq!(
            state(&checks, "calibration", "light planes"),
            expected,
            "{start_mm} {count}"
        );
    }
    let doubts: Vec<&Check> = checks.iter().filter(|c| c.what == "trust").collect();
    assert!(
        doubts.iter().any(|c| c.found.contains("days old")),
        "{checks:#?}"
    );
    assert!(
        doubts.iter().any(|c| c.found.contains("0.90 px")),
        "{checks:#?}"
    );
}

#[test]
fn a_configuration_that_is_missing_can_be_begun() {
    let loaded = Rig::load(Path::new("/no/such/rig.toml")).map_err(|e| e.to_string());
    let said = loaded.as_ref().unwrap_err().clone();
    assert!(
        said.starts_with("/no/such/rig.toml: there is no such file")
            && said.contains("config --example"),
        "{said}"
    );
    let checks = configuration(&loaded, Some("/no/such/rig.toml"));
    assert_eq!(checks[0].state, State::Wrong);
    assert!(
        checks[0]
            .remedy
            .contains("config --example > /no/such/rig.toml"),
        "{checks:?}"
    );
    // One that is there is mended, not begun anew.
    let there = tempfile::NamedTempFile::new().unwrap();
    let path = there.path().to_str().unwrap();
    std::fs::write(path, "[board]\nspeed = 3").unwrap();
    let loaded = Rig::load(there.path()).map_err(|e| e.to_string());
    assert!(
        configuration(&loaded, Some(path))[0]
            .remedy
            .starts_with("mend that key")
    );
}
