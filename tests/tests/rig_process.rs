//! The program as a process of its own beside a board that lives on: Ctrl-C, a kill, a full disk.
//! The board (simulated, in real time, behind a pseudo-terminal) is looked at from outside.
#![cfg(unix)]

use cannula::rig::config::Rig;
use cannula::rig::link::Board;
use cannula::rig::lock::Lock;
use cannula::rig::open;
use cannula::simulation::mcu::{Pin, RealTime};
use cannula_shared::units::CYCLES_PER_MICRO;
use cannula_tests::program::{self, signal, start, wait, whole};
use cannula_tests::sweeps::SMALL_RIG;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// See [`program::become_it`].
#[test]
fn the_program() {
    program::become_it();
}

/// Ample on a loaded machine.
const LIMIT: Duration = Duration::from_secs(60);
/// From a signal to the laser's edge: a process that is scheduled, a round of the link.
const PROMPT_US: u64 = 150_000;
/// The lease of the laser is 100 ms, the host's silence is noticed after 200 ms (both of the
/// default configuration), each on a loaded machine.
const LEASE_US: u64 = 400_000;

/// One at a time: board and program run in real time, and the board's patience of 200 ms is soon over on cores
/// that others keep busy.
static ONE: Mutex<()> = Mutex::new(());

/// A board, a configuration for it, and a folder.
struct Bench {
    _one: MutexGuard<'static, ()>,
    real: RealTime,
    folder: tempfile::TempDir,
    config: PathBuf,
}

impl Bench {
    fn new() -> Self {
        let one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let real = RealTime::start(open::simulated_board(&Rig::default())).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("rig.toml");
        let text = format!(
            "[board]\nport = {:?}\nhoming_fast_mm_s = 40.0\n\
             [scan]\nstart_mm = 10.0\nspacing_mm = 1.0\ncount = 60\nspeed_mm_s = 10.0\n\
             [simulation]\nseed = 6\nprofile = \"tiny\"\n",
            real.path()
        );
        std::fs::write(&config, text).unwrap();
        Self {
            _one: one,
            real,
            folder,
            config,
        }
    }

    /// With the rig's configuration behind the command's words.
    fn start(&self, words: &[&str]) -> Child {
        start(&[words, &["--config", self.config.to_str().unwrap()]].concat())
    }

