//! The plane of symmetry as an interface: the crack that holds it closed (cohesive.rs) and the
//! rigid needle that opens it, at the corners of every facet of the mesh on y = 0.
//!
//! Corners (Lobatto's rule), not Gauss points: at the needle's outline a facet is half cut and half
//! bonded. With points inside the facet the bonds hold the same nodes down that the needle lifts;
//! bonds of 11 MPa in tissue of 1 MPa then press needle and tissue together along the whole
//! outline, over a strip as wide as a brick: 1.95 N at 0.2 mm and 1.59 N at 0.14 mm (60°, 4 mm of
//! path) where the corners give 1.12, 1.28 and, at 0.1 mm, 1.32 N. At a corner a node is either
//! bonded or cut.
//!
//! Contact is a potential: at a point with gap g = y − w(x, z, t) < 0 the energy is ½ k A g² and the
//! force its exact gradient, so that nothing is lost whatever the shape. Friction is Coulomb's with
//! an elastic part: a spring drags the point along with the needle until μN, then slips. All the
//! work that goes into it is booked as stored or gone, from the slip itself.

use super::cohesive;
use super::explicit::Body;
use super::mesh::Region;

/// A rigid surface y = w(x, z), moving.
pub trait Rigid {
    /// w and its derivatives against x and z; at most this far (w ≤ −reach) callers do not look.
    fn width(&self, x: f64, z: f64) -> (f64, f64, f64);
    /// Distance in the plane to where the surface stands out of it (0 inside), and by how much it
    /// shrinks per advance along the axis.
    fn edge(&self, x: f64, z: f64) -> (f64, f64);
    /// Direction (x, z) in which it cuts.
    fn axis(&self) -> [f64; 2];
    /// Velocity (x, z) of the surface's material at a point, and of y, mm per step.
    fn velocity(&self, x: f64, z: f64) -> [f64; 3];
    /// Largest slope |∇w|.
    fn steepest(&self) -> f64;
}

/// Numbers of the interface.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Stiffness {
    /// Contact spring, as a share of nodal mass / step².
    pub contact: f64,
    /// Friction spring, as a share of the contact spring.
    pub friction: f64,
}

impl Default for Stiffness {
    fn default() -> Self {
        Self {
            contact: 0.12,
            friction: 0.5,
        }
    }
}

/// What the interface did in a step (half model).
#[derive(Clone, Copy, Debug, Default)]
pub struct Touch {
    /// Force of the tissue on the needle (x, z), by region, N.
    pub force: [[f64; 2]; 5],
    /// Part of it that cuts: the force on the edge, along its advance, by region, N.
    pub cut: [f64; 5],
    /// Points in contact, by region.
    pub points: [u32; 5],
    /// Points that the needle's edge is cutting, by region.
    pub cutting: [u32; 5],
    /// Work that the needle did on the tissue at this step's velocity, N·mm.
    pub work: f64,
}

/// Energies of the interface (half model), N·mm.
#[derive(Clone, Copy, Debug, Default)]
pub struct Energies {
    /// In the contact springs.
    pub contact: f64,
    /// In the friction springs.
    pub friction_stored: f64,
    /// In the crack, would come back.
    pub crack_stored: f64,
    /// Gone into new surface, by region.
    pub crack_gone: [f64; 5],
}

#[derive(Clone, Copy, Debug, Default)]
struct Point {
    /// Largest λ.
    most: f64,
    /// How far the needle's edge has severed the bond, mm.
    edge: f64,
    /// Where it was at the step before, if in the edge's process zone.
    place: [f64; 2],
    in_zone: bool,
    /// Friction force on the tissue, N.
    drag: [f64; 3],
    /// Position at the step before.
    before: [f64; 3],
    touching: bool,
}

#[derive(Clone, Debug)]
struct Facet {
    node: [usize; 4],
    region: usize,
    area: f64,
    /// Contact spring per area, MPa/mm.
    spring: f64,
    reach: f64,
    law: Option<cohesive::Law>,
    rest: [[f64; 2]; 4],
    point: [Point; 4],
    touched: bool,
}

