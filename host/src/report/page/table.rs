//! Tables: numbers right, words left, units in the head.

use crate::report::model::Table;
use maud::{Markup, html};

/// How a column's cells stand: numbers right, words left, and long ones wrapped.
fn class(cells: &[&str]) -> Option<&'static str> {
    let words = |c: &&str| c.chars().any(char::is_alphabetic);
    let long = |c: &&str| c.chars().count() > 30;
    match cells {
        c if c.iter().any(long) => Some("text"),
        c if c.iter().any(words) => Some("left"),
        _ => None,
    }
}

/// Rows that fit one printed page; a longer table may be broken between two.
const ONE_PAGE: usize = 40;

/// A table with a caption above.
pub fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> Markup {
    let classes: Vec<Option<&str>> = (0..head.len())
        .map(|k| {
            let cells: Vec<&str> = rows
                .iter()
                .filter_map(|r| Some(r.get(k)?.as_str()))
                .collect();
            class(&cells)
        })
        .collect();
    let of = |k: usize| classes.get(k).copied().flatten();
    html! {
        @if !rows.is_empty() { div.block[rows.len() <= ONE_PAGE] {
            @if !caption.is_empty() { h3 { (caption) } }
            div.scroll tabindex="0" { table {
                thead { tr { @for (k, h) in head.iter().enumerate() { th class=[of(k)] { (h) } } } }
                tbody { @for row in rows { tr {
                    @for (k, cell) in row.iter().enumerate() { td class=[of(k)] { (cell) } }
                } } }
            } }
        } }
    }
}

/// A table whose rows are named by their first cells; the others stand right, words among them too.
pub fn given(caption: &str, t: &Table) -> Markup {
    let side = |k: usize| (k == 0).then_some("name");
    html! {
        @if !t.rows.is_empty() { div.block {
            h3 { (caption) }
            div.scroll tabindex="0" { table.across {
                thead { tr { @for (k, h) in t.head.iter().enumerate() { th class=[side(k)] { (h) } } } }
                tbody { @for row in &t.rows { tr {
                    @for (k, cell) in row.iter().enumerate() { td class=[side(k)] { (cell) } }
                } } }
            } }
        } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_right_and_words_left() {
        let rows = vec![vec![
            "−5.00".into(),
            "3 × 10⁻⁷".into(),
            "px".into(),
            "60°".into(),
        ]];
        let page = table("", &["slide / mm", "Σ / px²", "unit", "angle"], &rows).into_string();
        for (cell, class) in [
            ("−5.00", ""),
            ("3 × 10⁻⁷", ""),
            ("px", " class=\"left\""),
            ("60°", ""),
        ] {
            assert!(page.contains(&format!("<td{class}>{cell}</td>")), "{page}");
        }
        assert!(page.contains("<th>slide / mm</th>") && page.contains("<th class=\"left\">unit"));
    }
}
