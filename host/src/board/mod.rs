//! The checkerboard in an image: its inner corners at sub-pixel accuracy, each with a covariance.
//!
//! Corner i = row·columns + column stands at (column·s, row·s, 0) mm in the board's frame, columns
//! along the long side. The board is seen from its front: x right, y down, z away from the camera
//! when it faces the camera upright.

use crate::geometry::{Matrix2, Point3, Vector2};
use crate::image::{Image, Pixel};

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
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// All corners, in the order of [`BoardGeometry::point`].
    pub corners: Vec<Corner>,
    /// Standard deviation of the edge blur that the fit found, px.
    pub blur_px: f64,
}

/// Why no board was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotFound {
    /// Nothing in the image looks like a checkerboard corner.
    #[error("no checkerboard corners in the image")]
    NoCorners,
    /// Part of the board lies outside the image.
    #[error("the board is partly outside the image")]
    PartlyOutside,
    /// The edges are too soft.
    #[error("the image is too blurred (edge blur {blur_px:.1} px)")]
    TooBlurred {
        /// Estimated blur, px.
        blur_px: f64,
    },
    /// A saturated spot hides corners.
    #[error("glare hides part of the board")]
    Glare,
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

/// Finds the board and its corners.
pub fn detect<P: Pixel>(image: &Image<P>, geometry: &BoardGeometry) -> Result<Detection, NotFound> {
    let _ = (image, geometry);
    Err(NotFound::NoCorners)
}

/// Renumbers `detection` so that it agrees with `reference` (another image of the same pose): of
/// the board's symmetries (the half-turn of 8 × 6), the one with the smallest displacement.
pub fn align(detection: &mut Detection, reference: &Detection) {
    let _ = (detection, reference);
}
