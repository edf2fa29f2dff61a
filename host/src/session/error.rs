//! What can be wrong with a recording: one sentence each, with the file and the remedy.

use std::path::PathBuf;

/// Why a session can't be used.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// There is no such folder or no session.json in it.
    #[error("{path}: not found; give the folder that holds session.json", path = path.display())]
    NotFound {
        /// The file looked for.
        path: PathBuf,
    },
    /// The operating system will not read or write it.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not JSON, or not of the session's shape.
    #[error("{path}: not a session file: {reason}; see the session format (cannula-session/1)", path = path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and what.
        reason: String,
    },
    /// A value that can't be.
    #[error("{path}: {what}; {remedy}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Which key, and what is wrong with it.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// An image that session.json names is not there.
    #[error("{path}: image not found; session.json names it: copy it there or take its entry out", path = path.display())]
    MissingImage {
        /// The image.
        path: PathBuf,
    },
    /// An image that can't be decoded.
    #[error("{path}: {reason}; record or copy the image again", path = path.display())]
    BrokenImage {
        /// The image.
        path: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// An image of another size.
    #[error("{path}: {width} × {height} pixels where session.json says {want_width} × {want_height}; correct \"image\" there or record with one image size", path = path.display())]
    WrongSize {
        /// The image.
        path: PathBuf,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// The session's width.
        want_width: u32,
        /// The session's height.
        want_height: u32,
    },
    /// A command needs a part that the session does not have.
    #[error("{path}: no \"{part}\" in it; {remedy}", path = path.display())]
    MissingPart {
        /// session.json.
        path: PathBuf,
        /// The key.
        part: &'static str,
        /// What to do.
        remedy: &'static str,
    },
}
