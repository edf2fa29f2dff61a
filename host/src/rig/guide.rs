//! Guides whoever shows the board to the camera: where it has been, how it was tilted, what next.

use crate::board::{BoardGeometry, Detection};
use crate::geometry::{Homography, Matrix3, Vector2};

/// Parts of the image along each side.
const CELLS: usize = 3;
/// Corners in a part of the image for it to count as covered.
const CELL_CORNERS: usize = 8;
/// A tilt counts from here on, degrees.
const TILT_DEG: f64 = 12.0;
/// Poses needed at least.
const POSES: usize = 10;
/// Focal length over image width that is assumed for the tilt, before the camera is calibrated.
const FOCAL_GUESS: f64 = 1.7;

/// A direction in which the board is tilted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tilt {
    /// Facing the camera.
    None,
    /// Its left edge is nearer.
    LeftNear,
    /// Its right edge is nearer.
    RightNear,
    /// Its upper edge is nearer.
    TopNear,
    /// Its lower edge is nearer.
    BottomNear,
}

/// What has been shown.
#[derive(Clone, Debug)]
pub struct Guide {
    width: f64,
    height: f64,
    cells: [[usize; CELLS]; CELLS],
    tilts: [usize; 4],
    poses: usize,
}

/// What the last pose was like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Angle between board and image plane, degrees (of an assumed focal length).
    pub tilt_deg: f64,
    /// Its direction.
    pub tilt: Tilt,
    /// From the camera to the board's middle along the optical axis, mm (likewise).
    pub distance_mm: f64,
}

const DIRECTIONS: [(Tilt, &str); 4] = [
    (Tilt::LeftNear, "turn its left edge towards the camera"),
    (Tilt::RightNear, "turn its right edge towards the camera"),
    (Tilt::TopNear, "tip its upper edge towards the camera"),
    (Tilt::BottomNear, "tip its lower edge towards the camera"),
];

const PLACES: [[&str; CELLS]; CELLS] = [
    ["upper left corner", "upper edge", "upper right corner"],
    ["left edge", "middle", "right edge"],
    ["lower left corner", "lower edge", "lower right corner"],
];

impl Guide {
    /// Nothing shown yet, in images of this size.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width: width.into(),
            height: height.into(),
            cells: [[0; CELLS]; CELLS],
            tilts: [0; 4],
            poses: 0,
        }
    }

    /// Takes in a pose.
    pub fn add(&mut self, detection: &Detection, board: &BoardGeometry) -> Seen {
        self.poses += 1;
        for corner in &detection.corners {
            let cell = |at: f64, size: f64| ((at / size * CELLS as f64) as usize).min(CELLS - 1);
            let (u, v) = (
                cell(corner.pixel.x, self.width),
                cell(corner.pixel.y, self.height),
            );
            self.cells[v][u] += 1;
        }
        let seen = self.tilt(detection, board);
        if let Some(i) = DIRECTIONS.iter().position(|(tilt, _)| *tilt == seen.tilt) {
            self.tilts[i] += 1;
        }
        seen
    }

    /// The board's tilt from the perspective in its corners.
    fn tilt(&self, detection: &Detection, board: &BoardGeometry) -> Seen {
        let flat: Vec<Vector2> = (0..board.corners())
            .map(|i| Vector2::new(board.point(i).x, board.point(i).y))
            .collect();
        let pixels: Vec<Vector2> = detection.corners.iter().map(|c| c.pixel).collect();
        let none = Seen {
            tilt_deg: 0.0,
            tilt: Tilt::None,
            distance_mm: 0.0,
        };
        let f = FOCAL_GUESS * self.width;
        let camera = Matrix3::new(
            f,
            0.0,
            0.5 * self.width,
            0.0,
            f,
            0.5 * self.height,
            0.0,
            0.0,
            1.0,
        );
        let (Ok(h), Some(inverse)) = (Homography::fit(&flat, &pixels), camera.try_inverse()) else {
            return none;
        };
        // K⁻¹·H = [r1 r2 t] up to scale; the normal is r1 × r2, away from the camera.
        let m = inverse * h.0;
        let scale = 0.5 * (m.column(0).norm() + m.column(1).norm());
        let middle = 0.5 * (flat[0] + flat[flat.len() - 1]);
        let at = m.column(0) * middle.x + m.column(1) * middle.y + m.column(2);
        let distance_mm = (at.z / scale).abs();
        let n = m.column(0).cross(&m.column(1));
        let n = if n.z < 0.0 { -n } else { n }.normalize();
        let tilt_deg = n.z.clamp(-1.0, 1.0).acos().to_degrees();
        // n·P = const with n.x > 0: to the right z falls, the right edge is nearer.
        let tilt = match (tilt_deg > TILT_DEG, n.x.abs() > n.y.abs()) {
            (false, _) => Tilt::None,
            (true, true) if n.x > 0.0 => Tilt::RightNear,
            (true, true) => Tilt::LeftNear,
            (true, false) if n.y > 0.0 => Tilt::BottomNear,
            (true, false) => Tilt::TopNear,
        };
        Seen {
            tilt_deg,
            tilt,
            distance_mm,
        }
    }

    /// Poses taken in.
    pub fn poses(&self) -> usize {
        self.poses
    }

    /// Sides to which it was tilted, of four.
    pub fn sides(&self) -> usize {
        self.tilts.iter().filter(|&&n| n > 0).count()
    }

    /// What to do for a tilt that has not been shown.
    pub fn untilted(&self) -> Option<&'static str> {
        let i = self.tilts.iter().position(|&n| n == 0)?;
        Some(DIRECTIONS[i].1)
    }

    /// Parts of the image that the board has covered, of nine.
    pub fn covered(&self) -> usize {
        self.cells
            .iter()
            .flatten()
            .filter(|&&n| n >= CELL_CORNERS)
            .count()
    }

    /// What to do next; `None` when it is enough.
    pub fn next(&self) -> Option<String> {
        let tilt = self.untilted();
        let mut place = None;
        // Corners of the image first: that is where distortion shows.
        for (v, u) in [
            (0, 0),
            (2, 2),
            (0, 2),
            (2, 0),
            (1, 1),
            (0, 1),
            (2, 1),
            (1, 0),
            (1, 2),
        ] {
            if place.is_none() && self.cells[v][u] < CELL_CORNERS {
                place = Some(PLACES[v][u]);
            }
        }
        match (place, tilt) {
            (Some(place), Some(tilt)) => Some(format!("move the board to the {place} and {tilt}")),
            (Some(place), None) => Some(format!("move the board to the {place}")),
            (None, Some(tilt)) => Some(tilt.to_owned()),
            (None, None) if self.poses < POSES => Some(format!(
                "{} more poses, each with another tilt",
                POSES - self.poses
            )),
            (None, None) => None,
        }
    }

    /// Coverage and tilts in one line.
    pub fn summary(&self) -> String {
        format!(
            "{} poses, {} of {} parts of the image covered, {} of 4 tilts",
            self.poses,
            self.covered(),
            CELLS * CELLS,
            self.sides()
        )
    }
}

