//! Whole punctures on a coarse mesh: energy closes, nothing inverts, layers come in order.

use super::super::events::events;
use super::super::output::summary;
use super::super::run::{Numerics, Run, puncture};
use super::super::tissue::Setup;
use rayon::prelude::*;

fn coarse() -> Numerics {
    Numerics {
        h_mm: 0.35,
        ..Numerics::default()
    }
}

fn run(setup: &Setup, angle: f64, numerics: &Numerics) -> Run {
    match puncture(setup, angle, numerics, &|_| {}) {
        Ok(run) => run,
        Err(e) => panic!("{angle}°: {e}"),
    }
}

#[test]
fn energy_closes_and_layers_are_pierced_in_order() {
    let setup = Setup::default();
    for angle in [45.0, 75.0] {
        let run = run(&setup, angle, &coarse());
        assert_eq!(run.refusal(), None, "{angle}");
        // The same limits from the curve itself.
        let work = run.samples[run.samples.len() - 1].energy.needle;
        for s in run.samples.iter().filter(|s| s.energy.needle > 0.01 * work) {
            let e = s.energy;
            assert!(e.missing().abs() < 0.01 * e.needle, "{angle}: {e:?}");
            assert!(e.kinetic < 0.05 * e.internal(), "{angle}: {e:?}");
        }
        assert!(
            run.j_range.0 > 0.9 && run.j_range.1 < 1.1,
            "{:?}",
            run.j_range
        );
        let e = events(&run);
        for pair in e.windows(2) {
            assert!(pair[0].contact_s < pair[1].contact_s, "{angle}: {e:?}");
        }
        assert!(e.iter().all(|e| e.puncture_s.is_some()), "{angle}: {e:?}");
        // The needle stands in the lumen at the end.
        assert!(run.severed.path_mm[2].is_some() && !run.transfixed);
        let s = summary(&run);
        assert!(
            s.peak_force_n > 0.1 && s.peak_force_n < 5.0,
            "{}",
            s.peak_force_n
        );
    }
}

#[test]
fn the_flattest_angle_runs_without_a_crushed_brick() {
    let numerics = Numerics {
        h_mm: 0.4,
        ..Numerics::default()
    };
    let run = run(&Setup::default(), 15.0, &numerics);
    assert!(run.samples.iter().all(|s| s.force_n.is_finite()));
    assert_eq!(run.refusal(), None);
}

#[test]
fn a_run_that_is_not_quasi_static_is_refused_with_the_reason() {
    let hasty = Numerics {
        h_mm: 0.5,
        advance: 0.03,
        ..Numerics::default()
    };
    // It may also stop by itself, in words; what it must not do is pass.
    let reason = match puncture(&Setup::default(), 75.0, &hasty, &|_| {}) {
        Ok(run) => run.refusal().unwrap_or_default(),
        Err(e) => e.to_string(),
    };
    assert!(
        reason.contains("refused") || reason.contains("stopped"),
        "{reason}"
    );
}

fn peak(angle: f64, numerics: Numerics) -> f64 {
    summary(&run(&Setup::default(), angle, &numerics)).peak_force_n
}

/// The whole table, minutes of it, is `cannula puncture --convergence`.
#[test]
fn the_peak_stands_when_step_or_brick_is_halved() {
    let default = Numerics::default();
    let half_step = Numerics {
        advance: 0.5 * default.advance,
        ..default
    };
    let half_brick = Numerics {
        h_mm: 0.5 * default.h_mm,
        ..default
    };
    // 75° has the shortest path: the only one whose fine mesh is cheap enough here.
    let jobs = [
        (75.0, half_brick),
        (60.0, half_step),
        (60.0, default),
        (75.0, default),
    ];
    let peaks: Vec<f64> = jobs
        .par_iter()
        .with_max_len(1)
        .map(|&(a, n)| peak(a, n))
        .collect();
    assert!((peaks[1] / peaks[2] - 1.0).abs() < 0.03, "{peaks:?}");
    assert!((peaks[0] / peaks[3] - 1.0).abs() < 0.1, "{peaks:?}");
}

#[test]
fn cutting_without_friction_takes_the_work_that_is_booked() {
    let setup = Setup {
        friction: 0.0,
        ..Setup::default()
    };
    let run = run(&setup, 60.0, &coarse());
    let end = run.samples[run.samples.len() - 1].energy;
    assert!(end.rubbed == 0.0);
    assert!((end.missing() / end.needle).abs() < 0.01, "{end:?}");
    assert!(end.cut > 0.3, "{end:?}");
}

#[test]
fn a_run_repeats_itself_exactly() {
    let n = Numerics {
        h_mm: 0.5,
        advance: 0.006,
        ..Numerics::default()
    };
    let (a, b) = (
        run(&Setup::default(), 75.0, &n),
        run(&Setup::default(), 75.0, &n),
    );
    assert_eq!(a.samples, b.samples);
}

#[test]
fn going_on_along_the_vein_lowers_the_needle_and_keeps_the_books() {
    let n = Numerics {
        along_vein_mm: 1.0,
        ..coarse()
    };
    let setup = Setup::default();
    let run = run(&setup, 45.0, &n);
    let last = run.samples[run.samples.len() - 1];
    // To the lumen's axis at least, then 1 mm on; the tip no deeper than where it turned.
    let to_axis = setup.lumen_axis_mm() / 45.0_f64.to_radians().sin();
    assert!(last.path_mm > to_axis + 0.99, "{}", last.path_mm);
    assert!(run.severed.path_mm[2].is_some_and(|through| last.path_mm > through + 0.99));
    let deepest = run.samples.iter().map(|s| s.depth_mm).fold(0.0, f64::max);
    assert!((last.depth_mm - deepest).abs() < 1e-9);
    assert_eq!(run.refusal(), None);
}
