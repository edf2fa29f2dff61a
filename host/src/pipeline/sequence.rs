//! Whether a scan's frames follow the slide: from frame to frame the stripe moves in the image in
//! proportion to the travel. Where it moves twice as far, or not at all, a frame was lost or doubled, or
//! the hand moved, and all that follows would be laid beside where it is. A slip of the slide, or a twitch
//! of the hand, by a tenth of a step shows too: a surface's travel runs smoothly, and a cubic through two
//! neighbours on either side foretells it to a few hundredths.

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
/// How far it may be off what the neighbours foretell, as a part of that, between two frames and over a
/// few: named, refused. On 79 rendered recordings without a slip, and on the same with every second or
/// third frame only, the most is 0.056, where speckle is strong, and 0.036 elsewhere.
const OFF: [[f64; 2]; 2] = [[0.045, 0.1], [0.045, 0.07]];
/// The same in the scan's own scatters (median of what all are off, as a standard deviation), where that
/// is more, up to [`OFF_MOST`]: what slips all the time must not hide itself.
const OFF_SCATTERS: [f64; 2] = [5.0, 10.0];
/// See [`OFF_SCATTERS`].
const OFF_MOST: [f64; 2] = [0.12, 0.2];
/// The scatter itself, named; 0.022 at the most without a slip.
const SCATTER: f64 = 0.03;
/// These hold for steps of this many mm and more; shorter ones scatter more, in proportion.
const STEP_MM: f64 = 2.0;
/// Travel over so many mm is looked at beside that from frame to frame.
const SPANS_MM: [f64; 3] = [2.0, 4.0, 6.0];

/// What is decided by here, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    let off = |k: usize| {
        let [near, wide] = OFF.map(|o| o[k]);
        let [scatters, most] = [OFF_SCATTERS[k], OFF_MOST[k]];
        format!("{near} (over several frames {wide}) or {scatters} scatters up to {most}")
    };
    vec![
        (
            "scan: a stripe’s travel from frame to frame against its neighbours’",
            format!("{} to {}", RATIO[0], RATIO[1]),
        ),
        (
            "scan: the same off what two neighbours on either side foretell, named at",
            off(0),
        ),
        ("scan: the same, refused at", off(1)),
        (
            "scan: scatter of the same named above",
            format!("{SCATTER} at steps of {STEP_MM} mm"),
        ),
    ]
}

/// Two frames between which the stripe's travel is judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The two, from 0.
    pub frames: [usize; 2],
    /// How far the stripe moved, as a part of what its neighbours' travel asks for.
    pub ratio: f64,
    /// Least and most that it may before it is named.
    pub named: [f64; 2],
    /// The same before no angle is given.
    pub refused: [f64; 2],
}

impl Pair {
    fn beyond(&self, limits: [f64; 2]) -> bool {
        !(limits[0]..=limits[1]).contains(&self.ratio)
    }

    fn breaks(&self) -> bool {
        self.beyond(self.refused)
    }

    /// How far off it is, in what is named.
    fn off(&self) -> f64 {
        (self.ratio - 1.0).abs() / (self.named[1] - 1.0)
    }

    /// As a reason for giving no angle.
    pub fn error(&self) -> NeedleError {
        NeedleError::OutOfStep {
            frames: self.frames,
            // No "-0.0".
            ratio: self.ratio + 0.0,
            least: self.refused[0],
            most: self.refused[1],
        }
    }
}

/// How a scan's stripes follow the slide.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    /// Frames that do not.
    pub breaks: Vec<Pair>,
    /// Those that are the farthest off what is foretold, where there are enough to tell.
    pub farthest: Option<Pair>,
    /// Scatter of all from frame to frame, and up to what it is usual.
    pub scatter: Option<[f64; 2]>,
}

