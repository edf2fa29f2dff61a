//! Every check that was made, with value, limit and outcome.

use super::number;
use crate::checks::{Check, Limit, Outcome};
use maud::{Markup, html};

/// The section.
pub fn section(checks: &[Check]) -> Markup {
    html! {
        @if !checks.is_empty() {
            h2 { "Checks" }
            p.soft { "Every check that was made for this result, in order; the verdict at the top is read off this list. A check without value is of something that is so or is not." }
            div.scroll { table {
                thead { tr { th.left { "check" } th.left { "outcome" } th { "value" } th { "limit" } th.left { "unit" } } }
                tbody { @for c in checks { tr {
                    td.text { (c.what) }
                    td.left.over[!c.sound()] { (outcome(c.outcome)) }
                    td { (value(c)) }
                    td { (c.limit.map_or("–".into(), limit)) }
                    td.left { (if c.unit.is_empty() { "–" } else { &c.unit }) }
                } } }
            } }
        }
    }
}

fn outcome(o: Outcome) -> &'static str {
    match o {
        Outcome::Sound => "sound",
        Outcome::Caution => "caution",
        Outcome::Refused => "refused",
    }
}

fn limit(l: Limit) -> String {
    match l {
        Limit::AtMost(most) => format!("≤ {}", figure(most)),
        Limit::AtLeast(least) => format!("≥ {}", figure(least)),
        Limit::Between([from, to]) => format!("{} … {}", figure(from), figure(to)),
    }
}

/// Four digits, or as many as tell an unsound value from its limit.
fn value(c: &Check) -> String {
    let Some(value) = c.value else {
        return "–".into();
    };
    let limits = match c.limit {
        Some(Limit::AtMost(x) | Limit::AtLeast(x)) => vec![x],
        Some(Limit::Between(both)) => both.to_vec(),
        None => Vec::new(),
    };
    let text = figure(value);
    match !c.sound() && limits.iter().any(|l| figure(*l) == text) {
        true => number(value, 6),
        false => text,
    }
}

/// Four digits; whole numbers as they are.
fn figure(value: f64) -> String {
    let digits = 3.0 - value.abs().max(1e-6).log10().floor();
    let text = number(value, digits.clamp(0.0, 5.0) as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_digits() {
        for (value, text) in [
            (1103.0, "1103"),
            (0.21842, "0.2184"),
            (0.000_123, "0.00012"),
            (0.0, "0"),
            (-22.541, "−22.54"),
            (3.0, "3"),
            (100.0, "100"),
        ] {
            assert_eq!(figure(value), text);
        }
    }

    #[test]
    fn a_check_stands_with_value_limit_and_outcome() {
        let far = Check::held("scan: farthest", 61.3, Limit::Between([-0.6, 60.6]), "mm");
        let page = section(&[far]).into_string();
        for cell in ["61.3", "−0.6 … 60.6", "mm", "caution"] {
            assert!(page.contains(&format!(">{cell}</td>")), "{cell}: {page}");
        }
        let near = Check::held("", 60.0004, Limit::AtMost(60.0), "mm");
        assert_eq!(value(&near), "60.000400");
    }
}
