//! Contact: Hertz' sphere on a block, and friction's energy.

use super::super::contact::{Interface, Rigid, Stiffness};
use super::super::explicit::{Body, Integration};
use super::super::material::{Branch, Law};
use super::super::mesh::{Mesh, Region};

/// A sphere (its paraboloid) that comes through y = 0.
struct Ball {
    radius: f64,
    depth: f64,
    at: [f64; 2],
    velocity: [f64; 3],
}

impl Rigid for Ball {
    fn width(&self, x: f64, z: f64) -> (f64, f64, f64) {
        let (dx, dz) = (x - self.at[0], z - self.at[1]);
        (
            self.depth - (dx * dx + dz * dz) / (2.0 * self.radius),
            -dx / self.radius,
            -dz / self.radius,
        )
    }
    fn edge(&self, _: f64, _: f64) -> (f64, f64) {
        (f64::INFINITY, 0.0)
    }
    fn axis(&self) -> [f64; 2] {
        [1.0, 0.0]
    }
    fn velocity(&self, _: f64, _: f64) -> [f64; 3] {
        self.velocity
    }
    fn steepest(&self) -> f64 {
        1.0
    }
}

/// Nearly incompressible and nearly linear.
const LAW: Law = Law::Yeoh {
    c10: 0.5,
    c20: 0.0,
    d1: 0.02,
    d2: 1.0,
};

fn pressed(h: f64, depth: f64, radius: f64) -> f64 {
    // A quarter would do; half the face keeps the code the solver's own.
    let fine = |n: usize, far: f64| {
        let mut v: Vec<f64> = (0..=n).map(|i| h * i as f64).collect();
        let mut step = h;
        while v[v.len() - 1] < far {
            step *= 1.35;
            v.push(v[v.len() - 1] + step);
        }
        v
    };
    let line = fine((0.4 / h) as usize, 8.0);
    let mesh = Mesh::sheet(&line, &line, &line, Region::Skin);
    let end = line[line.len() - 1];
    let calm = Integration {
        damping: 0.004,
        ..Integration::default()
    };
    let mut body = Body::new(mesh, |_| LAW, Branch::Published, calm);
    // Planes of symmetry x = 0 and z = 0; the far face is held.
    body.hold(0, |p| p[0] < 1e-9);
    body.hold(2, |p| p[2] < 1e-9);
    for c in 0..3 {
        body.hold(c, |p| p[1] > end - 1e-9);
    }
    let stiffness = Stiffness {
        contact: 0.3,
        friction: 0.5,
    };
    let mut face = Interface::new(&mut body, |_, _| true, |_| None, 0.0, stiffness);
    let mut force = 0.0;
    let steps = 4000;
    for step in 0..steps {
        let ball = Ball {
            radius,
            depth: depth * (f64::from(step) / 2000.0).min(1.0),
            at: [0.0; 2],
            velocity: [0.0; 3],
        };
        let before: f64 = body.f[1].iter().sum();
        face.apply(&mut body, &ball);
        let total: f64 = body.f[1].iter().sum::<f64>() - before;
        body.internal();
        body.advance();
        if step > steps - 200 {
            force += total / 199.0;
        }
    }
    4.0 * force
}

#[test]
fn a_sphere_on_a_block_follows_hertz() {
    // F = 4/3 E* √R d^1.5, E* = E/(1 − ν²); μ = 1, K = 100 MPa.
    let (mu, k) = (LAW.shear_modulus(), LAW.bulk_modulus());
    let young = 9.0 * k * mu / (3.0 * k + mu);
    let nu = (3.0 * k - 2.0 * mu) / (2.0 * (3.0 * k + mu));
    let (radius, depth) = (1.6_f64, 0.04_f64);
    let hertz = 4.0 / 3.0 * young / (1.0 - nu * nu) * radius.sqrt() * depth.powf(1.5);
    let got = pressed(0.05, depth, radius);
    assert!((got / hertz - 1.0).abs() < 0.06, "{got} {hertz}");
}
