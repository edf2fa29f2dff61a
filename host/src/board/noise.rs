//! The noise of a board's image, from what the corner model leaves over; and pixels that are not
//! of the board at all.

use super::edge_model::index;
use super::site::Site;
use crate::simd::widest;

/// Standard deviations of the residual, grey: on dark and bright flats and on the edges between.
/// (Shot noise makes the bright noisier; a point spread that is not quite Gaussian shows on edges.)
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    pub dark: f64,
    pub edge: f64,
    pub bright: f64,
}

/// |K| beyond which a pixel counts as flat.
const FLAT: f32 = 0.95;
/// Residuals beyond this many standard deviations are foreign.
const FOREIGN: f64 = 4.5;
/// Part of the contrast that a residual may have on top, for a model that is not perfect.
const SLACK: f64 = 0.03;
/// A smaller part of the patch beyond the limit is chance.
const CHANCE: f64 = 0.004;
/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "board: pixels foreign beyond",
            format!("{FOREIGN} σ and {:.0} % of the contrast", 100.0 * SLACK),
        ),
        (
            "board: foreign by chance below",
            format!("{:.1} %", 100.0 * CHANCE),
        ),
    ]
}

/// Foreign pixels take this many pixels around them along, px.
const AROUND: i32 = 2;

impl Noise {
    pub fn uniform(sigma: f64) -> Self {
        Self {
            dark: sigma,
            edge: sigma,
            bright: sigma,
        }
    }

    /// From all sites' residuals ([`Site::look`]): spread of the middle (robust), then of what lies within four of
    /// those. Every sixth pixel serves.
    pub fn estimate(sites: &[Site]) -> Self {
        let mut groups: [Vec<f32>; 3] = Default::default();
        for site in sites {
            let sign = site.parameters.free[index::HALF].signum() as f32;
            for i in (0..site.patch.len).step_by(6) {
                if site.patch.weight[i] > 0.0 {
                    groups[group(site.pattern[i] * sign)].push(site.residual[i].abs());
                }
            }
        }
        // Rounding to whole grey levels adds 1/12 everywhere, seen or not.
        let rounding = 1.0f64 / 12.0;
        let [dark, edge, bright] = groups.map(|mut g| {
            if g.is_empty() {
                return rounding.sqrt();
            }
            let middle = g.len() / 2;
            let median = *g.select_nth_unstable_by(middle, f32::total_cmp).1;
            let limit = (4.0 * 1.4826 * median).max(1.0);
            let (n, sum) = g
                .iter()
                .filter(|&&r| r <= limit)
                .fold((0usize, 0f64), |(n, s), &r| (n + 1, s + f64::from(r * r)));
            (sum / n.max(1) as f64).max(rounding).sqrt()
        });
        Self { dark, edge, bright }
    }

    /// Sets the weights of a site's pixels that are not masked.
    pub fn weigh(&self, site: &mut Site) {
        let sign = site.parameters.free[index::HALF].signum() as f32;
        let inverse = [self.dark, self.edge, self.bright].map(|s| (1.0 / s) as f32);
        let patch = &mut site.patch;
        widest(
            #[inline(always)]
            || {
                let weights = patch.weight[..patch.len].iter_mut();
                for (weight, pattern) in weights.zip(&site.pattern) {
                    let kept = pick(inverse, pattern * sign);
                    *weight = if *weight > 0.0 { kept } else { 0.0 };
                }
            },
        );
    }
}

/// 0 dark, 1 edge, 2 bright; `pattern` positive where bright.
fn group(pattern: f32) -> usize {
    if pattern.abs() < FLAT {
        1
    } else if pattern < 0.0 {
        0
    } else {
        2
    }
}

/// The value of `pattern`'s group.
#[inline(always)]
fn pick([dark, edge, bright]: [f32; 3], pattern: f32) -> f32 {
    let flat = if pattern < 0.0 { dark } else { bright };
    if pattern.abs() < FLAT { edge } else { flat }
}

/// Leaves out pixels that fit neither square nor edge, with their surroundings, if there are more
/// of them than chance gives. Returns whether any were. `strict`: no slack on top of the noise.
pub(super) fn mask_foreign(site: &mut Site, noise: &Noise, strict: bool) -> bool {
    let half = site.parameters.free[index::HALF];
    let slack = if strict {
        0.0
    } else {
        SLACK * 2.0 * half.abs()
    };
    let sign = half.signum() as f32;
    let n = site.patch.len;
    let limits =
        [noise.dark, noise.edge, noise.bright].map(|sigma| (FOREIGN * sigma + slack) as f32);
    let pixels = || site.residual[..n].iter().zip(&site.pattern[..n]);
    let mut beyond = 0u32;
    widest(
        #[inline(always)]
        || {
            beyond = pixels()
                .map(|(r, p)| u32::from(r.abs() > pick(limits, p * sign)))
                .sum();
        },
    );
    site.patch.weight[..n].fill(1.0);
    site.masked = 0.0;
    site.darker = 0.0;
    if f64::from(beyond) <= CHANCE * n as f64 {
        return false;
    }
    let foreign: Vec<usize> = pixels()
        .enumerate()
        .filter(|(_, (r, p))| r.abs() > pick(limits, *p * sign))
        .map(|(i, _)| i)
        .collect();
    let darker = foreign.iter().filter(|&&i| site.residual[i] < 0.0).count();
    site.darker = darker as f64 / foreign.len() as f64;
    // A bitmap of the patch's surroundings.
    let extent = |v: &[f32]| {
        v[..n].iter().fold((i32::MAX, i32::MIN), |(a, b), &x| {
            (a.min(x as i32), b.max(x as i32))
        })
    };
    let ((x0, x1), (y0, y1)) = (extent(&site.patch.x), extent(&site.patch.y));
    let width = (x1 - x0 + 1) as usize;
    let height = (y1 - y0 + 1) as usize;
    let mut bitmap = vec![false; width * height];
    for &i in &foreign {
        let (x, y) = (site.patch.x[i] as i32, site.patch.y[i] as i32);
        for v in (y - AROUND).max(y0)..=(y + AROUND).min(y1) {
            for u in (x - AROUND).max(x0)..=(x + AROUND).min(x1) {
                bitmap[(v - y0) as usize * width + (u - x0) as usize] = true;
            }
        }
    }
    let mut masked = 0;
    for i in 0..n {
        let (x, y) = (site.patch.x[i] as i32, site.patch.y[i] as i32);
        if bitmap[(y - y0) as usize * width + (x - x0) as usize] {
            site.patch.weight[i] = 0.0;
            masked += 1;
        }
    }
    site.masked = f64::from(masked) / n as f64;
    true
}
