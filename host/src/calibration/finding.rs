//! What a calibration gate says: what is lacking, how bad it is, and what to do about it.

use crate::checks::{Check, Limit};
use std::fmt;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The result stands; its uncertainty is larger than it need be, or something looks odd.
    Warn,
    /// No result is given.
    Refuse,
}

/// What a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// Fewer views than the solve needs.
    TooFewViews,
    /// All boards are (nearly) parallel to each other: the focal length is not determined.
    ParallelViews,
    /// The boards are tilted little.
    LittleTilt,
    /// Parts of the image that no board reached.
    Coverage,
    /// One view does not fit the others.
    BadView,
    /// The corners fit no board as described.
    LargeResiduals,
    /// The focal length is uncertain.
    UncertainFocalLength,
    /// The distortion folds over inside the image.
    FoldedDistortion,
    /// fx and fy differ more than a real sensor's.
    AspectRatio,
    /// The light planes move at a speed that the slide can't give: wrong unit, steps per
    /// millimetre or square size.
    TravelUnit,
    /// The slide seems to move obliquely to the light plane.
    ObliqueTravel,
    /// A position's own plane disagrees with the common normal.
    PlaneDisagrees,
    /// Too few stripe points, views or positions.
    TooFewPoints,
    /// The board poses of the light views are too much alike to carry a plane.
    LightGeometry,
    /// A stripe does not lie on its light plane.
    BadStripe,
    /// Positions predicted from the others miss.
    HoldOut,
}

/// One finding of a gate.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// What it is about, for programs.
    pub cause: Cause,
    /// The view that it is about, by its index in the input.
    pub view: Option<usize>,
    /// What is wrong, with figures; without the view's name.
    pub what: String,
    /// What to do.
    pub advice: String,
}

impl Finding {
    /// One sentence for a person, with `name` in place of the view's index.
    pub fn sentence(&self, name: Option<&str>) -> String {
        let subject = match (name, self.view) {
            (Some(name), Some(_)) => format!("{name}: "),
            (None, Some(view)) => format!("view {view}: "),
            _ => String::new(),
        };
        format!("{subject}{}; {}", self.what, self.advice)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.sentence(None))
    }
}

/// What a gate has looked at and what it has to say.
#[derive(Debug, Default)]
pub(super) struct Gate {
    /// Every check that was made.
    pub checks: Vec<Check>,
    /// What is lacking or odd.
    pub findings: Vec<Finding>,
}

impl Gate {
    /// Holds a value against a limit and keeps that; whether it is sound.
    pub fn holds(&mut self, what: &str, value: f64, limit: Limit, unit: &str) -> bool {
        self.keep(Check::held(what, value, limit, unit))
    }

    /// The same of what has no figure.
    pub fn is(&mut self, what: &str, so: bool) -> bool {
        self.keep(Check::is(what, so))
    }

    fn keep(&mut self, check: Check) -> bool {
        let sound = check.sound();
        self.checks.push(check);
        sound
    }
}

/// The findings that refuse, as one line.
pub(super) fn refusals(findings: &[Finding]) -> String {
    findings
        .iter()
        .filter(|f| f.severity == Severity::Refuse)
        .map(Finding::to_string)
        .collect::<Vec<_>>()
        .join("; ")
}
