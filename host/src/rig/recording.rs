//! A recording in the making: session.json grows pose by pose, and goes on where it was broken off.
//!
//! What session.json names is whole at any time: images are written first, under names that were
//! not there before, and the file after them. Nothing is overwritten.

use super::camera::Picture;
use super::config::Rig;
use super::kept::Kept;
use super::progress::{self, Part, Progress, Settings};
use super::writer::{WriteError, Writer, write_whole};
use crate::board::BoardGeometry;
use crate::session::{
    self, BoardSpec, CameraView, Entry, Frame, LightPose, Manifest, Scan, SessionError,
};
use std::path::{Path, PathBuf};

/// Why a recording can't go on.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// session.json.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// An image.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The recording there is of another camera or board.
    #[error("{path}: recorded with {there}, now it is {here}; give another folder", path = path.display())]
    Different {
        /// session.json.
        path: PathBuf,
        /// What it says.
        there: String,
        /// What is set now.
        here: String,
    },
    /// That part stands already.
    #[error("{path}: a {part} stands there; give another folder, or --force to record it anew", path = path.display())]
    Stands {
        /// session.json.
        path: PathBuf,
        /// Which part.
        part: &'static str,
    },
    /// Another part of the recording is of another camera, scene or slide.
    #[error("{path}: its part \"{part}\" was recorded with {key} = {there}, now it is {here}; set it back to go on, or give another folder", path = path.display())]
    OtherPart {
        /// session.json.
        path: PathBuf,
        /// The part.
        part: &'static str,
        /// The key of the rig's configuration.
        key: String,
        /// What it was.
        there: String,
        /// What it is.
        here: String,
    },
    /// A part, or a sweep that was broken off, was begun with other settings.
    #[error("{path}: this was begun with {key} = {there}, now it is {here}; set it back to go on, or --force to record it anew", path = path.display())]
    Settings {
        /// Where it stands.
        path: PathBuf,
        /// The key of the rig's configuration.
        key: String,
        /// What it was.
        there: String,
        /// What it is.
        here: String,
    },
    /// Another part's slide has other steps.
    #[error("{path}: its part \"{part}\" is of a slide with another board.steps_per_mm, or with another zero: {image} lies at {there} mm after {steps} steps, which are {here:.3} mm now; set it back to go on, or give another folder", path = path.display())]
    Steps {
        /// session.json.
        path: PathBuf,
        /// The part.
        part: &'static str,
        /// Its image that shows it best.
        image: String,
        /// Its slide_steps.
        steps: i64,
        /// Its slide_mm.
        there: f64,
        /// What the steps are with the ratio that is set, mm.
        here: f64,
    },
    /// What is before the camera is not what was when a scan was broken off.
    #[error("{path}: the scene has changed since this scan was broken off ({percent:.1} % of the image differ): the hand or its light has moved; --force to record it anew", path = path.display())]
    Changed {
        /// The image of then.
        path: PathBuf,
        /// How much of the image differs.
        percent: f64,
    },
    /// The image without laser of a scan that was broken off can't be read.
    #[error(
        "{0}; without it nobody knows whether the scene is still the same: --force to record the scan anew"
    )]
    NoScene(String),
    /// The background writer could not be started.
    #[error("the writer could not be started: {0}")]
    Thread(std::io::Error),
}

/// Farther than this a frame's slide_mm does not lie from its steps, mm (as `session::check` has it).
const STEPS_APART_MM: f64 = 0.05;

/// For session.json.
fn now() -> String {
    crate::output::seconds(jiff::Timestamp::now())
}

/// A recording in the making.
pub struct Recording {
    folder: PathBuf,
    /// What session.json says, or will.
    pub manifest: Manifest,
    /// What it says beside that.
    kept: Option<Kept>,
}

