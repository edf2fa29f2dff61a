//! The measured surface around the entry, between the stripes as well as on them.
//!
//! Stripes 2 mm apart sample a region unevenly: a plane through the bare points is tilted by
//! 0.05° for no other reason. So the surface is written as a height over the region's own plane:
//! stripes run along s, travel goes along t. On a grid of columns s each stripe gives a node
//! (t, height) by a local quadratic along the stripe; through a column's nodes runs a natural cubic
//! spline. From it come the height anywhere, the area of each piece, and where a ray meets it.
//! (Measured on 60 synthetic hands: 0.006° and 0.003 mm root mean square remain; with straight
//! lines between the stripes 0.008° and 0.016 mm.)

use super::NeedleError;
use super::plane::Cell;
use crate::cloud::CloudPoint;
use crate::geometry::{Point3, Vector2, Vector3};
use crate::median::median;
use nalgebra::{SMatrix, SVector};

/// A right-handed frame on the region: `along` the stripes, `across` them, `normal` away from the
/// camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// Its origin, near the entry, mm.
    pub origin: Point3,
    /// s axis.
    pub along: Vector3,
    /// t axis.
    pub across: Vector3,
    /// h axis.
    pub normal: Vector3,
}

impl LocalFrame {
    /// (s, t, h) of a point.
    #[inline]
    pub fn local(&self, p: &Point3) -> [f64; 3] {
        let r = p - self.origin;
        [r.dot(&self.along), r.dot(&self.across), r.dot(&self.normal)]
    }

    /// The point at (s, t, h).
    #[inline]
    pub fn point(&self, s: f64, t: f64, h: f64) -> Point3 {
        self.origin + self.along * s + self.across * t + self.normal * h
    }
}

/// Half width of the parabola along a stripe where the height itself counts, mm. A vein's or tendon's
/// ridge (σ 1.1 mm, 0.45 mm high) loses 0.008 mm by it, a usual one 0.002 mm; the noise falls with its
/// root.
pub const FINE_MM: f64 = 1.25;
/// The same where only the height's course along a vein counts, mm: what the ridge loses it loses all along,
/// so that the vein's line keeps its direction with less noise. (Wider, the bend of the hand turns the line:
/// by up to 0.05° at 2.5 mm on noise-free hands, 0.14° at 4 mm.)
pub const BROAD_MM: f64 = 2.0;
/// Nearer to a measured point, an entry beside the surface is at its edge, mm.
const AT_EDGE_MM: f64 = 0.05;
/// A gap of so many usual spacings of the stripes is bridged, however wide they stand.
pub const GAP_SPACINGS: f64 = 2.6;

/// How heights run between two stripes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// A natural cubic spline.
    Cubic,
    /// Straight lines: shows how much hangs on the curve in between.
    Linear,
}

/// A stripe where a column crosses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Scan frame.
    pub frame: u32,
    /// Column.
    pub column: u32,
    /// Position across the stripes, mm.
    pub t: f64,
    /// Height, mm.
    pub h: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// How the point moves with its centre, mm/px.
    pub shift: Vector3,
    /// Length along the stripe over which points share one error, mm.
    pub grain_mm: f64,
    /// The spline's second derivative, 1/mm.
    bend: f64,
}

/// Nodes (index, weight) that a place hangs on: two columns, four stripes.
pub type Links = [(u32, f64); 8];

/// A height over the region's plane.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Its frame.
    pub frame: LocalFrame,
    /// Distance between columns, mm.
    pub step: f64,
    /// All nodes, column by column, ascending in t.
    pub nodes: Vec<Node>,
    columns: Vec<std::ops::Range<usize>>,
    /// Column of s = 0.
    middle: usize,
    /// Widest gap that is bridged, mm.
    gap: f64,
}

/// The surface within the region's ball, as pieces.
#[derive(Clone, Debug)]
pub struct Patch {
    /// The pieces.
    pub cells: Vec<Cell>,
    /// What each piece hangs on.
    pub links: Vec<[(u32, f64); 2]>,
    /// Part of the region's disc that they cover.
    pub coverage: f64,
    /// (s, t) of the disc's pieces that were not measured, mm, and their area, mm².
    pub missing: Vec<([f64; 2], f64)>,
}

