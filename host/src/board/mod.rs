//! The checkerboard in an image: its inner corners at sub-pixel accuracy, each with a covariance.
//!
//! Corner i = row·columns + column stands at (column·s, row·s, 0) mm in the board's frame, columns
//! along the long side. The board is seen from its front: x right, y down, z away from the camera
//! when it faces the camera upright.

mod candidate;
mod edge_model;
mod grid;
mod layout;
mod levels;
mod noise;
mod refine;
mod response;
mod search;
mod site;
mod stack;
pub mod subpixel;
#[cfg(test)]
mod tests;

pub use stack::{Stack, Summable};

use crate::geometry::{Matrix2, Point3, Vector2};
use crate::image::{Image, Pixel};

/// What is decided by, for the report: name and value.
pub fn limits() -> Vec<(&'static str, String)> {
    let mut all = search::limits();
    all.extend(grid::limits());
    all.extend(layout::limits());
    all.extend(refine::limits());
    all.extend(noise::limits());
    all
}

/// The calibration target: inner corners and the size of a square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardGeometry {
    /// Inner corners along the long side.
    pub columns: usize,
    /// Inner corners along the short side.
    pub rows: usize,
    /// Side of a square, mm.
    pub square_mm: f64,
}

impl BoardGeometry {
    /// How many inner corners there are.
    pub fn corners(&self) -> usize {
        self.columns * self.rows
    }

    /// Corner i in the board's frame, mm.
    pub fn point(&self, i: usize) -> Point3 {
        Point3::new(
            (i % self.columns) as f64 * self.square_mm,
            (i / self.columns) as f64 * self.square_mm,
            0.0,
        )
    }
}

/// One corner as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Sub-pixel position.
    pub pixel: Vector2,
    /// Its covariance, px².
    pub covariance: Matrix2,
}

/// A whole board found in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detection {
    /// All corners, in the order of [`BoardGeometry::point`].
    pub corners: Vec<Corner>,
    /// Standard deviation of the edge blur that the fit found (median over the corners), px: the
    /// point spread alone, the pixel's own area taken out.
    pub blur_px: f64,
    /// Corners along the board's x axis.
    pub columns: usize,
    /// Corners along the board's y axis.
    pub rows: usize,
    /// What a user needs to know to take a better image.
    pub quality: Quality,
}

/// How well a board was seen. Grey values are in the image's own units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Quality {
    /// Shortest and longest side of a square, px.
    pub square_px: [f64; 2],
    /// Grey of the white squares (median over the corners).
    pub white: f64,
    /// Grey of the black squares (median over the corners).
    pub black: f64,
    /// Standard deviation of the noise on the black and on the white squares.
    pub noise: [f64; 2],
    /// Each corner's misfit: root mean square residual over the noise that the whole board shows
    /// (1 where the model holds).
    pub misfit: Vec<f64>,
    /// Each corner's part of the patch left out as foreign (a laser stripe, dirt), 0 to 1.
    pub masked: Vec<f64>,
    /// Part of the white squares that is saturated, 0 to 1.
    pub saturated: f64,
}

/// Edges of the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides {
    /// The edge at u = 0.
    pub left: bool,
    /// The edge at the largest u.
    pub right: bool,
    /// The edge at v = 0.
    pub top: bool,
    /// The edge at the largest v.
    pub bottom: bool,
}

impl std::fmt::Display for Sides {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names = [
            (self.left, "left"),
            (self.right, "right"),
            (self.top, "top"),
            (self.bottom, "bottom"),
        ];
        let mut first = true;
        for (_, name) in names.iter().filter(|(set, _)| *set) {
            write!(f, "{}{name}", if first { "" } else { " and " })?;
            first = false;
        }
        Ok(())
    }
}

