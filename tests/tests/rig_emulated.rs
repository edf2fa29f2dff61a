//! The commands of the program against the board's own binary: the shipped ELF in the emulator,
//! behind a pseudo-terminal, and what its pins did while each command ran.
//!
//! Skipped with a word where node, the emulator or the ELF is missing (see tests/tests/emulator).
#![cfg(unix)]

#[allow(dead_code, reason = "shared with the emulator's own tests")]
#[path = "emulator/edges.rs"]
mod edges;
#[allow(dead_code, reason = "shared with the emulator's own tests")]
#[path = "emulator/emulator.rs"]
mod emulator;

use cannula::rig::link::Pipe;
use cannula::simulation::mcu::Terminal;
use cannula_shared::units::Micros;
use cannula_tests::program;
use edges::{Edges, pin};
use emulator::{Emulator, Shared};
use serde_json::Value;
use std::cell::Cell;
use std::path::Path;
use std::time::Duration;

/// See [`program::become_it`].
#[test]
fn the_program() {
    program::become_it();
}

/// The emulated board may run slower than real time, and the machine may be loaded.
const LIMIT: Duration = Duration::from_secs(150);
/// The slide stands so far from its home switch, steps.
const FROM_HOME: i64 = 800;
/// Steps per mm, and where zero lies beyond the switch, mm.
const PER_MM: i64 = 800;
/// Exposure with the laser, µs. In half of it the slide goes 16 steps on, at 10 mm/s.
const EXPOSURE: u64 = 4000;
const MIDDLE: i64 = 16;

struct Bench {
    emulator: Shared,
    terminal: Terminal,
    folder: tempfile::TempDir,
    /// What DIR was left at.
    away: Cell<bool>,
}

/// What a command did.
struct Ran {
    status: Option<i32>,
    /// Its result object.
    object: Value,
    /// What it said on standard error.
    said: String,
    /// What the pins did.
    edges: Edges,
    /// Steps away from home, by the STEP and DIR pins.
    moved: i64,
    /// DIR when it began.
    away: bool,
}

impl Bench {
    fn start() -> Option<Self> {
        let found = emulator::find()?;
        let mut emulator = Emulator::start(&found).expect("node starts");
        emulator
            .command(&format!("slide {FROM_HOME} {}", 305 * PER_MM))
            .expect("a slide");
        let emulator = Shared::new(emulator);
        let mut usb = emulator.pipe();
        let start = usb.now().0;
        let terminal = Terminal::serve(move |bytes, elapsed| {
            if !bytes.is_empty() {
                usb.write(bytes).expect("the emulator runs");
            }
            let mut out = Vec::new();
            let mut buffer = [0; 1024];
            // At most in real time.
            let due = start + elapsed.0;
            while usb.now().0 < due {
                let wait = Micros((due - usb.now().0).min(1000));
                let read = usb.read(&mut buffer, wait).expect("the emulator runs");
                out.extend_from_slice(&buffer[..read]);
            }
            out
        })
        .expect("a pseudo-terminal");
        let folder = tempfile::tempdir().expect("a folder");
        let text = format!(
            "[board]\nport = {:?}\ntravel_mm = 300.0\nhoming_fast_mm_s = 20.0\nhoming_slow_mm_s = 5.0\n\
             clearance_mm = 1.0\nsettle_ms = 5.0\n\
             [camera]\nexposure_laser_ms = {}\n\
             [scan]\nstart_mm = 2.0\nspacing_mm = 0.5\ncount = 12\nspeed_mm_s = 10.0\n\
             [simulation]\nseed = 6\nprofile = \"tiny\"\n",
            terminal.path(),
            EXPOSURE as f64 / 1000.0
        );
        std::fs::write(folder.path().join("rig.toml"), text).expect("a file");
        Some(Self {
            emulator,
            terminal,
            folder,
            away: Cell::new(false),
        })
    }

    /// Runs a command.
    fn run(&self, words: &[&str]) -> Ran {
        self.emulator.get().command("mark").expect("a command");
        let config = self.folder.path().join("rig.toml");
        let more = ["--config", config.to_str().expect("a name"), "--json"];
        let child = program::start(&[words, &more].concat());
        let ended = program::wait_output(child, LIMIT);
        let edges = self.emulator.get().edges().expect("edges");
        // The test harness prints its own lines around the object.
        let object = ended.out.find('{').zip(ended.out.rfind('}'));
        let object = object.map_or(Value::Null, |(from, to)| {
            serde_json::from_str(&ended.out[from..=to]).expect("JSON")
        });
        let away = self.away.get();
        self.away
            .set(edges.level(pin::DIR, u64::MAX).unwrap_or(away));
        Ran {
            status: ended.status,
            object,
            said: ended.said,
            moved: edges.positions(0, away).last().map_or(0, |p| p.1),
            edges,
            away,
        }
    }
}

