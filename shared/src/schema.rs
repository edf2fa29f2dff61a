//! The hash over the message table, computed when compiling.
//!
//! [`wire!`](crate::wire) defines a type and, from the same tokens, the constant text of its shape: names and
//! types of fields and variants in order, without documentation and spaces. [`fnv1a`] folds these
//! texts into one number that both sides compare in the hello. Renaming, adding, removing or
//! reordering anything changes it; rewriting a comment does not.

/// 64-bit FNV-1a, the start value.
pub const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Folds `text` into `hash`, leaving out white space (it is the compiler's choice when tokens
/// are turned into text).
#[allow(
    clippy::indexing_slicing,
    reason = "below the length, by the loop; when compiling"
)]
pub const fn fnv1a(mut hash: u64, text: &str) -> u64 {
    let bytes = text.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        let byte = bytes[i];
        if !byte.is_ascii_whitespace() {
            hash = (hash ^ byte as u64).wrapping_mul(FNV_PRIME);
        }
        i += 1;
    }
    // A separator, so that "ab" + "c" differs from "a" + "bc".
    (hash ^ 0xff).wrapping_mul(FNV_PRIME)
}

/// Hash of several shapes in order.
#[allow(
    clippy::indexing_slicing,
    reason = "below the length, by the loop; when compiling"
)]
pub const fn fold(shapes: &[&str]) -> u64 {
    let mut hash = FNV_OFFSET;
    let mut i = 0;
    while i < shapes.len() {
        hash = fnv1a(hash, shapes[i]);
        i += 1;
    }
    hash
}

/// Defines wire types, each with an associated constant `SHAPE`.
#[macro_export]
macro_rules! wire {
    () => {};
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $( $(#[$fmeta:meta])* pub $field:ident : $type:ty ),* $(,)?
        }
        $($rest:tt)*
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub struct $name { $( $(#[$fmeta])* pub $field : $type ),* }
        impl $name {
            /// The type's shape as it enters the schema hash.
            pub const SHAPE: &'static str =
                concat!("struct ", stringify!($name), "{", $( stringify!($field), ":", stringify!($type), ";", )* "}");
        }
        $crate::wire! { $($rest)* }
    };
    (
        $(#[$meta:meta])*
        pub enum $name:ident {
            $(
                $(#[$vmeta:meta])*
                $variant:ident
                $( ( $inner:ty ) )?
                $( { $( $(#[$fmeta:meta])* $field:ident : $type:ty ),* $(,)? } )?
            ),* $(,)?
        }
        $($rest:tt)*
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $( $(#[$vmeta])* $variant $( ( $inner ) )? $( { $( $(#[$fmeta])* $field : $type ),* } )? ),*
        }
        impl $name {
            /// The type's shape as it enters the schema hash.
            pub const SHAPE: &'static str = concat!(
                "enum ", stringify!($name), "{",
                $( stringify!($variant),
                   $( "(", stringify!($inner), ")", )?
                   $( "{", $( stringify!($field), ":", stringify!($type), ";", )* "}", )?
                   "|", )*
                "}"
            );
        }
        $crate::wire! { $($rest)* }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    wire! {
        /// Documented.
        pub struct Sample {
            /// A field.
            pub a: u8,
            /// Another.
            pub b: u16,
        }
        /// Documented.
        pub enum Choice {
            /// Nothing.
            None,
            /// One.
            One(u8),
            /// Two.
            Two {
                /// Left.
                l: u8,
                /// Right.
                r: i8
            },
        }
    }

    #[test]
    fn shape_is_the_tokens_without_comments() {
        assert_eq!(Sample::SHAPE, "struct Sample{a:u8;b:u16;}");
        assert_eq!(Choice::SHAPE, "enum Choice{None|One(u8)|Two{l:u8;r:i8;}|}");
    }

    #[test]
    fn hash_is_fnv1a() {
        // Published test vector: FNV-1a 64 of "foobar" is 0x85944171f73967e8; then our separator.
        let expected = (0x8594_4171_f739_67e8_u64 ^ 0xff).wrapping_mul(FNV_PRIME);
        assert_eq!(fnv1a(FNV_OFFSET, "foobar"), expected);
        assert_eq!(fnv1a(FNV_OFFSET, " foo\nbar "), expected);
        assert_ne!(fold(&["ab", "c"]), fold(&["a", "bc"]));
    }
}
