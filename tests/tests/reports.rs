//! What a reader gets when there is no result: the cloud and a report that shows why, never an
//! earlier run's needle. And what a calibration's file tells a later report.

use cannula::cli;
use cannula::cloud::read_ply;
use cannula::pipeline::{Method, Times, calibrate, measure};
use cannula::progress::Silent;
use cannula::session::{Manifest, Session};
use cannula_tests::truth::{committed, manifest};
use std::path::Path;

fn run(words: &[&str]) -> u8 {
    let all = ["cannula", "--quiet"].iter().chain(words);
    cli::main(all.map(Into::into))
}

/// The small recording in a folder of its own, changed.
fn recording(folder: &Path, change: impl FnOnce(&mut Manifest)) -> String {
    let mut m = manifest("tiny-1001");
    change(&mut m);
    std::fs::create_dir_all(folder).unwrap();
    let text = serde_json::to_vec(&m).unwrap();
    std::fs::write(folder.join("session.json"), text).unwrap();
    folder.display().to_string()
}

/// What the report says above everything, and whether it holds a view of the cloud.
fn top(page: &str) -> (String, bool) {
    let from = page.find("<main>").unwrap();
    let to = page.find("<h2>").unwrap();
    (
        page[from..to].to_owned(),
        page.contains("id=\"scene-data\""),
    )
}

#[test]
fn a_refused_needle_leaves_cloud_and_report_and_no_earlier_needle() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let to = out.display().to_string();
    let good = recording(&dir.path().join("good"), |_| ());
    assert_eq!(run(&["process", &good, "--out", &to]), 0);
    let whole = read_ply(std::fs::File::open(out.join("cloud.ply")).unwrap()).unwrap();
    std::fs::remove_file(out.join("cloud.ply")).unwrap();
    let calibration = dir.path().join("calibration.json");
    std::fs::rename(out.join("calibration.json"), &calibration).unwrap();

    // The entry beside the hand; the same cloud must be there to show it.
    let off = recording(&dir.path().join("off"), |m| {
        m.entry.as_mut().unwrap().pixel = [2.0, 2.0];
    });
    assert_eq!(run(&["process", &off, "--out", &to]), 1);
    assert!(!out.join("result.json").exists() && out.join("result-before.json").exists());
    let cloud = read_ply(std::fs::File::open(out.join("cloud.ply")).unwrap()).unwrap();
    assert_eq!(cloud, whole);
    let (head, view) = top(&std::fs::read_to_string(out.join("report.html")).unwrap());
    assert!(
        head.contains("Not usable:") && head.contains("check entry.pixel"),
        "{head}"
    );
    assert!(head.contains("put aside as result-before.json") && view);

    // A hole: half of the frames taken out, around the entry. With a calibration's file.
    let hole = recording(&dir.path().join("hole"), |m| {
        let frames = &mut m.scan.as_mut().unwrap().frames;
        let (first, last) = (frames.len() / 4, 3 * frames.len() / 4);
        frames.drain(first..last);
    });
    let given = calibration.display().to_string();
    let to = dir.path().join("angle");
    let words = ["angle", &hole, "--calibration", &given, "--out"];
    let all = words.iter().copied().chain([to.to_str().unwrap()]);
    assert_eq!(run(&all.collect::<Vec<_>>()), 1);
    let page = std::fs::read_to_string(to.join("report.html")).unwrap();
    let (head, view) = top(&page);
    assert!(head.contains("Not usable:") && view, "{head}");
    assert!(to.join("cloud.ply").exists() && !to.join("result.json").exists());
    // The calibration is shown whole from its file.
    for words in [
        "Coverage: the corner grid",
        "Tilt of the board",
        "Reprojection residuals, drawn",
    ] {
        assert!(page.contains(words), "{words}");
    }
}

