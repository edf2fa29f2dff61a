//! Whether a scan's frames follow the slide: from frame to frame the stripe moves in the image in
//! proportion to the travel. Where it moves twice as far, or not at all, a frame was lost or doubled, or
//! the hand moved, and all that follows would be laid beside where it is. A slip of the slide, or a twitch
//! of the hand, by a tenth of a step shows against the two neighbours: a surface's travel is smooth.

use crate::checks::{Check, Limit};
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
/// How far it may be off the mean of the two beside it, as a part of that: named, refused. On 79 rendered
/// recordings without a slip the most is 0.057, where speckle is strong, and 0.04 elsewhere.
const OFF: [f64; 2] = [0.045, 0.1];
/// The same where the scan's own scatter (median of what pairs are off, as a standard deviation) asks for more.
const OFF_SCATTERS: [f64; 2] = [5.0, 10.0];

/// What is decided by here, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    let off = |k: usize| format!("{} or {} scatters", OFF[k], OFF_SCATTERS[k]);
    vec![
        (
            "scan: a stripe’s travel from frame to frame against its neighbours’",
            format!("{} to {}", RATIO[0], RATIO[1]),
        ),
        (
            "scan: the same off the mean of the two beside it refused, named at",
            format!("{}, {}", off(1), off(0)),
        ),
    ]
}

/// A pair of frames between which the stripe did not follow the slide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Break {
    /// The two frames, from 0.
    pub frames: [usize; 2],
    /// How far the stripe moved, as a part of what its neighbours' travel asks for.
    pub ratio: f64,
    /// Least and most that it may.
    pub limits: [f64; 2],
}

impl Break {
    fn beyond(&self) -> bool {
        !(self.limits[0]..=self.limits[1]).contains(&self.ratio)
    }

    /// As a reason for giving no angle.
    pub fn error(&self) -> NeedleError {
        NeedleError::OutOfStep {
            frames: self.frames,
            // No "-0.0".
            ratio: self.ratio + 0.0,
            least: self.limits[0],
            most: self.limits[1],
        }
    }
}

/// How a scan's stripes follow the slide.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    /// Pairs that do not.
    pub breaks: Vec<Break>,
    /// The pair that is the farthest off the two beside it, where there are enough to tell, with the
    /// limits of caution.
    pub farthest: Option<Break>,
}

impl Sequence {
    /// As checks, those that refuse among them.
    pub fn checks(&self) -> Vec<Check> {
        let breaks = Check::held(
            "scan: frames whose stripe does not follow the slide",
            self.breaks.len() as f64,
            Limit::AtMost(0.0),
            "",
        );
        let farthest = self.farthest.map(|f| {
            let what = "scan: a stripe’s travel against the two beside it, farthest off";
            Check::held(what, f.ratio, Limit::Between(f.limits), "").or(|| {
                (
                    format!(
                        "from frame {} to frame {} the stripe moves {:.2} times as far as the slide’s travel asks for: did the hand move, or the slide slip?",
                        f.frames[0], f.frames[1], f.ratio
                    ),
                    "scan again with the hand at rest; if it is there again, look at the slide".to_owned(),
                )
            })
        });
        std::iter::once(breaks).chain(farthest).collect()
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

/// Looks at the pairs of frames; `positions` of the slide are those of frames 0, 1, …, mm, and `cloud` is
/// in their order. Of centres that are whole pixels (the paper's thinning) only the coarse limits hold.
pub fn follow(cloud: &[CloudPoint], positions: &[f64], axis: Axis, sub_pixel: bool) -> Sequence {
    let courses = courses(cloud, positions.len(), axis);
    let pairs: Vec<(usize, f64)> = (1..positions.len())
        .filter_map(|i| {
            let mm = positions[i] - positions[i - 1];
            Some((i, travel(&courses[i - 1], &courses[i], mm)?))
        })
        .collect();
    if pairs.len() < LEAST_PAIRS {
        return Sequence::default();
    }
    let at = |k: usize, ratio: f64, limits: [f64; 2]| Break {
        frames: [pairs[k].0 - 1, pairs[k].0],
        ratio,
        limits,
    };
    let around = |k: usize| {
        let around = k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(pairs.len());
        let mut others: Vec<f64> = around.filter(|&j| j != k).map(|j| pairs[j].1).collect();
        at(k, pairs[k].1 / median(&mut others), RATIO)
    };
    let mut breaks: Vec<Break> = (0..pairs.len()).map(around).filter(Break::beyond).collect();

    let beside: Vec<(usize, f64)> = (1..pairs.len().saturating_sub(1))
        .filter(|&k| pairs[k + 1].0 == pairs[k - 1].0 + 2)
        .map(|k| (k, pairs[k].1 / (0.5 * (pairs[k - 1].1 + pairs[k + 1].1))))
        .collect();
    let mut off: Vec<f64> = beside.iter().map(|b| (b.1 - 1.0).abs()).collect();
    let scatter = 1.4826 * median(&mut off);
    let limits = |k: usize| {
        let off = OFF[k].max(OFF_SCATTERS[k] * scatter);
        [1.0 - off, 1.0 + off]
    };
    let farthest = beside
        .iter()
        .max_by(|a, b| (a.1 - 1.0).abs().total_cmp(&(b.1 - 1.0).abs()));
    let farthest = farthest.filter(|_| sub_pixel && beside.len() >= LEAST_PAIRS);
    let refused = farthest.map(|&(k, ratio)| at(k, ratio, limits(1)));
    if breaks.is_empty() {
        breaks.extend(refused.filter(Break::beyond));
    }
    Sequence {
        breaks,
        farthest: farthest.map(|&(k, ratio)| at(k, ratio, limits(0))),
    }
}

/// Each frame's stripe on the hand.
fn courses(cloud: &[CloudPoint], frames: usize, axis: Axis) -> Vec<Course> {
    let mut courses: Vec<Course> = vec![Course::new(); frames];
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
    courses
}
