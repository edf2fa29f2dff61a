//! Renders what the camera sees: the board or the hand in ambient light, and the laser's line on it.
//!
//! The still part (ambient light) of a pose is rendered once; a frame adds the laser's line, which
//! touches few pixels, and the sensor's noise. Only forward optics: rays meet surfaces, light is
//! added up. Nothing here is shared with the pipeline but the camera model.

use super::hand::Hand;
use super::random::mix;
use super::raster::{Kernel, Light, RayMap, Sample, Tiles};
use super::scene::Scene;
use super::sensor;
use super::target::Target;
use crate::geometry::{Plane, Pose, Vector3};
use crate::image::Image;
use rayon::prelude::*;

/// Board edges are drawn this soft (σ, pixels) before the lens's blur takes over the rest: too
/// soft for three samples a pixel to alias.
const EDGE_PX: f64 = 0.28;
/// Direction towards the lamp.
const LAMP: [f64; 3] = [0.35, -0.55, -0.76];
const TABLE_ALBEDO: f64 = 0.04;

/// What stands before the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Subject {
    /// The checkerboard in a pose.
    Board(Pose),
    /// The hand on its table.
    Hand,
}

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Surface {
    Nothing,
    Board,
    Skin,
    Table,
}

/// A subject in ambient light, ready for the laser.
#[derive(Clone, Debug)]
pub struct Still {
    target: Option<Target>,
    /// Ambient light at unit exposure.
    ambient: Light,
    surface: Vec<Surface>,
    /// n·P of the light planes' normal at every pixel, mm; NaN where the laser reaches nothing.
    reach: Vec<f32>,
    /// Distance along the optical axis, mm.
    depth: Vec<f32>,
}

/// The camera of a scene.
#[derive(Clone, Debug)]
pub struct Renderer {
    scene: Scene,
    rays: RayMap,
}

