//! The host's end of the link to the motion board.
//!
//! ```text
//!  Board (calls that wait) ─► Session (sans-IO) ─► Pipe (serial port, pseudo-terminal, memory)
//! ```
//!
//! [`Session`] knows the rules and no clock, [`Pipe`] moves bytes, [`Board`] waits. On a pipe in
//! real time a thread keeps the heartbeat while nobody calls; the board turns the laser off and
//! stops when it does not hear one.

mod board;
mod error;
mod pipe;
mod scan;
mod session;

use cannula_shared::hello::Identity;

pub use board::{Board, Homed};
pub use error::LinkError;
#[cfg(unix)]
pub(crate) use pipe::open_terminal;
pub use pipe::{Pipe, PortDescription, SerialPipe, ports};
pub use scan::{Scan, ScanEvent};
pub use session::{Counts, Session};

/// Whatever can go wrong here is a [`LinkError`].
pub type Result<T> = std::result::Result<T, LinkError>;

/// A board's number and its firmware's version, for people.
pub fn identity_words(identity: &Identity) -> (String, String) {
    let number = identity.board.iter().map(|b| format!("{b:02x}")).collect();
    let [major, minor, patch] = identity.firmware;
    (number, format!("{major}.{minor}.{patch}"))
}