/// Why no board was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotFound {
    /// Nothing in the image looks like a checkerboard.
    #[error("no checkerboard in the image ({seen} single corners seen)")]
    NoCorners {
        /// Places that look like a corner but form no grid.
        seen: usize,
    },
    /// The image is all of one brightness.
    #[error(
        "the image is empty (grey {darkest:.0} to {brightest:.0}): check light, exposure and lens cap"
    )]
    NoContrast {
        /// Grey exceeded by 99 % of the image.
        darkest: f64,
        /// Grey exceeded by 1 % of the image.
        brightest: f64,
    },
    /// Part of the board lies outside the image.
    #[error("the board is cut off by the image's {sides} edge ({seen} corners seen)")]
    PartlyOutside {
        /// Corners seen.
        seen: usize,
        /// Edges of the image that cut it.
        sides: Sides,
    },
    /// The edges are too soft.
    #[error(
        "the image is too blurred (edge blur {blur_px:.1} px, at most {limit_px:.1} px for this board): focus, or hold the board still"
    )]
    TooBlurred {
        /// Estimated blur, px.
        blur_px: f64,
        /// The most that would do, px.
        limit_px: f64,
    },
    /// A saturated spot hides corners.
    #[error("glare hides {hidden} of the board's corners: tilt the board or move the light")]
    Glare {
        /// Corners in the saturated spot.
        hidden: usize,
    },
    /// Something stands before the board, or it lies in a shadow.
    #[error("{} of the board's corners are hidden, the first near pixel ({:.0}, {:.0})", hidden, near.x, near.y)]
    Hidden {
        /// Corners not seen.
        hidden: usize,
        /// Where one of them should be.
        near: Vector2,
    },
    /// The board did not stand still between the images of one pose.
    #[error(
        "the board moved by {moved_px:.1} px between the image without the laser and those with it: fix it while the slide runs"
    )]
    Moved {
        /// Largest distance between a corner's places, px.
        moved_px: f64,
    },
    /// A grid was found, but not of the size asked for.
    #[error(
        "found a grid of {found_columns} × {found_rows} corners where {columns} × {rows} were asked for"
    )]
    WrongCount {
        /// Corners found along the longer side.
        found_columns: usize,
        /// Corners found along the shorter side.
        found_rows: usize,
        /// Corners wanted along the longer side.
        columns: usize,
        /// Corners wanted along the shorter side.
        rows: usize,
    },
}

/// Finds the board and its corners, at sub-pixel accuracy.
///
/// The whole board must be seen; its squares must be at least 8 px wide. Any turn, tilts to about
/// 50°, uneven or weak light, and a laser stripe across the board are all right. Where columns +
/// rows is odd, corner 0 is the one whose square between +x and +y is black; where it is even the
/// board looks the same after half a turn, and x points to the right as far as it can ([`align`]
/// settles it between images of one pose).
///
/// # Errors
/// The reason why there is no such board in the image.
pub fn detect<P: Pixel>(image: &Image<P>, geometry: &BoardGeometry) -> Result<Detection, NotFound> {
    search::detect(image, geometry)
}

/// Renumbers `detection` so that it agrees with `reference` (another image of the same pose): of
/// the board's symmetries (the half-turn of 8 × 6; quarter turns where columns = rows is even), the
/// one with the smallest displacement. Detections of different boards are left as they are.
pub fn align(detection: &mut Detection, reference: &Detection) {
    let (columns, rows) = (detection.columns, detection.rows);
    let n = detection.corners.len();
    if columns * rows != n
        || n != reference.corners.len()
        || (reference.columns, reference.rows) != (columns, rows)
    {
        return;
    }
    // A turn takes (column, row) to where the turned board's corner of that number was.
    let half = |c: usize, r: usize| (columns - 1 - c, rows - 1 - r);
    let quarter = |c: usize, r: usize| (r, columns - 1 - c);
    let mut turns: Vec<Vec<usize>> = vec![(0..n).collect()];
    let numbering = |turn: &dyn Fn(usize, usize) -> (usize, usize)| -> Vec<usize> {
        (0..n)
            .map(|i| {
                let (c, r) = turn(i % columns, i / columns);
                r * columns + c
            })
            .collect()
    };
    if (columns + rows).is_multiple_of(2) {
        turns.push(numbering(&half));
    }
    // A quarter turn swaps the colours of a corner an odd number of squares away, and back.
    if columns == rows && columns.is_multiple_of(2) {
        turns.push(numbering(&quarter));
        turns.push(numbering(&|c, r| {
            let (c, r) = half(c, r);
            quarter(c, r)
        }));
    }
    let displacement = |turn: &Vec<usize>| -> f64 {
        turn.iter()
            .zip(&reference.corners)
            .map(|(&i, r)| (detection.corners[i].pixel - r.pixel).norm_squared())
            .sum()
    };
    let best = turns
        .iter()
        .min_by(|a, b| displacement(a).total_cmp(&displacement(b)));
    if let Some(turn) = best {
        detection.corners = turn.iter().map(|&i| detection.corners[i]).collect();
        for values in [&mut detection.quality.misfit, &mut detection.quality.masked] {
            if values.len() == n {
                *values = turn.iter().map(|&i| values[i]).collect();
            }
        }
    }
}
