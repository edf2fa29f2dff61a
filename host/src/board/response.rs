//! ChESS corner response (Bennett and Lasenby, "ChESS – quick and robust detection of chess-board
//! features", CVIU 2014): 16 samples on a ring of radius 5 around each pixel,
//!
//! R = Σ₀³ |(Iₙ + Iₙ₊₈) − (Iₙ₊₄ + Iₙ₊₁₂)| − Σ₀⁷ |Iₙ − Iₙ₊₈| − |Σ ring − 16·local mean|.
//!
//! A checker corner of contrast C gives up to 8·C; edges, stripes and flat regions give no more
//! than zero.

use super::levels::Level;

/// Ring radius, level pixels.
pub(super) const RADIUS: usize = 5;

/// Ring offsets (x, y), clockwise on the screen from the right.
const RING: [(isize, isize); 16] = [
    (5, 0),
    (5, 2),
    (4, 4),
    (2, 5),
    (0, 5),
    (-2, 5),
    (-4, 4),
    (-5, 2),
    (-5, 0),
    (-5, -2),
    (-4, -4),
    (-2, -5),
    (0, -5),
    (2, -5),
    (4, -4),
    (5, -2),
];

/// A local maximum of the response.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    /// Level position, refined by a parabola in each direction.
    pub x: f32,
    pub y: f32,
    pub response: i16,
}

/// Rows whose response is held at a time: with their level they stay in the nearest caches.
const BAND: usize = 16;
/// Rows around a pixel that must not exceed it.
const SIDE: usize = 2;

/// Pixels of a row looked at together: most have no maximum among them.
const BLOCK: usize = 32;

/// The response of row `y` at every pixel that has a whole ring; 0 elsewhere.
#[inline(always)]
fn row(level: &Level, y: usize, out: &mut [i16]) {
    let (w, h) = (level.width, level.height);
    if y < RADIUS || y >= h - RADIUS {
        out.fill(0);
        return;
    }
    let n = w - 2 * RADIUS;
    let at = |(dx, dy): (isize, isize)| {
        let start = (y.wrapping_add_signed(dy)) * w + RADIUS.wrapping_add_signed(dx);
        &level.pixels[start..start + n]
    };
    let ring = RING.map(at);
    let near = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(at);
    row_response(&ring, &near, &mut out[RADIUS..RADIUS + n]);
}

/// One row: plain 16-bit lanes, so that the compiler takes the widest registers there are. No sum
/// leaves 16 bits: values are at most 1020, the ring's sum 16 320, a response no less than −24 480.
#[inline(always)]
fn row_response(ring: &[&[i16]; 16], near: &[&[i16]; 4], out: &mut [i16]) {
    let n = out.len();
    let ring = ring.map(|r| &r[..n]);
    let near = near.map(|r| &r[..n]);
    for i in 0..n {
        let at = |k: usize| ring[k][i];
        let mut sum_response = 0i16;
        let mut difference = 0i16;
        let mut sum = 0i16;
        for k in 0..4 {
            let a = at(k).wrapping_add(at(k + 8));
            let b = at(k + 4).wrapping_add(at(k + 12));
            sum = sum.wrapping_add(a).wrapping_add(b);
            sum_response = sum_response.wrapping_add(a.wrapping_sub(b).wrapping_abs());
            difference = difference
                .wrapping_add(at(k).wrapping_sub(at(k + 8)).wrapping_abs())
                .wrapping_add(at(k + 4).wrapping_sub(at(k + 12)).wrapping_abs());
        }
        let centre = near[0][i]
            .wrapping_add(near[1][i])
            .wrapping_add(near[2][i])
            .wrapping_add(near[3][i]);
        let mean = sum.wrapping_sub(centre.wrapping_mul(4)).wrapping_abs();
        out[i] = sum_response.wrapping_sub(difference).wrapping_sub(mean);
    }
}

