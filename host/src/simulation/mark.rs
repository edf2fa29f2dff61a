//! What a simulation wrote may be replaced by another one, if that is asked for; nothing else may.
//!
//! [`FILE`] marks a recording as a simulation's. It is written before anything else, and goes away as
//! soon as something else is recorded into that folder.

use crate::rig::lock;
use crate::rig::progress::is_of_sweep;
use crate::session::sha256_of;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// The mark's name, beside session.json.
pub const FILE: &str = "simulated.json";

/// Why a folder is not to be replaced.
#[derive(Debug, thiserror::Error)]
pub enum MarkError {
    /// It holds something else.
    #[error("{path}: not written by a simulation, so not replaced even with --force; move it away, or give another folder", path = .0.display())]
    Foreign(PathBuf),
    /// The disk.
    #[error("{path}: can't be looked at or written", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> MarkError {
    move |source| MarkError::Io {
        path: path.to_owned(),
        source,
    }
}

/// What the mark says.
#[derive(Default, Serialize, Deserialize)]
struct Mark {
    /// SHA-256 of the files beside the recording, once they are complete.
    results: Option<BTreeMap<PathBuf, String>>,
}

/// Marks the recording in `session` as a simulation's that is under way.
///
/// # Errors
/// The disk.
pub fn begin(session: &Path) -> Result<(), MarkError> {
    write(session, &Mark::default())
}

/// Notes the results that were made of it, so that others under their names are told apart.
///
/// # Errors
/// The disk.
pub fn complete(session: &Path, results: &[PathBuf]) -> Result<(), MarkError> {
    let stands = results.iter().filter(|path| path.is_file());
    let results = stands
        .map(|path| Ok((path.clone(), sha256_of(path).map_err(failed(path))?)))
        .map(|named| named.map(|(path, sum)| (name(&path), sum)))
        .collect::<Result<_, MarkError>>()?;
    write(
        session,
        &Mark {
            results: Some(results),
        },
    )
}

/// The mark does not care where the folder is.
fn name(path: &Path) -> PathBuf {
    path.file_name().map(PathBuf::from).unwrap_or_default()
}

fn write(session: &Path, mark: &Mark) -> Result<(), MarkError> {
    let path = session.join(FILE);
    crate::output::write_json(&path, mark).map_err(|e| failed(&path)(io::Error::other(e)))
}

/// The recording is no longer a simulation's alone.
///
/// # Errors
/// The disk.
pub fn lift(session: &Path) -> Result<(), MarkError> {
    let path = session.join(FILE);
    match std::fs::remove_file(&path) {
        Err(e) if !matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Err(failed(&path)(e))
        }
        _ => Ok(()),
    }
}

/// Whether something of a recording stands in `session`: its first part.
pub fn stands(session: &Path) -> Option<PathBuf> {
    let parts = [
        "session.json",
        "truth.json",
        "camera",
        "light",
        "scan",
        FILE,
    ];
    let mut parts = parts.iter().map(|part| session.join(part));
    parts.find(|part| part.symlink_metadata().is_ok())
}

/// Whether there is anything at all in `session`, but for the lock of who records there.
pub fn used(session: &Path) -> bool {
    match std::fs::read_dir(session) {
        Ok(entries) => entries
            .into_iter()
            .any(|entry| !entry.is_ok_and(|entry| entry.file_name() == lock::FILE)),
        Err(e) => e.kind() != ErrorKind::NotFound,
    }
}

/// Removes a simulation's recording and the results beside it (and not the lock of who records there).
///
/// # Errors
/// Anything there was not written by a simulation (nothing is then removed); the disk.
pub fn clear(session: &Path, results: &[PathBuf]) -> Result<(), MarkError> {
    for path in clearable(session, results)? {
        std::fs::remove_file(path).map_err(failed(path))?;
    }
    let entries = match std::fs::read_dir(session) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(failed(session))?,
    };
    // The mark last: without it nobody would clear what is left.
    let mut marked = None;
    for entry in entries {
        let path = entry.map_err(failed(session))?.path();
        if path.ends_with(FILE) {
            marked = Some(path);
            continue;
        }
        let removed = if path.is_dir() {
            std::fs::remove_dir_all(&path)
        } else if path.ends_with(lock::FILE) {
            // Whoever clears may hold it; another process must not lock a file of its own.
            Ok(())
        } else {
            std::fs::remove_file(&path)
        };
        removed.map_err(failed(&path))?;
    }
    if let Some(path) = marked {
        std::fs::remove_file(&path).map_err(failed(&path))?;
    }
    match std::fs::remove_dir(session) {
        Err(e) if e.kind() != ErrorKind::DirectoryNotEmpty => Err(failed(session)(e)),
        _ => Ok(()),
    }
}

