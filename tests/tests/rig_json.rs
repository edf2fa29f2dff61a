//! `--json` of the commands that drive a rig: one JSON object on standard output, nothing else, also
//! where a command warns or fails.

use cannula_tests::program::{self, start, wait_output};
use cannula_tests::sweeps::SMALL_RIG;
use serde_json::Value;
use std::time::Duration;

/// See [`program::become_it`].
#[test]
fn the_program() {
    program::become_it();
}

/// Exit status and standard output of the program alone.
fn ran(words: &[&str]) -> (Option<i32>, String) {
    let all = [&["--json"], words].concat();
    let ended = wait_output(start(&all), Duration::from_secs(120));
    // The harness announces the test before it becomes the program.
    let (_, out) = ended.out.split_once("the_program ... ").expect("announced");
    println!("{words:?}: {}", ended.said);
    (ended.status, out.to_owned())
}

fn object(words: &[&str]) -> Value {
    let (status, out) = ran(words);
    assert_eq!(status, Some(0), "{words:?}: {out}");
    let value: Value =
        serde_json::from_str(&out).unwrap_or_else(|e| panic!("{words:?}: {e}: {out}"));
    assert!(value.is_object(), "{words:?}: {out}");
    value
}

#[test]
fn hands_on_commands() {
    let port = "--port=simulated";
    let status = object(&["motion", port, "status"]);
    assert_eq!(status["laser"], false);
    assert_eq!(status["position_mm"], Value::Null);
    assert_eq!(object(&["motion", port, "home"])["position_mm"], 0.0);
    assert_eq!(object(&["motion", port, "trigger"])["laser"], false);
    for command in ["stop", "release"] {
        assert_eq!(object(&["motion", port, command])["moving"], false);
    }
    let taken = &object(&["motion", port, "config"])["configuration"];
    assert_eq!(taken["steps_per_mm"]["numerator"], 800);
    assert_eq!(taken["travel_um"], 300_000);
    assert!(object(&["ports"])["ports"].is_array());
    let example = object(&["config", "--example"]);
    assert_eq!(example["board"]["travel_mm"], 300.0);
    // What fails says so on standard error alone.
    for (words, expected) in [
        (vec!["motion", port, "move", "10"], 1),
        (vec!["motion", port, "rearm"], 1),
        (vec!["motion", "--port", "/nowhere/tty", "status"], 1),
        (vec!["motion", port, "laser"], 2),
        (vec!["config", "/nowhere/rig.toml"], 1),
    ] {
        assert_eq!(ran(&words), (Some(expected), String::new()), "{words:?}");
    }
}

/// A board that was homed and starts anew knows nothing any more, and homes again.
#[cfg(unix)]
#[test]
fn a_board_that_starts_anew_comes_back() {
    use cannula::rig::{config::Rig, open};
    use cannula::simulation::mcu::{Pin, RealTime};
    let real = RealTime::start(open::simulated_board(&Rig::default())).unwrap();
    let motion = |words: &[&str]| {
        let all = [&["--json", "motion", "--port", real.path()], words].concat();
        let ended = wait_output(start(&all), Duration::from_secs(60));
        let (_, out) = ended.out.split_once("the_program ... ").expect("announced");
        assert_eq!(ended.status, Some(0), "{words:?}: {}", ended.said);
        serde_json::from_str::<Value>(out).unwrap()
    };
    motion(&["home"]);
    let before = motion(&["move", "12.5"]);
    assert_eq!(before["position_mm"], 12.5);
    motion(&["reboot"]);
    let after = motion(&["status"]);
    let up = |status: &Value| status["uptime_us"].as_u64().unwrap();
    assert!(up(&after) < up(&before), "{before} {after}");
    assert_eq!(
        (&after["position_known"], &after["driver"], &after["laser"]),
        (&false.into(), &false.into(), &false.into())
    );
    assert!(!real.board().board().level(Pin::Laser));
    // The slide itself stands where it was, and is found again.
    assert_eq!(real.board().board().rig().slide, 800 * 12 + 400 + 800 * 4);
    assert_eq!(motion(&["home"])["position_mm"], 0.0);
    assert_eq!(real.board().board().rig().slide, 800 * 4);

    // In its bootloader it is no motion board: said, not waited for without end.
    motion(&["reboot", "--bootloader"]);
    assert_eq!(
        ran(&["motion", "--port", real.path(), "status"]),
        (Some(1), String::new())
    );
}

