//! Recordings that are wrong: an error or a gate that names what is wrong, never a panic, never a
//! confident wrong answer.

use cannula::image::Image;
use cannula::needle;
use cannula::output::{CalibrationFile, all_checks};
use cannula::pipeline::{Measurement, Method, PipelineError, Times, calibrate, measure};
use cannula::progress::Silent;
use cannula::session::{self, CameraView, Manifest, Session, SessionError};
use cannula_tests::truth::{committed, manifest};
use std::path::{Path, PathBuf};

/// The small recording with its images named by their full paths, to be spoiled.
fn recording() -> Manifest {
    manifest("tiny-1001")
}

/// Writes it as it is, without the checks of `session::write`, and processes it.
fn process(m: &Manifest) -> Result<Measurement, String> {
    let folder = tempfile::tempdir().unwrap();
    let text = serde_json::to_vec(m).unwrap();
    std::fs::write(folder.path().join("session.json"), text).unwrap();
    process_folder(folder.path())
}

fn process_folder(folder: &Path) -> Result<Measurement, String> {
    let said = |e: PipelineError| e.to_string();
    let session = Session::open(folder).map_err(|e| e.to_string())?;
    let times = Times::default();
    let calibrated = calibrate(&session, Method::Ml, &times, &Silent).map_err(said)?;
    let rig = calibrated.rig().ok_or("no light planes")?;
    let settings = needle::Settings::default();
    measure(&session, &rig, &[], Method::Ml, &settings, &times, &Silent).map_err(said)
}

/// The one sentence with which a recording is refused; it must hold one of the words.
#[track_caller]
fn refused(m: &Manifest, words: &[&str]) -> String {
    match process(m) {
        Ok(_) => panic!("accepted; should have been refused for {words:?}"),
        Err(said) => {
            println!("{said}");
            assert!(
                words.iter().any(|w| said.contains(w)),
                "{words:?} not in: {said}"
            );
            assert!(!said.contains('\n'), "one sentence: {said}");
            said
        }
    }
}

fn flat(value: u8) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("flat_{value}.png"));
    session::write_png(&path, &Image::new(320, 240, value)).unwrap();
    let name = path.display().to_string();
    (folder, name)
}

#[test]
fn the_recording_itself_is_good() {
    process(&recording()).unwrap();
}

/// 200 000 mutations of session.json: bytes changed, put in, taken out, cut off.
#[test]
fn a_fuzzed_session_never_panics() {
    let folder = committed("tiny-1001");
    let good = std::fs::read(folder.join("session.json")).unwrap();
    let path = folder.join("session.json");
    let mut state = 0x1234_5678_9abc_def0u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let pool = br#"0123456789.-+eE,:;[]{}"truefalsn \u"#;
    let (mut accepted, mut refusals, mut passed) = (0, 0, Vec::new());
    for i in 0..200_000 {
        let mut text = good.clone();
        for _ in 0..1 + random(3) {
            let at = random(text.len());
            match random(5) {
                0 => text[at] = random(256) as u8,
                1 | 2 => text[at] = pool[random(pool.len())],
                3 => text.insert(at, pool[random(pool.len())]),
                _ => {
                    text.remove(at);
                }
            }
        }
        if random(50) == 0 {
            text.truncate(random(text.len()));
        }
        match session::parse(&text, &path) {
            Ok(_) => {
                accepted += 1;
                if i % 400 == 0 {
                    passed.push(text);
                }
            }
            Err(e) => {
                refusals += 1;
                let said = e.to_string();
                assert!(
                    said.contains("session.json") && !said.contains('\n'),
                    "{said}"
                );
            }
        }
    }
    println!("{accepted} accepted, {refusals} refused");
    assert!(refusals > 50_000 && accepted > 1_000);
    // Some of those that pass go the whole way: a result or a sentence.
    for text in passed.iter().take(40) {
        let manifest = session::parse(text, &path).unwrap();
        let folder_of = |name: &str| committed("tiny-1001").join(name).exists();
        let missing = manifest.images().any(|name| !folder_of(name));
        let here = tempfile::tempdir().unwrap();
        std::fs::write(here.path().join("session.json"), text).unwrap();
        for part in ["camera", "light", "scan"] {
            link(&folder.join(part), &here.path().join(part));
        }
        let outcome = process_folder(here.path());
        assert!(!missing || outcome.is_err(), "an image that is not there");
    }
}

