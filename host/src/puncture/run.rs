//! One puncture at one angle by the reference solver: force curve, energies, and how well they close.

use super::cohesive;
use super::contact::{Energies, Interface, Rigid, Stiffness};
use super::explicit::{Body, Integration, Stopped};
use super::material::Branch;
use super::mesh::{Mesh, Region};
use super::needle::{Placement, Shape};
use super::pressure::Lumen;
use super::tissue::Setup;
use std::time::Instant;

/// Mesh and steps.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Numerics {
    /// Brick where the needle passes, mm.
    pub h_mm: f64,
    /// Advance of the needle in a step, as a share of h.
    pub advance: f64,
    /// How far the needle goes on along the vein after the puncture, mm (paper: 5). It is lowered
    /// meanwhile: its lower edge keeps passing through the point of entry.
    pub along_vein_mm: f64,
    /// Path between the points of the curve, mm.
    pub sample_mm: f64,
    /// Time integration.
    pub integration: Integration,
    /// Interface.
    pub stiffness: Stiffness,
}

impl Default for Numerics {
    fn default() -> Self {
        Self {
            h_mm: 0.15,
            advance: 0.002,
            along_vein_mm: 0.0,
            sample_mm: 0.025,
            integration: Integration::default(),
            stiffness: Stiffness::default(),
        }
    }
}

/// A point of the curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Since first contact, s.
    pub time_s: f64,
    /// Path of the tip, mm.
    pub path_mm: f64,
    /// Depth of the tip below the undeformed surface, mm.
    pub depth_mm: f64,
    /// Axial force on the needle, N.
    pub force_n: f64,
    /// Axial force by region, N.
    pub by_region: [f64; 5],
    /// Part of it that cuts, by region, N.
    pub cutting: [f64; 5],
    /// Energies at the sample's end.
    pub energy: Energy,
}

/// Energies of the whole model (both halves), N·mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Done by the needle.
    pub needle: f64,
    /// Done by the pressure.
    pub pressure: f64,
    /// Strain energy.
    pub strain: f64,
    /// Hourglass springs.
    pub hourglass: f64,
    /// Contact and friction springs, crack not yet open.
    pub springs: f64,
    /// New surface.
    pub cut: f64,
    /// Friction.
    pub rubbed: f64,
    /// Kinetic.
    pub kinetic: f64,
    /// Damping and mass that followed squeezed bricks.
    pub damped: f64,
}

impl Energy {
    /// Internal energy: all that is stored in the tissue, its bonds and the contact.
    pub fn internal(&self) -> f64 {
        self.strain + self.hourglass + self.springs
    }

    /// What went in and can't be found again.
    pub fn missing(&self) -> f64 {
        self.needle + self.pressure
            - (self.strain
                + self.hourglass
                + self.springs
                + self.cut
                + self.rubbed
                + self.kinetic
                + self.damped)
    }
}

/// When the needle stood in a layer's lowest part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Severed {
    /// Path of the tip at that moment, mm, by region; None while not through.
    pub path_mm: [Option<f64>; 5],
}

/// A finished run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Speed of the needle, mm/s.
    pub speed_mm_s: f64,
    /// The curve.
    pub samples: Vec<Sample>,
    /// When each layer was cut through.
    pub severed: Severed,
    /// Bricks of the mesh.
    pub bricks: usize,
    /// Steps taken.
    pub steps: usize,
    /// Wall time, s.
    pub seconds: f64,
    /// Smallest and largest det F.
    pub j_range: (f64, f64),
    /// Most bricks on the stabilised branch at a time.
    pub stabilised: usize,
    /// Smallest distance from the tip to the far wall as it lay then, mm.
    pub far_wall_mm: f64,
    /// Whether the run ended because the tip had come to the far wall.
    pub transfixed: bool,
}

/// Largest share of the needle's work that may go missing in a run that is reported.
pub const ENERGY_LIMIT: f64 = 0.01;
/// Largest kinetic energy in a run that is reported, as a share of internal energy.
pub const KINETIC_LIMIT: f64 = 0.05;

