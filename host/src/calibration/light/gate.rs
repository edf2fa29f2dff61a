//! The gate of the light planes: positions in the wrong unit, planes that disagree, stripes that
//! are not where their position puts them, and too little variety of board poses.

use super::Options;
use super::check::{Report, Solution};
use super::strand::Strand;
use crate::board::BoardGeometry;
use crate::calibration::finding::{Cause, Finding, Gate, Severity};
use crate::calibration::{Covariance, PARAMETERS};
use crate::checks::Limit;
use crate::geometry::{PARAMETERS as CAMERA, Vector3, tangent_basis};
use nalgebra::Vector4;

/// |a| is the cosine between travel and plane normal. How far that angle may be from the one that
/// the rig is built with: refused and named, radians.
const ANGLE: (f64, f64) = (
    15.0 * std::f64::consts::PI / 180.0,
    8.0 * std::f64::consts::PI / 180.0,
);
/// How far |a| may be beyond the cosine for the tolerance of squares and steps: refused and named.
const EXCESS: (f64, f64) = (0.02, 0.005);
/// Standard deviation of the plane in the middle of the calibrated volume: refused, named, mm.
const PLANE_SIGMA_MM: (f64, f64) = (0.3, 0.1);
/// Hold-out error at which no result is given, mm: twice what the paper's own rig shows.
pub const REFUSE_HOLD_OUT_MM: f64 = 0.3;
/// The same of the worst position: refused, named, mm. A good slide's stays under 0.01.
const HOLD_OUT_MM: (f64, f64) = (REFUSE_HOLD_OUT_MM, 0.06);
/// Board poses that show the stripe: fewer are named.
const FEW_POSES: f64 = 4.0;
/// χ² and angle beyond which a position's own plane is named as turned against the common normal.
const TURNED_CHI2: f64 = 50.0;
/// See [`TURNED_CHI2`], degrees.
const TURNED_DEG: f64 = 0.2;
/// A stripe with fewer of its centres near its plane is not where its position puts it.
const LEAST_USED: f64 = 0.3;

/// What the gate looks at.
pub(super) struct Evidence<'a> {
    pub solution: &'a Solution<'a>,
    pub covariance: &'a Covariance,
    pub report: &'a Report,
    pub strands: &'a [Strand],
    pub board: &'a BoardGeometry,
    pub options: Options,
}

pub(super) fn examine(e: &Evidence) -> Gate {
    let mut gate = Gate::default();
    travel(e, &mut gate);
    certainty(e, &mut gate);
    stripes(e, &mut gate);
    planes(e, &mut gate);
    gate
}

fn travel(e: &Evidence, gate: &mut Gate) {
    if !e.solution.travels {
        return;
    }
    let a = e.solution.rig.light.a.abs();
    let expected = e.options.travel_angle.abs();
    let within = |angle: f64, excess: f64| {
        let least = (expected + angle).min(std::f64::consts::FRAC_PI_2).cos();
        let most = (expected - angle).max(0.0).cos();
        Limit::Between([least - excess, most + excess])
    };
    let refuse = !within(ANGLE.0, EXCESS.0).holds(a);
    let usual = gate.holds(
        "light planes: |a|, their travel over the slide’s",
        a,
        within(ANGLE.1, EXCESS.1),
        "",
    );
    if refuse {
        let near = |unit: f64| (a / unit).ln().abs() < 0.3;
        let guess = if near(1000.0) {
            "the positions seem to be in metres".to_owned()
        } else if near(25.4) {
            "the positions seem to be in inches".to_owned()
        } else if near(10.0) {
            "the positions seem to be in centimetres".to_owned()
        } else if near(1e-3) {
            "the positions seem to be in micrometres".to_owned()
        } else {
            format!(
                "either the positions (steps per mm) are off by a factor of {a:.4}, or the board's squares are {:.3} mm rather than {:.3} mm",
                e.board.square_mm / a,
                e.board.square_mm
            )
        };
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::TravelUnit,
            view: None,
            what: format!("the light plane moves by {a:.4} mm for each mm of the slide: {guess}"),
            advice: "give the positions in mm and the square's true size, or the angle between travel and light plane if the rig is built with one".into(),
        });
    } else if !usual {
        gate.findings.push(Finding {
            severity: Severity::Warn,
            cause: Cause::ObliqueTravel,
            view: None,
            what: format!(
                "the light plane moves by {a:.4} mm for each mm of the slide (an angle of {:.0}° between travel and normal)",
                a.min(1.0).acos().to_degrees()
            ),
            advice: "check the positions' unit and the square's size if the rig is not built so".into(),
        });
    }
}

/// Standard deviation of the plane's distance in the middle of the measured volume, mm.
fn plane_sigma(e: &Evidence) -> f64 {
    let light = &e.solution.rig.light;
    let centre: Vector3 = e
        .solution
        .poses
        .iter()
        .map(|p| {
            let half =
                (e.board.point(0).coords + e.board.point(e.board.corners() - 1).coords) / 2.0;
            p.rotation * half + p.translation
        })
        .sum::<Vector3>()
        / e.solution.poses.len() as f64;
    let x = e.solution.positions.iter().sum::<f64>() / e.solution.positions.len() as f64;
    let t = tangent_basis(&light.normal).transpose() * centre;
    let j = Vector4::new(t.x, t.y, x, 1.0);
    let c = e.covariance.fixed_view::<4, 4>(CAMERA, CAMERA);
    (j.transpose() * c * j)[0].sqrt()
}