/// A calibration that is no longer to be trusted gives no angle, whatever was measured with it.
#[test]
fn a_calibration_past_its_limits_gives_no_angle() {
    let dir = tempfile::tempdir().unwrap();
    let session = committed("tiny-1001").display().to_string();
    let path = |name: &str| dir.path().join(name).display().to_string();
    assert_eq!(
        run(&["calibrate", &session, "--out", &path("good.json")]),
        0
    );
    let text = std::fs::read(path("good.json")).unwrap();
    let good: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let to = path("out");
    let angle = |calibration: &str| {
        run(&[
            "angle",
            &session,
            "--calibration",
            calibration,
            "--out",
            &to,
        ])
    };
    assert_eq!(angle(&path("good.json")), 0);
    let aged = |file: &mut serde_json::Value| {
        file["provenance"]["recorded"] = "2020-02-02T12:00:00Z".into();
    };
    let loose = |file: &mut serde_json::Value| file["camera"]["rms_px"] = 1.5.into();
    type Spoil<'a> = &'a dyn Fn(&mut serde_json::Value);
    for (spoil, reason) in [
        (&aged as Spoil, "(more than 365)"),
        (&loose, "1.50 px (more than 1.0)"),
    ] {
        let mut bad = good.clone();
        spoil(&mut bad);
        std::fs::write(path("bad.json"), bad.to_string()).unwrap();
        assert_eq!(angle(&path("bad.json")), 1);
        // A scan does not even begin.
        let scanned = path("scanned");
        let bad = path("bad.json");
        assert_eq!(run(&["scan", "--out", &scanned, "--calibration", &bad]), 1);
        assert!(!Path::new(&scanned).join("session").exists());
        let there = |name: &str| Path::new(&to).join(name).exists();
        assert!(!there("result.json") && there("cloud.ply"), "{reason}");
        let page = std::fs::read_to_string(format!("{to}/report.html")).unwrap();
        let (head, view) = top(&page);
        assert!(
            view && head.contains("No angle") && head.contains("Not usable:"),
            "{head}"
        );
        assert!(head.contains(reason), "{reason}: {head}");
        // Once among the checks, with the limit that it is refused by.
        let table = page.split("<h2>Checks</h2>").nth(1).unwrap();
        let table = table.split("</table>").next().unwrap();
        assert_eq!(table.matches(">refused</td>").count(), 1);
    }
    assert!(Path::new(&to).join("result-before.json").exists());
}

/// What this run does not write is another's, and does not stand beside what it writes.
#[test]
fn no_earlier_hand_stands_beside_a_run_s_files() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let to = out.display().to_string();
    let there = |name: &str| out.join(name).exists();
    let good = recording(&dir.path().join("good"), |_| ());
    assert_eq!(run(&["process", &good, "--out", &to, "--csv", "--xyz"]), 0);
    assert_eq!(run(&["process", &good, "--out", &to, "--xyz"]), 0);
    assert!(there("cloud.xyz") && !there("cloud.csv") && there("cloud-before.csv"));
    // A scan that can't be read, after a calibration that could.
    let cut = dir.path().join("cut.png");
    let bad = recording(&dir.path().join("bad"), |m| {
        let frames = &mut m.scan.as_mut().unwrap().frames;
        let whole = std::fs::read(&frames[5].image).unwrap();
        std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
        frames[5].image = cut.display().to_string();
    });
    let was = std::fs::read(out.join("result.json")).unwrap();
    assert_eq!(run(&["process", &bad, "--out", &to]), 1);
    for name in ["result.json", "cloud.ply", "cloud.xyz", "report.html"] {
        assert!(!there(name), "{name}");
    }
    assert_eq!(std::fs::read(out.join("result-before.json")).unwrap(), was);
}

