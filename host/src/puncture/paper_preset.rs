//! The paper's puncture, as far as it can be read from its text and figures, and ours beside it.
//!
//! The paper gives no thicknesses. Its Figure 26 gives times at 5 mm/s: contact with skin 0 s, fat
//! 0.14 s, vein 0.28 s; puncture of skin 0.07 s, fat 0.24 s, vein 0.35 s. Thickness is the time
//! between contacts × speed × sin θ; the wall's is from contact to puncture. The angle of that
//! figure is not given either; 45° is taken, the middle one of its three.

use super::output::RunSummary;
use super::tissue::Setup;
use serde::Serialize;

/// The angle assumed for Figure 26, degrees.
pub const ANGLE_DEG: f64 = 45.0;

/// Contact and puncture in Figure 26, s: skin, fat, vein.
pub const EVENTS_S: [(&str, f64, f64); 3] = [
    ("skin", 0.0, 0.07),
    ("fat", 0.14, 0.24),
    ("vein", 0.28, 0.35),
];

/// The paper's layers with everything else as in [`Setup::default`].
pub fn setup() -> Setup {
    let mut s = Setup::default();
    let depth = |seconds: f64| seconds * s.needle.speed_mm_s * ANGLE_DEG.to_radians().sin();
    let [skin, fat, vein] = EVENTS_S;
    s.layers.skin_mm = depth(fat.1 - skin.1);
    s.layers.fat_mm = depth(vein.1 - fat.1);
    s.layers.wall_mm = depth(vein.2 - vein.1);
    // Half of what 1 mm layers have: the zone must be small against a layer.
    s.process_zone_mm = 0.125;
    s
}

/// Brick for these layers, mm.
pub const MESH_MM: f64 = 0.1;

/// An event beside the paper's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Beside {
    /// "skin contact" and so on.
    pub event: String,
    /// Ours, s.
    pub ours_s: Option<f64>,
    /// The paper's, s.
    pub paper_s: f64,
}

/// What agrees with the paper and what does not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Events of Figure 26 at 45°; empty if that angle was not run.
    pub events: Vec<Beside>,
    /// Whether contacts and punctures come in the paper's order: skin, fat, vein.
    pub order_agrees: Option<bool>,
    /// Whether each layer's force rises, falls and rises again ("increase decrease increase").
    pub rise_and_fall: Option<bool>,
    /// Whether peak force falls and the process gets shorter as the angle grows (Figure 27).
    pub trend_agrees: Option<bool>,
    /// Differences in words.
    pub differences: Vec<String>,
}

/// Sets runs of [`setup`] beside the paper.
pub fn compare(runs: &[RunSummary]) -> Comparison {
    let mut out = Comparison {
        events: Vec::new(),
        order_agrees: None,
        rise_and_fall: None,
        trend_agrees: None,
        differences: Vec::new(),
    };
    if let Some(run) = runs.iter().find(|r| (r.angle_deg - ANGLE_DEG).abs() < 1e-9) {
        let mut contacts = Vec::new();
        let mut punctures = Vec::new();
        for (ours, (layer, contact, puncture)) in run.events.iter().zip(EVENTS_S) {
            contacts.push(ours.contact_s);
            punctures.push(ours.puncture_s);
            for (what, mine, theirs) in [
                ("contact", ours.contact_s, contact),
                ("puncture", ours.puncture_s, puncture),
            ] {
                match mine {
                    Some(t) if theirs > 0.0 && (t / theirs - 1.0).abs() > 0.25 => {
                        let mm = (t - theirs) * 5.0;
                        let more = if mm > 0.0 { "more" } else { "less" };
                        out.differences.push(format!(
                            "{layer} {what} at {t:.2} s, the paper's at {theirs:.2} s: our tissue \
                             gives way by {:.2} mm {more} under the needle",
                            mm.abs()
                        ));
                    }
                    Some(_) => {}
                    None => out.differences.push(format!("no {layer} {what} was found")),
                }
                out.events.push(Beside {
                    event: format!("{layer} {what}"),
                    ours_s: mine,
                    paper_s: theirs,
                });
            }
        }
        let rising =
            |v: &[Option<f64>]| v.iter().all(Option::is_some) && v.windows(2).all(|w| w[0] < w[1]);
        out.order_agrees = Some(rising(&contacts) && rising(&punctures));
        out.rise_and_fall = Some(run.events.iter().all(|e| e.drop > 0.0));
    }
    if runs.len() > 1 {
        let mut sorted: Vec<&RunSummary> = runs.iter().collect();
        sorted.sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg));
        let falls = |f: &dyn Fn(&RunSummary) -> f64| sorted.windows(2).all(|w| f(w[1]) < f(w[0]));
        let force = falls(&|r| r.peak_force_n);
        let time = falls(&|r| r.duration_s);
        out.trend_agrees = Some(force && time);
        if !force {
            out.differences
                .push("peak force does not fall with every step of the angle".to_owned());
        }
    }
    out.differences.push(
        "the paper prints no forces, needle, fracture criterion or thicknesses: only order, shape \
         and trend can be compared"
            .to_owned(),
    );
    out
}