impl Run {
    /// Why this run must not be reported, if so: its energy does not close, or it is no longer
    /// quasi-static.
    pub fn refusal(&self) -> Option<String> {
        let (lost, kinetic) = (self.energy_error(), self.kinetic_share());
        if !(lost <= ENERGY_LIMIT) {
            return Some(format!(
                "the run is refused: {:.1} % of the needle's work went missing (limit {:.0} %); \
                 use a finer mesh or smaller steps",
                100.0 * lost,
                100.0 * ENERGY_LIMIT
            ));
        }
        if !(kinetic <= KINETIC_LIMIT) {
            return Some(format!(
                "the run is refused: kinetic energy reached {:.1} % of internal energy (limit \
                 {:.0} %); use smaller steps",
                100.0 * kinetic,
                100.0 * KINETIC_LIMIT
            ));
        }
        None
    }

    /// Largest share of energy that went missing, against the work of the needle so far (and at
    /// least a hundredth of all of it).
    pub fn energy_error(&self) -> f64 {
        let all = self.samples.last().map_or(0.0, |s| s.energy.needle.abs());
        self.samples
            .iter()
            .map(|s| s.energy.missing().abs() / s.energy.needle.abs().max(0.01 * all).max(1e-12))
            .fold(0.0, f64::max)
    }

    /// Largest kinetic energy against internal energy, once a hundredth of the work is done.
    pub fn kinetic_share(&self) -> f64 {
        let all = self.samples.last().map_or(0.0, |s| s.energy.needle.abs());
        self.samples
            .iter()
            .filter(|s| s.energy.needle > 0.01 * all)
            .map(|s| s.energy.kinetic / s.energy.internal().max(1e-12))
            .fold(0.0, f64::max)
    }
}

struct Moving {
    shape: Shape,
    at: Placement,
}

impl Moving {
    /// The needle's own coordinates (s, η) of a point.
    fn own(&self, x: f64, z: f64) -> (f64, f64) {
        let (a, up) = (self.at.axis(), self.at.up());
        let r = [x - self.at.tip[0], z - self.at.tip[1]];
        (
            -(r[0] * a[0] + r[1] * a[1]),
            r[0] * up[0] + r[1] * up[1] - self.shape.radius,
        )
    }
}

impl Rigid for Moving {
    fn width(&self, x: f64, z: f64) -> (f64, f64, f64) {
        let (a, up) = (self.at.axis(), self.at.up());
        let (s, e) = self.own(x, z);
        let w = self.shape.width(s, e);
        (
            w.w,
            -w.ds * a[0] + w.de * up[0],
            -w.ds * a[1] + w.de * up[1],
        )
    }
    fn edge(&self, x: f64, z: f64) -> (f64, f64) {
        let (s, e) = self.own(x, z);
        let (d, ds, _) = self.shape.distance(s, e);
        (d, (-ds).max(0.0))
    }
    fn axis(&self) -> [f64; 2] {
        self.at.axis()
    }
    fn velocity(&self, x: f64, z: f64) -> [f64; 3] {
        let v = self.at.velocity_at([x, z]);
        [v[0], 0.0, v[1]]
    }
    fn steepest(&self) -> f64 {
        2.1
    }
}

/// The body, its crack and its vein, ready to be pierced.
struct Model {
    body: Body,
    face: Interface,
    lumen: Lumen,
    /// Places of the far wall's inner surface on y = 0.
    far: Vec<usize>,
    /// Depth at rest of the lowest row of points in skin, fat and vein's roof.
    bottom: [(Region, f64); 3],
}

impl Model {
    fn new(setup: &Setup, numerics: &Numerics, x_to: f64) -> Self {
        let mesh = Mesh::hand(setup, numerics.h_mm, -1.0, x_to);
        let low = mesh
            .section
            .iter()
            .map(|p| p[1])
            .fold(f64::INFINITY, f64::min);
        let side = mesh.section.iter().map(|p| p[0]).fold(0.0, f64::max);
        let (x0, x1) = (mesh.x[0], mesh.x[mesh.x.len() - 1]);
        let tissue = |r: Region| match r {
            Region::Skin => setup.skin,
            Region::Fat => setup.fat,
            Region::Vein | Region::FarWall => setup.vein,
            Region::Muscle => setup.muscle,
        };
        let mut body = Body::new(
            mesh,
            |r| tissue(r).law,
            Branch::Stabilised,
            numerics.integration,
        );
        for c in 0..3 {
            body.hold(c, |p| p[2] < low + 1e-9);
        }
        body.hold(1, |p| p[1] > side - 1e-9);
        body.hold(0, |p| p[0] < x0 + 1e-9 || p[0] > x1 - 1e-9);
        let axis = setup.lumen_axis_mm();
        let face = Interface::new(
            &mut body,
            |p, _| p[2] > -axis && p[0] > -2.0 && p[0] < x_to + 1.0,
            |r| {
                let t = tissue(r);
                Some(cohesive::Law::new(
                    t.toughness_kj_m2,
                    t.strength_mpa,
                    0.5,
                    setup.process_zone_mm,
                    300.0,
                ))
            },
            setup.friction,
            numerics.stiffness,
        );
        let lumen = Lumen::new(&body);
        let floor = -(setup.lumen_roof_mm() + setup.layers.lumen_mm);
        let far = body
            .places()
            .filter(|&p| {
                let r = body.rest(p);
                r[1].abs() < 1e-9 && (r[2] - floor).abs() < 1e-6
            })
            .collect();
        let bottom = [Region::Skin, Region::Fat, Region::Vein].map(|r| (r, face.lowest(r)));
        Self {
            body,
            face,
            lumen,
            far,
            bottom,
        }
    }