#[test]
fn a_refused_calibration_shows_what_there_is() {
    let dir = tempfile::tempdir().unwrap();
    // Squares of another size than described: the planes move too fast or too slowly.
    let bad = recording(&dir.path().join("bad"), |m| {
        m.board.as_mut().unwrap().square_mm *= 2.0;
    });
    let out = dir.path().join("out");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("cloud.ply"), "an earlier hand's").unwrap();
    assert_eq!(
        run(&["process", &bad, "--out", &out.display().to_string()]),
        1
    );
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    let (head, view) = top(&page);
    assert!(
        head.contains("Not usable:") && head.contains("squares are"),
        "{head}"
    );
    assert!(!view && !out.join("calibration.json").exists());
    // The earlier cloud does not stand beside this report, and is not lost.
    assert!(!out.join("cloud.ply").exists() && head.contains("cloud-before.ply"));
    let aside = std::fs::read_to_string(out.join("cloud-before.ply")).unwrap();
    assert_eq!(aside, "an earlier hand's");
    // The refusal is the first thing that is weak.
    assert!(weak(&page).contains("squares are") && !weak(&page).contains("Nothing"));
    assert!(page.contains(">refused</td>"));
    for words in ["Reprojection residuals, drawn", "Coverage", "Table 4"] {
        assert!(page.contains(words), "{words}");
    }
    // The same from `calibrate`, beside the file that is not written.
    let file = dir.path().join("rig.json");
    assert_eq!(
        run(&["calibrate", &bad, "--out", &file.display().to_string()]),
        1
    );
    let page = std::fs::read_to_string(dir.path().join("rig.html")).unwrap();
    assert!(page.contains("No calibration") && !file.exists());
    assert!(weak(&page).contains("squares are"));
    assert!(!page.contains("earlier run's"));
}

/// A refused calibration leaves an earlier file as it is, and its page says whose it is; `process`,
/// whose folder is one run's, puts it aside.
#[test]
fn a_refused_calibration_is_not_mistaken_for_the_earlier_one() {
    let dir = tempfile::tempdir().unwrap();
    let good = recording(&dir.path().join("good"), |_| ());
    let bad = recording(&dir.path().join("bad"), |m| {
        m.board.as_mut().unwrap().square_mm *= 2.0;
    });
    let out = dir.path().join("out");
    let file = out.join("calibration.json");
    let (to, path) = (out.display().to_string(), file.display().to_string());
    assert_eq!(run(&["calibrate", &good, "--out", &path]), 0);
    let made = std::fs::read(&file).unwrap();
    assert_eq!(run(&["calibrate", &bad, "--out", &path]), 1);
    assert_eq!(std::fs::read(&file).unwrap(), made, "untouched");
    let page = std::fs::read_to_string(out.join("calibration.html")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&made).unwrap();
    let time = json["provenance"]["time"].as_str().unwrap();
    let time = time.replace('T', " ").replace('Z', " UTC");
    let words =
        format!("{path} of {time} is an earlier run's calibration, from the recording {good}");
    assert!(top(&page).0.contains(&words), "{}", top(&page).0);
    assert!(page.contains("No calibration"));
    assert_eq!(run(&["process", &bad, "--out", &to]), 1);
    assert!(!file.exists());
    assert_eq!(
        std::fs::read(out.join("calibration-before.json")).unwrap(),
        made
    );
    let head = top(&std::fs::read_to_string(out.join("report.html")).unwrap()).0;
    assert!(
        head.contains("put aside as calibration-before.json"),
        "{head}"
    );
    // A given calibration is an input: it stays, whatever is refused.
    let given = dir.path().join("given.json");
    std::fs::copy(out.join("calibration-before.json"), &given).unwrap();
    std::fs::copy(&given, &file).unwrap();
    let off = recording(&dir.path().join("off"), |m| {
        m.entry.as_mut().unwrap().pixel = [2.0, 2.0];
    });
    assert_eq!(
        run(&["angle", &off, "--calibration", &path, "--out", &to]),
        1
    );
    assert_eq!(std::fs::read(&file).unwrap(), made);
}

/// The calibration's list of what is weak.
fn weak(page: &str) -> &str {
    let list = page.split("What is weak, and what to do").nth(1).unwrap();
    list.split("<div").next().unwrap()
}

