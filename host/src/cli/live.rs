//! Reconstruction while frames arrive, for `scan` and `replay`: each frame is worked on as soon as
//! it is matched, so that the result stands right after the last one.

use super::Output;
use super::job::{Job, NeedleArgs};
use crate::calibration::RigModel;
use crate::checks::{Check, Limit};
use crate::image::{Image, Pixel};
use crate::output::{CalibrationFile, ResultFile, ScanProvenance};
use crate::pipeline::{
    FrameResult, Measurement, Method, PipelineError, Reconstruction, Times, exposed,
};
use crate::progress::Progress;
use crate::rig::acquisition::{Shot, Sweep};
use crate::rig::camera::Picture;
use crate::session::{Entry, Session};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A reconstruction of pictures of either depth.
///
/// A picture that can't be worked on is left out and named by [`Finished::conclude`], as one that was
/// lost: it must end neither the recording nor the result.
pub struct Live {
    rig: RigModel,
    times: Times,
    depth: Depth,
    begun: Instant,
    /// When the last frame was taken from the camera.
    last: Instant,
    /// What is wrong with pictures that were left out.
    left_out: Vec<anyhow::Error>,
}

enum Depth {
    Unknown,
    Eight(Frames<u8>),
    Sixteen(Frames<u16>),
}

impl Depth {
    /// Frames that were worked on.
    fn frames(&self) -> usize {
        match self {
            Self::Unknown => 0,
            Self::Eight(f) => f.results.len(),
            Self::Sixteen(f) => f.results.len(),
        }
    }
}

struct Frames<P: Pixel> {
    whole: Reconstruction<P>,
    /// Slide position and points of each frame, as they came.
    /// Index, position and points of each.
    results: Vec<(u32, f64, FrameResult)>,
}

impl<P: Pixel> Frames<P> {
    fn new(rig: &RigModel, ambient: Option<Image<P>>) -> Self {
        Self {
            whole: Reconstruction::new(rig.clone(), Method::Ml, ambient),
            results: Vec::new(),
        }
    }

    fn push(&mut self, shot: &Shot, image: &Image<P>, times: &Times) -> Result<(), PipelineError> {
        let path = || PathBuf::from(format!("frame {}", shot.index));
        exposed(image, path)?;
        let result = self.whole.frame(shot.index, shot.slide_mm, image, times);
        let result = result.map_err(|source| PipelineError::Stripe {
            path: path(),
            source,
        })?;
        self.results.push((shot.index, shot.slide_mm, result));
        Ok(())
    }

    /// The frames that show no stripe at all though others before and after them do.
    fn without_stripe(&self) -> Vec<u32> {
        // Those that look swapped are named where all frames are in.
        let dark = |r: &FrameResult| r.hand.is_empty() && r.background.is_empty() && !r.swapped;
        let lit = |index: u32| self.results.iter().any(|(i, _, r)| *i == index && !dark(r));
        let shown: Vec<u32> = self
            .results
            .iter()
            .map(|r| r.0)
            .filter(|i| lit(*i))
            .collect();
        let (Some(first), Some(last)) = (shown.iter().min(), shown.iter().max()) else {
            return Vec::new();
        };
        self.results
            .iter()
            .filter(|(i, _, r)| dark(r) && (first..=last).contains(&i))
            .map(|(i, ..)| *i)
            .collect()
    }

    /// Puts the frames in the order of travel: one that was shot again came last, and the surface
    /// is laid through neighbouring stripes.
    fn in_order(mut self) -> Reconstruction<P> {
        self.results.sort_by(|a, b| a.1.total_cmp(&b.1));
        for ((_, _, mut result), frame) in self.results.into_iter().zip(0..) {
            for point in result.hand.iter_mut().chain(&mut result.background) {
                point.frame = frame;
            }
            self.whole.add(result);
        }
        self.whole
    }
}

/// What a live reconstruction has come to.
pub struct Finished {
    /// The hand and the needle.
    pub measured: Measurement,
    /// How long after the last frame they stood.
    pub after: Duration,
    times: Times,
    begun: Instant,
}

impl Live {
    /// For a calibrated rig.
    pub fn new(rig: RigModel) -> Self {
        let now = Instant::now();
        Self {
            rig,
            times: Times::default(),
            depth: Depth::Unknown,
            begun: now,
            last: now,
            left_out: Vec::new(),
        }
    }

    /// The scene without laser, before the first frame.
    pub fn ambient(&mut self, picture: &Picture) {
        self.depth = match picture {
            Picture::Eight(i) => Depth::Eight(Frames::new(&self.rig, Some(i.clone()))),
            Picture::Sixteen(i) => Depth::Sixteen(Frames::new(&self.rig, Some(i.clone()))),
        };
    }

