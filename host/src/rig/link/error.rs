//! What can go wrong between host and board.

use cannula_shared::error::{Fault, Refusal};
use cannula_shared::hello::ResetReason;
use thiserror::Error;

/// An error of the link or of the board behind it.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The port cannot be opened.
    #[error(
        "{path}: cannot open the port: {source}; `cannula ports` lists the ports, and no other program may have it open"
    )]
    Open {
        /// The port.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The port failed while in use.
    #[error("the port to the motion board failed: {0}; is it still plugged in?")]
    Io(#[from] std::io::Error),
    /// Nobody answered the hello.
    #[error(
        "no motion board answered within {seconds} s: is this the right port, and does the board run Cannula's firmware?"
    )]
    NoHello {
        /// How long was waited.
        seconds: f64,
    },
    /// The board speaks another protocol.
    #[error(
        "the board speaks protocol {board}, this program {host}: flash the firmware that belongs to this version"
    )]
    Version {
        /// The board's.
        board: u16,
        /// Ours.
        host: u16,
    },
    /// The board's messages differ.
    #[error(
        "the board's firmware {}.{}.{} has other messages (schema {board:016x}) than this program ({host:016x}): flash the firmware that belongs to this version",
        firmware[0], firmware[1], firmware[2]
    )]
    Schema {
        /// The board's.
        board: u64,
        /// Ours.
        host: u64,
        /// The board's firmware version.
        firmware: [u8; 3],
    },
    /// No answer in time.
    #[error("the motion board did not answer within {seconds} s while {doing}")]
    Timeout {
        /// What was waited for.
        doing: &'static str,
        /// How long.
        seconds: f64,
    },
    /// A board that has work to do says nothing any more.
    #[error(
        "the motion board has said nothing for {seconds:.1} s while {doing}: it turns the laser off and stops by itself once it hears no host; look at the slide, then check the board's cable and power"
    )]
    Mute {
        /// What it was to do.
        doing: &'static str,
        /// How long it was silent.
        seconds: f64,
    },
    /// The board refused a command.
    #[error("the motion board refused: {0}")]
    Refused(Refusal),
    /// The board is in fault.
    #[error("the motion board stopped: {0}")]
    Fault(Fault),
    /// The board takes no command because of a fault of before.
    #[error("the motion board is in fault ({0}): mend the cause, then `cannula motion rearm`")]
    InFault(Fault),
    /// The job was stopped by command.
    #[error("stopped by command")]
    Stopped,
    /// The board started anew in the middle of a session.
    #[error(
        "the motion board restarted in the middle of the session ({0}): its position is unknown, home again"
    )]
    Restarted(ResetReason),
    /// Another host has taken the board over.
    #[error("another program has opened a session with the motion board")]
    TakenOver,
    /// A command is still waiting for its reply.
    #[error("a command is still waiting for its reply")]
    Busy,
    /// The board answered something that does not belong to the command.
    #[error("the motion board answered out of turn: {0}")]
    Unexpected(String),
    /// The events of a scan do not add up to its summary.
    #[error("the scan's ledger does not add up: {0}")]
    Ledger(String),
}
