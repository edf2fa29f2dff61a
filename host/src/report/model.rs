//! What a report shows, as plain data: no file is read and nothing is computed here.
//!
//! Lengths mm, angles degrees, pixels as everywhere. A section that is `None` or empty is left out
//! of the page.

use crate::stripe::Axis;

/// Everything on the page.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What it is about: "Needle insertion: hand scan of …, session …".
    pub title: String,
    /// In the angle's place where there is none; empty for nothing.
    pub headline: String,
    /// Whether the result may be used.
    pub verdict: Option<Verdict>,
    /// The needle.
    pub needle: Option<Needle>,
    /// The hand with entry, vein, region and needle drawn on it.
    pub picture: Option<Picture>,
    /// The turnable view.
    pub scene: Option<Scene>,
    /// Every check that was made.
    pub checks: Vec<crate::checks::Check>,
    /// Camera and light planes.
    pub calibration: Option<Calibration>,
    /// A few frames with the centres drawn.
    pub stripes: Vec<StripeSample>,
    /// Force curves and the decision.
    pub puncture: Option<Puncture>,
    /// Errors against the truth, where there is one (simulated rig).
    pub truth: Vec<TruthRow>,
    /// How the result came about.
    pub provenance: Provenance,
}

/// Whether the result may be used.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// Nothing speaks against it.
    pub usable: bool,
    /// Why not, a sentence each.
    pub reasons: Vec<String>,
    /// What is weak, a sentence each.
    pub warnings: Vec<String>,
}

/// Entry, axis and angle in one frame.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// "camera" or "robot".
    pub name: String,
    /// Entry point, mm.
    pub entry_mm: [f64; 3],
    /// Plane's unit normal.
    pub normal: [f64; 3],
    /// Vein's unit direction in the plane.
    pub vein: [f64; 3],
    /// Unit vector in which the needle advances.
    pub axis: [f64; 3],
}

/// The needle.
#[derive(Clone, Debug, Default)]
pub struct Needle {
    /// Angle to the plane, degrees.
    pub angle_deg: f64,
    /// Its standard deviation, degrees.
    pub angle_sigma_deg: f64,
    /// Where the angle comes from: "--needle-angle" or the decision.
    pub angle_source: String,
    /// Standard deviations of the entry point along X, Y, Z of the camera, mm.
    pub entry_sigma_mm: Option<[f64; 3]>,
    /// Standard deviation of the axis's direction, degrees.
    pub axis_sigma_deg: Option<f64>,
    /// Points in the region of the fit.
    pub region_points: usize,
    /// Their root mean square distance from the plane, mm.
    pub region_rms_mm: f64,
    /// Radius of the cylinder that is as far from its plane, mm.
    pub bend_mm: f64,
    /// The smaller radius, mm, to whose plane the same needle's angle differs most, and that angle,
    /// degrees.
    pub turned: Option<(f64, f64)>,
    /// Radius of the region, mm.
    pub radius_mm: f64,
    /// The camera's frame, and the robot's where given.
    pub frames: Vec<Frame>,
}

/// An image as 8-bit grey, row by row.
#[derive(Clone, Debug, Default)]
pub struct Gray {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// width × height grey values.
    pub pixels: Vec<u8>,
}

/// The hand with lines drawn on it, in the image's pixels.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// The hand.
    pub image: Gray,
    /// The entry.
    pub entry: [f64; 2],
    /// Along the vein.
    pub vein: Vec<[f64; 2]>,
    /// Outline of the region of the fit.
    pub region: Vec<[f64; 2]>,
    /// The needle's axis outside the hand, from its far end to the entry.
    pub needle: Vec<[f64; 2]>,
    /// Measured points; drawn where no angle is given, to show where the surface was seen.
    pub points: Vec<[f64; 2]>,
}

