//! The checks of the paper's Tables 2 and 4: planes fitted one by one against the distance
//! travelled (Eq. 10) and against D = a·x + b (Eq. 9).

use super::SinglePlane;
use crate::geometry::Vector3;

/// Eq. 9 by least squares over (x, D): a and b. `None` for fewer than two different positions.
pub fn fit_travel(offsets: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = offsets.len() as f64;
    let (mx, md) = offsets
        .iter()
        .fold((0.0, 0.0), |(x, d), o| (x + o.0 / n, d + o.1 / n));
    let (sxx, sxd) = offsets.iter().fold((0.0, 0.0), |(xx, xd), o| {
        (xx + (o.0 - mx).powi(2), xd + (o.0 - mx) * (o.1 - md))
    });
    (sxx > 0.0).then(|| {
        let a = sxd / sxx;
        (a, md - a * mx)
    })
}

/// Eq. 10: the distance between two planes of one normal, mm.
pub fn spacing(normal: &Vector3, d0: f64, d1: f64) -> f64 {
    (d1 - d0).abs() / normal.norm()
}

/// A row of Table 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spacing {
    /// Slide position of the later plane, mm.
    pub slide_mm: f64,
    /// Distance travelled since the plane before, mm.
    pub travelled_mm: f64,
    /// Distance between the two planes (Eq. 10), mm.
    pub distance_mm: f64,
}

/// A row of Table 4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Slide position, mm.
    pub slide_mm: f64,
    /// a·x + b, mm.
    pub predicted_mm: f64,
    /// D of the plane fitted at this position, mm.
    pub fitted_mm: f64,
}

/// Table 2 from (x, D) pairs of planes with one normal, in order of x.
pub fn spacings(normal: &Vector3, offsets: &[(f64, f64)]) -> Vec<Spacing> {
    offsets
        .windows(2)
        .map(|w| Spacing {
            slide_mm: w[1].0,
            travelled_mm: w[1].0 - w[0].0,
            distance_mm: spacing(normal, w[0].1, w[1].1),
        })
        .collect()
}

/// Table 4 from (x, D) pairs.
pub fn offsets(a: f64, b: f64, pairs: &[(f64, f64)]) -> Vec<Offset> {
    pairs
        .iter()
        .map(|&(x, d)| Offset {
            slide_mm: x,
            predicted_mm: a * x + b,
            fitted_mm: d,
        })
        .collect()
}

/// Mean |distance − travelled|, mm: the figure under Table 2.
pub fn spacing_error(rows: &[Spacing]) -> f64 {
    mean(
        rows.iter()
            .map(|r| (r.distance_mm - r.travelled_mm.abs()).abs()),
    )
}

/// Mean |predicted − fitted|, mm: the figure under Table 4.
pub fn offset_error(rows: &[Offset]) -> f64 {
    mean(rows.iter().map(|r| (r.predicted_mm - r.fitted_mm).abs()))
}

/// Mean distance between neighbouring single planes against the distance travelled, where each
/// plane keeps its own normal: distances are taken along the common normal at a point of the
/// volume (the centroid of the points measured), where the planes are used.
pub fn offsets_at(planes: &[SinglePlane], normal: &Vector3, centre: &Vector3) -> Vec<(f64, f64)> {
    planes
        .iter()
        .map(|p| {
            // The plane of the common normal that meets this one on the line through the centre.
            let along = p.plane.normal.dot(normal);
            let reach = -(p.plane.normal.dot(centre) + p.plane.d) / along;
            (p.slide_mm, -normal.dot(&(centre + normal * reach)))
        })
        .collect()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len();
    if n == 0 {
        0.0
    } else {
        values.sum::<f64>() / n as f64
    }
}

#[cfg(test)]
mod paper {
    //! The paper's own tables, replayed.
    use super::super::published::{TABLE_2, TABLE_3, TABLE_4};
    use super::*;

    /// Table 3's common normal.
    const NORMAL: Vector3 = Vector3::new(TABLE_3[0], TABLE_3[1], TABLE_3[2]);

    fn real() -> Vec<(f64, f64)> {
        TABLE_4.iter().map(|r| (r.0, r.2)).collect()
    }

