//! The stripe on the checkerboard, the paper's way (Section 2.2.1, steps 2–5; Figures 7–10):
//! rectify by the homography, take the grid squares whose on–off difference exceeds 30, binarise,
//! keep the largest contour if its smallest rectangle is slender, screen by slope, thin, slice off
//! the ends, fit a line, and go back through the inverse perspective.

use super::{thinning, to_gray};
use crate::board::BoardGeometry;
use crate::geometry::{Homography, HomographyError, Matrix2, Vector2};
use crate::image::{Image, Pixel};
use crate::stripe::StripePoint;
use ::image::{GrayImage, Luma};
use imageproc::contrast::{ThresholdType, otsu_level, threshold};
use imageproc::definitions::Image as Raster;
use imageproc::geometric_transformations::{Border, Interpolation, warp_into_with};
use imageproc::geometry::min_area_rect;
use imageproc::point::Point;
use imageproc::region_labelling::{Connectivity, connected_components};
use serde::Serialize;

/// Thresholds of the paper's extraction; the defaults are the paper's where it gives them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Grey levels by which a square must brighten (paper: 30).
    #[serde(rename = "least brightening of a square / grey levels")]
    pub difference: u8,
    /// Largest height-to-width ratio of a contour's smallest rectangle (paper: 0.25).
    #[serde(rename = "largest height to width of a contour")]
    pub ratio: f64,
    /// Largest deviation of the slope between two squares from the median slope, rad.
    #[serde(rename = "largest deviation of a slope / rad")]
    pub slope: f64,
    /// Share of a square's skeleton that is sliced off at each end.
    #[serde(rename = "share sliced off at each end")]
    pub slice: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            difference: 30,
            ratio: 0.25,
            slope: 2f64.to_radians(),
            slice: 0.1,
        }
    }
}

/// Why no line was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The corners determine no homography.
    #[error("the board's corners: {0}")]
    NoHomography(#[from] HomographyError),
    /// Squares too small to hold a stripe, or no corners.
    #[error(
        "{given} corners of a board of {columns} × {rows} with squares of 4 pixels or more are needed"
    )]
    Corners {
        /// Corners given.
        given: usize,
        /// Inner corners along the long side.
        columns: usize,
        /// Inner corners along the short side.
        rows: usize,
    },
    /// Too few squares passed the screenings.
    #[error(
        "the paper's way found the stripe in {squares} of the board's squares (of {side_px:.0} pixels) where 2 or more are needed: {}",
        remedy(*subtracted)
    )]
    TooFewSquares {
        /// Squares left.
        squares: usize,
        /// Mean side of a square, px.
        side_px: f64,
        /// Whether there was an image without the laser to subtract.
        subtracted: bool,
    },
}

fn remedy(subtracted: bool) -> &'static str {
    if subtracted {
        "bring the board nearer or lengthen the exposure, or leave out --method paper"
    } else {
        "record an image with the laser off for each board pose and name it as \"off\", or bring the board nearer"
    }
}

/// What one square of the board contributes, in rectified pixels.
struct Square {
    centre: Vector2,
    skeleton: Vec<Vector2>,
}

/// The board rectified: a square keeps about the size that it has in the image.
#[derive(Clone, Debug)]
pub struct Rectified {
    board: BoardGeometry,
    /// Of a square, in rectified pixels.
    side: f64,
    size: (u32, u32),
    to_image: Homography,
    off: Option<GrayImage>,
}

impl Rectified {
    /// `corners` in the board's order; the image without the laser may be missing, then each
    /// square's own median serves as its background.
    ///
    /// # Errors
    /// [`Error::Corners`], [`Error::NoHomography`].
    pub fn new<P: Pixel>(
        off: Option<&Image<P>>,
        corners: &[Vector2],
        board: &BoardGeometry,
    ) -> Result<Self, Error> {
        let side = square_side(corners, board).ok_or(Error::Corners {
            given: corners.len(),
            columns: board.columns,
            rows: board.rows,
        })?;
        let grid: Vec<Vector2> = (0..board.corners())
            .map(|i| Vector2::new((i % board.columns) as f64, (i / board.columns) as f64) * side)
            .collect();
        let whole = |squares: usize| (squares as f64 * side).floor() as u32 + 1;
        let mut rectified = Self {
            board: *board,
            side,
            size: (whole(board.columns - 1), whole(board.rows - 1)),
            to_image: Homography::fit(&grid, corners)?,
            off: None,
        };
        rectified.off = off.map(|off| rectified.warp(off));
        Ok(rectified)
    }

