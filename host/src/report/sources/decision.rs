//! The decision's part of the puncture's section, with the fast model over all angles.

use crate::puncture::decision::{Decision, Row, Sensitivity, against, given_row};
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
            "The curves are the fast model’s: a closed form whose peaks are {:.1} % RMS off the reference simulation, as is the peak over the angle; dots mark where a layer gives way. With --puncture (or by the command puncture) they are simulated.",
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
        settings: Vec::new(),
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
        against: against_each(&rows),
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

/// A column per angle: a phone's window holds four, and a printed page as many as one compares.
fn decision(rows: &[Row], d: &Decision, given: Option<f64>) -> Table {
    let across = |name: &str, cell: &dyn Fn(&Row) -> String| {
        let cells = rows.iter().map(cell);
        std::iter::once(name.to_owned()).chain(cells).collect()
    };
    let figure = |x: f64| format!("{x:.2}").replace('-', "−");
    let by = |r: &Row| match r.source {
        "reference" => "simulated".to_owned(),
        _ => "fast model".to_owned(),
    };
    let body: Vec<Vec<String>> = vec![
        across("this angle is", &|r| is(r, d, given).to_owned()),
        across("peak force / N", &|r| figure(r.peak_force_n)),
        across("its σ / N", &|r| figure(r.peak_error_n)),
        across("force by", &by),
        across("work / N·mm", &|r| figure(r.work_n_mm)),
        across("path to the lumen / mm", &|r| figure(r.path_mm)),
        across("time for it / s", &|r| figure(r.duration_s)),
        across("clearance to far wall / mm", &|r| figure(r.clearance_mm)),
        across("straight length in lumen / mm", &|r| {
            figure(r.lumen_length_mm)
        }),
    ];
    Table {
        head: across("", &|r| format!("{}°", plain(r.angle_deg))),
        rows: body,
    }
}

/// What an angle is to the decision.
fn is(r: &Row, d: &Decision, given: Option<f64>) -> &'static str {
    let chosen = r.angle_deg == d.angle_deg;
    match given {
        Some(given) if given == r.angle_deg && chosen => "given; the criterion’s too",
        Some(given) if given == r.angle_deg => "given: used",
        Some(_) if chosen => "the criterion’s: not used",
        None if chosen => "chosen",
        _ => "compared",
    }
}

/// What speaks against each angle, a sentence each.
fn against_each(rows: &[Row]) -> Vec<String> {
    let words = |r: &Row| match r.flags.is_empty() {
        true => "nothing that is checked".to_owned(),
        false => r.flags.join("; "),
    };
    let angle = |r: &Row| format!("Against {}°: {}.", plain(r.angle_deg), words(r));
    rows.iter().map(angle).collect()
}

fn sensitivity(rows: &[Row], d: &Decision) -> Table {
    type Force = fn(&Sensitivity) -> f64;
    // Each with the word by which its answer is known.
    let cases: [(&str, &str, Force); 4] = [
        ("friction 0.3", "0.3", |s| s.friction_0_3),
        ("friction 0.7", "0.7", |s| s.friction_0_7),
        ("toughness halved", "halv", |s| s.toughness_half),
        ("toughness doubled", "doub", |s| s.toughness_double),
    ];
    let mut head = vec![String::new()];
    head.extend(rows.iter().map(|r| format!("{}°", plain(r.angle_deg))));
    head.push("lowest of those compared".to_owned());
    let row = |(name, word, force): &(&str, &str, Force)| {
        let found = d.variations.iter().find(|v| v.case.contains(word));
        let best = found.map_or("–".to_owned(), |v| format!("{:.0}°", v.angle_deg));
        let forces = rows.iter().map(|r| format!("{:.2}", force(&r.sensitivity)));
        let cells = std::iter::once((*name).to_owned()).chain(forces);
        cells.chain([best]).collect()
    };
    Table {
        head,
        rows: cases.iter().map(row).collect(),
    }
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
        assert_eq!(section.decision.head.len(), 1 + d.rows.len());
        let peaks = &section.decision.rows[1][1..];
        for (cell, row) in peaks.iter().zip(&d.rows) {
            assert_eq!(*cell, format!("{:.2}", row.peak_force_n));
        }
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
        for row in &section.sensitivity.rows {
            assert_eq!(row.len(), 2 + d.rows.len());
            assert!(row.last().unwrap().ends_with('°'), "{row:?}");
        }
    }
}