/// The turnable view, camera frame.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// X, Y, Z of each point, mm.
    pub points: Vec<[f32; 3]>,
    /// Brightness of each.
    pub brightness: Vec<u8>,
    /// Distance between neighbouring points, mm: the size at which they are drawn.
    pub point_size_mm: f64,
    /// Corners of the plane's drawn part.
    pub plane: Option<[[f64; 3]; 4]>,
    /// Corners of the drawn part of the vein's section plane.
    pub section: Option<[[f64; 3]; 4]>,
    /// Points along the vein.
    pub vein: Vec<[f64; 3]>,
    /// The needle: far end, entry, tip; and its radius.
    pub needle: Option<SceneNeedle>,
    /// Outline of the region that is asked for.
    pub region: Vec<[f64; 3]>,
    /// Where the camera looks through the entry pixel, where no entry was found.
    pub sight: Option<[[f64; 3]; 2]>,
    /// What the first view looks at and turns about.
    pub focus: [f64; 3],
    /// Direction from the focus to the eye in the first view.
    pub view: [f64; 3],
    /// What is up in it: away from the skin.
    pub up: [f64; 3],
    /// Radius of the region that the plane was fitted to, mm.
    pub radius_mm: f64,
}

/// The needle in the turnable view, mm.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneNeedle {
    /// Far end.
    pub from: [f64; 3],
    /// Entry point.
    pub entry: [f64; 3],
    /// Tip at the end of the path.
    pub to: [f64; 3],
    /// Radius, mm.
    pub radius: f64,
}

/// One view of the board.
#[derive(Clone, Debug, Default)]
pub struct BoardView {
    /// The image's name.
    pub name: String,
    /// Root mean square reprojection error, px.
    pub rms_px: f64,
    /// The corners.
    pub corners: Vec<[f64; 2]>,
    /// Observed minus reprojected, px, corner by corner; may be empty.
    pub residuals: Vec<[f64; 2]>,
    /// Outline of the corner grid.
    pub outline: Vec<[f64; 2]>,
    /// Tilt about the image's horizontal and vertical axis, degrees.
    pub tilt_deg: Option<[f64; 2]>,
    /// Distance from the camera, mm.
    pub distance_mm: Option<f64>,
    /// Whether it took part.
    pub used: bool,
}

/// A slide position.
#[derive(Clone, Debug, Default)]
pub struct Position {
    /// Slide, mm.
    pub slide_mm: f64,
    /// Normal of its own plane.
    pub normal: [f64; 3],
    /// D of its plane, mm.
    pub fitted_mm: f64,
    /// a·x + b, mm.
    pub predicted_mm: f64,
    /// Distance from the plane before, mm (none for the first).
    pub spacing_mm: Option<f64>,
    /// Travel since the plane before, mm.
    pub travelled_mm: Option<f64>,
    /// Predicted from the other positions, minus fitted, mm.
    pub hold_out_mm: Option<f64>,
    /// Points.
    pub points: usize,
    /// Root mean square distance of the points from the plane, mm.
    pub rms_mm: f64,
}

/// Table 3.
#[derive(Clone, Copy, Debug, Default)]
pub struct Light {
    /// Common normal.
    pub normal: [f64; 3],
    /// a and b (mm) of D = a·x + b; none for a slide that stood at one position.
    pub travel: Option<(f64, f64)>,
}

/// Camera and light planes.
#[derive(Clone, Debug, Default)]
pub struct Calibration {
    /// Image size, px.
    pub size: [u32; 2],
    /// Name, value, standard deviation, unit.
    pub parameters: Vec<(String, f64, Option<f64>, String)>,
    /// Reprojection error over all views, px.
    pub rms_px: f64,
    /// The views.
    pub views: Vec<BoardView>,
    /// The light planes; none for a camera alone.
    pub light: Option<Light>,
    /// The slide positions.
    pub positions: Vec<Position>,
    /// Mean |spacing − travel|, mm.
    pub spacing_error_mm: f64,
    /// Mean |predicted − fitted|, mm.
    pub offset_error_mm: f64,
    /// Table 1: board pose, Σ squared reprojection error before and after, px².
    pub table_1: Vec<(String, f64, f64)>,
    /// Figure 14: slide position, mean distance from the plane before and after, mm.
    pub figure_14: Vec<(f64, f64, f64)>,
    /// What is weak and what to do about it.
    pub findings: Vec<String>,
    /// How many checks were made of it.
    pub checked: usize,
    /// "ml" or "paper".
    pub method: String,
    /// When: "of …, … ago, … before the scan".
    pub made: Option<String>,
}

