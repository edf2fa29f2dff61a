//! `cannula plot calibration|cloud|stripes|puncture INPUT -o FILE.svg|png`: a chart for a paper or a
//! talk.

use super::Output;
use super::output::BadArgument;
use crate::cloud::read_ply;
use crate::output::{CalibrationFile, read_calibration, write_whole};
use crate::pipeline::{Method, Times, calibrate};
use crate::report::chart::{self, Plot, figure};
use crate::report::{calibration_section, puncture_folder, stripe_middle, stripe_sample};
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
    /// Centres over the picture, and their uncertainty, in a scan frame of a session.
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
    /// Width and height of the whole picture, px (640 × 420 a chart if not given).
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = pixels)]
    size: Option<(u32, u32)>,
    /// Words, lines and marks so many times as large; without --size the whole grows with them.
    #[arg(long, value_name = "TIMES", value_parser = times)]
    scale: Option<f64>,
    /// Width on paper, mm; written into the file.
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    width: Option<f64>,
}

fn pixels(text: &str) -> Result<(u32, u32), String> {
    let parts = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match parts {
        Some((w, h)) if (200..=20_000).contains(&w) && (150..=20_000).contains(&h) => Ok((w, h)),
        _ => Err("give pixels as 1600x1000, from 200x150 to 20000x20000".to_owned()),
    }
}

fn times(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.25..=10.0).contains(&v) => Ok(v),
        _ => Err("give a number from 0.25 to 10".to_owned()),
    }
}

fn millimetres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (10.0..=2000.0).contains(&v) => Ok(v),
        _ => Err("give millimetres, 10 to 2000".to_owned()),
    }
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
            let c = calibration_section(&file, &[], None);
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
            (job, vec![chart::cloud(&points, entry(&path))])
        }
        What::Stripes { job, frame } => {
            let session = Session::open(&job.input)?;
            let frames = session.manifest.scan.as_ref().map_or(0, |s| s.frames.len());
            if let Some(asked) = frame
                && asked >= frames
                && frames > 0
            {
                anyhow::bail!(
                    "{}: its scan has no frame {asked}; give --frame 0 to {}",
                    session.file().display(),
                    frames - 1
                );
            }
            let sample = stripe_sample(&session, frame)?.ok_or_else(|| {
                anyhow::anyhow!(
                    "{}: frame {} shows no stripe on the hand; give another with --frame",
                    session.file().display(),
                    frame.unwrap_or(frames / 2)
                )
            })?;
            let middle = stripe_middle(&session, &sample)?;
            let plots = vec![
                chart::centres(&sample),
                chart::centres(&middle),
                chart::quality(&sample),
            ];
            (job, plots)
        }
        What::Puncture(job) => {
            let p = puncture_folder(&job.input)?;
            let mut plots = vec![chart::forces(&p)];
            plots.extend(p.runs.iter().map(chart::force_by_layer));
            (job, plots)
        }
    };
    let size = figure::Size {
        pixels: job.size,
        scale: job.scale,
        width_mm: job.width,
    };
    write(&job.output, &plots, size)?;
    let written = serde_json::json!({ "file": job.output });
    out.result(&written, || format!("written: {}", job.output.display()))
}

/// The entry of the result beside a cloud, if there is one of this cloud.
fn entry(cloud: &Path) -> Option<[f64; 3]> {
    let text = std::fs::read(cloud.with_file_name("result.json")).ok()?;
    let result: serde_json::Value = serde_json::from_slice(&text).ok()?;
    let own = result["cloud"]["file"].as_str() == cloud.file_name()?.to_str();
    let point = result["entry"]["point_mm"].as_array().filter(|_| own)?;
    let at = |k: usize| point.get(k)?.as_f64();
    Some([at(0)?, at(1)?, at(2)?])
}

fn write(path: &Path, plots: &[Plot], size: figure::Size) -> anyhow::Result<()> {
    let bytes = match path.extension().and_then(|e| e.to_str()) {
        Some("svg") => figure::svg(plots, size).map(String::into_bytes),
        Some("png") => figure::png(plots, size),
        _ => {
            let text = format!("{}: give a name that ends in .svg or .png", path.display());
            return Err(BadArgument(text).into());
        }
    };
    let bytes = bytes.context("the chart can't be drawn")?;
    write_whole(path, |w| w.write_all(&bytes))?;
    Ok(())
}
