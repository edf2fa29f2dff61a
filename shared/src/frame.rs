//! Frames on the wire, for both directions, sans-IO.
//!
//! ```text
//!  0      layout version, 1 for ever
//!  1      kind
//!  2..4   session        } little-endian
//!  4..8   sequence       }
//!  8..12  acknowledge    }
//! 12..n   payload
//!  n..n+4 CRC-32 of all before
//! ```
//!
//! COBS-encoded, ended by one zero byte. A decoder that has lost its place finds it again at the
//! next zero; whatever does not check is dropped and counted, never acted on.
//!
//! | kind | from | sequence | acknowledge | payload |
//! |---|---|---|---|---|
//! | hello | both | 0 | 0 | see [`crate::hello`] |
//! | command | host | the command's number, from 1 | last event received in order | [`Command`](crate::message::Command) |
//! | reply | board | the command's number | 0 | [`Reply`](crate::message::Reply) |
//! | event | board | the event's counter, from 1 since boot | 0 | [`Event`](crate::message::Event) |
//! | telemetry | board | 0 | 0 | [`Telemetry`](crate::message::Telemetry) |
//! | alive | host | 0 | last event received in order | none |
//!
//! The host sends one command at a time and repeats it until its reply comes; the board carries
//! out the number that follows the last one, answers a repetition of the last from memory, and
//! ignores every other. Events are repeated until acknowledged. Frames of another session are
//! ignored, so that nothing of a host's former life is carried out.

use crate::cobs;
use crate::crc::crc32;

/// The layout's version.
pub const LAYOUT: u8 = 1;
/// The longest payload.
pub const MAX_PAYLOAD: usize = 176;
const HEADER: usize = 12;
const TRAILER: usize = 4;
/// The longest frame before encoding.
pub const MAX_RAW: usize = HEADER + MAX_PAYLOAD + TRAILER;
/// The longest frame on the wire, with its zero.
pub const MAX_WIRE: usize = cobs::max_encoded(MAX_RAW) + 1;

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// A greeting.
    Hello = 0,
    /// A command.
    Command = 1,
    /// The answer to a command.
    Reply = 2,
    /// An event that is to be acknowledged.
    Event = 3,
    /// A position that may be lost.
    Telemetry = 4,
    /// The host lives, and has received events.
    Alive = 5,
}

impl Kind {
    const fn from_u8(value: u8) -> Option<Self> {
        Some(match value {
            0 => Kind::Hello,
            1 => Kind::Command,
            2 => Kind::Reply,
            3 => Kind::Event,
            4 => Kind::Telemetry,
            5 => Kind::Alive,
            _ => return None,
        })
    }
}

/// A frame's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// What it is.
    pub kind: Kind,
    /// The host's session; 0 before any.
    pub session: u16,
    /// Number of the command, reply or event.
    pub sequence: u32,
    /// Last event received in order.
    pub acknowledge: u32,
}

/// Writes a frame with its ending zero into `out`; its length. `None` if the payload is too long
/// or `out` shorter than [`MAX_WIRE`] by need.
pub fn encode(header: Header, payload: &[u8], out: &mut [u8]) -> Option<usize> {
    let mut raw = [0; MAX_RAW];
    let body = HEADER + payload.len();
    let fields: [&[u8]; 6] = [
        &[LAYOUT, header.kind as u8],
        &header.session.to_le_bytes(),
        &header.sequence.to_le_bytes(),
        &header.acknowledge.to_le_bytes(),
        payload,
        &[],
    ];
    if payload.len() > MAX_PAYLOAD {
        return None;
    }
    for (to, from) in raw.iter_mut().zip(fields.into_iter().flatten()) {
        *to = *from;
    }
    let crc = crc32(raw.get(..body)?);
    raw.get_mut(body..body + TRAILER)?
        .copy_from_slice(&crc.to_le_bytes());
    let length = cobs::encode(raw.get(..body + TRAILER)?, out)?;
    *out.get_mut(length)? = 0;
    Some(length + 1)
}

/// Writes a frame whose payload is a postcard message.
pub fn encode_message<M: serde::Serialize>(
    header: Header,
    message: &M,
    out: &mut [u8],
) -> Option<usize> {
    let mut payload = [0; MAX_PAYLOAD];
    let used = postcard::to_slice(message, &mut payload).ok()?;
    encode(header, used, out)
}

/// Reads a postcard message; nothing may be left over.
pub fn decode_message<'a, M: serde::Deserialize<'a>>(payload: &'a [u8]) -> Option<M> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Some(message),
        _ => None,
    }
}

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_WIRE],
    used: usize,
    overrun: bool,
    bad: u32,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the start of a stream.
    pub const fn new() -> Self {
        Decoder {
            buffer: [0; MAX_WIRE],
            used: 0,
            overrun: false,
            bad: 0,
        }
    }

    /// Takes one byte; a frame, if it was the last of a sound one.
    pub fn push(&mut self, byte: u8) -> Option<(Header, &[u8])> {
        if byte != 0 {
            match self.buffer.get_mut(self.used) {
                Some(slot) => {
                    *slot = byte;
                    self.used += 1;
                }
                None => self.overrun = true,
            }
            return None;
        }
        let used = core::mem::take(&mut self.used);
        let overrun = core::mem::take(&mut self.overrun);
        // Zeros between frames are no damage.
        if used == 0 {
            return None;
        }
        let frame = match self.buffer.get_mut(..used) {
            Some(encoded) if !overrun => read(encoded),
            _ => None,
        };
        if frame.is_none() {
            self.bad = self.bad.saturating_add(1);
        }
        frame
    }

    /// Takes bytes until a frame is complete: how many were taken, and the frame.
    pub fn feed(&mut self, bytes: &[u8]) -> (usize, Option<(Header, usize)>) {
        for (i, &byte) in bytes.iter().enumerate() {
            if let Some((header, payload)) = self.push(byte) {
                let length = payload.len();
                return (i + 1, Some((header, length)));
            }
        }
        (bytes.len(), None)
    }

    /// The payload of the frame that [`Self::feed`] has just announced, by its length.
    pub fn payload(&self, length: usize) -> &[u8] {
        self.buffer.get(HEADER..HEADER + length).unwrap_or(&[])
    }

    /// How many frames came damaged.
    pub const fn bad_frames(&self) -> u32 {
        self.bad
    }

    /// Forgets a frame that has begun (a new connection).
    pub fn reset(&mut self) {
        self.used = 0;
        self.overrun = false;
    }
}

