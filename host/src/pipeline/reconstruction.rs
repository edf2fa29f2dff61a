//! From the scan's frames and a calibration to cloud and needle. [`Reconstruction`] takes frames
//! one by one, so that a live scan and a recording go the same way.

use super::Method;
use super::error::PipelineError;
use super::sequence;
use super::times::{Stage, Times};
use crate::calibration::{RigModel, loss};
use crate::checks::{Check, Limit};
use crate::cloud::{CloudPoint, Lost, triangulate};
use crate::geometry::{Point3, Vector2};
use crate::image::{Image, Pixel};
use crate::needle::{self, Decision, EntryRequest, NeedleError, PlaneMethod};
use crate::progress::Progress;
use crate::session::{Depth, Entry, Frame, Session};
use crate::stripe::hand::{self, HandSettings, Surface};
use crate::stripe::{StripeError, StripePoint, pair, paper};
use rayon::prelude::*;
use std::path::Path;

/// The ambient image is compared with every so many frames.
const PAIRS: u32 = 8;

/// What one frame gave.
#[derive(Clone, Debug, Default)]
pub struct FrameResult {
    /// Where the slide stood, mm.
    pub slide_mm: f64,
    /// Points on the hand.
    pub hand: Vec<CloudPoint>,
    /// The same as they were measured, without smoothing along the stripe.
    pub measured: Vec<CloudPoint>,
    /// Points on the table behind it.
    pub background: Vec<CloudPoint>,
    /// Stripe points that gave no point in space.
    pub lost: Lost,
    /// It shows no stripe, and the ambient image something like one.
    pub swapped: bool,
}

/// A cloud that grows frame by frame.
#[derive(Clone, Debug)]
pub struct Reconstruction<P: Pixel> {
    rig: RigModel,
    method: Method,
    ambient: Option<Image<P>>,
    region: Option<paper::hand::Region>,
    settings: HandSettings,
    frames: u32,
    /// Frames that seem to be swapped with the ambient image.
    swapped: Vec<u32>,
    positions: Vec<f64>,
    /// Points on the hand, frame by frame.
    pub cloud: Vec<CloudPoint>,
    /// The same as they were measured, without smoothing along the stripe: the region's surface
    /// is fitted to these.
    measured: Vec<CloudPoint>,
    /// Points on the table behind it.
    pub background: Vec<CloudPoint>,
    /// Stripe points that gave no point in space.
    pub lost: Lost,
    /// Points on the hand a frame.
    pub counts: Vec<usize>,
}

impl<P: Pixel> Reconstruction<P> {
    /// For a rig; `ambient` is the scene without the laser.
    pub fn new(rig: RigModel, method: Method, ambient: Option<Image<P>>) -> Self {
        let region = match method {
            Method::Paper => ambient.as_ref().map(paper::hand::region),
            Method::Ml => None,
        };
        let settings = HandSettings {
            axis: rig.stripe_axis(),
            ..HandSettings::default()
        };
        Self {
            rig,
            method,
            ambient,
            region,
            settings,
            frames: 0,
            swapped: Vec::new(),
            positions: Vec::new(),
            cloud: Vec::new(),
            measured: Vec::new(),
            background: Vec::new(),
            lost: Lost::default(),
            counts: Vec::new(),
        }
    }

    /// Works on one frame without keeping its result: for callers that work on several at once.
    ///
    /// # Errors
    /// An image of another size, or an ambient image that is brighter.
    pub fn frame(
        &self,
        index: u32,
        slide_mm: f64,
        image: &Image<P>,
        times: &Times,
    ) -> Result<FrameResult, StripeError> {
        let mut result = match self.method {
            Method::Ml => self.ml(index, slide_mm, image, times)?,
            Method::Paper => self.paper(index, slide_mm, image, times),
        };
        if let (0, Some(ambient)) = (index % PAIRS, &self.ambient) {
            times.time(Stage::HandStripe, || pair::check(image, ambient))?;
        }
        result.slide_mm = slide_mm;
        Ok(result)
    }

