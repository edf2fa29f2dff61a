//! What a decision between angles rests on, for the files and the report: so that it can be made
//! again, and doubted.

use super::decision::{ADVANCE_MM, CLINICAL_DEG, Criterion, FITTED_DEG};
use super::fast::Calibration;
use super::run::Numerics;
use super::tissue::Setup;
use serde::Serialize;

/// What a decision rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Basis {
    /// What computed the forces that were compared: "fast model" or "reference simulation".
    pub model: &'static str,
    /// How the angle is chosen.
    pub criterion: Criterion,
    /// The angles that were compared, degrees.
    pub compared_deg: Vec<f64>,
    /// What is usual where people do it by hand, degrees.
    pub clinical_deg: [f64; 2],
    /// The angles that the fast model was fitted to, degrees.
    pub fitted_deg: [f64; 2],
    /// How far the needle is to advance straight on in the vein, mm.
    pub advance_mm: f64,
    /// Error of the fast model's peaks against the reference's, as a share of them, RMS.
    pub fast_peak_error: f64,
    /// Error of the reference's peaks by its mesh, as a share of them.
    pub mesh_error: f64,
    /// Tissue, layers, needle, friction, pressure.
    pub setup: Setup,
}

impl Basis {
    /// Of a decision between these angles (degrees).
    pub fn new(setup: &Setup, compared_deg: &[f64], criterion: Criterion, simulated: bool) -> Self {
        let fast = Calibration::stored();
        Self {
            model: match simulated {
                true => "reference simulation",
                false => "fast model",
            },
            criterion,
            compared_deg: compared_deg.to_vec(),
            clinical_deg: CLINICAL_DEG,
            fitted_deg: FITTED_DEG,
            advance_mm: ADVANCE_MM,
            fast_peak_error: fast.peak_error,
            mesh_error: fast.mesh_error,
            setup: *setup,
        }
    }
}

/// How a puncture.json came about ("provenance" there).
#[derive(Clone, Debug, Serialize)]
pub struct Provenance {
    /// Program, version and commit.
    pub program: &'static str,
    /// When, ISO 8601 in UTC.
    pub time: String,
    /// What the decision rests on.
    pub puncture: Basis,
    /// How it was computed.
    pub numerics: Numerics,
}

impl Provenance {
    /// Of runs that stand now.
    pub fn now(puncture: Basis, numerics: Numerics) -> Self {
        Self {
            program: crate::PROGRAM,
            time: crate::output::seconds(jiff::Timestamp::now()),
            puncture,
            numerics,
        }
    }
}
