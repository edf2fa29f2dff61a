//! The page as a reader's program sees it.

use crate::report::model::*;
use crate::report::render;

fn full() -> Report {
    Report {
        title: "a <b>bold</b> session".into(),
        headline: String::new(),
        verdict: Some(Verdict {
            usable: false,
            reasons: vec!["the region has a hole".into()],
            warnings: vec!["few tilted views".into()],
        }),
        needle: Some(Needle {
            angle_deg: 30.0,
            angle_sigma_deg: 0.04,
            frames: vec![Frame {
                name: "camera".into(),
                entry_mm: [1.0, -2.0, 430.123],
                ..Frame::default()
            }],
            ..Needle::default()
        }),
        picture: Some(Picture {
            image: Gray {
                width: 4,
                height: 2,
                pixels: vec![9; 8],
            },
            entry: [1.0, 1.0],
            ..Picture::default()
        }),
        scene: Some(Scene {
            points: vec![[0.0, 0.0, 430.0], [1.0, 0.0, 431.0]],
            brightness: vec![3, 200],
            ..Scene::default()
        }),
        checks: vec![crate::checks::Check::refusal(
            "needle: refused",
            "the region has a hole",
        )],
        calibration: Some(Calibration {
            size: [1280, 960],
            views: vec![BoardView {
                rms_px: 0.01,
                corners: vec![[10.0, 10.0]],
                residuals: vec![[0.01, -0.02]],
                ..BoardView::default()
            }],
            positions: vec![
                Position::default(),
                Position {
                    slide_mm: 5.0,
                    spacing_mm: Some(5.001),
                    travelled_mm: Some(5.0),
                    ..Position::default()
                },
            ],
            light: Some(Light {
                normal: [0.0, -0.87, 0.48],
                travel: Some((-1.0, -190.0)),
            }),
            ..Calibration::default()
        }),
        stripes: vec![StripeSample {
            image: Gray {
                width: 4,
                height: 2,
                pixels: vec![9; 8],
            },
            centres: vec![[1.0, 0.5, 0.02, 1.0]],
            ..StripeSample::default()
        }],
        puncture: Some(Puncture {
            runs: vec![PunctureRun {
                angle_deg: 30.0,
                curve: vec![[0.0; 5], [1.0, 2.0, 1.0, 0.5, 0.5]],
                ..PunctureRun::default()
            }],
            ..Puncture::default()
        }),
        truth: vec![TruthRow {
            what: "entry".into(),
            error: 0.07,
            unit: "mm".into(),
            limit: Some(0.06),
        }],
        provenance: Provenance {
            stages: vec![("corners".into(), 12.0)],
            ..Provenance::default()
        },
    }
}

#[test]
fn every_section_is_there_and_text_is_escaped() {
    let page = render(&full());
    for word in [
        "Not usable",
        "the region has a hole",
        "430.123",
        "Table 2: distance",
        "Table 4: D predicted",
        "Stripes",
        "Puncture",
        "Against the truth",
        "Provenance",
        "not a medical device",
    ] {
        assert!(page.contains(word), "{word} is missing");
    }
    assert!(page.contains("a &lt;b&gt;bold") && !page.contains("<b>bold"));
    assert!(
        page.contains("class=\"over\""),
        "an error over its limit is marked"
    );
}

#[test]
fn only_what_was_checked_is_said_to_be_sound() {
    let mut report = full();
    let calibration = report.calibration.as_mut().unwrap();
    assert!(calibration.findings.is_empty());
    calibration.checked = 2;
    assert!(render(&report).contains("Nothing: all 2 checks of it are sound."));
    report.calibration.as_mut().unwrap().checked = 0;
    assert!(render(&report).contains("Nothing was checked."));
}

#[test]
fn nothing_is_fetched() {
    let page = render(&full());
    // No element of the page names an address (the bundled library names one XML namespace).
    for pattern in [
        "src=\"http",
        "href=\"http",
        "url(http",
        "@import",
        "fetch(",
        "XMLHttpRequest",
    ] {
        assert!(!page.contains(pattern), "{pattern}");
    }
}

#[test]
fn an_empty_report_is_a_page() {
    let page = render(&Report::default());
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>"));
    assert!(!page.contains("<script"));
}