    fn run(&self, words: &[&str]) -> (Option<i32>, String) {
        wait(self.start(words), LIMIT)
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn rises(&self, pin: Pin) -> usize {
        self.real.board().board().trace().rises(pin).count()
    }

    fn now_us(&self) -> u64 {
        self.real.board().board().now().0 / CYCLES_PER_MICRO
    }

    /// Waits until the board has done it.
    fn until(&self, child: &mut Child, what: &str, mut done: impl FnMut() -> bool) {
        let began = Instant::now();
        while !done() {
            let ended = child.try_wait().unwrap();
            assert!(
                ended.is_none() && began.elapsed() < LIMIT,
                "{what}: {ended:?}"
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// The laser has gone off for good within `limit` of `since`, and the slide stands.
    fn safe(&self, since: u64, limit: u64) {
        std::thread::sleep(Duration::from_millis(100));
        let (off, slide) = {
            let mut board = self.real.board().board();
            assert!(!board.level(Pin::Laser));
            let off = board.trace().falls(Pin::Laser).last().unwrap_or(0);
            (off / CYCLES_PER_MICRO, board.rig().slide)
        };
        println!("laser off {} µs after", off as i64 - since as i64);
        assert!(off < since + limit, "{} µs", off - since);
        std::thread::sleep(Duration::from_millis(200));
        let mut board = self.real.board().board();
        assert!(!board.level(Pin::Laser));
        assert_eq!(board.rig().slide, slide, "the slide stands");
    }
}

/// A calibration of the committed recording, whose images are as large as the tiny scene's.
fn calibration(bench: &Bench) -> String {
    let path = bench.path("calibration.json");
    let session = cannula_tests::truth::committed("tiny-1001");
    let (status, said) = program::run(&["calibrate", session.to_str().unwrap(), "--out", &path]);
    assert_eq!(status, Some(0), "{said}");
    path
}

#[test]
fn ctrl_c_in_the_middle_of_a_scan() {
    let bench = Bench::new();
    let (out, calibration) = (bench.path("scan"), calibration(&bench));
    let mut child = bench.start(&["scan", "--out", &out, "--calibration", &calibration]);
    // Three are at rest: the clocks' anchor and the ambient image.
    bench.until(&mut child, "a scan under way", || {
        bench.rises(Pin::Trigger) >= 12
    });
    let since = bench.now_us();
    signal(&child, "INT");
    let (status, said) = wait(child, LIMIT);
    assert_eq!(status, Some(1), "{said}");
    assert!(said.contains("interrupted"), "{said}");
    bench.safe(since, PROMPT_US);
    let images = whole(&Path::new(&out).join("session"));
    assert!((3..60).contains(&images), "{images}");
    assert!(!Path::new(&out).join("result.json").exists());
    let status = Board::connect(bench.real.path()).unwrap().status().unwrap();
    assert!(
        status.position_known && !status.moving && !status.laser,
        "{status:?}"
    );

    // The same command again is not in its own way, and ends.
    let (status, said) = bench.run(&["scan", "--out", &out, "--calibration", &calibration]);
    // The calibration is of another scene's rig: an angle, or a sentence why there is none.
    assert!(status == Some(0) || said.contains("session.json"), "{said}");
    let session = cannula::session::Session::open(&Path::new(&out).join("session")).unwrap();
    assert_eq!(session.manifest.scan.unwrap().frames.len(), 60);
}

#[test]
fn a_killed_program_leaves_the_laser_off_and_what_was_recorded() {
    let bench = Bench::new();
    let out = bench.path("session");
    let (status, said) = bench.run(&["capture", "camera", "--poses", "2", "--out", &out]);
    assert_eq!(status, Some(0), "{said}");
    let mut child = bench.start(&["capture", "scan", "--out", &out]);
    let before = bench.rises(Pin::Trigger);
    bench.until(&mut child, "a scan under way", || {
        bench.rises(Pin::Trigger) >= before + 12
    });
    let since = bench.now_us();
    signal(&child, "KILL");
    assert_eq!(wait(child, LIMIT).0, None);
    std::thread::sleep(Duration::from_micros(LEASE_US));
    bench.safe(since, LEASE_US);
    // What had been recorded stands, and the recording goes on.
    let session = cannula::session::Session::open(Path::new(&out)).unwrap();
    assert_eq!(session.manifest.camera.len(), 2);
    assert!(session.manifest.scan.is_none());
    let rearmed = bench.run(&["motion", "rearm"]);
    assert_eq!(rearmed.0, Some(0), "{}", rearmed.1);
    let stood: Vec<PathBuf> = images(&Path::new(&out).join("scan"));
    let written: Vec<_> = stood
        .iter()
        .map(|p| std::fs::metadata(p).unwrap().modified().unwrap())
        .collect();
    assert!(stood.len() >= 4, "the ambient one and some: {stood:?}");
    let fired = bench.rises(Pin::Trigger);

    // With other settings it does not go on.
    let other = bench.path("other.toml");
    let text = std::fs::read_to_string(&bench.config).unwrap();
    std::fs::write(&other, text.replace("spacing_mm = 1.0", "spacing_mm = 1.5")).unwrap();
    let (status, said) = wait(
        start(&["capture", "scan", "--out", &out, "--config", &other]),
        LIMIT,
    );
    assert_eq!(status, Some(1), "{said}");
    assert!(
        said.contains("scan.spacing_mm = 1.0, now it is 1.5") && said.contains("--force"),
        "{said}"
    );

    // With the same ones only what is missing is visited.
    let (status, said) = bench.run(&["capture", "scan", "--out", &out]);
    assert_eq!(status, Some(0), "{said}");
    assert!(said.contains("frames stood from before"), "{said}");
    let visited = bench.rises(Pin::Trigger) - fired;
    assert!(
        visited <= 60 - (stood.len() - 1) + 6,
        "{visited} with the clocks' anchors"
    );
    let session = cannula::session::Session::open(Path::new(&out)).unwrap();
    let manifest = &session.manifest;
    let frames = &manifest.scan.as_ref().unwrap().frames;
    let steps: Vec<i64> = frames.iter().filter_map(|f| f.slide_steps).collect();
    assert_eq!(steps.len(), 60);
    for (steps, k) in steps.iter().zip(0..) {
        // In the order of travel. At 10 mm/s the middle of an exposure of 5 ms lies 20 steps after its trigger, at rest none.
        let moved = steps - 800 * (10 + k);
        assert!(moved == 20 || moved == 0, "{k}: {moved}");
    }
    assert_eq!(manifest.camera.len(), 2);
    // Nothing lies about that session.json does not name, and what stood was not written again.
    let mut named: Vec<PathBuf> = frames.iter().map(|f| session.path(&f.image)).collect();
    named.push(session.path(manifest.scan.as_ref().unwrap().ambient.as_ref().unwrap()));
    named.sort();
    assert_eq!(images(&Path::new(&out).join("scan")), named);
    let again: Vec<_> = stood
        .iter()
        .map(|p| std::fs::metadata(p).unwrap().modified().unwrap())
        .collect();
    assert_eq!(again, written);
}

/// A pose of the light planes that was killed in the middle is taken anew, in its own folder.
#[test]
fn a_light_pose_that_was_broken_off_leaves_nothing_behind() {
    let bench = Bench::new();
    let out = bench.path("session");
    let mut child = bench.start(&["capture", "light", "--poses", "2", "--out", &out]);
    let second = Path::new(&out).join("light/01/on_02.png");
    bench.until(&mut child, "the second pose", || second.exists());
    signal(&child, "KILL");
    assert_eq!(wait(child, LIMIT).0, None);
    std::thread::sleep(Duration::from_micros(LEASE_US));
    let rearmed = bench.run(&["motion", "rearm"]);
    assert_eq!(rearmed.0, Some(0), "{}", rearmed.1);
    let (status, said) = bench.run(&["capture", "light", "--poses", "2", "--out", &out]);
    assert_eq!(status, Some(0), "{said}");
    let session = cannula::session::Session::open(Path::new(&out)).unwrap();
    let light = &session.manifest.light;
    let offs: Vec<&str> = light.iter().filter_map(|p| p.off.as_deref()).collect();
    assert_eq!(offs, ["light/00/off.png", "light/01/off.png"]);
    assert!(light.iter().all(|p| p.on.len() == 13));
    assert_eq!(whole(Path::new(&out)), 28);
    for (pose, folder) in light.iter().zip(["light/00", "light/01"]) {
        assert_eq!(
            images(&Path::new(&out).join(folder)).len(),
            pose.on.len() + 1
        );
    }
}

/// What lies in a folder, by name, but for the file of a sweep under way.
fn images(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    let mut all: Vec<PathBuf> = entries.filter(|p| !p.ends_with("progress.jsonl")).collect();
    all.sort();
    all
}

#[test]
fn ctrl_c_stops_what_moves_and_what_shines() {
    let bench = Bench::new();
    // Homing: 21 mm to go at 40 mm/s.
    let mut child = bench.start(&["motion", "home"]);
    let begun = bench.real.board().board().rig().slide;
    bench.until(&mut child, "homing", || {
        bench.real.board().board().rig().slide < begun - 800
    });
    signal(&child, "INT");
    let (status, said) = wait(child, LIMIT);
    assert_eq!(status, Some(1), "{said}");
    assert!(said.contains("stopped"), "{said}");
    let slide = bench.real.board().board().rig().slide;
    assert!(slide > 800, "stopped on the way: {slide} steps from home");
    bench.safe(bench.now_us(), 0);

    let (status, said) = bench.run(&["motion", "home"]);
    assert_eq!(status, Some(0), "{said}");
    let mut child = bench.start(&["motion", "laser", "--laser"]);
    bench.until(&mut child, "the laser", || {
        bench.real.board().board().level(Pin::Laser)
    });
    let since = bench.now_us();
    signal(&child, "TERM");
    let (status, said) = wait(child, LIMIT);
    assert_eq!(status, Some(0), "{said}");
    bench.safe(since, PROMPT_US);
}

/// A file system of its own, of so many kilobytes; `None` where it can't be mounted.
struct Disk(PathBuf);

impl Disk {
    fn mount(at: &Path, kilobytes: u32) -> Option<Self> {
        std::fs::create_dir_all(at).unwrap();
        let size = format!("size={kilobytes}k");
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "tmpfs"])
            .arg(at)
            .output()
            .is_ok_and(|o| o.status.success());
        if !mounted {
            println!("skipped:no-mount");
        }
        mounted.then(|| Self(at.to_owned()))
    }

    fn grow(&self, kilobytes: u32) {
        let grown = Command::new("mount")
            .args(["-o", &format!("remount,size={kilobytes}k")])
            .arg(&self.0)
            .status();
        assert!(grown.is_ok_and(|s| s.success()));
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_stops_the_scan_with_the_laser_off_and_files_whole() {
    let bench = Bench::new();
    let out = bench.path("disk");
    // An image of the tiny scene takes some 50 kB: two poses, and a part of the scan.
    let Some(disk) = Disk::mount(Path::new(&out), 600) else {
        return;
    };
    let (status, said) = bench.run(&["capture", "camera", "--poses", "2", "--out", &out]);
    assert_eq!(status, Some(0), "{said}");
    let ended = bench.run(&["capture", "scan", "--out", &out]);
    broken_off(&bench, &out, &ended, "No space left on device");
    // With room again it goes on where it was broken off.
    disk.grow(60_000);
    goes_on(&bench, &out);
}

/// A scan ended by what the disk said: in one sentence, with the laser off and the slide at rest, what
/// stands whole and named.
fn broken_off(bench: &Bench, out: &str, (status, said): &(Option<i32>, String), cause: &str) {
    let full_at = bench.now_us();
    assert_eq!(*status, Some(1), "{said}");
    let image = format!("{out}/scan/");
    assert!(said.contains(&image) && said.contains(cause), "{said}");
    assert_eq!(
        said.trim().lines().count(),
        2,
        "one sentence, after the camera's name: {said}"
    );
    bench.safe(full_at, 0);
    let images = whole(Path::new(out));
    assert!((3..62).contains(&images), "{images}");
    let session = cannula::session::Session::open(Path::new(out)).unwrap();
    assert_eq!(session.manifest.camera.len(), 2);
    assert!(session.manifest.scan.is_none());
}

fn goes_on(bench: &Bench, out: &str) {
    let (status, said) = bench.run(&["capture", "scan", "--out", out]);
    assert_eq!(status, Some(0), "{said}");
    let session = cannula::session::Session::open(Path::new(out)).unwrap();
    assert_eq!(session.manifest.scan.as_ref().unwrap().frames.len(), 60);
    assert_eq!(session.manifest.camera.len(), 2);
    whole(Path::new(out));
}

/// The same where no disk can be made: a file can't be written to its end, as on a full one.
#[test]
fn a_file_that_can_not_be_written_stops_the_scan_with_the_laser_off_and_files_whole() {
    let bench = Bench::new();
    let out = bench.path("session");
    let (status, said) = bench.run(&["capture", "camera", "--poses", "2", "--out", &out]);
    assert_eq!(status, Some(0), "{said}");
    // How large the images of this scan are: the noise is the scene's own, the same each time.
    let trial = bench.path("trial");
    let (status, said) = bench.run(&["capture", "scan", "--out", &trial]);
    assert_eq!(status, Some(0), "{said}");
    let sizes: Vec<u64> = images(&Path::new(&trial).join("scan"))
        .iter()
        .map(|p| std::fs::metadata(p).unwrap().len())
        .collect();
    // All fit but the largest, one of the frames: the image without laser comes last by its name.
    let most = *sizes.iter().max().unwrap();
    let at = sizes.iter().position(|s| *s == most).unwrap();
    println!("frame {at} has {most} bytes");
    assert!((4..60).contains(&at), "{sizes:?}");
    let config = bench.config.to_str().unwrap();
    let words = ["capture", "scan", "--out", &out, "--config", config];
    let Some(limited) = program::start_limited(&words, most - 1) else {
        return;
    };
    let ended = wait(limited, LIMIT);
    broken_off(&bench, &out, &ended, "File too large");
    let scan = Path::new(&out).join("scan");
    assert!(
        ended.1.contains(&format!("scan/{at:03}.png")),
        "{}",
        ended.1
    );
    assert!(images(&scan).len() >= at, "those before it stand");
    goes_on(&bench, &out);
}

/// A recording on the rig that is all simulated, and what the program says when it is given words.
struct Small {
    folder: tempfile::TempDir,
}

impl Small {
    fn capture(&self, rig: &str, words: &[&str]) -> (Option<i32>, String) {
        wait(self.start(rig, words), LIMIT)
    }

    fn start(&self, rig: &str, words: &[&str]) -> Child {
        let path = |name: &str| self.folder.path().join(name).to_str().unwrap().to_owned();
        let (config, session) = (path("rig.toml"), path("session"));
        std::fs::write(&config, rig).unwrap();
        let before = ["capture", "--config", &config, words[0], "--out", &session];
        start(&[&before, &words[1..]].concat())
    }

    fn manifest(&self) -> serde_json::Value {
        let text = std::fs::read(self.folder.path().join("session/session.json")).unwrap();
        serde_json::from_slice(&text).unwrap()
    }
}

/// Poses of one rig and poses of another give one calibration that is right for neither.
#[test]
fn another_rig_does_not_go_on_with_a_recording() {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let small = Small {
        folder: tempfile::tempdir().unwrap(),
    };
    let rig = |from: &str, to: &str| {
        assert!(SMALL_RIG.contains(from));
        SMALL_RIG.replace(from, to)
    };
    let camera = |rig: &str, more: &[&str]| {
        small.capture(rig, &[&["camera", "--poses", "2"], more].concat())
    };
    let light = |rig: &str| small.capture(rig, &["light", "--poses", "2"]);
    assert_eq!(camera(SMALL_RIG, &[]).0, Some(0));
    let before = small.manifest();
    let exposure = rig("[light]", "[camera]\nexposure_board_ms = 4.0\n[light]");
    let gain = rig("[light]", "[camera]\ngain_db = 3.0\n[light]");
    let seed = rig("seed = 6", "seed = 7");
    for (rig, key) in [
        (&exposure, "camera.exposure_board_ms = 10.0, now it is 4.0"),
        (&gain, "camera.gain_db = 0.0, now it is 3.0"),
        (&seed, "simulation.seed = 6, now it is 7"),
    ] {
        let (status, said) = small.capture(rig, &["camera", "--poses", "3"]);
        assert_eq!(status, Some(1), "{said}");
        assert!(said.contains(key) && said.contains("--force"), "{said}");
        assert_eq!(small.manifest(), before);
    }
    // The light planes may be looked at with another exposure, but not in another scene.
    let (status, said) = light(&seed);
    assert_eq!(status, Some(1), "{said}");
    let named = "\"camera\" was recorded with simulation.seed = 6";
    assert!(said.contains(named) && !said.contains("--force"), "{said}");
    let (status, said) = light(&exposure);
    assert_eq!(status, Some(0), "{said}");
    let (status, said) = light(&rig("spacing_mm = 10.0", "spacing_mm = 9.0"));
    assert_eq!(status, Some(1), "{said}");
    assert!(
        said.contains("light.spacing_mm = 10.0, now it is 9.0"),
        "{said}"
    );
    // Recorded anew, the camera's part may have its exposure.
    let (status, said) = camera(&exposure, &["--force"]);
    assert_eq!(status, Some(0), "{said}");
    // A recording of before settings were recorded goes on.
    let mut old = small.manifest();
    old["recorded"].as_object_mut().unwrap().remove("settings");
    let file = small.folder.path().join("session/session.json");
    std::fs::write(&file, old.to_string()).unwrap();
    let (status, said) = small.capture(&gain, &["camera", "--poses", "3"]);
    assert_eq!(status, Some(0), "{said}");
    assert_eq!(small.manifest()["camera"].as_array().unwrap().len(), 3);
}

/// The second of two that record into one folder is refused; one that was killed holds nothing.
#[test]
fn one_process_at_a_time_records_into_a_folder() {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let small = Small {
        folder: tempfile::tempdir().unwrap(),
    };
    let slow = ["camera", "--poses", "9", "--every", "30"];
    let mut first = small.start(SMALL_RIG, &slow);
    let began = Instant::now();
    // It holds the folder before it does anything else.
    while !small.folder.path().join("session/.lock").exists() {
        assert!(began.elapsed() < LIMIT && first.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(200));
    for words in [
        &["camera", "--poses", "1"][..],
        &["light", "--poses", "1"],
        &["scan"],
    ] {
        let (status, said) = small.capture(SMALL_RIG, words);
        assert_eq!(status, Some(1), "{words:?}: {said}");
        assert!(said.contains("another cannula process"), "{said}");
    }
    signal(&first, "KILL");
    let _ = first.wait();
    let (status, said) = small.capture(SMALL_RIG, &["camera", "--poses", "1"]);
    assert_eq!(status, Some(0), "{said}");
}

/// Whatever writes a recording keeps others out of its folder, and lets a refused one be as it was.
#[test]
fn every_command_that_records_takes_the_lock() {
    let bench = Bench::new();
    let calibration = calibration(&bench);
    let out = bench.path("job");
    let session = Path::new(&out).join("session");
    let recording = session.to_str().unwrap();
    let held = Lock::take(&session).unwrap();
    let fired = bench.rises(Pin::Trigger);
    let demo = ["demo", "--out", &out, "--profile", "tiny"];
    let simulate = ["simulate", "--session", recording, "--profile", "tiny"];
    let scan = ["scan", "--out", &out, "--calibration", &calibration];
    for words in [&demo[..], &[&demo[..], &["--force"]].concat(), &simulate] {
        let (status, said) = program::run(words);
        assert_eq!(status, Some(1), "{words:?}: {said}");
        assert!(said.contains("another cannula process"), "{said}");
    }
    let (status, said) = bench.run(&scan);
    assert_eq!(status, Some(1), "{said}");
    assert!(said.contains("another cannula process"), "{said}");
    assert_eq!(bench.rises(Pin::Trigger), fired);
    assert_eq!(std::fs::read_dir(&session).unwrap().count(), 1, "the lock");
    drop(held);
    // Its remains are in nobody's way, and what is replaced stays locked meanwhile.
    for force in [&[][..], &["--force"]] {
        let (status, said) = program::run(&[&simulate[..], force].concat());
        assert_eq!(status, Some(0), "{said}");
        assert!(session.join(".lock").exists());
        whole_simulation(&session);
    }
}

fn whole_simulation(session: &Path) {
    let session = cannula::session::Session::open(session).unwrap();
    for frame in &session.manifest.scan.as_ref().unwrap().frames {
        assert!(session.path(&frame.image).exists());
    }
}

/// All frames would have been taken, and then refused.
#[test]
fn an_entry_that_can_not_be_is_refused_before_anything_moves() {
    let bench = Bench::new();
    let calibration = calibration(&bench);
    let (out, file) = (bench.path("job"), bench.path("entry.json"));
    for (entry, words) in [
        (
            r#"{"pixel":[160,120],"vein":[],"radius_mm":12}"#,
            "entry.vein",
        ),
        (
            r#"{"pixel":[160,120],"vein":[[150,130],[170,100]],"radius_mm":-1}"#,
            "radius_mm",
        ),
        (
            r#"{"pixel":[160,120],"vein":[[150,130],[150,130]],"radius_mm":12}"#,
            "entry.vein",
        ),
        (
            r#"{"pixel":[1600,120],"vein":[[150,130],[170,100]],"radius_mm":12}"#,
            "entry.pixel",
        ),
    ] {
        std::fs::write(&file, entry).unwrap();
        let words_of_it = ["--calibration", &calibration, "--entry", &file];
        let (status, said) = bench.run(&[&["scan", "--out", &out], &words_of_it[..]].concat());
        assert_eq!(status, Some(1), "{said}");
        assert!(said.contains(&file) && said.contains(words), "{said}");
        let session = Path::new(&out).join("session");
        assert!(!session.join("scan").exists() && !session.join("session.json").exists());
    }
    assert_eq!((bench.rises(Pin::Step), bench.rises(Pin::Trigger)), (0, 0));
}

/// What a simulated board at a pseudo-terminal, which no system lists, says of itself.
#[test]
fn a_port_that_is_not_listed_can_be_asked() {
    let bench = Bench::new();
    let port = bench.real.path();
    let ended = program::wait_output(start(&["ports", "--port", port, "--json"]), LIMIT);
    assert_eq!(ended.status, Some(0), "{}", ended.said);
    let from = ended.out.find("{\n").or(ended.out.find('{')).unwrap();
    let text = &ended.out[from..];
    let object = serde_json::Deserializer::from_str(text)
        .into_iter::<serde_json::Value>()
        .next()
        .unwrap()
        .unwrap();
    let found = object["ports"].as_array().unwrap();
    assert_eq!(found.len(), 1);
    assert_eq!(found[0]["path"], port);
    assert_eq!(found[0]["board"], true);
    assert!(found[0]["firmware"].is_string());
    let (status, said) = program::run(&["ports", "--port", "/dev/no-such-port"]);
    assert_eq!(status, Some(1), "{said}");
    assert!(
        said.contains("/dev/no-such-port: cannot open the port"),
        "{said}"
    );
}

#[test]
fn words_without_effect_are_refused_and_a_given_entry_is_kept() {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let small = Small {
        folder: tempfile::tempdir().unwrap(),
    };
    for words in [
        &["scan", "--radius", "9"][..],
        &["camera", "--poses", "1", "--every", "nan"],
        &["camera", "--poses", "1", "--every", "-1"],
        &["light", "--every", "1"],
    ] {
        let (status, said) = small.capture(SMALL_RIG, words);
        assert_eq!(status, Some(2), "{words:?}: {said}");
    }
    let entry = [
        "--entry",
        "160.5,120",
        "--vein",
        "158,130",
        "163,105",
        "--radius",
        "9",
    ];
    let (status, said) = small.capture(SMALL_RIG, &[&["scan"], &entry[..]].concat());
    assert_eq!(status, Some(0), "{said}");
    let given = small.manifest()["entry"].clone();
    assert_eq!(given["radius_mm"], 9.0);
    let (status, said) = small.capture(SMALL_RIG, &["scan", "--force"]);
    assert_eq!(status, Some(0), "{said}");
    assert_eq!(small.manifest()["entry"], given);
}