/// All facets on y = 0 that may open.
#[derive(Clone, Debug)]
pub struct Interface {
    facet: Vec<Facet>,
    stiffness: Stiffness,
    friction: f64,
    /// Gone by friction, N·mm (half model).
    pub rubbed: f64,
}

impl Interface {
    /// Facets on y = 0 that `which` (middle at rest, region) picks. Nodes on y = 0 of no facet are
    /// held in y. `law` gives each region's crack, if it has one.
    pub fn new(
        body: &mut Body,
        which: impl Fn([f64; 3], Region) -> bool,
        law: impl Fn(Region) -> Option<cohesive::Law>,
        friction: f64,
        stiffness: Stiffness,
    ) -> Self {
        let on_plane = |body: &Body, q: usize| body.mesh.section[q][0].abs() < 1e-9;
        let mut facet = Vec::new();
        let mut free = vec![false; body.mass.len()];
        for (r, quad) in body.mesh.quads.iter().enumerate() {
            for k in 0..4 {
                let (a, b) = (quad[k], quad[(k + 1) % 4]);
                if !on_plane(body, a) || !on_plane(body, b) {
                    continue;
                }
                let region = body.mesh.region[r];
                for i in 0..body.bricks.along {
                    let (za, zb) = (body.mesh.section[a][1], body.mesh.section[b][1]);
                    let (x0, x1) = (body.mesh.x[i], body.mesh.x[i + 1]);
                    if !which([0.5 * (x0 + x1), 0.0, 0.5 * (za + zb)], region) {
                        continue;
                    }
                    let node = [
                        body.place(a, i),
                        body.place(b, i),
                        body.place(b, i + 1),
                        body.place(a, i + 1),
                    ];
                    for n in node {
                        free[n] = true;
                    }
                    let (length, width) = ((zb - za).abs(), x1 - x0);
                    facet.push(Facet {
                        node,
                        region: region.index(),
                        area: length * width,
                        spring: 0.0,
                        reach: 0.75 * length.hypot(width),
                        law: law(region),
                        rest: [[x0, za], [x0, zb], [x1, zb], [x1, za]],
                        point: [Point::default(); 4],
                        touched: false,
                    });
                }
            }
        }
        // Springs must not be stiffer than the step allows: the crack makes light nodes heavier.
        for f in &facet {
            if let Some(l) = f.law {
                for n in f.node {
                    body.at_least(n, l.stiffness() * f.area / 0.6);
                }
            }
        }
        body.mass_sink = 0.0;
        for f in &mut facet {
            let mass = f
                .node
                .iter()
                .map(|&n| body.mass[n])
                .fold(f64::INFINITY, f64::min);
            f.spring = stiffness.contact * mass / f.area;
        }
        let held: Vec<usize> = body
            .places()
            .filter(|&p| body.rest(p)[1].abs() < 1e-9 && !free[p])
            .collect();
        for p in held {
            body.inverse[1][p] = 0.0;
        }
        Self {
            facet,
            stiffness,
            friction,
            rubbed: 0.0,
        }
    }

