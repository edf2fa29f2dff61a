//! Table 5's materials against proofs' oracle (root of a scalar equation; FElupe and CalculiX agree)
//! and closed forms.

use super::super::material::{Branch, Law, Material, Matrix};
use super::super::tissue::Setup;

fn law(name: &str) -> Law {
    let s = Setup::default();
    s.tissues()
        .into_iter()
        .find(|t| t.0 == name)
        .map(|t| t.1.law)
        .unwrap_or(s.skin.law)
}

fn diagonal(l: [f64; 3]) -> Matrix<f64> {
    let mut h = [[0.0; 3]; 3];
    for i in 0..3 {
        h[i][i] = l[i] - 1.0;
    }
    h
}

fn stress(m: &Material, l: [f64; 3]) -> [f64; 3] {
    let s = m.state(&diagonal(l)).stress;
    [s[0][0], s[1][1], s[2][2]]
}

#[test]
fn uniaxial_stress_agrees_with_the_oracle() {
    let mut rows = 0;
    for line in include_str!("oracle.csv").lines().skip(1) {
        let f: Vec<&str> = line.split(',').collect();
        let n = |i: usize| f[i].parse::<f64>().expect("a number");
        let m = Material::new(law(f[0]), Branch::Published);
        let l = n(1);
        // Free sides: lateral stretch by bisection.
        let (mut a, mut b) = (0.95 / l.sqrt(), 1.05 / l.sqrt());
        for _ in 0..200 {
            let c = 0.5 * (a + b);
            if stress(&m, [l, c, c])[1] > 0.0 {
                b = c;
            } else {
                a = c;
            }
        }
        assert!((stress(&m, [l, a, a])[0] - n(3)).abs() < 1e-6, "{line}");
        assert!((l * a * a - n(4)).abs() < 1e-6, "{line}");
        // Incompressible: the pressure from the free sides.
        let c = l.powf(-0.5);
        let p = stress(&m, [l, c, c]);
        assert!((p[0] - p[1] * c / l - n(2)).abs() < 1e-6, "{line}");
        rows += 1;
    }
    assert_eq!(rows, 48);
}

/// 2(λ − λ⁻⁵)(W1 + λ² W2) and 2(λ − λ⁻³)(W1 + W2).
#[test]
fn equibiaxial_and_planar_stress_have_their_closed_forms() {
    for name in ["skin", "fat", "vein", "muscle"] {
        let law = law(name);
        let m = Material::new(law, Branch::Published);
        let slopes = |i1: f64| match law {
            Law::Yeoh { c10, c20, .. } => (c10 + 2.0 * c20 * (i1 - 3.0), 0.0),
            Law::MooneyRivlin { c10, c01, .. } => (c10, c01),
        };
        for k in 4..=25 {
            let l = 0.1 * f64::from(k);
            let (w1, w2) = slopes(2.0 * l * l + l.powi(-4));
            let p = stress(&m, [l, l, l.powi(-2)]);
            let equi = 2.0 * (l - l.powi(-5)) * (w1 + l * l * w2);
            let got = p[0] - p[2] * l.powi(-3);
            assert!(
                (got - equi).abs() < 1e-9 * (1.0 + equi.abs()),
                "{name} {l}: {got} {equi}"
            );
            let (w1, w2) = slopes(l * l + l.powi(-2) + 1.0);
            let p = stress(&m, [l, 1.0, 1.0 / l]);
            let planar = 2.0 * (l - l.powi(-3)) * (w1 + w2);
            let got = p[0] - p[2] * l.powi(-2);
            assert!(
                (got - planar).abs() < 1e-9 * (1.0 + planar.abs()),
                "{name} {l}"
            );
        }
    }
}

/// A small generator, so that runs repeat.
fn noise(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6364136223846793005)
        .wrapping_add(1442695040888963407);
    (*seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
}

#[test]
fn stress_is_the_derivative_of_energy_on_both_branches() {
    let mut seed = 1;
    for name in ["skin", "fat", "vein", "muscle"] {
        for branch in [Branch::Published, Branch::Stabilised] {
            let m = Material::new(law(name), branch);
            for scale in [0.2, 1.0] {
                let mut h = [[0.0; 3]; 3];
                for x in h.iter_mut().flatten() {
                    *x = scale * noise(&mut seed);
                }
                // Bring J near one, where tissue lives.
                let j = m.state(&h).j;
                if j < 0.1 {
                    continue;
                }
                let k = 1.02 * j.powf(-1.0 / 3.0);
                for (r, row) in h.iter_mut().enumerate() {
                    for (c, x) in row.iter_mut().enumerate() {
                        let one = if r == c { 1.0 } else { 0.0 };
                        *x = k * (*x + one) - one;
                    }
                }
                let p = m.state(&h).stress;
                for r in 0..3 {
                    for c in 0..3 {
                        let e = 1e-5;
                        let (mut a, mut b) = (h, h);
                        a[r][c] += e;
                        b[r][c] -= e;
                        let d = (m.state(&a).energy - m.state(&b).energy) / (2.0 * e);
                        assert!(
                            (d - p[r][c]).abs() < 2e-6 * (1.0 + d.abs()),
                            "{name} {d} {}",
                            p[r][c]
                        );
                    }
                }
            }
        }
    }
}

