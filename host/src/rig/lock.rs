//! One process at a time records into a folder. The system releases the lock when its process ends,
//! however it ends.

use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The file that is locked, in the recording's folder. It stays: who removed it could remove one that
/// somebody else has locked since.
pub const FILE: &str = ".lock";

/// Why a folder can't be recorded into.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process does.
    #[error("{folder}: another cannula process is recording into this folder: wait for its end, or give another folder", folder = .0.display())]
    Taken(PathBuf),
    /// The disk.
    #[error("{path}: can't be locked ({source})", path = path.display())]
    Io {
        /// The file, or its folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// The right to record into a folder, while it lives.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

impl Lock {
    /// Takes it; the folder is made if it is not there.
    ///
    /// # Errors
    /// Another process has it; the disk.
    pub fn take(folder: &Path) -> Result<Self, LockError> {
        let path = folder.join(FILE);
        let fail = |source| LockError::Io {
            path: path.clone(),
            source,
        };
        std::fs::create_dir_all(folder).map_err(fail)?;
        let file = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .map_err(fail)?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(LockError::Taken(folder.to_owned())),
            // A file system without locks (some network ones) is no reason not to record.
            Err(TryLockError::Error(e)) if e.kind() != ErrorKind::Unsupported => Err(fail(e)),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(Self { _file: file }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("new/session");
        let first = Lock::take(&folder).unwrap();
        let said = Lock::take(&folder).unwrap_err().to_string();
        assert!(said.contains("another cannula process"), "{said}");
        // Another folder is another matter.
        Lock::take(dir.path()).unwrap();
        drop(first);
        Lock::take(&folder).unwrap();
    }
}
