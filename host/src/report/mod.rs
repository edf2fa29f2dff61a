//! `report.html`: one file without network, for a screen and for paper.
//!
//! [`model`] is what a report shows, as plain data; [`chart`] draws; the page is put together from them. The
//! turnable view is three.js, bundled by `host/report-viewer` into `viewer.min.js`.

pub mod chart;
pub mod model;
mod page;
mod raster;
mod sources;
mod write;

pub use model::{Puncture, Report, TruthRow};
pub use sources::{
    calibration as calibration_section, calibration_settings, decided, leaves, puncture_folder,
    punctured, settings, stripe_middle, stripe_sample, under, with_reference,
};
pub use write::{Outcome, ReportError, Sources, assemble, of_puncture, write};

/// The whole page.
pub fn render(report: &Report) -> String {
    page::render(report)
}
