//! Which line and which key of a TOML text an error is about.

use serde::de::{Deserialize, Deserializer, Error as _};
use toml::de::{DeTable, DeValue, Error};

/// An array of so many numbers; further ones are not passed over.
pub(super) fn exactly<'de, D: Deserializer<'de>, const N: usize>(
    source: D,
) -> Result<[u32; N], D::Error> {
    let numbers = Vec::deserialize(source)?;
    let given = numbers.len();
    numbers
        .try_into()
        .map_err(|_| D::Error::invalid_length(given, &format!("{N} numbers").as_str()))
}

/// Line, key and reason in one sentence.
pub(super) fn reason(text: &str, error: &Error) -> String {
    let message = error.message().replace('\n', " ");
    let Some(span) = error.span() else {
        return message;
    };
    let before = text.get(..span.start).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    // A text that is no TOML has no keys.
    let table = DeTable::parse(text).ok();
    match table.and_then(|t| key_at(t.get_ref(), span.start)) {
        Some(key) => format!("line {line}, {key}: {message}"),
        None => format!("line {line}: {message}"),
    }
}

/// The key at a place of the text, with its tables.
fn key_at(table: &DeTable, at: usize) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let name = key.get_ref();
        if let DeValue::Table(inner) = value.get_ref()
            && let Some(deeper) = key_at(inner, at)
        {
            return Some(format!("{name}.{deeper}"));
        }
        let here = key.span().contains(&at) || value.span().contains(&at);
        here.then(|| name.to_string())
    })
}
