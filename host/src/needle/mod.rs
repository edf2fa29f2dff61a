//! The plane at the entry, the needle's axis and path (paper, Section 2.4; Eq. 12–19).
//!
//! The entry pixel's ray meets the measured surface ([`surface`]); the plane is fitted to all of
//! the surface within `radius_mm` of that point, each piece weighted by its area ([`plane`]); the
//! vein's pixels meet the surface likewise, smoothed more broadly, and their line is laid into the plane along its normal
//! ([`axis`]). Every result carries the covariance of calibration, stripe and sampling
//! ([`uncertainty`]). [`decide`] does it all, or says with numbers why it will not.

pub mod axis;
mod error;
pub mod plane;
#[cfg(test)]
mod scene;
pub mod surface;
pub mod uncertainty;

pub use axis::{NeedleAxis, Path, angle};
pub use error::NeedleError;
pub use uncertainty::Uncertainty;

use crate::calibration::RigModel;
use crate::cloud::CloudPoint;
use crate::geometry::{Plane, Point3, Vector2, Vector3};
use plane::PlaneFit;
use surface::{Interpolation, Surface};

/// What the vein-imaging stage asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct EntryRequest {
    /// The entry pixel.
    pub pixel: Vector2,
    /// Pixels along the vein, in the direction in which the needle is to advance.
    pub vein: Vec<Vector2>,
    /// Radius of the region to which the plane is fitted, mm.
    pub radius_mm: f64,
}

/// How the plane is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlaneMethod {
    /// Orthogonal distances over the interpolated surface, weighted by area.
    #[default]
    Area,
    /// Eq. 15: least squares of z = a·x + b·y + c over the points as they come; the entry and the
    /// vein lie on the plane (the paper's way).
    Paper,
}

/// What is asked of a region before an angle is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Fewest points in the region.
    pub points: usize,
    /// Fewest stripes across it.
    pub stripes: usize,
    /// Widest gap between stripes that is bridged, mm (but at least 2.6 of their usual spacing).
    pub gap_mm: f64,
    /// Least part of the region's disc that is covered by measured surface.
    pub coverage: f64,
    /// Largest root mean square distance of the surface from the plane, as a part of the radius.
    pub roughness: f64,
    /// Largest standard deviation of the needle's angle to the plane, rad.
    pub angle_sigma: f64,
    /// Largest standard deviation of the entry point, mm.
    pub entry_sigma_mm: f64,
    /// Largest angle between the plane's normal and the line of sight, rad.
    pub obliquity: f64,
    /// Smallest angle between light plane and surface, rad. A scan whose positions are in too large
    /// a unit seems to lie in the light plane itself.
    pub grazing: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            points: 60,
            stripes: 4,
            gap_mm: 3.0,
            coverage: 0.8,
            roughness: 0.09,
            angle_sigma: 1f64.to_radians(),
            entry_sigma_mm: 1.0,
            obliquity: 75f64.to_radians(),
            grazing: 25f64.to_radians(),
        }
    }
}

/// What a decision is made with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How the plane is fitted.
    pub method: PlaneMethod,
    /// The wanted angle between needle and plane, rad.
    pub angle: f64,
    /// How far before the entry the path begins, mm.
    pub stand_off_mm: f64,
    /// How deep under the plane it ends, mm.
    pub depth_mm: f64,
    /// Part of the stripe centre's error that a whole stripe shares (glow, profile asymmetry), px.
    pub stripe_bias_px: f64,
    /// When to refuse.
    pub limits: Limits,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            method: PlaneMethod::Area,
            angle: 30f64.to_radians(),
            stand_off_mm: 30.0,
            depth_mm: 3.25,
            stripe_bias_px: 0.008,
            limits: Limits::default(),
        }
    }
}

/// Where and how the needle goes in.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// The plane of the entry region, its normal away from the camera.
    pub plane: Plane,
    /// Points of the cloud in the region.
    pub points: usize,
    /// Stripes across the region.
    pub stripes: usize,
    /// Root mean square distance from the plane: of the surface, or of the points in the paper's
    /// way, mm.
    pub rms_mm: f64,
    /// Part of the region's disc that the measured surface covers.
    pub coverage: f64,
    /// Where the entry pixel's ray meets the measured surface (or the plane, in the paper's way).
    pub entry: Point3,
    /// The vein's points on the surface, as far as the surface was measured there.
    pub vein: Vec<Point3>,
    /// The vein's direction in the plane, unit.
    pub direction: Vector3,
    /// The needle.
    pub needle: NeedleAxis,
    /// How sure all this is.
    pub uncertainty: Uncertainty,
}

