//! The commands that drive a rig, run as the program runs them, on the simulated rig.

use cannula_tests::sweeps::SMALL_RIG;
use std::ffi::OsString;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// One at a time: the board over a pseudo-terminal is in real time, and its heartbeat of 200 ms does not outlast a
/// recording that is rendered on all cores beside it.
static ONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn cannula(args: &[&str]) -> u8 {
    let words = ["cannula", "--quiet"]
        .iter()
        .chain(args)
        .map(OsString::from);
    cannula::cli::main(words)
}

fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&text).unwrap()
}

/// From homing to the needle, and every error within what a picture of a quarter the size allows.
#[test]
fn the_demo_finds_the_needle() {
    let _one = alone();
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let to = out.to_str().unwrap();
    assert_eq!(
        cannula(&["demo", "--profile", "tiny", "--seed", "3", "--out", to]),
        0
    );
    let errors = json(&out.join("errors.json"));
    let error = |name: &str| {
        let all = errors["errors"].as_array().unwrap();
        let line = all.iter().find(|e| e["quantity"] == name);
        line.unwrap_or_else(|| panic!("{name}"))["error"]
            .as_f64()
            .unwrap()
    };
    assert!(error("light planes, mean over the volume") < 0.25);
    assert!(error("entry point") < 0.6);
    assert!(error("plane, normal") < 0.6);
    assert!(error("needle, axis") < 0.8);
    let result = json(&out.join("result.json"));
    assert_eq!(result["format"], "cannula-result/1");
    assert!(out.join("cloud.ply").exists() && out.join("calibration.json").exists());
    let truth = json(&out.join("session/truth.json"));
    assert_eq!(truth["format"], "cannula-truth/1");
    assert_eq!(truth["light_poses"].as_array().unwrap().len(), 4);
    assert_eq!(truth["scan"].as_array().unwrap().len(), 31);

    // It stands there: nothing is overwritten unasked.
    assert_eq!(cannula(&["demo", "--profile", "tiny", "--out", to]), 1);
    // The recording is one like any other.
    let again = dir.path().join("again");
    let session = out.join("session");
    assert_eq!(
        cannula(&[
            "replay",
            session.to_str().unwrap(),
            "--out",
            again.to_str().unwrap()
        ]),
        0
    );
    let axis = |v: &serde_json::Value| -> Vec<f64> {
        v["needle"]["axis"]
            .as_array()
            .unwrap()
            .iter()
            .map(|x| x.as_f64().unwrap())
            .collect()
    };
    let replayed = json(&again.join("result.json"));
    let apart: f64 = axis(&result)
        .iter()
        .zip(axis(&replayed))
        .map(|(a, b)| (a - b).abs())
        .sum();
    assert!(apart < 1e-9, "live and from files: {apart}");

    // With --force another demo takes its place, but not once something else lies or was recorded there.
    let again = [
        "demo",
        "--profile",
        "tiny",
        "--seed",
        "5",
        "--force",
        "--out",
        to,
    ];
    let seed = || json(&out.join("errors.json"))["seed"].as_u64();
    assert_eq!((cannula(&again), seed()), (0, Some(5)));
    let mine = out.join("session/notes.txt");
    std::fs::write(&mine, "mine").unwrap();
    assert_eq!(cannula(&again), 1);
    std::fs::remove_file(&mine).unwrap();
    let to_session = session.to_str().unwrap();
    let config = dir.path().join("rig.toml");
    // The scene that stands there, not another.
    std::fs::write(&config, SMALL_RIG.replace("seed = 6", "seed = 5")).unwrap();
    let config = config.to_str().unwrap();
    let more = [
        "capture", "camera", "--config", config, "--poses", "1", "--out", to_session,
    ];
    assert_eq!(cannula(&more), 0);
    assert_eq!(cannula(&again), 1);
    assert_eq!(
        json(&session.join("truth.json"))["format"],
        "cannula-truth/1"
    );
}