fn link(from: &Path, to: &Path) {
    if from.is_dir() {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            link(&entry.path(), &to.join(entry.file_name()));
        }
    } else if std::fs::hard_link(from, to).is_err() {
        std::fs::copy(from, to).unwrap();
    }
}

#[test]
fn truncated_images_are_named() {
    let m = recording();
    let names = [
        &m.camera[3].image,
        &m.light[1].on[2].image,
        &m.scan.as_ref().unwrap().frames[9].image,
    ];
    for (i, name) in names.into_iter().enumerate() {
        let whole = std::fs::read(name).unwrap();
        for part in [0.0, 0.01, 0.5, 0.99] {
            let folder = tempfile::tempdir().unwrap();
            let cut = folder.path().join("cut.png");
            std::fs::write(&cut, &whole[..(whole.len() as f64 * part) as usize]).unwrap();
            let mut bad = m.clone();
            let cut = cut.display().to_string();
            match i {
                0 => bad.camera[3].image = cut,
                1 => bad.light[1].on[2].image = cut,
                _ => bad.scan.as_mut().unwrap().frames[9].image = cut,
            }
            refused(&bad, &["cut.png"]);
        }
    }
}

#[test]
fn black_and_white_images_are_named() {
    for value in [0, 255] {
        let (_folder, name) = flat(value);
        let mut bad = recording();
        bad.camera.iter_mut().for_each(|c| c.image = name.clone());
        refused(&bad, &["empty", "no checkerboard"]);

        let mut bad = recording();
        bad.light
            .iter_mut()
            .for_each(|l| l.off = Some(name.clone()));
        bad.camera.clear();
        refused(&bad, &["empty", "no checkerboard"]);

        // Each frame its own name, as a dead camera would write them.
        let folder = tempfile::tempdir().unwrap();
        let mut bad = recording();
        for (i, frame) in bad.scan.as_mut().unwrap().frames.iter_mut().enumerate() {
            let copy = folder.path().join(format!("{i:03}.png"));
            std::fs::copy(&name, &copy).unwrap();
            frame.image = copy.display().to_string();
        }
        refused(&bad, &["empty", "saturated"]);
    }
}

#[test]
fn too_few_and_parallel_views_are_named() {
    let mut bad = recording();
    bad.camera.truncate(1);
    bad.light.clear();
    refused(&bad, &["1 views", "1 view"]);

    // Twelve times the same pose: no two boards are tilted against each other.
    let mut bad = recording();
    let one: CameraView = bad.camera[0].clone();
    bad.camera.iter_mut().for_each(|c| *c = one.clone());
    bad.light.clear();
    refused(&bad, &["parallel", "tilt"]);
}

#[test]
fn a_wrong_board_is_named() {
    for square in [5.0, 20.0, 25.4, 100.0] {
        let mut bad = recording();
        bad.board.as_mut().unwrap().square_mm = square;
        refused(&bad, &["square"]);
    }
    for (columns, rows) in [(9, 6), (8, 7), (7, 5)] {
        let mut bad = recording();
        let board = bad.board.as_mut().unwrap();
        (board.columns, board.rows) = (columns, rows);
        refused(&bad, &["corners"]);
    }
}

#[test]
fn swapped_images_are_named() {
    // One pose's dark image and a lit one.
    let mut bad = recording();
    let pose = &mut bad.light[0];
    std::mem::swap(pose.off.as_mut().unwrap(), &mut pose.on[3].image);
    refused(&bad, &["swapped"]);
    // All poses.
    let mut bad = recording();
    for pose in &mut bad.light {
        std::mem::swap(pose.off.as_mut().unwrap(), &mut pose.on[2].image);
    }
    refused(&bad, &["swapped"]);
    // The scan's ambient image and a frame.
    let mut bad = recording();
    let scan = bad.scan.as_mut().unwrap();
    std::mem::swap(scan.ambient.as_mut().unwrap(), &mut scan.frames[12].image);
    refused(&bad, &["swapped"]);
}

/// The board or the hand without the laser, three rows in its middle darker: as a sensor's noise in rows
/// makes it.
fn dark_rows(name: &str) -> Image<u8> {
    let session = Session::open(&committed("tiny-1001")).unwrap();
    let mut dark = session.luma::<u8>(name).unwrap();
    let (width, middle) = (dark.width(), dark.height() / 2);
    for row in middle - 1..middle + 2 {
        for p in &mut dark.pixels_mut()[row * width..][..width] {
            *p = p.saturating_sub(14);
        }
    }
    dark
}