/// An angle that was given meets the checks that a chosen one meets, and a calibration that says no
/// more than the contract asks is not taken for one without faults.
#[test]
fn a_given_angle_and_a_bare_calibration_are_doubted() {
    let dir = tempfile::tempdir().unwrap();
    let session = committed("tiny-1001").display().to_string();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let whole = path("whole.json");
    assert_eq!(run(&["calibrate", &session, "--out", &whole]), 0);
    let text = std::fs::read_to_string(&whole).unwrap();
    let mut bare: serde_json::Value = serde_json::from_str(&text).unwrap();
    for key in ["provenance", "covariance", "warnings", "board"] {
        bare.as_object_mut().unwrap().remove(key);
    }
    bare["camera"].as_object_mut().unwrap().remove("views");
    std::fs::write(path("bare.json"), bare.to_string()).unwrap();
    let of = |calibration: &str, angle: &str| {
        let to = path(&format!("{angle}-{}", calibration.len()));
        let words = [
            "angle",
            &session,
            "--calibration",
            calibration,
            "--needle-angle",
            angle,
            "--out",
            &to,
        ];
        assert_eq!(run(&words), 0);
        std::fs::read_to_string(format!("{to}/report.html")).unwrap()
    };
    for (angle, faults) in [
        ("85", &["clinical", "15–75°", "far wall", "straight on"][..]),
        ("60", &["clinical", "far wall", "straight on"]),
        ("25", &[]),
    ] {
        let page = of(&whole, angle);
        let head = top(&page).0;
        if !faults.is_empty() {
            assert!(head.contains("Usable with caution:"), "{head}");
        }
        for word in ["clinical", "15–75°", "far wall", "straight on"] {
            assert_eq!(
                head.contains(word),
                faults.contains(&word),
                "{word}: {head}"
            );
        }
        assert!(page.contains("two digits of its standard deviation"));
    }
    let page = of(&path("bare.json"), "25");
    let head = top(&page).0;
    assert!(head.contains("Usable with caution:"), "{head}");
    for word in ["no date", "no uncertainty", "no views"] {
        assert!(head.contains(word) && weak(&page).contains(word), "{word}");
    }
    assert!(!page.contains("two digits of its standard deviation"));
}

/// The list of checks is a record: each outcome follows from its own value and limit, the verdict and
/// the warnings from the list, and the page shows that list and no other.
#[test]
fn the_verdict_is_read_off_the_checks_that_were_made() {
    let dir = tempfile::tempdir().unwrap();
    let good = recording(&dir.path().join("good"), |_| ());
    let out = dir.path().join("out").display().to_string();
    assert_eq!(
        run(&["process", &good, "--out", &out, "--needle-angle", "25"]),
        0
    );
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(format!("{out}/{name}")).unwrap()).unwrap()
    };
    let (result, calibration) = (json("result.json"), json("calibration.json"));
    let checks = result["checks"].as_array().unwrap();
    let mut unsound = 0;
    for c in checks {
        let value = c["value"].as_f64();
        let at = |key: &str| c[key].as_f64();
        let within = match (
            value,
            at("at_most"),
            at("at_least"),
            c["between"].as_array(),
        ) {
            (Some(v), Some(most), None, None) => v <= most,
            (Some(v), None, Some(least), None) => v >= least,
            (Some(v), None, None, Some(range)) => {
                range[0].as_f64().unwrap() <= v && v <= range[1].as_f64().unwrap()
            }
            (None, None, None, None) => c["outcome"] == "sound",
            _ => panic!("{c}"),
        };
        assert_eq!(c["outcome"] == "sound", within, "{c}");
        unsound += usize::from(!within);
    }
    let verdict = match unsound {
        0 => "usable",
        _ => "usable with caution",
    };
    assert_eq!(result["verdict"], verdict);
    // What the file says elsewhere is what was checked.
    let value = |what: &str| {
        let found = checks.iter().find(|c| c["what"] == what);
        found.unwrap_or_else(|| panic!("{what}"))["value"]
            .as_f64()
            .unwrap()
    };
    for (what, found) in [
        ("region: points", &result["plane"]["points"]),
        ("region: stripes", &result["plane"]["stripes"]),
        ("needle angle: σ", &result["needle"]["angle_sigma_deg"]),
        ("entry: σ", &result["entry"]["sigma_mm"]),
        (
            "needle angle: largest change with a smaller radius",
            &result["needle"]["angle_systematic_deg"],
        ),
        (
            "calibration: corners off the fitted boards, RMS",
            &calibration["camera"]["rms_px"],
        ),
        (
            "calibration: light planes as predicted",
            &calibration["light"]["hold_out_error_mm"],
        ),
    ] {
        assert!(
            (value(what) - found.as_f64().unwrap()).abs() < 1e-9,
            "{what}"
        );
    }
    let sigma = calibration["covariance"][0][0].as_f64().unwrap().sqrt();
    let focal = 100.0 * sigma / calibration["camera"]["fx"].as_f64().unwrap();
    // Zhang's own, before the light views refine it: of the same size.
    assert!((value("camera: σ of the focal length") / focal).ln().abs() < 1.0);
    // The page's rows are these, in order.
    let page = std::fs::read_to_string(format!("{out}/report.html")).unwrap();
    let table = page.split("<h2>Checks</h2>").nth(1).unwrap();
    let table = table.split("</table>").next().unwrap();
    assert_eq!(table.matches("<tr>").count(), 1 + checks.len());
    let mut rest = table;
    for c in checks {
        let cell = format!(">{}</td>", c["what"].as_str().unwrap());
        rest = rest.split_once(&cell).unwrap_or_else(|| panic!("{cell}")).1;
    }
    // The first line: what was measured, and what is known of the model's error.
    let needle = &result["needle"];
    let figure = |key: &str| needle[key].as_f64().unwrap();
    let change = figure("angle_systematic_deg");
    let half = (figure("angle_at_half_radius_deg") - figure("angle_deg")).abs();
    assert!(change >= half && half > 0.0);
    let within = figure("angle_systematic_radius_mm");
    assert!(page.contains(&format!("fitted within {within:.1} mm of the entry")));
    let line = format!(
        "25.0°<small> ± {:.2}° measured (1 σ), ± {change:.2}° by the region’s radius",
        figure("angle_sigma_deg")
    );
    assert!(top(&page).0.contains(&line), "{line}: {}", top(&page).0);
}

