//! The brick: patch test, rigid rotation, forces as the gradient of energy, SIMD against scalar.

use super::super::element::{Bricks, Field, Scratch};
use super::super::material::{Branch, Material};
use super::super::mesh::Mesh;
use super::super::tissue::Setup;

fn hand() -> (Mesh, Bricks) {
    let s = Setup::default();
    let mesh = Mesh::hand(&s, 0.5, -1.0, 2.0);
    let bricks = Bricks::new(
        &mesh,
        |_| Material::new(s.vein.law, Branch::Stabilised),
        0.2,
    );
    (mesh, bricks)
}

fn field(mesh: &Mesh, f: impl Fn([f64; 3]) -> [f64; 3]) -> Field {
    let stride = mesh.stride();
    let mut u: Field = std::array::from_fn(|_| vec![0.0; mesh.section.len() * stride]);
    for (s, p) in mesh.section.iter().enumerate() {
        for (i, &x) in mesh.x.iter().enumerate() {
            let v = f([x, p[0], p[1]]);
            for c in 0..3 {
                u[c][s * stride + i] = v[c];
            }
        }
    }
    u
}

fn forces(mesh: &Mesh, bricks: &Bricks, u: &Field, simd: bool) -> Field {
    let mut f = field(mesh, |_| [0.0; 3]);
    let mut scratch = Scratch::new(bricks);
    if simd {
        bricks.subtract_forces(u, &mut f, &mut scratch);
    } else {
        bricks.subtract_forces_scalar(u, &mut f, &mut scratch);
    }
    f
}

fn volume(mesh: &Mesh) -> f64 {
    let length = mesh.x[mesh.x.len() - 1] - mesh.x[0];
    mesh.quads.iter().map(|q| mesh.area(q)).sum::<f64>() * length
}

/// A wavy field that leaves no symmetry.
fn wavy(p: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = p;
    [
        0.10 * (0.9 * x + 0.4 * y).sin() + 0.05 * y,
        0.08 * (0.7 * y - 0.3 * z).cos() + 0.04 * x,
        0.09 * (0.5 * z + 0.6 * x).sin() - 0.03 * y,
    ]
}

#[test]
fn every_section_quadrilateral_is_convex_and_fills_the_block() {
    let s = Setup::default();
    for h in [0.1, 0.25, 0.4] {
        let mesh = Mesh::hand(&s, h, -1.0, 2.0);
        let mut area = 0.0;
        for q in &mesh.quads {
            area += mesh.area(q);
            for k in 0..4 {
                let [a, b, c] = [q[k], q[(k + 1) % 4], q[(k + 2) % 4]].map(|n| mesh.section[n]);
                let turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]);
                assert!(turn > 0.0, "h {h}: {a:?} {b:?} {c:?}");
            }
        }
        let y = mesh.section.iter().map(|p| p[0]).fold(0.0, f64::max);
        let z = mesh.section.iter().map(|p| -p[1]).fold(0.0, f64::max);
        // The block less half a polygon of a lumen.
        let lumen: f64 = mesh
            .lumen
            .iter()
            .map(|e| e.map(|n| mesh.section[n]))
            .map(|[a, b]| 0.5 * (a[0] + b[0]) * (a[1] - b[1]))
            .sum();
        assert!((lumen / (0.5 * std::f64::consts::PI * 1.25 * 1.25) - 1.0).abs() < 0.03);
        assert!(
            (area - (y * z - lumen)).abs() < 1e-9,
            "{area} {}",
            y * z - lumen
        );
    }
}

