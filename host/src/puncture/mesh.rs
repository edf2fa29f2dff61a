//! The mesh: quadrilaterals in the cross-section (y, z), swept along the vein (x).
//!
//! Half of the block, y ≥ 0; the plane of needle and vein is y = 0. x runs along the vein in the
//! direction of the needle, z up, the skin's surface at z = 0. Nodes of one section node lie one
//! after the other along x, so that the bricks of one quadrilateral are a row of contiguous memory
//! (element.rs).

use super::tissue::Setup;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Which tissue a brick is of. The lumen has no bricks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Region {
    /// Skin.
    Skin,
    /// Fat, above and around the vein.
    Fat,
    /// Upper half of the vein's wall.
    Vein,
    /// Lower half of the vein's wall.
    FarWall,
    /// Muscle.
    Muscle,
}

impl Region {
    /// All, in order of [`Region::index`].
    pub const ALL: [Region; 5] = [
        Region::Skin,
        Region::Fat,
        Region::Vein,
        Region::FarWall,
        Region::Muscle,
    ];

    /// As a word in a message.
    pub fn name(self) -> &'static str {
        match self {
            Region::Skin => "skin",
            Region::Fat => "fat",
            Region::Vein => "vein",
            Region::FarWall => "vein's far wall",
            Region::Muscle => "muscle",
        }
    }

    /// 0 to 4 from the surface down.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A mesh of swept quadrilaterals.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Section nodes (y, z), mm.
    pub section: Vec<[f64; 2]>,
    /// Quadrilaterals, counter-clockwise in (y, z).
    pub quads: Vec<[usize; 4]>,
    /// Tissue of each quadrilateral.
    pub region: Vec<Region>,
    /// Planes along x, mm, ascending.
    pub x: Vec<f64>,
    /// Section edges on the lumen's inner surface, the tissue to the left (pressure acts there).
    pub lumen: Vec<[usize; 2]>,
    /// Typical brick where the needle passes, mm.
    pub h: f64,
}

/// Distance between the rows of two section nodes in memory is a multiple of this.
pub(super) const ROW_ALIGN: usize = 8;

impl Mesh {
    /// Bricks along x.
    pub fn bricks_along(&self) -> usize {
        self.x.len().saturating_sub(1)
    }

    /// Number of bricks.
    pub fn bricks(&self) -> usize {
        self.quads.len() * self.bricks_along()
    }

    /// Length of a node row in memory: node planes, padded for whole registers.
    pub fn stride(&self) -> usize {
        self.bricks_along().next_multiple_of(ROW_ALIGN) + ROW_ALIGN
    }

    /// Area of a quadrilateral.
    pub fn area(&self, quad: &[usize; 4]) -> f64 {
        let [a, b, c, d] = quad.map(|n| self.section[n]);
        0.5 * ((c[0] - a[0]) * (d[1] - b[1]) + (b[0] - d[0]) * (c[1] - a[1]))
    }

    /// A block of equal bricks from (0, 0, 0), of one tissue (for the verification).
    pub fn block(size: [f64; 3], n: [usize; 3], region: Region) -> Self {
        let line = |l: f64, n: usize| (0..=n).map(|i| l * i as f64 / n as f64).collect::<Vec<_>>();
        Self::sheet(
            &line(size[0], n[0]),
            &line(size[1], n[1]),
            &line(size[2], n[2]),
            region,
        )
    }

    /// A block between given planes.
    pub fn sheet(x: &[f64], y: &[f64], z: &[f64], region: Region) -> Self {
        let mut b = Builder::default();
        b.block(y.len() - 1, z.len() - 1, |i, j| [y[i], z[j]], region);
        b.finish(x.to_vec(), y[1] - y[0])
    }

    /// A quarter of a thick tube (inner radius `a`, outer `b`), for the pressure benchmark.
    pub fn tube(a: f64, b: f64, radial: usize, around: usize, length: f64) -> Self {
        let mut m = Builder::default();
        let at = |i: usize, j: usize| {
            let r = a + (b - a) * i as f64 / radial as f64;
            let t = 0.5 * PI * j as f64 / around as f64;
            // Exact zeros on the planes of symmetry.
            let (s, c) = if j == around { (1.0, 0.0) } else { t.sin_cos() };
            [r * c, r * s]
        };
        m.block(radial, around, at, Region::Vein);
        for j in 0..around {
            m.lumen.push([at(0, j + 1), at(0, j)]);
        }
        m.finish(vec![0.0, length], (b - a) / radial as f64)
    }