/// Least second derivative of the energy along m ⊗ n that keeps the volume, at stretches `l`.
fn ellipticity(m: &Material, l: [f64; 3]) -> f64 {
    let h = diagonal(l);
    let mut seed = 7;
    let mut least = f64::INFINITY;
    for k in 0..600 {
        let mut n = [noise(&mut seed), noise(&mut seed), noise(&mut seed)];
        let mut v = [noise(&mut seed), noise(&mut seed), noise(&mut seed)];
        if k % 3 == 0 {
            // Principal planes, where the worst directions are.
            n[k / 3 % 3] = 0.0;
            v[k / 3 % 3] = 0.0;
        }
        // v ⊥ F⁻ᵀ n keeps J to first order (and, being rank one, exactly).
        let q = [n[0] / l[0], n[1] / l[1], n[2] / l[2]];
        let qq = q.iter().map(|x| x * x).sum::<f64>();
        let d = q.iter().zip(v).map(|(a, b)| a * b).sum::<f64>() / qq;
        for (x, y) in v.iter_mut().zip(q) {
            *x -= d * y;
        }
        let size =
            (n.iter().map(|x| x * x).sum::<f64>() * v.iter().map(|x| x * x).sum::<f64>()).sqrt();
        if size < 1e-3 {
            continue;
        }
        let e = 1e-3 / size;
        let moved = |s: f64| {
            let mut g = h;
            for r in 0..3 {
                for c in 0..3 {
                    g[r][c] += s * v[r] * n[c];
                }
            }
            m.state(&g).energy
        };
        least = least.min((moved(e) + moved(-e) - 2.0 * moved(0.0)) / 1e-6);
    }
    least
}

#[test]
fn the_published_law_loses_ellipticity_where_the_limit_says() {
    for name in ["fat", "muscle"] {
        let Law::MooneyRivlin { c10, c01, .. } = law(name) else {
            unreachable!("Table 5 has Mooney–Rivlin here")
        };
        let m = Material::new(law(name), Branch::Published);
        let limit = (c10 / -c01).sqrt();
        let at = |l: f64| ellipticity(&m, [l, 1.0 / l, 1.0]);
        assert!(at(0.97 * limit) > 0.0 && at(1.1 * limit) < 0.0, "{name}");
    }
    for name in ["skin", "vein"] {
        let m = Material::new(law(name), Branch::Published);
        let limit = law(name).ellipticity_limit();
        let at = |l: f64| ellipticity(&m, [l, 1.0 / l, 1.0]);
        let stretch = |e: f64| {
            // λ² + λ⁻² + 1 − 3 = e
            let b = e + 2.0;
            ((b + (b * b - 4.0).sqrt()) / 2.0).sqrt()
        };
        assert!(at(stretch(0.9 * limit)) > 0.0, "{name}");
        assert!(at(stretch(3.5 * limit)) < 0.0, "{name}");
    }
}

#[test]
fn the_stabilised_law_stays_elliptic_and_is_the_published_one_below_the_limit() {
    let mut seed = 3;
    for name in ["skin", "fat", "vein", "muscle"] {
        let m = Material::new(law(name), Branch::Stabilised);
        let p = Material::new(law(name), Branch::Published);
        let mut beyond = 0;
        for _ in 0..60 {
            let a = (2.4 * noise(&mut seed)).exp();
            let b = (2.4 * noise(&mut seed)).exp();
            let l = [a, b, 1.0 / (a * b)];
            let s = m.state(&diagonal(l));
            if s.limit_ratio > 1.0 {
                beyond += 1;
            } else {
                let q = p.state(&diagonal(l));
                assert!((s.energy - q.energy).abs() < 1e-12);
            }
            let e = ellipticity(&m, l);
            assert!(e > -1e-6, "{name} {l:?}: {e}");
        }
        assert!(beyond > 10, "{name}: the test must reach the branch");
    }
}
