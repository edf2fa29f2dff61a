//! From the board's ELF to UF2, the form in which the RP2040's boot loader takes a program: a file
//! dropped on the drive that the board shows when it is powered up with BOOTSEL held.
//!
//! UF2 is a row of 512-byte blocks, each with 256 bytes for one flash page
//! (<https://github.com/microsoft/uf2>):
//!
//! ```text
//!   0 magic "UF2\n"   4 magic 0x9e5d5157   8 flags 0x2000 (family id present)   12 address
//!  16 bytes (256)    20 block number      24 blocks in all   28 family id   32 data…   508 magic 0x0ab16f30
//! ```

use std::collections::BTreeMap;

/// The boot loader's number for the RP2040.
pub const FAMILY_RP2040: u32 = 0xe48b_ff56;
/// The boot loader's number for the RP2350 in its ARM secure state.
pub const FAMILY_RP2350_ARM_S: u32 = 0xe48b_ff59;

const PAGE: usize = 256;
const FLASH: std::ops::Range<u32> = 0x1000_0000..0x1100_0000;

/// What is wrong with an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Uf2Error {
    /// Not an ELF of the right kind.
    #[error("not a 32-bit little-endian ARM ELF: give the motion-board file that cargo built")]
    NotElf,
    /// The file is shorter than its own headers say.
    #[error("the ELF is cut short: build it again")]
    CutShort,
    /// A loadable segment outside the flash.
    #[error("a segment at {0:#010x} lies outside the flash: the linker did not use memory.x")]
    OutsideFlash(u32),
    /// Two segments overlap.
    #[error("two segments overlap at {0:#010x}: the linker did not use memory.x")]
    Overlap(u32),
    /// Nothing to load.
    #[error("the ELF has nothing to load")]
    Empty,
    /// The RP2040's boot ROM would refuse the image.
    #[error(
        "the first 256 bytes are no second-stage boot loader (checksum {found:#010x}, not {right:#010x}): the board would not start"
    )]
    Boot2 {
        /// What stands there.
        found: u32,
        /// What should.
        right: u32,
    },
}

/// The flash pages of an ELF, by address; bytes of a page that no segment gives are zero.
fn pages(elf: &[u8]) -> Result<BTreeMap<u32, [u8; PAGE]>, Uf2Error> {
    let bytes = |at: usize, n: usize| {
        at.checked_add(n)
            .and_then(|end| elf.get(at..end))
            .ok_or(Uf2Error::CutShort)
    };
    let half = |at: usize| bytes(at, 2).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])));
    let word = |at: usize| bytes(at, 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    // Magic, 32 bits, little-endian; machine 40 is ARM.
    if !elf.starts_with(b"\x7fELF\x01\x01") || half(18)? != 40 {
        return Err(Uf2Error::NotElf);
    }
    let (table, size, count) = (word(28)? as usize, half(42)?, half(44)?);
    let mut pages = BTreeMap::new();
    let mut written = BTreeMap::<u32, u32>::new();
    for i in 0..count {
        let header = table.saturating_add(i.saturating_mul(size));
        const LOAD: u32 = 1;
        let (kind, offset) = (word(header)?, word(header + 4)? as usize);
        let (address, length) = (word(header + 12)?, word(header + 16)?);
        if kind != LOAD || length == 0 {
            continue;
        }
        let end = address
            .checked_add(length)
            .ok_or(Uf2Error::OutsideFlash(address))?;
        if !FLASH.contains(&address) || end > FLASH.end {
            return Err(Uf2Error::OutsideFlash(address));
        }
        let before = written.range(..end).next_back();
        if before.is_some_and(|(_, &other_end)| other_end > address) {
            return Err(Uf2Error::Overlap(address));
        }
        written.insert(address, end);
        for (at, &byte) in (address..).zip(bytes(offset, length as usize)?) {
            let page = at - at % PAGE as u32;
            pages.entry(page).or_insert([0; PAGE])[(at - page) as usize] = byte;
        }
    }
    if pages.is_empty() {
        return Err(Uf2Error::Empty);
    }
    Ok(pages)
}

/// CRC-32 as the RP2040's boot ROM computes it over the first 252 bytes of flash: polynomial
/// 0x04c11db7, started with ones, neither reflected nor inverted (RP2040 datasheet, 2.8.1.3.1).
fn boot2_checksum(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0xffff_ffff, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte) << 24, |crc, _| {
            let shifted = crc << 1;
            if crc >> 31 == 1 {
                shifted ^ 0x04c1_1db7
            } else {
                shifted
            }
        })
    })
}