/// They look like a stripe in the image without the laser: one image says nothing of the recording,
/// most of a pose do.
#[test]
fn one_image_with_a_dark_row_is_left_out_and_most_of_a_pose_are_swapped() {
    let folder = tempfile::tempdir().unwrap();
    let good = recording();
    let pose = &good.light[2];
    let dark = dark_rows(pose.off.as_ref().unwrap());
    let with = |images: std::ops::Range<usize>| {
        let mut m = good.clone();
        for i in images {
            let path = folder.path().join(format!("dark_{i}.png"));
            session::write_png(&path, &dark).unwrap();
            m.light[2].on[i].image = path.display().to_string();
        }
        m
    };
    let of = pose.on.len();
    refused(&with(1..of - 1), &["on and off are swapped"]);
    let here = tempfile::tempdir().unwrap();
    let text = serde_json::to_vec(&with(2..3)).unwrap();
    std::fs::write(here.path().join("session.json"), text).unwrap();
    let session = Session::open(here.path()).unwrap();
    let calibrated = calibrate(&session, Method::Ml, &Times::default(), &Silent).unwrap();
    let words = calibrated.warnings.join("\n");
    assert!(
        words.contains(
            "dark_2.png: left out: no stripe, but something like one in the image without"
        ),
        "{words}"
    );
}

#[test]
fn scan_frames_with_a_dark_row_are_left_out_and_most_are_swapped() {
    let folder = tempfile::tempdir().unwrap();
    let dark = dark_rows(recording().scan.unwrap().ambient.as_ref().unwrap());
    let with = |frames: std::ops::Range<usize>| {
        let mut m = recording();
        for i in frames {
            let path = folder.path().join(format!("dark_{i}.png"));
            session::write_png(&path, &dark).unwrap();
            m.scan.as_mut().unwrap().frames[i].image = path.display().to_string();
        }
        m
    };
    let measured = process(&with(0..2)).unwrap();
    let words = cannula::checks::sentences(&measured.checks).join("\n");
    assert!(
        words.contains("something like one: 0, 1 (from 0)"),
        "{words}"
    );
    assert_eq!(measured.counts[..2], [0, 0]);
    refused(&with(3..28), &["on and off are swapped"]);
}

#[test]
fn an_image_without_the_laser_that_is_none_is_named() {
    // The laser was on in the ambient image; it shows another scene; so does a pose's dark image.
    let folder = tempfile::tempdir().unwrap();
    let good = recording();
    let copy = folder.path().join("lit.png");
    std::fs::copy(&good.scan.as_ref().unwrap().frames[9].image, &copy).unwrap();
    let lit = copy.display().to_string();
    for ambient in [lit.clone(), good.light[0].off.clone().unwrap()] {
        let mut bad = recording();
        bad.scan.as_mut().unwrap().ambient = Some(ambient);
        refused(&bad, &["the laser was on in it, or it shows another scene"]);
    }
    let mut bad = recording();
    let on = &bad.light[1].on;
    std::fs::copy(&on[on.len() / 2].image, &copy).unwrap();
    bad.light[1].off = Some(lit);
    refused(&bad, &["the laser was on in it, or it shows another scene"]);
}

/// All that follows a lost or doubled frame would be laid a step beside where it is.
#[test]
fn lost_and_doubled_frames_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let images = |m: &Manifest| -> Vec<String> {
        let frames = &m.scan.as_ref().unwrap().frames;
        frames.iter().map(|f| f.image.clone()).collect()
    };
    let good = images(&recording());
    let with = |images: &[String]| {
        let mut bad = recording();
        let frames = &mut bad.scan.as_mut().unwrap().frames;
        frames.truncate(images.len());
        for (frame, image) in frames.iter_mut().zip(images) {
            frame.image = image.clone();
        }
        bad
    };
    for at in [7, good.len() / 2] {
        let mut lost = good.clone();
        lost.remove(at);
        let said = refused(&with(&lost), &["a frame was lost or doubled"]);
        let names = format!("from frame {} to frame {at}", at - 1);
        assert!(said.contains(&names), "{names}: {said}");
        let mut doubled = good.clone();
        doubled.pop();
        let copy = folder.path().join(format!("again_{at}.png"));
        std::fs::copy(&good[at], &copy).unwrap();
        doubled.insert(at + 1, copy.display().to_string());
        let said = refused(&with(&doubled), &["a frame was lost or doubled"]);
        let names = format!("from frame {at} to frame {}", at + 1);
        assert!(said.contains(&names), "{names}: {said}");
    }
}