    /// Adds the forces of crack and needle to the body's external forces.
    pub fn apply<R: Rigid>(&mut self, body: &mut Body, needle: &R) -> Touch {
        let mut touch = Touch::default();
        let steep = needle.steepest() + 0.1;
        for f in &mut self.facet {
            let mut at = [[0.0; 3]; 4];
            for ((at, &n), rest) in at.iter_mut().zip(&f.node).zip(&f.rest) {
                *at = [rest[0] + body.u[0][n], body.u[1][n], rest[1] + body.u[2][n]];
            }
            let middle = |c: usize| 0.25 * (at[0][c] + at[1][c] + at[2][c] + at[3][c]);
            let zone = f.law.map_or(0.02, |l| l.zone());
            let near = needle.width(middle(0), middle(2)).0 > -steep * (f.reach + zone);
            let quarter = 0.25 * f.area;
            for ((&[x, y, z], &n), point) in at.iter().zip(&f.node).zip(&mut f.point) {
                let mut force = [0.0; 3];
                let (w, wx, wz) = if near {
                    needle.width(x, z)
                } else {
                    (-1.0, 0.0, 0.0)
                };
                if let Some(law) = f.law {
                    // The edge severs by its advance against the tissue.
                    let mut rate = 0.0;
                    let mut moving = [0.0; 3];
                    if near && point.most < 1.0 {
                        let (d, rise) = needle.edge(x, z);
                        if d < law.zone() && d > 0.0 {
                            moving = needle.velocity(x, z);
                            if point.in_zone {
                                let slip = [
                                    moving[0] - (x - point.place[0]),
                                    moving[2] - (z - point.place[1]),
                                ];
                                let a = needle.axis();
                                let advance = slip[0] * a[0] + slip[1] * a[1];
                                let e = point.edge + rise * advance;
                                point.edge = e.clamp(0.0, law.zone());
                            }
                            rate = rise;
                            point.in_zone = true;
                        } else {
                            point.in_zone = false;
                        }
                        point.place = [x, z];
                    } else {
                        point.in_zone = false;
                    }
                    let bond = law.pull(y, point.edge, &mut point.most);
                    force[1] -= bond.traction * quarter;
                    let cut = bond.edge * rate * quarter;
                    if cut > 0.0 {
                        let a = needle.axis();
                        let push = [cut * a[0], 0.0, cut * a[1]];
                        for c in 0..3 {
                            force[c] += push[c];
                            touch.work += push[c] * moving[c];
                        }
                        touch.force[f.region][0] -= push[0];
                        touch.force[f.region][1] -= push[2];
                        touch.cut[f.region] += cut;
                        touch.cutting[f.region] += 1;
                    }
                }
                if near {
                    let g = w - y;
                    if g > 0.0 {
                        let k = f.spring * quarter;
                        let n = k * g;
                        let velocity = needle.velocity(x, z);
                        let slope2 = 1.0 + wx * wx + wz * wz;
                        let mut push = [-n * wx, n, -n * wz];
                        if self.friction > 0.0 {
                            let normal = [-wx, 1.0, -wz];
                            let kt = self.stiffness.friction * k;
                            let drag = rub(
                                point,
                                [x, y, z],
                                velocity,
                                normal,
                                slope2,
                                kt,
                                self.friction * n * slope2.sqrt(),
                                &mut self.rubbed,
                            );
                            for (p, d) in push.iter_mut().zip(drag) {
                                *p += d;
                            }
                        }
                        point.touching = true;
                        point.before = [x, y, z];
                        f.touched = true;
                        for c in 0..3 {
                            force[c] += push[c];
                            touch.work += push[c] * velocity[c];
                        }
                        touch.force[f.region][0] -= push[0];
                        touch.force[f.region][1] -= push[2];
                        touch.points[f.region] += 1;
                    } else if point.touching {
                        let kt = self.stiffness.friction * f.spring * quarter;
                        self.rubbed += lift(point, kt);
                    }
                } else if f.touched && point.touching {
                    let kt = self.stiffness.friction * f.spring * quarter;
                    self.rubbed += lift(point, kt);
                }
                for (f, x) in body.f.iter_mut().zip(&force) {
                    f[n] += x;
                }
            }
            if !near {
                f.touched = false;
            }
        }
        touch
    }

