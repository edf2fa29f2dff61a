//! The pictures: the hand with what was decided drawn on it, and pieces of frames with their
//! centres.

use super::measurement::{at_cloud, circle};
use crate::geometry::{Camera, Point3};
use crate::image::Image;
use crate::pipeline::{Measurement, Stage, Times};
use crate::report::model::{Gray, Picture, StripeSample};
use crate::report::write::Outcome;
use crate::session::{Session, SessionError};
use crate::stripe::Axis;
use crate::stripe::hand::{self, HandSettings, Surface};
use rayon::prelude::*;

/// Columns and rows of a stripe's piece: few enough that single pixels are seen.
const PIECE: (usize, usize) = (64, 32);

/// The image, in eight bits.
fn read(session: &Session, name: &str) -> Result<Image<u8>, SessionError> {
    use crate::session::Depth;
    match session.depth {
        Depth::Eight => session.laser::<u8>(name),
        Depth::Sixteen => {
            let wide = session.laser::<u16>(name)?;
            let (width, height) = (wide.width(), wide.height());
            let pixels = wide.pixels().iter().map(|p| (p >> 8) as u8).collect();
            Ok(Image::from_vec(width, height, pixels).unwrap_or_else(|| Image::new(0, 0, 0)))
        }
    }
}

/// The scan's image without the laser, where there is one.
///
/// # Errors
/// An image that can't be read.
pub fn ambient(session: &Session, times: &Times) -> Result<Option<Image<u8>>, SessionError> {
    let name = session
        .manifest
        .scan
        .as_ref()
        .and_then(|s| s.ambient.as_ref());
    name.map(|name| times.time(Stage::Read, || read(session, name)))
        .transpose()
}

/// Most measured points drawn on the hand.
const MOST_POINTS: usize = 4000;

/// The hand (`ambient`, or the middle frame), with entry, vein, and, where it was measured,
/// region and needle; where no angle is given, the measured points and the region asked for.
pub fn picture(
    session: &Session,
    ambient: Option<&Image<u8>>,
    outcome: &Outcome,
    camera: &Camera,
    times: &Times,
) -> Result<Option<Picture>, SessionError> {
    let (Some(scan), Some(entry)) = (&session.manifest.scan, &session.manifest.entry) else {
        return Ok(None);
    };
    let middle;
    let image = match (ambient, scan.frames.get(scan.frames.len() / 2)) {
        (Some(image), _) => image,
        (None, Some(frame)) => {
            middle = times.time(Stage::Read, || read(session, &frame.image))?;
            &middle
        }
        (None, None) => return Ok(None),
    };
    let mut drawn = Picture {
        image: Gray::default(),
        entry: entry.pixel,
        vein: entry.vein.clone(),
        region: Vec::new(),
        needle: Vec::new(),
        points: Vec::new(),
    };
    let seen = |p: &Point3| camera.project(p).map(|u| [u.x, u.y]);
    if let Some(s) = outcome.scanned() {
        if let Some(at) = at_cloud(s, &s.request.pixel, camera) {
            let region = circle(&at, &at.coords.normalize(), s.request.radius_mm);
            drawn.region = region.iter().filter_map(seen).collect();
        }
        let every = s.cloud.len().div_ceil(MOST_POINTS).max(1);
        let points = s.cloud.iter().step_by(every);
        drawn.points = points.map(|p| [p.pixel.x, p.pixel.y]).collect();
    }
    if let Some(m) = outcome.measured() {
        let d = &m.decision;
        let region = circle(&d.entry, &d.plane.normal, m.request.radius_mm);
        drawn.region = region.iter().filter_map(seen).collect();
        let path = &d.needle.path;
        let along = |k: i32| path.start + (path.entry - path.start) * (f64::from(k) / 20.0);
        drawn.needle = (0..=20).filter_map(|k| seen(&along(k))).collect();
    }
    Ok(Some(cut(image, drawn)))
}

