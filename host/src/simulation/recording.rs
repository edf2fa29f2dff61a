//! Writes a whole recording of a scene, with its truth, straight from the renderer (no board, no
//! link): `cannula simulate --session`.

use super::profile::Profile;
use super::random::Random;
use super::render::{Renderer, Subject};
use super::scene::Scene;
use super::truth::{Lit, Recorded, Truth, to_json};
use crate::geometry::Plane;
use crate::output::{OutputError, write_whole};
use crate::progress::Progress;
use crate::session::{self, Manifest, SessionError};
use rayon::prelude::*;
use std::path::Path;

/// Steps of the simulated slide a millimetre: 200 full steps of 16 microsteps on a screw of 10 mm.
pub const STEPS_PER_MM: f64 = 320.0;

/// Why no recording was written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The scene of this seed can't be rendered.
    #[error("seed {0} gives a scene that can't be rendered: take another")]
    Seed(u64),
    /// A file could not be written.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// truth.json could not be written.
    #[error(transparent)]
    Truth(#[from] OutputError),
}

/// The number of a frame in the noise's streams: images of one recording must not share noise.
#[derive(Clone, Copy, Debug)]
pub enum FrameId {
    /// Camera pose.
    Camera(usize),
    /// Light pose and position (0: laser off).
    Light(usize, usize),
    /// Scan position (0: laser off).
    Scan(usize),
}

impl FrameId {
    /// As a number.
    pub fn number(self) -> u64 {
        match self {
            Self::Camera(i) => i as u64,
            Self::Light(pose, k) => 1_000_000 + 10_000 * pose as u64 + k as u64,
            Self::Scan(k) => 2_000_000_000 + k as u64,
        }
    }
}

impl Scene {
    /// The true light plane of a frame whose steps say `slide_mm`: the slide's own error is added.
    pub fn lit_plane(&self, slide_mm: f64, frame: u64) -> Plane {
        let jitter = Random::new(self.seed, 0x511D_0000_0000 ^ frame).normal();
        self.laser
            .plane(slide_mm + jitter * self.parameters.slide_jitter_mm)
    }
}

/// Writes the recording of a seed to `folder` (session.json, images, truth.json); gives the truth.
pub fn record(
    folder: &Path,
    profile: Profile,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Truth, RecordError> {
    record_scene(folder, Scene::new(profile, seed), progress)
}

/// [`record`] for a scene that was drawn already.
///
/// # Errors
/// As of [`record`].
pub fn record_scene(
    folder: &Path,
    scene: Scene,
    progress: &dyn Progress,
) -> Result<Truth, RecordError> {
    let seed = scene.seed;
    let truth = Truth::new(&scene).ok_or(RecordError::Seed(seed))?;
    let renderer = Renderer::new(scene).ok_or(RecordError::Seed(seed))?;
    let scene = renderer.scene();
    let p = &scene.parameters;
    let board_exposure = f64::from(p.board_exposure);
    let positions = scene.light_positions();
    let scan_positions = scene.scan_positions();
    let total = p.camera_poses + p.light_poses * (1 + positions.len()) + 1 + scan_positions.len();
    progress.start("rendering", total);

    let mut manifest = Manifest::new(p.width, p.height);
    manifest.board = Some(session::BoardSpec {
        columns: scene.board.columns,
        rows: scene.board.rows,
        square_mm: scene.board.square_mm,
    });
    manifest.entry = Some(truth.entry.clone());
    let mut recorded = Recorded::default();
    let write = |name: &str, image| {
        let done = session::write_png(&folder.join(name), &image);
        progress.step();
        done
    };
    let frame = |image: String, slide_mm: f64| session::Frame {
        slide_mm,
        slide_steps: Some((slide_mm * STEPS_PER_MM).round() as i64),
        trigger_us: None,
        image,
    };

    for (i, pose) in scene.camera_poses.iter().enumerate() {
        recorded.camera.push((format!("camera/{i:02}.png"), *pose));
    }
    recorded
        .camera
        .par_iter()
        .enumerate()
        .try_for_each(|(i, (name, pose))| {
            let still = renderer.still(&Subject::Board(*pose));
            let id = FrameId::Camera(i).number();
            write(name, renderer.frame(&still, board_exposure, None, id))
        })?;
    manifest.camera = recorded
        .camera
        .iter()
        .map(|(image, _)| session::CameraView {
            image: image.clone(),
        })
        .collect();

    for (i, pose) in scene.light_poses.iter().enumerate() {
        let still = renderer.still(&Subject::Board(*pose));
        let off = format!("light/{i:02}/off.png");
        write(
            &off,
            renderer.frame(&still, 1.0, None, FrameId::Light(i, 0).number()),
        )?;
        let on: Vec<(session::Frame, Lit)> = positions
            .par_iter()
            .enumerate()
            .map(|(k, &slide_mm)| {
                let name = format!("light/{i:02}/on_{k:02}.png");
                let id = FrameId::Light(i, k + 1).number();
                let plane = scene.lit_plane(slide_mm, id);
                write(&name, renderer.frame(&still, 1.0, Some(&plane), id))?;
                Ok((
                    frame(name, slide_mm),
                    Lit {
                        slide_mm,
                        d: plane.d,
                    },
                ))
            })
            .collect::<Result<_, SessionError>>()?;
        let (on, lit) = on.into_iter().unzip();
        recorded.light.push((off.clone(), *pose, lit));
        manifest
            .light
            .push(session::LightPose { off: Some(off), on });
    }

    let still = renderer.still(&Subject::Hand);
    let ambient = "scan/ambient.png".to_owned();
    write(
        &ambient,
        renderer.frame(&still, 1.0, None, FrameId::Scan(0).number()),
    )?;
    let frames: Vec<(session::Frame, Lit)> = scan_positions
        .par_iter()
        .enumerate()
        .map(|(k, &slide_mm)| {
            let name = format!("scan/{k:03}.png");
            let id = FrameId::Scan(k + 1).number();
            let plane = scene.lit_plane(slide_mm, id);
            write(&name, renderer.frame(&still, 1.0, Some(&plane), id))?;
            let mut frame = frame(name, slide_mm);
            frame.trigger_us = Some(1_000_000 + 40_000 * k as u64);
            Ok((
                frame,
                Lit {
                    slide_mm,
                    d: plane.d,
                },
            ))
        })
        .collect::<Result<_, SessionError>>()?;
    let (frames, lit) = frames.into_iter().unzip();
    recorded.scan = lit;
    manifest.scan = Some(session::Scan {
        ambient: Some(ambient),
        frames,
    });
    session::write(folder, &manifest)?;

    write_truth(folder, &renderer, &truth, &recorded)?;
    progress.finish();
    Ok(truth)
}

/// Writes truth.json beside a recording.
pub fn write_truth(
    folder: &Path,
    renderer: &Renderer,
    truth: &Truth,
    recorded: &Recorded,
) -> Result<(), RecordError> {
    let object = to_json(renderer, truth, recorded);
    Ok(write_whole(&folder.join("truth.json"), |out| {
        Ok(serde_json::to_writer(out, &object)?)
    })?)
}