/// Converts an ELF to UF2 for the boot loader of `family`.
///
/// # Errors
/// When the file is not such an ELF, lies outside the flash, or (RP2040) would not start.
pub fn from_elf(elf: &[u8], family: u32) -> Result<Vec<u8>, Uf2Error> {
    let pages = pages(elf)?;
    if family == FAMILY_RP2040 {
        let empty = [0; PAGE];
        let (boot2, checksum) = pages.get(&FLASH.start).unwrap_or(&empty).split_at(252);
        let found = u32::from_le_bytes([checksum[0], checksum[1], checksum[2], checksum[3]]);
        let right = boot2_checksum(boot2);
        if found != right {
            return Err(Uf2Error::Boot2 { found, right });
        }
    }
    let count = pages.len() as u32;
    let mut out = Vec::with_capacity(512 * pages.len());
    for (number, (&address, data)) in (0u32..).zip(&pages) {
        let head = [
            0x0a32_4655,
            0x9e5d_5157,
            0x2000,
            address,
            PAGE as u32,
            number,
            count,
            family,
        ];
        for word in head {
            out.extend_from_slice(&word.to_le_bytes());
        }
        out.extend_from_slice(data);
        out.resize(out.len() + 512 - 32 - PAGE - 4, 0);
        out.extend_from_slice(&0x0ab1_6f30u32.to_le_bytes());
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An ELF with the given segments (address, bytes).
    fn elf(segments: &[(u32, Vec<u8>)]) -> Vec<u8> {
        let mut head = vec![0u8; 52 + 32 * segments.len()];
        head[..6].copy_from_slice(b"\x7fELF\x01\x01");
        head[18] = 40;
        head[28] = 52;
        head[42] = 32;
        head[44] = segments.len() as u8;
        let mut body = Vec::new();
        for (i, (address, bytes)) in segments.iter().enumerate() {
            let offset = (head.len() + body.len()) as u32;
            let fields = [1, offset, *address, *address, bytes.len() as u32];
            for (j, field) in fields.iter().enumerate() {
                let at = 52 + 32 * i + 4 * j;
                head[at..at + 4].copy_from_slice(&field.to_le_bytes());
            }
            body.extend_from_slice(bytes);
        }
        head.extend(body);
        head
    }

    /// What a boot loader would write, reading block by block.
    fn flashed(uf2: &[u8], family: u32) -> BTreeMap<u32, u8> {
        let mut flash = BTreeMap::new();
        for (n, block) in uf2.chunks(512).enumerate() {
            let word = |i: usize| u32::from_le_bytes(block[4 * i..4 * i + 4].try_into().unwrap());
            assert_eq!((block.len(), &block[..4]), (512, &b"UF2\n"[..]));
            assert_eq!((word(1), word(127)), (0x9e5d_5157, 0x0ab1_6f30));
            assert_eq!((word(2), word(4), word(7)), (0x2000, 256, family));
            assert_eq!((word(5) as usize, word(6) as usize), (n, uf2.len() / 512));
            assert_eq!(word(3) % 256, 0, "pages");
            for (i, &byte) in block[32..288].iter().enumerate() {
                assert_eq!(
                    flash.insert(word(3) + i as u32, byte),
                    None,
                    "each page once"
                );
            }
        }
        flash
    }

    #[test]
    fn boot2_must_be_one() {
        let mut boot2: Vec<u8> = (0..252u32).map(|i| (i * 7) as u8).collect();
        let wrong = elf(&[(0x1000_0000, boot2.clone())]);
        assert!(matches!(
            from_elf(&wrong, FAMILY_RP2040),
            Err(Uf2Error::Boot2 { found: 0, .. })
        ));
        // CRC-32/MPEG-2's published check value.
        assert_eq!(boot2_checksum(b"123456789"), 0x0376_e6e7);
        boot2.extend_from_slice(&boot2_checksum(&boot2).to_le_bytes());
        assert!(from_elf(&elf(&[(0x1000_0000, boot2)]), FAMILY_RP2040).is_ok());
    }

    #[test]
    fn bad_images_are_named() {
        let convert = |bytes: &[u8]| from_elf(bytes, FAMILY_RP2350_ARM_S);
        assert_eq!(convert(b"text"), Err(Uf2Error::NotElf));
        assert_eq!(convert(b"\x7fELF\x01\x01"), Err(Uf2Error::CutShort));
        assert_eq!(convert(&[0; 64]), Err(Uf2Error::NotElf));
        assert_eq!(convert(&elf(&[])), Err(Uf2Error::Empty));
        let in_ram = elf(&[(0x2000_0000, vec![1])]);
        assert_eq!(convert(&in_ram), Err(Uf2Error::OutsideFlash(0x2000_0000)));
        let beyond = elf(&[(0x10ff_ffff, vec![1, 2])]);
        assert_eq!(convert(&beyond), Err(Uf2Error::OutsideFlash(0x10ff_ffff)));
        let twice = elf(&[(0x1000_0000, vec![1; 8]), (0x1000_0004, vec![2; 8])]);
        assert_eq!(convert(&twice), Err(Uf2Error::Overlap(0x1000_0004)));
        let mut cut = elf(&[(0x1000_0000, vec![1; 8])]);
        cut.pop();
        assert_eq!(convert(&cut), Err(Uf2Error::CutShort));
    }

    proptest! {
        #[test]
        fn every_byte_arrives(first in 0u32..3000, gap in 0u32..3000, a in prop::collection::vec(any::<u8>(), 1..900), b in prop::collection::vec(any::<u8>(), 1..900)) {
            let start = 0x1000_0000 + first;
            let second = start + a.len() as u32 + gap;
            let segments = [(start, a), (second, b)];
            let flash = flashed(&from_elf(&elf(&segments), FAMILY_RP2350_ARM_S).unwrap(), FAMILY_RP2350_ARM_S);
            let mut expected = BTreeMap::new();
            for (address, bytes) in &segments {
                expected.extend((*address..).zip(bytes.iter().copied()));
            }
            for (address, byte) in &flash {
                prop_assert_eq!(*byte, expected.remove(address).unwrap_or(0));
            }
            prop_assert!(expected.is_empty());
        }

        #[test]
        fn never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let mut elf = b"\x7fELF\x01\x01".to_vec();
            elf.extend(bytes);
            let _ = from_elf(&elf, FAMILY_RP2040);
        }
    }
}
