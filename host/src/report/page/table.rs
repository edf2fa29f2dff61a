//! Tables: first column left, numbers right, units in the head.

use crate::report::model::Table;
use maud::{Markup, html};

/// A table with a caption above.
pub fn table(caption: &str, head: &[&str], rows: &[Vec<String>]) -> Markup {
    html! {
        @if !rows.is_empty() {
            @if !caption.is_empty() { h3 { (caption) } }
            div.scroll { table {
                thead { tr { @for (k, h) in head.iter().enumerate() { th.text[rows.iter().any(|r| r.get(k).is_some_and(|c| is_text(c)))] { (h) } } } }
                tbody { @for row in rows { tr { @for cell in row { (self::cell(cell)) } } } }
            } }
        }
    }
}

/// The same for a table that comes as text.
pub fn given(caption: &str, t: &Table) -> Markup {
    let head: Vec<&str> = t.head.iter().map(String::as_str).collect();
    table(caption, &head, &t.rows)
}

/// Long words wrap and stand left, numbers do not.
fn cell(text: &str) -> Markup {
    html! { td.text[is_text(text)] { (text) } }
}

fn is_text(cell: &str) -> bool {
    cell.chars().count() > 30
}