/// A first guess of where the ray of `pixel` meets the surface: the median depth of the nearest
/// points.
pub fn near(cloud: &[CloudPoint], pixel: &Vector2, ray: &Vector3) -> Result<Point3, NeedleError> {
    const NEAREST: usize = 9;
    let mut by_distance: Vec<(f64, f64)> = cloud
        .iter()
        .map(|p| ((p.pixel - pixel).norm_squared(), p.position.z))
        .collect();
    if by_distance.len() < NEAREST {
        return Err(NeedleError::TooFewPoints {
            points: by_distance.len(),
            stripes: 0,
            needed_points: NEAREST,
            needed_stripes: 2,
        });
    }
    by_distance.select_nth_unstable_by(NEAREST - 1, |a, b| a.0.total_cmp(&b.0));
    let nearest = &mut by_distance[..NEAREST];
    nearest.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(Point3::from(ray * nearest[NEAREST / 2].1))
}

/// A stripe point in the local frame.
#[derive(Clone, Copy)]
struct Local {
    frame: u32,
    s: f64,
    t: f64,
    h: f64,
    sigma_px: f64,
    shift: Vector3,
    correlation: f64,
}

impl Surface {
    /// From the cloud, for everything within `reach` mm of the frame's origin; `radius` is the
    /// region's, `gap` the widest distance between stripes to bridge (at least [`GAP_SPACINGS`] of the usual),
    /// `smooth` half the width of the parabola along a stripe ([`FINE_MM`], [`BROAD_MM`]).
    pub fn build(
        cloud: &[CloudPoint],
        frame: &LocalFrame,
        radius: f64,
        reach: f64,
        gap: f64,
        smooth: f64,
    ) -> Self {
        let step = (radius / 24.0).clamp(0.1, 0.5);
        let half = (reach / step).ceil() as usize + 3;
        let span = (half as f64 + 2.0) * step;
        let across = reach + gap + 4.0;
        let mut points: Vec<Local> = cloud
            .iter()
            .filter_map(|p| {
                let [s, t, h] = frame.local(&p.position);
                // Another surface (a table, a finger in front) is not this one.
                let mine = s.abs() <= span && t.abs() <= across && h.abs() <= radius;
                mine.then_some(Local {
                    frame: p.frame,
                    s,
                    t,
                    h,
                    sigma_px: f64::from(p.sigma_mm)
                        / p.shift.dot(&p.position.coords.normalize()).abs().max(1e-9),
                    shift: p.shift,
                    correlation: f64::from(p.correlation),
                })
            })
            .collect();
        // The size of a grain is the optics': what all stripes say together is surer than what one says.
        let mut grains: Vec<f64> = points.iter().map(|p| p.correlation).collect();
        let usual = median(&mut grains);
        points.iter_mut().for_each(|p| p.correlation = usual);
        points.sort_by(|a, b| a.frame.cmp(&b.frame).then(a.s.total_cmp(&b.s)));
        let count = 2 * half + 1;
        let mut columns: Vec<Vec<Node>> = vec![Vec::new(); count];
        for stripe in points.chunk_by(|a, b| a.frame == b.frame) {
            stripe_nodes(stripe, step, half, smooth, &mut columns);
        }
        let gap = gap.max(GAP_SPACINGS * usual_spacing(&mut columns));
        let mut surface = Self {
            frame: *frame,
            step,
            nodes: Vec::new(),
            columns: Vec::with_capacity(count),
            middle: half,
            gap,
        };
        for mut column in columns {
            drop_outliers(&mut column);
            bend(&mut column, gap);
            let from = surface.nodes.len();
            surface.nodes.append(&mut column);
            surface.columns.push(from..surface.nodes.len());
        }
        surface
    }

    /// The nodes of column `j` on either side of t, if the gap is bridged.
    #[inline]
    fn bracket(&self, column: usize, t: f64) -> Option<usize> {
        let range = self.columns.get(column)?.clone();
        let nodes = &self.nodes[range.clone()];
        let upper = nodes.partition_point(|n| n.t <= t);
        if upper == 0 || upper == nodes.len() {
            return None;
        }
        (nodes[upper].t - nodes[upper - 1].t <= self.gap).then_some(range.start + upper - 1)
    }