impl Decision {
    /// The plane as z = a·x + b·y + c (Eq. 14).
    pub fn abc(&self) -> [f64; 3] {
        let n = self.plane.normal;
        [-n.x / n.z, -n.y / n.z, -self.plane.d / n.z]
    }
}

/// From cloud and request to the needle.
///
/// # Errors
/// [`NeedleError`] with the number that broke a limit.
pub fn decide(
    cloud: &[CloudPoint],
    rig: &RigModel,
    request: &EntryRequest,
    settings: &Settings,
) -> Result<Decision, NeedleError> {
    let limits = &settings.limits;
    let ray = rig.camera.ray(&request.pixel).ok_or(NeedleError::NoRay)?;
    let start = surface::near(cloud, &request.pixel, &ray)?;
    let frame = local_frame(cloud, &start, request.radius_mm, rig, limits)?;
    let reach = reach(cloud, request, &start);
    let build = |smooth| {
        Surface::build(
            cloud,
            &frame,
            request.radius_mm,
            reach,
            limits.gap_mm,
            smooth,
        )
    };
    let (surface, broad) = (build(surface::FINE_MM), build(surface::BROAD_MM));
    let paper = settings.method == PlaneMethod::Paper;

    // In the paper's way the region is centred on the same point; only the fit differs.
    let met = surface.meet(&ray, Interpolation::Cubic)?;
    let region: Vec<&CloudPoint> = cloud
        .iter()
        .filter(|p| (p.position - met).norm() <= request.radius_mm)
        .collect();
    let stripes = frames(&region);
    if region.len() < limits.points || stripes < limits.stripes {
        return Err(NeedleError::TooFewPoints {
            points: region.len(),
            stripes,
            needed_points: limits.points,
            needed_stripes: limits.stripes,
        });
    }
    let patch = surface.patch(&met, request.radius_mm, Interpolation::Cubic);
    if !(patch.coverage >= limits.coverage) {
        return Err(NeedleError::NotCovered {
            coverage: patch.coverage,
            needed: limits.coverage,
        });
    }
    let area = PlaneFit::new(&patch.cells).ok_or(NeedleError::Degenerate)?;
    if !(area.rms_mm <= limits.roughness * request.radius_mm) {
        return Err(NeedleError::NotFlat {
            rms_mm: area.rms_mm,
            limit_mm: limits.roughness * request.radius_mm,
        });
    }
    let (plane, rms_mm) = if paper {
        plane::least_squares(region.iter().map(|p| &p.position)).ok_or(NeedleError::Degenerate)?
    } else {
        (area.plane, area.rms_mm)
    };
    let sight = met
        .coords
        .normalize()
        .dot(&plane.normal)
        .clamp(-1.0, 1.0)
        .acos();
    if !(sight <= limits.obliquity) {
        return Err(NeedleError::Oblique {
            angle_deg: sight.to_degrees(),
            limit_deg: limits.obliquity.to_degrees(),
        });
    }
    let meet = |surface: &Surface, ray: &Vector3| -> Option<Point3> {
        if paper {
            plane.meet(ray)
        } else {
            surface.meet(ray, Interpolation::Cubic).ok()
        }
    };
    let rays: Vec<Vector3> = request
        .vein
        .iter()
        .filter_map(|p| rig.camera.ray(p))
        .collect();
    let on = |surface| -> Vec<Point3> { rays.iter().filter_map(|r| meet(surface, r)).collect() };
    let (vein, course) = (on(&surface), on(&broad));
    let line = axis::line(&course).ok_or(NeedleError::NoVein {
        met: course.len(),
        given: request.vein.len(),
    })?;
    let direction = axis::into_plane(&line, &plane.normal).ok_or(NeedleError::NoVein {
        met: course.len(),
        given: request.vein.len(),
    })?;
    let entry = if paper {
        plane.meet(&ray).ok_or(NeedleError::Degenerate)?
    } else {
        met
    };

    // The same once more with straight lines between the stripes: how much hangs on what was not
    // measured.
    let coarse = coarse(&surface, &broad, &ray, &rays, request.radius_mm);
    let needle = NeedleAxis::new(&plane, &direction, &entry, settings);
    let uncertainty = uncertainty::propagate(&uncertainty::Inputs {
        surface: &surface,
        patch: &patch,
        broad: &broad,
        fit: &area,
        entry: &met,
        radius_mm: request.radius_mm,
        vein: &course,
        line: &line,
        plane: &plane,
        angle: settings.angle,
        rig,
        coarse,
        stripe_bias_px: settings.stripe_bias_px,
    });
    if !(uncertainty.angle_sigma <= limits.angle_sigma)
        || !(uncertainty.entry_sigma_mm() <= limits.entry_sigma_mm)
    {
        return Err(NeedleError::TooUncertain {
            angle_deg: uncertainty.angle_sigma.to_degrees(),
            angle_limit_deg: limits.angle_sigma.to_degrees(),
            entry_mm: uncertainty.entry_sigma_mm(),
            entry_limit_mm: limits.entry_sigma_mm,
        });
    }
    Ok(Decision {
        plane,
        points: region.len(),
        stripes,
        rms_mm,
        coverage: patch.coverage,
        entry,
        vein,
        direction,
        needle,
        uncertainty,
    })
}