impl Renderer {
    /// Ready to render a scene; `None` if its lens model folds over within the image.
    pub fn new(scene: Scene) -> Option<Self> {
        let rays = RayMap::new(&scene.camera)?;
        Some(Self { scene, rays })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The rays of the camera's pixels.
    pub(super) fn rays(&self) -> &RayMap {
        &self.rays
    }

    /// Renders a subject in ambient light.
    pub fn still(&self, subject: &Subject) -> Still {
        match subject {
            Subject::Board(pose) => self.still_board(pose),
            Subject::Hand => self.still_hand(),
        }
    }

    /// A frame. `exposure`: 1 is the exposure of laser images. `laser`: the true light plane, if the
    /// laser is on. `frame` makes noise and speckle its own.
    pub fn frame(
        &self,
        still: &Still,
        exposure: f64,
        laser: Option<&Plane>,
        frame: u64,
    ) -> Image<u8> {
        let p = &self.scene.parameters;
        match laser {
            None => sensor::expose(&still.ambient, exposure as f32, p, self.scene.seed, frame),
            Some(plane) => {
                let mut light = still.ambient.clone();
                self.add_laser(still, plane, frame, &mut light);
                sensor::expose(&light, exposure as f32, p, self.scene.seed, frame)
            }
        }
    }

    fn empty(&self) -> Still {
        let (w, h) = (self.rays.width(), self.rays.height());
        Still {
            target: None,
            ambient: Light::dark(w, h),
            surface: vec![Surface::Nothing; w * h],
            reach: vec![f32::NAN; w * h],
            depth: vec![0.0; w * h],
        }
    }

    /// Ambient light of the dark wall behind the board.
    fn wall(&self, ray: &Vector3) -> f64 {
        let e = f64::from(self.scene.parameters.ambient_dn);
        e * 0.015 * (1.0 + 0.5 * (55.0 * ray.x).sin() * (60.0 * ray.y + 1.0).sin())
    }

    fn still_board(&self, pose: &Pose) -> Still {
        let mut still = self.empty();
        let (w, h) = (self.rays.width(), self.rays.height());
        for (i, value) in still.ambient.values.iter_mut().enumerate() {
            *value = self.wall(&self.rays.at(i % w, i / w)) as f32;
        }
        let Some(target) = Target::new(self.scene.board, *pose) else {
            return still;
        };
        // The box that the plate's outline fills in the image.
        let [x0, x1, y0, y1] = target.outline();
        let mut low = (f64::MAX, f64::MAX);
        let mut high = (f64::MIN, f64::MIN);
        for i in 0..=20 {
            let t = f64::from(i) / 20.0;
            let (x, y) = (x0 + t * (x1 - x0), y0 + t * (y1 - y0));
            for (x, y) in [(x, y0), (x, y1), (x0, y), (x1, y)] {
                if let Some(p) = self.scene.camera.project(&pose.apply(&[x, y, 0.0].into())) {
                    low = (low.0.min(p.x), low.1.min(p.y));
                    high = (high.0.max(p.x), high.1.max(p.y));
                }
            }
        }
        let clip = |low: f64, high: f64, n: usize| {
            let end = |t: f64| (t.max(0.0) as usize).min(n - 1);
            (end(low - 6.0), end(high + 6.0))
        };
        let (us, vs) = (clip(low.0, high.0, w), clip(low.1, high.1, h));
        let mut tiles = Tiles::none(w, h);
        tiles.add(us, vs);
        let shade = self.board_shade(pose);
        still
            .ambient
            .render(&self.rays, &tiles, &self.board_kernel(), |u, v| {
                let soft = self.board_softness(&target, u, v);
                let target = &target;
                move |s: Sample| {
                    let wall = self.wall(&s.ray);
                    let Some(place) = target.meet(&s.ray) else {
                        return wall as f32;
                    };
                    let (albedo, share) = target.reflectance(&place, soft);
                    let light =
                        shade * (1.0 + 0.0008 * (place.x - 35.0) - 0.0006 * (place.y - 25.0));
                    (share * albedo * light + (1.0 - share) * wall) as f32
                }
            });
        let n = self.scene.laser.model.normal;
        for v in vs.0..=vs.1 {
            for u in us.0..=us.1 {
                let ray = self.rays.at(u, v);
                if let Some(place) = target.meet(&ray)
                    && target.covers(&place)
                {
                    let i = v * w + u;
                    still.surface[i] = Surface::Board;
                    still.depth[i] = place.z as f32;
                    still.reach[i] = (n.dot(&ray) * place.z) as f32;
                }
            }
        }
        still.target = Some(target);
        still
    }

    /// Ambient light on a white board in a pose.
    fn board_shade(&self, pose: &Pose) -> f64 {
        let normal = pose.rotation * -Vector3::z();
        f64::from(self.scene.parameters.ambient_dn)
            * (0.55 + 0.45 * normal.dot(&Vector3::from(LAMP)).max(0.0))
    }

    fn board_kernel(&self) -> Kernel {
        Kernel::new(
            (self.scene.psf_px.powi(2) - EDGE_PX.powi(2))
                .max(0.0)
                .sqrt(),
        )
    }

    /// [`EDGE_PX`] in mm along the board's axes, at a pixel.
    fn board_softness(&self, target: &Target, u: usize, v: usize) -> (f64, f64) {
        let ray = self.rays.at(u, v);
        let (by_u, by_v) = self.rays.slope(u, v);
        let move_by = |d: [f64; 2]| target.meet(&(ray + Vector3::new(d[0], d[1], 0.0)));
        match (target.meet(&ray), move_by(by_u), move_by(by_v)) {
            (Some(o), Some(a), Some(b)) => (
                EDGE_PX * (a.x - o.x).hypot(b.x - o.x),
                EDGE_PX * (a.y - o.y).hypot(b.y - o.y),
            ),
            _ => (1e-3, 1e-3),
        }
    }

    fn still_hand(&self) -> Still {
        let mut still = self.empty();
        let scene = &self.scene;
        let hand = &scene.hand;
        let (w, h) = (self.rays.width(), self.rays.height());
        let n = scene.laser.model.normal;
        let e = f64::from(scene.parameters.ambient_dn);
        let lamp = Vector3::from(LAMP);
        // Surfaces at the pixels' centres.
        let found: Vec<(Surface, f64)> = (0..h)
            .into_par_iter()
            .flat_map_iter(|v| {
                let mut guess = hand.origin.z;
                (0..w).map(move |u| {
                    let ray = self.rays.at(u, v);
                    match hand.meet(&ray, guess) {
                        Some((z, ..)) => {
                            guess = z;
                            (Surface::Skin, z)
                        }
                        None => match hand.table.meet(&ray) {
                            Some(p) => (Surface::Table, p.z),
                            None => (Surface::Nothing, 0.0),
                        },
                    }
                })
            })
            .collect();
        let mut tiles = Tiles::none(w, h);
        for (i, &(surface, z)) in found.iter().enumerate() {
            let (u, v) = (i % w, i / w);
            let ray = self.rays.at(u, v);
            still.surface[i] = surface;
            still.depth[i] = z as f32;
            still.reach[i] = if surface == Surface::Nothing {
                f32::NAN
            } else {
                (n.dot(&ray) * z) as f32
            };
            if surface == Surface::Skin {
                tiles.add(
                    (u.saturating_sub(4), (u + 4).min(w - 1)),
                    (v.saturating_sub(4), (v + 4).min(h - 1)),
                );
            }
            still.ambient.values[i] = (e * self.table_albedo(&ray, z)) as f32;
        }
        // The table in the hand's shadow gets no laser light.
        const BLOCK: usize = 4;
        let shaded: Vec<(usize, usize)> = (0..h.div_ceil(BLOCK) * w.div_ceil(BLOCK))
            .into_par_iter()
            .map(|i| (i % w.div_ceil(BLOCK) * BLOCK, i / w.div_ceil(BLOCK) * BLOCK))
            .filter(|&(u, v)| {
                let i = v * w + u;
                still.surface[i] == Surface::Table
                    && hand.shades(
                        &(self.rays.at(u, v) * f64::from(still.depth[i])).into(),
                        &scene.laser.beam,
                    )
            })
            .collect();
        for (u, v) in shaded {
            for v in v..(v + BLOCK).min(h) {
                for i in v * w + u..v * w + (u + BLOCK).min(w) {
                    if still.surface[i] == Surface::Table {
                        still.reach[i] = f32::NAN;
                    }
                }
            }
        }
        let depth = &still.depth;
        still
            .ambient
            .render(&self.rays, &tiles, &Kernel::new(scene.psf_px), |u, v| {
                let mut guess = f64::from(depth[v * w + u]);
                move |s: Sample| {
                    let Some((z, local, slope)) = hand.meet(&s.ray, guess) else {
                        let z = hand.table.meet(&s.ray).map_or(0.0, |p| p.z);
                        return (e * self.table_albedo(&s.ray, z)) as f32;
                    };
                    guess = z;
                    let facing = hand.normal(&slope).dot(&lamp).max(0.0);
                    let albedo = scene.skin.albedo(hand, local.x, local.y);
                    let wet = scene.skin.shine(local.x, local.y) - 1.0;
                    (e * ((0.35 + 0.65 * facing) * albedo + 0.15 * wet)) as f32
                }
            });
        still
    }

    fn table_albedo(&self, ray: &Vector3, z: f64) -> f64 {
        if z <= 0.0 {
            return 0.0;
        }
        let (x, y) = (ray.x * z, ray.y * z);
        0.4 * TABLE_ALBEDO * (1.0 + 0.3 * (0.35 * x).sin() * (0.3 * y).sin())
    }

    /// Adds the laser's line on a still to `light` (unit exposure).
    fn add_laser(&self, still: &Still, plane: &Plane, frame: u64, light: &mut Light) {
        let (w, h) = (light.width, light.height);
        // Beyond 3.6 σ the line is darker than 0.2 % of its middle.
        let cut = 3.6 * self.scene.laser.width_1e2_mm / 4.0;
        let d = plane.d as f32;
        let mut tiles = Tiles::none(w, h);
        let mut rows = (h, 0);
        let mut columns = (w, 0);
        for v in 0..h {
            let row = &still.reach[v * w..(v + 1) * w];
            for (u, reach) in row.iter().enumerate() {
                if (reach + d).abs() < cut as f32 {
                    tiles.add(
                        (u.saturating_sub(3), (u + 3).min(w - 1)),
                        (v.saturating_sub(3), (v + 3).min(h - 1)),
                    );
                    rows = (rows.0.min(v), rows.1.max(v));
                    columns = (columns.0.min(u), columns.1.max(u));
                }
            }
        }
        if rows.0 > rows.1 {
            return;
        }
        let speckle = Speckle::new(self, frame);
        let mut line = Light::dark(w, h);
        match &still.target {
            Some(target) => self.board_line(still, target, plane, &speckle, &tiles, &mut line),
            None => self.hand_line(still, plane, cut + 0.4, &speckle, &tiles, &mut line),
        }
        if still.target.is_none() {
            self.glow(still, &mut line, rows, columns);
        }
        for (sum, part) in light.values.iter_mut().zip(&line.values) {
            *sum += part;
        }
    }

    fn board_line(
        &self,
        still: &Still,
        target: &Target,
        plane: &Plane,
        speckle: &Speckle,
        tiles: &Tiles,
        line: &mut Light,
    ) {
        let laser = &self.scene.laser;
        let (w, h) = (line.width, line.height);
        let normal = target.pose.rotation * Vector3::z();
        let p = &self.scene.parameters;
        let peak = f64::from(p.laser_dn * p.board_laser) * normal.dot(&laser.beam).abs();
        line.render(&self.rays, tiles, &self.board_kernel(), |u, v| {
            let soft = self.board_softness(target, u, v);
            // EDGE_PX as a distance from the light plane.
            let at = |u: usize, v: usize| still.reach[v * w + u];
            let slope = |a: f32, b: f32| {
                if (b - a).is_finite() {
                    f64::from(b - a)
                } else {
                    0.17
                }
            };
            let across = slope(at(u, v), at((u + 1).min(w - 1), v))
                .hypot(slope(at(u, v), at(u, (v + 1).min(h - 1))));
            let soft_mm = EDGE_PX * across;
            move |s: Sample| {
                let Some(place) = target.meet(&s.ray) else {
                    return 0.0;
                };
                let d = plane.normal.dot(&s.ray) * place.z + plane.d;
                if d.abs() > 1.4 {
                    return 0.0;
                }
                let (albedo, share) = target.reflectance(&place, soft);
                (peak * share * albedo * laser.profile(d, s.ray.x * place.z, soft_mm)) as f32
                    * speckle.at(s.place)
            }
        });
    }

    fn hand_line(
        &self,
        still: &Still,
        plane: &Plane,
        cut: f64,
        speckle: &Speckle,
        tiles: &Tiles,
        line: &mut Light,
    ) {
        let scene = &self.scene;
        let (hand, laser): (&Hand, _) = (&scene.hand, &scene.laser);
        let w = line.width;
        let peak = f64::from(scene.parameters.laser_dn);
        let table_cos = hand.table.normal.dot(&laser.beam).abs();
        line.render(&self.rays, tiles, &Kernel::new(scene.psf_px), |_, _| {
            move |s: Sample| {
                let i = s.pixel.1 * w + s.pixel.0;
                let near = f64::from(still.reach[i]) + plane.d;
                if !(near.abs() < cut) {
                    return 0.0;
                }
                let (z, albedo) = match still.surface[i] {
                    Surface::Skin => {
                        let Some((z, local, slope)) = hand.meet(&s.ray, f64::from(still.depth[i]))
                        else {
                            return 0.0;
                        };
                        let facing = -hand.normal(&slope).dot(&laser.beam);
                        let skin = scene.skin.albedo(hand, local.x, local.y);
                        (
                            z,
                            skin * facing.max(0.0) * scene.skin.shine(local.x, local.y),
                        )
                    }
                    Surface::Table => match hand.table.meet(&s.ray) {
                        Some(p) => (p.z, TABLE_ALBEDO * table_cos),
                        None => return 0.0,
                    },
                    Surface::Board | Surface::Nothing => return 0.0,
                };
                let d = plane.normal.dot(&s.ray) * z + plane.d;
                (peak * albedo * laser.profile(d, s.ray.x * z, 0.0)) as f32 * speckle.at(s.place)
            }
        });
    }

    /// Light that went into the skin comes out nearby.
    fn glow(&self, still: &Still, line: &mut Light, rows: (usize, usize), columns: (usize, usize)) {
        let share = self.scene.parameters.glow_share;
        let sigma = self.scene.parameters.glow_mm * self.scene.camera.fx / self.scene.hand.origin.z;
        let reach = (3.0 * sigma).ceil() as usize;
        let weights: Vec<f32> = {
            let g: Vec<f64> = (0..=2 * reach)
                .map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp())
                .collect();
            let sum: f64 = g.iter().sum();
            g.iter().map(|x| (x / sum) as f32).collect()
        };
        let (w, h) = (line.width, line.height);
        let (u0, u1) = (
            columns.0.saturating_sub(reach),
            (columns.1 + reach + 1).min(w),
        );
        let (v0, v1) = (rows.0.saturating_sub(reach), (rows.1 + reach + 1).min(h));
        let n = u1 - u0;
        let skin = |u: usize, v: usize| still.surface[v * w + u] == Surface::Skin;
        // Down the columns first: only the rows that the line touches carry light.
        let mut down = vec![0.0f32; n * (v1 - v0)];
        for v in rows.0.saturating_sub(8)..(rows.1 + 9).min(h) {
            let source: Vec<f32> = (u0..u1)
                .map(|u| {
                    if skin(u, v) {
                        line.values[v * w + u]
                    } else {
                        0.0
                    }
                })
                .collect();
            if source.iter().all(|&s| s == 0.0) {
                continue;
            }
            for y in v.saturating_sub(reach).max(v0)..(v + reach + 1).min(v1) {
                let weight = weights[y + reach - v];
                for (o, s) in down[(y - v0) * n..(y - v0 + 1) * n].iter_mut().zip(&source) {
                    *o += weight * s;
                }
            }
        }
        let mut padded = vec![0.0f32; n + 2 * reach];
        let mut glow = vec![0.0f32; n];
        for y in v0..v1 {
            padded[reach..reach + n].copy_from_slice(&down[(y - v0) * n..(y - v0 + 1) * n]);
            glow.fill(0.0);
            for (k, weight) in weights.iter().enumerate() {
                for (o, s) in glow.iter_mut().zip(&padded[k..k + n]) {
                    *o += weight * s;
                }
            }
            for u in u0..u1 {
                if skin(u, y) {
                    let value = &mut line.values[y * w + u];
                    *value += share * glow[u - u0];
                }
            }
        }
    }
}

