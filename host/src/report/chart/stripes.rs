//! Quality along a stripe.

use super::{Kind, Plot, Series, Under};
use crate::report::model::StripeSample;
use crate::report::raster::brightened;
use crate::stripe::Axis;

/// The centres over the piece of the frame that the sample holds, v downwards.
pub fn centres(s: &StripeSample) -> Plot {
    // A pixel reaches half a pixel around its centre.
    let [left, top] = s.origin.map(|x| x - 0.5);
    let right = left + s.side * s.image.width as f64;
    let bottom = top + s.side * s.image.height as f64;
    let inside = |c: &&[f64; 4]| (left..right).contains(&c[0]) && (top..bottom).contains(&c[1]);
    let points = s.centres.iter().filter(inside).map(|c| (c[0], c[1]));
    Plot {
        title: format!(
            "{}: the stripe’s centres, slide at {:.1} mm",
            s.name, s.slide_mm
        ),
        x_label: "u / px".into(),
        y_label: "v / px".into(),
        x_range: Some((left, right)),
        y_range: Some((bottom, top)),
        series: vec![Series::new("centre", 1, Kind::Points, points.collect())],
        equal: true,
        under: Some(Under {
            image: brightened(&s.image),
            corner: [left, top],
            side: s.side,
        }),
        ..Plot::default()
    }
}

/// Below this quality a centre is drawn apart.
const POOR: f64 = 0.5;

/// Standard deviation of the centre along the whole stripe, poor centres apart.
pub fn quality(s: &StripeSample) -> Plot {
    let (along, name) = match s.axis {
        Axis::Columns => (0, "u"),
        Axis::Rows => (1, "v"),
    };
    let pick = |poor: bool| {
        let centres = s.centres.iter().filter(move |c| (c[3] < POOR) == poor);
        centres.map(|c| (c[along], c[2])).collect::<Vec<_>>()
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
        x_label: format!("{name} / px"),
        y_label: "σ / px".into(),
        series,
        ..Plot::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quality_runs_along_the_stripe() {
        for (axis, label, at) in [
            (Axis::Columns, "u / px", 30.0),
            (Axis::Rows, "v / px", 70.0),
        ] {
            let plot = quality(&StripeSample {
                axis,
                centres: vec![[30.0, 70.0, 0.02, 1.0]],
                ..StripeSample::default()
            });
            assert_eq!(plot.x_label, label);
            assert_eq!(plot.series[0].points, [(at, 0.02)]);
        }
    }
}
