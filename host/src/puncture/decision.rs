//! Which angle: the paper's criterion, a constrained one, and what speaks against the answer.
//!
//! The paper takes the angle with the lowest puncture force (Section 3.4). That follows from
//! friction times path: the steeper the needle, the shorter its way through the layers. It leaves
//! out where the tip goes: when the heel of the bevel has just come through the roof of the vein,
//! the tip stands B sin θ + D cos θ below the roof (B = D/tan β), and must not be through the far
//! wall. A row per angle holds both sides.

use super::fast::Calibration;
use super::tissue::Setup;
use crate::checks::{Check, Limit};
use serde::Serialize;

/// What is usual where people do it by hand, degrees.
pub const CLINICAL_DEG: [f64; 2] = [15.0, 30.0];
/// How far the paper goes on along the vein after the puncture, mm.
pub const ADVANCE_MM: f64 = 5.0;
/// Flag of an angle outside [`CLINICAL_DEG`].
const OUTSIDE: &str = "outside the clinical 15–30°";
/// The angles that the fast model was fitted to, degrees: beyond them its forces are extrapolated.
pub const FITTED_DEG: [f64; 2] = [15.0, 75.0];
/// The paper's angles, degrees.
pub const PAPER_ANGLES_DEG: [f64; 3] = [30.0, 45.0, 60.0];

/// How an angle is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// Lowest peak force (paper, Section 3.4).
    #[default]
    Paper,
    /// Lowest peak force, then work, among the angles at which the whole bevel fits into the lumen
    /// and the straight way in it is as long as the paper's advance.
    Constrained,
}

/// What the reference solver said about an angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Peak force, N.
    pub peak_force_n: f64,
    /// Work, N·mm.
    pub work_n_mm: f64,
    /// Side of a brick, mm.
    pub mesh_mm: f64,
}

/// Peak force by the fast model when an assumption changes, N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Friction 0.3.
    pub friction_0_3: f64,
    /// Friction 0.7.
    pub friction_0_7: f64,
    /// Half of each fracture energy.
    pub toughness_half: f64,
    /// Twice each fracture energy.
    pub toughness_double: f64,
}

/// What speaks for and against an angle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Peak force, N, and whether the reference solver or the fast model gave it.
    pub peak_force_n: f64,
    /// "reference" or "fast".
    pub source: &'static str,
    /// Error of that, one sigma, N.
    pub peak_error_n: f64,
    /// Work of the needle, N·mm.
    pub work_n_mm: f64,
    /// Path from skin to lumen, mm.
    pub path_mm: f64,
    /// Time of that path, s.
    pub duration_s: f64,
    /// Room between tip and far wall when the heel has just come through the roof, mm; negative if
    /// the tip is through the far wall by then.
    pub clearance_mm: f64,
    /// Straight way along the axis in the lumen, mm.
    pub lumen_length_mm: f64,
    /// Peak force when assumptions change.
    pub sensitivity: Sensitivity,
    /// Whether the bevel fits and the straight way is long enough.
    pub fits: bool,
    /// What speaks against it, in words.
    pub flags: Vec<String>,
}

/// The answer when an assumption changes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Variation {
    /// Which.
    pub case: &'static str,
    /// Angle with the lowest peak force then, degrees.
    pub angle_deg: f64,
    /// Largest less smallest peak force, N.
    pub spread_n: f64,
    /// False if that is less than the model's own error.
    pub preference: bool,
}

/// The answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// The wanted angle, degrees.
    pub angle_deg: f64,
    /// "paper" or "constrained".
    pub criterion: Criterion,
    /// The paper's answer, whatever the criterion, degrees.
    pub paper_angle_deg: f64,
    /// The constrained answer, degrees; None if no angle meets the constraints.
    pub constrained_angle_deg: Option<f64>,
    /// False if the forces differ by less than the model's own error.
    pub preference: bool,
    /// Error of a peak force, as a share of it.
    pub model_error: f64,
    /// One plain sentence.
    pub sentence: String,
    /// A row per angle.
    pub rows: Vec<Row>,
    /// Whether the answer stands when assumptions change (fast model).
    pub variations: Vec<Variation>,
}

/// Room between tip and far wall when the heel has just come through the roof, mm.
pub fn clearance_mm(setup: &Setup, angle: f64) -> f64 {
    let d = setup.needle.diameter_mm;
    let bevel = d / setup.needle.bevel_deg.to_radians().tan();
    setup.layers.lumen_mm - bevel * angle.sin() - d * angle.cos()
}

