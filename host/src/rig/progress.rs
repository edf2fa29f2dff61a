//! A sweep under way: what stands of it on disk, so that one that was broken off goes on where it was.
//!
//! [`FILE`] lies beside the images until the sweep is complete: a line with the settings, then a line
//! a shot, written before its image. A shot stands if its image does and can be read; it
//! appears whole or not at all.

use super::config::{CameraKind, Rig};
use super::recording::RecordingError;
use super::writer::WriteError;
use crate::session::Frame;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The file's name, in the folder of the images.
pub const FILE: &str = "progress.jsonl";

/// What must be the same when a sweep goes on: keys of the rig's configuration with their values.
pub type Settings = BTreeMap<String, Value>;

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Settings(Settings),
    Shot { index: u32, frame: Frame },
}

/// A sweep under way.
#[derive(Debug)]
pub struct Progress {
    folder: PathBuf,
    settings: Settings,
    frames: Vec<(u32, Frame)>,
    file: Option<File>,
}

/// A part of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Board poses for the camera.
    Camera,
    /// Board poses for the light planes.
    Light,
    /// The scan of the hand.
    Scan,
}

impl Part {
    /// All of them, in the order of recording.
    pub const ALL: [Self; 3] = [Self::Camera, Self::Light, Self::Scan];

    /// Its name in session.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Light => "light",
            Self::Scan => "scan",
        }
    }
}

/// What the images of a part depend on.
pub fn settings(rig: &Rig, part: Part) -> Settings {
    let (b, c) = (&rig.board, &rig.camera);
    let mut all = vec![
        ("camera.kind", json!(c.kind)),
        ("camera.device", json!(c.device)),
        ("camera.pixel_format", json!(c.pixel_format)),
        ("camera.region", json!(c.region)),
        ("camera.gain_db", json!(c.gain_db)),
    ];
    if part == Part::Camera {
        all.push(("camera.exposure_board_ms", json!(c.exposure_board_ms)));
    } else {
        all.extend([
            ("board.steps_per_mm", json!(b.steps_per_mm)),
            ("board.invert_direction", json!(b.invert_direction)),
            ("board.clearance_mm", json!(b.clearance_mm)),
            ("camera.exposure_laser_ms", json!(c.exposure_laser_ms)),
        ]);
    }
    let (light, scan) = (&rig.light, &rig.scan);
    match part {
        Part::Camera => {}
        Part::Light => all.extend([
            ("light.start_mm", json!(light.start_mm)),
            ("light.spacing_mm", json!(light.spacing_mm)),
            ("light.count", json!(light.count)),
        ]),
        Part::Scan => all.extend([
            ("scan.start_mm", json!(scan.start_mm)),
            ("scan.spacing_mm", json!(scan.spacing_mm)),
            ("scan.count", json!(scan.count)),
        ]),
    }
    if c.kind == CameraKind::Simulated {
        all.push(("simulation.seed", json!(rig.simulation.seed)));
        all.push(("simulation.profile", json!(rig.simulation.profile)));
    }
    all.into_iter().map(|(k, v)| (k.to_owned(), v)).collect()
}

/// What must be the same in all parts of a recording, for one calibration to hold for them: which
/// camera and which of its pixels, and what a step of the slide is. (Exposure and gain may differ.)
pub fn binds_all(key: &str) -> bool {
    key.starts_with("board.")
        || key.starts_with("simulation.")
        || ["camera.kind", "camera.device", "camera.region"].contains(&key)
}

/// The first setting that is not what it was: key, what it was, what it is.
pub fn differs(then: &Settings, now: &Settings) -> Option<(String, String, String)> {
    let (key, here) = now.iter().find(|(k, v)| then.get(*k) != Some(v))?;
    let there = then
        .get(key)
        .map_or_else(|| "not known".into(), Value::to_string);
    Some((key.clone(), there, here.to_string()))
}