/// Laser speckle: grains of exponentially distributed brightness (fully developed speckle) mixed
/// with even light, fixed to the sensor and new in every frame.
struct Speckle {
    seed: u64,
    contrast: f32,
    grain: f64,
    quantiles: [f32; 256],
}

impl Speckle {
    fn new(renderer: &Renderer, frame: u64) -> Self {
        let p = &renderer.scene.parameters;
        let mut quantiles = [0.0f32; 256];
        for (i, q) in quantiles.iter_mut().enumerate() {
            *q = -(1.0 - (i as f32 + 0.5) / 256.0).ln();
        }
        let mean = quantiles.iter().sum::<f32>() / 256.0;
        quantiles.iter_mut().for_each(|q| *q -= mean);
        Self {
            seed: mix(mix(renderer.scene.seed ^ 0x5BEC) ^ frame),
            contrast: p.speckle_contrast,
            grain: p.speckle_grain_px,
            quantiles,
        }
    }

    /// Brightness relative to the mean at a place on the sensor.
    #[inline]
    fn at(&self, (u, v): (f64, f64)) -> f32 {
        let (x, y) = (u / self.grain + 16.0, v / self.grain + 16.0);
        let (i, j) = (x.floor(), y.floor());
        let (a, b) = ((x - i) as f32, (y - j) as f32);
        let cell = |i: f64, j: f64| {
            self.quantiles[(mix(self.seed ^ ((i as u64) << 32 | j as u64)) >> 56) as usize]
        };
        let top = cell(i, j) * (1.0 - a) + cell(i + 1.0, j) * a;
        let bottom = cell(i, j + 1.0) * (1.0 - a) + cell(i + 1.0, j + 1.0) * a;
        1.0 + self.contrast * (top * (1.0 - b) + bottom * b)
    }
}
