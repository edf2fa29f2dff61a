//! Why no needle angle is given: each reason with its numbers and a remedy.

use crate::checks::decimals;

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
    /// The entry pixel looks at the edge of the measured surface.
    #[error(
        "the entry pixel lies at the very edge of the measured surface, with nothing measured on one side of it; check entry.pixel, or scan farther"
    )]
    Edge,
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
        "the measured surface has a hole of {gap_mm:.n$} mm at the entry (at most {limit_mm:.n$} mm are bridged): scan again there, or choose another entry",
        n = decimals(*gap_mm, *limit_mm, 1)
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
        "light plane and surface meet at {angle_deg:.n$}° only (at least {limit_deg:.n$}° are needed): turn the hand, or check that the scan's slide_mm are millimetres",
        n = decimals(*angle_deg, *limit_deg, 0)
    )]
    Grazing {
        /// Angle between the two, degrees.
        angle_deg: f64,
        /// Smallest allowed, degrees.
        limit_deg: f64,
    },
    /// Too much of the region was not measured.
    #[error(
        "only {part:.n$} % of the entry region was measured ({least:.n$} % are needed): scan again, or choose an entry farther from the edge",
        part = 100.0 * coverage,
        least = 100.0 * needed,
        n = decimals(100.0 * coverage, 100.0 * needed, 0)
    )]
    NotCovered {
        /// Part covered.
        coverage: f64,
        /// Part needed.
        needed: f64,
    },
    /// The region is no plane.
    #[error(
        "the entry region is not flat: {rms_mm:.n$} mm root mean square off its plane (at most {limit_mm:.n$} mm); choose another entry or a smaller radius_mm",
        n = decimals(*rms_mm, *limit_mm, 2)
    )]
    NotFlat {
        /// Root mean square distance, mm.
        rms_mm: f64,
        /// Largest allowed, mm.
        limit_mm: f64,
    },
    /// Two frames between which the stripe did not follow the slide.
    #[error(
        "from frame {} to frame {} the stripe moves {ratio:.n$} times as far in the image as the slide's travel asks for ({least:.2} to {most:.2} is a surface's): a frame was lost or doubled, a position is wrong, the slide slipped or the hand moved; scan again",
        frames[0],
        frames[1],
        n = decimals(*ratio, *least, 2).max(decimals(*ratio, *most, 2))
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
        "the vein's pixels span {length_mm:.n$} mm on the surface (at least {least_mm:.n$} mm are needed): give pixels farther apart along the vein",
        n = decimals(*length_mm, *least_mm, 1)
    )]
    ShortVein {
        /// Length, mm.
        length_mm: f64,
        /// Least length, mm.
        least_mm: f64,
    },
    /// The camera looks along the surface.
    #[error(
        "the camera sees the entry region at {angle_deg:.n$}° from its normal (at most {limit_deg:.n$}°): turn the hand towards the camera",
        n = decimals(*angle_deg, *limit_deg, 0)
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
        "the result is too uncertain: angle ±{angle_deg:.n$}° (at most {angle_limit_deg:.n$}°), entry ±{entry_mm:.m$} mm (at most {entry_limit_mm:.m$} mm); calibrate with more and more tilted board views",
        n = decimals(*angle_deg, *angle_limit_deg, 2),
        m = decimals(*entry_mm, *entry_limit_mm, 2)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The two numbers of a sentence, as a reader sees them.
    fn numbers(e: &NeedleError) -> Vec<f64> {
        let text = e.to_string();
        let words = text.split(|c: char| !(c.is_ascii_digit() || c == '.'));
        words.filter_map(|w| w.parse().ok()).collect()
    }

    #[test]
    fn a_number_that_breaks_its_limit_is_seen_to() {
        for coverage in [0.5, 0.894, 0.8996, 0.89999] {
            let e = NeedleError::NotCovered {
                coverage,
                needed: 0.9,
            };
            let seen = numbers(&e);
            assert!(seen[0] < seen[1] && seen[1] == 90.0, "{e}");
        }
        let e = NeedleError::NotFlat {
            rms_mm: 1.0803,
            limit_mm: 1.08,
        };
        assert!(e.to_string().contains("1.0803 mm root mean square"), "{e}");
        let e = NeedleError::TooUncertain {
            angle_deg: 0.3,
            angle_limit_deg: 1.0,
            entry_mm: 1.004,
            entry_limit_mm: 1.0,
        };
        let seen = numbers(&e);
        assert_eq!(seen, [0.3, 1.0, 1.004, 1.0], "{e}");
        let e = NeedleError::OutOfStep {
            frames: [3, 4],
            ratio: 0.58,
            least: 0.6,
            most: 1.3,
        };
        assert!(e.to_string().contains("moves 0.58 times"), "{e}");
    }
}