    /// Height and slope along t in one column.
    #[inline]
    fn in_column(&self, column: usize, t: f64, how: Interpolation) -> Option<(f64, f64, usize)> {
        let i = self.bracket(column, t)?;
        let (p, q) = (&self.nodes[i], &self.nodes[i + 1]);
        let d = q.t - p.t;
        let (b, a) = ((t - p.t) / d, (q.t - t) / d);
        let mut h = a * p.h + b * q.h;
        let mut slope = (q.h - p.h) / d;
        if how == Interpolation::Cubic {
            h += ((a * a * a - a) * p.bend + (b * b * b - b) * q.bend) * d * d / 6.0;
            slope += ((1.0 - 3.0 * a * a) * p.bend + (3.0 * b * b - 1.0) * q.bend) * d / 6.0;
        }
        Some((h, slope, i))
    }

    /// Height, slope along s and slope along t at (s, t).
    pub fn height(&self, s: f64, t: f64, how: Interpolation) -> Option<(f64, f64, f64)> {
        let x = s / self.step + self.middle as f64;
        if !(x >= 1.0 && x < (self.columns.len() - 2) as f64) {
            return None;
        }
        let j = x as usize;
        let f = x - j as f64;
        let at = |k: usize| self.in_column(k, t, how);
        let (h1, t1, _) = at(j)?;
        let (h2, t2, _) = at(j + 1)?;
        let (slope_t, step) = (t1 + f * (t2 - t1), self.step);
        // Through four columns where there are four, else straight.
        match (how, at(j - 1), at(j + 2)) {
            (Interpolation::Cubic, Some((h0, ..)), Some((h3, ..))) => {
                let m1 = 0.5 * (h2 - h0);
                let m2 = 0.5 * (h3 - h1);
                let c2 = 3.0 * (h2 - h1) - 2.0 * m1 - m2;
                let c3 = m1 + m2 - 2.0 * (h2 - h1);
                let h = h1 + f * (m1 + f * (c2 + f * c3));
                Some((h, (m1 + f * (2.0 * c2 + 3.0 * f * c3)) / step, slope_t))
            }
            _ => Some((h1 + f * (h2 - h1), (h2 - h1) / step, slope_t)),
        }
    }

    /// Where the ray Z·(x, y, 1) from the camera meets the surface.
    ///
    /// # Errors
    /// A hole there, or no surface on one side.
    pub fn meet(&self, ray: &Vector3, how: Interpolation) -> Result<Point3, NeedleError> {
        let [cs, ct, ch] = self.frame.local(&Point3::origin());
        let d = ray.normalize();
        let (ds, dt, dh) = (
            d.dot(&self.frame.along),
            d.dot(&self.frame.across),
            d.dot(&self.frame.normal),
        );
        let mut along = -ch / dh;
        for _ in 0..50 {
            let (s, t) = (cs + along * ds, ct + along * dt);
            let Some((h, hs, ht)) = self.height(s, t, how) else {
                return Err(self.why_not(s, t));
            };
            let miss = ch + along * dh - h;
            let rate = dh - hs * ds - ht * dt;
            // A surface seen edge-on has no safe step.
            if !(rate.abs() > 0.05) {
                break;
            }
            let move_by = (miss / rate).clamp(-2.0, 2.0);
            along -= move_by;
            if move_by.abs() < 1e-10 {
                return Ok(Point3::from(d * along));
            }
        }
        let (s, t) = (cs + along * ds, ct + along * dt);
        Err(self.why_not(s, t))
    }

    fn why_not(&self, s: f64, t: f64) -> NeedleError {
        let x = s / self.step + self.middle as f64;
        // The narrowest gap that the columns around show: a stripe broken along s is a hole too.
        let around = (x.floor() as isize - 1)..=(x.floor() as isize + 2);
        let gap_mm = around
            .filter_map(|j| self.columns.get(usize::try_from(j).ok()?))
            .filter_map(|range| {
                let nodes = &self.nodes[range.clone()];
                let upper = nodes.partition_point(|n| n.t <= t);
                (upper > 0 && upper < nodes.len()).then(|| nodes[upper].t - nodes[upper - 1].t)
            })
            .fold(f64::NEG_INFINITY, f64::max);
        if gap_mm > self.gap {
            return NeedleError::Hole {
                gap_mm,
                limit_mm: self.gap,
            };
        }
        let distance_mm = self
            .nodes
            .iter()
            .map(|n| (self.s(n.column as usize) - s).hypot(n.t - t))
            .fold(f64::INFINITY, f64::min);
        if gap_mm.is_finite() && distance_mm <= self.gap {
            return NeedleError::Broken;
        }
        if distance_mm < AT_EDGE_MM {
            return NeedleError::Edge;
        }
        NeedleError::OffSurface { distance_mm }
    }

