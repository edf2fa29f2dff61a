//! The top of the page: angle, verdict, entry and axis, the picture; and the stripes.

use super::table::table;
use super::{decimals, number, small_chart};
use crate::report::chart as charts;
use crate::report::model::{Needle, Picture, Report, StripeSample, Verdict};
use crate::report::raster;
use maud::{Markup, html};

/// What the reader came for.
pub fn top(report: &Report) -> Markup {
    html! {
        div.top {
            div {
                @if let Some(n) = &report.needle { (angle(n)) }
                @else if !report.headline.is_empty() { p.angle { (report.headline) } }
                @if let Some(v) = &report.verdict { (verdict(v)) }
            }
            @if let Some(p) = &report.picture { (picture(p)) }
            @if let Some(n) = &report.needle { div.details { (details(n)) } }
        }
    }
}

fn angle(n: &Needle) -> Markup {
    html! {
        p.angle {
            (number(n.angle_deg, 1)) "°"
            small {
                " ± " (number(n.angle_sigma_deg, 2)) "° measured (1 σ), "
                @match n.turned {
                    Some((_, inner)) => { "± " (number((inner - n.angle_deg).abs(), 2)) "° by the region’s radius" },
                    None => "the radius’s part unknown",
                }
            }
        }
        p.soft {
            "Needle to the plane of the skin at the entry; wanted angle from " (n.angle_source) ". "
            @if let Some((inner_mm, inner)) = n.turned {
                "A hand is no plane: to the one fitted within " (number(inner_mm, 1)) " mm of the entry, rather than " (number(n.radius_mm, 1)) " mm, the same needle stands at " (number(inner, 2)) "°. Of the smaller radii looked at this one differs most. That part is systematic: no repetition makes it smaller."
            }
        }
    }
}

fn verdict(v: &Verdict) -> Markup {
    html! {
        div.verdict.not[!v.usable] .caution[v.usable && !v.warnings.is_empty()] {
            strong {
                @if !v.usable { "Not usable:" }
                @else if v.warnings.is_empty() { "Usable:" }
                @else { "Usable with caution:" }
            }
            @if v.usable && v.warnings.is_empty() { " nothing that was checked speaks against it." }
            @if !v.reasons.is_empty() { ul { @for r in &v.reasons { li { (r) } } } }
            @if !v.warnings.is_empty() {
                @if !v.usable { p { "Beside that:" } }
                ul { @for w in &v.warnings { li { (w) } } }
            }
        }
    }
}

fn details(n: &Needle) -> Markup {
    html! {
        div.frames { @for f in &n.frames {
            div.scroll { table {
                thead { tr { th.left { (f.name) " frame" } th { "X" } th { "Y" } th { "Z" } } }
                tbody {
                    (row("entry / mm", &f.entry_mm, 3))
                    (row("needle axis", &f.axis, 4))
                    (row("plane’s normal", &f.normal, 4))
                    (row("vein’s direction", &f.vein, 4))
                }
            } }
        } }
        p.soft {
            @if let Some(s) = &n.entry_sigma_mm {
                "Entry: σ " (number(s[0], 3)) ", " (number(s[1], 3)) ", " (number(s[2], 3)) " mm along X, Y, Z. "
            }
            @if let Some(s) = n.axis_sigma_deg { "Axis: σ " (number(s, 3)) "°. " }
            "Plane fitted to " (n.region_points) " points within " (number(n.radius_mm, 1))
            " mm of the entry, RMS distance " (number(n.region_rms_mm, 3)) " mm, as of a cylinder of " (number(n.bend_mm, 0)) " mm radius."
        }
    }
}

fn row(name: &str, v: &[f64; 3], decimals: usize) -> Markup {
    html! { tr { td.left { (name) } @for x in v { td { (number(*x, decimals)) } } } }
}

/// SVG polyline coordinates.
fn path(points: &[[f64; 2]]) -> String {
    points
        .iter()
        .map(|p| format!("{:.1},{:.1}", p[0] + 0.5, p[1] + 0.5))
        .collect::<Vec<_>>()
        .join(" ")
}

/// SVG path of points alone.
fn dots(points: &[[f64; 2]]) -> String {
    points
        .iter()
        .map(|p| format!("M{:.1} {:.1}h0", p[0] + 0.5, p[1] + 0.5))
        .collect()
}

