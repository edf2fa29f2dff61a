//! Triangulation: the ray of a stripe pixel meets the light plane at D(x) (paper, Eq. 3–5, 9, 11).

use crate::geometry::{Point3, Vector2};

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
    /// As of the stripe point.
    pub quality: f32,
}