fn read(encoded: &mut [u8]) -> Option<(Header, &[u8])> {
    let length = cobs::decode_in_place(encoded)?;
    let raw = encoded.get(..length)?;
    let body = length.checked_sub(TRAILER)?;
    let crc = u32::from_le_bytes(raw.get(body..)?.try_into().ok()?);
    let (raw, payload) = (raw.get(..body)?, raw.get(HEADER..body)?);
    if crc32(raw) != crc {
        return None;
    }
    let &[LAYOUT, kind, s0, s1, q0, q1, q2, q3, a0, a1, a2, a3, ..] = raw else {
        return None;
    };
    let header = Header {
        kind: Kind::from_u8(kind)?,
        session: u16::from_le_bytes([s0, s1]),
        sequence: u32::from_le_bytes([q0, q1, q2, q3]),
        acknowledge: u32::from_le_bytes([a0, a1, a2, a3]),
    };
    Some((header, payload))
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn kinds() -> impl Strategy<Value = Kind> {
        (0u8..6).prop_map(|k| Kind::from_u8(k).unwrap())
    }

    fn headers() -> impl Strategy<Value = Header> {
        (kinds(), any::<u16>(), any::<u32>(), any::<u32>()).prop_map(
            |(kind, session, sequence, acknowledge)| Header {
                kind,
                session,
                sequence,
                acknowledge,
            },
        )
    }

    fn wire(header: Header, payload: &[u8]) -> Vec<u8> {
        let mut out = [0; MAX_WIRE];
        let n = encode(header, payload, &mut out).unwrap();
        out[..n].to_vec()
    }

    fn all(decoder: &mut Decoder, bytes: &[u8]) -> Vec<(Header, Vec<u8>)> {
        bytes
            .iter()
            .filter_map(|&b| decoder.push(b).map(|(h, p)| (h, p.to_vec())))
            .collect()
    }

    proptest! {
        #[test]
        fn round_trip_after_any_rubbish(
            header in headers(),
            payload in proptest::collection::vec(any::<u8>(), 0..=MAX_PAYLOAD),
            rubbish in proptest::collection::vec(any::<u8>(), 0..500),
        ) {
            let mut stream = rubbish;
            stream.push(0);
            let bytes = wire(header, &payload);
            prop_assert!(bytes.len() <= MAX_WIRE);
            stream.extend_from_slice(&bytes);
            let mut decoder = Decoder::new();
            prop_assert_eq!(all(&mut decoder, &stream).pop(), Some((header, payload)));
        }

        #[test]
        fn a_changed_byte_is_noticed(
            header in headers(),
            payload in proptest::collection::vec(any::<u8>(), 0..=MAX_PAYLOAD),
            at in any::<prop::sample::Index>(),
            flip in 1u8..,
        ) {
            let mut bytes = wire(header, &payload);
            let last = bytes.len() - 1;
            bytes[at.index(last)] ^= flip;
            let mut decoder = Decoder::new();
            let frames = all(&mut decoder, &bytes);
            prop_assert!(frames.is_empty(), "{:?}", frames);
            prop_assert!(decoder.bad_frames() >= 1);
        }
    }

    #[test]
    fn overlong_payloads_and_short_buffers_are_refused() {
        let header = Header {
            kind: Kind::Alive,
            session: 1,
            sequence: 0,
            acknowledge: 2,
        };
        assert_eq!(encode(header, &[1; MAX_PAYLOAD + 1], &mut [0; 400]), None);
        assert_eq!(encode(header, &[1; 20], &mut [0; 30]), None);
        let bytes = wire(header, &[255; MAX_PAYLOAD]);
        assert!(bytes.len() <= MAX_WIRE);
    }

    #[test]
    fn feed_hands_out_frames_one_by_one() {
        let header = |sequence| Header {
            kind: Kind::Event,
            session: 9,
            sequence,
            acknowledge: 0,
        };
        let mut stream = wire(header(1), b"first");
        stream.extend(wire(header(2), b"second"));
        let mut decoder = Decoder::new();
        let mut rest = &stream[..];
        let mut got = Vec::new();
        while !rest.is_empty() {
            let (used, frame) = decoder.feed(rest);
            rest = &rest[used..];
            if let Some((h, n)) = frame {
                got.push((h.sequence, decoder.payload(n).to_vec()));
            }
        }
        assert_eq!(got, [(1, b"first".to_vec()), (2, b"second".to_vec())]);
    }
}