#[test]
fn the_commands_drive_the_real_binary() {
    let Some(bench) = Bench::start() else {
        return;
    };
    println!("port {}", bench.terminal.path());
    let ran = bench.run(&["motion", "status"]);
    assert_eq!((ran.status, ran.moved), (Some(0), 0), "{}", ran.said);
    assert_eq!(ran.object["position_known"], false);
    assert_eq!(ran.object["laser"], false);

    // Not homed: refused, and nothing moves.
    let ran = bench.run(&["motion", "move", "3"]);
    assert_eq!((ran.status, ran.moved), (Some(1), 0), "{}", ran.said);

    let ran = bench.run(&["motion", "home"]);
    assert_eq!(ran.status, Some(0), "{}", ran.said);
    assert_eq!(ran.object["position_steps"], 0);
    // Zero lies the clearance beyond the switch's edge.
    let home = FROM_HOME + ran.moved;
    assert!(
        (PER_MM..=PER_MM + 2).contains(&home),
        "{home} steps from the switch"
    );
    assert!(ran.edges.rising(pin::LASER).is_empty());

    for (words, position, moved) in [
        (&["motion", "move", "12.5"][..], 10_000, 10_000),
        (&["motion", "jog", "-2.5", "--speed", "20"], 8_000, -2_000),
    ] {
        let ran = bench.run(words);
        assert_eq!((ran.status, ran.moved), (Some(0), moved), "{}", ran.said);
        assert_eq!(ran.object["position_steps"], position);
    }
    let ran = bench.run(&["motion", "move", "999"]);
    assert_eq!((ran.status, ran.moved), (Some(1), 0), "{}", ran.said);

    // The laser: not without the word, and no longer than the command.
    let ran = bench.run(&["motion", "laser"]);
    assert_eq!(ran.status, Some(2), "{}", ran.said);
    assert!(ran.edges.rising(pin::LASER).is_empty());
    let ran = bench.run(&["motion", "laser", "--laser", "--seconds", "0.2"]);
    assert_eq!(ran.status, Some(0), "{}", ran.said);
    assert_eq!(ran.object["laser"], false);
    assert_eq!(ran.edges.rising(pin::LASER).len(), 1);
    assert_eq!(
        ran.edges.falling(pin::LASER).len(),
        1,
        "off when the command has ended"
    );

    let ran = bench.run(&["motion", "trigger"]);
    assert_eq!(ran.status, Some(0), "{}", ran.said);
    assert_eq!(ran.edges.rising(pin::TRIGGER).len(), 1);
    let ran = bench.run(&["motion", "config"]);
    assert_eq!(ran.status, Some(0), "{}", ran.said);

    // A scan with the simulated camera.
    let out = bench.folder.path().join("session");
    let ran = bench.run(&["capture", "scan", "--out", out.to_str().expect("a name")]);
    assert_eq!(ran.status, Some(0), "{}", ran.said);
    let object = &ran.object;
    assert_eq!(
        (&object["frames"], &object["planned"]),
        (&12.into(), &12.into())
    );
    assert_eq!(object["faults"], serde_json::json!([]));
    let session = cannula::session::Session::open(Path::new(&out)).expect("a recording");
    let frames = session.manifest.scan.expect("a scan").frames;
    let planned: Vec<Option<i64>> = (0..12).map(|k| Some(1_600 + 400 * k)).collect();
    // Recorded is where the sheet stood in the middle of the exposure.
    let noted: Vec<Option<i64>> = frames.iter().map(|f| f.slide_steps).collect();
    let middle: Vec<Option<i64>> = planned.iter().map(|p| p.map(|p| p + MIDDLE)).collect();
    assert_eq!(noted, middle);
    // Some at rest (for the clocks, the ambient image), then the sweep: pin, ledger and recording
    // agree on where and when each of its triggers fired.
    let fired = ran.edges.rising(pin::TRIGGER);
    assert!(fired.len() >= 12 + 3, "{}", fired.len());
    let sweep = &fired[fired.len() - 12..];
    let positions = ran.edges.positions(8_000, ran.away);
    let at = |cycle: u64| {
        let passed = positions.partition_point(|p| p.0 <= cycle);
        passed.checked_sub(1).map(|i| positions[i].1)
    };
    let truly: Vec<Option<i64>> = sweep.iter().map(|&cycle| at(cycle)).collect();
    assert_eq!(truly, planned);
    for (&cycle, noted) in sweep.iter().zip(&noted) {
        let stood = at(cycle + EXPOSURE / 2 * emulator::PER_MICRO).zip(*noted);
        assert!(
            stood.is_some_and(|(stood, noted)| (stood - noted).abs() <= 1),
            "{stood:?}"
        );
    }
    for (frame, &cycle) in frames.iter().zip(sweep) {
        let time = frame.trigger_us.expect("a time") as i64;
        let late = time - (cycle / emulator::PER_MICRO) as i64;
        assert!((-1..=20).contains(&late), "noted {late} µs after the edge");
    }
    let lit = |cycle: u64| ran.edges.level(pin::LASER, cycle);
    assert!(sweep.iter().all(|&cycle| lit(cycle) == Some(true)));
    assert_eq!(lit(u64::MAX), Some(false));
}
