//! The pictures: the hand with what was decided drawn on it, and pieces of frames with their
//! centres.

use crate::geometry::{Camera, Point3, tangent_basis};
use crate::image::Image;
use crate::pipeline::Measurement;
use crate::report::model::{Gray, Picture, StripeSample};
use crate::session::{Session, SessionError};
use crate::stripe::hand::{self, HandSettings, Surface};

/// Columns of a stripe's piece.
const PIECE: usize = 160;

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

/// The hand (ambient image, or the middle frame), with entry, vein, region and needle.
pub fn picture(
    session: &Session,
    m: &Measurement,
    camera: &Camera,
) -> Result<Option<Picture>, SessionError> {
    let Some(scan) = &session.manifest.scan else {
        return Ok(None);
    };
    let middle = scan.frames.get(scan.frames.len() / 2).map(|f| &f.image);
    let Some(name) = scan.ambient.as_ref().or(middle) else {
        return Ok(None);
    };
    let image = read(session, name)?;
    let d = &m.decision;
    let basis = tangent_basis(&d.plane.normal);
    let seen = |p: &Point3| camera.project(p).map(|u| [u.x, u.y]);
    let circle = (0..72).filter_map(|k| {
        let (sin, cos) = (f64::from(k) * 5.0).to_radians().sin_cos();
        let r = m.request.radius_mm;
        seen(&(d.entry + basis.column(0) * (r * cos) + basis.column(1) * (r * sin)))
    });
    let path = &d.needle.path;
    let needle = (0..=20)
        .filter_map(|k| seen(&(path.start + (path.entry - path.start) * (f64::from(k) / 20.0))));
    Ok(Some(cut(
        &image,
        Picture {
            image: Gray::default(),
            entry: [m.request.pixel.x, m.request.pixel.y],
            vein: m.request.vein.iter().map(|p| [p.x, p.y]).collect(),
            region: circle.collect(),
            needle: needle.collect(),
        },
    )))
}

/// The part of the image around all that is drawn, twice the region's width to each side.
fn cut(image: &Image<u8>, mut drawn: Picture) -> Picture {
    let extent = |points: &[[f64; 2]], k: usize| {
        points
            .iter()
            .fold((drawn.entry[k], drawn.entry[k]), |(lo, hi), p| {
                (lo.min(p[k]), hi.max(p[k]))
            })
    };
    let limits = |k: usize, size: usize| {
        let region = extent(&drawn.region, k);
        let margin = 2.0 * (region.1 - region.0).max(20.0);
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
    drawn
}

/// The whole stripe of one scan frame, the middle one if not given.
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
    let ambient = scan
        .ambient
        .as_ref()
        .map(|name| read(session, name))
        .transpose()?;
    let image = read(session, &frame.image)?;
    let centres = centres(&image, ambient.as_ref());
    Ok((!centres.is_empty()).then(|| StripeSample {
        name: frame.image.clone(),
        slide_mm: frame.slide_mm,
        centres,
        ..StripeSample::default()
    }))
}

/// Centres on the hand: u, v, σ, quality. A frame without a stripe has none.
fn centres(image: &Image<u8>, ambient: Option<&Image<u8>>) -> Vec<[f64; 4]> {
    hand::extract(image, ambient, &HandSettings::default())
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

/// Pieces of the frames nearest to the entry, a quarter and three quarters of the scan.
pub fn stripes(session: &Session, m: &Measurement) -> Result<Vec<StripeSample>, SessionError> {
    let Some(scan) = &session.manifest.scan else {
        return Ok(Vec::new());
    };
    let ambient = scan
        .ambient
        .as_ref()
        .map(|name| read(session, name))
        .transpose()?;
    let nearest = m
        .cloud
        .iter()
        .min_by(|p, q| {
            let far = |c: &crate::cloud::CloudPoint| (c.position - m.decision.entry).norm();
            far(p).total_cmp(&far(q))
        })
        .map_or(scan.frames.len() / 2, |p| p.frame as usize);
    let mut picked = vec![nearest.saturating_sub(5), nearest, nearest + 5];
    picked.retain(|&i| i < scan.frames.len());
    picked.dedup();
    let mut samples = Vec::new();
    for frame in picked.into_iter().filter_map(|i| scan.frames.get(i)) {
        let image = read(session, &frame.image)?;
        let centres = centres(&image, ambient.as_ref());
        samples.extend(piece(
            frame.slide_mm,
            &frame.image,
            &image,
            &centres,
            m.request.pixel.x,
        ));
    }
    Ok(samples)
}

/// The piece around column u.
fn piece(
    slide_mm: f64,
    name: &str,
    image: &Image<u8>,
    centres: &[[f64; 4]],
    u: f64,
) -> Option<StripeSample> {
    let left = (u - PIECE as f64 / 2.0).max(0.0) as usize;
    let right = (left + PIECE).min(image.width());
    let inside: Vec<[f64; 4]> = centres
        .iter()
        .copied()
        .filter(|c| (left as f64..right as f64).contains(&c[0]))
        .collect();
    let rows =
        |pick: fn(f64, f64) -> f64, start: f64| inside.iter().fold(start, |m, c| pick(m, c[1]));
    let (top, bottom) = (
        rows(f64::min, f64::INFINITY),
        rows(f64::max, f64::NEG_INFINITY),
    );
    if !(top.is_finite() && bottom.is_finite()) {
        return None;
    }
    let top = (top - 15.0).max(0.0) as usize;
    let bottom = ((bottom + 16.0).max(0.0) as usize).min(image.height());
    let pixels = (top..bottom)
        .flat_map(|v| image.row(v).get(left..right).unwrap_or_default())
        .copied()
        .collect();
    Some(StripeSample {
        name: name.to_owned(),
        slide_mm,
        image: Gray {
            width: right.saturating_sub(left),
            height: bottom.saturating_sub(top),
            pixels,
        },
        origin: [left as f64, top as f64],
        centres: inside,
    })
}