fn picture(p: &Picture) -> Markup {
    let stroke = p.image.width as f64 / 400.0;
    html! {
        figure {
            div.drawn {
                img src=(raster::data_uri(&raster::brightened(&p.image))) alt="The hand, with entry, vein, region and needle drawn on it" width=(p.image.width) height=(p.image.height);
                svg viewBox=(format!("0 0 {} {}", p.image.width, p.image.height)) aria-hidden="true" {
                    @if !p.points.is_empty() { path d=(dots(&p.points)) fill="none" stroke="#F0E442" stroke-width=(0.7 * stroke) stroke-linecap="round" {} }
                    @if !p.region.is_empty() { polygon points=(path(&p.region)) fill="#0072B2" fill-opacity="0.18" stroke="#56B4E9" stroke-width=(stroke) {} }
                    polyline points=(path(&p.vein)) fill="none" stroke="#fff" stroke-width=(2.6 * stroke) stroke-linecap="round" {}
                    polyline points=(path(&p.vein)) fill="none" stroke="#CC79A7" stroke-width=(1.6 * stroke) stroke-linecap="round" {}
                    @if !p.needle.is_empty() { polyline points=(path(&p.needle)) fill="none" stroke="#E69F00" stroke-width=(2.0 * stroke) {} }
                    circle cx=(p.entry[0] + 0.5) cy=(p.entry[1] + 0.5) r=(2.5 * stroke) fill="#D55E00" stroke="#fff" stroke-width=(0.6 * stroke) {}
                }
            }
            figcaption {
                span.key style="background:#D55E00" {} "entry · "
                @if !p.needle.is_empty() { span.key style="background:#E69F00" {} "needle before the entry · " }
                span.key style="background:#CC79A7" {} "vein, as given"
                @if !p.region.is_empty() { " · " span.key style="background:#56B4E9" {} @if p.points.is_empty() { "region of the plane" } @else { "region that was asked for" } }
                @if !p.points.is_empty() { " · " span.key style="background:#F0E442" {} "measured surface" }
                " (image brightened)"
            }
        }
    }
}

/// The stripes section.
pub fn stripes(samples: &[StripeSample]) -> Markup {
    html! {
        @if !samples.is_empty() { div.block {
            h2 { "Stripes" }
            p.soft { "Pieces of scan frames beside the entry, every pixel drawn large, with the extracted centres at sub-pixel scale (" span.key style="background:#D55E00" {} "quality 0.5 and better, " span.key style="background:#56B4E9" {} "below); under each, σ of every centre of the whole stripe." }
            div.charts.three { @for s in samples { (sample(s)) } }
        } }
    }
}

fn sample(s: &StripeSample) -> Markup {
    let at = |c: &[f64; 4]| (c[0] - s.origin[0] + 0.5, c[1] - s.origin[1] + 0.5);
    let inside = |c: &&[f64; 4]| {
        let (x, y) = at(c);
        (0.0..s.image.width as f64).contains(&x) && (0.0..s.image.height as f64).contains(&y)
    };
    html! {
        div {
            figure {
                div.drawn {
                    img src=(raster::data_uri(&raster::enlarged(&raster::brightened(&s.image), 8))) alt=(format!("Piece of {}", s.name)) width=(s.image.width) height=(s.image.height);
                    svg viewBox=(format!("0 0 {} {}", s.image.width, s.image.height)) aria-hidden="true" {
                        @for c in s.centres.iter().filter(inside) {
                            @let (x, y) = at(c);
                            circle cx=(format!("{x:.3}")) cy=(format!("{y:.3}")) r="0.25" fill=(if c[3] >= 0.5 { "#D55E00" } else { "#56B4E9" }) {}
                        }
                    }
                }
                figcaption { (s.name) ", slide at " (number(s.slide_mm, 2)) " mm; u " (s.origin[0]) " to " (s.origin[0] + s.image.width as f64 - 1.0) ", v " (s.origin[1]) " to " (s.origin[1] + s.image.height as f64 - 1.0) " px" }
            }
            (small_chart(&charts::quality(s)))
        }
    }
}

/// Used by the calibration's parameters too: name, value, σ, unit.
pub fn parameters(rows: &[(String, f64, Option<f64>, String)]) -> Markup {
    let sigmas = rows.iter().any(|(_, _, sigma, _)| sigma.is_some());
    let rows: Vec<Vec<String>> = rows
        .iter()
        .map(|(name, value, sigma, unit)| {
            vec![
                name.clone(),
                number(*value, sigma.map_or(5, decimals)),
                sigma.map_or("–".into(), |s| number(s, decimals(s))),
                if unit.is_empty() {
                    "–".into()
                } else {
                    unit.clone()
                },
            ]
        })
        .collect();
    html! { @if !rows.is_empty() { div.block {
        (table("Parameters", &["", "value", "σ", "unit"], &rows))
        @if sigmas { p.soft { "Each with two digits of its standard deviation (1 σ)." } }
    } } }
}
