//! Where in each column might the stripe be? One pass over the image.
//!
//! A row's response is its five-row sum S less the larger of the sums seven rows above and below,
//! r(v) = min(S(v) − S(v−7), S(v) − S(v+7)): a narrow ridge answers, an edge or a slope of the
//! background does not. Each column keeps the largest response of every band of sixteen rows, so
//! that a bright spot elsewhere in the column cannot hide the stripe.

use crate::image::{Image, Pixel};
use crate::simd::widest;

/// Rows of a band.
const BAND: usize = 16;
/// Columns worked on at a time: their ring buffers (14 KiB) stay in the first-level cache, and a
/// row of a strip is long enough for the memory to be read ahead.
const STRIP: usize = 256;
/// Columns that are passed over at once where nothing stands out.
const BLOCK: usize = 32;
/// Half of the rows of a sum.
const HALF: usize = 2;
/// Distance of the surround from the sum, rows.
const SURROUND: usize = 7;
/// Rows at the top and bottom without a response.
pub(super) const MARGIN: usize = HALF + SURROUND;

/// A response that counts is at least so many times the noise's (a fraction) ...
const OVER_NOISE: (u16, u16) = (5, 2);
/// ... and at least this.
const LEAST_RESPONSE: u16 = 6;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "stripe, search: rows summed, rows to their surround",
            format!("{}, {SURROUND}", 2 * HALF + 1),
        ),
        (
            "stripe, search: one candidate in a band of",
            format!("{BAND} rows"),
        ),
        (
            "stripe, search: least response over the noise, and at all",
            format!("{}/{} ×, {LEAST_RESPONSE}", OVER_NOISE.0, OVER_NOISE.1),
        ),
    ]
}

/// A part of an image, end exclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Region {
    pub u0: usize,
    pub u1: usize,
    pub v0: usize,
    pub v1: usize,
}

impl Region {
    /// The whole image.
    pub fn whole<P: Pixel>(image: &Image<P>) -> Self {
        Self {
            u0: 0,
            u1: image.width(),
            v0: 0,
            v1: image.height(),
        }
    }
}

/// A possible stripe in a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub u: u16,
    pub v: u16,
    /// Response, in sums of five pixels.
    pub response: u16,
}

/// What the search found.
pub(super) struct Candidates {
    /// By column, then by row.
    pub list: Vec<Candidate>,
    /// Index into `list` of each column's first candidate, and one more at the end.
    pub first: Vec<u32>,
}

impl Candidates {
    /// The candidates of the region's column `i`.
    pub fn column(&self, i: usize) -> &[Candidate] {
        &self.list[self.first[i] as usize..self.first[i + 1] as usize]
    }
}

/// All candidates well above the noise in `on` − `off` (or in `on` alone).
/// The images are of one size and the region lies inside.
pub(super) fn candidates<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    region: &Region,
) -> Candidates {
    // Five pixels must fit into 16 bits with room to spare.
    let mut shift = 0;
    if P::BITS > 8 {
        let largest = on.pixels().iter().map(|p| p.to_u16()).max().unwrap_or(0);
        while largest >> shift > 4095 {
            shift += 1;
        }
    }
    let width = region.u1 - region.u0;
    let height = region.v1 - region.v0;
    let bands = height.div_ceil(BAND);
    let mut best = vec![0_u16; bands * width];
    let mut row = vec![0_u16; bands * width];
    if height > 2 * MARGIN {
        widest(
            #[inline(always)]
            || {
                for start in (0..width).step_by(STRIP) {
                    let columns = STRIP.min(width - start);
                    strip(on, off, region, shift, start, columns, &mut best, &mut row);
                }
            },
        );
    }
    collect(&best, &row, width, bands, region)
}

/// The band maxima of up to [`STRIP`] columns.
#[allow(clippy::too_many_arguments)]
#[inline(always)]
fn strip<P: Pixel>(
    on: &Image<P>,
    off: Option<&Image<P>>,
    region: &Region,
    shift: u32,
    start: usize,
    columns: usize,
    best: &mut [u16],
    row: &mut [u16],
) {
    let width = region.u1 - region.u0;
    let (a, b) = (region.u0 + start, region.u0 + start + columns);
    let mut pixels = [[0_u16; STRIP]; 8];
    let mut sums = [[0_u16; STRIP]; 16];
    let mut sum = [0_u16; STRIP];
    let mut band_best = [0_u16; STRIP];
    let mut band_row = [0_u16; STRIP];
    let height = region.v1 - region.v0;
    for v in 0..height {
        let new = &mut pixels[v % 8];
        let on_row = &on.row(region.v0 + v)[a..b];
        match off {
            Some(off) => {
                let off_row = &off.row(region.v0 + v)[a..b];
                for ((n, x), y) in new.iter_mut().zip(on_row).zip(off_row) {
                    *n = x.to_u16().saturating_sub(y.to_u16()) >> shift;
                }
            }
            None => {
                for (n, x) in new.iter_mut().zip(on_row) {
                    *n = x.to_u16() >> shift;
                }
            }
        }
        // The row that leaves the sum, five rows ago; 0 before there were five.
        let (new, gone) = (&pixels[v % 8], &pixels[(v + 3) % 8]);
        let kept = &mut sums[v.wrapping_sub(HALF) % 16];
        for l in 0..STRIP {
            // Never overflows: five values below 4096; wrapping keeps the loop plain.
            sum[l] = sum[l].wrapping_add(new[l]).wrapping_sub(gone[l]);
            kept[l] = sum[l];
        }
        if v < 2 * MARGIN {
            continue;
        }
        let c = v - MARGIN;
        let (here, above, below) = (
            &sums[c % 16],
            &sums[(c - SURROUND) % 16],
            &sums[(c + SURROUND) % 16],
        );
        let c16 = c as u16;
        for l in 0..STRIP {
            let r = here[l].saturating_sub(above[l].max(below[l]));
            let larger = r > band_best[l];
            band_best[l] = if larger { r } else { band_best[l] };
            band_row[l] = if larger { c16 } else { band_row[l] };
        }
        if c % BAND == BAND - 1 || v == height - 1 {
            let at = c / BAND * width + start;
            best[at..at + columns].copy_from_slice(&band_best[..columns]);
            row[at..at + columns].copy_from_slice(&band_row[..columns]);
            band_best = [0; STRIP];
            band_row = [0; STRIP];
        }
    }
}

