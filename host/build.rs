//! Says which commit the program is built from: CANNULA_COMMIT is its short hash, with "+dirty" where
//! the program's own sources differ from it, or "unknown" where there is no repository (a tarball) or
//! no git.

use std::path::Path;
use std::process::Command;

/// What the program is made of, from the workspace's top.
const SOURCES: [&str; 7] = [
    "host/src",
    "host/build.rs",
    "host/Cargo.toml",
    "shared",
    "firmware",
    "Cargo.toml",
    "Cargo.lock",
];

fn main() {
    let root = Path::new("..");
    for source in SOURCES {
        println!("cargo:rerun-if-changed=../{source}");
    }
    let commit = commit(root).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo:rustc-env=CANNULA_COMMIT={commit}");
}

fn commit(root: &Path) -> Option<String> {
    // A tarball unpacked inside another repository is not of that one.
    let top = git(root, &["rev-parse", "--show-toplevel"])?;
    if Path::new(&top).canonicalize().ok()? != root.canonicalize().ok()? {
        return None;
    }
    // The reflog grows with every commit, checkout and reset.
    let log = git(root, &["rev-parse", "--git-path", "logs/HEAD"])?;
    println!("cargo:rerun-if-changed={}", root.join(log).display());
    let hash = git(root, &["rev-parse", "--short=12", "HEAD"])?;
    let status = ["status", "--porcelain", "--"];
    let changed = git(root, &[&status[..], &SOURCES].concat())?;
    let dirty = if changed.is_empty() { "" } else { "+dirty" };
    Some(format!("{hash}{dirty}"))
}

/// What git says, if it is there and content.
fn git(root: &Path, words: &[&str]) -> Option<String> {
    let said = Command::new("git")
        .arg("--no-optional-locks")
        .args(words)
        .current_dir(root)
        .output()
        .ok()
        .filter(|o| o.status.success())?;
    Some(String::from_utf8(said.stdout).ok()?.trim().to_owned())
}
