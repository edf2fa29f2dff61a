//! CRC-32 (ISO-HDLC: the one of Ethernet, zip and PNG; polynomial 0x04C11DB7 reflected).
//!
//! Four bits at a time: the table is 64 bytes of the board's flash, and a frame is short.

const POLYNOMIAL: u32 = 0xEDB8_8320;

#[allow(
    clippy::indexing_slicing,
    reason = "below the length, by the loop; when compiling"
)]
const TABLE: [u32; 16] = {
    let mut table = [0; 16];
    let mut i = 0;
    while i < 16 {
        let mut value = i as u32;
        let mut bit = 0;
        while bit < 4 {
            value = if value & 1 == 1 {
                (value >> 1) ^ POLYNOMIAL
            } else {
                value >> 1
            };
            bit += 1;
        }
        table[i] = value;
        i += 1;
    }
    table
};

/// A checksum that grows with the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc32 {
    /// The checksum of nothing.
    pub const fn new() -> Self {
        Crc32(u32::MAX)
    }

    /// Takes in more bytes.
    #[allow(clippy::indexing_slicing, reason = "the mask keeps the index below 16")]
    pub fn update(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 ^= u32::from(byte);
            self.0 = (self.0 >> 4) ^ TABLE[(self.0 & 15) as usize];
            self.0 = (self.0 >> 4) ^ TABLE[(self.0 & 15) as usize];
        }
    }

    /// The value so far.
    pub const fn value(self) -> u32 {
        !self.0
    }
}

/// The CRC-32 of `bytes`.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc32::new();
    crc.update(bytes);
    crc.value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
        assert_eq!(crc32(b""), 0);
    }

    proptest! {
        #[test]
        fn agrees_with_crc32fast(bytes in proptest::collection::vec(any::<u8>(), 0..300), cut in any::<prop::sample::Index>()) {
            prop_assert_eq!(crc32(&bytes), crc32fast::hash(&bytes));
            let (left, right) = bytes.split_at(cut.index(bytes.len() + 1));
            let mut crc = Crc32::new();
            crc.update(left);
            crc.update(right);
            prop_assert_eq!(crc.value(), crc32fast::hash(&bytes));
        }
    }
}
