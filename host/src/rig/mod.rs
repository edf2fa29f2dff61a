//! The rig: what moves, lights and looks.

pub mod link;