    /// Energies now.
    pub fn energies<R: Rigid>(&self, body: &Body, needle: &R) -> Energies {
        let mut e = Energies::default();
        for f in &self.facet {
            let quarter = 0.25 * f.area;
            for ((&n, rest), point) in f.node.iter().zip(&f.rest).zip(&f.point) {
                let at = [rest[0] + body.u[0][n], body.u[1][n], rest[1] + body.u[2][n]];
                let w = needle.width(at[0], at[2]).0;
                if let Some(law) = f.law {
                    let mut most = point.most;
                    let pull = law.pull(at[1], point.edge, &mut most);
                    e.crack_stored += pull.stored * quarter;
                    e.crack_gone[f.region] += pull.gone * quarter;
                }
                let k = f.spring * quarter;
                let g = w - at[1];
                if g > 0.0 {
                    e.contact += 0.5 * k * g * g;
                }
                if point.touching && self.friction > 0.0 {
                    let kt = self.stiffness.friction * k;
                    e.friction_stored += 0.5 * dot(point.drag, point.drag) / kt;
                }
            }
        }
        e
    }

    /// Whether the needle stands in a region at a point, or has severed it, among the points that
    /// `which` picks by their position at rest (x, z).
    pub fn reached(&self, region: Region, which: impl Fn([f64; 2]) -> bool) -> bool {
        self.points(region)
            .any(|(at, _, point)| (point.touching || point.most >= 1.0) && which(at))
    }

    /// Area in a region where the bond is gone, and the area of all, mm².
    pub fn cut_area(&self, region: Region) -> (f64, f64) {
        self.points(region)
            .fold((0.0, 0.0), |(cut, all), (_, area, point)| {
                (if point.most >= 1.0 { cut + area } else { cut }, all + area)
            })
    }

    /// Height at rest of a region's lowest points.
    pub fn lowest(&self, region: Region) -> f64 {
        self.points(region)
            .map(|(at, _, _)| at[1])
            .fold(f64::INFINITY, f64::min)
    }

    fn points(&self, region: Region) -> impl Iterator<Item = ([f64; 2], f64, &Point)> {
        self.facet
            .iter()
            .filter(move |f| f.region == region.index() && f.law.is_some())
            .flat_map(move |f| {
                f.rest
                    .iter()
                    .zip(&f.point)
                    .map(|(rest, point)| (*rest, 0.25 * f.area, point))
            })
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A point lifts off: what its friction spring held is gone.
fn lift(point: &mut Point, kt: f64) -> f64 {
    let gone = 0.5 * dot(point.drag, point.drag) / kt;
    point.drag = [0.0; 3];
    point.touching = false;
    gone
}

/// Coulomb friction with an elastic part: returns the force on the tissue, books what is gone.
#[allow(clippy::too_many_arguments)]
fn rub(
    point: &mut Point,
    at: [f64; 3],
    velocity: [f64; 3],
    normal: [f64; 3],
    normal2: f64,
    kt: f64,
    limit: f64,
    gone: &mut f64,
) -> [f64; 3] {
    if !point.touching {
        point.drag = [0.0; 3];
        return point.drag;
    }
    let tangent = |v: [f64; 3]| {
        let k = dot(v, normal) / normal2;
        [
            v[0] - k * normal[0],
            v[1] - k * normal[1],
            v[2] - k * normal[2],
        ]
    };
    let slip: [f64; 3] = std::array::from_fn(|c| at[c] - point.before[c] - velocity[c]);
    let slip = tangent(slip);
    let old = tangent(point.drag);
    // Turning the spring into the new tangent plane loses what stood out of it.
    *gone += 0.5 * (dot(point.drag, point.drag) - dot(old, old)) / kt;
    let trial: [f64; 3] = std::array::from_fn(|c| old[c] - kt * slip[c]);
    let size = dot(trial, trial).sqrt();
    if size > limit {
        let k = if size > 0.0 { limit / size } else { 0.0 };
        let new = trial.map(|t| k * t);
        // Sliding part of the slip, (trial − new)/kt, against the mean force of the step.
        let slid: [f64; 3] = std::array::from_fn(|c| (trial[c] - new[c]) / kt);
        let mean: [f64; 3] = std::array::from_fn(|c| 0.5 * (old[c] + new[c]));
        *gone += dot(mean, slid);
        point.drag = new;
    } else {
        point.drag = trial;
    }
    point.drag
}