#[test]
fn a_linear_field_gives_the_exact_energy_and_no_force_inside() {
    let (mesh, bricks) = hand();
    let g = [
        [0.08, 0.03, -0.02],
        [0.01, -0.05, 0.04],
        [-0.03, 0.02, -0.02],
    ];
    let u = field(&mesh, |p| {
        std::array::from_fn(|r| (0..3).map(|c| g[r][c] * p[c]).sum())
    });
    let material = Material::new(Setup::default().vein.law, Branch::Stabilised);
    let energy = bricks.energy(&u);
    let expected = material.state(&g).energy * volume(&mesh);
    assert!((energy.strain / expected - 1.0).abs() < 1e-12);
    assert!(energy.hourglass < 1e-20 * expected.max(1.0));
    let f = forces(&mesh, &bricks, &u, true);
    let stride = mesh.stride();
    // Inside: in a ring of bricks all around. Section nodes off every border have four quads and
    // their angles close; pick them by the border's coordinates.
    let y1 = mesh.section.iter().map(|p| p[0]).fold(0.0, f64::max);
    let z0 = mesh.section.iter().map(|p| p[1]).fold(0.0, f64::min);
    let lumen: std::collections::HashSet<usize> = mesh.lumen.iter().flatten().copied().collect();
    let mut checked = 0;
    for (s, p) in mesh.section.iter().enumerate() {
        let border = p[0] < 1e-9 || p[0] > y1 - 1e-9 || p[1] > -1e-9 || p[1] < z0 + 1e-9;
        if border || lumen.contains(&s) {
            continue;
        }
        for i in 1..mesh.x.len() - 1 {
            for f in &f {
                assert!(f[s * stride + i].abs() < 1e-10, "{p:?}");
            }
            checked += 1;
        }
    }
    assert!(checked > 500);
}

#[test]
fn a_rigid_rotation_gives_neither_energy_nor_force() {
    let (mesh, bricks) = hand();
    let (a, b) = (0.9_f64, -0.6_f64);
    let r = nalgebra_free_rotation(a, b);
    let u = field(&mesh, |p| {
        std::array::from_fn(|k| (0..3).map(|c| r[k][c] * p[c]).sum::<f64>() - p[k] + 0.3)
    });
    let e = bricks.energy(&u);
    assert!(e.strain.abs() < 1e-12 && e.hourglass.abs() < 1e-12, "{e:?}");
    let f = forces(&mesh, &bricks, &u, true);
    let largest = f.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
    assert!(largest < 1e-11, "{largest}");
}

/// A turn about x after one about z.
fn nalgebra_free_rotation(a: f64, b: f64) -> [[f64; 3]; 3] {
    let (sa, ca) = a.sin_cos();
    let (sb, cb) = b.sin_cos();
    [
        [cb, -sb, 0.0],
        [ca * sb, ca * cb, -sa],
        [sa * sb, sa * cb, ca],
    ]
}

#[test]
fn forces_are_the_gradient_of_the_energy() {
    let (mesh, bricks) = hand();
    let u = field(&mesh, wavy);
    let f = forces(&mesh, &bricks, &u, true);
    let stride = mesh.stride();
    let mut checked = 0;
    for s in (0..mesh.section.len()).step_by(7) {
        for i in (0..mesh.x.len()).step_by(3) {
            let c = (s + i) % 3;
            let k = s * stride + i;
            let e = 1e-6;
            let at = |d: f64| {
                let mut v = u.clone();
                v[c][k] += d;
                let e = bricks.energy(&v);
                e.strain + e.hourglass
            };
            let d = -(at(e) - at(-e)) / (2.0 * e);
            assert!(
                (d - f[c][k]).abs() < 1e-5 * (1.0 + d.abs()),
                "{d} {}",
                f[c][k]
            );
            checked += 1;
        }
    }
    assert!(checked > 50);
}

#[test]
fn simd_and_scalar_forces_agree() {
    let (mesh, bricks) = hand();
    let u = field(&mesh, wavy);
    let (a, b) = (
        forces(&mesh, &bricks, &u, true),
        forces(&mesh, &bricks, &u, false),
    );
    let scale = b.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
    for (x, y) in a.iter().flatten().zip(b.iter().flatten()) {
        assert!((x - y).abs() < 1e-12 * scale);
    }
    assert!(scale > 0.1);
}
