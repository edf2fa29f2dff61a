//! Consistent overhead byte stuffing (Cheshire and Baker, 1999): zero bytes are removed from a
//! frame, so that a zero on the wire can only be the end of one.
//!
//! Written here rather than taken from the `cobs` crate because its encoder panics when the
//! output is short; the tests compare with that crate.

/// The longest that `n` bytes can become, without the ending zero.
pub const fn max_encoded(n: usize) -> usize {
    n + n / 254 + 1
}

/// Encodes `data` into `out`, without the ending zero; the length, or `None` if `out` is short.
pub fn encode(data: &[u8], out: &mut [u8]) -> Option<usize> {
    let mut code_at = 0;
    let mut code = 1u8;
    let mut at = 1;
    // The codes that a full block of 254 leaves open are only written if data follows.
    let mut pending = false;
    for &byte in data {
        if pending {
            code_at = at;
            at += 1;
            code = 1;
            pending = false;
        }
        if byte == 0 {
            *out.get_mut(code_at)? = code;
            code_at = at;
            at += 1;
            code = 1;
        } else {
            *out.get_mut(at)? = byte;
            at += 1;
            code += 1;
            if code == 0xff {
                *out.get_mut(code_at)? = code;
                pending = true;
            }
        }
    }
    if !pending {
        *out.get_mut(code_at)? = code;
    }
    (at <= out.len()).then_some(at)
}

/// Decodes `data` (without its ending zero) in place; the length of the result, or `None` if a
/// code points past the end or a zero stands inside.
pub fn decode_in_place(data: &mut [u8]) -> Option<usize> {
    let mut read = 0;
    let mut write = 0;
    while read < data.len() {
        let code = usize::from(*data.get(read)?);
        if code == 0 {
            return None;
        }
        read += 1;
        for _ in 1..code {
            let byte = *data.get(read)?;
            if byte == 0 {
                return None;
            }
            *data.get_mut(write)? = byte;
            read += 1;
            write += 1;
        }
        if code != 0xff && read < data.len() {
            *data.get_mut(write)? = 0;
            write += 1;
        }
    }
    Some(write)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    #[test]
    fn examples_of_the_paper() {
        let mut out = [0; 16];
        assert_eq!(encode(&[0], &mut out), Some(2));
        assert_eq!(out[..2], [1, 1]);
        assert_eq!(encode(&[0x11, 0x22, 0, 0x33], &mut out), Some(5));
        assert_eq!(out[..5], [3, 0x11, 0x22, 2, 0x33]);
        assert_eq!(encode(&[1, 2, 3], &mut out[..3]), None);
    }

    proptest! {
        #[test]
        fn round_trip_and_agreement_with_the_cobs_crate(
            mut data in proptest::collection::vec(prop_oneof![Just(0u8), any::<u8>(), Just(7)], 0..700),
            zeros in any::<bool>(),
        ) {
            if !zeros {
                data.iter_mut().for_each(|b| *b |= 1);
            }
            let mut out = vec![0; max_encoded(data.len())];
            let n = encode(&data, &mut out).unwrap();
            out.truncate(n);
            prop_assert!(!out.contains(&0));
            let mut theirs = vec![0; cobs::max_encoding_length(data.len()) + 8];
            // That crate writes one more code after a full last block; both decode alike.
            let m = cobs::encode(&data, &mut theirs);
            theirs.truncate(m);
            let mut ours = theirs.clone();
            let back = decode_in_place(&mut ours).unwrap();
            prop_assert_eq!(&ours[..back], &data[..]);
            let k = decode_in_place(&mut out).unwrap();
            prop_assert_eq!(&out[..k], &data[..]);
        }

        #[test]
        fn any_bytes_decode_or_not_but_never_panic(mut data in proptest::collection::vec(any::<u8>(), 0..600)) {
            if let Some(n) = decode_in_place(&mut data) {
                prop_assert!(n <= data.len());
            }
        }
    }
}