    fn warp<P: Pixel>(&self, image: &Image<P>) -> GrayImage {
        let mut out = GrayImage::new(self.size.0, self.size.1);
        warp_into_with(
            &to_gray(image),
            |x, y| {
                let p = self.to_image.apply(&Vector2::new(x as f64, y as f64));
                (p.x as f32, p.y as f32)
            },
            Interpolation::Bilinear,
            Border::Replicate,
            &mut out,
        );
        out
    }
}

/// Points on the stripe's centre line in the image (one for each skeleton pixel that was kept,
/// moved onto the fitted line).
///
/// # Errors
/// [`Error::TooFewSquares`].
pub fn extract<P: Pixel>(
    on: &Image<P>,
    rectified: &Rectified,
    settings: &Settings,
) -> Result<Vec<StripePoint>, Error> {
    let Rectified {
        board,
        side,
        to_image,
        off,
        ..
    } = rectified;
    let side = *side;
    let on = rectified.warp(on);

    let mut squares = Vec::new();
    for row in 0..board.rows - 1 {
        for column in 0..board.columns - 1 {
            let difference = square_difference(&on, off.as_ref(), column, row, side);
            if let Some(found) = in_square(&difference, settings) {
                let origin =
                    Vector2::new((column as f64 * side).ceil(), (row as f64 * side).ceil());
                squares.push(Square {
                    centre: found.centre + origin,
                    skeleton: found.skeleton.iter().map(|p| p + origin).collect(),
                });
            }
        }
    }
    screen_by_slope(&mut squares, settings.slope);
    if squares.len() < 2 {
        return Err(Error::TooFewSquares {
            squares: squares.len(),
            side_px: side,
            subtracted: off.is_some(),
        });
    }

    // Step 5: one line through all that was kept.
    let points: Vec<Vector2> = squares.into_iter().flat_map(|s| s.skeleton).collect();
    let (centre, direction) = principal(&points);
    let normal = Vector2::new(-direction.y, direction.x);
    let variance = points
        .iter()
        .map(|p| (p - centre).dot(&normal).powi(2))
        .sum::<f64>()
        / points.len() as f64;
    Ok(points
        .iter()
        .map(|p| {
            let on_line = centre + direction * (p - centre).dot(&direction);
            let pixel = to_image.apply(&on_line);
            let along = (to_image.apply(&(on_line + direction)) - pixel).normalize();
            StripePoint {
                pixel,
                across: Vector2::new(-along.y, along.x),
                variance,
                intensity: f32::from(on.get_pixel(p.x as u32, p.y as u32).0[0]),
                width_px: 1.0,
                quality: 1.0,
            }
        })
        .collect())
}

/// Mean side of a square in the image, px.
fn square_side(corners: &[Vector2], board: &BoardGeometry) -> Option<f64> {
    if corners.len() != board.corners() || board.columns < 2 || board.rows < 2 {
        return None;
    }
    let at = |column: usize, row: usize| corners[row * board.columns + column];
    let (c, r) = (board.columns - 1, board.rows - 1);
    let along = (at(c, 0) - at(0, 0)).norm() + (at(c, r) - at(0, r)).norm();
    let across = (at(0, r) - at(0, 0)).norm() + (at(c, r) - at(c, 0)).norm();
    let side = (along / c as f64 + across / r as f64) / 4.0;
    (side.is_finite() && side >= 4.0).then_some(side)
}

/// On minus off (or minus the square's median) inside one grid square.
fn square_difference(
    on: &GrayImage,
    off: Option<&GrayImage>,
    column: usize,
    row: usize,
    side: f64,
) -> GrayImage {
    let (x0, y0) = (
        (column as f64 * side).ceil() as u32,
        (row as f64 * side).ceil() as u32,
    );
    let x1 = (((column + 1) as f64 * side).floor() as u32).min(on.width());
    let y1 = (((row + 1) as f64 * side).floor() as u32).min(on.height());
    let (w, h) = (x1.saturating_sub(x0), y1.saturating_sub(y0));
    let median = {
        let mut values: Vec<u8> = (0..w * h)
            .map(|i| on.get_pixel(x0 + i % w, y0 + i / w).0[0])
            .collect();
        values.sort_unstable();
        values.get(values.len() / 2).copied().unwrap_or(0)
    };
    GrayImage::from_fn(w, h, |x, y| {
        let background = off.map_or(median, |off| off.get_pixel(x0 + x, y0 + y).0[0]);
        Luma([on.get_pixel(x0 + x, y0 + y).0[0].saturating_sub(background)])
    })
}

