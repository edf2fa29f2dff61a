//! What makes a decided angle mean less than its figure says: a region that is curved, hangs on its
//! radius or is cut off, and a vein that does not belong to the entry.

use super::{Decision, EntryRequest, Limits, axis};
use crate::checks::{Check, Limit};

/// The checks of a decision that stands.
pub(super) fn weigh(d: &Decision, request: &EntryRequest, limits: &Limits) -> Vec<Check> {
    let mut all = vec![
        met(d, request.vein.len()),
        curved(d, request.radius_mm, limits),
        turned(d, limits),
        whole(d, limits),
    ];
    all.extend(course(d, limits).into_iter().flatten());
    all
}

fn met(d: &Decision, given: usize) -> Check {
    let met = d.vein.len();
    let all = Limit::AtLeast(given as f64);
    Check::held("vein: pixels that meet the surface", met as f64, all, "").or(|| {
        (
            format!("only {met} of the vein’s {given} pixels meet the measured surface: its direction is theirs"),
            "give pixels on the scanned surface, or scan farther".to_owned(),
        )
    })
}

fn curved(d: &Decision, radius_mm: f64, limits: &Limits) -> Check {
    Check::held(
        "region: RMS distance from its plane",
        d.rms_mm,
        Limit::AtMost(limits.curved * radius_mm),
        "mm",
    )
    .or(|| {
        (
            format!(
                "the region is curved like a cylinder of {:.0} mm radius ({:.2} mm RMS off its plane, flat enough up to {:.2} mm): an entry 1 mm off meets the skin at up to {:.1}° another angle",
                d.bend_mm,
                d.rms_mm,
                limits.curved * radius_mm,
                (1.0 / d.bend_mm).to_degrees(),
            ),
            "choose a flatter entry or a smaller radius_mm".to_owned(),
        )
    })
}

fn turned(d: &Decision, limits: &Limits) -> Check {
    let what = "needle angle: largest change with a smaller radius";
    match d.turned {
        Some((inner_mm, inner)) => {
            let change = inner - d.needle.angle;
            let limit = Limit::AtMost(limits.turn.to_degrees());
            Check::held(what, change.abs().to_degrees(), limit, "°").or(|| {
                (
                    format!(
                        "the angle hangs on the region’s radius: the same needle stands at {:.1}° to the plane within {inner_mm:.0} mm, at {:.1}° to this one",
                        inner.to_degrees(),
                        d.needle.angle.to_degrees(),
                    ),
                    "choose another entry, or give the radius that the needle’s contact asks for".to_owned(),
                )
            })
        }
        None => Check::is(what, false).or(|| {
            (
                "half the region’s radius holds no plane, so that it is not known how far the angle hangs on the radius".to_owned(),
                "give a larger radius_mm, or scan with closer stripes".to_owned(),
            )
        }),
    }
}

fn whole(d: &Decision, limits: &Limits) -> Check {
    Check::held(
        "region: part covered by measured surface, called cut off",
        100.0 * d.coverage,
        Limit::AtLeast(100.0 * limits.whole),
        "%",
    )
    .or(|| {
        (
            format!(
                "{:.0} % of the region was not measured: how the surface goes on there is guessed from its bend",
                100.0 * (1.0 - d.coverage)
            ),
            "choose an entry farther from the hand’s edge or a smaller radius_mm, or scan farther".to_owned(),
        )
    })
}

/// Where the vein's line runs; nothing where it has none.
fn course(d: &Decision, limits: &Limits) -> Option<[Check; 2]> {
    let line = axis::line(&d.vein)?;
    let most = Limit::AtMost(limits.beside_mm);
    let beside = axis::beside(&d.vein, &line, &d.entry);
    let what = "vein: distance of its line from the entry";
    let through = Check::held(what, beside, most, "mm").or(|| {
        (
            format!("the vein’s line passes {beside:.1} mm beside the entry"),
            "check entry.pixel and entry.vein".to_owned(),
        )
    });
    let off = d.vein.iter().map(|p| axis::beside(&d.vein, &line, p));
    let off = off.fold(0.0, f64::max);
    let what = "vein: largest distance of its points from their line";
    let straight = Check::held(what, off, most, "mm").or(|| {
        (
            format!("the vein bends: its points lie up to {off:.1} mm off their line"),
            "give its course near the entry only".to_owned(),
        )
    });
    Some([through, straight])
}