/// Whether [`clear`] would remove everything: the results that stand.
///
/// # Errors
/// Anything there was not written by a simulation; the disk.
pub fn clearable<'r>(
    session: &Path,
    results: &'r [PathBuf],
) -> Result<Vec<&'r PathBuf>, MarkError> {
    let mark = read(session)?;
    let mine = |path: &Path| {
        let known = mark.as_ref().map(|mark| &mark.results);
        Ok(match known {
            None => false,
            // Under way: it began where none of them stood.
            Some(None) => true,
            Some(Some(sums)) => {
                sums.get(&name(path)) == Some(&sha256_of(path).map_err(failed(path))?)
            }
        })
    };
    if session.symlink_metadata().is_ok() && used(session) {
        if mark.is_none() {
            return Err(MarkError::Foreign(session.to_owned()));
        }
        check(session, session)?;
    }
    let stands = results
        .iter()
        .filter(|path| path.symlink_metadata().is_ok());
    let stands: Vec<&PathBuf> = stands.collect();
    for &path in &stands {
        if !mine(path)? {
            return Err(MarkError::Foreign(path.clone()));
        }
    }
    Ok(stands)
}

fn read(session: &Path) -> Result<Option<Mark>, MarkError> {
    let path = session.join(FILE);
    match std::fs::read(&path) {
        Ok(text) => Ok(serde_json::from_slice(&text).ok()),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(e) => Err(failed(&path)(e)),
    }
}

/// Whether everything below `folder` can be a simulation's.
fn check(folder: &Path, session: &Path) -> Result<(), MarkError> {
    for entry in std::fs::read_dir(folder).map_err(failed(folder))? {
        let entry = entry.map_err(failed(folder))?;
        let path = entry.path();
        // A link is neither: what it leads to is somebody's.
        let kind = entry.file_type().map_err(failed(&path))?;
        let inner = path.strip_prefix(session).unwrap_or(&path);
        let image = ["camera", "light", "scan"]
            .iter()
            .any(|part| inner.starts_with(part));
        if kind.is_dir() && image {
            check(&path, session)?;
        } else if !(kind.is_file() && (image && is_of_sweep(&path) || is_notes(inner))) {
            return Err(MarkError::Foreign(path));
        }
    }
    Ok(())
}

fn is_notes(inner: &Path) -> bool {
    ["session.json", "truth.json", FILE, lock::FILE]
        .iter()
        .any(|name| inner == Path::new(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &Path) -> Vec<PathBuf> {
        let mut all = Vec::new();
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                all.extend(files(&path));
            }
            all.push(path);
        }
        all.sort();
        all
    }

    fn refused(session: &Path, results: &[PathBuf], because: &Path) {
        let root = session.parent().unwrap();
        let before = files(root);
        let said = clear(session, results).unwrap_err().to_string();
        assert!(
            said.starts_with(&format!("{}: not written", because.display())),
            "{said}"
        );
        assert_eq!(files(root), before);
    }

    #[test]
    fn only_what_a_simulation_wrote_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let session = dir.path().join("session");
        let results = [dir.path().join("result.json"), dir.path().join("cloud.ply")];
        let put = |inner: &str| {
            let path = session.join(inner);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, inner).unwrap();
            path
        };
        // Nothing at all: nothing to do.
        clear(&session, &results).unwrap();

        // A recording without the mark.
        put("session.json");
        put("camera/00.png");
        refused(&session, &results, &session);
        std::fs::remove_dir_all(&session).unwrap();

        // Somebody's result where no simulation is.
        std::fs::write(&results[0], "mine").unwrap();
        refused(&session, &results, &results[0]);
        std::fs::remove_file(&results[0]).unwrap();

        // A simulation's, and something else in it.
        let simulated = || {
            begin(&session).unwrap();
            for inner in [
                "session.json",
                "truth.json",
                "light/00/off.png",
                "scan/progress.jsonl",
            ] {
                put(inner);
            }
        };
        simulated();
        for other in [
            "notes.txt",
            "light/00/notes.txt",
            "other/00.png",
            "camera/session.json",
        ] {
            let path = put(other);
            let because = if other.starts_with("other") {
                session.join("other")
            } else {
                path.clone()
            };
            refused(&session, &results, &because);
            std::fs::remove_file(&path).unwrap();
            let _ = std::fs::remove_dir(path.parent().unwrap());
        }

        // Complete: its own results go with it, another's of the same name do not.
        std::fs::write(&results[0], "its own").unwrap();
        complete(&session, &results).unwrap();
        std::fs::write(&results[0], "another's").unwrap();
        refused(&session, &results, &results[0]);
        std::fs::write(&results[0], "its own").unwrap();
        std::fs::write(&results[1], "came later").unwrap();
        refused(&session, &results, &results[1]);
        std::fs::remove_file(&results[1]).unwrap();
        std::fs::write(session.join(lock::FILE), "").unwrap();
        assert!(used(&session));
        clear(&session, &results).unwrap();
        assert!(!used(&session));
        assert_eq!(
            files(dir.path()),
            [session.clone(), session.join(lock::FILE)]
        );
        std::fs::remove_dir_all(&session).unwrap();
        assert!(!used(&session));

        // Something else was recorded into it.
        simulated();
        lift(&session).unwrap();
        refused(&session, &results, &session);
    }
}
