//! Helpers that the end-to-end tests share.

pub mod bench;
pub mod program;
pub mod sweeps;
pub mod truth;
