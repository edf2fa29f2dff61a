//! The puncture: which angle, by simulation that can be checked (paper, Sections 2.5 and 3.4).
//!
//! ```text
//! tissue ─► mesh ─► run: element + explicit + contact(needle, cohesive) + pressure ─► events, output
//!                      │
//!                      └─► fast (calibrated once, stored) ─► decision
//! ```
//! [`run::puncture`] is the reference: three-dimensional, half-symmetric about the plane of needle
//! and vein, explicit, total Lagrangian. [`fast::Calibration`] draws force over all angles in
//! microseconds. [`decision::default_decision`] is what `cannula angle` and `process` ask.
//! Units: mm, N, MPa, s (time inside the solver counts in steps); angles in degrees in what goes to
//! files and the screen, in radians inside.

pub mod basis;
pub mod cohesive;
pub mod contact;
pub mod decision;
pub mod element;
pub mod events;
pub mod explicit;
pub mod fast;
pub mod fit;
pub mod lane;
pub mod material;
pub mod mesh;
pub mod needle;
pub mod output;
pub mod paper_preset;
pub mod pressure;
pub mod run;
pub mod tissue;

pub use basis::Basis;
pub use decision::{Criterion, Decision, decision, default_decision};
pub use fast::Calibration;
pub use output::{CurvePoint, PunctureReport};
pub use run::{Numerics, Run, puncture};
pub use tissue::Setup;

#[cfg(test)]
mod verification;