    /// The hand: skin, fat with a vein in it, muscle. `h` is the brick's size where the needle
    /// passes; `x_from` and `x_to` bound the fine part along the vein.
    pub fn hand(setup: &Setup, h: f64, x_from: f64, x_to: f64) -> Self {
        let l = &setup.layers;
        let inner = 0.5 * l.lumen_mm;
        let outer = inner + l.wall_mm;
        let gap = (0.35 * l.fat_mm).min(0.4);
        let top = l.skin_mm + l.fat_mm; // depth of the vein's crown
        let axis = -(top + outer);
        let box_half = outer + gap;
        let (box_top, box_bottom) = (axis + box_half, axis - box_half);
        let side = 5.0 + box_half;
        let deep = 3.0;

        let y_top = graded(0.0, box_half, 0.9 * h, 1.15);
        let last = y_top[y_top.len() - 1] - y_top[y_top.len() - 2];
        let y_right = graded(box_half, side, 1.3 * last, 1.4);
        let n_side = ((2.0 * box_half / (2.2 * h)).round() as usize).clamp(4, 24);
        let n_bottom = ((box_half / (2.2 * h)).round() as usize).clamp(2, 12);
        let n_wall = ((l.wall_mm / (0.75 * h)).round() as usize).max(2);
        let n_gap = ((gap / (0.9 * h)).round() as usize).max(1);

        // Heights above the box: fat from the box up, then skin.
        let n_fat = (((l.fat_mm - gap) / h).round() as usize).max(1);
        let n_skin = ((l.skin_mm / h).round() as usize).max(2);
        let mut z_top = evenly(box_top, -l.skin_mm, n_fat);
        z_top.extend_from_slice(&evenly(-l.skin_mm, 0.0, n_skin)[1..]);
        let z_side = evenly(box_bottom, box_top, n_side);
        let y_bottom = evenly(0.0, box_half, n_bottom);
        let mut z_deep = graded(0.0, deep, 2.5 * h, 1.4);
        z_deep = z_deep.iter().rev().map(|d| box_bottom - d).collect();

        let mut b = Builder::default();
        let above = |j: usize| if j < n_fat { Region::Fat } else { Region::Skin };
        b.block_by(
            y_top.len() - 1,
            z_top.len() - 1,
            |i, j| [y_top[i], z_top[j]],
            |_, j| above(j),
        );
        b.block_by(
            y_right.len() - 1,
            z_top.len() - 1,
            |i, j| [y_right[i], z_top[j]],
            |_, j| above(j),
        );
        b.block(
            y_right.len() - 1,
            n_side,
            |i, j| [y_right[i], z_side[j]],
            Region::Fat,
        );
        b.block(
            n_bottom,
            z_deep.len() - 1,
            |i, j| [y_bottom[i], z_deep[j]],
            Region::Muscle,
        );
        b.block(
            y_right.len() - 1,
            z_deep.len() - 1,
            |i, j| [y_right[i], z_deep[j]],
            Region::Muscle,
        );

        // Rings from the lumen to the box: points on the box from its top middle clockwise, each
        // with its angle from the vertical.
        let mut rim: Vec<([f64; 2], f64)> = Vec::new();
        for &y in &y_top {
            rim.push(([y, box_top], 0.25 * PI * y / box_half));
        }
        for (k, &z) in z_side.iter().rev().enumerate().skip(1) {
            rim.push((
                [box_half, z],
                0.25 * PI + 0.5 * PI * k as f64 / n_side as f64,
            ));
        }
        for &y in y_bottom.iter().rev().skip(1) {
            rim.push(([y, box_bottom], PI - 0.25 * PI * y / box_half));
        }
        let around = rim.len() - 1;
        let rings = n_wall + n_gap;
        // Radial index from the box inwards, so that (i, j) runs counter-clockwise.
        let at = |i: usize, j: usize| {
            let ([by, bz], phi) = rim[j];
            let on = |r: f64| {
                let y = if j == 0 || j == around {
                    0.0
                } else {
                    r * phi.sin()
                };
                [y, axis + r * phi.cos()]
            };
            if i >= n_gap {
                on(outer - (outer - inner) * (i - n_gap) as f64 / n_wall as f64)
            } else {
                let t = i as f64 / n_gap as f64;
                let c = on(outer);
                [by + (c[0] - by) * t, bz + (c[1] - bz) * t]
            }
        };
        b.block_by(rings, around, at, |i, j| {
            if i < n_gap {
                Region::Fat
            } else if 2 * j < around && rim[j].1 < 0.5 * PI {
                Region::Vein
            } else {
                Region::FarWall
            }
        });
        for j in 0..around {
            b.lumen.push([at(rings, j), at(rings, j + 1)]);
        }

        let mut x = evenly(
            x_from,
            x_to,
            ((x_to - x_from) / h).round().max(1.0) as usize,
        );
        let dx = x[1] - x[0];
        let tail = graded(0.0, 5.0, 1.3 * dx, 1.4);
        let mut all: Vec<f64> = tail.iter().skip(1).rev().map(|d| x_from - d).collect();
        all.append(&mut x);
        all.extend(tail.iter().skip(1).map(|d| x_to + d));
        b.finish(all, h)
    }
}