    /// Energies of both halves.
    fn energy(&self, needle: &Moving, work: f64) -> Energy {
        let s = self.body.bricks.energy(&self.body.u);
        let Energies {
            contact,
            friction_stored,
            crack_stored,
            crack_gone,
        } = self.face.energies(&self.body, needle);
        Energy {
            needle: 2.0 * work,
            pressure: 2.0 * self.lumen.work,
            strain: 2.0 * s.strain,
            hourglass: 2.0 * s.hourglass,
            springs: 2.0 * (contact + friction_stored + crack_stored),
            cut: 2.0 * crack_gone.iter().sum::<f64>(),
            rubbed: 2.0 * self.face.rubbed,
            kinetic: 2.0 * self.body.kinetic,
            damped: 2.0 * (self.body.damped + self.body.mass_sink),
        }
    }

    /// Distance from the tip to the far wall above which it is, mm.
    fn far_wall_mm(&self, tip: [f64; 2]) -> f64 {
        let mut best = (f64::INFINITY, f64::INFINITY);
        for &p in &self.far {
            let r = self.body.rest(p);
            let (x, z) = (r[0] + self.body.u[0][p], r[2] + self.body.u[2][p]);
            if (x - tip[0]).abs() < best.0 {
                best = ((x - tip[0]).abs(), tip[1] - z);
            }
        }
        best.1
    }
}

/// Steps over which needle and pressure come up to speed.
const RAMP: usize = 300;

/// Where the needle goes: along its axis, and then, if asked, along the vein while it is lowered.
struct Course {
    angle: f64,
    /// Path along the axis, mm.
    moved: f64,
    /// Path along the vein, mm.
    along: f64,
    /// The outline's tip follows the process zone's lowest point by this, mm.
    lag: f64,
    speed: f64,
    /// Steps since it set off.
    since: usize,
    velocity: f64,
    lowering: bool,
}

impl Course {
    /// Takes the speed of this step.
    fn set_off(&mut self) {
        self.velocity = self.speed * ((self.since as f64 + 0.5) / RAMP as f64).min(1.0);
    }

    fn step(&mut self) {
        if self.lowering {
            self.along += self.velocity;
        } else {
            self.moved += self.velocity;
        }
        self.since += 1;
    }

    fn lower(&mut self) {
        self.lowering = true;
        self.since = 0;
    }

    fn placement(&self) -> Placement {
        let axis = [self.angle.cos(), -self.angle.sin()];
        let [x, z] = axis.map(|a| a * (self.moved - self.lag));
        let v = self.velocity;
        if self.lowering {
            let x = x + self.along;
            // tan(angle) = depth/x: the lower edge goes through the point of entry.
            Placement {
                tip: [x, z],
                angle: (-z).atan2(x),
                velocity: [v, 0.0],
                turn: z * v / (x * x + z * z),
            }
        } else {
            Placement {
                tip: [x, z],
                angle: self.angle,
                velocity: axis.map(|a| a * v),
                turn: 0.0,
            }
        }
    }
}

