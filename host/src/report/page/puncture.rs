//! The puncture: curves, decision, sensitivity.

use super::table::given;
use super::{chart, number};
use crate::report::chart as charts;
use crate::report::model::Puncture;
use maud::{Markup, html};

/// The section.
pub fn section(p: &Puncture) -> Markup {
    html! {
        h2 { "Puncture" }
        @match p.given_deg {
            None => p { "Angle by the criterion «" (p.criterion) "»: " strong { (number(p.angle_deg, 1)) "°" } "." },
            Some(given) => p {
                "Angle given by hand: " strong { (number(given, 1)) "°" } ". "
                @if given == p.angle_deg { "The criterion «" (p.criterion) "» would have given the same." }
                @else { "By the criterion «" (p.criterion) "» it would have been " (number(p.angle_deg, 1)) "°; that was not used." }
            },
        }
        @for s in &p.sentences { p { (s) } }
        @if !p.curves.is_empty() { p.soft { (p.curves) } }
        div.charts {
            @if !p.runs.is_empty() { (chart(&charts::forces(p))) }
            @for r in &p.runs { (chart(&charts::force_by_layer(r))) }
            @if !p.force_over_angle.is_empty() { (chart(&charts::force_over_angle(p))) }
        }
        div.block {
            (given("The decision, angle by angle", &p.decision))
            @if !p.against.is_empty() { ul { @for a in &p.against { li { (a) } } } }
        }
        (given("Sensitivity: peak force / N by the fast model, under other assumptions", &p.sensitivity))
    }
}
