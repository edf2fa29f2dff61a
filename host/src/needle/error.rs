//! Why no needle angle is given: each reason with its numbers and a remedy.

/// Why no needle angle is given.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NeedleError {
    /// The cloud is empty around the entry.
    #[error(
        "{points} points on {stripes} stripes in the entry region; {needed_points} on {needed_stripes} are needed: give a larger radius_mm, scan with smaller steps, or check laser and exposure"
    )]
    TooFewPoints {
        /// Points in the region.
        points: usize,
        /// Stripes in the region.
        stripes: usize,
        /// Points needed.
        needed_points: usize,
        /// Stripes needed.
        needed_stripes: usize,
    },
    /// The entry pixel does not look at the measured surface.
    #[error(
        "the entry pixel lies off the measured surface: the nearest point is {distance_mm:.1} mm away; check entry.pixel, or scan farther"
    )]
    OffSurface {
        /// To the nearest measured point, mm.
        distance_mm: f64,
    },
    /// The region falls between the stripes.
    #[error(
        "no measured point lies within radius_mm = {radius_mm} mm of the entry, the nearest is {distance_mm:.1} mm away: give a larger radius_mm (12 is usual), or scan with smaller steps"
    )]
    SmallRegion {
        /// Radius that was asked for, mm.
        radius_mm: f64,
        /// To the nearest measured point, mm.
        distance_mm: f64,
    },
    /// The surface has a hole where the needle is to go in.
    #[error(
        "the measured surface has a hole of {gap_mm:.1} mm at the entry (at most {limit_mm:.1} mm are bridged): scan again there, or choose another entry"
    )]
    Hole {
        /// Width of the hole, mm.
        gap_mm: f64,
        /// Widest that is bridged, mm.
        limit_mm: f64,
    },
    /// The measured surface is broken up where the needle is to go in.
    #[error(
        "the measured surface is broken up at the entry: it can't be followed there; scan again there, or choose another entry"
    )]
    Broken,
    /// The light plane runs along the surface.
    #[error(
        "light plane and surface meet at {angle_deg:.0}° only (at least {limit_deg:.0}° are needed): turn the hand, or check that the scan's slide_mm are millimetres"
    )]
    Grazing {
        /// Angle between the two, degrees.
        angle_deg: f64,
        /// Smallest allowed, degrees.
        limit_deg: f64,
    },
    /// Too much of the region was not measured.
    #[error("only {:.0} % of the entry region was measured ({:.0} % are needed): scan again, or choose an entry farther from the edge", 100.0 * coverage, 100.0 * needed)]
    NotCovered {
        /// Part covered.
        coverage: f64,
        /// Part needed.
        needed: f64,
    },
    /// The region is no plane.
    #[error(
        "the entry region is not flat: {rms_mm:.2} mm root mean square off its plane (at most {limit_mm:.2} mm); choose another entry or a smaller radius_mm"
    )]
    NotFlat {
        /// Root mean square distance, mm.
        rms_mm: f64,
        /// Largest allowed, mm.
        limit_mm: f64,
    },
    /// Two frames between which the stripe did not follow the slide.
    #[error(
        "from frame {} to frame {} the stripe moves {ratio:.2} times as far in the image as the slide's travel asks for ({least:.2} to {most:.2} is a surface's): a frame was lost or doubled, a position is wrong, the slide slipped or the hand moved; scan again", frames[0], frames[1]
    )]
    OutOfStep {
        /// The frames, from 0.
        frames: [usize; 2],
        /// Travel in the image against that of the neighbours.
        ratio: f64,
        /// Least allowed.
        least: f64,
        /// Most allowed.
        most: f64,
    },
    /// The vein is too short to have a direction.
    #[error(
        "the vein's pixels span {length_mm:.1} mm on the surface (at least {least_mm:.1} mm are needed): give pixels farther apart along the vein"
    )]
    ShortVein {
        /// Length, mm.
        length_mm: f64,
        /// Least length, mm.
        least_mm: f64,
    },
    /// The camera looks along the surface.
    #[error(
        "the camera sees the entry region at {angle_deg:.0}° from its normal (at most {limit_deg:.0}°): turn the hand towards the camera"
    )]
    Oblique {
        /// Angle between normal and line of sight, degrees.
        angle_deg: f64,
        /// Largest allowed, degrees.
        limit_deg: f64,
    },
    /// The vein has no direction on the surface.
    #[error(
        "{met} of the vein's {given} pixels meet the measured surface and they give no direction: check entry.vein"
    )]
    NoVein {
        /// Vein pixels that meet the surface.
        met: usize,
        /// Vein pixels given.
        given: usize,
    },
    /// The result would not be sure enough.
    #[error(
        "the result is too uncertain: angle ±{angle_deg:.2}° (at most {angle_limit_deg:.2}°), entry ±{entry_mm:.2} mm (at most {entry_limit_mm:.2} mm); calibrate with more and more tilted board views"
    )]
    TooUncertain {
        /// Standard deviation of the angle, degrees.
        angle_deg: f64,
        /// Largest allowed, degrees.
        angle_limit_deg: f64,
        /// Standard deviation of the entry, mm.
        entry_mm: f64,
        /// Largest allowed, mm.
        entry_limit_mm: f64,
    },
    /// The lens model has no inverse at the entry pixel.
    #[error(
        "the calibration's lens model has no inverse at the entry pixel: calibrate with the board in that part of the image too"
    )]
    NoRay,
    /// The points determine no plane.
    #[error("the points of the entry region lie on one line: they determine no plane")]
    Degenerate,
}
