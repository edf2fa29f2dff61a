//! A recording on disk: `session.json` and the images that it names.
//!
//! [`Session::open`] reads and checks the file and every image's header; images are decoded one by
//! one by [`Session::luma`], [`Session::laser`] or [`Session::both`], on as many threads as the
//! caller has, so that memory stays bounded by the number of threads.

mod check;
mod digest;
mod error;
mod load;
mod model;
mod write;

pub use check::{check, parse};
pub use digest::{RecordingDigest, sha256_of};
pub use error::SessionError;
pub use load::{Depth, Header, Raw, decode, decode_bytes, header};
pub use model::{
    BoardSpec, CameraView, Colour, Entry, FORMAT, Frame, ImageSize, Laser, LightPose, Manifest,
    Scan,
};
pub(crate) use write::write_checked;
pub use write::{write, write_png};

use crate::image::{Image, Pixel};
use std::path::{Path, PathBuf};

/// A session that was opened and checked.
#[derive(Clone, Debug)]
pub struct Session {
    file: PathBuf,
    root: PathBuf,
    /// What session.json says.
    pub manifest: Manifest,
    /// One depth for all images.
    pub depth: Depth,
    /// session.json as it stands.
    said: std::sync::Arc<[u8]>,
    seen: digest::Seen,
}

impl Session {
    /// Opens a session folder (or its session.json), checks the file and that every image is there
    /// with the right size.
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        let file = if path.is_dir() {
            path.join("session.json")
        } else {
            path.to_owned()
        };
        let text = std::fs::read(&file).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => {
                SessionError::NotFound { path: file.clone() }
            }
            _ => SessionError::Io {
                path: file.clone(),
                source,
            },
        })?;
        let manifest = parse(&text, &file)?;
        let root = file.parent().unwrap_or(Path::new("")).to_owned();
        let mut session = Self {
            file,
            root,
            manifest,
            depth: Depth::Eight,
            said: text.into(),
            seen: digest::Seen::default(),
        };
        session.check_images()?;
        Ok(session)
    }

    fn check_images(&mut self) -> Result<(), SessionError> {
        for name in self.manifest.images() {
            let path = self.path(name);
            let header = load::header(&path)?;
            self.check_size(&path, header.width, header.height)?;
            if header.depth == Depth::Sixteen {
                self.depth = Depth::Sixteen;
            }
        }
        Ok(())
    }

    fn check_size(&self, path: &Path, width: u32, height: u32) -> Result<(), SessionError> {
        let want = self.manifest.image;
        if (width, height) == (want.width, want.height) {
            return Ok(());
        }
        Err(SessionError::WrongSize {
            path: path.to_owned(),
            width,
            height,
            want_width: want.width,
            want_height: want.height,
        })
    }

    /// session.json itself.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// For a reader: the folder's name, or the one above where it is called "session".
    pub fn name(&self) -> String {
        let folder = self.folder();
        let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
        let named = |p: &Path| Some(p.file_name()?.to_string_lossy().into_owned());
        let name = match named(&whole) {
            Some(own) if own == "session" => whole.parent().and_then(named).or(Some(own)),
            own => own,
        };
        name.unwrap_or_else(|| folder.display().to_string())
    }

    /// The folder that session.json lies in.
    pub fn folder(&self) -> &Path {
        match self.file.parent() {
            Some(p) if !p.as_os_str().is_empty() => p,
            _ => Path::new("."),
        }
    }

    /// Where an image that session.json names is.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// The error for a part that a command needs and the session does not have.
    pub fn missing(&self, part: &'static str, remedy: &'static str) -> SessionError {
        SessionError::MissingPart {
            path: self.file.clone(),
            part,
            remedy,
        }
    }

    fn decode(&self, name: &str) -> Result<(Raw, PathBuf), SessionError> {
        let path = self.path(name);
        let bytes = load::read(&path)?;
        self.seen.note(name, &bytes);
        let raw = load::decode_bytes(&bytes, &path)?;
        self.check_size(&path, raw.width, raw.height)?;
        Ok((raw, path))
    }

    /// An image's brightness.
    pub fn luma<P: Pixel>(&self, name: &str) -> Result<Image<P>, SessionError> {
        let (raw, path) = self.decode(name)?;
        raw.luma().ok_or_else(|| incomplete(path))
    }

    /// An image as the stripe is sought in it.
    pub fn laser<P: Pixel>(&self, name: &str) -> Result<Image<P>, SessionError> {
        let (raw, path) = self.decode(name)?;
        raw.laser(self.colour()).ok_or_else(|| incomplete(path))
    }

    /// Both of one image, decoded once; the second is `None` where they are the same.
    pub fn both<P: Pixel>(&self, name: &str) -> Result<(Image<P>, Option<Image<P>>), SessionError> {
        let (raw, path) = self.decode(name)?;
        let laser = match self.colour() {
            Some(colour) if raw.is_colour() => Some(
                raw.clone()
                    .laser(Some(colour))
                    .ok_or_else(|| incomplete(path.clone()))?,
            ),
            _ => None,
        };
        Ok((raw.luma().ok_or_else(|| incomplete(path))?, laser))
    }

    fn colour(&self) -> Option<Colour> {
        self.manifest.laser.and_then(|l| l.colour)
    }
}

fn incomplete(path: PathBuf) -> SessionError {
    SessionError::BrokenImage {
        path,
        reason: "the image is not whole".to_owned(),
    }
}

#[cfg(test)]
mod tests;
