//! Guides whoever shows the board to camera and laser: how the poses of the light planes spread over
//! depth, tilt and image, what next, and when it is enough.
//!
//! A light plane is laid through the lines that it draws on the boards: it is as sure as these lie
//! apart in depth and as their boards are tilted to different sides
//! ([`crate::calibration::light::limits`] says what the calibration then asks of it).

use super::guide::{Guide, Seen};
use crate::board::{BoardGeometry, Detection};

/// Poses needed at least: one bad one is then noticed.
const POSES: usize = 6;
/// From the nearest board to the farthest, as a part of their mean distance.
const DEPTH: f64 = 0.1;
/// Sides to which boards have been tilted, of four.
const SIDES: usize = 2;
/// Parts of the image that boards have covered, of nine.
const COVERED: usize = 4;

/// What has been shown to camera and laser.
#[derive(Clone, Debug)]
pub struct LightGuide {
    guide: Guide,
    distances: Vec<f64>,
}

impl LightGuide {
    /// Nothing shown yet, in images of this size.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            guide: Guide::new(width, height),
            distances: Vec::new(),
        }
    }

    /// Takes in a pose from its image without laser.
    pub fn add(&mut self, detection: &Detection, board: &BoardGeometry) -> Seen {
        let seen = self.guide.add(detection, board);
        self.distances.push(seen.distance_mm);
        seen
    }

    /// From the nearest to the farthest as a part of the mean; 0 with none.
    pub fn depth(&self) -> f64 {
        let n = self.distances.len().max(1) as f64;
        let mean = self.distances.iter().sum::<f64>() / n;
        let most = self.distances.iter().copied().fold(0.0, f64::max);
        let least = self.distances.iter().copied().fold(most, f64::min);
        if mean > 0.0 {
            (most - least) / mean
        } else {
            0.0
        }
    }

    /// What to do next; `None` when it is enough.
    pub fn next(&self) -> Option<String> {
        let poses = self.guide.poses();
        let mut wanted = Vec::new();
        if poses > 0 && self.depth() < DEPTH {
            // To where fewer have been.
            let mean = self.distances.iter().sum::<f64>() / poses as f64;
            let near = self.distances.iter().filter(|d| **d < mean).count();
            let way = if 2 * near > poses {
                "away from"
            } else {
                "towards"
            };
            wanted.push(format!(
                "move the board {way} the camera by {:.0} % of its distance",
                100.0 * DEPTH
            ));
        }
        if self.guide.sides() < SIDES
            && let Some(tilt) = self.guide.untilted()
        {
            wanted.push(tilt.to_owned());
        }
        if self.guide.covered() < COVERED {
            wanted.push("move it sideways, to where no pose has been".to_owned());
        }
        if wanted.is_empty() && poses < POSES {
            wanted.push(format!(
                "{} more poses, each at another distance and tilt",
                POSES - poses
            ));
        }
        (!wanted.is_empty()).then(|| {
            format!(
                "{}; the line must cross the board at every position",
                wanted.join(", ")
            )
        })
    }

    /// The spread in one line.
    pub fn summary(&self) -> String {
        format!(
            "{} poses, depth spread {:.0} % (of {:.0} wanted), tilted to {} of {SIDES} sides wanted, {} of 9 parts of the image covered ({COVERED} wanted)",
            self.guide.poses(),
            100.0 * self.depth(),
            100.0 * DEPTH,
            self.guide.sides().min(SIDES),
            self.guide.covered()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::{Corner, Quality};
    use crate::geometry::Matrix2;
    use crate::simulation::{Profile, Scene};
    use crate::synthetic::BOARD;

    /// The corners as they truly are.
    fn seen_in(scene: &Scene, pose: &crate::geometry::Pose) -> Detection {
        Detection {
            corners: (0..BOARD.corners())
                .map(|i| Corner {
                    pixel: scene.camera.project(&pose.apply(&BOARD.point(i))).unwrap(),
                    covariance: Matrix2::identity() * 1e-4,
                })
                .collect(),
            blur_px: 0.6,
            columns: 8,
            rows: 6,
            quality: Quality::default(),
        }
    }

    #[test]
    fn poses_that_calibrate_are_enough_and_equal_ones_never() {
        for seed in 1..5 {
            let scene = Scene::new(Profile::Nominal, seed);
            let mut guide = LightGuide::new(1280, 960);
            assert!(guide.next().is_some());
            for pose in &scene.light_poses {
                let seen = guide.add(&seen_in(&scene, pose), &BOARD);
                let half = (BOARD.point(0).coords + BOARD.point(47).coords) / 2.0;
                let true_z = pose.apply(&half.into()).z;
                // The focal length is a guess: within a fifth.
                assert!((seen.distance_mm / true_z - 1.0).abs() < 0.2);
            }
            // Spread does not depend on the guess: from the true depths of the boards' middles.
            let z: Vec<f64> = scene
                .light_poses
                .iter()
                .map(|p| {
                    let half = (BOARD.point(0).coords + BOARD.point(47).coords) / 2.0;
                    p.apply(&half.into()).z
                })
                .collect();
            let mean = z.iter().sum::<f64>() / z.len() as f64;
            let range =
                z.iter().copied().fold(0.0, f64::max) - z.iter().copied().fold(1e9, f64::min);
            assert!((guide.depth() - range / mean).abs() < 0.01);
            assert_eq!(guide.next(), None, "seed {seed}: {}", guide.summary());

            let mut same = LightGuide::new(1280, 960);
            for _ in 0..12 {
                same.add(&seen_in(&scene, &scene.light_poses[0]), &BOARD);
            }
            let said = same.next().unwrap();
            assert!(
                said.contains("the camera by 10 % of its distance"),
                "{said}"
            );
        }
    }
}
