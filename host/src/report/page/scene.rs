//! The turnable view and its controls.

use crate::report::model::Scene;
use crate::report::raster::base64;
use maud::{Markup, PreEscaped, html};

/// The section.
pub fn section(s: &Scene) -> Markup {
    // What there is, with its key; the viewer knows each by its name.
    let refused = s.plane.is_none();
    let layers = [
        ("plane", s.plane.is_some(), "#0072b2", "plane"),
        (
            "section",
            s.section.is_some(),
            "#cc79a7",
            "vein’s section plane",
        ),
        (
            "vein",
            s.vein.len() > 1,
            "#56b4e9",
            if refused { "vein as given" } else { "vein" },
        ),
        (
            "region",
            !s.region.is_empty(),
            "#009e73",
            if refused {
                "region asked for"
            } else {
                "region"
            },
        ),
        (
            "sight",
            s.sight.is_some(),
            "#d55e00",
            "sight through the entry pixel",
        ),
    ];
    html! {
        h2 { "The scan in space" }
        div.scene {
        div.controls {
            label.screen { "colour " select { option value="height" { "height" } option value="brightness" { "brightness" } } }
            span.scale { span.low {} i {} span.high {} }
            label { input type="checkbox" data-layer="cloud" checked; " cloud" }
            @for (layer, _, colour, name) in layers.iter().filter(|l| l.1) {
                label { input type="checkbox" data-layer=(layer) checked; " " span.key style=(format!("background:{colour}")) {} (name) }
            }
            @if s.needle.is_some() { label { input type="checkbox" data-layer="needle" checked; " needle: " span.key style="background:#888888" {} "before, " span.key style="background:#d55e00" {} "in the hand" } }
            button type="button" { "first view" }
        }
        div.view-3d data-scene="scene-data" {
            canvas {}
            div.under-pointer {}
            p.no-view { "This browser has no WebGL; the cloud is in cloud.ply." }
        }
        }
        p.soft.screen { "Drag to turn, wheel or pinch to zoom, right drag, shift and drag, or two fingers to pan; the measured point under the pointer is given in the camera’s frame (X right, Y down, Z away)." }
        p.soft {
            (s.points.len()) " points. "
            @if refused { "The region of " (super::number(2.0 * s.radius_mm, 1)) " mm across stands where the entry pixel looks, at the depth of the measured points around it." }
            @else { "The region and the plane’s square are " (super::number(2.0 * s.radius_mm, 1)) " mm wide." }
        }
        script type="application/json" id="scene-data" { (PreEscaped(data(s))) }
    }
}

/// The data as JSON; positions and brightness as base64 of little-endian floats and bytes. Only
/// numbers and base64, so nothing in it can end the script element.
fn data(s: &Scene) -> String {
    let positions: Vec<u8> = s
        .points
        .iter()
        .flatten()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    // Colours between the 1st and 99th percentile of height: single points do not flatten them.
    let mut z: Vec<f32> = s.points.iter().map(|p| p[2]).collect();
    z.sort_by(f32::total_cmp);
    let at = |q: usize| z.get(z.len() * q / 100).copied().unwrap_or(0.0);
    serde_json::json!({
        "positions": base64(&positions),
        "brightness": base64(&s.brightness),
        "height_range": [at(1), at(99)],
        "point_size": s.point_size_mm,
        "plane": s.plane,
        "section": s.section,
        "vein": (s.vein.len() > 1).then_some(&s.vein),
        "needle": s.needle.map(|n| serde_json::json!({
            "from": n.from, "entry": n.entry, "to": n.to, "radius": n.radius,
        })),
        "region": (!s.region.is_empty()).then_some(&s.region),
        "sight": s.sight,
        "focus": s.focus,
        "view": s.view,
        "up": s.up,
    })
    .to_string()
}
