//! The decoder against arbitrary bytes: a bounded number of inputs, the same each time. It must
//! neither panic nor accept what was not sent, and it must find its place again.

use cannula_shared::frame::{self, Decoder, Header, Kind, MAX_PAYLOAD, MAX_WIRE};
use cannula_shared::hello::Hello;
use cannula_shared::message::{Command, Event, Reply, Telemetry};

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

fn decode_all(payload: &[u8]) {
    let _ = frame::decode_message::<Command>(payload);
    let _ = frame::decode_message::<Reply>(payload);
    let _ = frame::decode_message::<Event>(payload);
    let _ = frame::decode_message::<Telemetry>(payload);
    let _ = Hello::decode(payload);
}

/// A million inputs: random, mutated frames, cut frames, frames glued together. After each, a
/// sound frame must come through.
#[test]
fn a_million_inputs() {
    let mut random = Random(0xC0B5);
    let mut decoder = Decoder::new();
    let mut accepted = 0u64;
    let sound = |sequence: u32, payload: &[u8]| {
        let mut out = [0; MAX_WIRE];
        let header = Header {
            kind: Kind::Event,
            session: 7,
            sequence,
            acknowledge: 1,
        };
        let n = frame::encode(header, payload, &mut out).expect("fits");
        (out, n)
    };
    let mut input = [0u8; 2 * MAX_WIRE];
    for round in 0..1_000_000u32 {
        let length = match round % 4 {
            // Arbitrary bytes, with many zeros.
            0 => {
                let n = random.below(64);
                for b in &mut input[..n] {
                    let r = random.next();
                    *b = if r & 7 == 0 { 0 } else { (r >> 8) as u8 };
                }
                n
            }
            // A sound frame with one to four bytes changed, dropped or added.
            1 | 2 => {
                let payload_length = random.below(40);
                let mut payload = [0u8; 40];
                payload.iter_mut().for_each(|b| *b = random.next() as u8);
                let (bytes, mut n) = sound(round, &payload[..payload_length]);
                input[..n].copy_from_slice(&bytes[..n]);
                for _ in 0..=random.below(4) {
                    let at = random.below(n);
                    match random.below(3) {
                        0 => input[at] ^= 1 + random.below(255) as u8,
                        1 => {
                            input.copy_within(at + 1..n, at);
                            n -= 1;
                        }
                        _ => {
                            input.copy_within(at..n, at + 1);
                            input[at] = random.next() as u8;
                            n += 1;
                        }
                    }
                }
                n
            }
            // A piece of one, and no end in sight.
            _ => {
                let n = random.below(2 * MAX_WIRE);
                for b in &mut input[..n] {
                    *b = (random.next() as u8) | 1;
                }
                n
            }
        };
        for &byte in &input[..length] {
            if let Some((_, payload)) = decoder.push(byte) {
                accepted += 1;
                assert!(payload.len() <= MAX_PAYLOAD);
            }
        }
        // (The changed frame may have lost its zero: end it.)
        decoder.push(0);
        let (bytes, n) = sound(round, &round.to_le_bytes());
        let mut found = None;
        for &byte in &bytes[..n] {
            if let Some((header, payload)) = decoder.push(byte) {
                found = Some((header.sequence, payload == round.to_le_bytes()));
            }
        }
        assert_eq!(found, Some((round, true)), "the frame after input {round}");
    }
    // A change that undoes itself (a byte dropped and the same added) may leave a sound frame;
    // by chance alone, a 32-bit checksum passes one in four thousand million.
    assert!(
        accepted < 6_000,
        "{accepted} accepted of a million damaged inputs"
    );
    assert!(decoder.bad_frames() > 700_000);
}

/// The messages' decoder, behind a sound checksum: any payload is read or refused.
#[test]
fn a_million_payloads() {
    let mut random = Random(0xF00D);
    let mut payload = [0u8; MAX_PAYLOAD];
    for _ in 0..1_000_000u32 {
        let n = random.below(48);
        for b in &mut payload[..n] {
            let r = random.next();
            // Small numbers reach more variants.
            *b = if r & 1 == 0 {
                (r >> 8) as u8 & 15
            } else {
                (r >> 8) as u8
            };
        }
        decode_all(&payload[..n]);
    }
}
