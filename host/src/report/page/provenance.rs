//! Errors against the truth, and how the result came about.

use super::number;
use super::table::table;
use crate::report::model::{Provenance, TruthRow};
use maud::{Markup, html};

/// Errors against the truth of a simulated rig.
pub fn truth(rows: &[TruthRow]) -> Markup {
    let limits = rows.iter().any(|r| r.limit.is_some());
    html! {
        @if !rows.is_empty() {
            h2 { "Against the truth" }
            p.soft { "The rig is simulated, so the truth is known." }
            div.scroll { table {
                thead { tr { th.left { "quantity" } th { "error" } th.left { "unit" } @if limits { th { "asked" } } } }
                tbody { @for r in rows { tr {
                    td.left { (r.what) }
                    td.over[r.limit.is_some_and(|l| r.error > l)] { (number(r.error, 4)) }
                    td.left { (r.unit) }
                    @if limits {
                        td { @if let Some(l) = r.limit { "≤ " (number(l, 3)) } @else { "–" } }
                    }
                } } }
            } }
        }
    }
}

/// The section.
pub fn section(p: &Provenance) -> Markup {
    let settings: Vec<Vec<String>> = p
        .settings
        .iter()
        .map(|(k, v)| vec![k.clone(), v.clone()])
        .collect();
    let stages: Vec<Vec<String>> = p
        .stages
        .iter()
        .map(|(k, ms)| vec![k.clone(), number(*ms, 1)])
        .collect();
    html! {
        h2 { "Provenance" }
        p { (p.program) ", " (p.time) @if !p.session.is_empty() { "; session " code { (p.session) } } "." }
        @if !p.command.is_empty() { p { "Made by " code { (p.command) } } }
        div.tables {
            @if !stages.is_empty() { div {
                (table("Time per stage", &["stage", "ms"], &stages))
                p.soft { "Summed over threads; reading is decoding the images." }
            } }
            div.settings { (table("Settings and thresholds", &["name", "value"], &settings)) }
        }
    }
}