    /// How the surface's meeting with a fixed ray at `p` moves along that ray when the surface moves
    /// by `step` there; 0 where it was not measured.
    pub fn along_ray(&self, p: &Point3, step: &Vector3) -> Vector3 {
        let [s, t, _] = self.frame.local(p);
        let Some((_, hs, ht)) = self.height(s, t, Interpolation::Cubic) else {
            return Vector3::zeros();
        };
        let normal = self.frame.normal - self.frame.along * hs - self.frame.across * ht;
        let sight = p.coords.normalize();
        sight * (normal.dot(step) / normal.dot(&sight))
    }

    /// s of a column.
    #[inline]
    pub fn s(&self, column: usize) -> f64 {
        (column as f64 - self.middle as f64) * self.step
    }

    /// What the surface at a point hangs on; `None` where it was not measured.
    pub fn links(&self, p: &Point3) -> Option<Links> {
        let [s, t, _] = self.frame.local(p);
        let x = s / self.step + self.middle as f64;
        if !(x >= 0.0) {
            return None;
        }
        let f = x - x.floor();
        let mut links = [(0, 0.0); 8];
        for (side, weight) in [(0, 1.0 - f), (1, f)] {
            let i = self.bracket(x as usize + side, t)?;
            let b = (t - self.nodes[i].t) / (self.nodes[i + 1].t - self.nodes[i].t);
            // The spline overshoots a moved node: half way between two stripes of many it takes
            // −0.1, 0.6, 0.6 and −0.1 of them.
            let range = &self.columns[x as usize + side];
            let four = i > range.start && i + 2 < range.end;
            let over = if four { 0.4 * b * (1.0 - b) } else { 0.0 };
            let link = |k: usize, share: f64| (k as u32, weight * share);
            let at = 4 * side;
            links[at] = link(i, 1.0 - b + over);
            links[at + 1] = link(i + 1, b + over);
            if four {
                links[at + 2] = link(i - 1, -over);
                links[at + 3] = link(i + 2, -over);
            }
        }
        Some(links)
    }

    /// The surface within `radius` of `centre`, in pieces of one column by half a step.
    pub fn patch(&self, centre: &Point3, radius: f64, how: Interpolation) -> Patch {
        let [cs, ct, ch] = self.frame.local(centre);
        let dt = 0.5 * self.step;
        let rows = (radius / dt).ceil() as isize;
        let height = (2 * rows + 1) as usize;
        let t_of = |r: usize| ct + (r as isize - rows) as f64 * dt;
        let reach = (radius / self.step).ceil() as isize + 1;
        let first = (cs / self.step).round() as isize + self.middle as isize - reach;
        let wide = (2 * reach + 1) as usize;
        // Heights first, slopes along s need the neighbours.
        let mut heights = vec![(f64::NAN, 0.0, 0usize); wide * height];
        for i in 0..wide {
            let Ok(column) = usize::try_from(first + i as isize) else {
                continue;
            };
            for r in 0..height {
                if let Some(found) = self.in_column(column, t_of(r), how) {
                    heights[i * height + r] = found;
                }
            }
        }
        let mut patch = Patch {
            cells: Vec::new(),
            links: Vec::new(),
            coverage: 0.0,
            missing: Vec::new(),
        };
        let (mut covered, mut missing) = (0.0, 0.0);
        let edge = |distance: f64| ((radius - distance) / dt + 0.5).clamp(0.0, 1.0);
        for i in 0..wide {
            let s = (first + i as isize - self.middle as isize) as f64 * self.step;
            for r in 0..height {
                let t = t_of(r);
                let flat = (s - cs).hypot(t - ct);
                if flat > radius + dt {
                    continue;
                }
                let (h, slope_t, node) = heights[i * height + r];
                if h.is_nan() {
                    missing += edge(flat);
                    if edge(flat) > 0.0 {
                        let area = edge(flat) * self.step * dt;
                        patch.missing.push(([s, t], area));
                    }
                    continue;
                }
                let weight = edge(flat.hypot(h - ch));
                covered += weight;
                if weight == 0.0 {
                    continue;
                }
                let side = |k: isize| {
                    let i = i as isize + k;
                    (0..wide as isize)
                        .contains(&i)
                        .then(|| heights[i as usize * height + r].0)
                        .filter(|h| !h.is_nan())
                };
                let slope_s = match (side(-1), side(1)) {
                    (Some(a), Some(b)) => (b - a) / (2.0 * self.step),
                    (Some(a), None) => (h - a) / self.step,
                    (None, Some(b)) => (b - h) / self.step,
                    (None, None) => 0.0,
                };
                let (p, q) = (&self.nodes[node], &self.nodes[node + 1]);
                let b = (t - p.t) / (q.t - p.t);
                patch.cells.push(Cell {
                    position: self.frame.point(s, t, h),
                    area: weight
                        * self.step
                        * dt
                        * (1.0 + slope_s * slope_s + slope_t * slope_t).sqrt(),
                });
                patch
                    .links
                    .push([(node as u32, 1.0 - b), (node as u32 + 1, b)]);
            }
        }
        let whole = covered + missing;
        patch.coverage = if whole > 0.0 { covered / whole } else { 0.0 };
        patch
    }

