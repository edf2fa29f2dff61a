//! From radiance along rays to light on pixels: the ray of every pixel, three by three samples to
//! a pixel, the lens's blur and the pixel's own square.

use crate::geometry::{Camera, Vector2, Vector3};
use rayon::prelude::*;

/// Samples a pixel side.
const FINE: usize = 3;
/// Side of a tile, pixels.
const TILE: usize = 16;

/// The ray through every pixel's centre, computed once for a camera.
#[derive(Clone, Debug)]
pub struct RayMap {
    width: usize,
    height: usize,
    rays: Vec<[f64; 2]>,
}

/// A floating-point image: light in grey values at unit exposure.
#[derive(Clone, Debug)]
pub struct Light {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub values: Vec<f32>,
}

/// Which tiles of an image are to be rendered.
#[derive(Clone, Debug)]
pub struct Tiles {
    columns: usize,
    rows: usize,
    wanted: Vec<bool>,
}

/// A blur of standard deviation `sigma_px` together with the square of a pixel, on fine samples.
#[derive(Clone, Debug)]
pub struct Kernel {
    taps: Vec<f32>,
}

impl RayMap {
    /// Undoes the lens's distortion for every pixel; `None` where the lens model has no inverse.
    pub fn new(camera: &Camera) -> Option<Self> {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let rays = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let pixel = Vector2::new((i % width) as f64, (i / width) as f64);
                camera.ray(&pixel).map(|ray| [ray.x, ray.y])
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self {
            width,
            height,
            rays,
        })
    }

    /// The ray through a pixel's centre.
    #[inline]
    pub fn at(&self, u: usize, v: usize) -> Vector3 {
        let [x, y] = self.rays[v * self.width + u];
        Vector3::new(x, y, 1.0)
    }

    /// ∂(x, y)/∂u and ∂(x, y)/∂v at a pixel, from its neighbours.
    #[inline]
    pub fn slope(&self, u: usize, v: usize) -> ([f64; 2], [f64; 2]) {
        let between = |a: usize, b: usize, n: f64| {
            let (a, b) = (self.rays[a], self.rays[b]);
            [(b[0] - a[0]) / n, (b[1] - a[1]) / n]
        };
        let (u0, u1) = (u.saturating_sub(1), (u + 1).min(self.width - 1));
        let (v0, v1) = (v.saturating_sub(1), (v + 1).min(self.height - 1));
        (
            between(v * self.width + u0, v * self.width + u1, (u1 - u0) as f64),
            between(v0 * self.width + u, v1 * self.width + u, (v1 - v0) as f64),
        )
    }

    /// Pixels a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }
}

impl Tiles {
    /// No tile of an image of this size.
    pub fn none(width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        Self {
            columns,
            rows,
            wanted: vec![false; columns * rows],
        }
    }

    /// Adds the tiles that a rectangle of pixels touches (its ends included).
    pub fn add(&mut self, u: (usize, usize), v: (usize, usize)) {
        for row in v.0 / TILE..=(v.1 / TILE).min(self.rows - 1) {
            for column in u.0 / TILE..=(u.1 / TILE).min(self.columns - 1) {
                self.wanted[row * self.columns + column] = true;
            }
        }
    }
}

impl Kernel {
    /// Blur of σ pixels (may be 0).
    pub fn new(sigma_px: f64) -> Self {
        let sigma = sigma_px * FINE as f64;
        let reach = (4.0 * sigma).ceil() as i64;
        let gauss = |d: i64| {
            if sigma > 0.0 {
                (-0.5 * (d as f64 / sigma).powi(2)).exp()
            } else {
                1.0
            }
        };
        let half = reach + (FINE as i64) / 2;
        let mut taps: Vec<f64> = (-half..=half)
            .map(|k| {
                (-1..=1)
                    .filter(|b| (k - b).abs() <= reach)
                    .map(|b| gauss(k - b))
                    .sum()
            })
            .collect();
        let sum: f64 = taps.iter().sum();
        taps.iter_mut().for_each(|t| *t /= sum);
        Self {
            taps: taps.into_iter().map(|t| t as f32).collect(),
        }
    }

    fn half(&self) -> usize {
        self.taps.len() / 2
    }
}

impl Light {
    /// Darkness.
    pub fn dark(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            values: vec![0.0; width * height],
        }
    }

    /// Renders the wanted tiles: `sampler(u, v)` is asked once a tile for a function from a pixel,
    /// its sample's place (offset from the pixel's centre) and ray to radiance. Other tiles stay
    /// as they are.
    pub fn render<S, F>(&mut self, rays: &RayMap, tiles: &Tiles, kernel: &Kernel, sampler: S)
    where
        S: Fn(usize, usize) -> F + Sync,
        F: FnMut(Sample) -> f32,
    {
        let wanted: Vec<usize> = (0..tiles.wanted.len())
            .filter(|&i| tiles.wanted[i])
            .collect();
        let (width, height) = (self.width, self.height);
        let done: Vec<(usize, [f32; TILE * TILE])> = wanted
            .into_par_iter()
            .map(|i| {
                let (u, v) = (i % tiles.columns * TILE, i / tiles.columns * TILE);
                let middle = (
                    (u + TILE / 2).min(width - 1),
                    (v + TILE / 2).min(height - 1),
                );
                (i, tile(rays, kernel, (u, v), sampler(middle.0, middle.1)))
            })
            .collect();
        for (i, values) in done {
            let (u, v) = (i % tiles.columns * TILE, i / tiles.columns * TILE);
            let across = TILE.min(width - u);
            for y in 0..TILE.min(height - v) {
                let at = (v + y) * width + u;
                self.values[at..at + across].copy_from_slice(&values[y * TILE..y * TILE + across]);
            }
        }
    }
}

