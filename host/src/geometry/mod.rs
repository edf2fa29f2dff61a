//! Cameras, poses, planes, rays: the mathematics that every stage shares. Knows no images.

mod camera;
mod homography;
mod plane;
mod pose;

pub use camera::{Camera, Distortion, PARAMETERS, ProjectionJacobian};
pub use homography::{Homography, HomographyError};
pub use plane::{Plane, tangent_basis};
pub use pose::Pose;

/// A point in space, mm.
pub type Point3 = nalgebra::Point3<f64>;
/// A direction or displacement in space.
pub type Vector3 = nalgebra::Vector3<f64>;
/// A pixel position (u, v) or a displacement in the image.
pub type Vector2 = nalgebra::Vector2<f64>;
/// 2 × 2, e.g. the covariance of a pixel position, px².
pub type Matrix2 = nalgebra::Matrix2<f64>;
/// 3 × 3, e.g. the covariance of a point, mm².
pub type Matrix3 = nalgebra::Matrix3<f64>;
