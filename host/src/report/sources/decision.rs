//! The decision's part of the puncture's section, with the fast model over all angles.

use crate::puncture::decision::{Decision, Row, against, given_row};
use crate::puncture::fast::Calibration;
use crate::puncture::output::PunctureReport;
use crate::puncture::tissue::Setup;
use crate::report::model::{Model, Puncture, PunctureRun, Table};

/// Said wherever a force is shown: what the model can't be trusted with.
const CAUTION: &str = "The forces are a model's, with assumed toughness and strength; clinical practice is 15–30°. The order of the angles follows mostly from friction times path. «Simulated» is the reference model (finite elements with a cutting needle), «fast model» a closed form fitted to it, with its own error: the two differ by that much.";

/// The section of a decision by the fast model alone. An angle that was `given` by hand (degrees) is
/// used in place of the decision's: it has a row and a curve of its own beside the angles compared.
pub fn decided(d: &Decision, setup: &Setup, given: Option<f64>) -> Puncture {
    let fast = Calibration::stored();
    let mut rows = d.rows.clone();
    if let Some(given) = given
        && !rows.iter().any(|r| r.angle_deg == given)
    {
        rows.push(given_row(setup, given));
        rows.sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg));
    }
    let angles = rows.iter().map(|r| r.angle_deg);
    let (first, last) = match given {
        Some(given) => (given.floor().min(10.0), given.ceil().max(80.0)),
        None => (10.0, 80.0),
    };
    Puncture {
        runs: angles.map(|a| fast_run(fast, setup, a)).collect(),
        curves: format!(
            "The curves are the fast model’s: a closed form whose peaks are {:.1} % RMS off the reference simulation, as is the peak over the angle; dots mark where a layer gives way. `--puncture` (or `cannula puncture`) simulates them.",
            100.0 * fast.peak_error
        ),
        force_over_angle: (first as i32..=last as i32)
            .map(|a| {
                let angle = f64::from(a);
                let peak = fast.angle(setup, angle).peak_force_n;
                let error = d.model_error * peak;
                [angle, peak, (peak - error).max(0.0), peak + error]
            })
            .collect(),
        given_deg: given,
        angle_deg: d.angle_deg,
        criterion: serde_json::to_value(d.criterion)
            .ok()
            .and_then(|v| v.as_str().map(str::to_owned))
            .unwrap_or_default(),
        sentences: match given {
            None => vec![d.sentence.clone(), CAUTION.to_owned()],
            Some(given) => vec![
                against(setup, given).map_or_else(
                    || format!("Nothing that is checked speaks against {given}°."),
                    |words| format!("Against it: {words}"),
                ),
                format!("The criterion’s own sentence: «{}»", d.sentence),
                CAUTION.to_owned(),
            ],
        },
        decision: decision(&rows, d, given),
        sensitivity: sensitivity(&rows, d),
    }
}

/// The force at one angle by the fast model.
fn fast_run(fast: &Calibration, setup: &Setup, angle_deg: f64) -> PunctureRun {
    const POINTS: usize = 240;
    let angle = angle_deg.to_radians();
    let (end, speed) = (fast.end_mm(setup, angle), setup.needle.speed_mm_s);
    let curve: Vec<[f64; 5]> = (0..=POINTS)
        .map(|k| {
            let s = end * k as f64 / POINTS as f64;
            let f = fast.force(setup, angle, s);
            let [skin, fat, vein] = f.layer_n;
            [s / speed, f.total(), skin, fat, vein]
        })
        .collect();
    let passages = fast.passages(setup, angle);
    let events = ["skin", "fat", "vein"].iter().zip(passages).enumerate();
    let events = events.filter(|(_, (_, (contact, _)))| *contact <= end);
    PunctureRun {
        model: Model::Fast,
        angle_deg,
        events: events
            .map(|(k, (layer, (contact, through)))| {
                let peak = curve.iter().map(|c| c[k + 2]).fold(0.0, f64::max);
                let through = (through <= end).then_some(through / speed);
                ((*layer).to_owned(), contact / speed, through, peak)
            })
            .collect(),
        curve,
    }
}

/// The section of a whole report, with the reference's curves.
pub fn punctured(r: &PunctureReport, setup: &Setup) -> Puncture {
    let mut section = decided(&r.decision, setup, None);
    with_reference(&mut section, r);
    section
}

