//! Triangulation: the ray of a stripe pixel meets the light plane at D(x) (paper, Eq. 3–5, 9).
//!
//! P = Z·(x, y, 1) with (x, y) the undistorted pixel and Z = −D(x)/(n·(x, y, 1)). A centre that is
//! off by δ pixels across the stripe moves P in the light plane (`shift`), its depth along the ray
//! by |∂Z/∂δ|·|(x, y, 1)|: with the centre's standard deviation that is the point's `sigma_mm`. Its error from the calibration is common to all points and is not in there.

mod export;
mod import;

pub use export::{write_csv, write_ply, write_xyz};
pub use import::read_ply;

use crate::calibration::RigModel;
use crate::geometry::{Point3, Vector2, Vector3};
use crate::stripe::StripePoint;

/// A measured point on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// Position in the camera frame, mm.
    pub position: Point3,
    /// The stripe pixel that it comes from.
    pub pixel: Vector2,
    /// Index of the scan frame.
    pub frame: u32,
    /// Brightness of the stripe there.
    pub intensity: f32,
    /// Standard deviation of the point along its ray from the stripe's centre alone, mm.
    pub sigma_mm: f32,
    /// How it moves (in the light plane) when its centre moves by a pixel across the stripe, away
    /// from the camera, mm/px.
    pub shift: Vector3,
    /// How many neighbours along the stripe share one error (1: none).
    pub correlation: f32,
    /// As of the stripe point.
    pub quality: f32,
}

/// Why a stripe point gave no point in space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// The lens model has no inverse at the pixel.
    pub no_ray: usize,
    /// The ray does not meet the light plane in front of the camera.
    pub no_meeting: usize,
}

/// Triangulates the stripe of one frame and appends its points to `cloud`; `correlation` as of the
/// stripe's segment.
pub fn triangulate(
    points: &[StripePoint],
    correlation: f64,
    frame: u32,
    slide_mm: f64,
    rig: &RigModel,
    cloud: &mut Vec<CloudPoint>,
) -> Lost {
    let plane = rig.light.plane(slide_mm);
    let camera = &rig.camera;
    let mut lost = Lost::default();
    cloud.reserve(points.len());
    for p in points {
        let Some(ray) = camera.ray(&p.pixel) else {
            lost.no_ray += 1;
            continue;
        };
        let Some(position) = plane.meet(&ray) else {
            lost.no_meeting += 1;
            continue;
        };
        // δray for one pixel across the stripe, through the inverse of Eq. 2's derivative.
        let step = Vector2::new(p.across.x / camera.fx, p.across.y / camera.fy);
        let slope = camera
            .distortion
            .jacobian(ray.x, ray.y)
            .lu()
            .solve(&step)
            .unwrap_or(step);
        // Z·ray with n·(Z·ray) constant: δP = Z·δray + ray·δZ.
        let sideways = Vector3::new(slope.x, slope.y, 0.0) * position.z;
        let shift = sideways - ray * (plane.normal.dot(&sideways) / plane.normal.dot(&ray));
        let shift = if shift.z < 0.0 { -shift } else { shift };
        let sigma = shift.z * ray.norm() * p.variance.max(0.0).sqrt();
        if !sigma.is_finite() {
            lost.no_meeting += 1;
            continue;
        }
        cloud.push(CloudPoint {
            position,
            pixel: p.pixel,
            frame,
            intensity: p.intensity,
            sigma_mm: sigma as f32,
            shift,
            correlation: correlation.max(1.0) as f32,
            quality: p.quality,
        });
    }
    lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::rig;

    fn stripe_point(pixel: Vector2, variance: f64) -> StripePoint {
        StripePoint {
            pixel,
            across: Vector2::new(0.1, 1.0).normalize(),
            variance,
            intensity: 100.0,
            width_px: 2.5,
            quality: 1.0,
        }
    }

    #[test]
    fn points_on_a_light_plane_come_back() {
        let rig = rig();
        for slide in [0.0, 17.0, 60.0] {
            let plane = rig.light.plane(slide);
            for (x, y) in [(-40.0, -20.0), (0.0, 0.0), (35.0, 12.0)] {
                let z = -(plane.d + plane.normal.x * x + plane.normal.y * y) / plane.normal.z;
                let truth = Point3::new(x, y, z);
                let pixel = rig.camera.project(&truth).unwrap();
                let mut cloud = Vec::new();
                let lost = triangulate(
                    &[stripe_point(pixel, 0.01)],
                    3.0,
                    5,
                    slide,
                    &rig,
                    &mut cloud,
                );
                assert_eq!(lost, Lost::default());
                assert!((cloud[0].position - truth).norm() < 1e-8);
                assert_eq!(cloud[0].frame, 5);
                // The standard deviation is what a shift of the centre by its own does.
                let mut moved = Vec::new();
                let p = stripe_point(pixel, 0.01);
                let h = 1e-4;
                for sign in [-1.0, 1.0] {
                    let shifted = stripe_point(pixel + p.across * (sign * h), 0.01);
                    triangulate(&[shifted], 1.0, 5, slide, &rig, &mut moved);
                }
                let by_difference = (moved[1].position.z - moved[0].position.z).abs() / (2.0 * h)
                    * (truth.coords.norm() / truth.z)
                    * 0.1;
                let sigma = f64::from(cloud[0].sigma_mm);
                assert!(
                    (sigma / by_difference - 1.0).abs() < 1e-5,
                    "{sigma} {by_difference}"
                );
            }
        }
    }

    #[test]
    fn a_ray_along_the_plane_is_counted_as_lost() {
        let mut rig = rig();
        rig.light.normal = Vector3::y();
        rig.light.b = -10.0;
        rig.light.a = 0.0;
        // Above the horizon of that plane: met behind the camera only.
        let mut cloud = Vec::new();
        let lost = triangulate(
            &[stripe_point(Vector2::new(640.0, 100.0), 0.01)],
            1.0,
            0,
            0.0,
            &rig,
            &mut cloud,
        );
        assert_eq!((lost.no_meeting, cloud.len()), (1, 0));
    }
}