/// An angle given by hand is the one that the report is about: a row and a curve of its own, and the
/// criterion's named as not used.
#[test]
fn a_given_angle_has_its_own_row_and_curve() {
    let dir = tempfile::tempdir().unwrap();
    let good = recording(&dir.path().join("good"), |_| ());
    let page = |angle: Option<&str>| {
        let out = dir.path().join(angle.unwrap_or("none"));
        let to = out.display().to_string();
        let mut words = vec!["process", &good, "--out", &to];
        words.extend(angle.iter().flat_map(|a| ["--needle-angle", a]));
        assert_eq!(run(&words), 0);
        std::fs::read_to_string(out.join("report.html")).unwrap()
    };
    let section = |page: &str| {
        let from = page.find("<h2>Puncture</h2>").unwrap();
        page[from..from + page[from..].find("<h2>Checks</h2>").unwrap()].to_owned()
    };
    let rows = |section: &str, with: &str| section.matches(with).count();
    let given = section(&page(Some("25")));
    assert!(given.contains("Angle given by hand: <strong>25.0°</strong>"));
    assert!(given.contains("it would have been 60.0°; that was not used"));
    assert!(given.contains("Force by layer at 25° (Figure 26)") && given.contains("25° (given)"));
    assert_eq!(rows(&given, ">given: used</td>"), 1);
    assert_eq!(rows(&given, ">the criterion’s: not used</td>"), 1);
    assert_eq!(rows(&given, ">chosen</td>"), 0);
    assert_eq!(
        rows(&given, "Force by layer at"),
        2 * 4,
        "label and title of each"
    );
    // One that was compared too is not shown twice; one beyond the model's range is drawn all the same.
    let compared = section(&page(Some("45")));
    assert_eq!(rows(&compared, "Force by layer at"), 2 * 3);
    assert_eq!(rows(&compared, ">given: used</td>"), 1);
    let steep = section(&page(Some("85")));
    assert!(steep.contains("Against it: the given 85° is outside"));
    assert_eq!(rows(&steep, "Force by layer at 85°"), 2);
    let none = section(&page(None));
    assert!(none.contains("Angle by the criterion") && !none.contains("given"));
    assert_eq!(rows(&none, ">chosen</td>"), 1);
}