#[test]
fn recording_scanning_replaying() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let config = path("rig.toml");
    std::fs::write(&config, SMALL_RIG).unwrap();
    let rig = ["--config", &config];
    let session = path("session");
    let capture = |what: &str, more: &[&str]| {
        object(&[&["capture"], &rig[..], &[what, "--out", &session], more].concat())
    };
    assert_eq!(capture("camera", &["--poses", "12"])["poses"], 12);
    // The same again, as after it was broken off: nothing twice.
    assert_eq!(capture("camera", &["--poses", "12"])["poses"], 12);
    assert_eq!(capture("light", &["--poses", "4"])["poses"], 4);
    let outside = ["--entry", "900,10", "--vein", "10,10", "20,20"];
    let words = [
        &["capture"],
        &rig[..],
        &["scan", "--out", &session],
        &outside,
    ]
    .concat();
    assert_eq!(ran(&words), (Some(1), String::new()));
    let inside = ["--entry", "160.5,120", "--vein", "158,130", "163,105"];
    let scanned = capture("scan", &inside);
    assert_eq!(
        (&scanned["frames"], &scanned["stood"]),
        (&31.into(), &0.into())
    );
    let text = std::fs::read(dir.path().join("session/session.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(
        manifest["entry"]["pixel"],
        serde_json::json!([160.5, 120.0])
    );
    assert_eq!(manifest["entry"]["radius_mm"], 12.0);

    let calibration = path("calibration.json");
    object(&["calibrate", &session, "--out", &calibration]);
    let out = path("scan");
    let scan = [
        &["scan"],
        &rig[..],
        &["--out", &out, "--calibration", &calibration],
    ]
    .concat();
    assert_eq!(object(&scan)["planned"], 31);
    let recorded = path("scan/session");
    assert_eq!(
        object(&["replay", &recorded, "--calibration", &calibration])["frames"],
        31
    );
}

/// The spread of the poses is enough; whether that calibrates is another matter, and has the last word.
#[test]
fn enough_is_what_calibrates() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (config, session, file) = (path("rig.toml"), path("s"), path("s/session.json"));
    // The simulated recording's slide.
    let rig = SMALL_RIG.replace("[board]\n", "[board]\nsteps_per_mm = [320, 1]\n");
    std::fs::write(&config, rig).unwrap();
    object(&["simulate", "--profile", "tiny", "--session", &session]);
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    // Its four poses twice: the guide asks for six.
    let light = manifest["light"].as_array_mut().unwrap();
    light.extend(light.clone());
    let look = |what: &str, manifest: &Value| {
        std::fs::write(&file, manifest.to_string()).unwrap();
        object(&[
            "capture", "--config", &config, what, "--out", &session, "--poses", "1",
        ])
    };
    let said = look("light", &manifest);
    assert_eq!(
        (&said["enough"], &said["next"]),
        (&true.into(), &Value::Null),
        "{said}"
    );
    assert_eq!(look("camera", &manifest)["enough"], true);

    // A slide that says it goes twice as far as it does: no image shows it, only the calibration.
    for pose in manifest["light"].as_array_mut().unwrap() {
        for frame in pose["on"].as_array_mut().unwrap() {
            frame["slide_mm"] = (2.0 * frame["slide_mm"].as_f64().unwrap()).into();
            frame["slide_steps"] = (2 * frame["slide_steps"].as_i64().unwrap()).into();
        }
    }
    let said = look("light", &manifest);
    assert_eq!(said["enough"], false, "{said}");
    let next = said["next"].as_str().unwrap();
    assert!(
        next.starts_with("it would not calibrate yet") && next.contains("mm of the slide"),
        "{next}"
    );
    // That is none of the camera's business.
    assert_eq!(look("camera", &manifest)["enough"], true);
}