/// Straight way along the axis in the lumen, mm. To a nanometre: at 30° it is just what is asked.
fn straight_mm(setup: &Setup, angle: f64) -> f64 {
    (setup.layers.lumen_mm / angle.sin() * 1e6).round() / 1e6
}

/// The checks of an angle (degrees), whoever chose it.
pub fn checks(setup: &Setup, angle_deg: f64) -> Vec<Check> {
    let angle = angle_deg.to_radians();
    let (clearance, straight) = (clearance_mm(setup, angle), straight_mm(setup, angle));
    let check = |what: &str, value, limit, unit, words: &dyn Fn() -> String| {
        Check::held(what, value, limit, unit).or(|| (words(), String::new()))
    };
    let [from, to] = FITTED_DEG;
    vec![
        check(
            "needle angle: clinical range",
            angle_deg,
            Limit::Between(CLINICAL_DEG),
            "°",
            &|| OUTSIDE.to_owned(),
        ),
        check(
            "needle angle: range that the puncture model was fitted to",
            angle_deg,
            Limit::Between(FITTED_DEG),
            "°",
            &|| format!("outside the {from}–{to}° that the puncture model was fitted to"),
        ),
        check(
            "needle angle: room to the far wall, the bevel just in the vein",
            clearance,
            Limit::AtLeast(0.0),
            "mm",
            &|| {
                format!(
                    "the tip is {:.1} mm through the far wall before the whole bevel is in the vein",
                    -clearance
                )
            },
        ),
        check(
            "needle angle: straight way in the lumen",
            straight,
            Limit::AtLeast(ADVANCE_MM),
            "mm",
            &|| {
                format!(
                    "only {straight:.1} mm straight on in the lumen: the needle must be lowered \
                     before it advances {ADVANCE_MM} mm"
                )
            },
        ),
    ]
}

/// What speaks against an angle (degrees).
fn flags(setup: &Setup, angle_deg: f64) -> Vec<String> {
    let checks = checks(setup, angle_deg).into_iter();
    checks.filter(|c| !c.sound()).map(|c| c.words).collect()
}

/// "60° is outside …, and …".
fn faults(angle_deg: f64, flags: &[&str]) -> String {
    let is = match flags.first() {
        Some(first) if first.starts_with("outside") => "is",
        _ => "has a fault:",
    };
    format!("{angle_deg}° {is} {}", flags.join(", and "))
}

/// What speaks against an angle (degrees) that was given, not decided: the checks and words of a
/// decision's row. None where nothing does.
pub fn against(setup: &Setup, angle_deg: f64) -> Option<String> {
    let flags = flags(setup, angle_deg);
    let words: Vec<&str> = flags.iter().map(String::as_str).collect();
    (!words.is_empty()).then(|| format!("the given {}.", faults(angle_deg, &words)))
}

/// The row of an angle (degrees) that was given, not compared, by the fast model.
pub fn given_row(setup: &Setup, angle_deg: f64) -> Row {
    row(setup, Calibration::stored(), angle_deg, None)
}

fn row(setup: &Setup, fast: &Calibration, angle_deg: f64, reference: Option<&Reference>) -> Row {
    let angle = angle_deg.to_radians();
    let here = fast.angle(setup, angle_deg);
    let rubbing = |friction: f64| {
        let s = Setup { friction, ..*setup };
        fast.angle(&s, angle_deg).peak_force_n
    };
    let tough = |k: f64| fast.angle(&setup.with_toughness(k), angle_deg).peak_force_n;
    let (peak, work, source, error) = match reference {
        Some(r) => {
            let error = fast.mesh_error_at(r.mesh_mm);
            (r.peak_force_n, r.work_n_mm, "reference", error)
        }
        None => (
            here.peak_force_n,
            here.work_n_mm,
            "fast",
            fast.peak_error.hypot(fast.mesh_error),
        ),
    };
    let clearance = clearance_mm(setup, angle);
    let straight = straight_mm(setup, angle);
    Row {
        angle_deg,
        peak_force_n: peak,
        source,
        peak_error_n: error * peak,
        work_n_mm: work,
        path_mm: here.path_mm,
        duration_s: here.path_mm / setup.needle.speed_mm_s,
        clearance_mm: clearance,
        lumen_length_mm: straight,
        sensitivity: Sensitivity {
            friction_0_3: rubbing(0.3),
            friction_0_7: rubbing(0.7),
            toughness_half: tough(0.5),
            toughness_double: tough(2.0),
        },
        fits: clearance >= 0.0 && straight >= ADVANCE_MM,
        flags: flags(setup, angle_deg),
    }
}

