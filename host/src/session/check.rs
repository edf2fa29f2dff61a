//! Checks of `session.json` alone, before any image is opened: everything that can be known to be
//! wrong without looking at a pixel.

use super::error::SessionError;
use super::model::{FORMAT, Frame, Manifest};
use crate::median::median;
use std::path::{Path, PathBuf};

/// Longest side of an image that is believed, px.
const MAX_SIDE: u32 = 20_000;
/// Most pixels of an image.
const MAX_PIXELS: u64 = 200_000_000;
/// Fewest and most inner corners along a side of the board.
const CORNERS: std::ops::RangeInclusive<usize> = 3..=60;
/// Side of a square that is believed, mm.
const SQUARE_MM: std::ops::RangeInclusive<f64> = 0.5..=500.0;
/// Farthest slide position that is believed, mm.
const MAX_SLIDE_MM: f64 = 2_000.0;
/// Shortest travel over which planes or stripes can be told apart, mm.
const MIN_TRAVEL_MM: f64 = 0.2;
/// How far slide_mm may stray from its line over slide_steps, mm.
const STEP_TOLERANCE_MM: f64 = 0.05;

/// Parses and checks the text of a session.json; `path` is for messages only.
pub fn parse(text: &[u8], path: &Path) -> Result<Manifest, SessionError> {
    let manifest: Manifest = serde_json::from_slice(text).map_err(|e| SessionError::Json {
        path: path.to_owned(),
        reason: e.to_string(),
    })?;
    check(&manifest, path)?;
    Ok(manifest)
}

/// Checks values; `path` is for messages only.
pub fn check(m: &Manifest, path: &Path) -> Result<(), SessionError> {
    let c = Checker { path };
    c.that(
        m.format == FORMAT,
        "write \"cannula-session/1\", or update this program",
        || format!("\"format\" is {:?}", m.format),
    )?;
    let (w, h) = (m.image.width, m.image.height);
    c.that(
        (16..=MAX_SIDE).contains(&w)
            && (16..=MAX_SIDE).contains(&h)
            && u64::from(w) * u64::from(h) <= MAX_PIXELS,
        "give the size of the images in pixels",
        || format!("\"image\" is {w} × {h}"),
    )?;
    if let Some(b) = &m.board {
        c.that(
            CORNERS.contains(&b.columns) && CORNERS.contains(&b.rows),
            "count the inner corners, 3 to 60 along each side",
            || format!("\"board\" has {} × {} inner corners", b.columns, b.rows),
        )?;
        c.that(
            b.columns >= b.rows,
            "\"columns\" counts along the long side: exchange the two",
            || format!("\"board\" has {} columns and {} rows", b.columns, b.rows),
        )?;
        c.that(
            SQUARE_MM.contains(&b.square_mm),
            "give the side of one square in millimetres (0.5 to 500)",
            || format!("\"square_mm\" is {}", b.square_mm),
        )?;
    }
    for (i, view) in m.camera.iter().enumerate() {
        c.name(&view.image, || format!("camera[{i}]"))?;
    }
    for (i, pose) in m.light.iter().enumerate() {
        if let Some(off) = &pose.off {
            c.name(off, || format!("light[{i}].off"))?;
            c.that(
                !pose.on.iter().any(|f| &f.image == off),
                "\"off\" is the image with the laser off",
                || format!("light[{i}] names {off:?} both as \"off\" and in \"on\""),
            )?;
        }
        c.that(
            !pose.on.is_empty(),
            "name its images, or take the pose out",
            || format!("light[{i}].on is empty"),
        )?;
        c.frames(&pose.on, &format!("light[{i}].on"))?;
    }
    if let Some(scan) = &m.scan {
        c.that(
            !scan.frames.is_empty(),
            "name its images, or take \"scan\" out",
            || "scan.frames is empty".to_owned(),
        )?;
        if let Some(ambient) = &scan.ambient {
            c.name(ambient, || "scan.ambient".to_owned())?;
            c.that(
                !scan.frames.iter().any(|f| &f.image == ambient),
                "\"ambient\" is the image with the laser off",
                || format!("{ambient:?} is named both as scan.ambient and in scan.frames"),
            )?;
        }
        c.frames(&scan.frames, "scan.frames")?;
    }
    c.units(m)?;
    if let Some(e) = &m.entry {
        let inside = |p: &[f64; 2]| {
            (-0.5..f64::from(w) - 0.5).contains(&p[0]) && (-0.5..f64::from(h) - 0.5).contains(&p[1])
        };
        c.that(
            inside(&e.pixel),
            "give [u, v] in pixels of the camera's image",
            || {
                format!(
                    "entry.pixel [{}, {}] lies outside the image",
                    e.pixel[0], e.pixel[1]
                )
            },
        )?;
        if let Some(p) = e.vein.iter().find(|p| !inside(p)) {
            return c.fail(
                format!("entry.vein [{}, {}] lies outside the image", p[0], p[1]),
                "give [u, v] in pixels of the camera's image",
            );
        }
        let far = |p: &[f64; 2], q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]) > 0.5;
        c.that(
            e.vein.len() >= 2 && e.vein.iter().any(|p| far(p, &e.vein[0])),
            "give two or more different pixels along the vein, in the direction of the needle",
            || format!("entry.vein has {} pixels and no direction", e.vein.len()),
        )?;
        c.that(
            (0.5..=200.0).contains(&e.radius_mm),
            "give millimetres, 0.5 to 200",
            || format!("entry.radius_mm is {}", e.radius_mm),
        )?;
    }
    if let Some(angle) = m.laser.and_then(|l| l.travel_angle_deg) {
        c.that(
            (0.0..85.0).contains(&angle),
            "give degrees, 0 to 85",
            || format!("laser.travel_angle_deg is {angle}"),
        )?;
    }
    if let Some(t) = &m.robot_from_camera {
        c.that(
            is_rigid(t),
            "give a rigid motion in mm, row by row, with the last row 0 0 0 1",
            || "\"robot_from_camera\" is not a rotation and a translation".to_owned(),
        )?;
    }
    Ok(())
}

