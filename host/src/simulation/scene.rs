//! One seed's scene: camera, laser and slide, the poses in which the board is shown, the hand.

use super::hand::{Hand, Skin};
use super::profile::{Parameters, Profile};
use super::random::Random;
use super::target::Target;
use crate::board::BoardGeometry;
use crate::calibration::LightModel;
use crate::geometry::{Camera, Distortion, Plane, Point3, Pose, Vector3};
use nalgebra::Rotation3;

/// Travel of the slide that the scene is laid out for, mm.
pub const TRAVEL_MM: f64 = 60.0;

/// The board that poses, depths and tilts were chosen for.
const USUAL: BoardGeometry = BoardGeometry {
    columns: 8,
    rows: 6,
    square_mm: 10.0,
};

/// The laser on its slide as it truly is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Laser {
    /// The true light planes, Eq. 9.
    pub model: LightModel,
    /// Full width of the sheet at 1/e² of its middle, mm.
    pub width_1e2_mm: f64,
    /// Direction in which the slide moves, camera frame.
    pub travel: Vector3,
    /// True mm of travel a nominal mm (the screw's error).
    pub screw: f64,
    /// Direction in which the light travels at the middle of the sheet.
    pub beam: Vector3,
}

/// Everything that stands before the camera, and the camera.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The seed that it was drawn from.
    pub seed: u64,
    /// The profile that it was drawn from.
    pub profile: Profile,
    /// The profile's conditions.
    pub parameters: Parameters,
    /// The true camera.
    pub camera: Camera,
    /// Standard deviation of the lens's blur, pixels.
    pub psf_px: f64,
    /// The true laser.
    pub laser: Laser,
    /// The calibration target.
    pub board: BoardGeometry,
    /// Board poses for the camera's calibration.
    pub camera_poses: Vec<Pose>,
    /// Board poses for the light planes.
    pub light_poses: Vec<Pose>,
    /// The hand.
    pub hand: Hand,
    /// The hand's skin.
    pub skin: Skin,
}

impl Laser {
    fn random(random: &mut Random) -> Self {
        let normal = Vector3::new(
            random.between(0.015, 0.028),
            random.between(-0.881, -0.867),
            random.between(0.475, 0.495),
        )
        .normalize();
        // The slide moves nearly along minus the normal's direction.
        let skew = |r: &mut Random| r.between(-0.04, 0.04);
        let travel =
            (normal + Vector3::new(skew(random) * 0.3, skew(random), skew(random))).normalize();
        let screw = 1.0 + random.between(-5e-4, 5e-4);
        let beam = Vector3::x().cross(&normal).normalize();
        Self {
            model: LightModel {
                normal,
                a: -normal.dot(&travel) * screw,
                b: random.between(-193.5, -187.0),
            },
            width_1e2_mm: random.between(1.0, 1.2),
            travel,
            screw,
            beam: if beam.z > 0.0 { beam } else { -beam },
        }
    }

    /// The light plane with the slide truly at x mm.
    pub fn plane(&self, slide_mm: f64) -> Plane {
        self.model.plane(slide_mm)
    }

    /// Brightness at distance `d` mm from the sheet's middle and `across` mm along its line, 0 to 1.
    #[inline]
    pub fn profile(&self, d: f64, across: f64, soft_mm: f64) -> f64 {
        let sigma2 = (self.width_1e2_mm / 4.0).powi(2);
        let soft2 = sigma2 + soft_mm * soft_mm;
        let along = across / 110.0;
        (sigma2 / soft2).sqrt() * (-0.5 * d * d / soft2 - along * along).exp()
    }
}

impl Scene {
    /// The scene of a seed, with the paper's board.
    pub fn new(profile: Profile, seed: u64) -> Self {
        Self::drawn(profile, seed, USUAL)
    }

    /// The same with another board; `None` where that is not whole in every pose, or not crossed by every
    /// light plane.
    pub fn with_board(profile: Profile, seed: u64, board: BoardGeometry) -> Option<Self> {
        let scene = Self::drawn(profile, seed, board);
        if board == USUAL {
            return Some(scene);
        }
        let mut poses = scene.camera_poses.iter().chain(&scene.light_poses);
        let whole = poses.all(|pose| scene.whole(pose));
        let crossed = scene.light_poses.iter().all(|pose| scene.crossed(pose));
        (whole && crossed).then_some(scene)
    }

    fn drawn(profile: Profile, seed: u64, board: BoardGeometry) -> Self {
        let parameters = profile.parameters();
        let mut random = Random::new(seed, 1);
        let camera = random_camera(&mut random, &parameters);
        let psf_px = random.between(parameters.psf_px.0, parameters.psf_px.1);
        let laser = Laser::random(&mut Random::new(seed, 2));
        let hand = Hand::random(&mut Random::new(seed, 3));
        let skin = Skin::random(&mut Random::new(seed, 4), &parameters, &hand);
        let mut scene = Self {
            seed,
            profile,
            parameters,
            camera,
            psf_px,
            laser,
            board,
            camera_poses: Vec::new(),
            light_poses: Vec::new(),
            hand,
            skin,
        };
        let mut random = Random::new(seed, 5);
        scene.camera_poses = (0..parameters.camera_poses)
            .map(|i| scene.camera_pose(i, &mut random))
            .collect();
        let mut random = Random::new(seed, 6);
        scene.light_poses = (0..parameters.light_poses)
            .map(|i| scene.light_pose(i, &mut random))
            .collect();
        scene
    }

