//! Images of the board to corners and stripes.

use super::error::PipelineError;
use super::times::{Stage, Times};
use super::{Method, calibration::Settings};
use crate::board::{self, BoardGeometry, Corner, Detection, Stack, Summable};
use crate::calibration::light::{BoardStripe, LightView};
use crate::geometry::Vector2;
use crate::image::{Image, Pixel};
use crate::progress::Progress;
use crate::session::{LightPose, Session};
use crate::stripe::paper::board as paper;
use crate::stripe::{self, StripeError, StripePoint};
use rayon::prelude::*;
use std::sync::Mutex;

/// A board image that gave corners, or why not.
pub(super) struct Seen {
    /// Its name in session.json.
    pub name: String,
    /// The board.
    pub board: Result<Detection, board::NotFound>,
}

/// A light pose: its board and the stripes on it.
pub(super) struct Swept {
    /// The board, from the image without the laser or from all with it.
    pub seen: Seen,
    /// The stripes, in the order of session.json; empty without a board.
    pub stripes: Vec<Stripe<String>>,
}

/// An image with the laser: its name, the slide's position, its stripe or why it has none.
type Stripe<E> = (String, f64, Result<Vec<StripePoint>, E>);

/// Why an image with the laser is no use.
enum Unusable {
    /// Its stripe seems to be in the image without the laser.
    Swapped,
    /// In words.
    For(String),
}

/// What all images of the board are worked on with.
pub(super) struct Looker<'a> {
    pub session: &'a Session,
    pub board: BoardGeometry,
    pub method: Method,
    pub times: &'a Times,
    pub progress: &'a dyn Progress,
    pub settings: &'a Settings,
}

