//! Checks that were made: what was looked at, its value, the limit, and what came of it. A check is
//! judged where it is made, and the same list goes to the files, the terminal and the report: the
//! verdict is read off it.

use serde::{Deserialize, Serialize};

/// What came of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Within its limit.
    Sound,
    /// Outside, or what it needs is not there: mind it.
    Caution,
    /// No result is given.
    Refused,
}

/// What a value is held against.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// Sound up to this.
    AtMost(f64),
    /// Sound from this.
    AtLeast(f64),
    /// Sound from the one to the other.
    Between([f64; 2]),
}

impl Limit {
    /// Whether a value is within; what is no number is not.
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(most) => value <= most,
            Self::AtLeast(least) => value >= least,
            Self::Between([from, to]) => (from..=to).contains(&value),
        }
    }
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// What it is a check of: "scan", "calibration", "needle"; empty where the file's own.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub part: String,
    /// What was looked at: "region: points".
    pub what: String,
    /// What was found; `None` where it is no number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// What it is held against: "at_most", "at_least" or "between".
    #[serde(default, flatten, skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
    /// Of value and limit; empty for counts and ratios.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// What came of it.
    pub outcome: Outcome,
    /// What is weak, in a sentence; another check's sentence may speak for this one too.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub words: String,
    /// What to do about it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub remedy: String,
    /// Whether it was said when the calibration was made.
    #[serde(skip)]
    pub said: bool,
}

impl Check {
    /// A value held against a limit.
    pub fn held(what: impl Into<String>, value: f64, limit: Limit, unit: &str) -> Self {
        let outcome = match limit.holds(value) {
            true => Outcome::Sound,
            false => Outcome::Caution,
        };
        Self {
            part: String::new(),
            what: what.into(),
            value: value.is_finite().then_some(value),
            limit: Some(limit),
            unit: unit.to_owned(),
            outcome,
            words: String::new(),
            remedy: String::new(),
            said: false,
        }
    }

    /// Whether something is so, without a figure.
    pub fn is(what: impl Into<String>, so: bool) -> Self {
        Self {
            value: None,
            limit: None,
            ..Self::held(what, if so { 0.0 } else { 1.0 }, Limit::AtMost(0.0), "")
        }
    }

    /// Something that speaks against the result, in a sentence.
    pub fn caution(what: impl Into<String>, words: impl Into<String>) -> Self {
        Self::is(what, false).or(|| (words.into(), String::new()))
    }

    /// What refuses the result, in a sentence.
    pub fn refusal(what: impl Into<String>, words: impl Into<String>) -> Self {
        Self {
            outcome: Outcome::Refused,
            ..Self::caution(what, words)
        }
    }

    /// Refuses what is beyond a second, wider limit too, which is the one to be told then.
    pub fn refused_beyond(mut self, limit: Limit) -> Self {
        if !self.value.is_some_and(|value| limit.holds(value)) {
            self.outcome = Outcome::Refused;
            self.limit = Some(limit);
        }
        self
    }

    /// The sentence and the remedy, by what it is held against, if it is not sound.
    pub fn or_beyond(self, words: impl FnOnce(f64) -> (String, String)) -> Self {
        let limit = match self.limit {
            Some(Limit::AtMost(limit) | Limit::AtLeast(limit) | Limit::Between([_, limit])) => {
                limit
            }
            None => f64::NAN,
        };
        self.or(|| words(limit))
    }

    /// The sentence and the remedy, if it is not sound.
    pub fn or(mut self, words: impl FnOnce() -> (String, String)) -> Self {
        if !self.sound() {
            (self.words, self.remedy) = words();
        }
        self
    }

    /// Within its limit.
    pub fn sound(&self) -> bool {
        self.outcome == Outcome::Sound
    }

    /// What is weak and what to do, in one sentence; `None` where nothing is, or where another
    /// check's sentence says it.
    pub fn sentence(&self) -> Option<String> {
        if self.sound() || self.words.is_empty() {
            return None;
        }
        Some(match self.remedy.as_str() {
            "" => self.words.clone(),
            remedy => format!("{}: {remedy}", self.words),
        })
    }
}

/// So many decimals, from `least`, that a number that breaks a limit does so as it is written.
pub(crate) fn decimals(value: f64, limit: f64, least: usize) -> usize {
    const MOST: usize = 6;
    let apart = |n: &usize| format!("{value:.n$}") != format!("{limit:.n$}");
    (least..MOST).find(apart).unwrap_or(least)
}

/// The same checks as those of a part.
pub fn of(part: &str, checks: impl IntoIterator<Item = Check>) -> impl Iterator<Item = Check> {
    checks.into_iter().map(move |check| Check {
        part: part.to_owned(),
        ..check
    })
}

/// What is weak, a sentence each.
pub fn sentences(checks: &[Check]) -> Vec<String> {
    checks.iter().filter_map(Check::sentence).collect()
}

/// What refuses a result, a sentence each.
pub fn refused_sentences(checks: &[Check]) -> Vec<String> {
    let refused = checks.iter().filter(|c| c.outcome == Outcome::Refused);
    refused.filter_map(Check::sentence).collect()
}

/// The verdict of these checks: "usable", "usable with caution" where one of them is not sound, "not
/// usable" where one refuses.
pub fn verdict(checks: &[Check]) -> &'static str {
    if checks.iter().any(|c| c.outcome == Outcome::Refused) {
        "not usable"
    } else if checks.iter().all(Check::sound) {
        "usable"
    } else {
        "usable with caution"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_judged_by_its_limit_and_a_verdict_by_all() {
        let of = |value, limit| Check::held("x", value, limit, "mm").outcome;
        for (value, limit, outcome) in [
            (1.0, Limit::AtMost(1.0), Outcome::Sound),
            (1.1, Limit::AtMost(1.0), Outcome::Caution),
            (0.9, Limit::AtLeast(1.0), Outcome::Caution),
            (30.0, Limit::Between([15.0, 30.0]), Outcome::Sound),
            (30.1, Limit::Between([15.0, 30.0]), Outcome::Caution),
            (f64::NAN, Limit::AtMost(1.0), Outcome::Caution),
            (f64::NAN, Limit::AtLeast(1.0), Outcome::Caution),
        ] {
            assert_eq!(of(value, limit), outcome, "{value} {limit:?}");
        }
        let mut list = vec![Check::held("a", 1.0, Limit::AtMost(2.0), "mm")];
        assert_eq!((verdict(&list), sentences(&list).len()), ("usable", 0));
        let weak = Check::held("b", 3.0, Limit::AtMost(2.0), "mm");
        list.push(weak.or(|| ("b is 3 mm".into(), "mend it".into())));
        assert_eq!(verdict(&list), "usable with caution");
        assert_eq!(sentences(&list), ["b is 3 mm: mend it"]);
        // One whose sentence another says still counts.
        list[1].words.clear();
        assert_eq!(verdict(&list), "usable with caution");
    }

    #[test]
    fn the_file_says_value_limit_and_outcome() {
        let check = Check::held("region: points", 80.0, Limit::AtLeast(60.0), "");
        let json = serde_json::to_value(&check).unwrap();
        assert_eq!(
            json,
            serde_json::json!({ "what": "region: points", "value": 80.0, "at_least": 60.0, "outcome": "sound" })
        );
        assert_eq!(serde_json::from_value::<Check>(json).unwrap(), check);
        let none = Check::caution("views", "there are none");
        let json = serde_json::to_value(&none).unwrap();
        assert_eq!(serde_json::from_value::<Check>(json).unwrap(), none);
    }
}
