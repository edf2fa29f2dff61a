//! Blocks in uniaxial and planar tension, and the pressurised tube, by the explicit solver.

use super::super::explicit::{Body, Integration};
use super::super::material::Branch;
use super::super::mesh::{Mesh, Region};
use super::super::pressure::Lumen;
use super::super::tissue::Setup;
use super::settle;

fn quiet() -> Integration {
    Integration {
        damping: 0.01,
        ..Integration::default()
    }
}

/// Pulls a 1 mm block of vein to a stretch along x; gives force per area.
fn pull(stretch: f64, planar: bool) -> f64 {
    let mesh = Mesh::block([1.0; 3], [3; 3], Region::Vein);
    let law = Setup::default().vein.law;
    let mut body = Body::new(mesh, |_| law, Branch::Published, quiet());
    body.hold(1, |p| p[1] < 1e-9 || (planar && p[1] > 1.0 - 1e-9));
    body.hold(2, |p| p[2] < 1e-9);
    body.hold(0, |p| p[0] < 1e-9);
    let end: Vec<usize> = body
        .places()
        .filter(|&p| body.rest(p)[0] > 1.0 - 1e-9)
        .collect();
    for &p in &end {
        body.prescribe(p, 0, 0.0);
    }
    let steps = 4000;
    body.set_prescribed(0, |_| (stretch - 1.0) / f64::from(steps));
    settle(&mut body, steps as usize, |_| {});
    body.set_prescribed(0, |_| 0.0);
    settle(&mut body, 3000, |_| {});
    body.internal();
    // The residual at a held place is minus the reaction.
    -end.iter().map(|&p| body.f[0][p]).sum::<f64>()
}

#[test]
fn a_block_in_uniaxial_tension_and_compression_meets_the_oracle() {
    for (stretch, expected) in [(1.3, 0.533438), (0.8, -0.588060)] {
        let got = pull(stretch, false);
        assert!(
            (got / expected - 1.0).abs() < 2e-4,
            "{stretch}: {got} {expected}"
        );
    }
}

#[test]
fn a_block_in_planar_tension_meets_the_closed_form() {
    // 2(λ − λ⁻³)(C10 + 2 C20 (Ī1 − 3)), incompressible; D1 and D2 take off about 0.2 %.
    let l = 1.3_f64;
    let e = l * l + l.powi(-2) - 2.0;
    let expected = 2.0 * (l - l.powi(-3)) * (0.4 - 0.1 * e);
    let got = pull(l, true);
    assert!((got / expected - 1.0).abs() < 4e-3, "{got} {expected}");
}

/// Inner radius of the benchmark tube under a pressure.
fn tube(pressure: f64, radial: usize) -> f64 {
    let mesh = Mesh::tube(1.0, 1.4, radial, 3 * radial, 0.4 / radial as f64);
    let law = Setup::default().vein.law;
    let slow = Integration {
        damping: 0.003,
        ..Integration::default()
    };
    let mut body = Body::new(mesh, |_| law, Branch::Published, slow);
    body.hold(0, |_| true);
    body.hold(1, |p| p[1] < 1e-9);
    body.hold(2, |p| p[2].abs() < 1e-9);
    let mut lumen = Lumen::new(&body);
    let steps = 16_000;
    for step in 0..steps {
        lumen.update(&body);
        lumen.apply(&mut body, pressure * (f64::from(step) / 3000.0).min(1.0));
        body.internal();
        body.advance();
    }
    let inner: Vec<usize> = body
        .places()
        .filter(|&p| {
            let r = body.rest(p);
            (r[1].hypot(r[2]) - 1.0).abs() < 1e-9
        })
        .collect();
    let sum: f64 = inner
        .iter()
        .map(|&p| {
            let r = body.rest(p);
            (r[1] + body.u[1][p]).hypot(r[2] + body.u[2][p])
        })
        .sum();
    sum / inner.len() as f64
}

#[test]
fn a_pressurised_vein_opens_as_the_benchmark_says() {
    // proofs' finite elements with D1 and D2: 0.065797 MPa at 1.1 A.
    let coarse = tube(0.065797, 4);
    let fine = tube(0.065797, 8);
    assert!((fine - 1.1).abs() < 6e-4, "{fine}");
    assert!(
        (fine - 1.1).abs() < 0.5 * (coarse - 1.1).abs() + 1e-5,
        "{coarse} {fine}"
    );
    // 0.7 kPa moves the inner wall by 0.895 µm.
    let small = tube(0.7e-3, 8) - 1.0;
    assert!((small / 0.895e-3 - 1.0).abs() < 0.02, "{small}");
}