/// How heavy a figure weighs that is over its limit: refused over the second one, or if it is none.
fn beyond(figure: f64, refuse: f64) -> Severity {
    if figure <= refuse {
        Severity::Warn
    } else {
        Severity::Refuse
    }
}

fn certainty(e: &Evidence, gate: &mut Gate) {
    debug_assert_eq!(CAMERA + 4, PARAMETERS);
    let sigma = plane_sigma(e);
    let (refuse, warn) = PLANE_SIGMA_MM;
    let known = gate.holds(
        "light planes: σ in the middle of the calibrated volume",
        sigma,
        Limit::AtMost(warn),
        "mm",
    );
    if !known {
        gate.findings.push(Finding {
            severity: beyond(sigma, refuse),
            cause: Cause::LightGeometry,
            view: None,
            what: format!("the light planes are known to ± {sigma:.2} mm only"),
            advice: "add board poses: nearer and farther, tilted to different sides".into(),
        });
    }
    let poses = gate.holds(
        "light planes: board poses that show the stripe",
        e.solution.poses.len() as f64,
        Limit::AtLeast(FEW_POSES),
        "",
    );
    if !poses {
        gate.findings.push(Finding {
            severity: Severity::Warn,
            cause: Cause::TooFewPoints,
            view: None,
            what: format!("{} board poses show the stripe", e.solution.poses.len()),
            advice: "take six or more, so that one bad pose is noticed".into(),
        });
    }
}

fn stripes(e: &Evidence, gate: &mut Gate) {
    let mut bad = 0_u32;
    for (k, strand) in e.strands.iter().enumerate() {
        let used = e.report.strand_used[k];
        if used < LEAST_USED {
            bad += 1;
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::BadStripe,
                view: Some(strand.view),
                what: format!(
                    "the stripe at {} mm lies {:.1} mm from its light plane ({:.0} % of it used)",
                    strand.slide_mm,
                    e.report.strand_mm[k].abs(),
                    100.0 * used
                ),
                advice:
                    "check that the image belongs to this position and that the board stood still"
                        .into(),
            });
        }
    }
    gate.holds(
        "light planes: stripes off their plane",
        f64::from(bad),
        Limit::AtMost(0.0),
        "",
    );
    if 4 * bad as usize > e.strands.len() {
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::BadStripe,
            view: None,
            what: format!(
                "{bad} of {} stripes do not lie on their light planes",
                e.strands.len()
            ),
            advice: "check the order of images and positions, and that nothing moved".into(),
        });
    }
}

fn planes(e: &Evidence, gate: &mut Gate) {
    let mut turned = 0_u32;
    for (plane, &chi2) in e.report.planes.iter().zip(&e.report.disagreement) {
        if plane.points == 0 {
            gate.findings.push(Finding {
                severity: Severity::Refuse,
                cause: Cause::PlaneDisagrees,
                view: None,
                what: format!(
                    "no stripe at {} mm lies where the other positions put its plane",
                    plane.slide_mm
                ),
                advice: "check this position: it may be wrong by a whole step, or its images belong elsewhere".into(),
            });
            continue;
        }
        let angle = plane
            .plane
            .normal
            .angle(&e.solution.rig.light.normal)
            .to_degrees();
        if chi2 > TURNED_CHI2 && angle > TURNED_DEG {
            turned += 1;
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::PlaneDisagrees,
                view: None,
                what: format!(
                    "the plane at {} mm is turned by {angle:.2}° against the common normal",
                    plane.slide_mm
                ),
                advice: "check that the slide runs straight and the projector is fixed".into(),
            });
        }
    }
    gate.holds(
        "light planes: positions turned against the common normal",
        f64::from(turned),
        Limit::AtMost(0.0),
        "",
    );
    let worst = e.report.hold_out_mm.iter().copied().fold(0.0, f64::max);
    let (refuse, warn) = HOLD_OUT_MM;
    let predicted = gate.holds(
        "light planes: largest hold-out error",
        worst,
        Limit::AtMost(warn),
        "mm",
    );
    if !predicted {
        gate.findings.push(Finding {
            severity: beyond(worst, refuse),
            cause: Cause::HoldOut,
            view: None,
            what: format!("a position predicted from the others misses its plane by {worst:.2} mm"),
            advice: "check the positions for a wrong entry, and the slide for slip".into(),
        });
    }
}

/// The gate's limits by name, for the report.
pub fn limits() -> Vec<(&'static str, String)> {
    let pair = |(refused, named): (f64, f64), unit: &str| format!("{refused}{unit}, {named}{unit}");
    let mut all = vec![
        (
            "light planes: travel off the normal refused, named at",
            format!("{:.0}°, {:.0}°", ANGLE.0.to_degrees(), ANGLE.1.to_degrees()),
        ),
        (
            "light planes: |a| beyond the cosine refused, named at",
            pair(EXCESS, ""),
        ),
        (
            "light planes: σ in the middle refused, named at",
            pair(PLANE_SIGMA_MM, " mm"),
        ),
        (
            "light planes: hold-out error refused, named at",
            pair(HOLD_OUT_MM, " mm"),
        ),
        (
            "light planes: least part of a stripe used",
            format!("{} %", 100.0 * LEAST_USED),
        ),
        (
            "light planes: named with fewer board poses than",
            FEW_POSES.to_string(),
        ),
        (
            "light planes: a position’s own plane named as turned beyond",
            format!("χ² of {TURNED_CHI2} and {TURNED_DEG}°"),
        ),
    ];
    all.extend(super::strand::limits());
    all
}