    /// The patch with its holes filled by the parabola (in s and t) through all that was measured:
    /// what the region would be if the surface bent on as it does. `None` where nothing is missing,
    /// or no parabola is determined.
    pub fn filled(&self, patch: &Patch) -> Option<Vec<Cell>> {
        if patch.missing.is_empty() {
            return None;
        }
        let row = |s: f64, t: f64| SVector::<f64, 6>::from([1.0, s, t, s * s, s * t, t * t]);
        let mut normal = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        for cell in &patch.cells {
            let [s, t, h] = self.frame.local(&cell.position);
            let row = row(s, t);
            normal += row * row.transpose() * cell.area;
            right += row * (h * cell.area);
        }
        let parabola = normal.cholesky()?.solve(&right);
        let filled = patch.missing.iter().map(|&([s, t], area)| Cell {
            position: self.frame.point(s, t, parabola.dot(&row(s, t))),
            area,
        });
        Some(patch.cells.iter().copied().chain(filled).collect())
    }
}

/// Nodes of one stripe (ascending in s) into the columns that it crosses; none where it breaks off or
/// jumps to another surface, and no parabola across such a place.
fn stripe_nodes(stripe: &[Local], step: f64, half: usize, smooth: f64, columns: &mut [Vec<Node>]) {
    if stripe.len() < 2 {
        return;
    }
    let mut gaps: Vec<f64> = stripe.windows(2).map(|p| p[1].s - p[0].s).collect();
    let spacing = median(&mut gaps);
    let widest = (3.0 * spacing).max(1.0);
    let one = |p: &Local, q: &Local| q.s - p.s <= widest && (q.h - p.h).abs() <= 2.0 * widest;
    for run in stripe.chunk_by(one) {
        run_nodes(run, spacing, step, half, smooth, columns);
    }
}

/// Nodes of an unbroken run of points, `spacing` mm apart.
fn run_nodes(
    run: &[Local],
    spacing: f64,
    step: f64,
    half: usize,
    smooth: f64,
    columns: &mut [Vec<Node>],
) {
    let window = smooth.max(2.0 * spacing);
    // The parabola's value at its middle is a mean over 8/9 of the window's half width.
    let mean_mm = 8.0 / 9.0 * window;
    let (mut from, mut to) = (0, 0);
    for (j, column) in columns.iter_mut().enumerate() {
        let s = (j as f64 - half as f64) * step;
        while from < run.len() && run[from].s < s - window {
            from += 1;
        }
        to = to.max(from);
        while to < run.len() && run[to].s <= s + window {
            to += 1;
        }
        let right = run.partition_point(|p| p.s < s);
        if right == 0 || right == run.len() {
            continue;
        }
        let (p, q) = (&run[right - 1], &run[right]);
        let near = &run[from..to];
        let f = if q.s > p.s {
            (s - p.s) / (q.s - p.s)
        } else {
            0.5
        };
        let straight = (p.t + f * (q.t - p.t), p.h + f * (q.h - p.h));
        let (t, h) = quadratic(near, s, window).unwrap_or(straight);
        let grain = (0.5 * (p.correlation + q.correlation) * spacing).max(1e-3);
        // The mean has less noise, shared over a longer way: variance × way stays.
        let wide = grain.hypot(mean_mm);
        column.push(Node {
            frame: p.frame,
            column: j as u32,
            t,
            h,
            sigma_px: 0.5 * (p.sigma_px + q.sigma_px) * (grain / wide).sqrt(),
            shift: (p.shift + q.shift) * 0.5,
            grain_mm: wide,
            bend: 0.0,
        });
    }
}