fn variation(setup: &Setup, fast: &Calibration, angles: &[f64], case: &'static str) -> Variation {
    let forces: Vec<f64> = angles
        .iter()
        .map(|&a| fast.angle(setup, a).peak_force_n)
        .collect();
    let (mut best, mut most) = (0, 0);
    for (i, f) in forces.iter().enumerate() {
        if *f < forces[best] {
            best = i;
        }
        if *f > forces[most] {
            most = i;
        }
    }
    let spread_n = forces[most] - forces[best];
    let error = fast.peak_error.hypot(fast.mesh_error);
    Variation {
        case,
        angle_deg: angles[best],
        spread_n,
        preference: spread_n > error * forces[most].hypot(forces[best]),
    }
}

/// Decides among angles (degrees); where the reference solver has run, its force counts. None
/// without an angle.
pub fn decide(
    setup: &Setup,
    fast: &Calibration,
    angles: &[f64],
    reference: &[Reference],
    criterion: Criterion,
) -> Option<Decision> {
    let rows: Vec<Row> = angles
        .iter()
        .map(|&a| {
            let known = reference.iter().find(|r| (r.angle_deg - a).abs() < 1e-9);
            row(setup, fast, a, known)
        })
        .collect();
    let least = |a: &&Row, b: &&Row| {
        let force = a.peak_force_n.total_cmp(&b.peak_force_n);
        force.then(a.work_n_mm.total_cmp(&b.work_n_mm))
    };
    let paper = rows.iter().min_by(least)?;
    let constrained = rows.iter().filter(|r| r.fits).min_by(least);
    let most = rows.iter().map(|r| r.peak_force_n).fold(0.0, f64::max);
    let worst = rows
        .iter()
        .max_by(|a, b| a.peak_force_n.total_cmp(&b.peak_force_n))?;
    let error = paper.peak_error_n.hypot(worst.peak_error_n);
    let preference = rows.len() == 1 || most - paper.peak_force_n > error;
    let chosen = match criterion {
        Criterion::Paper => paper,
        // Where nothing fits, the angle that comes nearest to it.
        Criterion::Constrained => constrained.or_else(|| {
            rows.iter()
                .max_by(|a, b| a.clearance_mm.total_cmp(&b.clearance_mm))
        })?,
    };
    let with = |f: &dyn Fn(&mut Setup)| {
        let mut s = *setup;
        f(&mut s);
        s
    };
    let cases: [(&'static str, Setup); 5] = [
        ("friction 0", with(&|s| s.friction = 0.0)),
        ("friction 0.3", with(&|s| s.friction = 0.3)),
        ("friction 0.7", with(&|s| s.friction = 0.7)),
        ("toughness halved", setup.with_toughness(0.5)),
        ("toughness doubled", setup.with_toughness(2.0)),
    ];
    let variations = cases
        .iter()
        .map(|(case, s)| variation(s, fast, angles, case))
        .collect();
    let sentence = sentence(
        &rows,
        chosen,
        paper,
        constrained,
        criterion,
        preference,
        worst,
    );
    Some(Decision {
        angle_deg: chosen.angle_deg,
        criterion,
        paper_angle_deg: paper.angle_deg,
        constrained_angle_deg: constrained.map(|r| r.angle_deg),
        preference,
        model_error: paper.peak_error_n / paper.peak_force_n.max(1e-12),
        sentence,
        rows,
        variations,
    })
}

fn sentence(
    rows: &[Row],
    chosen: &Row,
    paper: &Row,
    constrained: Option<&Row>,
    criterion: Criterion,
    preference: bool,
    worst: &Row,
) -> String {
    let by = if rows.iter().all(|r| r.source == "reference") {
        "simulated"
    } else {
        "fast model"
    };
    let mut text = if rows.len() == 1 {
        format!(
            "{}° needs {:.1} N ({by})",
            chosen.angle_deg, chosen.peak_force_n
        )
    } else if !preference {
        format!(
            "No preference: the peak forces, {:.1} to {:.1} N ({by}), differ by less than the model's own \
             error; {}° is the lowest in name",
            paper.peak_force_n, worst.peak_force_n, paper.angle_deg
        )
    } else {
        format!(
            "{}° needs the least force, {:.1} N against {:.1} N at {}° ({by})",
            paper.angle_deg, paper.peak_force_n, worst.peak_force_n, worst.angle_deg
        )
    };
    if criterion == Criterion::Constrained {
        text += &match constrained {
            Some(r) => format!(
                "; with room for the bevel and {ADVANCE_MM} mm of straight way in the vein it is {}°",
                r.angle_deg
            ),
            None => format!(
                "; at none of the angles is there room for the bevel and {ADVANCE_MM} mm of straight \
                 way in the vein, {}° comes nearest",
                chosen.angle_deg
            ),
        };
    }
    // The last flag only says what to do next; the others break something.
    let against: Vec<&str> = chosen
        .flags
        .iter()
        .filter(|f| !f.starts_with("only"))
        .map(String::as_str)
        .collect();
    if !against.is_empty() {
        text += &format!(", but {}", faults(chosen.angle_deg, &against));
        if criterion == Criterion::Paper
            && let Some(r) = constrained
            && r.angle_deg != chosen.angle_deg
        {
            text += &format!("; of these angles {}° keeps clear of it", r.angle_deg);
        }
    }
    text + "."
}

/// The decision of the paper's setup by the fast model: Table 5, 22G needle, the paper's angles and
/// criterion. Microseconds.
pub fn default_decision() -> Decision {
    decision(&Setup::default(), &PAPER_ANGLES_DEG, Criterion::Paper)
}

/// The decision by the fast model alone. Angles outside 10–80° are left out; without any, the
/// paper's are taken.
pub fn decision(setup: &Setup, angles: &[f64], criterion: Criterion) -> Decision {
    let fast = Calibration::stored();
    let usable: Vec<f64> = angles
        .iter()
        .copied()
        .filter(|a| (10.0..=80.0).contains(a))
        .collect();
    let angles: &[f64] = if usable.is_empty() {
        &PAPER_ANGLES_DEG
    } else {
        &usable
    };
    decide(setup, fast, angles, &[], criterion).unwrap_or_else(|| Decision {
        angle_deg: angles[0],
        criterion,
        paper_angle_deg: angles[0],
        constrained_angle_deg: None,
        preference: false,
        model_error: 1.0,
        sentence: "No angle could be compared.".to_owned(),
        rows: Vec::new(),
        variations: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reference(forces: [f64; 3]) -> Vec<Reference> {
        PAPER_ANGLES_DEG
            .iter()
            .zip(forces)
            .map(|(&angle_deg, peak_force_n)| Reference {
                mesh_mm: 0.15,
                angle_deg,
                peak_force_n,
                work_n_mm: 1.0,
            })
            .collect()
    }

    fn of(forces: [f64; 3], criterion: Criterion) -> Decision {
        let setup = Setup::default();
        let known = reference(forces);
        decide(
            &setup,
            Calibration::stored(),
            &PAPER_ANGLES_DEG,
            &known,
            criterion,
        )
        .expect("three angles")
    }

    #[test]
    fn the_paper_takes_the_lowest_peak_force() {
        let d = of([3.0, 2.0, 1.0], Criterion::Paper);
        assert_eq!(
            (d.angle_deg, d.paper_angle_deg, d.preference),
            (60.0, 60.0, true)
        );
        assert!(
            d.sentence.contains("clinical") && d.sentence.contains("far wall"),
            "{}",
            d.sentence
        );
        assert_eq!(of([1.0, 2.0, 3.0], Criterion::Paper).angle_deg, 30.0);
    }

    #[test]
    fn under_constraints_the_bevel_must_fit_into_the_vein() {
        // By hand: 2.5 − 3.387 sin θ − 0.72 cos θ = 0.183, −0.404, −0.793 mm.
        let s = Setup::default();
        for (a, c) in [(30.0_f64, 0.183), (45.0, -0.404), (60.0, -0.793)] {
            assert!((clearance_mm(&s, a.to_radians()) - c).abs() < 1e-3);
        }
        let d = of([3.0, 2.0, 1.0], Criterion::Constrained);
        assert_eq!((d.angle_deg, d.paper_angle_deg), (30.0, 60.0));
        assert_eq!(d.constrained_angle_deg, Some(30.0));
        let steep = decide(
            &s,
            Calibration::stored(),
            &[50.0, 60.0],
            &[],
            Criterion::Constrained,
        )
        .expect("two angles");
        assert_eq!((steep.constrained_angle_deg, steep.angle_deg), (None, 50.0));
        assert!(
            steep.sentence.contains("at none of the angles"),
            "{}",
            steep.sentence
        );
    }

    #[test]
    fn under_constraints_the_straight_way_must_be_as_long_as_the_advance() {
        // A thin needle in a wide vein: 45° has room for its bevel, but 3.2/sin 45° = 4.5 mm.
        let mut s = Setup::default();
        s.needle.diameter_mm = 0.5;
        s.layers.lumen_mm = 3.2;
        let fast = Calibration::stored();
        let d = decide(&s, fast, &[30.0, 45.0], &[], Criterion::Constrained).expect("two angles");
        assert!(d.rows.iter().all(|r| r.clearance_mm > 0.0));
        assert_eq!((d.paper_angle_deg, d.angle_deg), (45.0, 30.0));
    }

    #[test]
    fn a_clinical_angle_without_room_is_told_in_a_whole_sentence() {
        let mut s = Setup::default();
        s.layers.lumen_mm = 2.0;
        let fast = Calibration::stored();
        let d = decide(&s, fast, &[30.0], &[], Criterion::Paper).expect("an angle");
        let end = "but 30° has a fault: the tip is 0.3 mm through the far wall before the whole \
                   bevel is in the vein.";
        assert!(d.sentence.ends_with(end), "{}", d.sentence);
    }

    /// The sentence of a given angle holds what a decision for the same angle alone holds.
    #[test]
    fn a_given_angle_is_told_what_a_chosen_one_is() {
        let s = Setup::default();
        let (clinical, fitted, wall) = (OUTSIDE, "outside the 15–75°", "through the far wall");
        let of = |a: f64| against(&s, a).unwrap_or_default();
        for (angle, named, not) in [
            (85.0, &[clinical, fitted, wall, "only 2.5 mm"][..], &[][..]),
            (60.0, &[clinical, wall, "only 2.9 mm"], &[fitted]),
            (3.0, &[clinical, fitted], &[wall, "only"]),
        ] {
            let words = of(angle);
            assert!(words.starts_with(&format!("the given {angle}° is outside")));
            assert!(named.iter().all(|w| words.contains(w)), "{words}");
            assert!(!not.iter().any(|w| words.contains(w)), "{words}");
        }
        let fast = Calibration::stored();
        let chosen = decide(&s, fast, &[60.0], &[], Criterion::Paper).expect("an angle");
        let faults = chosen.sentence.split(", but ").nth(1).expect("faults");
        assert!(of(60.0).contains(faults.trim_end_matches('.')));
        assert_eq!(against(&s, 25.0), None);
        // The range is that of the runs that the model was fitted to.
        let cases = super::super::fit::CASES.map(|c| c.0);
        let least = cases.iter().copied().fold(f64::INFINITY, f64::min);
        let most = cases.iter().copied().fold(0.0, f64::max);
        assert_eq!(FITTED_DEG, [least, most]);
    }

    #[test]
    fn forces_within_the_error_are_no_preference() {
        let d = of([2.0, 1.99, 1.98], Criterion::Paper);
        assert!(
            !d.preference && d.sentence.starts_with("No preference"),
            "{}",
            d.sentence
        );
    }

    #[test]
    fn coarse_bricks_leave_no_preference() {
        let setup = Setup::default();
        let mut known = reference([2.8, 2.3, 1.9]);
        let decide = |known: &[Reference]| {
            let fast = Calibration::stored();
            super::decide(&setup, fast, &PAPER_ANGLES_DEG, known, Criterion::Paper).unwrap()
        };
        assert!(decide(&known).preference);
        known.iter_mut().for_each(|r| r.mesh_mm = 0.4);
        assert!(!decide(&known).preference);
    }

    #[test]
    fn the_default_is_the_papers_and_comes_at_once() {
        let d = default_decision();
        assert_eq!(d.angle_deg, 60.0);
        assert_eq!(d.rows.len(), 3);
        assert!(
            d.rows
                .iter()
                .all(|r| r.sensitivity.friction_0_3 < r.sensitivity.friction_0_7)
        );
        assert!(
            d.rows
                .iter()
                .all(|r| r.sensitivity.toughness_half < r.sensitivity.toughness_double)
        );
        // The trend is friction × path: without friction the angles differ little.
        let spread = |case: &str| {
            let v = d.variations.iter().find(|v| v.case == case);
            v.map(|v| v.spread_n).expect("the case")
        };
        assert!(spread("friction 0") < 0.2 * spread("friction 0.7"));
        let alike = variation(
            &Setup::default(),
            Calibration::stored(),
            &[45.0, 45.5],
            "nearly the same angle",
        );
        assert!(!alike.preference && d.variations.iter().any(|v| v.preference));
    }
}
