//! Quality along a stripe.

use super::{Kind, Plot, Series};
use crate::report::model::StripeSample;

/// The centres in the image, v downwards.
pub fn centres(s: &StripeSample) -> Plot {
    let points: Vec<(f64, f64)> = s.centres.iter().map(|c| (c[0], c[1])).collect();
    let mut plot = Plot {
        title: format!(
            "{}: centres of the stripe, slide at {:.1} mm",
            s.name, s.slide_mm
        ),
        x_label: "u / px".into(),
        y_label: "v / px".into(),
        series: vec![Series::new("", 1, Kind::Points, points)],
        ..Plot::default()
    };
    let (lo, hi) = plot.range(|p| p.1, false);
    plot.y_range = Some((hi, lo));
    plot
}

/// Below this quality a centre is drawn apart.
const POOR: f64 = 0.5;

/// Standard deviation of the centre along the whole stripe, poor centres apart.
pub fn quality(s: &StripeSample) -> Plot {
    let pick = |poor: bool| {
        let centres = s.centres.iter().filter(move |c| (c[3] < POOR) == poor);
        centres.map(|c| (c[0], c[2])).collect::<Vec<_>>()
    };
    let poor = pick(true);
    let mut series = vec![Series::new(
        &format!("quality {POOR} and better"),
        0,
        Kind::Points,
        pick(false),
    )];
    if !poor.is_empty() {
        series.push(Series::new(
            &format!("quality below {POOR}"),
            1,
            Kind::Crosses,
            poor,
        ));
    }
    Plot {
        title: format!("σ of the centre along the stripe at {:.1} mm", s.slide_mm),
        x_label: "u / px".into(),
        y_label: "σ / px".into(),
        series,
        ..Plot::default()
    }
}
