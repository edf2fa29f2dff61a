//! Tests of the extractors as a whole.

mod recordings;
mod scenes;