/// Whether a 4 × 4 is a rotation and a translation (within 1e-4, as typed by hand).
fn is_rigid(t: &[[f64; 4]; 4]) -> bool {
    let r = nalgebra::Matrix3::from_fn(|i, j| t[i][j]);
    t.iter().flatten().all(|v| v.is_finite())
        && t[3] == [0.0, 0.0, 0.0, 1.0]
        && (r * r.transpose() - nalgebra::Matrix3::identity())
            .abs()
            .max()
            < 1e-4
        && r.determinant() > 0.0
}

struct Checker<'a> {
    path: &'a Path,
}

impl Checker<'_> {
    fn fail(&self, what: String, remedy: &'static str) -> Result<(), SessionError> {
        Err(SessionError::Value {
            path: PathBuf::from(self.path),
            what,
            remedy,
        })
    }

    fn that(
        &self,
        ok: bool,
        remedy: &'static str,
        what: impl FnOnce() -> String,
    ) -> Result<(), SessionError> {
        if ok {
            Ok(())
        } else {
            self.fail(what(), remedy)
        }
    }

    fn name(&self, name: &str, place: impl Fn() -> String) -> Result<(), SessionError> {
        self.that(
            !name.is_empty() && !name.contains('\0'),
            "give a file name relative to session.json",
            || format!("{} names no image", place()),
        )
    }

    /// Names, finite positions, strictly in order of travel (either way), in step with slide_steps.
    fn frames(&self, frames: &[Frame], place: &str) -> Result<(), SessionError> {
        for (i, f) in frames.iter().enumerate() {
            self.name(&f.image, || format!("{place}[{i}]"))?;
            self.that(f.slide_mm.is_finite(), "give millimetres", || {
                format!("{place}[{i}].slide_mm is {}", f.slide_mm)
            })?;
            self.that(
                f.slide_mm.abs() <= MAX_SLIDE_MM,
                "give millimetres (not micrometres or steps)",
                || {
                    format!(
                        "{place}[{i}].slide_mm is {}, farther than any slide of this kind goes",
                        f.slide_mm
                    )
                },
            )?;
        }
        let mut seen: Vec<&Frame> = frames.iter().collect();
        seen.sort_by(|a, b| a.slide_mm.total_cmp(&b.slide_mm));
        if let Some(pair) = seen
            .windows(2)
            .find(|p| p[1].slide_mm - p[0].slide_mm < 1e-6)
        {
            return self.fail(
                format!(
                    "{place} has the position {} mm twice ({} and {})",
                    pair[0].slide_mm, pair[0].image, pair[1].image
                ),
                "correct slide_mm or take one of them out",
            );
        }
        let descending = frames.len() > 1 && frames[1].slide_mm < frames[0].slide_mm;
        if let Some(pair) = frames
            .windows(2)
            .find(|p| (p[1].slide_mm < p[0].slide_mm) != descending)
        {
            return self.fail(
                format!(
                    "{place} is not in the order of travel: {} mm ({}) comes after {} mm ({})",
                    pair[1].slide_mm, pair[1].image, pair[0].slide_mm, pair[0].image
                ),
                "list the frames in the order in which the slide visited them",
            );
        }
        let mut names: Vec<&str> = frames.iter().map(|f| f.image.as_str()).collect();
        names.sort_unstable();
        if let Some(pair) = names.windows(2).find(|p| p[0] == p[1]) {
            return self.fail(
                format!("{place} names {:?} twice", pair[0]),
                "one image belongs to one position",
            );
        }
        Ok(())
    }

    /// Positions in another unit than mm, as far as the file alone can tell.
    fn units(&self, m: &Manifest) -> Result<(), SessionError> {
        let light: Vec<&Frame> = m.light.iter().flat_map(|l| &l.on).collect();
        let scan: Vec<&Frame> = m.scan.iter().flat_map(|s| &s.frames).collect();
        let mut known: Vec<f64> = light.iter().map(|f| f.slide_mm).collect();
        known.sort_by(f64::total_cmp);
        known.dedup();
        for (frames, place) in [(&light, "light"), (&scan, "scan.frames")] {
            let (low, high) = range(frames.iter().map(|f| f.slide_mm));
            self.that(
                !(high - low > 0.0 && high - low < MIN_TRAVEL_MM),
                "give slide_mm in millimetres (are these metres?)",
                || format!("the slide travels only {} mm over {place}", high - low),
            )?;
        }
        // A scan that goes far beyond where the light planes were measured is in another unit, or
        // of another rig: either way its depth would be made up.
        if known.len() >= 2 && !scan.is_empty() {
            let (low, high) = (known[0], known[known.len() - 1]);
            let reach = high - low;
            let (first, last) = range(scan.iter().map(|f| f.slide_mm));
            self.that(
                first > low - reach && last < high + reach,
                "give both in millimetres of the same slide, and calibrate over the range that is scanned",
                || format!("the scan runs from {first} to {last} mm, the light planes were recorded from {low} to {high} mm"),
            )?;
            self.that(
                scan.len() < 3 || last - first > 0.02 * reach,
                "give both in millimetres of the same slide",
                || {
                    format!(
                        "the scan travels {} mm, the light planes {reach} mm",
                        last - first
                    )
                },
            )?;
        }
        let pairs = |frames: &[&Frame]| -> Steps {
            let counted = |f: &&Frame| {
                Some(Counted {
                    steps: f.slide_steps? as f64,
                    mm: f.slide_mm,
                    image: f.image.clone(),
                })
            };
            frames.iter().filter_map(counted).collect()
        };
        self.steps(pairs(&light), pairs(&scan))
    }

    /// slide_mm must be one straight line over slide_steps, where both stand. Where it is not, each list is
    /// looked at for itself: the frame that is off its own list's line is named, or the two lists.
    fn steps(&self, light: Steps, scan: Steps) -> Result<(), SessionError> {
        let all: Steps = light.iter().chain(&scan).cloned().collect();
        let Some((of_all, astray)) = fitted(&all) else {
            return Ok(());
        };
        let Some(astray) = astray else {
            return Ok(());
        };
        let frame = |line: Line, Counted { steps, mm, image }: &Counted| {
            self.fail(
                format!(
                    "{image}: slide_mm {mm} does not fit its slide_steps {steps} ({:.3} mm by the other frames)",
                    line.at(*steps)
                ),
                "correct the position of that frame",
            )
        };
        let own = [&light, &scan].map(fitted);
        for (line, astray) in own.iter().flatten() {
            if let Some(astray) = astray {
                return frame(*line, astray);
            }
        }
        let ((line, name), (others, other)) = match own {
            [Some((line, _)), _] => ((line, "light"), (&scan, "scan")),
            [None, Some((line, _))] => ((line, "scan"), (&light, "light")),
            // One position in each.
            [None, None] => return frame(of_all, astray),
        };
        let off = |p: &&Counted| (p.mm - line.at(p.steps)).abs();
        let farthest = others.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
        let Some(Counted { steps, mm, image }) = farthest else {
            return Ok(());
        };
        self.fail(
            format!(
                "\"{name}\" and \"{other}\" disagree on where the slide stands: slide_steps {steps} is {mm} mm in \"{other}\" ({image}), {:.3} mm by the frames of \"{name}\"",
                line.at(*steps)
            ),
            "correct slide_mm or slide_steps of one of them, or record both without homing in between",
        )
    }
}

