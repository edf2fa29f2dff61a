//! Which angle: the paper's criterion, a constrained one, and what speaks against the answer.

use serde::Serialize;

/// How an angle is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// Lowest peak force (paper, Section 3.4).
    #[default]
    Paper,
    /// Lowest peak force, then work, among the angles that keep clear of the far wall and leave
    /// room in the lumen.
    Constrained,
}

/// What speaks for and against an angle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Peak force, N.
    pub peak_force_n: f64,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// The wanted angle, degrees.
    pub angle_deg: f64,
    /// "paper" or "constrained".
    pub criterion: Criterion,
    /// A row per angle.
    pub rows: Vec<Row>,
    /// One plain sentence.
    pub sentence: String,
}

/// Decides among finished runs.
pub fn decide(rows: Vec<Row>, criterion: Criterion) -> Option<Decision> {
    let best = rows
        .iter()
        .min_by(|a, b| a.peak_force_n.total_cmp(&b.peak_force_n))?;
    Some(Decision {
        angle_deg: best.angle_deg,
        criterion,
        sentence: format!(
            "{}° has the lowest peak force, {:.2} N.",
            best.angle_deg, best.peak_force_n
        ),
        rows,
    })
}
