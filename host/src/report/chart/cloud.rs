//! The cloud from above.

use super::{Kind, PALETTE, Plot, Series};

/// X and Y of the points in bands of height (Z), the entry marked.
pub fn cloud(points: &[[f32; 3]], entry: Option<[f64; 3]>) -> Plot {
    const BANDS: usize = 5;
    let mut z: Vec<f32> = points.iter().map(|p| p[2]).collect();
    z.sort_by(f32::total_cmp);
    let at = |k: usize| {
        z.get((z.len() * k / BANDS).min(z.len().saturating_sub(1)))
            .copied()
    };
    let mut series = Vec::new();
    for k in 0..BANDS {
        let (Some(lo), Some(hi)) = (at(k), at(k + 1)) else {
            continue;
        };
        let last = k + 1 == BANDS;
        let inside = points
            .iter()
            .filter(|p| p[2] >= lo && (p[2] < hi || last))
            .map(|p| (f64::from(p[0]), f64::from(p[1])))
            .collect();
        series.push(Series::new(
            &format!("Z {lo:.1} to {hi:.1} mm"),
            // The nearest is the lightest, as in the turnable view.
            PALETTE.len() + BANDS - 1 - k,
            Kind::Points,
            inside,
        ));
    }
    if let Some(e) = entry {
        series.push(Series::new("entry", 1, Kind::Crosses, vec![(e[0], e[1])]));
    }
    let mut plot = Plot {
        title: "The cloud from the camera".into(),
        x_label: "X / mm".into(),
        y_label: "Y / mm".into(),
        series,
        equal: true,
        ..Plot::default()
    };
    // Y downwards, as in the image.
    let (lo, hi) = plot.range(|p| p.1, false);
    plot.y_range = Some((hi, lo));
    plot
}
