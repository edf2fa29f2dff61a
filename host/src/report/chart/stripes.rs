//! Quality along a stripe.

use super::{Kind, Plot, Series};
use crate::report::model::StripeSample;

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