/// The part of the image around all that is drawn, 1.4 times the region's width to each side.
fn cut(image: &Image<u8>, mut drawn: Picture) -> Picture {
    let extent = |points: &[[f64; 2]], k: usize| {
        points
            .iter()
            .fold((drawn.entry[k], drawn.entry[k]), |(lo, hi), p| {
                (lo.min(p[k]), hi.max(p[k]))
            })
    };
    // Where no angle is given, all of it: the surface that was measured may lie elsewhere.
    let whole = !drawn.points.is_empty();
    let limits = |k: usize, size: usize| {
        if whole {
            return (0, size);
        }
        let region = extent(&drawn.region, k);
        // Without a region, a good part of the image.
        let margin = 1.4 * (region.1 - region.0).max(size as f64 / 8.0);
        let needle = extent(&drawn.needle, k);
        let lo = (region.0.min(needle.0.max(region.0 - margin)) - margin).max(0.0) as usize;
        let hi = (region.1.max(needle.1.min(region.1 + margin)) + margin).max(0.0) as usize;
        (lo.min(size), hi.min(size))
    };
    let (u, v) = (limits(0, image.width()), limits(1, image.height()));
    drawn.image = Gray {
        width: u.1 - u.0,
        height: v.1 - v.0,
        pixels: (v.0..v.1)
            .flat_map(|row| image.row(row).get(u.0..u.1).unwrap_or_default())
            .copied()
            .collect(),
    };
    let shift = |p: &mut [f64; 2]| {
        p[0] -= u.0 as f64;
        p[1] -= v.0 as f64;
    };
    shift(&mut drawn.entry);
    drawn.vein.iter_mut().for_each(shift);
    drawn.region.iter_mut().for_each(shift);
    drawn.needle.iter_mut().for_each(shift);
    let (width, height) = (drawn.image.width as f64, drawn.image.height as f64);
    drawn.points.iter_mut().for_each(shift);
    let inside = |p: &[f64; 2]| (0.0..width).contains(&p[0]) && (0.0..height).contains(&p[1]);
    drawn.points.retain(inside);
    drawn
}

/// The whole stripe of one scan frame, the middle one if not given. No calibration is at hand to say
/// which way it runs: the way along which more of it is found.
///
/// # Errors
/// An image that can't be read.
pub fn stripe_sample(
    session: &Session,
    frame: Option<usize>,
) -> Result<Option<StripeSample>, SessionError> {
    let Some(scan) = &session.manifest.scan else {
        return Err(session.missing("scan", "record the hand with `cannula scan`"));
    };
    let Some(frame) = scan.frames.get(frame.unwrap_or(scan.frames.len() / 2)) else {
        return Ok(None);
    };
    let ambient = ambient(session, &Times::default())?;
    let image = read(session, &frame.image)?;
    let along = |axis| (axis, centres(&image, ambient.as_ref(), axis));
    let (columns, rows) = (along(Axis::Columns), along(Axis::Rows));
    let found = match rows.1.len() > columns.1.len() {
        true => rows,
        false => columns,
    };
    Ok(whole(frame.slide_mm, &frame.image, &image, found))
}

/// The same stripe at the scale of its pixels, around its middle.
pub fn stripe_middle(
    session: &Session,
    whole: &StripeSample,
) -> Result<StripeSample, SessionError> {
    let image = read(session, &whole.name)?;
    let at = whole.centres.get(whole.centres.len() / 2);
    let at = at.map_or([0.0; 2], |c| [c[0], c[1]]);
    let piece = piece(
        whole.slide_mm,
        &whole.name,
        &image,
        (whole.axis, whole.centres.clone()),
        at,
    );
    Ok(piece.unwrap_or_default())
}

/// The stripe's axis and its centres.
type Found = (Axis, Vec<[f64; 4]>);

/// The part of the frame around the whole stripe, shown smaller where it is large.
fn whole(
    slide_mm: f64,
    name: &str,
    image: &Image<u8>,
    (axis, centres): Found,
) -> Option<StripeSample> {
    const MARGIN: f64 = 12.0;
    const WIDEST: usize = 220;
    let range = |k: usize, size: usize| {
        let places = centres.iter().map(|c| c[k]);
        let (lo, hi) = places.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        let from = (lo - MARGIN).max(0.0) as usize;
        (from.min(size), ((hi + MARGIN) as usize + 1).min(size))
    };
    if centres.is_empty() {
        return None;
    }
    let (u, v) = (range(0, image.width()), range(1, image.height()));
    let step = (u.1 - u.0).max(v.1 - v.0).div_ceil(WIDEST).max(1);
    // The brightest of a block: a stripe two pixels wide must not vanish.
    let block = |row: usize, column: usize| {
        let rows = row..(row + step).min(v.1);
        let columns = column..(column + step).min(u.1);
        let in_row = |r: usize| image.row(r).get(columns.clone()).unwrap_or_default().iter();
        rows.flat_map(in_row).copied().max().unwrap_or(0)
    };
    let rows: Vec<usize> = (v.0..v.1).step_by(step).collect();
    let columns: Vec<usize> = (u.0..u.1).step_by(step).collect();
    let pixels = rows
        .iter()
        .flat_map(|&r| columns.iter().map(move |&c| (r, c)));
    Some(StripeSample {
        name: name.to_owned(),
        slide_mm,
        axis,
        image: Gray {
            width: columns.len(),
            height: rows.len(),
            pixels: pixels.map(|(r, c)| block(r, c)).collect(),
        },
        origin: [u.0 as f64, v.0 as f64],
        side: step as f64,
        centres,
    })
}