impl std::fmt::Display for Seen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let direction = match self.tilt {
            Tilt::None => "facing the camera",
            Tilt::LeftNear => "left edge nearer",
            Tilt::RightNear => "right edge nearer",
            Tilt::TopNear => "upper edge nearer",
            Tilt::BottomNear => "lower edge nearer",
        };
        write!(f, "tilted {:.0}°, {direction}", self.tilt_deg)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::{Corner, Quality};
    use crate::geometry::{Camera, Distortion, Matrix2, Pose, Vector3};
    use crate::synthetic::BOARD;
    use nalgebra::Rotation3;

    fn shown(rotation: Vector3, at: (f64, f64)) -> Detection {
        let camera = Camera {
            width: 1280,
            height: 960,
            fx: 2176.0,
            fy: 2176.0,
            u0: 639.5,
            v0: 479.5,
            distortion: Distortion::default(),
        };
        let rotation = Rotation3::new(rotation);
        let pose = Pose {
            rotation,
            translation: Vector3::new(at.0, at.1, 430.0) - rotation * Vector3::new(35.0, 25.0, 0.0),
        };
        let corners = (0..48)
            .map(|i| Corner {
                pixel: camera.project(&pose.apply(&BOARD.point(i))).unwrap(),
                covariance: Matrix2::identity() * 1e-4,
            })
            .collect();
        Detection {
            corners,
            blur_px: 0.6,
            columns: 8,
            rows: 6,
            quality: Quality::default(),
        }
    }

    #[test]
    fn tilts_are_told_apart() {
        let mut guide = Guide::new(1280, 960);
        // A turn about y by +20° brings the right edge (x > 0) to z − : nearer.
        for (rotation, tilt) in [
            (Vector3::new(0.0, 0.0, 0.3), Tilt::None),
            (Vector3::new(0.0, 0.35, 0.0), Tilt::RightNear),
            (Vector3::new(0.0, -0.35, 0.0), Tilt::LeftNear),
            (Vector3::new(-0.35, 0.0, 0.0), Tilt::BottomNear),
            (Vector3::new(0.35, 0.0, 0.0), Tilt::TopNear),
        ] {
            let seen = guide.add(&shown(rotation, (0.0, 0.0)), &BOARD);
            assert_eq!(seen.tilt, tilt, "{rotation}");
            let expected = rotation.xy().norm().to_degrees();
            assert!(
                (seen.tilt_deg - expected).abs() < 1.0,
                "{} {expected}",
                seen.tilt_deg
            );
        }
        assert_eq!(guide.tilts, [1; 4]);
    }

    #[test]
    fn it_asks_until_everything_is_covered() {
        let mut guide = Guide::new(1280, 960);
        assert_eq!(
            guide.next().unwrap(),
            "move the board to the upper left corner and turn its left edge towards the camera"
        );
        let tilts = [(0.35, 0.0), (-0.35, 0.0), (0.0, 0.35), (0.0, -0.35)];
        let mut asked = 0;
        'all: for round in 0..4 {
            for y in [-50.0, 0.0, 50.0] {
                for x in [-75.0, 0.0, 75.0] {
                    if guide.next().is_none() {
                        break 'all;
                    }
                    let (a, b) = tilts[(asked + round) % 4];
                    guide.add(&shown(Vector3::new(a, b, 0.0), (x, y)), &BOARD);
                    asked += 1;
                }
            }
        }
        assert!((10..=20).contains(&asked), "{asked}");
        assert_eq!(guide.covered(), 9);
    }
}
