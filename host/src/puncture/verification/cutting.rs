//! Cutting takes the fracture energy times the area, whichever way the crack is opened.

use super::super::cohesive::Law as Crack;
use super::super::contact::{Interface, Rigid, Stiffness};
use super::super::explicit::{Body, Integration};
use super::super::material::Branch;
use super::super::mesh::{Mesh, Region};
use super::super::tissue::Setup;

struct Nothing;

impl Rigid for Nothing {
    fn width(&self, _: f64, _: f64) -> (f64, f64, f64) {
        (-1.0, 0.0, 0.0)
    }
    fn edge(&self, _: f64, _: f64) -> (f64, f64) {
        (f64::INFINITY, 0.0)
    }
    fn axis(&self) -> [f64; 2] {
        [1.0, 0.0]
    }
    fn velocity(&self, _: f64, _: f64) -> [f64; 3] {
        [0.0; 3]
    }
    fn steepest(&self) -> f64 {
        0.0
    }
}

#[test]
fn the_cohesive_law_holds_its_fracture_energy_in_any_mode() {
    let law = Crack::new(1.1, 11.0, 0.5, 0.25, 300.0);
    for mix in [0.0, 0.3, 1.0] {
        // Along a straight path in (y, e) from nothing to open.
        let (mut work, mut most) = (0.0, 0.0);
        let n = 20_000;
        let at = |k: usize| {
            let t = k as f64 / n as f64;
            (0.24 * t * (1.0 - mix), 0.6 * t * mix)
        };
        for k in 0..n {
            let ((y0, e0), (y1, e1)) = (at(k), at(k + 1));
            let p = law.pull(0.5 * (y0 + y1), 0.5 * (e0 + e1), &mut most);
            work += p.traction * (y1 - y0) + p.edge * (e1 - e0);
        }
        let end = law.pull(0.2, 0.3, &mut most);
        assert!((end.gone - 0.55).abs() < 1e-12 && end.stored.abs() < 1e-12);
        assert!((work - 0.55).abs() < 1e-6, "{mix}: {work}");
    }
}

/// Pulls a block off its plane of symmetry: the work at the grips is what the crack took.
#[test]
fn work_to_part_a_block_is_fracture_energy_times_area() {
    let setup = Setup::default();
    let mesh = Mesh::block([0.8, 0.2, 0.6], [4, 1, 3], Region::Skin);
    let calm = Integration {
        damping: 2e-3,
        ..Integration::default()
    };
    // A soft crack in stiff tissue: it opens evenly, without a snap.
    let mut body = Body::new(mesh, |_| setup.muscle.law, Branch::Stabilised, calm);
    let law = Crack::new(0.4, 1.0, 0.5, 0.25, 300.0);
    let mut face = Interface::new(
        &mut body,
        |_, _| true,
        |_| Some(law),
        0.0,
        Stiffness::default(),
    );
    body.hold(0, |_| true);
    body.hold(2, |_| true);
    let grips: Vec<usize> = body
        .places()
        .filter(|&p| body.rest(p)[1] > 0.2 - 1e-9)
        .collect();
    for &p in &grips {
        body.prescribe(p, 1, 0.0);
    }
    let speed = 0.5 / 20_000.0;
    body.set_prescribed(1, |_| speed);
    let mut work = 0.0;
    for _ in 0..20_000 {
        face.apply(&mut body, &Nothing);
        body.internal();
        work -= grips.iter().map(|&p| body.f[1][p]).sum::<f64>() * speed;
        body.advance();
    }
    let expected = 0.4 * 0.8 * 0.6;
    assert!(
        (2.0 * work / expected - 1.0).abs() < 0.01,
        "{} {expected}",
        2.0 * work
    );
    let gone: f64 = face.energies(&body, &Nothing).crack_gone.iter().sum();
    assert!((2.0 * gone / expected - 1.0).abs() < 1e-9);
    let (cut, all) = face.cut_area(Region::Skin);
    assert!((cut - 0.48).abs() < 1e-9 && (all - 0.48).abs() < 1e-9);
}
