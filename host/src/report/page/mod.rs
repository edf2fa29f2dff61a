//! The page: head, top, and the sections in order.

mod calibration;
mod checks;
mod needle;
mod provenance;
mod puncture;
mod scene;
mod table;

use super::chart::Plot;
use super::model::Report;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("../style.css");
const VIEWER: &str = include_str!("../viewer.min.js");

/// The whole page as text.
pub fn render(report: &Report) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // Nothing may be fetched, whatever a file's name or text contains.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
                link rel="icon" href="data:,";
                title { (report.title) " · Cannula" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                main {
                    h1 { (report.title) }
                    p.soft { "Report of " (report.provenance.time) " · " (report.provenance.program) " · Research software, not a medical device; not for use on people without the approval and supervision that your institution requires." }
                    (needle::top(report))
                    @if let Some(s) = &report.scene { (scene::section(s)) }
                    (provenance::truth(&report.truth))
                    @if let Some(c) = &report.calibration { (calibration::section(c)) }
                    (needle::stripes(&report.stripes))
                    @if let Some(p) = &report.puncture { (puncture::section(p)) }
                    (checks::section(&report.checks))
                    (provenance::section(&report.provenance))
                }
                @if report.scene.is_some() { script { (PreEscaped(VIEWER)) } }
            }
        }
    }
    .into_string()
}

/// A chart as a figure.
fn chart(plot: &Plot) -> Markup {
    drawn(plot, 480, 350)
}

/// For three in a row: smaller as a whole, so that its words are not.
fn small_chart(plot: &Plot) -> Markup {
    drawn(plot, 340, 260)
}

fn drawn(plot: &Plot, width: u32, height: u32) -> Markup {
    html! { figure role="img" aria-label=(plot.title) { (PreEscaped(plot.svg(width, height))) } }
}

/// "1 view", "2 views".
fn count(n: usize, of: &str) -> String {
    match n {
        1 => format!("1 {of}"),
        _ => format!("{n} {of}s"),
    }
}

/// Fixed decimals with a true minus.
fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let text = format!("{value:.decimals$}");
    let zero = text
        .trim_start_matches('-')
        .chars()
        .all(|c| c == '0' || c == '.');
    match text.strip_prefix('-') {
        Some(rest) if zero => rest.into(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// Decimals that show two digits of a standard deviation.
fn decimals(sigma: f64) -> usize {
    if sigma > 0.0 && sigma.is_finite() {
        (1.0 - sigma.log10().floor()).clamp(0.0, 9.0) as usize
    } else {
        5
    }
}

/// Three decimals, or a power of ten for what would vanish with them.
fn scientific(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || value.abs() >= 1e-2 {
        return number(value, 3);
    }
    let power = value.abs().log10().floor();
    let digits: String = format!("{power}")
        .chars()
        .map(|c| match c {
            '-' => '⁻',
            c => c
                .to_digit(10)
                .and_then(|d| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(d as usize))
                .unwrap_or(c),
        })
        .collect();
    format!("{} × 10{digits}", number(value / 10f64.powf(power), 3))
}

#[cfg(test)]
mod tests;
