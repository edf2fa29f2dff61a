//! Pin edges with their cycle, as the emulator writes them, and what follows from them.

/// Pins (contract.md).
pub mod pin {
    pub const STEP: u8 = 2;
    pub const DIR: u8 = 3;
    pub const ENABLE: u8 = 4;
    pub const TRIGGER: u8 = 6;
    pub const LASER: u8 = 7;
    pub const EXPOSURE: u8 = 14;
}

/// One change of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    pub cycle: u64,
    pub pin: u8,
    pub high: bool,
}

/// All changes in order.
pub struct Edges(pub Vec<Edge>);

impl Edges {
    /// From the emulator's file.
    pub fn parse(bytes: &[u8]) -> Self {
        let words = bytes.chunks_exact(8).map(|c| {
            let word = c.iter().rev().fold(0u64, |w, &b| w << 8 | u64::from(b));
            Edge {
                cycle: word >> 6,
                pin: (word >> 1 & 31) as u8,
                high: word & 1 == 1,
            }
        });
        Self(words.collect())
    }

    /// Cycles at which a pin went high.
    pub fn rising(&self, pin: u8) -> Vec<u64> {
        self.0
            .iter()
            .filter(|e| e.pin == pin && e.high)
            .map(|e| e.cycle)
            .collect()
    }

    /// Cycles at which a pin went low.
    pub fn falling(&self, pin: u8) -> Vec<u64> {
        self.0
            .iter()
            .filter(|e| e.pin == pin && !e.high)
            .map(|e| e.cycle)
            .collect()
    }

    /// The level of a pin just after `cycle`, if it changed before.
    pub fn level(&self, pin: u8, cycle: u64) -> Option<bool> {
        self.0
            .iter()
            .rev()
            .find(|e| e.pin == pin && e.cycle <= cycle)
            .map(|e| e.high)
    }

    /// STEP edges with the position after each, counted by DIR from `start`.
    pub fn positions(&self, start: i64, away: bool) -> Vec<(u64, i64)> {
        let (mut at, mut away) = (start, away);
        let mut out = Vec::new();
        for edge in &self.0 {
            match edge.pin {
                pin::DIR => away = edge.high,
                pin::STEP if edge.high => {
                    at += if away { 1 } else { -1 };
                    out.push((edge.cycle, at));
                }
                _ => {}
            }
        }
        out
    }
}

/// The smallest and the largest of some values.
pub fn range(values: impl IntoIterator<Item = u64>) -> Option<(u64, u64)> {
    values.into_iter().fold(None, |range, v| match range {
        None => Some((v, v)),
        Some((low, high)) => Some((low.min(v), high.max(v))),
    })
}

/// Differences of neighbours.
pub fn intervals(cycles: &[u64]) -> Vec<u64> {
    cycles.windows(2).map(|w| w[1] - w[0]).collect()
}