    /// Board and slide positions in mm that a light pose visits.
    pub fn light_positions(&self) -> Vec<f64> {
        even_positions(self.parameters.light_positions)
    }

    /// Slide positions of the scan, mm.
    pub fn scan_positions(&self) -> Vec<f64> {
        even_positions(self.parameters.scan_positions)
    }

    /// Board pose number i for the camera: the poses cover image and tilts in turn.
    fn camera_pose(&self, i: usize, random: &mut Random) -> Pose {
        // Where in the image (thirds), in an order that goes to the corners early.
        const PLACES: [(f64, f64); 9] = [
            (-1.0, -1.0),
            (1.0, 1.0),
            (1.0, -1.0),
            (-1.0, 1.0),
            (0.0, 0.0),
            (0.0, -1.0),
            (0.0, 1.0),
            (-1.0, 0.0),
            (1.0, 0.0),
        ];
        let (along, down) = PLACES[i % 9];
        let turn = i as f64 * 2.4; // golden angle: directions of tilt spread evenly
        for attempt in 0..400 {
            let ease = 1.0 - f64::from(attempt) / 400.0;
            let tilt = if i == 0 {
                3.0
            } else {
                random.between(8.0, 34.0)
            } * ease.max(0.3);
            let axis = turn + random.between(-0.4, 0.4);
            let z = random.between(400.0, 490.0);
            let half = (
                0.5 * f64::from(self.camera.width) / self.camera.fx * z,
                0.5 * f64::from(self.camera.height) / self.camera.fy * z,
            );
            let middle = Vector3::new(
                (along + random.between(-0.3, 0.3)) * 0.62 * ease * half.0,
                (down + random.between(-0.3, 0.3)) * 0.55 * ease * half.1,
                z,
            );
            let roll = random.between(-0.12, 0.12);
            let pose = self.pose(middle, tilt, axis, roll);
            if self.whole(&pose) {
                return pose;
            }
        }
        self.pose(Vector3::new(0.0, 0.0, 450.0), 0.0, 0.0, 0.0)
    }

    /// Board pose number i for the light planes: upright or on its side, at different depths, all
    /// slide positions crossing the pattern.
    fn light_pose(&self, i: usize, random: &mut Random) -> Pose {
        let upright = std::f64::consts::FRAC_PI_2 * if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        let depths = [415.0, 470.0, 430.0, 450.0, 400.0, 440.0];
        for attempt in 0..2000 {
            let ease = 1.0 - f64::from(attempt) / 2000.0;
            let z = depths[i % 6] * ease + 430.0 * (1.0 - ease) + random.between(-8.0, 8.0);
            // Where the sheet is half way along the slide.
            let plane = self.laser.plane(0.5 * TRAVEL_MM);
            let y = -(plane.normal.z * z + plane.d) / plane.normal.y;
            let middle = Vector3::new(
                random.between(-38.0, 38.0) * ease,
                y + random.between(-8.0, 8.0),
                z,
            );
            let pose = self.pose(
                middle,
                random.between(6.0, 28.0) * (0.3 + 0.7 * ease),
                i as f64 * 2.4 + random.between(-0.6, 0.6),
                upright + random.between(-0.15, 0.15),
            );
            if self.whole(&pose) && self.crossed(&pose) {
                return pose;
            }
        }
        self.pose(Vector3::new(0.0, -17.0, 430.0), 0.0, 0.0, upright)
    }

    /// A pose with the pattern's middle at a place, tilted by degrees about an axis in the image
    /// plane and turned by `roll` radians.
    fn pose(&self, middle: Vector3, tilt_deg: f64, axis: f64, roll: f64) -> Pose {
        let axis = nalgebra::Unit::new_normalize(Vector3::new(axis.cos(), axis.sin(), 0.0));
        let rotation = Rotation3::from_axis_angle(&axis, tilt_deg.to_radians())
            * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
        let s = self.board.square_mm;
        let centre = Vector3::new(
            0.5 * (self.board.columns - 1) as f64 * s,
            0.5 * (self.board.rows - 1) as f64 * s,
            0.0,
        );
        Pose {
            rotation,
            translation: middle - rotation * centre,
        }
    }