    fn ml(
        &self,
        index: u32,
        slide_mm: f64,
        image: &Image<P>,
        times: &Times,
    ) -> Result<FrameResult, StripeError> {
        let found = times.time(Stage::HandStripe, || {
            hand::extract(image, self.ambient.as_ref(), &self.settings)
        });
        // The sensor's noise, in rows, can look so beside the hand: one frame tells nothing.
        if found == Err(StripeError::Swapped) {
            return Ok(FrameResult {
                swapped: true,
                ..FrameResult::default()
            });
        }
        let segments = found?;
        let mut result = FrameResult::default();
        times.time(Stage::Cloud, || {
            for segment in &segments {
                let onto = match segment.surface {
                    Surface::Hand => &mut result.hand,
                    Surface::Background => &mut result.background,
                };
                let lost = triangulate(
                    &segment.points,
                    segment.correlation,
                    index,
                    slide_mm,
                    &self.rig,
                    onto,
                );
                result.lost.no_ray += lost.no_ray;
                result.lost.no_meeting += lost.no_meeting;
                if segment.surface == Surface::Hand {
                    triangulate(
                        &segment.measured,
                        segment.grain,
                        index,
                        slide_mm,
                        &self.rig,
                        &mut result.measured,
                    );
                }
            }
        });
        Ok(result)
    }

    fn paper(&self, index: u32, slide_mm: f64, image: &Image<P>, times: &Times) -> FrameResult {
        let region = self.region.unwrap_or(paper::hand::Region {
            u: 0,
            v: 0,
            width: image.width() as u32,
            height: image.height() as u32,
        });
        let points: Vec<StripePoint> = times.time(Stage::HandStripe, || {
            let settings = paper::hand::Settings::default();
            paper::hand::extract(image, &region, self.settings.axis, &settings)
        });
        let mut result = FrameResult::default();
        times.time(Stage::Cloud, || {
            result.lost = triangulate(&points, 1.0, index, slide_mm, &self.rig, &mut result.hand);
            // Eq. 11.
            let pixels: Vec<Vector2> = result.hand.iter().map(|p| p.pixel).collect();
            let mut places: Vec<Point3> = result.hand.iter().map(|p| p.position).collect();
            let plane = self.rig.light.plane(slide_mm);
            let settings = loss::Settings::default();
            loss::minimise(
                &self.rig.camera,
                &pixels,
                &mut places,
                &plane,
                false,
                &settings,
            );
            for (point, place) in result.hand.iter_mut().zip(places) {
                point.position = place;
            }
        });
        result
    }

    /// Keeps a frame's result; frames come in the order of travel.
    pub fn add(&mut self, mut result: FrameResult) {
        if result.swapped {
            self.swapped.push(self.frames);
        }
        self.positions.push(result.slide_mm);
        self.counts.push(result.hand.len());
        self.cloud.append(&mut result.hand);
        self.measured.append(&mut result.measured);
        self.background.append(&mut result.background);
        self.lost.no_ray += result.lost.no_ray;
        self.lost.no_meeting += result.lost.no_meeting;
        self.frames += 1;
    }

    /// The next frame of a live scan; gives the number of points that it added.
    ///
    /// # Errors
    /// As of [`Reconstruction::frame`].
    pub fn push(
        &mut self,
        slide_mm: f64,
        image: &Image<P>,
        times: &Times,
    ) -> Result<usize, StripeError> {
        let result = self.frame(self.frames, slide_mm, image, times)?;
        let points = result.hand.len();
        self.add(result);
        Ok(points)
    }

    /// Plane, entry and needle from what has been scanned; the checks made on the way go to `checks`.
    ///
    /// # Errors
    /// Why no angle is given.
    pub fn decide(
        &self,
        request: &EntryRequest,
        settings: &needle::Settings,
        checks: &mut Vec<Check>,
    ) -> Result<Decision, NeedleError> {
        let mut settings = *settings;
        let mut cloud = &self.measured;
        if self.method == Method::Paper {
            settings.method = PlaneMethod::Paper;
            cloud = &self.cloud;
        }
        needle::decide_noting(cloud, &self.rig, request, &settings, checks)
    }