/// n equal intervals.
fn evenly(from: f64, to: f64, n: usize) -> Vec<f64> {
    (0..=n)
        .map(|i| {
            if i == n {
                to
            } else {
                from + (to - from) * i as f64 / n as f64
            }
        })
        .collect()
}

/// Intervals from about `first`, growing by about `ratio`.
fn graded(from: f64, to: f64, first: f64, ratio: f64) -> Vec<f64> {
    let length = to - from;
    let mut widths = vec![first];
    let mut total = first;
    while total < length {
        let next = widths[widths.len() - 1] * ratio;
        widths.push(next);
        total += next;
    }
    // Drop the last if that comes closer to the length; then scale.
    let last = widths[widths.len() - 1];
    if widths.len() > 1 && total - length > 0.5 * last {
        widths.pop();
        total -= last;
    }
    let mut at = from;
    let mut points = vec![from];
    for w in &widths {
        at += w * length / total;
        points.push(at);
    }
    if let Some(end) = points.last_mut() {
        *end = to;
    }
    points
}

#[derive(Default)]
struct Builder {
    index: HashMap<(i64, i64), usize>,
    section: Vec<[f64; 2]>,
    quads: Vec<[usize; 4]>,
    region: Vec<Region>,
    lumen: Vec<[[f64; 2]; 2]>,
}

impl Builder {
    fn node(&mut self, p: [f64; 2]) -> usize {
        let key = ((p[0] * 1e7).round() as i64, (p[1] * 1e7).round() as i64);
        *self.index.entry(key).or_insert_with(|| {
            self.section.push(p);
            self.section.len() - 1
        })
    }

    fn block(&mut self, n1: usize, n2: usize, at: impl Fn(usize, usize) -> [f64; 2], r: Region) {
        self.block_by(n1, n2, at, |_, _| r);
    }

    fn block_by(
        &mut self,
        n1: usize,
        n2: usize,
        at: impl Fn(usize, usize) -> [f64; 2],
        region: impl Fn(usize, usize) -> Region,
    ) {
        for j in 0..n2 {
            for i in 0..n1 {
                let mut q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                let twice = (q[2][0] - q[0][0]) * (q[3][1] - q[1][1])
                    + (q[1][0] - q[3][0]) * (q[2][1] - q[0][1]);
                if twice < 0.0 {
                    q.swap(1, 3);
                }
                let quad = q.map(|p| self.node(p));
                self.quads.push(quad);
                self.region.push(region(i, j));
            }
        }
    }

    fn finish(mut self, x: Vec<f64>, h: f64) -> Mesh {
        let lumen = std::mem::take(&mut self.lumen)
            .into_iter()
            .map(|e| e.map(|p| self.node(p)))
            .collect();
        Mesh {
            section: self.section,
            quads: self.quads,
            region: self.region,
            x,
            lumen,
            h,
        }
    }
}