/// Local maxima (5 × 5) of the response above `threshold`, the strongest `limit` of them.
///
/// None where the level is narrower than a block with its surroundings.
pub(super) fn peaks(level: &Level, threshold: i16, limit: usize) -> Vec<Peak> {
    let (w, h) = (level.width, level.height);
    let mut found = Vec::new();
    if w < BLOCK + 2 * SIDE || h <= 2 * RADIUS {
        return found;
    }
    let mut held = vec![0i16; (BAND + 2 * SIDE) * w];
    for first in (RADIUS..h - RADIUS).step_by(BAND) {
        // The band before has the first rows already.
        let known = if first == RADIUS { 0 } else { 2 * SIDE };
        held.copy_within(BAND * w.., 0);
        crate::simd::widest(
            #[inline(always)]
            || {
                let rows = held.chunks_exact_mut(w).enumerate().skip(known);
                for (k, out) in rows {
                    row(level, first - SIDE + k, out);
                }
            },
        );
        for y in SIDE..SIDE + BAND.min(h - RADIUS - first) {
            let row = &held[y * w..(y + 1) * w];
            for (block, start) in row.chunks(BLOCK).zip((0..w).step_by(BLOCK)) {
                if block.iter().fold(i16::MIN, |m, &r| m.max(r)) <= threshold {
                    continue;
                }
                // The ring's margin holds no response: the last block may begin earlier.
                let from = start.clamp(SIDE, w - SIDE - BLOCK);
                let mut marks = [false; BLOCK];
                crate::simd::widest(
                    #[inline(always)]
                    || marks = maxima(&held, w, from, y, threshold),
                );
                let (eights, _) = marks.as_chunks::<8>();
                for (eight, from) in eights.iter().zip((from..).step_by(8)) {
                    if *eight == [false; 8] {
                        continue;
                    }
                    for (x, mark) in (from..).zip(eight) {
                        if *mark && x >= start && is_first(&held, w, x, y) {
                            let mut peak = refine(&held, w, x, y);
                            peak.y += (first - SIDE) as f32;
                            found.push(peak);
                        }
                    }
                }
            }
        }
    }
    if found.len() > limit {
        found.select_nth_unstable_by(limit, |a, b| b.response.cmp(&a.response));
        found.truncate(limit);
    }
    found
}

/// Which pixels of row `y` from column `from` exceed `threshold` and are exceeded by none of the
/// 5 × 5 around.
#[inline(always)]
fn maxima(held: &[i16], w: usize, from: usize, y: usize, threshold: i16) -> [bool; BLOCK] {
    let mut most = [threshold + 1; BLOCK];
    for v in y - SIDE..=y + SIDE {
        for u in from - SIDE..=from + SIDE {
            for (m, &r) in most.iter_mut().zip(&held[v * w + u..][..BLOCK]) {
                *m = (*m).max(r);
            }
        }
    }
    let mut marks = [false; BLOCK];
    for ((mark, &r), &most) in marks
        .iter_mut()
        .zip(&held[y * w + from..][..BLOCK])
        .zip(&most)
    {
        *mark = r >= most;
    }
    marks
}

/// Of equal neighbours the first counts.
fn is_first(response: &[i16], w: usize, x: usize, y: usize) -> bool {
    let r = response[y * w + x];
    (y - SIDE..=y).all(|v| {
        let until = if v < y { x + SIDE + 1 } else { x };
        response[v * w + x - SIDE..v * w + until]
            .iter()
            .all(|&other| other < r)
    })
}

fn refine(response: &[i16], w: usize, x: usize, y: usize) -> Peak {
    let at = |x: usize, y: usize| f32::from(response[y * w + x]);
    let vertex = |a: f32, b: f32, c: f32| {
        let curvature = a - 2.0 * b + c;
        if curvature < 0.0 {
            (0.5 * (a - c) / curvature).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    };
    let b = at(x, y);
    Peak {
        x: x as f32 + vertex(at(x - 1, y), b, at(x + 1, y)),
        y: y as f32 + vertex(at(x, y - 1), b, at(x, y + 1)),
        response: response[y * w + x],
    }
}