    /// The measurement, once all frames are in. `file` is what an error names, `checks` those made so
    /// far.
    ///
    /// # Errors
    /// [`PipelineError::Needle`]: why no angle is given, with what was scanned;
    /// [`PipelineError::Stripe`]: most frames show no stripe where the ambient image does.
    pub fn finish(
        self,
        file: &Path,
        request: EntryRequest,
        settings: &needle::Settings,
        mut checks: Vec<Check>,
        times: &Times,
    ) -> Result<Measurement, PipelineError> {
        if self.method == Method::Paper {
            checks.push(Check::caution(
                "method",
                "the paper’s way, to compare with: the stated σ leave out what its thinning and its plane of z-distances add (ten times as much and more)",
            ));
        }
        if 2 * self.swapped.len() > self.counts.len() {
            return Err(PipelineError::Stripe {
                path: file.to_owned(),
                source: StripeError::Swapped,
            });
        }
        let swapped = Check::held(
            "scan: frames that look swapped with the image without the laser",
            self.swapped.len() as f64,
            Limit::AtMost(0.0),
            "",
        );
        checks.push(swapped.or(|| {
            let names: Vec<String> = self.swapped.iter().map(u32::to_string).collect();
            let what = format!(
                "frames of the scan without a stripe, where the image without the laser shows something like one: {} (from 0)",
                names.join(", ")
            );
            (what, "they are left out".to_owned())
        }));
        let mut made = Vec::new();
        let decided = times.time(Stage::Needle, || {
            let sub_pixel = self.method == Method::Ml;
            let axis = self.settings.axis;
            let sequence = sequence::follow(&self.cloud, &self.positions, axis, sub_pixel);
            checks.extend(sequence.checks());
            if let Some(first) = sequence.breaks.first() {
                return Err(first.error());
            }
            self.decide(&request, settings, &mut made)
        });
        match decided {
            Ok(decision) => Ok(Measurement {
                cloud: self.cloud,
                background: self.background,
                counts: self.counts,
                request,
                decision: Decision {
                    checks: made,
                    ..decision
                },
                checks,
            }),
            Err(source) => Err(PipelineError::Needle {
                path: file.to_owned(),
                source,
                scanned: Box::new(Scanned {
                    cloud: self.cloud,
                    request,
                    checks: crate::checks::of("needle", made).chain(checks).collect(),
                }),
            }),
        }
    }
}

/// A measured hand and what is to be done on it.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Points on the hand.
    pub cloud: Vec<CloudPoint>,
    /// Points on the table behind it.
    pub background: Vec<CloudPoint>,
    /// Points on the hand a frame.
    pub counts: Vec<usize>,
    /// The request, from session.json.
    pub request: EntryRequest,
    /// The needle.
    pub decision: Decision,
    /// Checks that were made: of the scan, and once a result is decided on, all others too. The
    /// verdict is read off them.
    pub checks: Vec<Check>,
}

/// A scanned hand for which no needle angle is given.
#[derive(Clone, Debug)]
pub struct Scanned {
    /// Points on the hand.
    pub cloud: Vec<CloudPoint>,
    /// The request, from session.json.
    pub request: EntryRequest,
    /// Checks that were made of the scan.
    pub checks: Vec<Check>,
}

impl From<&Entry> for EntryRequest {
    fn from(entry: &Entry) -> Self {
        let pixel = |p: &[f64; 2]| Vector2::new(p[0], p[1]);
        Self {
            pixel: pixel(&entry.pixel),
            vein: entry.vein.iter().map(pixel).collect(),
            radius_mm: entry.radius_mm,
        }
    }
}

/// Measures the hand of a recording. `calibrated` are the slide positions at which the rig's light
/// planes were measured (empty if not known).
///
/// # Errors
/// What is wrong with the recording, or why no angle is given.
pub fn measure(
    session: &Session,
    rig: &RigModel,
    calibrated: &[f64],
    method: Method,
    settings: &needle::Settings,
    times: &Times,
    progress: &dyn Progress,
) -> Result<Measurement, PipelineError> {
    match session.depth {
        Depth::Eight => run::<u8>(session, rig, calibrated, method, settings, times, progress),
        Depth::Sixteen => run::<u16>(session, rig, calibrated, method, settings, times, progress),
    }
}

