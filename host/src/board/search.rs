//! The search from level to level, and the reason when it fails.

use super::candidate::{Candidate, examine};
use super::grid::find_grids;
use super::layout::lay_out;
use super::levels::{Level, depth_shift};
use super::refine::{MOST_BLUR, refine};
use super::response::peaks;
use super::{BoardGeometry, Detection, NotFound};
use crate::image::{Image, Pixel};

/// Least corner response taken up (a perfect corner of contrast C has 8·C; level units are a
/// quarter of an 8-bit grey).
const THRESHOLD: i16 = 100;
/// Most local maxima looked at, and most corners tried as neighbours, the strongest first.
const MOST_PEAKS: usize = 2000;
const MOST_CANDIDATES: usize = 500;
/// Shortest side of an image or level worth searching.
const SMALLEST: usize = 32;
/// Levels up to this size are searched first.
const FIRST_SIZE: usize = 1000;
/// Grids tried per level.
const MOST_GRIDS: usize = 4;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "board: least corner response",
            format!("{THRESHOLD} (8 × contrast)"),
        ),
        (
            "board: most peaks, candidates looked at",
            format!("{MOST_PEAKS}, {MOST_CANDIDATES}"),
        ),
        ("board: grids tried a level", MOST_GRIDS.to_string()),
        (
            "board: sizes searched first",
            format!("up to {FIRST_SIZE} px"),
        ),
    ]
}

/// What the search came to so far.
#[derive(Default)]
struct Failure {
    /// Corners in the largest grid, and what was wrong with it.
    grid: usize,
    reason: Option<NotFound>,
    /// Single corners seen, on the level where there were most.
    seen: usize,
}

/// See [`super::detect`].
pub(super) fn detect<P: Pixel>(
    image: &Image<P>,
    geometry: &BoardGeometry,
) -> Result<Detection, NotFound> {
    if image.width().min(image.height()) < SMALLEST || geometry.columns < 2 || geometry.rows < 2 {
        return Err(NotFound::NoCorners { seen: 0 });
    }
    let shift = depth_shift(image);
    let mut search = Search {
        image,
        geometry,
        saturation: ((P::MAX as u32 * 4) >> shift).min(i16::MAX as u32) as f32,
        failure: Failure::default(),
    };
    // First where the image is about 640 wide, then coarser (soft edges), then finer (small boards).
    let size = image.width().max(image.height());
    let mut pyramid = vec![if size > FIRST_SIZE {
        Level::half(image, shift)
    } else {
        Level::full(image, shift)
    }];
    while pyramid[pyramid.len() - 1]
        .width
        .max(pyramid[pyramid.len() - 1].height)
        > FIRST_SIZE
    {
        pyramid.push(pyramid[pyramid.len() - 1].coarser());
    }
    let first = pyramid.len() - 1;
    if let Some(found) = search.level(&pyramid[first]) {
        return Ok(found);
    }
    for k in first + 1..first + 3 {
        let next = pyramid[k - 1].coarser();
        if !search.hopeless()
            && let Some(found) = search.level(&next)
        {
            return Ok(found);
        }
        pyramid.push(next);
    }
    for level in pyramid[..first].iter().rev() {
        if !search.hopeless()
            && let Some(found) = search.level(level)
        {
            return Ok(found);
        }
    }
    if size > FIRST_SIZE
        && !search.hopeless()
        && let Some(found) = search.level(&Level::full(image, shift))
    {
        return Ok(found);
    }
    Err(search.reason(&pyramid[first + 1], shift))
}

struct Search<'a, P> {
    image: &'a Image<P>,
    geometry: &'a BoardGeometry,
    saturation: f32,
    failure: Failure,
}

impl<P: Pixel> Search<'_, P> {
    /// One level; failures are noted.
    fn level(&mut self, level: &Level) -> Option<Detection> {
        if level.width.min(level.height) < SMALLEST {
            return None;
        }
        let mut candidates: Vec<Candidate> = peaks(level, THRESHOLD, MOST_PEAKS)
            .iter()
            .filter_map(|p| examine(level, p))
            .collect();
        // By strength: grids start at good corners, and the order does not depend on the search.
        candidates.sort_by_key(|c| std::cmp::Reverse(c.response));
        candidates.truncate(MOST_CANDIDATES);
        self.failure.seen = self.failure.seen.max(candidates.len());
        for grid in find_grids(&candidates).iter().take(MOST_GRIDS) {
            let result = lay_out(grid, &candidates, self.geometry, level, self.saturation)
                .and_then(|layout| refine(self.image, &layout, self.geometry, level.step));
            match result {
                Ok(found) => return Some(found),
                Err(reason) if grid.cells.len() > self.failure.grid => {
                    self.failure.grid = grid.cells.len();
                    self.failure.reason = Some(reason);
                }
                Err(_) => {}
            }
        }
        None
    }

    /// Whether another level cannot help: the board was seen as a whole, but is too soft.
    fn hopeless(&self) -> bool {
        matches!(self.failure.reason, Some(NotFound::TooBlurred { .. }))
    }

    fn reason(self, level: &Level, shift: u32) -> NotFound {
        let grey = |x: i32| f64::from(x) * f64::from(1u32 << shift) / 4.0;
        let (low, high) = percentiles(level);
        if self.failure.reason.is_none() && high - low < 12 {
            return NotFound::NoContrast {
                darkest: grey(low),
                brightest: grey(high),
            };
        }
        // The sharpest step between dark and bright, against a third of the largest squares that
        // would fit.
        let (w, h) = (self.image.width() as f64, self.image.height() as f64);
        let (c, r) = (
            self.geometry.columns as f64 + 1.0,
            self.geometry.rows as f64 + 1.0,
        );
        let largest = (w / c).min(h / r).max((w / r).min(h / c));
        let limit_px = MOST_BLUR * largest / 3.0;
        let blur_px = f64::from(high - low) / steepest(level) / std::f64::consts::TAU.sqrt()
            * level.step as f64;
        let wanted = self.geometry.corners();
        let reason = self
            .failure
            .reason
            .filter(|_| self.failure.grid >= (wanted / 4).max(4));
        // Corners that the search saw and the fit lost in an image without one sharp edge.
        let unclear = matches!(reason, None | Some(NotFound::Hidden { .. }));
        if unclear && blur_px > limit_px {
            return NotFound::TooBlurred { blur_px, limit_px };
        }
        reason.unwrap_or(NotFound::NoCorners {
            seen: self.failure.seen,
        })
    }
}

/// Values that 1 % of the level lie below and above.
fn percentiles(level: &Level) -> (i32, i32) {
    let mut counts = vec![0usize; 1024];
    for &p in &level.pixels {
        counts[p.clamp(0, 1023) as usize] += 1;
    }
    let tail = level.pixels.len() / 100;
    let find = |values: &mut dyn Iterator<Item = usize>| {
        let mut sum = 0;
        for v in values {
            sum += counts[v];
            if sum > tail {
                return v as i32;
            }
        }
        0
    };
    (find(&mut (0..1024)), find(&mut (0..1024).rev()))
}

/// The steepest slope, grey per level pixel.
fn steepest(level: &Level) -> f64 {
    let mut best = 1;
    for y in 1..level.height - 1 {
        let (above, row, below) = (level.row(y - 1), level.row(y), level.row(y + 1));
        for x in 1..level.width - 1 {
            let gx = i32::from(row[x + 1]) - i32::from(row[x - 1]);
            let gy = i32::from(below[x]) - i32::from(above[x]);
            best = best.max(gx * gx + gy * gy);
        }
    }
    0.5 * f64::from(best).sqrt()
}