/// (t, h) at s by least-squares parabolas through the points around; `None` for fewer than five,
/// all on one side, or points that leave the parabola open.
fn quadratic(near: &[Local], s: f64, window: f64) -> Option<(f64, f64)> {
    if near.len() < 5 {
        return None;
    }
    let mut m = [0.0; 5];
    let (mut t, mut h) = ([0.0; 3], [0.0; 3]);
    let mut sides = [0; 2];
    for p in near {
        let x = (p.s - s) / window;
        sides[usize::from(x > 0.0)] += 1;
        let x2 = x * x;
        for (k, power) in [1.0, x, x2, x2 * x, x2 * x2].into_iter().enumerate() {
            m[k] += power;
        }
        for (k, power) in [1.0, x, x2].into_iter().enumerate() {
            t[k] += power * p.t;
            h[k] += power * p.h;
        }
    }
    if sides[0] < 2 || sides[1] < 2 {
        return None;
    }
    let matrix = nalgebra::Matrix3::new(m[0], m[1], m[2], m[1], m[2], m[3], m[2], m[3], m[4]);
    let inverse = matrix.cholesky()?.inverse();
    let at_zero = |v: &[f64; 3]| (0..3).map(|k| inverse[(0, k)] * v[k]).sum::<f64>();
    let result = (at_zero(&t), at_zero(&h));
    (result.0.is_finite() && result.1.is_finite() && inverse[(0, 0)] < 1.0).then_some(result)
}

/// The usual distance between neighbouring stripes, mm; sorts the columns.
fn usual_spacing(columns: &mut [Vec<Node>]) -> f64 {
    let mut gaps = Vec::new();
    for column in columns.iter_mut() {
        column.sort_by(|a, b| a.t.total_cmp(&b.t));
        // Two stripes on one spot can't both be right; the spline needs ascending places.
        column.dedup_by(|b, a| b.t - a.t < 1e-6);
        gaps.extend(column.windows(2).map(|p| p[1].t - p[0].t));
    }
    median(&mut gaps)
}

/// Takes out nodes that stand off both neighbours' line by more than skin can.
fn drop_outliers(column: &mut Vec<Node>) {
    const SLOPE: f64 = 0.75;
    for _ in 0..3 {
        let worst = column
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                let f = (w[1].t - w[0].t) / (w[2].t - w[0].t);
                let off = (w[1].h - w[0].h - f * (w[2].h - w[0].h)).abs();
                (i + 1, off / (w[2].t - w[0].t))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((i, off)) if off > SLOPE => {
                column.remove(i);
            }
            _ => return,
        }
    }
}

/// Second derivatives of the natural cubic spline through the nodes, apart on both sides of a gap
/// (the usual tridiagonal system).
fn bend(column: &mut [Node], gap: f64) {
    for run in column.chunk_by_mut(|a, b| b.t - a.t <= gap) {
        let n = run.len();
        if n < 3 {
            continue;
        }
        let mut sweep = vec![(0.0, 0.0); n];
        for i in 1..n - 1 {
            let (d0, d1) = (run[i].t - run[i - 1].t, run[i + 1].t - run[i].t);
            let right = 6.0 * ((run[i + 1].h - run[i].h) / d1 - (run[i].h - run[i - 1].h) / d0);
            let (c, d) = sweep[i - 1];
            let pivot = 2.0 * (d0 + d1) - d0 * c;
            sweep[i] = (d1 / pivot, (right - d0 * d) / pivot);
        }
        for i in (1..n - 1).rev() {
            run[i].bend = sweep[i].1 - sweep[i].0 * run[i + 1].bend;
        }
    }
}

#[cfg(test)]
#[path = "surface_tests.rs"]
mod tests;