/// A piece of a frame with the centres found in it.
#[derive(Clone, Debug, Default)]
pub struct StripeSample {
    /// The frame's name.
    pub name: String,
    /// Slide, mm.
    pub slide_mm: f64,
    /// Along which axis the stripe was searched.
    pub axis: Axis,
    /// The piece.
    pub image: Gray,
    /// Pixel of the frame at the piece's top left.
    pub origin: [f64; 2],
    /// Pixels of the frame to a pixel of the piece: more than one where it is shown smaller.
    pub side: f64,
    /// The centres of the whole stripe, in the frame: u, v, standard deviation across, quality.
    pub centres: Vec<[f64; 4]>,
}

/// Where a curve comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// The reference: finite elements that a needle cuts.
    #[default]
    Reference,
    /// The closed form fitted to it.
    Fast,
}

impl Model {
    /// In a chart's title.
    pub fn words(self) -> &'static str {
        match self {
            Self::Reference => "reference simulation",
            Self::Fast => "fast model",
        }
    }
}

/// The force on a needle at one angle.
#[derive(Clone, Debug, Default)]
pub struct PunctureRun {
    /// What computed it.
    pub model: Model,
    /// Angle, degrees.
    pub angle_deg: f64,
    /// Time, s; force on the needle: whole, skin, fat, vein, N.
    pub curve: Vec<[f64; 5]>,
    /// Layer, time of contact, time of puncture, s, peak force, N.
    pub events: Vec<(String, f64, Option<f64>, f64)>,
}

/// A table as text.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Column heads with units.
    pub head: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// Force curves and the decision.
#[derive(Clone, Debug, Default)]
pub struct Puncture {
    /// A run for each angle.
    pub runs: Vec<PunctureRun>,
    /// Fast model: angle, degrees; peak force, lower and upper bound, N.
    pub force_over_angle: Vec<[f64; 4]>,
    /// The angle that was given by hand and is used, degrees; then the criterion's is not.
    pub given_deg: Option<f64>,
    /// The angle decided on, degrees.
    pub angle_deg: f64,
    /// By which criterion.
    pub criterion: String,
    /// The plain sentences.
    pub sentences: Vec<String>,
    /// What the curves are, in a sentence.
    pub curves: String,
    /// A column per angle, for and against.
    pub decision: Table,
    /// What speaks against each of them, a sentence an angle.
    pub against: Vec<String>,
    /// Sensitivity to friction and toughness.
    pub sensitivity: Table,
    /// How the reference simulation was run, name and value; empty where it was not.
    pub settings: Vec<(String, String)>,
}

/// An error against the truth.
#[derive(Clone, Debug, Default)]
pub struct TruthRow {
    /// What.
    pub what: String,
    /// The error.
    pub error: f64,
    /// Its unit.
    pub unit: String,
    /// What it should stay under, if anything was asked.
    pub limit: Option<f64>,
}

/// How the result came about.
#[derive(Clone, Debug, Default)]
pub struct Provenance {
    /// Program and version.
    pub program: String,
    /// Command line.
    pub command: String,
    /// When, to be read.
    pub time: String,
    /// Session's path as given.
    pub session: String,
    /// Name and value of every setting and threshold.
    pub settings: Vec<(String, String)>,
    /// Stage and its time, ms.
    pub stages: Vec<(String, f64)>,
}
