//! The gate of the camera calibration: which views do not fit, and what a set of views lacks.

use crate::board::Corner;
use crate::calibration::finding::{Cause, Finding, Gate, Severity};
use crate::checks::Limit;
use crate::geometry::{Camera, Homography, PARAMETERS, Pose, Vector2, Vector3};
use nalgebra::SMatrix;

/// A view whose residuals are this many times the median view's is left out.
const BAD_VIEW: f64 = 5.0;
/// And one of this many times is named.
const ODD_VIEW: f64 = 3.0;
/// Largest angle between two boards: below, the focal length can't be told from the distance.
const PARALLEL_DEG: f64 = 4.0;
/// Below this angle it can be told badly.
const LITTLE_TILT_DEG: f64 = 20.0;
/// Relative standard deviation of the focal length at which no result is given. Depth errs as
/// the focal length does: 1 % is 4 mm at the hand.
const REFUSE_FOCAL: f64 = 0.01;
/// And at which it is named.
const WARN_FOCAL: f64 = 0.002;
/// Residuals at which the corners are not those of the board, or the board is not flat.
pub const REFUSE_RMS_PX: f64 = 1.0;

/// fx over fy that a sensor's pixels can give.
const RATIO: [f64; 2] = [0.9, 1.1];

/// Which views' corners are a plane's image at all: the residuals of a homography, which a lens
/// bends by a few pixels and a wrong order of corners by many.
pub fn homographies_fit(
    homographies: &[Option<Homography>],
    plane: &[Vector2],
    pixels: &[Vec<Vector2>],
) -> Vec<bool> {
    let rms: Vec<f64> = homographies
        .iter()
        .zip(pixels)
        .map(|(h, pixels)| {
            let Some(h) = h else { return f64::INFINITY };
            let sum: f64 = plane
                .iter()
                .zip(pixels)
                .map(|(p, q)| (h.apply(p) - q).norm_squared())
                .sum();
            (sum / pixels.len().max(1) as f64).sqrt()
        })
        .collect();
    let limit = 2.0 + 5.0 * median(rms.iter().copied());
    rms.iter().map(|&r| r <= limit).collect()
}

/// Views in use that do not fit the others, worst first; nothing if more than a third would go.
pub fn bad_views(view_scale: &[f64], used: &[bool]) -> Vec<usize> {
    let middle = median(
        view_scale
            .iter()
            .zip(used)
            .filter(|&(_, &u)| u)
            .map(|(&s, _)| s),
    );
    let mut bad: Vec<usize> = (0..view_scale.len())
        .filter(|&i| used[i] && view_scale[i] > BAD_VIEW * middle)
        .collect();
    bad.sort_by(|&i, &j| view_scale[j].total_cmp(&view_scale[i]));
    // A bad view spoils the poses of good ones: the worst goes first, the rest get a second look.
    bad.truncate(1);
    bad
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.collect();
    if v.is_empty() {
        return 0.0;
    }
    v.sort_by(f64::total_cmp);
    // The lower of the two middle ones: half of the views may be bad.
    v[(v.len() - 1) / 2]
}

/// What the gate looks at.
pub struct Evidence<'a> {
    /// The camera found.
    pub camera: &'a Camera,
    /// Its covariance, if the data determines it.
    pub covariance: Option<&'a SMatrix<f64, PARAMETERS, PARAMETERS>>,
    /// Poses of all views.
    pub poses: &'a [Pose],
    /// Which views took part.
    pub used: &'a [bool],
    /// The corners of all views.
    pub views: &'a [Vec<Corner>],
    /// Root mean square whitened residual of the views in use.
    pub view_scale: &'a [f64],
    /// Root mean square distance of all views, px.
    pub view_rms_px: &'a [f64],
    /// The same over the views in use, px.
    pub rms_px: f64,
}

/// Everything that is lacking or odd.
pub fn examine(evidence: &Evidence) -> Gate {
    let mut gate = Gate::default();
    views(evidence, &mut gate);
    geometry(evidence, &mut gate);
    coverage(evidence, &mut gate);
    lens(evidence, &mut gate);
    gate
}