/// One fine sample.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Nearest pixel on the sensor.
    pub pixel: (usize, usize),
    /// Exact place, pixels.
    pub place: (f64, f64),
    /// Its ray (x, y, 1).
    pub ray: Vector3,
}

fn tile(
    rays: &RayMap,
    kernel: &Kernel,
    (u0, v0): (usize, usize),
    mut radiance: impl FnMut(Sample) -> f32,
) -> [f32; TILE * TILE] {
    let half = kernel.half();
    let side = FINE * TILE + 2 * (half - FINE / 2);
    // Fine sample 0 lies `half` samples before the first pixel's centre.
    let place = |start: usize, k: usize| start as f64 + (k as f64 - half as f64) / FINE as f64;
    let nearest = |place: f64, n: usize| (place.round().max(0.0) as usize).min(n - 1);
    let mut fine = vec![0.0f32; side];
    let mut across = vec![0.0f32; side * TILE];
    for j in 0..side {
        let v = place(v0, j);
        let pv = nearest(v, rays.height);
        for (i, value) in fine.iter_mut().enumerate() {
            let u = place(u0, i);
            let pu = nearest(u, rays.width);
            let (by_u, by_v) = rays.slope(pu, pv);
            let (du, dv) = (u - pu as f64, v - pv as f64);
            let mut ray = rays.at(pu, pv);
            ray.x += by_u[0] * du + by_v[0] * dv;
            ray.y += by_u[1] * du + by_v[1] * dv;
            *value = radiance(Sample {
                pixel: (pu, pv),
                place: (u, v),
                ray,
            });
        }
        for (x, out) in across[j * TILE..(j + 1) * TILE].iter_mut().enumerate() {
            let part = &fine[FINE * x..FINE * x + kernel.taps.len()];
            *out = part.iter().zip(&kernel.taps).map(|(a, b)| a * b).sum();
        }
    }
    let mut out = [0.0f32; TILE * TILE];
    for y in 0..TILE {
        let row = &mut out[y * TILE..(y + 1) * TILE];
        for (k, tap) in kernel.taps.iter().enumerate() {
            let line = &across[(FINE * y + k) * TILE..][..TILE];
            for (o, a) in row.iter_mut().zip(line) {
                *o += tap * a;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;

    #[test]
    fn a_blurred_edge_has_its_middle_and_width_where_they_belong() {
        let camera = Camera {
            width: 64,
            height: 48,
            fx: 100.0,
            fy: 100.0,
            u0: 31.0,
            v0: 24.0,
            distortion: Distortion::default(),
        };
        let rays = RayMap::new(&camera).unwrap();
        let mut tiles = Tiles::none(64, 48);
        tiles.add((0, 63), (0, 47));
        let sigma = 0.6;
        let edge = 30.27; // px
        let mut light = Light::dark(64, 48);
        // A ramp of ±0.5 px has no aliasing worth speaking of at three samples a pixel.
        light.render(&rays, &tiles, &Kernel::new(sigma), |_, _| {
            |s: Sample| (s.ray.x * 100.0 + 31.0 - edge + 0.5).clamp(0.0, 1.0) as f32
        });
        let row = &light.values[20 * 64..21 * 64];
        // The first and second moments of the edge's derivative.
        let slope: Vec<f64> = row.windows(2).map(|w| f64::from(w[1] - w[0])).collect();
        let at = |i: usize| i as f64 + 0.5;
        let (lo, hi) = (10, 50);
        let sum: f64 = slope[lo..hi].iter().sum();
        let mean = (lo..hi).map(|i| at(i) * slope[i]).sum::<f64>() / sum;
        let var = (lo..hi)
            .map(|i| (at(i) - mean).powi(2) * slope[i])
            .sum::<f64>()
            / sum;
        assert!((sum - 1.0).abs() < 1e-5);
        assert!((mean - edge).abs() < 1e-3, "{mean}");
        // Lens + ramp + pixel square (1/12 each; the square by three samples: 2/27) + the
        // difference of neighbours, which is another pixel square.
        let expected = sigma * sigma + 1.0 / 12.0 + 2.0 / 27.0 + 1.0 / 12.0;
        assert!((var - expected).abs() < 0.01, "{var} against {expected}");
    }
}
