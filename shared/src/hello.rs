//! The greeting that never changes, whatever becomes of the messages, so that any host can say
//! why it does not understand any board.
//!
//! The host asks with an empty hello frame that carries a fresh session number; the board starts
//! that session (commands count from 1 again) and answers with this payload, little-endian:
//!
//! ```text
//!  0..4   "CNLA"
//!  4..6   protocol version
//!  6..14  schema hash
//! 14..22  board identity (the flash chip's unique number)
//! 22..25  firmware version: major, minor, patch
//! 25..29  system clock, Hz
//! 29      reset reason
//! 30..38  time since boot, µs
//! 38..42  counter of the oldest event that is kept (of the next one, if none is)
//! ```
//!
//! Bytes may be added at the end; readers ignore what they do not know. None may ever move.
//! A board also sends it unasked once after its boot, with session 0: a host that is connected
//! learns of the restart.

use crate::message::SCHEMA;
use crate::units::{CLOCK_HZ, Micros};
use core::fmt;

/// Version of the protocol around the messages: sequence, acknowledgement, sessions.
pub const PROTOCOL: u16 = 1;
/// Length of the payload today.
pub const HELLO_LEN: usize = 42;

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ResetReason {
    /// The board does not know.
    Unknown = 0,
    /// Power came on.
    PowerOn = 1,
    /// The reset pin, or a brown-out.
    Pin = 2,
    /// The watchdog: the program hung.
    Watchdog = 3,
    /// The program asked for it.
    Software = 4,
    /// The program panicked.
    Panic = 5,
    /// The debugger.
    Debugger = 6,
}

impl ResetReason {
    /// From the wire; numbers of the future are unknown.
    pub const fn from_u8(value: u8) -> Self {
        match value {
            1 => ResetReason::PowerOn,
            2 => ResetReason::Pin,
            3 => ResetReason::Watchdog,
            4 => ResetReason::Software,
            5 => ResetReason::Panic,
            6 => ResetReason::Debugger,
            _ => ResetReason::Unknown,
        }
    }
}

impl fmt::Display for ResetReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ResetReason::Unknown => "unknown",
            ResetReason::PowerOn => "power on",
            ResetReason::Pin => "reset pin or brown-out",
            ResetReason::Watchdog => "watchdog: the program hung",
            ResetReason::Software => "asked for by the program",
            ResetReason::Panic => "panic",
            ResetReason::Debugger => "debugger",
        })
    }
}

/// What the board is; fixed for its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The flash chip's unique number, or whatever tells boards apart.
    pub board: [u8; 8],
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
}

/// The greeting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Protocol version, [`PROTOCOL`].
    pub protocol: u16,
    /// Schema hash, [`SCHEMA`].
    pub schema: u64,
    /// The board.
    pub identity: Identity,
    /// System clock, Hz.
    pub clock_hz: u32,
    /// Why it started.
    pub reset: ResetReason,
    /// Time since boot.
    pub uptime: Micros,
    /// Counter of the oldest event kept, or of the next one.
    pub first_event: u32,
}

const MAGIC: [u8; 4] = *b"CNLA";

impl Hello {
    /// The greeting of this build.
    pub const fn of(
        identity: Identity,
        reset: ResetReason,
        uptime: Micros,
        first_event: u32,
    ) -> Self {
        Hello {
            protocol: PROTOCOL,
            schema: SCHEMA,
            identity,
            clock_hz: CLOCK_HZ,
            reset,
            uptime,
            first_event,
        }
    }

    /// The payload.
    pub fn encode(&self) -> [u8; HELLO_LEN] {
        let mut out = [0; HELLO_LEN];
        let fields: [&[u8]; 9] = [
            &MAGIC,
            &self.protocol.to_le_bytes(),
            &self.schema.to_le_bytes(),
            &self.identity.board,
            &self.identity.firmware,
            &self.clock_hz.to_le_bytes(),
            &[self.reset as u8],
            &self.uptime.0.to_le_bytes(),
            &self.first_event.to_le_bytes(),
        ];
        for (to, from) in out.iter_mut().zip(fields.into_iter().flatten()) {
            *to = *from;
        }
        out
    }

    /// Reads a payload; `None` if it is no greeting.
    pub fn decode(payload: &[u8]) -> Option<Self> {
        fn take<const N: usize>(payload: &[u8], at: usize) -> Option<[u8; N]> {
            payload.get(at..at + N)?.try_into().ok()
        }
        if take::<4>(payload, 0)? != MAGIC {
            return None;
        }
        Some(Hello {
            protocol: u16::from_le_bytes(take(payload, 4)?),
            schema: u64::from_le_bytes(take(payload, 6)?),
            identity: Identity {
                board: take(payload, 14)?,
                firmware: take(payload, 22)?,
            },
            clock_hz: u32::from_le_bytes(take(payload, 25)?),
            reset: ResetReason::from_u8(take::<1>(payload, 29)?[0]),
            uptime: Micros(u64::from_le_bytes(take(payload, 30)?)),
            first_event: u32::from_le_bytes(take(payload, 38)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layout_of_today_and_of_every_day() {
        let hello = Hello {
            protocol: 0x0201,
            schema: 0x1817_1615_1413_1211,
            identity: Identity {
                board: *b"BOARD-ID",
                firmware: [1, 2, 3],
            },
            clock_hz: 125_000_000,
            reset: ResetReason::Watchdog,
            uptime: Micros(0x0807_0605_0403_0201),
            first_event: 0x2423_2221,
        };
        let bytes = hello.encode();
        let expected: [u8; HELLO_LEN] = [
            b'C', b'N', b'L', b'A', 0x01, 0x02, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18,
            b'B', b'O', b'A', b'R', b'D', b'-', b'I', b'D', 1, 2, 3, 0x40, 0x59, 0x73, 0x07, 3, 1,
            2, 3, 4, 5, 6, 7, 8, 0x21, 0x22, 0x23, 0x24,
        ];
        assert_eq!(bytes, expected);
        assert_eq!(Hello::decode(&bytes), Some(hello));
        let mut longer = [0xaa; HELLO_LEN + 5];
        longer[..HELLO_LEN].copy_from_slice(&bytes);
        assert_eq!(
            Hello::decode(&longer),
            Some(hello),
            "a later board adds bytes"
        );
        assert_eq!(Hello::decode(&bytes[..HELLO_LEN - 1]), None);
        assert_eq!(Hello::decode(b"OTHER"), None);
        for reason in 0..=255 {
            let r = ResetReason::from_u8(reason);
            assert!(r as u8 == reason || r == ResetReason::Unknown);
        }
    }
}