/// A slip by a fifth of a step from the middle on: all that follows lies beside where it is.
#[test]
fn a_slip_of_the_slide_is_named() {
    let count = recording().scan.unwrap().frames.len();
    for at in [count / 3, count / 2] {
        for slip in [-0.4, 0.4] {
            let mut bad = recording();
            for frame in &mut bad.scan.as_mut().unwrap().frames[at..] {
                frame.slide_mm += slip;
                frame.slide_steps = None;
            }
            let said = refused(&bad, &["the slide slipped or the hand moved"]);
            let names = format!("from frame {} to frame {at}", at - 1);
            assert!(said.contains(&names), "{names}: {said}");
        }
    }
    // Less than that is doubted, as is the same in two halves, and a slide that slips all the time. The
    // recording itself is not.
    let doubts = |shift: &dyn Fn(usize) -> f64| -> Vec<String> {
        let mut m = recording();
        for (i, frame) in (0..).zip(&mut m.scan.as_mut().unwrap().frames) {
            frame.slide_mm += shift(i);
            frame.slide_steps = None;
        }
        let measured = process(&m).unwrap();
        let words = measured
            .checks
            .iter()
            .filter(|c| c.what.contains("stripe’s travel"));
        words.filter_map(|c| c.sentence()).collect()
    };
    let at = count / 2;
    let names = |from: usize, to: usize| format!("from frame {from} to frame {to}");
    let said = doubts(&|i| if i >= at { -0.15 } else { 0.0 });
    let single = names(at - 1, at);
    assert!(
        said.len() == 1 && said[0].contains(&single),
        "{single}: {said:?}"
    );
    let halves = |i: usize| match i {
        i if i > at => -0.3,
        i if i == at => -0.15,
        _ => 0.0,
    };
    let said = doubts(&halves);
    let both = names(at - 1, at + 1);
    assert!(
        said.len() == 1 && said[0].contains(&both),
        "{both}: {said:?}"
    );
    let said = doubts(&|i| 0.15 * (i / 2) as f64);
    assert!(
        said.iter().any(|w| w.contains("sticks and slips")),
        "{said:?}"
    );
    assert_eq!(doubts(&|_| 0.0), [""; 0]);
}