/// The corners and residuals in the file are those of the solve.
#[test]
fn a_calibration_file_carries_its_views() {
    let session = Session::open(&committed("tiny-1001")).unwrap();
    let times = Times::default();
    let found = calibrate(&session, Method::Ml, &times, &Silent).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("calibration.json");
    let file = cannula::output::CalibrationFile::new(&found, &session);
    cannula::output::write_json(&path, &file).unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() < 100_000);
    let read = cannula::output::read_calibration(&path).unwrap();
    assert_eq!(read.camera.views.len(), found.views.len());
    for (view, rms) in read.camera.views.iter().zip(&found.zhang.view_rms_px) {
        let squares = view.residuals_px.iter().map(|r| r * r);
        let mean = squares.sum::<f64>() / (view.residuals_px.len() / 2) as f64;
        assert!((mean.sqrt() - rms).abs() < 1e-4, "{} {rms}", mean.sqrt());
        let tilt = view.tilt_deg.unwrap();
        assert!(tilt.iter().all(|t| t.abs() < 70.0));
    }
    // What is measured with the file is what is measured with the solve.
    let settings = cannula::needle::Settings::default();
    let needle = |rig| measure(&session, &rig, &[], Method::Ml, &settings, &times, &Silent);
    let a = needle(found.rig().unwrap()).unwrap().decision.entry;
    let b = needle(read.rig().unwrap()).unwrap().decision.entry;
    assert!((a - b).norm() < 1e-9);
}

/// The result names what it was made from and by, so that it can be made again: digests that stand
/// against the files themselves, the commit, and everything that decided the angle.
#[test]
fn provenance_tells_recording_calibration_commit_and_what_decided_the_angle() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let folder = committed("tiny-1001");
    let session = folder.display().to_string();
    assert_eq!(run(&["process", &session, "--out", &path("out")]), 0);
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(path(name)).unwrap()).unwrap()
    };
    // The digest as the documentation describes it, from the files alone.
    let m = Session::open(&folder).unwrap().manifest;
    let digest = |images: Vec<&str>| {
        let mut told = std::fs::read(folder.join("session.json")).unwrap();
        for name in &images {
            let bytes = std::fs::read(folder.join(name)).unwrap();
            let line = format!("{name}\t{}\t{:08x}\n", bytes.len(), crc32(&bytes));
            told.extend(line.into_bytes());
        }
        let file = dir.path().join("told");
        std::fs::write(&file, told).unwrap();
        let sha256 = cannula::session::sha256_of(&file).unwrap();
        serde_json::json!({ "sha256": sha256, "images": images.len() })
    };
    let all = digest(m.images().collect());
    let provenance = &json("out/result.json")["provenance"];
    assert_eq!(provenance["recording"], all);
    let made = json("out/calibration.json");
    assert_eq!(
        made["provenance"]["recording"],
        digest(m.board_images().collect())
    );
    let program = provenance["program"].as_str().unwrap();
    let (version, commit) = program.split_once(" (").unwrap();
    assert_eq!(version, concat!("cannula ", env!("CARGO_PKG_VERSION")));
    let commit = commit.trim_end_matches(')').trim_end_matches("+dirty");
    let hash = commit.len() == 12 && commit.chars().all(|c| c.is_ascii_hexdigit());
    assert!(commit == "unknown" || hash, "{program}");

    // With a calibration's file: the scan's images alone, and the file's own digest.
    let given = path("out/calibration.json");
    let words = [
        "angle",
        &session,
        "--calibration",
        &given,
        "--out",
        &path("angle"),
    ];
    assert_eq!(run(&words), 0);
    let measured = &json("angle/result.json")["provenance"];
    assert_eq!(measured["recording"], digest(m.scan_images().collect()));
    let own = cannula::session::sha256_of(Path::new(&given)).unwrap();
    assert_eq!(measured["calibration"]["sha256"], own.as_str());

    // What decided the angle, in the file and on the page, which also lists each stage's constants.
    let setup = serde_json::to_value(cannula::puncture::Setup::default()).unwrap();
    assert_eq!(provenance["puncture"]["setup"], setup);
    assert_eq!(
        provenance["puncture"]["clinical_deg"],
        serde_json::json!([15.0, 30.0])
    );
    let page = std::fs::read_to_string(path("out/report.html")).unwrap();
    let settings = page.split("Settings and thresholds").nth(1).unwrap();
    let row = |name: &str, value: &str| {
        let cell = format!(">{name}</td>");
        let after = settings.split(&cell).nth(1);
        let value = format!(">{value}</td>");
        assert!(
            after.is_some_and(|a| a.split("</tr>").next().unwrap().contains(&value)),
            "{name}"
        );
    };
    row("recording: sha256", all["sha256"].as_str().unwrap());
    row("puncture: setup: friction", "0.7");
    row("puncture: setup: layers: skin / mm", "1.0");
    row("puncture: setup: skin: law: c10", "0.5");
    row("puncture: setup: needle: diameter / mm", "0.72");
    row("puncture: model", "fast model");
    row("puncture: advance / mm", "5.0");
    row("puncture: clinical / °", "15.0, 30.0");
    // Rendered recordings say so in their title; this one has its truth beside it.
    assert!(page.contains("<h1>Simulated, no real hand. Needle insertion"));
    let stages = cannula::stripe::limits().into_iter();
    for (name, value) in stages.chain(cannula::stripe::hand::limits()) {
        row(name, &value);
    }
}

