//! `cannula plot calibration|cloud|stripes|puncture INPUT -o FILE.svg|png`: a chart for a paper or a
//! talk.

use super::Output;
use super::output::BadArgument;
use crate::cloud::read_ply;
use crate::output::{CalibrationFile, read_calibration, write_whole};
use crate::pipeline::{Method, Times, calibrate};
use crate::report::chart::{self, Plot, figure};
use crate::report::{calibration_section, puncture_folder, stripe_sample};
use crate::session::Session;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand, Debug)]
enum What {
    /// Reprojection residuals, coverage, tilts and light planes of a session, or of a calibration.json.
    Calibration(Job),
    /// The cloud from above; INPUT is a folder with cloud.ply.
    Cloud(Job),
    /// Centres and their uncertainty in a scan frame of a session.
    Stripes {
        #[command(flatten)]
        job: Job,
        /// Which frame, from 0 (the middle one if not given).
        #[arg(long)]
        frame: Option<usize>,
    },
    /// Force curves; INPUT is a folder with puncture.json.
    Puncture(Job),
}

#[derive(clap::Args, Debug)]
struct Job {
    /// The session, or the folder of results.
    input: PathBuf,
    /// The picture: .svg or .png.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let (job, plots) = match args.what {
        What::Calibration(job) => {
            let file = if job.input.extension().is_some_and(|e| e == "json")
                && job.input.file_name().is_some_and(|n| n != "session.json")
            {
                read_calibration(&job.input)?
            } else {
                let session = Session::open(&job.input)?;
                let found = calibrate(&session, Method::Ml, &Times::default(), out)?;
                CalibrationFile::new(&found, &session)
            };
            let c = calibration_section(&file, Vec::new(), None);
            let mut plots = vec![
                chart::view_rms(&c),
                chart::residuals(&c),
                chart::coverage(&c),
                chart::tilts(&c),
            ];
            if c.positions.len() > 1 {
                plots.extend([chart::offsets(&c), chart::figure_14(&c)]);
            }
            (job, plots)
        }
        What::Cloud(job) => {
            let path = job.input.join("cloud.ply");
            let file = std::fs::File::open(&path).with_context(|| {
                format!(
                    "{}: give a folder that `cannula process` wrote",
                    path.display()
                )
            })?;
            let points = read_ply(file).with_context(|| path.display().to_string())?;
            (job, vec![chart::cloud(&points, None)])
        }
        What::Stripes { job, frame } => {
            let session = Session::open(&job.input)?;
            let sample = stripe_sample(&session, frame)?.ok_or_else(|| {
                anyhow::anyhow!(
                    "{}: no stripe in that frame; give another with --frame",
                    session.file().display()
                )
            })?;
            (job, vec![chart::centres(&sample), chart::quality(&sample)])
        }
        What::Puncture(job) => {
            let p = puncture_folder(&job.input)?;
            let mut plots = vec![chart::forces(&p)];
            plots.extend(p.runs.iter().map(chart::force_by_layer));
            (job, plots)
        }
    };
    write(&job.output, &plots)?;
    let written = serde_json::json!({ "file": job.output });
    out.result(&written, || format!("written: {}", job.output.display()))
}

fn write(path: &Path, plots: &[Plot]) -> anyhow::Result<()> {
    let bytes = match path.extension().and_then(|e| e.to_str()) {
        Some("svg") => figure::svg(plots).map(String::into_bytes),
        Some("png") => figure::png(plots),
        _ => {
            let text = format!("{}: give a name that ends in .svg or .png", path.display());
            return Err(BadArgument(text).into());
        }
    };
    let bytes = bytes.context("the chart can't be drawn")?;
    write_whole(path, |w| w.write_all(&bytes))?;
    Ok(())
}