/// Normal, entry and vein line with straight interpolation.
fn coarse(
    surface: &Surface,
    broad: &Surface,
    ray: &Vector3,
    vein: &[Vector3],
    radius_mm: f64,
) -> Option<(Vector3, Point3, Vector3)> {
    let entry = surface.meet(ray, Interpolation::Linear).ok()?;
    let patch = surface.patch(&entry, radius_mm, Interpolation::Linear);
    let fit = PlaneFit::new(&patch.cells)?;
    let points: Vec<Point3> = vein
        .iter()
        .filter_map(|r| broad.meet(r, Interpolation::Linear).ok())
        .collect();
    Some((fit.plane.normal, entry, axis::line(&points)?))
}

fn frames(points: &[&CloudPoint]) -> usize {
    let mut frames: Vec<u32> = points.iter().map(|p| p.frame).collect();
    frames.sort_unstable();
    frames.dedup();
    frames.len()
}

/// The frame in which the surface is written as a height: from the points around `start`.
fn local_frame(
    cloud: &[CloudPoint],
    start: &Point3,
    radius_mm: f64,
    rig: &RigModel,
    limits: &Limits,
) -> Result<surface::LocalFrame, NeedleError> {
    let near: Vec<&CloudPoint> = cloud
        .iter()
        .filter(|p| (p.position - start).norm() <= radius_mm)
        .collect();
    let stripes = frames(&near);
    if near.len() < limits.points.min(12) || stripes < limits.stripes.min(3) {
        return Err(NeedleError::TooFewPoints {
            points: near.len(),
            stripes,
            needed_points: limits.points,
            needed_stripes: limits.stripes,
        });
    }
    let cells: Vec<plane::Cell> = near
        .iter()
        .map(|p| plane::Cell {
            position: p.position,
            area: 1.0,
        })
        .collect();
    let rough = PlaneFit::new(&cells).ok_or(NeedleError::Degenerate)?;
    let between = rig.light.normal.cross(&rough.plane.normal).norm();
    if !(between >= limits.grazing.sin()) {
        return Err(NeedleError::Grazing {
            angle_deg: between.min(1.0).asin().to_degrees(),
            limit_deg: limits.grazing.to_degrees(),
        });
    }
    // Along the stripe: where the light plane cuts the surface's plane.
    let along = rig.light.normal.cross(&rough.plane.normal).normalize();
    Ok(surface::LocalFrame {
        origin: *start,
        along,
        across: rough.plane.normal.cross(&along),
        normal: rough.plane.normal,
    })
}

/// How far from the start the surface is needed: the region and the vein's pixels.
fn reach(cloud: &[CloudPoint], request: &EntryRequest, start: &Point3) -> f64 {
    let farthest = request
        .vein
        .iter()
        .filter_map(|v| {
            cloud.iter().min_by(|a, b| {
                (a.pixel - v)
                    .norm_squared()
                    .total_cmp(&(b.pixel - v).norm_squared())
            })
        })
        .map(|p| (p.position - start).norm())
        .fold(0.0, f64::max);
    farthest.clamp(request.radius_mm, 3.0 * request.radius_mm)
}
