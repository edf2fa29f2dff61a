//! Tables: first column left, numbers right, units in the head.

use crate::report::model::Table;
use maud::{Markup, html};

/// A table with a caption above.
pub fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> Markup {
    // A column with long words in it wraps and stands left; numbers do not.
    let text: Vec<bool> = (0..head.len())
        .map(|k| {
            let mut cells = rows.iter().filter_map(|r| r.get(k));
            cells.any(|c| c.chars().count() > 30)
        })
        .collect();
    let is_text = |k: usize| text.get(k).copied().unwrap_or(false);
    html! {
        @if !rows.is_empty() {
            @if !caption.is_empty() { h3 { (caption) } }
            div.scroll { table {
                thead { tr { @for (k, h) in head.iter().enumerate() { th.text[is_text(k)] { (h) } } } }
                tbody { @for row in rows { tr {
                    @for (k, cell) in row.iter().enumerate() { td.text[is_text(k)] { (cell) } }
                } } }
            } }
        }
    }
}

/// The same for a table that comes as text.
pub fn given(caption: &str, t: &Table) -> Markup {
    let head: Vec<&str> = t.head.iter().map(String::as_str).collect();
    table(caption, &head, &t.rows)
}
