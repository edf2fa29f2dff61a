//! One direction of the link, with the damage that is asked for.

use crate::simulation::random::Random;
use cannula_shared::units::Micros;
use std::collections::VecDeque;

/// What happens to bytes under way. Shares are probabilities: per byte for `drop` and `flip`, per
/// piece for `duplicate`, `split` and `delay`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damage {
    /// A byte vanishes.
    pub drop: f64,
    /// A bit of a byte is turned over.
    pub flip: f64,
    /// A piece comes twice.
    pub duplicate: f64,
    /// A piece comes in two, the second part later.
    pub split: f64,
    /// A piece comes late (and all after it: bytes keep their order).
    pub delay: f64,
    /// How late, at most.
    pub delay_by: Micros,
    /// Nothing comes through at all.
    pub cut: bool,
}

impl Damage {
    /// A good cable.
    pub const NONE: Damage = Damage {
        drop: 0.0,
        flip: 0.0,
        duplicate: 0.0,
        split: 0.0,
        delay: 0.0,
        delay_by: Micros(0),
        cut: false,
    };

    /// Everything goes wrong now and then: about every tenth frame is damaged.
    pub const LOSSY: Damage = Damage {
        drop: 0.001,
        flip: 0.001,
        duplicate: 0.03,
        split: 0.2,
        delay: 0.05,
        delay_by: Micros(15_000),
        cut: false,
    };

    /// Silence.
    pub const CUT: Damage = Damage {
        cut: true,
        ..Damage::NONE
    };
}

/// From here to the other side: 125 µs, a microframe.
const TRANSIT: u64 = 125 * 125;

/// Bytes under way.
pub(super) struct Channel {
    pub damage: Damage,
    pieces: VecDeque<(u64, Vec<u8>)>,
    random: Random,
    last: u64,
}

impl Channel {
    pub fn new(stream: u64) -> Self {
        Channel {
            damage: Damage::NONE,
            pieces: VecDeque::new(),
            random: Random::new(0x1147, stream),
            last: 0,
        }
    }

    pub fn send(&mut self, now: u64, bytes: &[u8]) {
        let d = self.damage;
        if d.cut {
            return;
        }
        let mut piece = Vec::with_capacity(bytes.len());
        for &byte in bytes {
            if d.drop > 0.0 && self.random.unit() < d.drop {
                continue;
            }
            let flip = d.flip > 0.0 && self.random.unit() < d.flip;
            piece.push(if flip {
                byte ^ (1 << (self.random.next_u64() % 8))
            } else {
                byte
            });
        }
        if d.duplicate > 0.0 && self.random.unit() < d.duplicate {
            self.put(now, piece.clone());
        }
        if piece.len() > 1 && d.split > 0.0 && self.random.unit() < d.split {
            let at = 1 + (self.random.next_u64() as usize) % (piece.len() - 1);
            let rest = piece.split_off(at);
            self.put(now, piece);
            self.put(now + TRANSIT, rest);
        } else {
            self.put(now, piece);
        }
    }

    fn put(&mut self, now: u64, piece: Vec<u8>) {
        let d = self.damage;
        let mut at = now + TRANSIT;
        if d.delay > 0.0 && self.random.unit() < d.delay {
            at += (self.random.unit() * d.delay_by.to_cycles().0 as f64) as u64;
        }
        self.last = self.last.max(at);
        if !piece.is_empty() {
            self.pieces.push_back((self.last, piece));
        }
    }

    fn due(&mut self, now: u64) -> Option<(u64, Vec<u8>)> {
        if self.next()? <= now {
            self.pieces.pop_front()
        } else {
            None
        }
    }

    /// When the next piece arrives.
    pub fn next(&self) -> Option<u64> {
        self.pieces.front().map(|(at, _)| *at)
    }

    /// What has arrived by `now`.
    pub fn take(&mut self, now: u64) -> Vec<u8> {
        let mut out = Vec::new();
        while let Some((_, piece)) = self.due(now) {
            out.extend(piece);
        }
        out
    }

    /// At most `limit` bytes of what has arrived by `now`.
    pub fn take_up_to(&mut self, now: u64, limit: usize) -> Vec<u8> {
        let mut out = Vec::new();
        while out.len() < limit {
            let Some((at, mut piece)) = self.due(now) else {
                break;
            };
            let rest = piece.split_off(piece.len().min(limit - out.len()));
            out.extend(piece);
            if !rest.is_empty() {
                self.pieces.push_front((at, rest));
            }
        }
        out
    }

    /// Nobody takes what arrives.
    pub fn discard(&mut self, now: u64) {
        while self.due(now).is_some() {}
    }
}
