//! The files that a job leaves: calibration.json (cannula-calibration/1), result.json
//! (cannula-result/1) and the cloud, each written whole or not at all.

mod calibration;
mod result;
mod trust;

pub use calibration::{CalibrationFile, LightFile, ViewFile, read_calibration};
pub use result::{AngleSource, CalibrationSource, ResultFile, ScanProvenance};
pub use trust::{
    LOOSE_AXIS_DEG, LOOSE_CORNERS_PX, LOOSE_ENTRY_MM, LOOSE_OFFSETS_MM, LOOSE_PLANES_MM, OLD_DAYS,
    REFUSED_CORNERS_PX, REFUSED_DAYS, REFUSED_PLANES_MM, age, age_at_scan, age_words, all_checks,
    calibration_checks, moment, seconds,
};

use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Why a file was not written or can't be used.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The operating system will not read or write it.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Not a calibration.
    #[error("{path}: not a calibration file: {reason}; make one with `cannula calibrate`", path = path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and what.
        reason: String,
    },
    /// A calibration with values that can't be.
    #[error("{path}: {what}; calibrate again", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
}

/// Writes a file through a temporary one beside it, so that it stands whole or not at all. Its
/// folder is made.
pub fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), OutputError> {
    let fail = |source| OutputError::Io {
        path: path.to_owned(),
        source,
    };
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(fail)?;
    if path.is_dir() {
        return Err(fail(io::Error::other("is a folder; give a file name")));
    }
    let mut file = tempfile::Builder::new()
        .prefix(".cannula-")
        .tempfile_in(folder)
        .map_err(fail)?;
    {
        let mut buffer = io::BufWriter::new(file.as_file_mut());
        write(&mut buffer)
            .and_then(|()| buffer.flush())
            .map_err(fail)?;
    }
    // A temporary file is its owner's alone; a result is for whoever may read the folder.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::Permissions::from_mode(0o644);
        file.as_file().set_permissions(mode).map_err(fail)?;
    }
    file.persist(path).map_err(|e| fail(e.error))?;
    Ok(())
}

/// Writes an object as JSON, whole or not at all.
pub fn write_json(path: &Path, object: &impl serde::Serialize) -> Result<(), OutputError> {
    write_whole(path, |out| {
        let text = serde_json::to_string_pretty(object)?;
        out.write_all(numbers_in_one_line(&text).as_bytes())?;
        out.write_all(b"\n")
    })
}

/// Indented JSON with every array of mere numbers in one line: readable, and half as long.
fn numbers_in_one_line(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut quoted) = (text, false);
    while let Some(c) = rest.chars().next() {
        let inside = rest.get(1..).unwrap_or_default();
        if c == '[' && !quoted {
            let mere = |c: char| c.is_ascii_digit() || "+-.eE, \n".contains(c);
            let end = inside.find(|c: char| !mere(c)).unwrap_or(inside.len());
            if end > 0 && inside[end..].starts_with(']') {
                let numbers: Vec<&str> = inside[..end].split(',').map(str::trim).collect();
                out.push('[');
                out.push_str(&numbers.join(", "));
                rest = &inside[end..];
                continue;
            }
        }
        // Within a string a backslash takes the next character with it.
        let long = match c {
            '\\' if quoted => 1 + inside.chars().next().map_or(0, char::len_utf8),
            c => c.len_utf8(),
        };
        if c == '"' {
            quoted = !quoted;
        }
        out.push_str(&rest[..long]);
        rest = &rest[long..];
    }
    out
}

/// Three numbers of a vector.
fn three(v: &crate::geometry::Vector3) -> [f64; 3] {
    [v.x, v.y, v.z]
}

/// The rows of a matrix.
fn rows(m: &crate::geometry::Matrix3) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)]))
}

#[cfg(test)]
mod tests;
