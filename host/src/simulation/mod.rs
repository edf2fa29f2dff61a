//! The simulated rig: a scene drawn from a seed, the camera that sees it, recordings with truth.
//!
//! Forward optics only, written apart from the pipeline (they share the camera model of
//! [`crate::geometry`]): what the pipeline measures on these images is compared with what the
//! scene was made of.

pub mod compare;
mod hand;
pub mod mark;
pub mod mcu;
mod profile;
mod random;
mod raster;
mod recording;
mod render;
mod scene;
mod sensor;
mod target;
mod truth;

pub use hand::{Hand, Skin};
pub use profile::{Parameters, Profile};
pub use recording::{FrameId, RecordError, STEPS_PER_MM, record, record_scene, write_truth};
pub use render::{Renderer, Still, Subject};
pub use scene::{Laser, Scene, TRAVEL_MM};
pub use truth::{Lit, Recorded, Truth, scan_stripe};
