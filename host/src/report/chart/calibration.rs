//! Charts of the calibration: reprojection residuals, coverage, tilts, slide positions.

use super::{Kind, Plot, Series};
use crate::report::model::Calibration;

/// Root mean square reprojection error of each view.
pub fn view_rms(c: &Calibration) -> Plot {
    let bars = c
        .views
        .iter()
        .enumerate()
        .map(|(i, v)| (i as f64 + 1.0, v.rms_px))
        .collect();
    Plot {
        title: "Reprojection error of each view".into(),
        x_label: "view".into(),
        y_label: "RMS / px".into(),
        x_range: Some((0.4, c.views.len() as f64 + 0.6)),
        series: vec![
            Series::new("each view", 0, Kind::Bars(0.7), bars),
            Series::new(
                "all views",
                1,
                Kind::Dashes(6, 4),
                vec![(0.4, c.rms_px), (c.views.len() as f64 + 0.6, c.rms_px)],
            ),
        ],
        ..Plot::default()
    }
}

/// The whole image as axes, v downwards.
fn image_axes(c: &Calibration, title: String) -> Plot {
    Plot {
        title,
        x_label: "u / px".into(),
        y_label: "v / px".into(),
        x_range: Some((0.0, f64::from(c.size[0]))),
        y_range: Some((f64::from(c.size[1]), 0.0)),
        equal: true,
        ..Plot::default()
    }
}

/// Residuals over the image, drawn longer by a factor that the title names.
pub fn residuals(c: &Calibration) -> Plot {
    let largest = c
        .views
        .iter()
        .flat_map(|v| &v.residuals)
        .map(|r| r[0].hypot(r[1]))
        .fold(0.0, f64::max);
    // The longest line takes at most a tenth of the image's width; 1, 2 or 5 with zeros.
    let room = if largest > 0.0 {
        f64::from(c.size[0]) / 10.0 / largest
    } else {
        1.0
    };
    let decade = 10f64.powf(room.log10().floor());
    let scale = decade
        * [5.0, 2.0, 1.0]
            .into_iter()
            .find(|m| m * decade <= room)
            .unwrap_or(1.0);
    let corners = || {
        c.views
            .iter()
            .flat_map(|v| v.corners.iter().zip(&v.residuals))
    };
    let segments = corners()
        .flat_map(|(p, r)| [(p[0], p[1]), (p[0] + scale * r[0], p[1] + scale * r[1])])
        .collect();
    let feet = corners().map(|(p, _)| (p[0], p[1])).collect();
    let mut plot = image_axes(
        c,
        format!("Reprojection residuals, drawn {scale} times longer"),
    );
    plot.series = vec![
        Series::new(
            &format!("observed − reprojected, {largest:.3} px at most"),
            0,
            Kind::Segments,
            segments,
        ),
        Series::new("corner", 1, Kind::Points, feet),
    ];
    plot
}

/// Where the boards stood in the image.
pub fn coverage(c: &Calibration) -> Plot {
    let mut plot = image_axes(c, "Coverage: the corner grid in each view".into());
    for (i, v) in c.views.iter().enumerate() {
        let mut outline: Vec<(f64, f64)> = v.outline.iter().map(|p| (p[0], p[1])).collect();
        outline.extend(outline.first().copied());
        plot.series.push(Series::new("", i, Kind::Line, outline));
    }
    plot
}

/// How the boards were tilted.
pub fn tilts(c: &Calibration) -> Plot {
    Plot {
        title: "Tilt of the board in each view".into(),
        x_label: "about the vertical / °".into(),
        y_label: "about the horizontal / °".into(),
        x_range: Some((-60.0, 60.0)),
        y_range: Some((-60.0, 60.0)),
        series: vec![Series::new(
            "",
            0,
            Kind::Dots,
            c.views
                .iter()
                .filter_map(|v| v.tilt_deg.map(|t| (t[1], t[0])))
                .collect(),
        )],
        ..Plot::default()
    }
}

/// D predicted minus D fitted, and the hold-out check, at each slide position.
pub fn offsets(c: &Calibration) -> Plot {
    let mut series = vec![Series::new(
        "all positions",
        0,
        Kind::Dots,
        c.positions
            .iter()
            .map(|p| (p.slide_mm, 1e3 * (p.predicted_mm - p.fitted_mm)))
            .collect(),
    )];
    let held: Vec<(f64, f64)> = c
        .positions
        .iter()
        .filter_map(|p| Some((p.slide_mm, 1e3 * p.hold_out_mm?)))
        .collect();
    if !held.is_empty() {
        series.push(Series::new("hold-out, absolute", 1, Kind::Crosses, held));
    }
    Plot {
        title: "Light plane: D predicted − D fitted".into(),
        x_label: "slide / mm".into(),
        y_label: "difference / µm".into(),
        series,
        ..Plot::default()
    }
}

/// Mean distance of the points from their plane, before and after Eq. 7.
pub fn figure_14(c: &Calibration) -> Plot {
    let pick =
        |f: fn(&(f64, f64, f64)) -> f64| c.figure_14.iter().map(|r| (r.0, 1e3 * f(r))).collect();
    Plot {
        title: "Points to their plane (as Figure 14)".into(),
        x_label: "slide / mm".into(),
        y_label: "mean distance / µm".into(),
        series: vec![
            Series::new("not optimised", 1, Kind::Crosses, pick(|r| r.1)),
            Series::new("optimised", 0, Kind::Dots, pick(|r| r.2)),
        ],
        ..Plot::default()
    }
}