/// CRC-32 (ISO 3309), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        let shift = |c: u32, _| (c >> 1) ^ (0xEDB8_8320 * (c & 1));
        (0..8).fold(crc ^ u32::from(*byte), shift)
    };
    !bytes.iter().fold(!0, step)
}

/// Every chart, as one whole SVG and as a PNG of the size that was asked for.
#[test]
fn charts_come_as_asked() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let session = committed("tiny-1001").display().to_string();
    assert_eq!(run(&["process", &session, "--out", &path("out")]), 0);
    for (what, input) in [
        ("calibration", path("out/calibration.json")),
        ("cloud", path("out")),
        ("stripes", session.clone()),
    ] {
        let (svg, png) = (path("a.svg"), path("a.png"));
        assert_eq!(run(&["plot", what, &input, "-o", &svg, "--width", "85"]), 0);
        let text = std::fs::read_to_string(&svg).unwrap();
        assert!(text.starts_with("<svg width=\"85mm\"") && text.trim_end().ends_with("</svg>"));
        assert_eq!(text.matches("</svg>").count(), 1, "{what}");
        let sized = [
            "plot", what, &input, "-o", &png, "--size", "1000x700", "--scale", "1.5",
        ];
        assert_eq!(run(&sized), 0);
        let image = std::fs::read(&png).unwrap();
        let side = |at: usize| u32::from_be_bytes(image[at..at + 4].try_into().unwrap());
        assert_eq!((side(16), side(20)), (1000, 700), "{what}");
    }
    // A frame that is not there is told from one without a stripe, and the cloud's entry is marked.
    for (frame, code) in [("0", 0), ("99", 1)] {
        let words = [
            "plot",
            "stripes",
            &session,
            "-o",
            &path("b.svg"),
            "--frame",
            frame,
        ];
        assert_eq!(run(&words), code, "frame {frame}");
    }
    assert_eq!(
        run(&["plot", "cloud", &path("out"), "-o", &path("c.svg")]),
        0
    );
    assert!(
        std::fs::read_to_string(path("c.svg"))
            .unwrap()
            .contains("entry")
    );
    let bad = [
        "plot",
        "cloud",
        &path("out"),
        "-o",
        &path("a.svg"),
        "--size",
        "20x10",
    ];
    assert_eq!(run(&bad), 2);
}