fn run<P: Pixel>(
    session: &Session,
    rig: &RigModel,
    calibrated: &[f64],
    method: Method,
    settings: &needle::Settings,
    times: &Times,
    progress: &dyn Progress,
) -> Result<Measurement, PipelineError> {
    let manifest = &session.manifest;
    let scan = manifest
        .scan
        .as_ref()
        .ok_or_else(|| session.missing("scan", "record the hand with `cannula scan`"))?;
    let entry = manifest.entry.as_ref().ok_or_else(|| {
        session.missing(
            "entry",
            "give entry pixel, vein and radius from the vein imaging",
        )
    })?;
    let size = (manifest.image.width, manifest.image.height);
    let positions: Vec<f64> = scan.frames.iter().map(|f| f.slide_mm).collect();
    let mut checks = belong_together(session.file(), size, rig, calibrated, &positions)?;
    checks.push(without_loss(&scan.frames));
    let read = |name: &String| {
        times
            .time(Stage::Read, || session.laser::<P>(name))
            .map_err(PipelineError::from)
    };
    let ambient = match (&scan.ambient, method) {
        (Some(name), _) => Some(read(name)?),
        // The paper's way seeks the hand in it.
        (None, Method::Paper) => darkest(scan.frames.iter().map(|f| &f.image), read)?,
        (None, Method::Ml) => None,
    };
    let mut whole = Reconstruction::new(rig.clone(), method, ambient);
    progress.start("scan frames", scan.frames.len());
    let results: Result<Vec<FrameResult>, PipelineError> = scan
        .frames
        .par_iter()
        .enumerate()
        .map(|(i, frame)| {
            let image = read(&frame.image)?;
            exposed(&image, || session.path(&frame.image))?;
            let result = whole
                .frame(i as u32, frame.slide_mm, &image, times)
                .map_err(|source| {
                    let name = match (&source, &scan.ambient) {
                        (StripeError::Lit { .. }, Some(ambient)) => ambient,
                        _ => &frame.image,
                    };
                    let path = session.path(name);
                    PipelineError::Stripe { path, source }
                });
            progress.step();
            result
        })
        .collect();
    progress.finish();
    results?.into_iter().for_each(|result| whole.add(result));
    let request = EntryRequest::from(entry);
    whole.finish(session.file(), request, settings, checks, times)
}

/// Whether no image is a JPEG: its blocks draw the stripe's centre along by as much for a whole stretch,
/// which no scatter shows.
pub fn without_loss(frames: &[Frame]) -> Check {
    let jpeg = frames
        .iter()
        .map(|f| Path::new(&f.image).extension().unwrap_or_default())
        .filter(|e| e.eq_ignore_ascii_case("jpg") || e.eq_ignore_ascii_case("jpeg"))
        .count();
    let what = "scan: images kept with loss (JPEG)";
    Check::held(what, jpeg as f64, Limit::AtMost(0.0), "").or(|| {
        (
            "the scan’s images are JPEG: what compression moves the stripe is not in any σ (strong compression moves the entry by several of them)".to_owned(),
            "record PNG".to_owned(),
        )
    })
}

/// The pixelwise minimum of a few frames from end to end: the scene without the stripe, where nobody
/// took it without the laser.
fn darkest<'a, P: Pixel>(
    names: impl ExactSizeIterator<Item = &'a String>,
    read: impl Fn(&String) -> Result<Image<P>, PipelineError>,
) -> Result<Option<Image<P>>, PipelineError> {
    const FRAMES: usize = 5;
    let every = names.len().div_ceil(FRAMES).max(1);
    let mut darkest: Option<Image<P>> = None;
    for name in names.step_by(every) {
        let image = read(name)?;
        match &mut darkest {
            Some(dark) => {
                let pixels = dark.pixels_mut().iter_mut().zip(image.pixels());
                pixels.for_each(|(dark, p)| *dark = (*dark).min(*p));
            }
            None => darkest = Some(image),
        }
    }
    Ok(darkest)
}