/// The same slip in every pose of the calibration bends no pose against another; the positions no longer
/// predict each other.
#[test]
fn a_slip_that_all_poses_share_is_doubted() {
    let hold_out = |slip: f64| {
        let mut m = recording();
        for frame in m.light.iter_mut().flat_map(|l| &mut l.on) {
            if frame.slide_mm > 29.0 {
                frame.slide_mm += slip;
                frame.slide_steps = None;
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let text = serde_json::to_vec(&m).unwrap();
        std::fs::write(folder.path().join("session.json"), text).unwrap();
        let session = Session::open(folder.path()).unwrap();
        let made = calibrate(&session, Method::Ml, &Times::default(), &Silent).unwrap();
        let file = CalibrationFile::new(&made, &session);
        let checks = all_checks(&file, None, jiff::Timestamp::now(), None);
        let planes = checks
            .iter()
            .find(|c| c.what == "calibration: light planes as predicted");
        planes.unwrap().sound()
    };
    assert!(hold_out(0.0) && !hold_out(0.3) && !hold_out(-0.3));
}

#[test]
fn a_board_that_moved_is_named() {
    // One pose's image without the laser is of the next pose.
    let mut bad = recording();
    let next = bad.light[1].off.clone();
    bad.light[0].off = next;
    refused(&bad, &["moved", "another scene"]);
}

/// Each list fits its steps; between them they do not: no frame is to blame.
#[test]
fn lists_that_count_from_different_ends_are_named() {
    let mut bad = recording();
    let frames = &mut bad.scan.as_mut().unwrap().frames;
    frames
        .iter_mut()
        .for_each(|f| f.slide_mm = 60.0 - f.slide_mm);
    let said = refused(&bad, &["\"light\" and \"scan\" disagree"]);
    let last = "slide_steps 19200 is 0 mm in \"scan\"";
    assert!(said.contains(last) && said.contains(", 60.000 mm by the frames of \"light\""));
    // One frame of the scan: that one, though the poses' frames are many more.
    let mut bad = recording();
    let frame = &mut bad.scan.as_mut().unwrap().frames[5];
    frame.slide_mm += 0.3;
    let name = frame.image.clone();
    refused(&bad, &[&format!("{name}: slide_mm")]);
}

#[test]
fn positions_in_another_unit_are_named() {
    // Centimetres, metres, micrometres, inches, steps of the motor.
    for factor in [0.1, 0.001, 1000.0, 1.0 / 25.4, 320.0] {
        let mut bad = recording();
        let scale = |f: &mut session::Frame| {
            f.slide_mm *= factor;
            f.slide_steps = None;
        };
        bad.light
            .iter_mut()
            .for_each(|l| l.on.iter_mut().for_each(scale));
        bad.scan.as_mut().unwrap().frames.iter_mut().for_each(scale);
        refused(&bad, &["slide", "metres", "travel"]);
        // The scan alone.
        let mut bad = recording();
        bad.scan.as_mut().unwrap().frames.iter_mut().for_each(scale);
        refused(&bad, &["scan", "slide_mm"]);
    }
}

#[test]
fn positions_out_of_order_or_twice_are_named() {
    let mut bad = recording();
    bad.light[2].on.swap(1, 4);
    refused(&bad, &["order of travel"]);
    let mut bad = recording();
    let frames = &mut bad.scan.as_mut().unwrap().frames;
    frames[5].slide_mm = frames[4].slide_mm;
    refused(&bad, &["twice"]);
}

#[test]
fn missing_parts_are_named() {
    let mut bad = recording();
    bad.scan = None;
    refused(&bad, &["\"scan\""]);
    let mut bad = recording();
    bad.entry = None;
    refused(&bad, &["\"entry\""]);
    let mut bad = recording();
    bad.board = None;
    refused(&bad, &["\"board\""]);
    let mut bad = recording();
    bad.camera.clear();
    bad.light.clear();
    refused(&bad, &["\"camera\""]);
    let nowhere = PathBuf::from("nowhere/at/all");
    assert!(matches!(
        Session::open(&nowhere),
        Err(SessionError::NotFound { .. })
    ));
}

#[test]
fn an_entry_off_the_hand_is_named() {
    for pixel in [[5.0, 5.0], [300.0, 20.0], [160.0, 235.0]] {
        let mut bad = recording();
        bad.entry.as_mut().unwrap().pixel = pixel;
        refused(&bad, &["entry"]);
    }
}

/// A region between two stripes, or with too few points in it, is told from a hand that was missed.
#[test]
fn a_region_that_is_too_small_names_the_radius() {
    for radius in [0.6, 2.5] {
        let mut bad = recording();
        bad.entry.as_mut().unwrap().radius_mm = radius;
        refused(&bad, &["give a larger radius_mm"]);
    }
}

/// Without dark images the corners and the stripe come from the lit ones. At a quarter of the
/// resolution the stripe can't be told from the squares: that is said, with what to record.
#[test]
fn poses_without_a_dark_image_are_refused_where_squares_are_small() {
    let mut bad = recording();
    bad.light.iter_mut().for_each(|l| l.off = None);
    for ambient in [true, false] {
        if !ambient {
            bad.scan.as_mut().unwrap().ambient = None;
        }
        let said = refused(&bad, &["too small to tell the stripe"]);
        for part in ["on_00.png", "squares of 13 pixels", "\"off\"", "28 of 28"] {
            assert!(said.contains(part), "{part:?} not in: {said}");
        }
    }
}

/// The paper's way can't work on squares of 13 pixels: its stripe is too thick for them. It says so,
/// with what to do: another thing with a dark image than without.
#[test]
fn the_papers_way_names_its_remedy() {
    let mut m = recording();
    for (off, remedy) in [
        (true, "bring the board nearer"),
        (false, "name it as \"off\""),
    ] {
        if !off {
            m.light.iter_mut().for_each(|l| l.off = None);
        }
        let folder = tempfile::tempdir().unwrap();
        let text = serde_json::to_vec(&m).unwrap();
        std::fs::write(folder.path().join("session.json"), text).unwrap();
        let session = Session::open(folder.path()).unwrap();
        let said = calibrate(&session, Method::Paper, &Times::default(), &Silent)
            .expect_err("squares of 13 pixels")
            .to_string();
        println!("{said}");
        for part in ["on_00.png", "13 pixels", remedy] {
            assert!(said.contains(part), "{part:?} not in: {said}");
        }
    }
}
