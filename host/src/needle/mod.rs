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
mod weigh;

pub use axis::{NeedleAxis, Path, angle};
pub use error::NeedleError;
pub use uncertainty::Uncertainty;

use crate::calibration::RigModel;
use crate::checks::{Check, Limit};
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
    /// The part below which the region is called cut off.
    pub whole: f64,
    /// Largest root mean square distance of the surface from the plane, as a part of the radius.
    pub roughness: f64,
    /// The same from which the region is called curved: as a cylinder whose slope turns by 1.1° a
    /// millimetre where the radius is 12 mm.
    pub curved: f64,
    /// Difference of the needle's angles to the region's plane and to that of half the radius from
    /// which the angle is said to hang on the radius, rad.
    pub turn: f64,
    /// Least length of the vein as given, mm.
    pub vein_mm: f64,
    /// How far its line may pass beside the entry, and its points beside the line, mm.
    pub beside_mm: f64,
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
            coverage: 0.9,
            whole: 0.98,
            roughness: 0.09,
            curved: 0.03,
            turn: 1f64.to_radians(),
            vein_mm: 2.0,
            beside_mm: 2.0,
            angle_sigma: 1f64.to_radians(),
            entry_sigma_mm: 1.0,
            obliquity: 75f64.to_radians(),
            grazing: 25f64.to_radians(),
        }
    }
}

/// Parts of the region's radius at which the angle is looked at again.
pub const SMALLER: [f64; 3] = [0.75, 0.5, 1.0 / 3.0];
/// The smallest radius at which it is, mm: four stripes of a scan in 2 mm steps.
pub const LEAST_RADIUS_MM: f64 = 4.0;

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
    /// Radius of the cylinder whose surface would be as far from its plane, mm; infinite for a flat
    /// region.
    pub bend_mm: f64,
    /// The needle's angle to the plane of half the region's radius, rad. `None` where that has no
    /// plane.
    pub inner_angle: Option<f64>,
    /// The smaller radius, mm, to whose plane the needle's angle differs most, and that angle, rad:
    /// how much the angle hangs on the radius. `None` where half the radius has no plane.
    pub turned: Option<(f64, f64)>,
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
    /// Every check that was made on the way.
    pub checks: Vec<Check>,
}

impl Decision {
    /// The plane as z = a·x + b·y + c (Eq. 14).
    pub fn abc(&self) -> [f64; 3] {
        let n = self.plane.normal;
        [-n.x / n.z, -n.y / n.z, -self.plane.d / n.z]
    }