/// --force never replaces a recording that no simulation wrote, nor results that lie beside it.
#[test]
fn a_simulation_replaces_only_simulations() {
    let _one = alone();
    let dir = tempfile::tempdir().unwrap();
    let session = dir.path().join("session");
    std::fs::create_dir_all(session.join("camera")).unwrap();
    std::fs::write(session.join("session.json"), "mine").unwrap();
    std::fs::write(session.join("camera/00.png"), "mine").unwrap();
    let (to, in_it) = (dir.path().to_str().unwrap(), session.to_str().unwrap());
    for words in [
        &["demo", "--profile", "tiny", "--out", to][..],
        &["simulate", "--profile", "tiny", "--session", in_it],
    ] {
        assert_eq!(cannula(words), 1);
        assert_eq!(cannula(&[words, &["--force"]].concat()), 1);
    }
    for file in ["session.json", "camera/00.png"] {
        assert_eq!(std::fs::read(session.join(file)).unwrap(), b"mine");
    }
    std::fs::remove_dir_all(&session).unwrap();
    let calibration = dir.path().join("calibration.json");
    std::fs::write(&calibration, "mine").unwrap();
    assert_eq!(
        cannula(&["demo", "--profile", "tiny", "--force", "--out", to]),
        1
    );
    assert_eq!(std::fs::read(&calibration).unwrap(), b"mine");
    assert!(!session.exists());

    // A simulated recording gives way to another.
    let simulate = ["simulate", "--profile", "tiny", "--session", in_it];
    assert_eq!(cannula(&simulate), 0);
    assert_eq!(cannula(&simulate), 1);
    let other = [&simulate[..], &["--seed", "7", "--force"]].concat();
    assert_eq!(cannula(&other), 0);
    assert_eq!(json(&session.join("truth.json"))["seed"], 7);
}