impl Sequence {
    /// As checks. What refuses is said by [`Pair::error`].
    pub fn checks(&self) -> Vec<Check> {
        let none = Limit::AtMost(0.0);
        let what = "scan: frames whose stripe does not follow the slide";
        let breaks = Check::held(what, self.breaks.len() as f64, none, "").refused_beyond(none);
        let farthest = self.farthest.map(|f| {
            let what = "scan: a stripe’s travel against what its neighbours foretell, farthest off";
            let check = Check::held(what, f.ratio, Limit::Between(f.named), "")
                .refused_beyond(Limit::Between(f.refused));
            match f.breaks() {
                true => check,
                false => check.or(|| {
                    (
                        format!(
                            "from frame {} to frame {} the stripe moves {:.2} times as far as the slide’s travel asks for, as if the hand had moved or the slide slipped",
                            f.frames[0], f.frames[1], f.ratio
                        ),
                        "scan again with the hand at rest; if it is there again, look at the slide".to_owned(),
                    )
                }),
            }
        });
        let scatter = self.scatter.map(|[scatter, usual]| {
            let what = "scan: scatter of the stripe’s travel from frame to frame";
            Check::held(what, scatter, Limit::AtMost(usual), "").or(|| {
                (
                    format!(
                        "the stripe’s travel scatters by {:.0} % from frame to frame (up to {:.0} % is usual): a slide that sticks and slips, positions that are not where it stood, or a hand that shakes; no σ holds that",
                        100.0 * scatter,
                        100.0 * usual,
                    ),
                    "look at the slide, and scan again with the hand at rest".to_owned(),
                )
            })
        });
        let all = std::iter::once(breaks).chain(farthest).chain(scatter);
        all.collect()
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

/// Looks at the frames; `positions` of the slide are those of frames 0, 1, …, mm, and `cloud` is in their
/// order. Of centres that are whole pixels (the paper's thinning) only the coarse limits hold.
pub fn follow(cloud: &[CloudPoint], positions: &[f64], axis: Axis, sub_pixel: bool) -> Sequence {
    let courses = courses(cloud, positions.len(), axis);
    let steps = spans(&courses, positions, 1);
    let pairs: Vec<(usize, f64)> = (1..)
        .zip(&steps)
        .filter_map(|(i, s)| Some((i, s.as_ref()?.travel)))
        .collect();
    if pairs.len() < LEAST_PAIRS {
        return Sequence::default();
    }
    let around = |k: usize| {
        let around = k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(pairs.len());
        let mut others: Vec<f64> = around.filter(|&j| j != k).map(|j| pairs[j].1).collect();
        Pair {
            frames: [pairs[k].0 - 1, pairs[k].0],
            ratio: pairs[k].1 / median(&mut others),
            named: RATIO,
            refused: RATIO,
        }
    };
    let mut breaks: Vec<Pair> = (0..pairs.len()).map(around).filter(Pair::breaks).collect();
    if !sub_pixel {
        return Sequence {
            breaks,
            ..Sequence::default()
        };
    }

    let mut lengths: Vec<f64> = positions.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let step = median(&mut lengths);
    let fine = (STEP_MM / step).max(1.0);
    let mut counts: Vec<usize> = SPANS_MM
        .map(|mm| ((mm / step).round() as usize).max(1))
        .to_vec();
    counts.insert(0, 1);
    counts.dedup();
    let mut farthest: Option<Pair> = None;
    let mut scatter = None;
    for count in counts {
        let spans = spans(&courses, positions, count);
        let ratios: Vec<(usize, f64)> = (0..spans.len())
            .filter_map(|i| Some((i, spans[i].as_ref()?.travel / foretold(&spans, i, count)?)))
            .collect();
        if ratios.len() < LEAST_PAIRS {
            continue;
        }
        let off = |r: &(usize, f64)| (r.1 - 1.0).abs();
        let worst = ratios.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
        let worst = worst.map_or(0, |r| r.0);
        // A slip spoils what is foretold around it, too: it must not make its own limit wider.
        let apart = |r: &&(usize, f64)| r.0.abs_diff(worst) > 2 * count;
        let mut rest: Vec<f64> = ratios.iter().filter(apart).map(off).collect();
        if rest.len() < LEAST_PAIRS {
            rest = ratios.iter().map(off).collect();
        }
        let scatters = 1.4826 * median(&mut rest);
        if count == 1 {
            scatter = Some([scatters, SCATTER * fine]);
        }
        let limits = |k: usize| {
            let least = OFF[usize::from(count > 1)][k];
            let off = (OFF_SCATTERS[k] * scatters)
                .min(fine * OFF_MOST[k])
                .max(least);
            [1.0 - off, 1.0 + off]
        };
        let pairs = ratios.iter().map(|&(i, ratio)| Pair {
            frames: [i, i + count],
            ratio,
            named: limits(0),
            refused: limits(1),
        });
        farthest = pairs
            .chain(farthest)
            .max_by(|a, b| a.off().total_cmp(&b.off()));
    }
    if breaks.is_empty() {
        breaks.extend(farthest.filter(Pair::breaks));
    }
    Sequence {
        breaks,
        farthest,
        scatter,
    }
}

/// Travel from one frame to a later one.
struct Span {
    /// Where between them the slide was, mm.
    middle_mm: f64,
    /// In the image for each mm of the slide.
    travel: f64,
}

/// From each frame to the one that comes `count` later.
fn spans(courses: &[Course], positions: &[f64], count: usize) -> Vec<Option<Span>> {
    (count..positions.len())
        .map(|j| {
            let (a, b) = (positions[j - count], positions[j]);
            Some(Span {
                middle_mm: 0.5 * (a + b),
                travel: travel(&courses[j - count], &courses[j], b - a)?,
            })
        })
        .collect()
}

/// The travel in span `i` by the cubic through the two spans before and the two after it, none of which
/// shares a frame's way with it.
fn foretold(spans: &[Option<Span>], i: usize, count: usize) -> Option<f64> {
    let at = |k: usize| spans.get(k)?.as_ref();
    let others = [
        at(i.checked_sub(2 * count)?)?,
        at(i.checked_sub(count)?)?,
        at(i + count)?,
        at(i + 2 * count)?,
    ];
    let x = at(i)?.middle_mm;
    let weight = |j: usize| -> f64 {
        let rest = others.iter().enumerate().filter(|(k, _)| *k != j);
        rest.map(|(_, o)| (x - o.middle_mm) / (others[j].middle_mm - o.middle_mm))
            .product()
    };
    Some(
        (0..others.len())
            .map(|j| weight(j) * others[j].travel)
            .sum(),
    )
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