impl Recording {
    /// Opens the recording in `folder`, or begins one there.
    pub fn open(
        folder: &Path,
        (width, height): (u32, u32),
        board: &BoardGeometry,
    ) -> Result<Self, RecordingError> {
        let path = folder.join("session.json");
        let spec = BoardSpec {
            columns: board.columns,
            rows: board.rows,
            square_mm: board.square_mm,
        };
        let mut kept = None;
        let manifest = match std::fs::read(&path) {
            Ok(text) => {
                let manifest = session::parse(&text, &path)?;
                kept = Kept::of(&text, &manifest);
                let there = (manifest.image.width, manifest.image.height);
                let different = |there: String, here: String| {
                    Err(RecordingError::Different {
                        path: path.clone(),
                        there,
                        here,
                    })
                };
                if there != (width, height) {
                    return different(
                        format!("images of {} × {}", there.0, there.1),
                        format!("{width} × {height}"),
                    );
                }
                if let Some(b) = manifest.board.filter(|b| *b != spec) {
                    return different(
                        format!(
                            "a board of {} × {} corners, {} mm",
                            b.columns, b.rows, b.square_mm
                        ),
                        format!("{} × {}, {} mm", spec.columns, spec.rows, spec.square_mm),
                    );
                }
                Manifest {
                    board: Some(spec),
                    ..manifest
                }
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Manifest {
                board: Some(spec),
                ..Manifest::new(width, height)
            },
            Err(source) => return Err(SessionError::Io { path, source }.into()),
        };
        Ok(Self {
            folder: folder.to_owned(),
            manifest,
            kept,
        })
    }

    /// Binds a part to the settings that it is recorded with: those that stand must be the same, of
    /// this part all (unless it is recorded anew with `force`), of the others what makes one rig.
    /// Of a part whose settings are not known (an older recording, another program's) the slide's steps
    /// bind, where the frames have them. What the part is going to be is then checked as a whole, before
    /// anything moves: after the sweep it would be too late.
    ///
    /// # Errors
    /// Another setting, named; a recording that could not be written.
    pub fn bind(&mut self, part: Part, rig: &Rig, force: bool) -> Result<(), RecordingError> {
        let path = || self.folder.join("session.json");
        let now = progress::settings(rig, part);
        for other in Part::ALL.into_iter().filter(|p| self.holds(*p)) {
            let Some(then) = self.manifest.recorded.settings.get(other.name()) else {
                continue;
            };
            if other == part && !force {
                if let Some((key, there, here)) = progress::differs(then, &now) {
                    let path = path();
                    return Err(RecordingError::Settings {
                        path,
                        key,
                        there,
                        here,
                    });
                }
            } else if other != part {
                let mut shared = now.clone();
                shared.retain(|key, _| progress::binds_all(key) && then.contains_key(key));
                if let Some((key, there, here)) = progress::differs(then, &shared) {
                    return Err(RecordingError::OtherPart {
                        path: path(),
                        part: other.name(),
                        key,
                        there,
                        here,
                    });
                }
            }
        }
        self.rehearse(part, rig, force)?;
        // Images of which nobody knows are not said to be of these settings.
        let unknown = self.holds(part)
            && !force
            && !self.manifest.recorded.settings.contains_key(part.name());
        if !unknown {
            let known = &mut self.manifest.recorded.settings;
            known.insert(part.name().to_owned(), now);
        }
        Ok(())
    }

    /// Checks the recording as it will be with this part.
    fn rehearse(&self, part: Part, rig: &Rig, force: bool) -> Result<(), RecordingError> {
        let request = match part {
            Part::Camera => return Ok(()),
            Part::Light => rig.light_request(),
            Part::Scan => rig.scan_request(),
        };
        let mut all = self.manifest.clone();
        if part == Part::Scan {
            all.scan = None;
        } else if force {
            all.light.clear();
        }
        let path = self.folder.join("session.json");
        let light = all.light.iter().flat_map(|pose| &pose.on);
        let scan = all.scan.iter().flat_map(|scan| &scan.frames);
        let stands = light
            .map(|f| (Part::Light, f))
            .chain(scan.map(|f| (Part::Scan, f)));
        let off = |f: &Frame| {
            f.slide_steps
                .map_or(0.0, |steps| (f.slide_mm - rig.mm(steps)).abs())
        };
        if let Some((part, frame)) = stands.max_by(|a, b| off(a.1).total_cmp(&off(b.1)))
            && off(frame) > STEPS_APART_MM.max(2.0 * rig.mm(1))
            && let Some(steps) = frame.slide_steps
        {
            return Err(RecordingError::Steps {
                path,
                part: part.name(),
                image: frame.image.clone(),
                steps,
                there: frame.slide_mm,
                here: rig.mm(steps),
            });
        }
        let planned = (0..request.count).map(|k| {
            let mm =
                1e-3 * (f64::from(request.start_um) + f64::from(request.spacing_um) * f64::from(k));
            let steps = (mm / rig.mm(1)).round() as i64;
            Frame {
                slide_mm: rig.mm(steps),
                slide_steps: Some(steps),
                trigger_us: None,
                image: format!("{} {k} to be", part.name()),
            }
        });
        let (off, frames) = (None, planned.collect());
        match part {
            Part::Scan => {
                all.scan = Some(Scan {
                    ambient: None,
                    frames,
                })
            }
            _ => all.light.push(LightPose { off, on: frames }),
        }
        Ok(session::check(&all, &path)?)
    }

    /// Sets the entry, checked against the image; `given` is the file that it comes from.
    ///
    /// # Errors
    /// It can't be.
    pub fn set_entry(&mut self, entry: Entry, given: &Path) -> Result<(), RecordingError> {
        let manifest = Manifest {
            entry: Some(entry),
            ..self.manifest.clone()
        };
        session::check(&manifest, given)?;
        self.manifest = manifest;
        Ok(())
    }

    fn holds(&self, part: Part) -> bool {
        match part {
            Part::Camera => !self.manifest.camera.is_empty(),
            Part::Light => !self.manifest.light.is_empty(),
            Part::Scan => self.manifest.scan.is_some(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where an image of the recording is.
    pub fn path(&self, image: &str) -> PathBuf {
        self.folder.join(image)
    }

    /// Writes session.json, with what was found in it that is not known here.
    pub fn save(&self) -> Result<PathBuf, RecordingError> {
        let Some(kept) = &self.kept else {
            return Ok(session::write(&self.folder, &self.manifest)?);
        };
        let path = self.folder.join("session.json");
        session::check(&self.manifest, &path)?;
        let all = kept.with(&self.manifest).map_err(|e| WriteError {
            path,
            reason: e.to_string(),
        })?;
        Ok(session::write_checked(&self.folder, &all)?)
    }

    /// A background writer for this machine.
    pub fn writer() -> Result<Writer, RecordingError> {
        let threads = std::thread::available_parallelism().map_or(2, usize::from);
        // 64 pictures of 1280 × 960 are 79 MB.
        Writer::new(threads, 64).map_err(RecordingError::Thread)
    }

    /// Writes a picture of the board for the camera's calibration and adds it.
    pub fn add_camera(&mut self, picture: &Picture) -> Result<String, RecordingError> {
        let image = fresh(
            &self.folder,
            |i| format!("camera/{i:02}.png"),
            self.manifest.camera.len(),
        );
        self.write(&image, picture)?;
        self.manifest.recorded.board = Some(now());
        self.manifest.camera.push(CameraView {
            image: image.clone(),
        });
        self.save()?;
        Ok(image)
    }

    /// Writes one picture, now.
    pub fn write(&self, image: &str, picture: &Picture) -> Result<(), RecordingError> {
        let path = self.path(image);
        write_whole(&path, picture).map_err(|reason| WriteError { path, reason }.into())
    }

    /// A folder (relative) for the next light pose, marked as under way. One that was broken off is
    /// begun anew: nobody knows whether the checkerboard has moved since.
    ///
    /// # Errors
    /// The disk.
    pub fn begin_light(&self, settings: Settings) -> Result<(String, Progress), RecordingError> {
        for i in 0.. {
            let name = format!("light/{i:02}");
            let folder = self.path(&name);
            let named = |image: &String| Path::new(image).starts_with(&name);
            if !folder.exists() {
                break;
            }
            let recorded = self.manifest.light.iter().any(|pose| {
                pose.off.as_ref().is_some_and(named) || pose.on.iter().any(|f| named(&f.image))
            });
            if let Some(left) = Progress::find(&folder, &self.folder)? {
                if recorded {
                    left.finish()?;
                } else {
                    left.discard()?;
                }
            }
        }
        let name = fresh(
            &self.folder,
            |i| format!("light/{i:02}"),
            self.manifest.light.len(),
        );
        let progress = Progress::begin(&self.path(&name), settings)?;
        Ok((name, progress))
    }

    /// Adds a light pose whose images stand, frames in the order of travel.
    pub fn add_light(
        &mut self,
        off: Option<String>,
        mut on: Vec<Frame>,
    ) -> Result<(), RecordingError> {
        on.sort_by(|a, b| a.slide_mm.total_cmp(&b.slide_mm));
        self.manifest.recorded.board = Some(now());
        self.manifest.light.push(LightPose { off, on });
        self.save()?;
        Ok(())
    }

    /// A folder (relative) for a scan.
    ///
    /// # Errors
    /// A scan stands there and `force` is not given.
    pub fn scan_folder(&self, force: bool) -> Result<String, RecordingError> {
        if self.manifest.scan.is_some() && !force {
            return Err(RecordingError::Stands {
                path: self.folder.join("session.json"),
                part: "scan",
            });
        }
        Ok(fresh(&self.folder, scan_name, 0))
    }

    /// Begins a scan, or goes on with one that was broken off: its folder (relative) and what stands.
    /// With `force` it goes on only with one that was itself to replace a scan, with the same settings;
    /// any other that was broken off is thrown away.
    ///
    /// # Errors
    /// A scan stands there and `force` is not given, or one that was broken off was begun with other
    /// settings.
    pub fn begin_scan(
        &self,
        force: bool,
        settings: Settings,
    ) -> Result<(String, Progress), RecordingError> {
        self.scan_folder(force)?;
        for i in 0.. {
            let left = scan_name(i);
            let folder = self.path(&left);
            if !folder.exists() {
                break;
            }
            let Some(found) = Progress::find(&folder, &self.folder)? else {
                continue;
            };
            let named = |s: &Scan| {
                s.frames
                    .iter()
                    .any(|f| Path::new(&f.image).starts_with(&left))
            };
            if self.manifest.scan.as_ref().is_some_and(named) {
                // Complete, but for taking the file away.
                found.finish()?;
            } else if force && !(self.manifest.scan.is_some() && found.is_of(&settings)) {
                found.discard()?;
            } else {
                return Ok((left, found.go_on(settings)?));
            }
        }
        // What was thrown away has left a name; a gap before it would hide a scan that is broken off later.
        let name = fresh(&self.folder, scan_name, 0);
        let progress = Progress::begin(&self.path(&name), settings)?;
        Ok((name, progress))
    }

    /// Sets the scan, whose images stand. With `--force` one that stood before is no longer named;
    /// its images stay.
    pub fn set_scan(
        &mut self,
        ambient: Option<String>,
        mut frames: Vec<Frame>,
    ) -> Result<(), RecordingError> {
        frames.sort_by(|a, b| a.slide_mm.total_cmp(&b.slide_mm));
        self.manifest.recorded.scan = Some(now());
        self.manifest.scan = Some(Scan { ambient, frames });
        self.save()?;
        Ok(())
    }
}

fn scan_name(i: usize) -> String {
    if i == 0 {
        "scan".to_owned()
    } else {
        format!("scan_{i}")
    }
}

/// The first name from number `from` on that nothing in the folder has.
fn fresh(folder: &Path, name: impl Fn(usize) -> String, from: usize) -> String {
    (from..)
        .map(name)
        .find(|name| !folder.join(name).exists())
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;
    use crate::synthetic::BOARD;

    fn picture(value: u8) -> Picture {
        Picture::Eight(Image::new(64, 48, value))
    }

    #[test]
    fn a_recording_goes_on_and_overwrites_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let mut r = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        assert_eq!(r.add_camera(&picture(1)).unwrap(), "camera/00.png");
        assert_eq!(r.add_camera(&picture(2)).unwrap(), "camera/01.png");
        // An image of a pose that was broken off: written, not named.
        r.write("camera/02.png", &picture(9)).unwrap();
        r.write("light/00/off.png", &picture(9)).unwrap();
        // One whose sweep is known to have been broken off.
        let broken = r.begin_light(Settings::new()).unwrap().0;
        assert_eq!(broken, "light/01");
        r.write("light/01/on_00.png", &picture(9)).unwrap();
        let third = r.path("light/02");
        Progress::begin(&third, Settings::new()).unwrap();
        r.write("light/02/on_00.png", &picture(9)).unwrap();
        std::fs::write(third.join("notes.txt"), "the board slipped").unwrap();
        drop(r);
        let mut r = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        assert_eq!(r.manifest.camera.len(), 2);
        assert_eq!(r.add_camera(&picture(3)).unwrap(), "camera/03.png");
        assert_eq!(r.begin_light(Settings::new()).unwrap().0, "light/01");
        assert!(!r.path("light/01/on_00.png").exists() && r.path("light/00/off.png").exists());
        // Whose file that is, nobody here knows.
        let left: Vec<_> = std::fs::read_dir(&third).unwrap().collect();
        assert_eq!(left.len(), 1);
        assert_eq!(left[0].as_ref().unwrap().file_name(), "notes.txt");
        assert_eq!(r.scan_folder(false).unwrap(), "scan");
        let frame = |mm: f64, image: &str| Frame {
            slide_mm: mm,
            slide_steps: None,
            trigger_us: None,
            image: image.into(),
        };
        r.write("scan/a.png", &picture(4)).unwrap();
        r.write("scan/b.png", &picture(5)).unwrap();
        // A position that was shot again comes last and is put in its place.
        r.set_scan(
            None,
            vec![frame(2.0, "scan/b.png"), frame(0.0, "scan/a.png")],
        )
        .unwrap();
        let stands = r.scan_folder(false).unwrap_err().to_string();
        assert!(stands.contains("--force"), "{stands}");
        assert_eq!(r.scan_folder(true).unwrap(), "scan_1");
        let s = session::Session::open(dir.path()).unwrap();
        assert_eq!(s.manifest.scan.unwrap().frames[0].image, "scan/a.png");

        for (size, board) in [
            ((65, 48), BOARD),
            (
                (64, 48),
                BoardGeometry {
                    columns: 9,
                    ..BOARD
                },
            ),
        ] {
            let Err(e) = Recording::open(dir.path(), size, &board) else {
                panic!("must be refused");
            };
            assert!(e.to_string().contains("give another folder"), "{e}");
        }
    }

    /// Another program's recording, or the simulation's: 320 steps a millimetre, and no settings.
    #[test]
    fn what_would_not_go_with_the_rest_is_said_before_it_is_recorded() {
        let dir = tempfile::tempdir().unwrap();
        let mut r = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        let on = (0..13).map(|k| Frame {
            slide_mm: 5.0 * f64::from(k),
            slide_steps: Some(1600 * i64::from(k)),
            trigger_us: None,
            image: format!("light/00/on_{k:02}.png"),
        });
        r.add_light(None, on.collect()).unwrap();
        let mut rig = Rig::default();
        for part in [Part::Light, Part::Scan] {
            let said = r.bind(part, &rig, false).unwrap_err().to_string();
            let words = "its part \"light\" is of a slide with another board.steps_per_mm, or with another zero: light/00/on_12.png lies at 60 mm after 19200 steps, which are 24.000 mm now";
            assert!(said.contains(words), "{said}");
            assert!(!r.manifest.recorded.settings.contains_key(part.name()));
        }
        // Board poses for the camera have no slide, and what is recorded anew need not go with what stood.
        r.bind(Part::Camera, &rig, false).unwrap();
        let mut anew = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        anew.bind(Part::Light, &rig, true).unwrap();
        rig.board.steps_per_mm = [320, 1];
        for part in [Part::Light, Part::Scan] {
            r.bind(part, &rig, false).unwrap();
        }
        // Far beyond where the light planes were measured.
        (rig.scan.start_mm, rig.scan.spacing_mm) = (130.0, 2.0);
        let said = r.bind(Part::Scan, &rig, false).unwrap_err().to_string();
        assert!(said.contains("the scan runs from 130 to 190 mm"), "{said}");
    }

    /// Other programs' keys stay, each with its image, and go with it.
    #[test]
    fn what_is_not_known_of_a_recording_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("session.json");
        let found = r#"{
            "format": "cannula-session/1", "note": "after lunch", "image": {"width": 64, "height": 48, "lens": 12},
            "board": {"columns": 8, "rows": 6, "square_mm": 10.0},
            "camera": [{"image": "camera/a.png", "note": "far"}, {"image": "camera/b.png"}],
            "scan": {"hand": "left", "frames": [{"slide_mm": 0.0, "image": "scan/000.png", "lux": 40},
                {"slide_mm": 5.0, "image": "scan/001.png", "lux": 41}]},
            "entry": {"pixel": [10.0, 10.0], "vein": [[9.0, 12.0], [11.0, 8.0]], "radius_mm": 12.0, "by": "NIR"}
        }"#;
        std::fs::write(&path, found).unwrap();
        let read = || -> serde_json::Value {
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap()
        };
        let before: serde_json::Value = serde_json::from_str(found).unwrap();
        let mut r = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        let image = r.add_camera(&picture(1)).unwrap();
        let mut now = read();
        assert!(now["recorded"]["board"].is_string());
        now.as_object_mut().unwrap().remove("recorded");
        let new = now["camera"].as_array_mut().unwrap().pop().unwrap();
        assert_eq!(new, serde_json::json!({ "image": image }));
        assert_eq!(now, before, "all else is as it was");

        // Of a scan, a view and an entry that are no longer there nothing is left.
        r.manifest.camera.remove(0);
        r.manifest.entry.as_mut().unwrap().radius_mm = 9.0;
        let frame = |image: &str, slide_mm| Frame {
            slide_mm,
            slide_steps: None,
            trigger_us: None,
            image: image.into(),
        };
        let anew = vec![frame("scan_1/000.png", 0.0), frame("scan_1/001.png", 5.0)];
        r.set_scan(None, anew).unwrap();
        let text = String::from_utf8(std::fs::read(&path).unwrap()).unwrap();
        for gone in ["far", "hand", "lux", "NIR"] {
            assert!(!text.contains(gone), "{gone}: {text}");
        }
        assert!(
            text.contains("after lunch") && text.contains("lens"),
            "{text}"
        );
        // And it is a recording.
        let again = Recording::open(dir.path(), (64, 48), &BOARD).unwrap();
        assert_eq!(again.manifest, r.manifest);
    }
}