/// Centres on the hand: u, v, σ, quality. A frame without a stripe has none.
fn centres(image: &Image<u8>, ambient: Option<&Image<u8>>, axis: Axis) -> Vec<[f64; 4]> {
    let settings = HandSettings {
        axis,
        ..HandSettings::default()
    };
    hand::extract(image, ambient, &settings)
        .unwrap_or_default()
        .iter()
        .filter(|s| s.surface == Surface::Hand)
        .flat_map(|s| &s.points)
        .map(|p| {
            [
                p.pixel.x,
                p.pixel.y,
                p.variance.sqrt(),
                f64::from(p.quality),
            ]
        })
        .collect()
}

/// Pieces of three frames beside the entry: the frame nearest to it (the middle one where nothing was
/// measured) and one to either side; the stripe is searched along `axis`.
pub fn stripes(
    session: &Session,
    ambient: Option<&Image<u8>>,
    measured: Option<&Measurement>,
    axis: Axis,
    times: &Times,
) -> Result<Vec<StripeSample>, SessionError> {
    let (Some(scan), Some(entry)) = (&session.manifest.scan, &session.manifest.entry) else {
        return Ok(Vec::new());
    };
    let nearest = measured
        .and_then(|m| {
            m.cloud.iter().min_by(|p, q| {
                let far = |c: &crate::cloud::CloudPoint| (c.position - m.decision.entry).norm();
                far(p).total_cmp(&far(q))
            })
        })
        .map_or(scan.frames.len() / 2, |p| p.frame as usize);
    let mut picked = vec![nearest.saturating_sub(5), nearest, nearest + 5];
    picked.retain(|&i| i < scan.frames.len());
    picked.dedup();
    let samples = picked.par_iter().map(|&i| {
        let Some(frame) = scan.frames.get(i) else {
            return Ok(None);
        };
        let image = times.time(Stage::Read, || read(session, &frame.image))?;
        let found = (axis, centres(&image, ambient, axis));
        let (at, name) = (frame.slide_mm, &frame.image);
        Ok(piece(at, name, &image, found, entry.pixel))
    });
    let samples: Vec<Option<StripeSample>> = samples.collect::<Result<_, SessionError>>()?;
    Ok(samples.into_iter().flatten().collect())
}

/// The piece around the stripe's point nearest to `at`.
fn piece(
    slide_mm: f64,
    name: &str,
    image: &Image<u8>,
    (axis, centres): Found,
    at: [f64; 2],
) -> Option<StripeSample> {
    let far = |c: &[f64; 4]| (c[0] - at[0]).hypot(c[1] - at[1]);
    let near = *centres.iter().min_by(|a, b| far(a).total_cmp(&far(b)))?;
    let span = |middle: f64, size: usize, length: usize| {
        let from = (middle - length as f64 / 2.0).max(0.0) as usize;
        let from = from.min(size.saturating_sub(length));
        (from, (from + length).min(size))
    };
    let (left, right) = span(near[0], image.width(), PIECE.0);
    let (top, bottom) = span(near[1], image.height(), PIECE.1);
    let pixels = (top..bottom)
        .flat_map(|v| image.row(v).get(left..right).unwrap_or_default())
        .copied()
        .collect();
    Some(StripeSample {
        name: name.to_owned(),
        slide_mm,
        axis,
        image: Gray {
            width: right.saturating_sub(left),
            height: bottom.saturating_sub(top),
            pixels,
        },
        origin: [left as f64, top as f64],
        side: 1.0,
        centres,
    })
}