/// Recorded in parts, broken off and gone on with, calibrated, scanned live.
#[test]
fn a_recording_in_parts_leads_to_the_needle() {
    let _one = alone();
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let config = path("rig.toml");
    std::fs::write(&config, SMALL_RIG).unwrap();
    assert_eq!(cannula(&["config", &config]), 0);
    let rig = path("session");
    let capture = |what: &str, more: &[&str]| {
        let mut args = vec!["capture", "--config", &config, what, "--out", &rig];
        args.extend(more);
        cannula(&args)
    };
    assert_eq!(capture("camera", &["--poses", "12"]), 0);
    assert_eq!(capture("light", &["--poses", "2"]), 0);
    // Later, in another run of the program: it goes on to four, and once it has them adds none.
    assert_eq!(capture("light", &["--poses", "4"]), 0);
    assert_eq!(capture("light", &["--poses", "4"]), 0);
    assert_eq!(capture("camera", &["--poses", "12"]), 0);
    assert_eq!(capture("scan", &[]), 0);
    assert_eq!(capture("scan", &[]), 1, "a scan stands there");
    assert_eq!(capture("scan", &["--force"]), 0);
    let manifest = json(&dir.path().join("session/session.json"));
    assert_eq!(manifest["camera"].as_array().unwrap().len(), 12);
    let light = manifest["light"].as_array().unwrap();
    assert_eq!(light.len(), 4);
    // Four different poses, not one of them twice: their images without laser differ widely.
    let offs: Vec<Vec<u8>> = light
        .iter()
        .map(|pose| {
            let image = dir
                .path()
                .join("session")
                .join(pose["off"].as_str().unwrap());
            let raw = cannula::session::decode(&image).unwrap();
            raw.luma::<u8>().unwrap().pixels().to_vec()
        })
        .collect();
    for (i, a) in offs.iter().enumerate() {
        for b in &offs[..i] {
            let apart = a
                .iter()
                .zip(b)
                .filter(|(p, q)| p.abs_diff(**q) > 40)
                .count();
            assert!(apart * 50 > a.len(), "{apart} pixels differ");
        }
    }
    assert_eq!(manifest["scan"]["frames"].as_array().unwrap().len(), 31);
    assert_eq!(manifest["scan"]["ambient"], "scan_1/ambient.png");

    let calibration = path("calibration.json");
    assert_eq!(cannula(&["calibrate", &rig, "--out", &calibration]), 0);
    let live = path("live");
    assert_eq!(
        cannula(&[
            "scan",
            "--config",
            &config,
            "--out",
            &live,
            "--calibration",
            &calibration
        ]),
        0
    );
    let page = std::fs::read_to_string(dir.path().join("live/report.html")).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    let recorded = json(&dir.path().join("live/session/session.json"));
    let positions: Vec<f64> = recorded["scan"]["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["slide_mm"].as_f64().unwrap())
        .collect();
    assert!(positions.len() == 31 && positions.is_sorted());
    let scene = cannula::simulation::Scene::new(cannula::simulation::Profile::Tiny, 6);
    let truth = cannula::simulation::Truth::new(&scene).unwrap();
    let result = json(&dir.path().join("live/result.json"));
    // What it was measured with stands beside it.
    let provenance = &result["provenance"];
    assert_eq!(provenance["rig"]["board"]["port"], "simulated");
    assert_eq!(provenance["rig"]["light"]["spacing_mm"], 10.0);
    assert_eq!(provenance["rig"]["camera"]["trigger"], "board");
    assert_eq!(provenance["calibration"]["file"], calibration.as_str());
    assert_eq!(
        provenance["calibration"]["time"],
        json(Path::new(&calibration))["provenance"]["time"]
    );
    let entry: Vec<f64> = result["entry"]["point_mm"]
        .as_array()
        .unwrap()
        .iter()
        .map(|x| x.as_f64().unwrap())
        .collect();
    let off = truth
        .point
        .coords
        .iter()
        .zip(&entry)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt();
    assert!(off < 0.6, "{off} mm");
}

#[test]
fn hands_on_commands_and_their_exit_statuses() {
    let _one = alone();
    assert_eq!(cannula(&["motion", "--port", "simulated", "status"]), 0);
    assert_eq!(cannula(&["motion", "--port", "simulated", "home"]), 0);
    // Not homed: refused by the board.
    assert_eq!(cannula(&["motion", "--port", "simulated", "move", "10"]), 1);
    // The laser only when it is said.
    assert_eq!(cannula(&["motion", "--port", "simulated", "laser"]), 2);
    assert_eq!(cannula(&["motion", "--port", "/nowhere/tty", "status"]), 1);
    assert_eq!(cannula(&["motion", "--port", "simulated", "fly"]), 2);
    assert_eq!(cannula(&["config", "--example"]), 0);
    assert_eq!(cannula(&["config", "/nowhere/rig.toml"]), 1);
    assert_eq!(cannula(&["ports"]), 0);
    assert_eq!(cannula(&["simulate"]), 2);
}

/// The board behind a pseudo-terminal, and hands-on commands over it: a laser that is on only
/// while its command runs, positions that outlive each command.
#[cfg(unix)]
#[test]
fn commands_over_a_pseudo_terminal() {
    let _one = alone();
    use cannula::rig::{config::Rig, open};
    use cannula::simulation::mcu::{Pin, RealTime};
    let rig = Rig::default();
    let real = RealTime::start(open::simulated_board(&rig)).unwrap();
    let port = real.path().to_owned();
    let motion = |words: &[&str]| {
        let mut args = vec!["motion", "--port", &port];
        args.extend(words);
        cannula(&args)
    };
    assert_eq!(motion(&["status"]), 0);
    assert_eq!(motion(&["home"]), 0);
    assert_eq!(motion(&["move", "12.5"]), 0);
    assert_eq!(motion(&["jog", "-2.5"]), 0);
    assert_eq!(motion(&["move", "999"]), 1);
    // Where the slide truly is: 10 mm from zero, which lies at the clearance.
    let slide = real.board().board().rig().slide;
    assert_eq!(slide, 800 * 10 + 800 * 4);
    assert_eq!(motion(&["trigger"]), 0);
    assert_eq!(motion(&["laser", "--laser", "--seconds", "0.3"]), 0);
    let mut board = real.board().board();
    assert!(!board.level(Pin::Laser));
    assert!(board.trace().rises(Pin::Laser).count() >= 1);
}

/// `simulate` draws the board that the configuration asks for, or says that it can't.
#[test]
fn a_simulated_recording_shows_the_checkerboard_that_was_asked_for() {
    let _one = alone();
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let simulate = |columns: usize, rows: usize, folder: &str| {
        let config = path("rig.toml");
        let text = format!("[checkerboard]\ncolumns = {columns}\nrows = {rows}\n");
        std::fs::write(&config, text).unwrap();
        let session = path(folder);
        cannula(&[
            "simulate",
            "--profile",
            "tiny",
            "--session",
            &session,
            "--config",
            &config,
        ])
    };
    assert_eq!(simulate(9, 6, "wide"), 0);
    let shown = &json(&dir.path().join("wide/session.json"))["board"];
    assert_eq!((&shown["columns"], &shown["rows"]), (&9.into(), &6.into()));
    // As the detector sees it.
    assert_eq!(
        cannula(&["calibrate", &path("wide"), "--out", &path("c.json")]),
        0
    );
    assert_eq!(simulate(4, 3, "small"), 1);
    assert!(!dir.path().join("small").exists());
}