fn views(e: &Evidence, gate: &mut Gate) {
    let in_use = || e.used.iter().zip(e.view_scale).filter(|&(&u, _)| u);
    let middle = median(in_use().map(|(_, &s)| s));
    for (i, &used) in e.used.iter().enumerate() {
        if !used {
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::BadView,
                view: Some(i),
                what: format!(
                    "left out, its corners lie {:.2} px from where the other views put them",
                    e.view_rms_px[i]
                ),
                advice: "take it again with the board flat, still and sharp".into(),
            });
        } else if e.view_scale[i] > ODD_VIEW * middle {
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::BadView,
                view: Some(i),
                what: format!(
                    "its corners fit {:.1} times worse than those of the other views ({:.3} px)",
                    e.view_scale[i] / middle,
                    e.view_rms_px[i]
                ),
                advice: "look whether the board moved or is blurred there".into(),
            });
        }
    }
    let odd = in_use().map(|(_, &s)| s / middle).fold(0.0, f64::max);
    gate.holds(
        "camera: residuals of the worst view over the median view’s",
        odd,
        Limit::AtMost(ODD_VIEW),
        "",
    );
    let left_out = e.used.iter().filter(|&&u| !u).count();
    gate.holds(
        "camera: views left out, as they do not fit the others",
        left_out as f64,
        Limit::AtMost(0.0),
        "",
    );
    if 3 * left_out > e.used.len() {
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::BadView,
            view: None,
            what: format!("{left_out} of {} views do not fit the others", e.used.len()),
            advice: "check the board's counts of columns and rows, and that it is flat".into(),
        });
    }
    let fits = gate.holds(
        "camera: corners off the fitted boards, RMS",
        e.rms_px,
        Limit::AtMost(REFUSE_RMS_PX),
        "px",
    );
    if !fits {
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::LargeResiduals,
            view: None,
            what: format!(
                "the corners miss the fitted board by {:.2} px RMS",
                e.rms_px
            ),
            advice: "check the board's counts of columns and rows, that it is flat, and the focus"
                .into(),
        });
    }
}

fn geometry(e: &Evidence, gate: &mut Gate) {
    let normals: Vec<Vector3> = e
        .poses
        .iter()
        .zip(e.used)
        .filter(|&(_, &u)| u)
        .map(|(p, _)| p.rotation * Vector3::z())
        .collect();
    let mut spread: f64 = 0.0;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            spread = spread.max(a.cross(b).norm().atan2(a.dot(b).abs()));
        }
    }
    let spread = spread.to_degrees();
    let focal = e.covariance.map_or(f64::INFINITY, |c| {
        (c[(0, 0)].sqrt() / e.camera.fx).max(c[(1, 1)].sqrt() / e.camera.fy)
    });
    let tilted = gate.holds(
        "camera: largest angle between two boards",
        spread,
        Limit::AtLeast(LITTLE_TILT_DEG),
        "°",
    );
    let known = gate.holds(
        "camera: σ of the focal length",
        100.0 * focal,
        Limit::AtMost(100.0 * WARN_FOCAL),
        "%",
    );
    if spread < PARALLEL_DEG {
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::ParallelViews,
            view: None,
            what: format!(
                "all boards are parallel to within {spread:.1}°, so the focal length can't be told from the distance"
            ),
            advice: "tilt the board by 20° to 40° to different sides".into(),
        });
    } else if !(focal < REFUSE_FOCAL) {
        gate.findings.push(Finding {
            severity: Severity::Refuse,
            cause: Cause::UncertainFocalLength,
            view: None,
            what: format!(
                "the focal length is known to no better than {:.1} % (boards differ by {spread:.0}° at most)",
                100.0 * focal.min(10.0)
            ),
            advice: "add views with the board tilted by 20° to 40° to different sides".into(),
        });
    } else {
        if !tilted {
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::LittleTilt,
                view: None,
                what: format!("the boards differ in tilt by {spread:.0}° at most"),
                advice: "tilt the board by 20° to 40° to different sides".into(),
            });
        }
        if !known {
            gate.findings.push(Finding {
                severity: Severity::Warn,
                cause: Cause::UncertainFocalLength,
                view: None,
                what: format!("the focal length is known to {:.2} % only", 100.0 * focal),
                advice: "add views, tilted more, filling more of the image".into(),
            });
        }
    }
}

