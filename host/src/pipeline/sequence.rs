//! Whether a scan's frames follow the slide: from frame to frame the stripe moves in the image in
//! proportion to the travel. Where it moves twice as far, or not at all, a frame was lost or doubled,
//! or the hand moved, and all that follows would be laid beside where it is.

use crate::cloud::CloudPoint;
use crate::median::median;
use crate::needle::NeedleError;
use crate::stripe::Axis;

/// Columns between those that are compared.
const EVERY: i64 = 4;
/// Fewest columns that two frames must share, and pairs of frames that tell what is usual.
const LEAST_COLUMNS: usize = 12;
const LEAST_PAIRS: usize = 5;
/// Pairs on either side that a pair is compared with.
const NEIGHBOURS: usize = 4;
/// Travel in the image against that of the neighbours: less or more than this is no surface's slope.
const RATIO: [f64; 2] = [0.6, 1.3];

/// What is decided by here, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "scan: a stripe’s travel from frame to frame against its neighbours’",
        format!("{} to {}", RATIO[0], RATIO[1]),
    )]
}

/// A pair of frames between which the stripe did not follow the slide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Break {
    /// The two frames, from 0.
    pub frames: [usize; 2],
    /// How far the stripe moved, as a part of what its neighbours' travel asks for.
    pub ratio: f64,
}

impl Break {
    /// As a reason for giving no angle.
    pub fn error(&self) -> NeedleError {
        NeedleError::OutOfStep {
            frames: self.frames,
            // No "-0.0".
            ratio: self.ratio + 0.0,
            least: RATIO[0],
            most: RATIO[1],
        }
    }
}

/// One frame's stripe: along and across the image, in every [`EVERY`]-th column.
type Course = Vec<(i64, f64)>;

/// Travel in the image for each mm of the slide; `None` where the frames share too little.
fn travel(a: &Course, b: &Course, mm: f64) -> Option<f64> {
    let mut moved: Vec<f64> = Vec::new();
    let mut at = 0;
    for &(column, v) in a {
        while at < b.len() && b[at].0 < column {
            at += 1;
        }
        if let Some(&(_, w)) = b.get(at).filter(|q| q.0 == column) {
            moved.push((w - v) / mm);
        }
    }
    (moved.len() >= LEAST_COLUMNS && mm != 0.0).then(|| median(&mut moved))
}

/// The pairs of frames that do not follow; `positions` of the slide are those of frames 0, 1, …, mm,
/// and `cloud` is in their order.
pub fn breaks(cloud: &[CloudPoint], positions: &[f64], axis: Axis) -> Vec<Break> {
    let mut courses: Vec<Course> = vec![Course::new(); positions.len()];
    for point in cloud {
        let (along, across) = match axis {
            Axis::Columns => (point.pixel.x, point.pixel.y),
            Axis::Rows => (point.pixel.y, point.pixel.x),
        };
        let column = along.round() as i64;
        if column % EVERY == 0
            && let Some(course) = courses.get_mut(point.frame as usize)
        {
            course.push((column, across));
        }
    }
    for course in &mut courses {
        course.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        course.dedup_by_key(|p| p.0);
    }
    let pairs: Vec<(usize, f64)> = (1..positions.len())
        .filter_map(|i| {
            let mm = positions[i] - positions[i - 1];
            Some((i, travel(&courses[i - 1], &courses[i], mm)?))
        })
        .collect();
    if pairs.len() < LEAST_PAIRS {
        return Vec::new();
    }
    let ratio = |k: usize| {
        let around = k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(pairs.len());
        let mut others: Vec<f64> = around.filter(|&j| j != k).map(|j| pairs[j].1).collect();
        pairs[k].1 / median(&mut others)
    };
    (0..pairs.len())
        .map(|k| Break {
            frames: [pairs[k].0 - 1, pairs[k].0],
            ratio: ratio(k),
        })
        .filter(|b| !(RATIO[0]..=RATIO[1]).contains(&b.ratio))
        .collect()
}