impl Looker<'_> {
    fn detect<P: Pixel>(&self, image: &Image<P>) -> Result<Detection, board::NotFound> {
        self.times.time(Stage::Corners, || {
            let mut found = board::detect(image, &self.board)?;
            if self.method == Method::Paper {
                // OpenCV's corners, as the paper has them.
                for corner in &mut found.corners {
                    corner.pixel = board::subpixel::refine(image, corner.pixel);
                }
            }
            Ok(found)
        })
    }

    /// One pose of `camera`.
    pub fn camera<P: Pixel>(&self, name: &str) -> Result<Seen, PipelineError> {
        let image = self
            .times
            .time(Stage::Read, || self.session.luma::<P>(name))?;
        let board = self.detect(&image);
        self.progress.step();
        Ok(Seen {
            name: name.to_owned(),
            board,
        })
    }

    /// One pose of `light`, its `on` images in parallel.
    pub fn light<P: Summable>(&self, pose: &LightPose) -> Result<Swept, PipelineError> {
        match &pose.off {
            Some(off) => self.with_off::<P>(pose, off),
            None => self.without_off::<P>(pose),
        }
    }

    fn with_off<P: Summable>(&self, pose: &LightPose, off: &str) -> Result<Swept, PipelineError> {
        let (luma, laser) = self
            .times
            .time(Stage::Read, || self.session.both::<P>(off))?;
        let mut seen = Seen {
            name: off.to_owned(),
            board: self.detect(&luma),
        };
        self.progress.step();
        let background = laser.as_ref().unwrap_or(&luma);
        let (stripes, stack) = match &seen.board {
            Err(_) => {
                pose.on.iter().for_each(|_| self.progress.step());
                (Vec::new(), None)
            }
            Ok(found) => {
                let corners = pixels(&found.corners);
                // A colour's own image has the stripe; only where it is the grey one too does it
                // show the corners as all other views do.
                let stack = (laser.is_none() && self.method == Method::Ml)
                    .then(|| Mutex::new(Stack::new(background, found)));
                let behind = self.behind(Some(background), corners);
                let last = pose.on.len().saturating_sub(1);
                let stripes = pose
                    .on
                    .par_iter()
                    .enumerate()
                    .map(|(i, frame)| {
                        let on = self
                            .times
                            .time(Stage::Read, || self.session.laser::<P>(&frame.image))?;
                        let points = self.stripe(&on, &behind, &frame.image)?;
                        // A stripe in the image without the laser is beside one of these two.
                        if i == 0 || i == last {
                            let pair = || stripe::pair::check(&on, background);
                            self.times
                                .time(Stage::BoardStripe, pair)
                                .map_err(|source| self.wrong(off, source))?;
                        }
                        if let (Some(stack), Ok(points)) = (&stack, &points) {
                            self.times.time(Stage::Corners, || pile(stack, &on, points));
                        }
                        self.progress.step();
                        Ok((frame.image.clone(), frame.slide_mm, points))
                    })
                    .collect::<Result<Vec<Stripe<Unusable>>, PipelineError>>()?;
                (self.told(off, stripes)?, stack)
            }
        };
        let stack = stack.and_then(|stack| stack.into_inner().ok());
        if let (Some(stack), Ok(found)) = (stack, &mut seen.board) {
            let again = self
                .times
                .time(Stage::Corners, || stack.measure(found, &self.board));
            match again {
                Ok(again) => *found = again,
                Err(moved @ board::NotFound::Moved { .. }) => {
                    seen.board = Err(moved);
                    return Ok(Swept {
                        seen,
                        stripes: Vec::new(),
                    });
                }
                // The first measurement stands where the mean does not show the board.
                Err(_) => {}
            }
        }
        Ok(Swept { seen, stripes })
    }

    /// Corners and stripe both from the images with the laser.
    fn without_off<P: Pixel>(&self, pose: &LightPose) -> Result<Swept, PipelineError> {
        let looked: Vec<_> = pose
            .on
            .par_iter()
            .map(|frame| {
                let (luma, laser) = self
                    .times
                    .time(Stage::Read, || self.session.both::<P>(&frame.image))?;
                let board = self.detect(&luma);
                let stripe = match &board {
                    Ok(found) => {
                        let on = laser.as_ref().unwrap_or(&luma);
                        let behind = self.behind(None, pixels(&found.corners));
                        let found = self.stripe(on, &behind, &frame.image)?;
                        found.map_err(Unusable::words)
                    }
                    Err(reason) => Err(reason.to_string()),
                };
                self.progress.step();
                Ok((board, stripe))
            })
            .collect::<Result<_, PipelineError>>()?;
        let mut found: Vec<Detection> = Vec::new();
        let mut failure = None;
        let mut stripes = Vec::new();
        for (frame, (board, stripe)) in pose.on.iter().zip(looked) {
            match board {
                Ok(mut detection) => {
                    if let Some(first) = found.first() {
                        board::align(&mut detection, first);
                    }
                    found.push(detection);
                }
                Err(reason) => failure = failure.or(Some(reason)),
            }
            stripes.push((frame.image.clone(), frame.slide_mm, stripe));
        }
        let name = pose
            .on
            .first()
            .map_or_else(String::new, |f| f.image.clone());
        let board = match merged(found) {
            Some(board) => Ok(board),
            None => Err(failure.unwrap_or(board::NotFound::NoCorners { seen: 0 })),
        };
        Ok(Swept {
            seen: Seen { name, board },
            stripes,
        })
    }

    fn behind<'i, P: Pixel>(
        &self,
        off: Option<&'i Image<P>>,
        corners: Vec<Vector2>,
    ) -> Behind<'i, P> {
        match self.method {
            Method::Ml => Behind::Ml(off, corners),
            Method::Paper => self.times.time(Stage::BoardStripe, || {
                Behind::Paper(paper::Rectified::new(off, &corners, &self.board))
            }),
        }
    }

    /// Two images are swapped where most of the pose say so: the sensor's noise, in rows, looks like
    /// a stripe in one of a hundred.
    fn told(
        &self,
        off: &str,
        stripes: Vec<Stripe<Unusable>>,
    ) -> Result<Vec<Stripe<String>>, PipelineError> {
        let swapped = |s: &&Stripe<Unusable>| matches!(s.2, Err(Unusable::Swapped));
        let agree = stripes.iter().filter(swapped).count();
        if agree > 1 && 2 * agree > stripes.len() {
            return Err(self.wrong(off, StripeError::Swapped));
        }
        let words =
            |(name, at, found): Stripe<Unusable>| (name, at, found.map_err(Unusable::words));
        Ok(stripes.into_iter().map(words).collect())
    }

    fn wrong(&self, image: &str, source: StripeError) -> PipelineError {
        PipelineError::Stripe {
            path: self.session.path(image),
            source,
        }
    }

    /// The stripe in one image. Outer error: the recording is wrong. Inner: this image is no use.
    fn stripe<P: Pixel>(
        &self,
        on: &Image<P>,
        behind: &Behind<P>,
        name: &str,
    ) -> Result<Result<Vec<StripePoint>, Unusable>, PipelineError> {
        let (columns, rows) = (self.board.columns, self.board.rows);
        self.times.time(Stage::BoardStripe, || match behind {
            Behind::Ml(off, corners) => {
                match stripe::board::extract(on, *off, corners, columns, rows) {
                    Err(source @ StripeError::Size { .. }) => Err(self.wrong(name, source)),
                    Err(StripeError::Swapped) => Ok(Err(Unusable::Swapped)),
                    found => Ok(found.map_err(|e| Unusable::For(e.to_string()))),
                }
            }
            Behind::Paper(rectified) => {
                let settings = &self.settings.paper_board;
                let found = rectified
                    .as_ref()
                    .map_err(Clone::clone)
                    .and_then(|rectified| paper::extract(on, rectified, settings));
                Ok(found.map_err(|e| Unusable::For(e.to_string())))
            }
        })
    }
}