fn coverage(e: &Evidence, gate: &mut Gate) {
    let size = [f64::from(e.camera.width), f64::from(e.camera.height)];
    let mut seen = [[false; 3]; 3];
    for (view, _) in e.views.iter().zip(e.used).filter(|&(_, &u)| u) {
        for corner in view {
            let cell = |p: f64, size: f64| (3.0 * (p + 0.5) / size).clamp(0.0, 2.0) as usize;
            seen[cell(corner.pixel.y, size[1])][cell(corner.pixel.x, size[0])] = true;
        }
    }
    const NAMES: [[&str; 3]; 3] = [
        ["top left", "top", "top right"],
        ["left", "middle", "right"],
        ["bottom left", "bottom", "bottom right"],
    ];
    let missing: Vec<&str> = (0..9)
        .filter(|i| !seen[i / 3][i % 3])
        .map(|i| NAMES[i / 3][i % 3])
        .collect();
    let covered = gate.holds(
        "camera: ninths of the image with a corner in them",
        9.0 - missing.len() as f64,
        Limit::AtLeast(9.0),
        "",
    );
    if !covered {
        gate.findings.push(Finding {
            severity: Severity::Warn,
            cause: Cause::Coverage,
            view: None,
            what: format!(
                "no corner was seen in these ninths of the image: {}",
                missing.join(", ")
            ),
            advice: "put the board there too, or the distortion is extrapolated".into(),
        });
    }
}

fn lens(e: &Evidence, gate: &mut Gate) {
    let camera = e.camera;
    let (w, h) = (
        f64::from(camera.width) - 1.0,
        f64::from(camera.height) - 1.0,
    );
    let folded = [
        (0.0, 0.0),
        (w, 0.0),
        (0.0, h),
        (w, h),
        (w / 2.0, 0.0),
        (w / 2.0, h),
        (0.0, h / 2.0),
        (w, h / 2.0),
    ]
    .into_iter()
    .any(|(u, v)| camera.ray(&Vector2::new(u, v)).is_none());
    if !gate.is(
        "camera: the distortion can be inverted up to the border",
        !folded,
    ) {
        gate.findings.push(Finding {
            severity: Severity::Warn,
            cause: Cause::FoldedDistortion,
            view: None,
            what: "the distortion has no inverse at the image's border".into(),
            advice: "put the board into the corners of the image too".into(),
        });
    }
    let ratio = camera.fx / camera.fy;
    if !gate.holds("camera: fx over fy", ratio, Limit::Between(RATIO), "") {
        gate.findings.push(Finding {
            severity: Severity::Warn,
            cause: Cause::AspectRatio,
            view: None,
            what: format!("fx is {ratio:.2} times fy"),
            advice: "check that the board's squares are square and its columns and rows right"
                .into(),
        });
    }
}

/// The gate's limits by name, for the report.
pub fn limits() -> Vec<(&'static str, String)> {
    let mut all = vec![
        (
            "camera: view left out beyond",
            format!("{BAD_VIEW} × the median view's residuals"),
        ),
        (
            "camera: view named beyond",
            format!("{ODD_VIEW} × the median view's residuals"),
        ),
        (
            "camera: refused if boards differ by less than",
            format!("{PARALLEL_DEG}°"),
        ),
        (
            "camera: named if boards differ by less than",
            format!("{LITTLE_TILT_DEG}°"),
        ),
        (
            "camera: refused at σ of the focal length",
            format!("{} %", 100.0 * REFUSE_FOCAL),
        ),
        (
            "camera: named at σ of the focal length",
            format!("{} %", 100.0 * WARN_FOCAL),
        ),
        (
            "camera: refused at residuals of",
            format!("{REFUSE_RMS_PX} px"),
        ),
        ("camera: fewest views", super::LEAST_VIEWS.to_string()),
        (
            "camera: named if fx over fy is outside",
            format!("{} to {}", RATIO[0], RATIO[1]),
        ),
    ];
    all.extend(crate::calibration::corners::limits());
    all
}
