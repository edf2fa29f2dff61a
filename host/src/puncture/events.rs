//! Contact and puncture of each layer, read off the force curves.
//!
//! The paper (Section 3.4) calls a layer punctured where the force between needle and layer
//! "decreases rapidly" after a rise. At its friction of 0.7 the drag along the shaft goes on rising
//! and hides that drop in a layer's whole force; it stands out in the part that cuts, which the
//! solver knows by itself. Forces are first averaged over a fixed length of path (a mesh's curve
//! carries the ripple of its bricks). Then the puncture is the first peak of the cutting force that
//! is followed by a fall of at least a given share before the force comes back to it. The solver's
//! own record of when the needle stood in the layer's lowest part is given beside it, and serves
//! where no drop stands out.

use super::mesh::Region;
use super::run::{Run, Sample};

/// Length of path over which forces are averaged, mm.
pub const WINDOW_MM: f64 = 0.3;
/// A fall by this share of the peak is a puncture.
pub const DROP: f64 = 0.2;
/// Force that counts as contact, N.
pub const CONTACT_N: f64 = 0.005;

/// How a puncture was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FoundBy {
    /// By the drop of the layer's cutting force.
    Drop,
    /// The needle had passed through; no drop stood out.
    Passage,
}

/// A layer's events.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Event {
    /// "skin", "fat" or "vein".
    pub layer: &'static str,
    /// First contact, s; None if there was none.
    pub contact_s: Option<f64>,
    /// Puncture, s; None if the layer held.
    pub puncture_s: Option<f64>,
    /// How it was found.
    pub found_by: Option<FoundBy>,
    /// When the needle stood in the layer's lowest part, s.
    pub passed_s: Option<f64>,
    /// Share of its peak by which the cutting force fell; 0 without a drop.
    pub drop: f64,
    /// Largest force between needle and layer, N.
    pub peak_force_n: f64,
}

/// Samples with forces averaged over [`WINDOW_MM`].
pub fn smooth(samples: &[Sample]) -> Vec<Sample> {
    let mut out = Vec::with_capacity(samples.len());
    let (mut from, mut to) = (0, 0);
    for s in samples {
        while samples[from].path_mm < s.path_mm - 0.5 * WINDOW_MM {
            from += 1;
        }
        while to < samples.len() && samples[to].path_mm <= s.path_mm + 0.5 * WINDOW_MM {
            to += 1;
        }
        let n = (to - from) as f64;
        let mut mean = *s;
        mean.force_n = samples[from..to].iter().map(|s| s.force_n).sum::<f64>() / n;
        for r in 0..5 {
            mean.cutting[r] = samples[from..to].iter().map(|s| s.cutting[r]).sum::<f64>() / n;
            mean.by_region[r] = samples[from..to]
                .iter()
                .map(|s| s.by_region[r])
                .sum::<f64>()
                / n;
        }
        out.push(mean);
    }
    out
}

/// First peak with a fall of at least [`DROP`] before the force comes back to it: index, share.
pub fn first_drop(force: &[f64]) -> Option<(usize, f64)> {
    let (mut top, mut bottom) = (0, 0);
    let mut found: Option<(usize, f64)> = None;
    for (i, &f) in force.iter().enumerate() {
        if f > force[top] {
            if found.is_some() {
                break;
            }
            (top, bottom) = (i, i);
        } else if f < force[bottom] {
            bottom = i;
            let share = (force[top] - f) / force[top].max(1e-12);
            if force[top] > 4.0 * CONTACT_N && share >= DROP {
                found = Some((top, share));
            }
        }
    }
    found
}

/// The events of a run, skin, fat, vein.
pub fn events(run: &Run) -> Vec<Event> {
    let smooth = smooth(&run.samples);
    let speed = run.speed_mm_s;
    [
        (Region::Skin, "skin"),
        (Region::Fat, "fat"),
        (Region::Vein, "vein"),
    ]
    .into_iter()
    .map(|(region, layer)| {
        let r = region.index();
        let cutting: Vec<f64> = smooth.iter().map(|s| s.cutting[r]).collect();
        let contact = run.samples.iter().position(|s| s.by_region[r] > CONTACT_N);
        let drop = first_drop(&cutting);
        let passed_s = run.severed.path_mm[r].map(|p| p / speed);
        let (puncture_s, found_by) = match (drop, passed_s) {
            (Some((i, _)), _) => (Some(smooth[i].time_s), Some(FoundBy::Drop)),
            (None, Some(t)) => (Some(t), Some(FoundBy::Passage)),
            (None, None) => (None, None),
        };
        Event {
            layer,
            contact_s: contact.map(|i| run.samples[i].time_s),
            puncture_s,
            found_by,
            passed_s,
            drop: drop.map_or(0.0, |d| d.1),
            peak_force_n: smooth.iter().map(|s| s.by_region[r]).fold(0.0, f64::max),
        }
    })
    .collect()
}
