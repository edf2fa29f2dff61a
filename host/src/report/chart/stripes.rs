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

/// Standard deviation of the centre along the stripe.
pub fn quality(s: &StripeSample) -> Plot {
    Plot {
        title: format!(
            "Stripe at {:.1} mm: standard deviation of its centre",
            s.slide_mm
        ),
        x_label: "u / px".into(),
        y_label: "σ / px".into(),
        series: vec![Series::new(
            "",
            0,
            Kind::Dots,
            s.centres.iter().map(|c| (c[0], c[2])).collect(),
        )],
        ..Plot::default()
    }
}