    /// Whether the whole plate is in the image.
    fn whole(&self, pose: &Pose) -> bool {
        let Some(target) = Target::new(self.board, *pose) else {
            return false;
        };
        let [x0, x1, y0, y1] = target.outline();
        let margin = 0.006 * f64::from(self.camera.width);
        [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
            .iter()
            .all(|&(x, y)| {
                self.camera
                    .project(&pose.apply(&Point3::new(x, y, 0.0)))
                    .is_some_and(|p| {
                        p.x > margin
                            && p.y > margin
                            && p.x < f64::from(self.camera.width) - 1.0 - margin
                            && p.y < f64::from(self.camera.height) - 1.0 - margin
                    })
            })
    }

    /// Whether every light plane draws a line on the board that is long enough.
    fn crossed(&self, pose: &Pose) -> bool {
        let long = |x: &f64| self.crossing_mm(pose, &self.laser.plane(*x)) > 45.0;
        self.light_positions().iter().all(long)
    }

    /// How long the light plane's line on the board's squares is, mm.
    fn crossing_mm(&self, pose: &Pose, plane: &Plane) -> f64 {
        let s = self.board.square_mm;
        let (x0, x1) = (-s, s * self.board.columns as f64);
        let (y0, y1) = (-s, s * self.board.rows as f64);
        // Distance from the plane over the board: d + g·(x, y).
        let d = plane.distance(&Point3::from(pose.translation));
        let g = pose.rotation.inverse_transform_vector(&plane.normal);
        let mut ends: Vec<(f64, f64)> = Vec::new();
        for x in [x0, x1] {
            let y = -(d + g.x * x) / g.y;
            if (y0..=y1).contains(&y) {
                ends.push((x, y));
            }
        }
        for y in [y0, y1] {
            let x = -(d + g.y * y) / g.x;
            if (x0..=x1).contains(&x) {
                ends.push((x, y));
            }
        }
        match ends.as_slice() {
            [a, b, ..] => (a.0 - b.0).hypot(a.1 - b.1),
            _ => 0.0,
        }
    }
}

/// n positions from 0 to [`TRAVEL_MM`].
fn even_positions(n: usize) -> Vec<f64> {
    (0..n)
        .map(|i| TRAVEL_MM * i as f64 / (n.max(2) - 1) as f64)
        .collect()
}

fn random_camera(random: &mut Random, parameters: &Parameters) -> Camera {
    let scale = f64::from(parameters.width) / 1280.0;
    let fx = parameters.focal_px * (1.0 + random.between(-0.01, 0.01));
    Camera {
        width: parameters.width,
        height: parameters.height,
        fx,
        fy: fx * (1.0 + random.between(-0.005, 0.005)),
        u0: 0.5 * f64::from(parameters.width) + scale * random.between(-20.0, 20.0),
        v0: 0.5 * f64::from(parameters.height) + scale * random.between(-15.0, 15.0),
        distortion: Distortion {
            k1: random.between(-0.16, 0.13),
            k2: random.between(-0.2, 0.2),
            p1: random.between(-7e-4, 7e-4),
            p2: random.between(-7e-4, 7e-4),
            k3: random.between(-0.3, 0.3),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_whole_and_crossed_by_every_light_plane() {
        for seed in 0..20 {
            let scene = Scene::new(Profile::Tiny, seed);
            for pose in scene.camera_poses.iter().chain(&scene.light_poses) {
                assert!(scene.whole(pose), "seed {seed}");
            }
            for pose in &scene.light_poses {
                for x in scene.light_positions() {
                    assert!(
                        scene.crossing_mm(pose, &scene.laser.plane(x)) > 45.0,
                        "seed {seed}, {x} mm"
                    );
                }
            }
        }
    }

    #[test]
    fn another_board_is_shown_if_it_can_be() {
        let board = |columns, rows, square_mm| BoardGeometry {
            columns,
            rows,
            square_mm,
        };
        let shown = |b| Scene::with_board(Profile::Tiny, 3, b).map(|s| s.board);
        for b in [board(9, 6, 8.0), board(8, 5, 10.0)] {
            assert_eq!(shown(b), Some(b));
        }
        // Larger than the image; smaller than the line that the planes need.
        for b in [board(20, 16, 10.0), board(4, 3, 4.0)] {
            assert_eq!(shown(b), None);
        }
        // The same as ever with the board that is the usual one.
        let (usual, given) = (
            Scene::new(Profile::Tiny, 3),
            Scene::with_board(Profile::Tiny, 3, board(8, 6, 10.0)).unwrap(),
        );
        assert_eq!(usual.light_poses, given.light_poses);
    }

    #[test]
    fn a_is_what_slide_and_screw_make_of_it() {
        let laser = Scene::new(Profile::Nominal, 7).laser;
        // A point fixed to the sheet moves by screw·travel for each nominal mm.
        let p = laser
            .plane(0.0)
            .meet(&Vector3::new(0.01, -0.02, 1.0))
            .unwrap();
        let moved = p + laser.travel * laser.screw * 25.0;
        assert!(laser.plane(25.0).distance(&moved).abs() < 1e-9);
    }
}
