//! `tests/peers/compare.py`: the same recording by Python with OpenCV and by the `cannula` command,
//! beside each other. Skipped in a word where Python, OpenCV, the recording or the built command
//! is missing.

use cannula_tests::truth::beside;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The command built beside this test, if it was.
fn command() -> Option<PathBuf> {
    let test = std::env::current_exe().ok()?;
    let name = format!("cannula{}", std::env::consts::EXE_SUFFIX);
    let found = test.parent()?.parent()?.join(name);
    found.exists().then_some(found)
}

/// The report of `compare.py` on nominal-1001; `None` where something is missing.
fn report() -> Option<Value> {
    let (Some(cannula), Some(session)) = (command(), beside("nominal-1001")) else {
        println!("skipped");
        return None;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/compare.py");
    let run = Command::new("python3")
        .arg(script)
        .arg(session)
        .arg("--cannula")
        .arg(cannula)
        .args(["--repeat", "0", "--json"])
        .output();
    let Ok(run) = run else {
        println!("skipped");
        return None;
    };
    let said = String::from_utf8_lossy(&run.stdout);
    if said.trim() == "skipped" {
        println!("skipped");
        return None;
    }
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    println!("{said}");
    Some(serde_json::from_str(&said).unwrap())
}

#[test]
fn no_peer_is_more_exact_and_the_papers_way_is_the_papers() {
    let Some(report) = report() else {
        return;
    };
    assert_eq!(report["recordings"], 1, "no way refuses this recording");
    let error = |who: &str, what: &str| report["errors"][who][what].as_f64().unwrap();
    // The floor of one recording's noise beside its peers': a draw of each may fall either way.
    for (what, floor) in [
        ("stripe_px", 0.0),
        ("light_mm", 0.02),
        ("light_turned_mm", 0.0),
        ("normal_deg", 0.03),
        ("entry_mm", 0.05),
        ("axis_deg", 0.03),
        ("focal_percent", 0.008),
    ] {
        for peer in ["competent", "model_fitted"] {
            let (ours, theirs) = (error("cannula", what), error(peer, what));
            assert!(
                ours <= theirs.max(floor),
                "{what}: {ours} against {peer}'s {theirs}"
            );
        }
        // The same steps on the same images.
        let (ours, theirs) = (error("cannula_paper", what), error("paper_opencv", what));
        assert!(
            ours <= 1.5 * theirs && theirs <= 1.5 * ours.max(floor),
            "{what}: {ours} in the paper's way, {theirs} by OpenCV"
        );
    }
    let corners = |who: &str| report["corners"]["rms_px"][who].as_f64();
    let of_opencv = corners("cornerSubPix").unwrap();
    // The example is built by `cargo test` of the whole workspace, not of this package alone.
    if let (Some(model), Some(gradient)) = (corners("ours"), corners("ours, gradient")) {
        assert!(model <= corners("fitted").unwrap() && model <= 0.01);
        assert!((gradient / of_opencv - 1.0).abs() < 0.1, "{gradient}");
        assert!(report["corners"]["no_board_reason"].is_string());
    }
}

/// Other programs read every point of a cloud where it is, and draw its brightness as a grey. Skipped in
/// a word where Python has none of them.
#[test]
fn other_programs_read_the_cloud() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().display().to_string();
    let session = cannula_tests::truth::committed("tiny-1001")
        .display()
        .to_string();
    let words = [
        "cannula", "--quiet", "process", &session, "--csv", "--out", &out,
    ];
    assert_eq!(cannula::cli::main(words.map(Into::into)), 0);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/cloud.py");
    let cloud = dir.path().join("cloud.ply");
    let run = Command::new("python3").arg(script).arg(cloud).output();
    let Ok(run) = run else {
        println!("skipped");
        return;
    };
    let said = String::from_utf8_lossy(&run.stdout);
    if said.trim() == "skipped" {
        println!("skipped");
        return;
    }
    println!("{said}{}", String::from_utf8_lossy(&run.stderr));
    assert!(run.status.success());
    // The same cloud as text, whose columns are named.
    let csv = std::fs::read_to_string(dir.path().join("cloud.csv")).unwrap();
    let rows: Vec<Vec<f64>> = csv
        .lines()
        .skip(1)
        .map(|l| l.split(',').map(|c| c.parse().unwrap()).collect())
        .collect();
    let mean = |k: usize| rows.iter().map(|r| r[k]).sum::<f64>() / rows.len() as f64;
    let brightest = rows.iter().map(|r| r[6]).fold(0.0, f64::max);
    let programs: Value = serde_json::from_str(&said).unwrap();
    for (name, read) in programs.as_object().unwrap() {
        assert_eq!(read["points"], rows.len(), "{name}");
        for k in 0..3 {
            let found = read["mean_mm"][k].as_f64().unwrap();
            assert!(
                (found - mean(k)).abs() < 1e-3,
                "{name}: {found} {}",
                mean(k)
            );
        }
        // MeshLab takes the whole part of a grey value.
        if let Some(grey) = read["grey"].as_f64() {
            let off = 255.0 * mean(6) / brightest - grey;
            assert!((-0.01..1.01).contains(&off), "{name}: {grey}");
        }
        if let Some(quality) = read["quality"].as_f64() {
            assert!((quality - mean(7)).abs() < 1e-3, "{name}: {quality}");
        }
    }
}