/// Puts the reference's curves in place of the fast model's at the same angles; decision and angle
/// stay.
pub fn with_reference(section: &mut Puncture, r: &PunctureReport) {
    let simulated = |run: &PunctureRun| r.runs.iter().any(|s| s.angle_deg == run.angle_deg);
    section.runs.retain(|run| !simulated(run));
    let fast: Vec<String> = section
        .runs
        .iter()
        .map(|run| format!("{}°", run.angle_deg))
        .collect();
    let runs = r
        .runs
        .iter()
        .zip(&r.curves)
        .map(|(run, curve)| PunctureRun {
            model: Model::Reference,
            angle_deg: run.angle_deg,
            curve: curve
                .iter()
                .map(|c| [c.time_s, c.force_n, c.skin_n, c.fat_n, c.vein_n])
                .collect(),
            events: run
                .events
                .iter()
                .filter_map(|e| {
                    Some((
                        e.layer.to_owned(),
                        e.contact_s?,
                        e.puncture_s,
                        e.peak_force_n,
                    ))
                })
                .collect(),
        });
    section.runs.extend(runs);
    section
        .runs
        .sort_by(|a, b| a.angle_deg.total_cmp(&b.angle_deg));
    section.curves = "The curves are the reference simulation’s (finite elements that the needle cuts), its samples not averaged; the band and line of the peak over the angle are the fast model’s, the dots on it the simulation’s.".to_owned();
    if !fast.is_empty() {
        let at = fast.join(", ");
        section.curves +=
            &format!(" At {at} there is no simulation: that curve is the fast model’s.");
    }
    section.sentences.extend(
        r.stopped
            .iter()
            .map(|s| format!("{}°: {}.", s.angle_deg, s.reason)),
    );
}

/// An angle to a hundredth of a degree, without zeros that say nothing.
fn plain(angle_deg: f64) -> String {
    ((angle_deg * 100.0).round() / 100.0).to_string()
}

fn table(head: &[&str], rows: Vec<Vec<String>>) -> Table {
    Table {
        head: head.iter().map(|h| (*h).to_owned()).collect(),
        rows,
    }
}

fn decision(rows: &[Row], d: &Decision, given: Option<f64>) -> Table {
    let rows = rows.iter().map(|r| {
        let chosen = r.angle_deg == d.angle_deg;
        let is = match given {
            Some(given) if given == r.angle_deg && chosen => "given; the criterion’s too",
            Some(given) if given == r.angle_deg => "given: used",
            Some(_) if chosen => "the criterion’s: not used",
            None if chosen => "chosen",
            _ => "compared",
        };
        vec![
            plain(r.angle_deg),
            is.to_owned(),
            format!("{:.2}", r.peak_force_n),
            format!("{:.2}", r.peak_error_n),
            match r.source {
                "reference" => "simulated",
                _ => "fast model",
            }
            .to_owned(),
            format!("{:.2}", r.work_n_mm),
            format!("{:.2}", r.path_mm),
            format!("{:.2}", r.duration_s),
            format!("{:.2}", r.clearance_mm).replace('-', "−"),
            format!("{:.2}", r.lumen_length_mm),
            if r.flags.is_empty() {
                "nothing speaks against it".to_owned()
            } else {
                r.flags.join("; ")
            },
        ]
    });
    table(
        &[
            "angle / °",
            "",
            "peak / N",
            "σ / N",
            "force by",
            "work / N·mm",
            "path to the lumen / mm",
            "time for it / s",
            "clearance to far wall / mm",
            "straight length in lumen / mm",
            "against it",
        ],
        rows.collect(),
    )
}

fn sensitivity(rows: &[Row], d: &Decision) -> Table {
    let mut rows: Vec<Vec<String>> = rows
        .iter()
        .map(|r| {
            let s = &r.sensitivity;
            let force = |f: f64| format!("{f:.2}");
            vec![
                // A row's name, as "lowest at" is: words, so that both stand left.
                format!("at {}°", plain(r.angle_deg)),
                force(s.friction_0_3),
                force(s.friction_0_7),
                force(s.toughness_half),
                force(s.toughness_double),
            ]
        })
        .collect();
    // The answer under the same assumptions, in the order of the columns where one is known.
    let best = |case: &str| {
        let found = d.variations.iter().find(|v| v.case.contains(case));
        found.map_or("–".to_owned(), |v| format!("{:.0}°", v.angle_deg))
    };
    rows.push(vec![
        "lowest of those compared".to_owned(),
        best("0.3"),
        best("0.7"),
        best("halv"),
        best("doub"),
    ]);
    table(
        &[
            "peak force / N",
            "friction 0.3",
            "friction 0.7",
            "toughness halved",
            "toughness doubled",
        ],
        rows,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::puncture::default_decision;

    #[test]
    fn the_section_says_what_the_decision_says() {
        let d = default_decision();
        let section = decided(&d, &Setup::default(), None);
        assert_eq!(section.angle_deg, d.angle_deg);
        assert_eq!(section.decision.rows.len(), d.rows.len());
        // The curves are of the angles that were compared, and their peaks the decision's.
        for (run, row) in section.runs.iter().zip(&d.rows) {
            assert_eq!((run.model, run.angle_deg), (Model::Fast, row.angle_deg));
            let peak = run.curve.iter().map(|c| c[1]).fold(0.0, f64::max);
            assert!((peak / row.peak_force_n - 1.0).abs() < 0.01, "{peak}");
            let times: Vec<f64> = run.events.iter().filter_map(|e| e.2).collect();
            assert_eq!(times.len(), 3, "skin, fat and vein give way");
            assert!(times.is_sorted(), "{times:?}");
        }
        assert_eq!(section.force_over_angle.len(), 71);
        for [_, peak, low, high] in &section.force_over_angle {
            assert!(low <= peak && peak <= high && *peak > 0.0);
        }
        let answers = section.sensitivity.rows.last().unwrap();
        assert!(answers[1..].iter().all(|a| a.ends_with('°')), "{answers:?}");
    }
}
