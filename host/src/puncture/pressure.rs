//! Pressure on the lumen's wall: a follower load on the facets of the inner surface.

use super::explicit::Body;

/// The lumen's inner surface.
#[derive(Clone, Debug)]
pub struct Lumen {
    facet: Vec<[usize; 4]>,
    /// Force per unit pressure on the nodes, at the last update.
    place: Vec<usize>,
    index: Vec<[usize; 4]>,
    force: Vec<[f64; 3]>,
    /// Work done on the wall, N·mm (half model).
    pub work: f64,
}

impl Lumen {
    /// The facets of the mesh's lumen.
    pub fn new(body: &Body) -> Self {
        let mut facet = Vec::new();
        for &[a, b] in &body.mesh.lumen {
            for i in 0..body.bricks.along {
                facet.push([
                    body.place(a, i),
                    body.place(b, i),
                    body.place(b, i + 1),
                    body.place(a, i + 1),
                ]);
            }
        }
        let mut place: Vec<usize> = facet.iter().flatten().copied().collect();
        place.sort_unstable();
        place.dedup();
        let index = facet
            .iter()
            .map(|f| f.map(|n| place.binary_search(&n).unwrap_or(0)))
            .collect();
        Self {
            force: vec![[0.0; 3]; place.len()],
            facet,
            place,
            index,
            work: 0.0,
        }
    }

    /// Takes the surface's area vectors from where the nodes are now.
    pub fn update(&mut self, body: &Body) {
        self.force.fill([0.0; 3]);
        for (f, index) in self.facet.iter().zip(&self.index) {
            let p = f.map(|n| {
                let r = body.rest(n);
                [
                    r[0] + body.u[0][n],
                    r[1] + body.u[1][n],
                    r[2] + body.u[2][n],
                ]
            });
            let d: [f64; 3] = std::array::from_fn(|c| p[2][c] - p[0][c]);
            let e: [f64; 3] = std::array::from_fn(|c| p[3][c] - p[1][c]);
            let quarter = [
                -0.125 * (d[1] * e[2] - d[2] * e[1]),
                -0.125 * (d[2] * e[0] - d[0] * e[2]),
                -0.125 * (d[0] * e[1] - d[1] * e[0]),
            ];
            for &k in index {
                for (f, q) in self.force[k].iter_mut().zip(quarter) {
                    *f += q;
                }
            }
        }
    }

    /// Adds the forces at a pressure (MPa) to the body's, and half of the step's work.
    pub fn apply(&mut self, body: &mut Body, pressure: f64) {
        for (&n, f) in self.place.iter().zip(&self.force) {
            for (to, x) in body.f.iter_mut().zip(f) {
                to[n] += pressure * x;
            }
        }
        self.book(body, pressure);
    }

    /// Half of the step's work at the velocity of now: once before and once after the step.
    pub fn book(&mut self, body: &Body, pressure: f64) {
        for (&n, f) in self.place.iter().zip(&self.force) {
            for (v, x) in body.v.iter().zip(f) {
                self.work += 0.5 * pressure * x * v[n];
            }
        }
    }
}
