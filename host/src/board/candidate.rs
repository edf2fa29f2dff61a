//! What a single place in the image says for itself: four alternating sectors around a centre, and
//! the directions of the two edges between them.

use super::levels::Level;
use super::response::{Peak, RADIUS};
use std::sync::LazyLock;

/// Ring samples.
const SAMPLES: usize = 32;

/// Where on the ring they lie, level pixels from its centre.
static RING: LazyLock<[[f32; 2]; SAMPLES]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let (sin, cos) = angle(k as f32).sin_cos();
        [RADIUS as f32 * cos, RADIUS as f32 * sin]
    })
});

/// A place that looks like a checker corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    /// Level position.
    pub position: [f32; 2],
    pub response: i16,
    /// Unit directions along the two edges. Turning clockwise on the screen (from u towards v) by
    /// less than half a turn, from the first to the second lies a dark sector.
    pub axes: [[f32; 2]; 2],
    /// White minus black on the ring.
    pub contrast: f32,
}

/// Looks at the ring around a peak; `None` if it has not two dark and two bright sectors opposite
/// each other.
pub(super) fn examine(level: &Level, peak: &Peak) -> Option<Candidate> {
    let mut ring = [0f32; SAMPLES];
    for (value, [x, y]) in ring.iter_mut().zip(*RING) {
        *value = level.sample(peak.x + x, peak.y + y);
    }
    let raw = ring;
    for k in 0..SAMPLES {
        ring[k] = 0.25 * (raw[(k + SAMPLES - 1) % SAMPLES] + raw[(k + 1) % SAMPLES]) + 0.5 * raw[k];
    }
    let (mut dark, mut bright) = (0.0, 0.0);
    crate::simd::widest(
        #[inline(always)]
        || (dark, bright) = extremes(&ring),
    );
    let contrast = bright - dark;
    if contrast < 8.0 || f32::from(peak.response) < 0.2 * 8.0 * contrast {
        return None;
    }
    let middle = 0.5 * (dark + bright);

    // Where the ring crosses the middle: into the dark and out of it.
    let (mut into, mut out) = ([0f32; 2], [0f32; 2]);
    let (mut n_into, mut n_out) = (0, 0);
    for k in 0..SAMPLES {
        let (a, b) = (ring[k] - middle, ring[(k + 1) % SAMPLES] - middle);
        if (a > 0.0) == (b > 0.0) {
            continue;
        }
        let phi = angle(k as f32 + a / (a - b));
        if a > 0.0 {
            *into.get_mut(n_into)? = phi;
            n_into += 1;
        } else {
            *out.get_mut(n_out)? = phi;
            n_out += 1;
        }
    }
    if n_into != 2 || n_out != 2 {
        return None;
    }
    let first = line(into)?;
    let mut second = line(out)?;
    if first[0] * second[1] - first[1] * second[0] < 0.0 {
        second = second.map(|x| -x);
    }
    // No sector narrower than 25°.
    if first[0] * second[1] - first[1] * second[0] < 0.42 {
        return None;
    }
    Some(Candidate {
        position: [peak.x, peak.y],
        response: peak.response,
        axes: [first, second],
        contrast,
    })
}

/// Means of the darkest and of the brightest quarter of the ring. By counting each sample's rank:
/// no branches, so that noise costs no more than a corner.
#[inline(always)]
fn extremes(ring: &[f32; SAMPLES]) -> (f32, f32) {
    let mut rank = [0i32; SAMPLES];
    for (k, &value) in ring.iter().enumerate() {
        // Of equal samples the first is the darker.
        for (j, (rank, &other)) in rank.iter_mut().zip(ring).enumerate() {
            *rank += i32::from((value < other) | ((value == other) & (k < j)));
        }
    }
    let quarter = (SAMPLES / 4) as i32;
    let mean = |wanted: &dyn Fn(i32) -> bool| {
        let sum: f32 = ring
            .iter()
            .zip(rank)
            .map(|(&v, r)| if wanted(r) { v } else { 0.0 })
            .sum();
        sum / quarter as f32
    };
    (
        mean(&|r| r < quarter),
        mean(&|r| r >= SAMPLES as i32 - quarter),
    )
}

fn angle(k: f32) -> f32 {
    k * (std::f32::consts::TAU / SAMPLES as f32)
}

/// The line through two crossings on opposite sides of the ring; `None` if they are more than 30°
/// from opposite.
fn line(crossings: [f32; 2]) -> Option<[f32; 2]> {
    let (s0, c0) = crossings[0].sin_cos();
    let (s1, c1) = crossings[1].sin_cos();
    if c0 * c1 + s0 * s1 > -0.866 {
        return None;
    }
    let (x, y) = (c0 - c1, s0 - s1);
    let length = x.hypot(y);
    Some([x / length, y / length])
}
