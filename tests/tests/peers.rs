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

#[test]
fn no_peer_is_more_exact() {
    let (Some(cannula), Some(session)) = (command(), beside("nominal-1001")) else {
        println!("skipped");
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/compare.py");
    let run = Command::new("python3")
        .arg(script)
        .arg(session)
        .arg("--cannula")
        .arg(cannula)
        .args(["--repeat", "1"])
        .output();
    let Ok(run) = run else {
        println!("skipped");
        return;
    };
    let said = String::from_utf8_lossy(&run.stdout);
    if said.trim() == "skipped" {
        println!("skipped");
        return;
    }
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    println!("{said}");
    let report: Value = serde_json::from_str(&said).unwrap();
    let error = |who: &str, what: &str| report["errors"][who][what].as_f64().unwrap();
    // The floor of one recording's noise beside its peers': a draw of each may fall either way.
    for (what, floor) in [
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
    }
}