/// Runs one angle (degrees). The run ends with the tip on the lumen's axis, or later, once the
/// vein's roof is cut through (and after the way along the vein, if asked), or where the tip would
/// touch the far wall. An end that follows from the geometry alone is the same for every mesh: the
/// drag grows up to it, and is often the peak. `progress` hears the path's share, 0 to 1.
///
/// # Errors
/// The run can't go on: a brick is crushed or a number is not finite.
pub fn puncture(
    setup: &Setup,
    angle_deg: f64,
    numerics: &Numerics,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Run, Stopped> {
    let start = Instant::now();
    let angle = angle_deg.to_radians();
    let h = numerics.h_mm;
    let axis_mm = setup.lumen_axis_mm();
    let deepest = setup.lumen_roof_mm() + 0.8 * setup.layers.lumen_mm;
    let path = deepest / angle.sin();
    let shape = Shape::new(
        setup.needle.diameter_mm,
        setup.needle.bevel_deg.to_radians(),
    );
    let reach = deepest / angle.tan();
    let x_to = reach.max(setup.needle.diameter_mm / angle.sin()) + 0.8 + numerics.along_vein_mm;
    let mut model = Model::new(setup, numerics, x_to);
    let pressure = setup.pressure_kpa * 1e-3;
    // The process zone touches the surface first; path and depth are of its lowest point.
    let lag = setup.process_zone_mm / angle.sin();

    let speed = numerics.advance * h;
    let every = ((numerics.sample_mm / speed).round() as usize).max(1);
    let mut course = Course {
        angle,
        moved: 0.0,
        along: 0.0,
        lag,
        speed,
        since: 0,
        velocity: 0.0,
        lowering: false,
    };
    let mut samples = Vec::new();
    let mut sum = Sample::default();
    let mut counted = 0.0;
    let mut work = 0.0;
    let mut strain = 0.0;
    let mut severed = Severed::default();
    let mut far_wall = f64::INFINITY;
    let mut transfixed = false;
    let mut steps = 0;
    let mut last = false;
    while !last {
        let load = pressure * (steps as f64 / RAMP as f64).min(1.0);
        course.set_off();
        let needle = Moving {
            shape,
            at: course.placement(),
        };
        let m = &mut model;
        if steps % 10 == 0 {
            m.lumen.update(&m.body);
        }
        m.lumen.apply(&mut m.body, load);
        let touch = m.face.apply(&mut m.body, &needle);
        m.body.internal();
        m.body.advance();
        m.body.settle(strain);
        m.lumen.book(&m.body, load);
        work += touch.work;
        let a = needle.at.axis();
        for (r, f) in touch.force.iter().enumerate() {
            let axial = -2.0 * (f[0] * a[0] + f[1] * a[1]);
            sum.by_region[r] += axial;
            sum.force_n += axial;
            sum.cutting[r] += 2.0 * touch.cut[r];
        }
        counted += 1.0;
        course.step();
        steps += 1;
        let moved = course.moved + course.along;
        if steps % 25 == 1 {
            m.body.check(moved)?;
            strain = m.body.bricks.energy(&m.body.u).strain;
        }
        last = course.moved >= path || (course.lowering && course.along >= numerics.along_vein_mm);
        if steps % every == 0 || last {
            let needle = Moving {
                shape,
                at: course.placement(),
            };
            samples.push(Sample {
                time_s: moved / setup.needle.speed_mm_s,
                path_mm: moved,
                depth_mm: course.moved * angle.sin(),
                force_n: sum.force_n / counted,
                by_region: sum.by_region.map(|f| f / counted),
                cutting: sum.cutting.map(|f| f / counted),
                energy: m.energy(&needle, work),
            });
            sum = Sample::default();
            counted = 0.0;
            for (region, z) in m.bottom {
                let place = &mut severed.path_mm[region.index()];
                if place.is_none() && m.face.reached(region, |at| at[1] < z + 1e-6) {
                    *place = Some(moved);
                }
            }
            far_wall = far_wall.min(m.far_wall_mm(needle.at.tip));
            progress((moved / (path + numerics.along_vein_mm)).min(1.0));
            if far_wall < 0.05 {
                transfixed = true;
                break;
            }
            let through = severed.path_mm[Region::Vein.index()].is_some();
            if through && course.moved * angle.sin() >= axis_mm && !course.lowering {
                if numerics.along_vein_mm <= 0.0 {
                    break;
                }
                course.lower();
            }
        }
    }
    let body = &model.body;
    Ok(Run {
        angle_deg,
        speed_mm_s: setup.needle.speed_mm_s,
        samples,
        severed,
        bricks: body.bricks.count(),
        steps,
        seconds: start.elapsed().as_secs_f64(),
        j_range: body.j_range,
        stabilised: body.stabilised,
        far_wall_mm: far_wall,
        transfixed,
    })
}
