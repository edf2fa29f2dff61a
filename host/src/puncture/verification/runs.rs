//! Whole punctures on a coarse mesh: energy closes, nothing inverts, layers come in order.

use super::super::events::events;
use super::super::output::summary;
use super::super::run::{Numerics, Run, puncture};
use super::super::tissue::Setup;

fn coarse() -> Numerics {
    Numerics {
        h_mm: 0.35,
        advance: 0.002,
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
        assert!(run.energy_error() < 0.01, "{angle}: {}", run.energy_error());
        assert!(
            run.kinetic_share() < 0.05,
            "{angle}: {}",
            run.kinetic_share()
        );
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
        advance: 0.004,
        ..Numerics::default()
    };
    let run = run(&Setup::default(), 15.0, &numerics);
    assert!(run.samples.iter().all(|s| s.force_n.is_finite()));
    assert!(run.energy_error() < 0.02, "{}", run.energy_error());
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
    match puncture(&Setup::default(), 45.0, &n, &|_| {}) {
        Ok(run) => {
            let last = run.samples[run.samples.len() - 1];
            let through = run.severed.path_mm[2].unwrap_or(f64::NAN);
            assert!(last.path_mm > through + 1.9, "{} {through}", last.path_mm);
            assert!(run.energy_error() < 0.015, "{}", run.energy_error());
        }
        // A crushed brick is a clear end, not a silent one.
        Err(e) => assert!(e.to_string().contains("the run stopped at"), "{e}"),
    }
}