    /// How far the needle's angle changes at most if the plane is fitted within a smaller radius
    /// ([`SMALLER`], and [`LEAST_RADIUS_MM`]), rad: what is known of the model's error, that a hand
    /// is no plane. `None` where half the radius has no plane.
    pub fn radius_change(&self) -> Option<f64> {
        Some(self.turned?.1 - self.needle.angle)
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
    let mut checks = Vec::new();
    let mut decision = decide_noting(cloud, rig, request, settings, &mut checks)?;
    decision.checks = checks;
    Ok(decision)
}

/// The same, with the checks made on the way in `checks` rather than in the decision: they are known
/// of a refusal, too.
///
/// # Errors
/// As of [`decide`].
pub fn decide_noting(
    cloud: &[CloudPoint],
    rig: &RigModel,
    request: &EntryRequest,
    settings: &Settings,
    checks: &mut Vec<Check>,
) -> Result<Decision, NeedleError> {
    let limits = &settings.limits;
    let ray = rig.camera.ray(&request.pixel).ok_or(NeedleError::NoRay)?;
    let start = surface::near(cloud, &request.pixel, &ray)?;
    let mut holds = |what: &str, value: f64, limit: Limit, unit: &str| {
        let check = Check::held(what, value, limit, unit).refused_beyond(limit);
        let sound = check.sound();
        checks.push(check);
        sound
    };
    let (frame, grazing) = local_frame(cloud, &start, request.radius_mm, rig, limits)?;
    holds(
        "region: angle between light plane and surface",
        grazing.to_degrees(),
        Limit::AtLeast(limits.grazing.to_degrees()),
        "°",
    );
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
    let enough = holds(
        "region: points",
        region.len() as f64,
        Limit::AtLeast(limits.points as f64),
        "",
    );
    let across = holds(
        "region: stripes",
        stripes as f64,
        Limit::AtLeast(limits.stripes as f64),
        "",
    );
    if !(enough && across) {
        return Err(NeedleError::TooFewPoints {
            points: region.len(),
            stripes,
            needed_points: limits.points,
            needed_stripes: limits.stripes,
        });
    }
    let patch = surface.patch(&met, request.radius_mm, Interpolation::Cubic);
    let covered = holds(
        "region: part covered by measured surface",
        100.0 * patch.coverage,
        Limit::AtLeast(100.0 * limits.coverage),
        "%",
    );
    if !covered {
        return Err(NeedleError::NotCovered {
            coverage: patch.coverage,
            needed: limits.coverage,
        });
    }
    let area = PlaneFit::new(&patch.cells).ok_or(NeedleError::Degenerate)?;
    let flat = holds(
        "region: RMS distance from its plane, refused",
        area.rms_mm,
        Limit::AtMost(limits.roughness * request.radius_mm),
        "mm",
    );
    if !flat {
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
    let facing = holds(
        "region: angle between normal and line of sight",
        sight.to_degrees(),
        Limit::AtMost(limits.obliquity.to_degrees()),
        "°",
    );
    if !facing {
        return Err(NeedleError::Oblique {
            angle_deg: sight.to_degrees(),
            limit_deg: limits.obliquity.to_degrees(),
        });
    }
    let rays: Vec<Vector3> = request
        .vein
        .iter()
        .filter_map(|p| rig.camera.ray(p))
        .collect();
    let on = |surface: &Surface| -> Vec<Point3> {
        let met = |ray| surface.meet(ray, Interpolation::Cubic).ok();
        rays.iter().filter_map(met).collect()
    };
    let (vein, course) = if paper {
        let met: Vec<Point3> = rays.iter().filter_map(|ray| plane.meet(ray)).collect();
        (met.clone(), met)
    } else {
        (on(&surface), on(&broad))
    };
    let line = axis::line(&course).ok_or(NeedleError::NoVein {
        met: course.len(),
        given: request.vein.len(),
    })?;
    let length = axis::length(&course, &line);
    let long = holds(
        "vein: length given",
        length,
        Limit::AtLeast(limits.vein_mm),
        "mm",
    );
    if !long {
        return Err(NeedleError::ShortVein {
            length_mm: length,
            least_mm: limits.vein_mm,
        });
    }
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
        filled: surface
            .filled(&patch)
            .and_then(|cells| Some(PlaneFit::new(&cells)?.plane.normal)),
        stripe_bias_px: settings.stripe_bias_px,
    });
    let angle = holds(
        "needle angle: σ",
        uncertainty.angle_sigma.to_degrees(),
        Limit::AtMost(limits.angle_sigma.to_degrees()),
        "°",
    );
    let place = holds(
        "entry: σ",
        uncertainty.entry_sigma_mm(),
        Limit::AtMost(limits.entry_sigma_mm),
        "mm",
    );
    if !(angle && place) {
        return Err(NeedleError::TooUncertain {
            angle_deg: uncertainty.angle_sigma.to_degrees(),
            angle_limit_deg: limits.angle_sigma.to_degrees(),
            entry_mm: uncertainty.entry_sigma_mm(),
            entry_limit_mm: limits.entry_sigma_mm,
        });
    }
    let within = |radius: f64| {
        let inner = surface.patch(&met, radius, Interpolation::Cubic);
        let sine = PlaneFit::new(&inner.cells)?.plane.normal.dot(&needle.axis);
        Some(sine.clamp(-1.0, 1.0).asin())
    };
    let half = 0.5 * request.radius_mm;
    let parts = SMALLER.map(|part| part * request.radius_mm);
    let smaller = parts.into_iter().chain([LEAST_RADIUS_MM]);
    let smaller =
        smaller.filter(|r| *r == half || (LEAST_RADIUS_MM..request.radius_mm).contains(r));
    let angles: Vec<(f64, f64)> = smaller
        .filter_map(|radius| Some((radius, within(radius)?)))
        .collect();
    let inner_angle = angles.iter().find(|a| a.0 == half).map(|a| a.1);
    let turned = inner_angle.and_then(|_| {
        let change = |turned: &(f64, f64)| (turned.1 - needle.angle).abs();
        angles
            .into_iter()
            .max_by(|a, b| change(a).total_cmp(&change(b)))
    });
    let decision = Decision {
        plane,
        points: region.len(),
        stripes,
        rms_mm,
        coverage: patch.coverage,
        // z = x²/2ρ over a disc of radius r is r²/8ρ off its mean, root mean square.
        bend_mm: request.radius_mm.powi(2) / (8.0 * area.rms_mm),
        inner_angle,
        turned,
        entry,
        vein,
        direction,
        needle,
        uncertainty,
        checks: Vec::new(),
    };
    checks.extend(weigh::weigh(&decision, request, limits));
    Ok(decision)
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

/// The frame in which the surface is written as a height, from the points around `start`; and the
/// angle between light plane and surface, rad.
fn local_frame(
    cloud: &[CloudPoint],
    start: &Point3,
    radius_mm: f64,
    rig: &RigModel,
    limits: &Limits,
) -> Result<(surface::LocalFrame, f64), NeedleError> {
    let near: Vec<&CloudPoint> = cloud
        .iter()
        .filter(|p| (p.position - start).norm() <= radius_mm)
        .collect();
    if near.is_empty() {
        let far = cloud.iter().map(|p| (p.position - start).norm());
        let distance_mm = far.fold(f64::INFINITY, f64::min);
        // Between two stripes, or beside the hand?
        return Err(match distance_mm <= limits.gap_mm {
            true => NeedleError::SmallRegion {
                radius_mm,
                distance_mm,
            },
            false => NeedleError::OffSurface { distance_mm },
        });
    }
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
    let frame = surface::LocalFrame {
        origin: *start,
        along,
        across: rough.plane.normal.cross(&along),
        normal: rough.plane.normal,
    };
    Ok((frame, between.min(1.0).asin()))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::LightModel;

    /// Points of z = z₀ + h(x) under a light plane that travels along y, every 1 mm; the vein runs
    /// along x.
    fn decision(h: impl Fn(f64) -> f64) -> Decision {
        let mut rig = crate::synthetic::rig();
        rig.light = LightModel {
            normal: Vector3::new(0.0, 0.8, 0.6),
            ..rig.light
        };
        let pixel = |p: &Point3| rig.camera.project(p).unwrap();
        let place = |x: f64, y: f64| Point3::new(x, y, 430.0 + h(x));
        let cloud: Vec<CloudPoint> = (0..40)
            .flat_map(|frame| (0..400).map(move |i| (frame, f64::from(i) * 0.1 - 20.0)))
            .map(|(frame, x)| {
                let position = place(x, f64::from(frame) - 20.0);
                CloudPoint {
                    position,
                    pixel: pixel(&position),
                    frame,
                    intensity: 100.0,
                    sigma_mm: 0.001,
                    shift: Vector3::new(0.0, 0.01, 0.1),
                    correlation: 1.0,
                    quality: 1.0,
                }
            })
            .collect();
        let request = EntryRequest {
            pixel: pixel(&place(0.0, 0.0)),
            vein: [-6.0, -3.0, 0.0, 3.0, 6.0]
                .map(|x| pixel(&place(x, 0.0)))
                .to_vec(),
            radius_mm: 12.0,
        };
        decide(&cloud, &rig, &request, &Settings::default()).unwrap()
    }

    #[test]
    fn a_cylinder_is_known_by_its_radius_and_called_curved_where_it_is() {
        for (radius, said) in [(30.0, 1), (100.0, 0)] {
            let d = decision(|x| radius - (radius * radius - x * x).sqrt());
            // A ball cuts less out of a strong bend than a disc: a tenth.
            assert!(
                (d.bend_mm / radius - 1.0).abs() < 0.12,
                "{} {radius}",
                d.bend_mm
            );
            let words = crate::checks::sentences(&d.checks);
            assert_eq!(words.len(), said, "{words:?}");
            assert!(words.iter().all(|w| w.contains("curved like a cylinder")));
            // It bends evenly to both sides.
            assert!((d.inner_angle.unwrap() - d.needle.angle).abs() < 2e-3);
        }
    }

    /// The plane through c·x³ over a disc of radius r has the slope c·r²/2: over half of it a
    /// quarter.
    #[test]
    fn an_angle_that_hangs_on_the_radius_is_named() {
        for (c, said) in [(5e-4, 1), (1e-4, 0)] {
            let d = decision(|x| c * x.powi(3));
            // A disc of radius r holds the slope c·r²/2; the smallest looked at is a third of 12 mm.
            let slope = |r: f64| (0.5 * c * r * r).atan();
            for (inner, r) in [(d.inner_angle.unwrap(), 6.0), (d.turned.unwrap().1, 4.0)] {
                let (found, turn) = ((inner - d.needle.angle).abs(), slope(12.0) - slope(r));
                assert!((found / turn - 1.0).abs() < 0.06, "{found} {turn}");
            }
            assert_eq!(d.turned.unwrap().0, 4.0);
            let words = crate::checks::sentences(&d.checks);
            let named = words.iter().filter(|w| w.contains("hangs on the region"));
            assert_eq!(named.count(), said, "{words:?}");
        }
    }
}