    #[test]
    fn table_4s_real_d_gives_a_and_b() {
        let (a, b) = fit_travel(&real()).unwrap();
        assert!((a - -1.0055).abs() < 5e-5, "a = {a}");
        assert!((b - -191.704).abs() < 5e-4, "b = {b}");
        // Table 3 prints −1.005 and −191.717: a to its digits, b 0.013 mm off.
        assert!((a - -1.005).abs() < 1e-3);
        assert!((b - -191.717).abs() < 0.014);
    }

    #[test]
    fn table_4s_predictions_are_equally_spaced() {
        // −5.026 a row: the table was computed with a = −1.0052, which Table 3 rounds.
        let rows = offsets(-1.0052, -191.717, &real());
        for (row, printed) in rows.iter().zip(&TABLE_4) {
            assert!((row.predicted_mm - printed.1).abs() < 5e-4);
        }
    }

    #[test]
    fn table_4s_predictions_follow_table_3() {
        for (slide, predicted, _, _) in TABLE_4 {
            let rounded = 1.5e-3 + 4e-4 * slide;
            assert!((TABLE_3[3] * slide + TABLE_3[4] - predicted).abs() < rounded);
        }
    }

    #[test]
    fn table_4s_mean_and_its_misprint() {
        let mut misprints = Vec::new();
        for (x, predicted, fitted, printed) in TABLE_4 {
            if ((predicted - fitted).abs() - printed).abs() > 5e-4 {
                misprints.push(x);
            }
        }
        // The row of 10 mm prints 0.002 where |−201.769 + 201.710| = 0.059.
        assert_eq!(misprints, [10.0]);
        let rows: Vec<Offset> = TABLE_4
            .iter()
            .map(|r| Offset {
                slide_mm: r.0,
                predicted_mm: r.1,
                fitted_mm: r.2,
            })
            .collect();
        assert!(((rows[2].predicted_mm - rows[2].fitted_mm).abs() - 0.059).abs() < 1e-9);
        // The printed average, 0.174, was taken over the printed differences; with the misprint
        // mended it is 0.179.
        let printed = TABLE_4.iter().map(|r| r.3).sum::<f64>() / 13.0;
        assert!((printed - 0.174).abs() < 5e-4, "{printed}");
        assert!(
            (offset_error(&rows) - 0.1785).abs() < 1e-4,
            "{}",
            offset_error(&rows)
        );
    }

    #[test]
    fn eq_10_gives_table_2_from_table_4() {
        // All rows but three agree to the table's rounding. The rows of 10, 25 and 30 mm do not:
        // Table 4's real D gives 5.07, 5.71 and 4.77 where Table 2 prints 5.13, 5.21 and 4.97.
        let rows = spacings(&NORMAL, &real());
        let apart: Vec<f64> = rows
            .iter()
            .zip(&TABLE_2)
            .filter(|(row, printed)| (row.distance_mm - printed.1).abs() > 0.0101)
            .map(|(row, _)| row.slide_mm)
            .collect();
        assert_eq!(apart, [10.0, 25.0, 30.0]);
        // First row: |−196.640 + 191.428| / |n|, |n| = 0.99989 as printed.
        assert!((rows[0].distance_mm - 5.212 / NORMAL.norm()).abs() < 1e-9);
    }

    #[test]
    fn table_2s_average() {
        let rows: Vec<Spacing> = TABLE_2
            .iter()
            .map(|r| Spacing {
                slide_mm: r.0,
                travelled_mm: 5.0,
                distance_mm: r.1,
            })
            .collect();
        // «About 0.1 mm».
        assert!(
            (spacing_error(&rows) - 1.15 / 12.0).abs() < 1e-9,
            "{}",
            spacing_error(&rows)
        );
    }

    #[test]
    fn one_position_has_no_travel() {
        assert_eq!(fit_travel(&[(3.0, -190.0)]), None);
        assert_eq!(fit_travel(&[(3.0, -190.0), (3.0, -190.1)]), None);
        assert_eq!(fit_travel(&[]), None);
    }
}
