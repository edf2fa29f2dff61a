//! The simulated checkerboard: a flat plate with its pattern, in ambient light.

use super::random::normal_cdf;
use crate::board::BoardGeometry;
use crate::geometry::{Matrix3, Pose, Vector3};

/// Width of the white rim round the outer squares, in squares.
const RIM: f64 = 1.0;
const WHITE: f64 = 0.92;
const BLACK: f64 = 0.05;

/// A board somewhere in front of the camera.
#[derive(Clone, Debug)]
pub struct Target {
    /// Its geometry.
    pub board: BoardGeometry,
    /// Board frame to camera frame.
    pub pose: Pose,
    /// Ray (x, y, 1) to board coordinates times 1/z, and 1/z.
    inverse: Matrix3,
}

/// A place on the board.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Board coordinates, mm.
    pub x: f64,
    /// Board coordinates, mm.
    pub y: f64,
    /// Distance along the optical axis, mm.
    pub z: f64,
}

impl Target {
    /// A board at a pose.
    pub fn new(board: BoardGeometry, pose: Pose) -> Option<Self> {
        // z·ray = R·(X, Y, 0) + T, so (X, Y, 1)/z = [r1 r2 T]⁻¹·ray.
        let r = pose.rotation.matrix();
        let m = Matrix3::from_columns(&[
            r.column(0).into_owned(),
            r.column(1).into_owned(),
            pose.translation,
        ]);
        Some(Self {
            board,
            pose,
            inverse: m.try_inverse()?,
        })
    }

    /// Corners of the plate: lowest and highest x, lowest and highest y, mm.
    pub fn outline(&self) -> [f64; 4] {
        let s = self.board.square_mm;
        let low = -s * (1.0 + RIM);
        [
            low,
            s * (self.board.columns as f64 + RIM),
            low,
            s * (self.board.rows as f64 + RIM),
        ]
    }

    /// Where a ray (x, y, 1) meets the board's plane.
    #[inline]
    pub fn meet(&self, ray: &Vector3) -> Option<Place> {
        let m = self.inverse * ray;
        (m.z > 1e-6).then(|| Place {
            x: m.x / m.z,
            y: m.y / m.z,
            z: 1.0 / m.z,
        })
    }

    /// Whether a place lies on the plate.
    pub fn covers(&self, place: &Place) -> bool {
        let [x0, x1, y0, y1] = self.outline();
        (x0..=x1).contains(&place.x) && (y0..=y1).contains(&place.y)
    }

    /// Reflectance at a place with its edges softened by `soft` = (along x, along y) mm, and the
    /// share of the plate (0 beside it, 1 on it).
    #[inline]
    pub fn reflectance(&self, place: &Place, soft: (f64, f64)) -> (f64, f64) {
        let s = self.board.square_mm;
        let share = {
            let [x0, x1, y0, y1] = self.outline();
            let step = |t: f64, w: f64| normal_cdf(t / w);
            step((place.x - x0).min(x1 - place.x), soft.0)
                * step((place.y - y0).min(y1 - place.y), soft.1)
        };
        if share == 0.0 {
            return (0.0, 0.0);
        }
        let (sx, edge_x) = wave(place.x / s, soft.0 / s, self.board.columns);
        let (sy, edge_y) = wave(place.y / s, soft.1 / s, self.board.rows);
        // The pattern's squares are black where the waves agree, within the pattern's outline.
        let black = 0.5 * (1.0 + sx * sy) * edge_x * edge_y;
        (WHITE + (BLACK - WHITE) * black, share)
    }
}

/// The square wave of the pattern along one axis, ±1 alternating, +1 in the first square
/// (−1..0), and the pattern's outline (1 inside), both softened by `soft`. Unit: squares.
#[inline]
fn wave(t: f64, soft: f64, corners: usize) -> (f64, f64) {
    let nearest = t.round();
    let offset = (t - nearest) / soft;
    let last = corners as f64;
    let outline = normal_cdf((t + 1.0).min(last - t) / soft);
    // Just before edge k the sign is (−1)^k: +1 before edge 0.
    let before = if nearest.rem_euclid(2.0) == 0.0 {
        1.0
    } else {
        -1.0
    };
    let sign = before * (1.0 - 2.0 * normal_cdf(offset));
    // The outermost edges are not edges of the wave.
    let sign = if nearest < 0.0 || nearest >= last {
        if nearest < 0.0 { 1.0 } else { before }
    } else {
        sign
    };
    (sign, outline)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn target() -> Target {
        Target::new(
            BoardGeometry {
                columns: 8,
                rows: 6,
                square_mm: 10.0,
            },
            Pose {
                rotation: Rotation3::new(Vector3::new(0.2, -0.3, 0.1)),
                translation: Vector3::new(-30.0, -20.0, 430.0),
            },
        )
        .unwrap()
    }

    #[test]
    fn squares_alternate_and_start_black() {
        let t = target();
        for i in -1..8 {
            for j in -1..6 {
                let place = Place {
                    x: 10.0 * f64::from(i) + 5.0,
                    y: 10.0 * f64::from(j) + 5.0,
                    z: 430.0,
                };
                let (value, share) = t.reflectance(&place, (0.05, 0.05));
                let expected = if (i + j) % 2 == 0 { BLACK } else { WHITE };
                assert!((value - expected).abs() < 1e-9, "square {i}, {j}: {value}");
                assert_eq!(share, 1.0);
            }
        }
        for (x, y) in [(-15.0, 20.0), (85.0, 20.0), (30.0, -14.0), (30.0, 64.0)] {
            assert!(
                (t.reflectance(&Place { x, y, z: 430.0 }, (0.05, 0.05)).0 - WHITE).abs() < 1e-9
            );
        }
        assert_eq!(
            t.reflectance(
                &Place {
                    x: 95.0,
                    y: 0.0,
                    z: 430.0
                },
                (0.05, 0.05)
            )
            .1,
            0.0
        );
    }

    #[test]
    fn an_edge_is_half_way_between() {
        let t = target();
        for (x, y) in [
            (0.0, 5.0),
            (70.0, 35.0),
            (25.0, 50.0),
            (80.0, 15.0),
            (35.0, 60.0),
            (-10.0, -5.0),
        ] {
            let (value, _) = t.reflectance(&Place { x, y, z: 430.0 }, (0.05, 0.05));
            assert!(
                (value - 0.5 * (WHITE + BLACK)).abs() < 1e-6,
                "{x}, {y}: {value}"
            );
        }
    }

    #[test]
    fn a_ray_meets_the_board_where_the_pose_says() {
        let t = target();
        let p = t.pose.apply(&crate::geometry::Point3::new(33.0, 21.0, 0.0));
        let place = t.meet(&Vector3::new(p.x / p.z, p.y / p.z, 1.0)).unwrap();
        assert!((place.x - 33.0).abs() < 1e-9 && (place.y - 21.0).abs() < 1e-9);
        assert!((place.z - p.z).abs() < 1e-9);
    }
}
