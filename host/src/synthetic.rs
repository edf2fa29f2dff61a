//! Made-up rigs with known truth, for tests and benches: exact projections plus noise.

use crate::board::{BoardGeometry, Corner};
use crate::calibration::light::BoardStripe;
use crate::calibration::{Covariance, LightModel, RigModel};
use crate::geometry::{Camera, Distortion, Matrix2, Point3, Pose, Vector2, Vector3};
use crate::stripe::StripePoint;
use nalgebra::Rotation3;

/// SplitMix64 with normal deviates: repeatable on every machine.
pub struct Noise(pub u64);

impl Noise {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn normal(&mut self) -> f64 {
        let r = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        r * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

pub const BOARD: BoardGeometry = BoardGeometry {
    columns: 8,
    rows: 6,
    square_mm: 10.0,
};

/// The made-up rig's camera.
pub fn camera() -> Camera {
    Camera {
        width: 1280,
        height: 960,
        fx: 2197.8,
        fy: 2204.8,
        u0: 626.6,
        v0: 487.3,
        distortion: Distortion {
            k1: -0.144,
            k2: -0.039,
            p1: -0.0006,
            p2: -0.0003,
            k3: -0.295,
        },
    }
}

/// The same without distortion.
pub fn pinhole() -> Camera {
    Camera {
        distortion: Distortion::default(),
        ..camera()
    }
}

/// Camera and light planes, known exactly.
pub fn rig() -> RigModel {
    RigModel {
        camera: camera(),
        light: light(),
        covariance: Covariance::zeros(),
    }
}

/// A pose whose board middle appears at `pixel` at depth `z`, turned by `rotation`.
pub fn pose_at(camera: &Camera, pixel: Vector2, z: f64, rotation: Vector3) -> Pose {
    let rotation = Rotation3::new(rotation);
    let middle = Point3::from(camera.ray(&pixel).unwrap() * z);
    let half = (BOARD.point(0).coords + BOARD.point(BOARD.corners() - 1).coords) / 2.0;
    Pose {
        rotation,
        translation: middle.coords - rotation * half,
    }
}

/// Whether the whole board lies in the image.
pub fn visible(camera: &Camera, pose: &Pose) -> bool {
    (0..BOARD.corners()).all(|i| {
        camera
            .project(&pose.apply(&BOARD.point(i)))
            .is_some_and(|p| camera.contains(&p))
    })
}

/// Poses for Zhang's method: tilted up to `tilt` radians about any axis, spread over the image.
pub fn poses(camera: &Camera, n: usize, tilt: f64, noise: &mut Noise) -> Vec<Pose> {
    let mut out = Vec::new();
    while out.len() < n {
        let pixel = Vector2::new(noise.between(250.0, 1030.0), noise.between(220.0, 740.0));
        let axis = noise.between(0.0, std::f64::consts::TAU);
        let angle = noise.between(0.5 * tilt, tilt);
        let turn = Vector3::new(
            angle * axis.cos(),
            angle * axis.sin(),
            noise.between(-0.5, 0.5),
        );
        let pose = pose_at(camera, pixel, noise.between(380.0, 520.0), turn);
        if visible(camera, &pose) {
            out.push(pose);
        }
    }
    out
}

/// The corners of a pose with noise of `sigma` px, told to have `sigma` as well.
pub fn corners(camera: &Camera, pose: &Pose, sigma: f64, noise: &mut Noise) -> Vec<Corner> {
    (0..BOARD.corners())
        .map(|i| Corner {
            pixel: camera.project(&pose.apply(&BOARD.point(i))).unwrap()
                + Vector2::new(noise.normal(), noise.normal()) * sigma,
            covariance: Matrix2::identity() * sigma.max(1e-3).powi(2),
        })
        .collect()
}

/// The light planes of the made-up rig.
pub fn light() -> LightModel {
    LightModel {
        normal: Vector3::new(0.0238, -0.8793, 0.4757).normalize(),
        a: -0.99993,
        b: -189.508,
    }
}

/// Errors of made-up stripes.
#[derive(Clone, Copy)]
pub struct StripeErrors {
    /// Of each centre, px (and told so).
    pub centre: f64,
    /// Of the slide at each visit, mm.
    pub slide: f64,
    /// A second error of the centres, correlated over `correlation` px along the stripe, px.
    pub speckle: f64,
    pub correlation: f64,
}

/// Poses at which the board faces the camera and crosses all light planes: about 45° to them.
pub fn light_poses(camera: &Camera, n: usize, noise: &mut Noise) -> Vec<Pose> {
    let mut out = Vec::new();
    while out.len() < n {
        let pixel = Vector2::new(noise.between(560.0, 720.0), noise.between(380.0, 480.0));
        // The long side down the image, along the travel of the stripe.
        let tilt = Vector3::new(noise.between(-0.5, 0.5), noise.between(-0.4, 0.4), 0.0);
        let turn = Rotation3::new(Vector3::z() * noise.between(1.4, 1.75));
        let turn = (Rotation3::new(tilt) * turn).scaled_axis();
        let pose = pose_at(camera, pixel, noise.between(405.0, 460.0), turn);
        if visible(camera, &pose) {
            out.push(pose);
        }
    }
    out
}

/// The stripe of a light plane on the board: points a pixel apart within the board's squares.
pub fn stripe(
    camera: &Camera,
    light: &LightModel,
    slide_mm: f64,
    pose: &Pose,
    errors: &StripeErrors,
    noise: &mut Noise,
) -> BoardStripe {
    let plane = light.plane(slide_mm + errors.slide * noise.normal());
    // In the board's frame: a line (x, y) with gx·x + gy·y + d = 0.
    let g = pose.rotation.inverse_transform_vector(&plane.normal);
    let d = plane.normal.dot(&pose.translation) + plane.d;
    let foot = Vector2::new(g.x, g.y) * (-d / g.xy().norm_squared());
    let along = Vector2::new(-g.y, g.x).normalize();
    let mut points = Vec::new();
    let mut speckle = errors.speckle * noise.normal();
    let keep = (-1.0 / errors.correlation.max(1e-9)).exp();
    for i in -800..800 {
        let at = foot + along * (0.2 * f64::from(i));
        let inside = (-9.0..79.0).contains(&at.x) && (-9.0..59.0).contains(&at.y);
        if !inside {
            continue;
        }
        let pixel = camera
            .project(&pose.apply(&Point3::new(at.x, at.y, 0.0)))
            .unwrap();
        if !camera.contains(&pixel) {
            continue;
        }
        speckle = keep * speckle + (1.0 - keep * keep).sqrt() * errors.speckle * noise.normal();
        let across = Vector2::y();
        points.push(StripePoint {
            pixel: pixel + across * (errors.centre * noise.normal() + speckle),
            across,
            variance: errors.centre.max(1e-3).powi(2),
            intensity: 100.0,
            width_px: 2.0,
            quality: 1.0,
        });
    }
    BoardStripe { slide_mm, points }
}