/// Steps 3 and 4 inside one square, in its own pixels.
fn in_square(difference: &GrayImage, settings: &Settings) -> Option<Square> {
    let brightest = difference.pixels().map(|p| p.0[0]).max()?;
    if brightest <= settings.difference {
        return None;
    }
    let binary = threshold(difference, otsu_level(difference), ThresholdType::Binary);
    let labels: Raster<Luma<u32>> = connected_components(&binary, Connectivity::Eight, Luma([0u8]));
    let mut sizes = vec![0usize; labels.pixels().map(|p| p.0[0]).max()? as usize + 1];
    for p in labels.pixels() {
        sizes[p.0[0] as usize] += 1;
    }
    let largest = (1..sizes.len()).max_by_key(|&i| sizes[i])? as u32;
    let contour: Vec<Point<i32>> = labels
        .enumerate_pixels()
        .filter(|(_, _, p)| p.0[0] == largest)
        .map(|(x, y, _)| Point::new(x as i32, y as i32))
        .collect();
    let [a, b, c, _] = min_area_rect(&contour);
    let length =
        |p: Point<i32>, q: Point<i32>| f64::from(p.x - q.x).hypot(f64::from(p.y - q.y)) + 1.0;
    let (s, t) = (length(a, b), length(b, c));
    if s.min(t) / s.max(t) > settings.ratio {
        return None;
    }
    let alone = GrayImage::from_fn(difference.width(), difference.height(), |x, y| {
        Luma([if labels.get_pixel(x, y).0[0] == largest {
            255
        } else {
            0
        }])
    });
    let mut skeleton: Vec<Vector2> = thinning::skeleton(&alone)
        .into_iter()
        .map(|(x, y)| Vector2::new(f64::from(x), f64::from(y)))
        .collect();
    if skeleton.len() < 4 {
        return None;
    }
    // Sorted along the stripe, head and tail sliced off: thinning warps there.
    let (centre, direction) = principal(&skeleton);
    skeleton.sort_by(|p, q| p.dot(&direction).total_cmp(&q.dot(&direction)));
    let cut = (skeleton.len() as f64 * settings.slice).ceil() as usize;
    let skeleton = skeleton.get(cut..skeleton.len() - cut)?.to_vec();
    (!skeleton.is_empty()).then_some(Square { centre, skeleton })
}

/// Removes squares whose slope to every other square departs from the median slope.
fn screen_by_slope(squares: &mut Vec<Square>, tolerance: f64) {
    if squares.len() < 3 {
        return;
    }
    let centres: Vec<Vector2> = squares.iter().map(|s| s.centre).collect();
    // A line's direction modulo a half-turn, measured from the principal one.
    let (_, main) = principal(&centres);
    let slope = |p: &Vector2, q: &Vector2| {
        let d = q - p;
        let across = main.x * d.y - main.y * d.x;
        (across / d.dot(&main)).atan()
    };
    let mut all: Vec<f64> = Vec::new();
    for (i, p) in centres.iter().enumerate() {
        all.extend(centres[i + 1..].iter().map(|q| slope(p, q)));
    }
    all.sort_by(f64::total_cmp);
    let median = all[all.len() / 2];
    let mut index = 0;
    squares.retain(|_| {
        let p = &centres[index];
        let agree = centres
            .iter()
            .enumerate()
            .filter(|(j, q)| *j != index && (slope(p, q) - median).abs() <= tolerance)
            .count();
        index += 1;
        2 * agree >= centres.len() - 1
    });
}

/// Centroid and direction of greatest spread.
fn principal(points: &[Vector2]) -> (Vector2, Vector2) {
    let centre = points.iter().sum::<Vector2>() / points.len() as f64;
    let scatter: Matrix2 = points
        .iter()
        .map(|p| (p - centre) * (p - centre).transpose())
        .sum();
    let eigen = scatter.symmetric_eigen();
    let major = usize::from(eigen.eigenvalues[1] > eigen.eigenvalues[0]);
    (centre, eigen.eigenvectors.column(major).into_owned())
}