impl Progress {
    /// What stands in `folder` of a sweep that was broken off there; `images` is the folder that the
    /// frames' names are relative to. `None` if none was.
    ///
    /// # Errors
    /// It can't be read.
    pub fn find(folder: &Path, images: &Path) -> Result<Option<Self>, RecordingError> {
        let path = folder.join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                return Ok(None);
            }
            Err(e) => return Err(failed(&path, &e)),
        };
        let mut found = Self {
            folder: folder.to_owned(),
            settings: Settings::new(),
            frames: Vec::new(),
            file: None,
        };
        // The last line may be torn; what does not stand is taken again.
        for line in text.lines().filter_map(|l| serde_json::from_str(l).ok()) {
            match line {
                Line::Settings(settings) => found.settings = settings,
                Line::Shot { index, frame } => {
                    let known = found.frames.iter().any(|(i, _)| *i == index);
                    // An image that can't be read (a power cut, another program) is none.
                    if !known && super::folder::read(&images.join(&frame.image)).is_ok() {
                        found.frames.push((index, frame));
                    }
                }
            }
        }
        Ok(Some(found))
    }

    /// Begins a sweep in a folder, which is made.
    ///
    /// # Errors
    /// It can't be written.
    pub fn begin(folder: &Path, settings: Settings) -> Result<Self, RecordingError> {
        let mut begun = Self {
            folder: folder.to_owned(),
            settings,
            frames: Vec::new(),
            file: None,
        };
        begun.write()?;
        Ok(begun)
    }

    /// Whether the sweep was begun with these settings.
    pub fn is_of(&self, settings: &Settings) -> bool {
        differs(&self.settings, settings).is_none()
    }

    /// Goes on with a sweep that was found.
    ///
    /// # Errors
    /// It was begun with other settings, or the file can't be written.
    pub fn go_on(mut self, now: Settings) -> Result<Self, RecordingError> {
        // Killed before anything was recorded: nothing is bound.
        if !self.frames.is_empty()
            && let Some((key, there, here)) = differs(&self.settings, &now)
        {
            return Err(RecordingError::Settings {
                path: self.folder.join(FILE),
                key,
                there,
                here,
            });
        }
        self.settings = now;
        self.write()?;
        Ok(self)
    }

    /// Writes the file anew, whole or not at all, and leaves it open for more.
    fn write(&mut self) -> Result<(), RecordingError> {
        let path = self.folder.join(FILE);
        let fail = |e: std::io::Error| failed(&path, &e);
        std::fs::create_dir_all(&self.folder).map_err(fail)?;
        let mut file = tempfile::NamedTempFile::new_in(&self.folder).map_err(fail)?;
        let lines = std::iter::once(Line::Settings(self.settings.clone())).chain(
            self.frames.iter().map(|(index, frame)| Line::Shot {
                index: *index,
                frame: frame.clone(),
            }),
        );
        for line in lines {
            put(file.as_file_mut(), &line).map_err(fail)?;
        }
        file.as_file().sync_all().map_err(fail)?;
        self.file = Some(file.persist(&path).map_err(|e| fail(e.error))?);
        Ok(())
    }

    /// Shots that stand, as they were taken.
    pub fn frames(&self) -> &[(u32, Frame)] {
        &self.frames
    }

    /// The folder of the images.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A shot whose image is about to be written.
    ///
    /// # Errors
    /// It can't be written.
    pub fn add(&mut self, index: u32, frame: Frame) -> Result<(), WriteError> {
        let line = Line::Shot {
            index,
            frame: frame.clone(),
        };
        if let Some(file) = &mut self.file {
            put(file, &line).map_err(|e| WriteError {
                path: self.folder.join(FILE),
                reason: e.to_string(),
            })?;
        }
        self.frames.push((index, frame));
        Ok(())
    }

    /// The sweep is complete and session.json names it: gives its frames.
    ///
    /// # Errors
    /// The file can't be removed.
    pub fn finish(self) -> Result<(), RecordingError> {
        let path = self.folder.join(FILE);
        std::fs::remove_file(&path).map_err(|e| failed(&path, &e))
    }

    /// Throws away what stands of a sweep that was broken off; a file that no sweep writes stays, and
    /// its folder with it.
    ///
    /// # Errors
    /// It can't be removed.
    pub fn discard(self) -> Result<(), RecordingError> {
        let fail = |e: std::io::Error| failed(&self.folder, &e);
        let mut empty = true;
        for entry in std::fs::read_dir(&self.folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if is_of_sweep(&path) {
                std::fs::remove_file(&path).map_err(|e| failed(&path, &e))?;
            } else {
                empty = false;
            }
        }
        if empty {
            std::fs::remove_dir(&self.folder).map_err(fail)?;
        }
        Ok(())
    }
}

/// Whether a file in the folder of a sweep can be the sweep's: an image, one in the making, its
/// progress.
pub fn is_of_sweep(path: &Path) -> bool {
    let image = path.extension().is_some_and(|e| e == "png" || e == "part");
    (image || path.ends_with(FILE)) && !path.is_dir()
}

fn put(file: &mut File, line: &Line) -> std::io::Result<()> {
    let mut text = serde_json::to_vec(line)?;
    text.push(b'\n');
    file.write_all(&text)
}

fn failed(path: &Path, e: &std::io::Error) -> RecordingError {
    WriteError {
        path: path.to_owned(),
        reason: e.to_string(),
    }
    .into()
}