    /// The next frame.
    pub fn push(&mut self, shot: &Shot) {
        self.last = shot.arrived;
        if matches!(self.depth, Depth::Unknown) {
            self.depth = match &shot.picture {
                Picture::Eight(_) => Depth::Eight(Frames::new(&self.rig, None)),
                Picture::Sixteen(_) => Depth::Sixteen(Frames::new(&self.rig, None)),
            };
        }
        let done = match (&mut self.depth, &shot.picture) {
            (Depth::Eight(f), Picture::Eight(i)) => f.push(shot, i, &self.times),
            (Depth::Sixteen(f), Picture::Sixteen(i)) => f.push(shot, i, &self.times),
            _ => {
                self.left_out.push(anyhow::anyhow!(
                    "frame {}: the camera has changed its depth in the middle of a scan",
                    shot.index
                ));
                return;
            }
        };
        self.left_out.extend(done.err().map(anyhow::Error::from));
    }

    /// Plane, entry and needle, once the last frame is in.
    /// `file` is what an error names, `weak` are the checks of scan and calibration so far.
    pub fn decide(
        mut self,
        file: &Path,
        entry: &Entry,
        needle: &NeedleArgs,
        mut weak: Vec<Check>,
    ) -> anyhow::Result<Finished> {
        // Nothing is left: the first says why.
        if self.depth.frames() == 0 && !self.left_out.is_empty() {
            return Err(self.left_out.swap_remove(0));
        }
        let (last, begun) = (self.last, self.begun);
        let dark = match &self.depth {
            Depth::Eight(f) => f.without_stripe(),
            Depth::Sixteen(f) => f.without_stripe(),
            Depth::Unknown => Vec::new(),
        };
        let dark = dark.iter().map(|i| {
            format!("frame {i}: the laser's stripe is nowhere in it (is something in the way?): left out")
        });
        let unusable = self.left_out.iter().map(|e| format!("{e:#}: left out"));
        let left_out: Vec<String> = unusable.chain(dark).collect();
        weak.push(Check::held(
            "scan: frames left out",
            left_out.len() as f64,
            Limit::AtMost(0.0),
            "",
        ));
        weak.extend(left_out.iter().map(|w| Check::caution("scan: frame", w)));
        let times = &self.times;
        let measured = match self.depth {
            Depth::Eight(f) => decide(f.in_order(), file, entry, needle, weak, times),
            Depth::Sixteen(f) => decide(f.in_order(), file, entry, needle, weak, times),
            Depth::Unknown => anyhow::bail!("no frame arrived"),
        }?;
        Ok(Finished {
            measured,
            after: last.elapsed(),
            times: self.times,
            begun,
        })
    }
}

fn decide<P: Pixel>(
    whole: Reconstruction<P>,
    file: &Path,
    entry: &Entry,
    needle: &NeedleArgs,
    weak: Vec<Check>,
    times: &Times,
) -> anyhow::Result<Measurement> {
    let settings = needle.settings().0;
    Ok(whole.finish(file, entry.into(), &settings, weak, times)?)
}

impl Finished {
    /// Adds the calibration's checks and the angle's, and says what is weak; then writes cloud, result
    /// and report where there is a folder for them.
    #[allow(clippy::too_many_arguments)]
    pub fn conclude(
        &mut self,
        folder: Option<&Path>,
        session: &Session,
        calibration: &CalibrationFile,
        needle: &NeedleArgs,
        provenance: ScanProvenance,
        out: &Output,
    ) -> anyhow::Result<Option<ResultFile>> {
        let job = Job {
            session,
            calibration,
            method: Method::Ml,
            args: needle,
            folder: folder.unwrap_or(Path::new("")),
            provenance,
            times: &self.times,
            begun: self.begun,
            out,
        };
        job.weigh(&mut self.measured).map_err(|e| match folder {
            Some(_) => job.refused(e),
            None => e,
        })?;
        if folder.is_none() {
            return Ok(None);
        }
        let result = job.write(&self.measured)?;
        job.report(&self.measured, Vec::new())?;
        Ok(Some(result))
    }
}

/// Writes what there is of a live scan that gave no angle; gives the error back.
pub fn refused(
    error: anyhow::Error,
    folder: &Path,
    session: &Session,
    calibration: &CalibrationFile,
    needle: &NeedleArgs,
    provenance: ScanProvenance,
    out: &Output,
) -> anyhow::Error {
    let job = Job {
        session,
        calibration,
        method: Method::Ml,
        args: needle,
        folder,
        provenance,
        times: &Times::default(),
        begun: Instant::now(),
        out,
    };
    job.refused(error)
}