/// Refuses an image of one grey throughout, and one of which more than a third is saturated: no
/// stripe could be told in either.
pub(crate) fn exposed<P: Pixel>(
    image: &Image<P>,
    path: impl FnOnce() -> std::path::PathBuf,
) -> Result<(), PipelineError> {
    // Every 61st pixel, so that no column is favoured.
    let samples = image.pixels().iter().step_by(61);
    let of = samples.len().max(1);
    if let Some(first) = image.pixels().first()
        && samples.clone().all(|p| p == first)
    {
        return Err(PipelineError::Empty {
            path: path(),
            grey: (*first).into(),
        });
    }
    let saturated = samples.filter(|p| Into::<f32>::into(**p) >= P::MAX).count();
    if 3 * saturated <= of {
        return Ok(());
    }
    Err(PipelineError::Saturated {
        path: path(),
        percent: 100.0 * saturated as f64 / of as f64,
    })
}

/// A scan may run so far beyond the calibrated positions, as a part of their range, without a word:
/// the line D = a·x + b is no less known there.
const SLACK: f64 = 0.01;

/// Whether a scan of images of `size` at these slide `positions` can be worked on with a calibration;
/// the checks that were made of it, one that warns where it can but should not. `file` is what an
/// error names.
pub(crate) fn belong_together(
    file: &Path,
    size: (u32, u32),
    rig: &RigModel,
    calibrated: &[f64],
    positions: &[f64],
) -> Result<Vec<Check>, PipelineError> {
    let mismatch = |what: String, remedy| PipelineError::Mismatch {
        path: file.to_owned(),
        what,
        remedy,
    };
    let camera = &rig.camera;
    if size != (camera.width, camera.height) {
        return Err(mismatch(
            format!(
                "its images are {} × {} pixels, the calibration is for {} × {}",
                size.0, size.1, camera.width, camera.height
            ),
            "use a calibration of this camera at this image size",
        ));
    }
    if rig.light.a == 0.0 && positions.len() > 1 {
        return Err(mismatch(
            "the calibration knows the light plane at one slide position only, the scan has more"
                .to_owned(),
            "calibrate with the slide at several positions",
        ));
    }
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        })
    };
    let (low, high) = range(&mut calibrated.iter().copied());
    let (first, last) = range(&mut positions.iter().copied());
    let reach = high - low;
    // On the fly exposures lie a little after their triggers.
    let slack = 1e-6 + SLACK * reach;
    if calibrated.len() < 2 {
        return Ok(Vec::new());
    }
    // The position that lies farthest out.
    let farthest = match low - first > last - high {
        true => first,
        false => last,
    };
    let check = Check::held(
        "scan: slide position farthest from the calibrated ones",
        farthest,
        Limit::Between([low - slack, high + slack]),
        "mm",
    );
    if check.sound() {
        return Ok(vec![check]);
    }
    let what = format!(
        "the scan runs from {first} to {last} mm, the light planes were calibrated from {low} to {high} mm"
    );
    if first < low - 0.5 * reach || last > high + 0.5 * reach {
        return Err(mismatch(
            what,
            "calibrate over the range that is scanned, and give both in mm of the same slide",
        ));
    }
    let words = || (what, "depth beyond is extrapolated".to_owned());
    Ok(vec![check.or(words)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_kept_with_loss_is_said() {
        let frames = |names: &[&str]| -> Vec<Frame> {
            let named = |name: &&str| Frame {
                slide_mm: 0.0,
                image: (*name).to_owned(),
                slide_steps: None,
                trigger_us: None,
            };
            names.iter().map(named).collect()
        };
        let png = ["scan/000.png", "scan/001.PNG", "jpg/2.png"];
        assert!(without_loss(&frames(&png)).sound());
        for name in ["scan/3.jpg", "scan/3.JPEG"] {
            let check = without_loss(&frames(&[png[0], name, png[2]]));
            assert_eq!(check.value, Some(1.0));
            assert!(check.sentence().is_some_and(|s| s.contains("record PNG")));
        }
    }
}
