//! Which recording a result was made from: one digest of session.json and the images that took part.
//!
//! SHA-256 over the bytes of session.json and then, for each image in the manifest's order, a line
//! "name, length in bytes, CRC-32 of the file in hexadecimal", parted by tabs and ended by a
//! newline. A CRC tells any mix-up or damage and costs 2 ms for a recording of 50 MB, whose bytes are in
//! the cache when they are decoded; hashing them by SHA-256 would take five to fifty times as long. So
//! it is no protection against forgery.

use super::{Session, SessionError};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// What a recording is told by.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingDigest {
    /// SHA-256, in hexadecimal, over the bytes of session.json and then, for each image in the
    /// manifest's order, a line "name, length in bytes, CRC-32 of the file in hexadecimal", parted by
    /// tabs and ended by a newline.
    pub sha256: String,
    /// Images in it.
    pub images: usize,
}

/// Length and CRC-32 of each image that was read, by name.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen(Arc<Mutex<BTreeMap<String, (usize, u32)>>>);

impl Seen {
    /// Keeps what tells an image. One that is read again is not looked at again.
    pub fn note(&self, name: &str, bytes: &[u8]) {
        if self.of(name).is_some() {
            return;
        }
        let told = (bytes.len(), crc32fast::hash(bytes));
        if let Ok(mut all) = self.0.lock() {
            all.insert(name.to_owned(), told);
        }
    }

    fn of(&self, name: &str) -> Option<(usize, u32)> {
        self.0.lock().ok()?.get(name).copied()
    }
}

impl Session {
    /// The digest of session.json and of these of its images, in the order given; images that have
    /// not been read yet are read.
    ///
    /// # Errors
    /// An image that can't be read.
    pub fn digest<'a>(
        &self,
        images: impl IntoIterator<Item = &'a str>,
    ) -> Result<RecordingDigest, SessionError> {
        let mut hash = Sha256::new_with_prefix(&*self.said);
        let mut count = 0;
        for name in images {
            let (length, crc) = match self.seen.of(name) {
                Some(told) => told,
                None => {
                    self.seen.note(name, &super::load::read(&self.path(name))?);
                    self.seen.of(name).unwrap_or_default()
                }
            };
            hash.update(format!("{name}\t{length}\t{crc:08x}\n"));
            count += 1;
        }
        Ok(RecordingDigest {
            sha256: hexadecimal(&hash.finalize()),
            images: count,
        })
    }
}

/// SHA-256 of a file, in hexadecimal.
///
/// # Errors
/// The file can't be read.
pub fn sha256_of(path: &Path) -> std::io::Result<String> {
    Ok(hexadecimal(&Sha256::digest(std::fs::read(path)?)))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn copy(to: &Path) {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tiny-1001");
        let manifest: serde_json::Value =
            serde_json::from_slice(&fs::read(from.join("session.json")).unwrap()).unwrap();
        for frame in manifest["scan"]["frames"].as_array().unwrap() {
            let name = frame["image"].as_str().unwrap();
            fs::create_dir_all(to.join(name).parent().unwrap()).unwrap();
            fs::copy(from.join(name), to.join(name)).unwrap();
        }
        let scan = serde_json::json!({
            "format": manifest["format"], "image": manifest["image"],
            "scan": { "frames": manifest["scan"]["frames"] },
        });
        fs::write(to.join("session.json"), scan.to_string()).unwrap();
    }

    /// Against known digests of the empty file and of "abc" (FIPS 180-4).
    #[test]
    fn sha_256_is_the_standards() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let of = |text: &str| {
            fs::write(file.path(), text).unwrap();
            sha256_of(file.path()).unwrap()
        };
        assert_eq!(
            of("abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        assert_eq!(
            of(""),
            "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
        );
    }

    #[test]
    fn any_changed_byte_changes_it_and_reading_first_does_not() {
        let folder = tempfile::tempdir().unwrap();
        copy(folder.path());
        let digest = || {
            let session = Session::open(folder.path()).unwrap();
            session.digest(session.manifest.images()).unwrap()
        };
        let whole = digest();
        let session = Session::open(folder.path()).unwrap();
        let names: Vec<&str> = session.manifest.images().collect();
        assert_eq!((whole.images, whole.sha256.len()), (names.len(), 64));
        // The same when the images were decoded before, and of a part another.
        for name in &names {
            session.laser::<u8>(name).unwrap();
        }
        assert_eq!(session.digest(session.manifest.images()).unwrap(), whole);
        let part = session.digest(names.iter().skip(1).copied()).unwrap();
        assert_ne!(part.sha256, whole.sha256);
        // One bit of one image; then one blank in session.json.
        let image = session.path(names[3]);
        let sound = fs::read(&image).unwrap();
        let mut bytes = sound.clone();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&image, bytes).unwrap();
        assert_ne!(digest().sha256, whole.sha256);
        fs::write(&image, sound).unwrap();
        assert_eq!(digest(), whole);
        let mut text = fs::read(session.file()).unwrap();
        text.push(b' ');
        fs::write(session.file(), text).unwrap();
        assert_ne!(digest().sha256, whole.sha256);
    }
}