/// Says what went wrong in a sweep, if anything did.
pub fn complain(sweep: &Sweep, waited: Duration, out: &Output) {
    for line in sweep.complaints() {
        out.warn(&line);
    }
    if waited.as_millis() > 0 {
        out.warn(&format!(
            "the disk kept the camera waiting for {:.2} s; frames that were lost are named above",
            waited.as_secs_f64()
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::calibrate;
    use crate::progress::Silent;
    use crate::rig::folder;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        needle: NeedleArgs,
    }

    /// The committed recording's scan, its frames changed by `change` (which may leave one out).
    struct Played {
        session: Session,
        rig: RigModel,
        needle: NeedleArgs,
    }

    impl Played {
        fn new() -> Self {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tiny-1001");
            let session = Session::open(&path).unwrap();
            let calibrated = calibrate(&session, Method::Ml, &Times::default(), &Silent).unwrap();
            Self {
                rig: calibrated.rig().unwrap(),
                session,
                needle: Line::parse_from(["needle"]).needle,
            }
        }

        fn frames(&self) -> usize {
            self.session.manifest.scan.as_ref().unwrap().frames.len()
        }

        fn measure(
            &self,
            order: &[usize],
            change: impl Fn(usize, Picture) -> Picture,
        ) -> anyhow::Result<Finished> {
            let scan = self.session.manifest.scan.as_ref().unwrap();
            let mut live = Live::new(self.rig.clone());
            let read = |name: &String| folder::read(&self.session.path(name)).unwrap();
            live.ambient(&read(scan.ambient.as_ref().unwrap()));
            for &i in order {
                let frame = &scan.frames[i];
                live.push(&Shot {
                    index: i as u32,
                    steps: 0,
                    slide_mm: frame.slide_mm,
                    trigger_us: 0,
                    laser: true,
                    picture: change(i, read(&frame.image)),
                    arrived: Instant::now(),
                });
            }
            let entry = self.session.manifest.entry.as_ref().unwrap();
            live.decide(self.session.file(), entry, &self.needle, Vec::new())
        }
    }

    /// What is said of frames that were left out.
    fn left_out(finished: &Finished) -> Vec<&str> {
        let checks = finished.measured.checks.iter();
        checks
            .filter(|c| c.what == "scan: frame")
            .map(|c| c.words.as_str())
            .collect()
    }

    /// A position that was shot again comes last; cloud and needle must not know.
    #[test]
    fn frames_that_come_out_of_order_give_the_same_needle() {
        let played = Played::new();
        let measure = |order: &[usize]| played.measure(order, |_, p| p).unwrap().measured;
        let straight: Vec<usize> = (0..played.frames()).collect();
        let middle = straight.len() / 2;
        let mut again = straight.clone();
        again.retain(|i| ![middle, middle + 3].contains(i));
        again.extend([middle, middle + 3]);
        let (a, b) = (measure(&straight), measure(&again));
        assert_eq!(a.cloud, b.cloud);
        assert_eq!(a.counts, b.counts);
        assert_eq!(a.decision.entry, b.decision.entry);
        assert_eq!(a.decision.plane.normal, b.decision.plane.normal);
        assert_eq!(a.decision.needle.axis, b.decision.needle.axis);
    }

    /// Black, overexposed, of another size, of another depth: each is named and left out, and what
    /// comes out is what comes out without them.
    #[test]
    fn pictures_that_cannot_be_worked_on_are_named_and_left_out() {
        let played = Played::new();
        let all: Vec<usize> = (0..played.frames()).collect();
        let bad = [3, 9, 14, 20];
        let spoiled = played
            .measure(&all, |i, picture| {
                let (w, h) = picture.size();
                match i {
                    3 => Picture::Eight(Image::new(w, h, 0)),
                    9 => Picture::Eight(Image::new(w, h, 255)),
                    14 => Picture::Eight(Image::new(w / 2, h, 7)),
                    20 => Picture::Sixteen(Image::new(w, h, 7)),
                    _ => picture,
                }
            })
            .unwrap();
        assert_eq!(left_out(&spoiled).len(), 4, "{:?}", left_out(&spoiled));
        for (words, i) in left_out(&spoiled).into_iter().zip(bad) {
            assert!(
                words.starts_with(&format!("frame {i}: ")) && words.ends_with(": left out"),
                "{words}"
            );
        }
        let rest: Vec<usize> = all.iter().copied().filter(|i| !bad.contains(i)).collect();
        let without = played.measure(&rest, |_, p| p).unwrap();
        assert!(left_out(&without).is_empty());
        assert_eq!(spoiled.measured.cloud, without.measured.cloud);
        assert_eq!(
            spoiled.measured.decision.needle.axis,
            without.measured.decision.needle.axis
        );

        // A picture in which the laser did not shine, too; at the scan's end that is no fault.
        let scan = played.session.manifest.scan.as_ref().unwrap();
        let ambient = folder::read(&played.session.path(scan.ambient.as_ref().unwrap())).unwrap();
        let last = played.frames() - 1;
        let dark = played
            .measure(&all, |i, picture| match i {
                12 => ambient.clone(),
                i if i == last => ambient.clone(),
                _ => picture,
            })
            .unwrap();
        let said = left_out(&dark);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("frame 12: the laser's stripe"));

        // Nothing but such pictures: the first one's sentence.
        let none = played.measure(&all, |_, picture| {
            let (w, h) = picture.size();
            Picture::Eight(Image::new(w, h, 0))
        });
        let said = none.err().unwrap().to_string();
        assert!(said.starts_with("frame 0: "), "{said}");
    }
}