/// The line of a list and the first of its frames that is off it; `None` where all stand at one place.
fn fitted(list: &Steps) -> Option<(Line, Option<&Counted>)> {
    let mut sorted: Vec<&Counted> = list.iter().collect();
    sorted.sort_by(|a, b| a.steps.total_cmp(&b.steps));
    let slopes = |apart: usize| -> Vec<f64> {
        let pairs = sorted.iter().zip(sorted.iter().skip(apart));
        pairs
            .map(|(p, q)| (q.steps - p.steps, q.mm - p.mm))
            .filter(|(steps, _)| *steps != 0.0)
            .map(|(steps, mm)| mm / steps)
            .collect()
    };
    // Theil–Sen's slope over pairs half the list apart: a wrong entry, at an end too, is in two of them.
    let mut slopes = match slopes(list.len() / 2) {
        // Most stand at one place.
        few if few.is_empty() => slopes(1),
        half => half,
    };
    if slopes.is_empty() {
        return None;
    }
    let slope = median(&mut slopes);
    let mut offsets: Vec<f64> = list.iter().map(|p| p.mm - slope * p.steps).collect();
    let line = Line {
        slope,
        offset: median(&mut offsets),
    };
    let tolerance = STEP_TOLERANCE_MM.max(2.0 * slope.abs());
    let astray = |p: &&Counted| !((p.mm - line.at(p.steps)).abs() <= tolerance);
    Some((line, list.iter().find(astray)))
}

/// Where a frame says that the slide stood, twice.
#[derive(Clone)]
struct Counted {
    steps: f64,
    mm: f64,
    image: String,
}

/// A list's frames that say so.
type Steps = Vec<Counted>;

/// mm over steps.
#[derive(Clone, Copy)]
struct Line {
    slope: f64,
    offset: f64,
}

impl Line {
    fn at(&self, steps: f64) -> f64 {
        self.slope * steps + self.offset
    }
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
        (a.min(v), b.max(v))
    })
}