impl Unusable {
    fn words(self) -> String {
        match self {
            Self::Swapped => {
                "no stripe, but something like one in the image without the laser (are the two swapped?)"
                    .to_owned()
            }
            Self::For(reason) => reason,
        }
    }
}

/// What the stripes of one pose stand out from.
enum Behind<'a, P> {
    /// The image without the laser, where there is one, and the board's corners.
    Ml(Option<&'a Image<P>>, Vec<Vector2>),
    /// The board rectified.
    Paper(Result<paper::Rectified, paper::Error>),
}

/// Widths of the stripe, and pixels, around its centre line that it may light.
const GLOW: f64 = 10.0;
const GLOW_PX: f64 = 4.0;

/// Adds an image to a pose's stack, all but its stripe.
fn pile<P: Summable>(stack: &Mutex<Stack<P>>, on: &Image<P>, points: &[StripePoint]) {
    let line: Vec<Vector2> = points.iter().map(|p| p.pixel).collect();
    let widest = points.iter().fold(0.0, |w: f32, p| w.max(p.width_px));
    if let Ok(mut stack) = stack.lock() {
        stack.add(on, &line, GLOW * f64::from(widest) + GLOW_PX);
    }
}

fn pixels(corners: &[Corner]) -> Vec<Vector2> {
    corners.iter().map(|c| c.pixel).collect()
}

/// One board from several images of one pose: the median of each corner, which a stripe over it in
/// one image does not move.
fn merged(found: Vec<Detection>) -> Option<Detection> {
    let mut first = found.first()?.clone();
    let n = found.len();
    for (i, corner) in first.corners.iter_mut().enumerate() {
        let median = |of: fn(&Vector2) -> f64| {
            let mut values: Vec<f64> = found.iter().map(|d| of(&d.corners[i].pixel)).collect();
            values.sort_by(f64::total_cmp);
            0.5 * (values[(n - 1) / 2] + values[n / 2])
        };
        corner.pixel = Vector2::new(median(|p| p.x), median(|p| p.y));
        let mean: crate::geometry::Matrix2 = found.iter().map(|d| d.corners[i].covariance).sum();
        // A median of n has π/2 times the variance of their mean.
        let factor = if n > 2 {
            std::f64::consts::FRAC_PI_2
        } else {
            1.0
        };
        corner.covariance = mean * (factor / (n * n) as f64);
    }
    Some(first)
}

/// What the light solve takes, from poses with a board.
pub(super) fn light_view(swept: &Swept) -> Option<LightView> {
    let board = swept.seen.board.as_ref().ok()?;
    Some(LightView {
        corners: board.corners.clone(),
        stripes: swept
            .stripes
            .iter()
            .filter_map(|(_, slide_mm, points)| {
                points.as_ref().ok().map(|points| BoardStripe {
                    slide_mm: *slide_mm,
                    points: points.clone(),
                })
            })
            .collect(),
    })
}
