//! Helpers that the end-to-end tests share.

pub mod bench;
pub mod truth;