/// The band maxima above the noise, sorted by column.
fn collect(best: &[u16], row: &[u16], width: usize, bands: usize, region: &Region) -> Candidates {
    // Most bands hold no stripe: their median is the noise's own maximum over a band.
    let mut histogram = [0_u32; 4096];
    let mut counted = 0;
    for value in best.iter().step_by(3) {
        histogram[usize::from(*value).min(4095)] += 1;
        counted += 1;
    }
    let mut noise = 0_u16;
    let mut below = 0;
    for (value, count) in histogram.iter().enumerate() {
        below += count;
        if 2 * below >= counted {
            noise = value as u16;
            break;
        }
    }
    let threshold = (noise.saturating_mul(OVER_NOISE.0) / OVER_NOISE.1).max(LEAST_RESPONSE);

    let mut first = vec![0_u32; width + 1];
    let mut hits = Vec::with_capacity(4 * width);
    for band in 0..bands {
        let line = &best[band * width..(band + 1) * width];
        for (block, start) in line.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
            if block.iter().fold(0, |m, &r| m.max(r)) < threshold {
                continue;
            }
            let above = block.iter().enumerate().filter(|(_, r)| **r >= threshold);
            for (i, response) in above.map(|(i, r)| (start + i, r)) {
                let v = row[band * width + i];
                // A ridge on the border of two bands is in both: the larger stays.
                let near = |other: usize| {
                    let (r, w) = (best[other * width + i], row[other * width + i]);
                    w.abs_diff(v) < 6 && (r > *response || (r == *response && other < band))
                };
                if (band > 0 && near(band - 1)) || (band + 1 < bands && near(band + 1)) {
                    continue;
                }
                hits.push((i as u32, v, *response));
                first[i + 1] += 1;
            }
        }
    }
    for i in 0..width {
        first[i + 1] += first[i];
    }
    let mut next = first.clone();
    let blank = Candidate {
        u: 0,
        v: 0,
        response: 0,
    };
    let mut list = vec![blank; hits.len()];
    for (i, v, response) in hits {
        let slot = &mut next[i as usize];
        list[*slot as usize] = Candidate {
            u: (region.u0 + i as usize) as u16,
            v: (region.v0 + usize::from(v)) as u16,
            response,
        };
        *slot += 1;
    }
    Candidates { list, first }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same definition, pixel by pixel.
    fn response(image: &Image<u8>, off: &Image<u8>, u: usize, v: usize) -> u16 {
        let sum = |c: usize| -> u16 {
            (c - 2..=c + 2)
                .map(|r| u16::from(image.at(u, r).saturating_sub(off.at(u, r))))
                .sum()
        };
        let s = sum(v);
        s.saturating_sub(sum(v - SURROUND).max(sum(v + SURROUND)))
    }

    #[test]
    fn candidates_are_the_largest_responses_of_their_bands() {
        let (width, height) = (150, 133);
        let mut state = 12345_u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 30) as u8
        };
        let mut on = Image::new(width, height, 0_u8);
        let mut off = Image::new(width, height, 0_u8);
        for p in on.pixels_mut() {
            *p = noise() + 10;
        }
        for p in off.pixels_mut() {
            *p = noise();
        }
        for u in 0..width {
            for (k, g) in [20, 60, 90, 60, 20].into_iter().enumerate() {
                on.pixels_mut()[(40 + u / 5 + k) * width + u] += g;
            }
        }
        let region = Region {
            u0: 3,
            u1: 147,
            v0: 1,
            v1: 130,
        };
        let found = candidates(&on, Some(&off), &region);
        for i in 0..144 {
            let column = found.column(i);
            assert!(!column.is_empty());
            for c in column {
                let (u, v) = (usize::from(c.u), usize::from(c.v));
                assert_eq!(u, i + 3);
                assert_eq!(c.response, response(&on, &off, u, v));
                let band = (v - region.v0) / BAND;
                for r in (band * BAND).max(MARGIN)..((band + 1) * BAND).min(129 - MARGIN) {
                    assert!(response(&on, &off, u, r + region.v0) <= c.response);
                }
            }
            let top = column.iter().max_by_key(|c| c.response).unwrap();
            assert!(top.v.abs_diff((42 + (i + 3) / 5) as u16) <= 1);
        }
    }

    #[test]
    fn wide_pixels_give_the_same_rows() {
        let (width, height) = (70, 80);
        let mut narrow = Image::new(width, height, 4_u8);
        for u in 0..width {
            narrow.pixels_mut()[(30 + u / 9) * width + u] = 200;
        }
        let wide = Image::from_vec(
            width,
            height,
            narrow
                .pixels()
                .iter()
                .map(|p| u16::from(*p) * 257)
                .collect(),
        )
        .unwrap();
        let a = candidates(&narrow, None, &Region::whole(&narrow));
        let b = candidates(&wide, None, &Region::whole(&wide));
        let rows = |c: &Candidates| c.list.iter().map(|c| (c.u, c.v)).collect::<Vec<_>>();
        assert_eq!(rows(&a), rows(&b));
    }
}
