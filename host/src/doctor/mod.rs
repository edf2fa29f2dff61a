//! `cannula doctor`: whether machine, board, camera, configuration and calibration are fit for work;
//! for each what was found, and how to mend what is wrong.
//!
//! Nothing moves and the laser stays off. The board is configured (that turns nothing on) and fires
//! triggers at rest.

mod board;
mod calibration;
mod camera;
mod machine;

pub use calibration::calibration;
pub use machine::machine;

use crate::rig::config::{CameraKind, Rig};
use crate::rig::open::{self, Opened, SIMULATED};
use serde::Serialize;
use std::path::Path;

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// As it should be.
    Good,
    /// Work can go on, but mind it.
    Weak,
    /// Work can't go on.
    Wrong,
    /// Not looked at.
    Skipped,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Machine, board, camera …
    pub part: &'static str,
    /// What of it.
    pub what: &'static str,
    /// How it is.
    pub state: State,
    /// What was found.
    pub found: String,
    /// How to mend it; empty where nothing is to be done.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub remedy: String,
}

/// Collects the checks of one part.
pub(crate) struct Checks {
    part: &'static str,
    list: Vec<Check>,
}

impl Checks {
    fn new(part: &'static str) -> Self {
        Self {
            part,
            list: Vec::new(),
        }
    }

    fn add(&mut self, state: State, what: &'static str, found: String, remedy: &str) {
        self.list.push(Check {
            part: self.part,
            what,
            state,
            found,
            remedy: remedy.to_owned(),
        });
    }

    fn good(&mut self, what: &'static str, found: String) {
        self.add(State::Good, what, found, "");
    }

    fn weak(&mut self, what: &'static str, found: String, remedy: &str) {
        self.add(State::Weak, what, found, remedy);
    }

    fn wrong(&mut self, what: &'static str, found: String, remedy: &str) {
        self.add(State::Wrong, what, found, remedy);
    }

    fn skipped(&mut self, what: &'static str, why: &str) {
        self.add(State::Skipped, what, why.to_owned(), "");
    }
}

/// The configuration as loaded.
pub fn configuration(loaded: &Result<Rig, String>, file: Option<&str>) -> Vec<Check> {
    let mut c = Checks::new("configuration");
    match loaded {
        Ok(_) => match file {
            Some(file) => c.good("file", format!("{file}: every key and value is sound")),
            None => c.weak(
                "file",
                "none given: the defaults are checked".to_owned(),
                "write one with `cannula config --example > rig.toml`, give it with --config rig.toml",
            ),
        },
        Err(said) => {
            let missing = file.is_some_and(|file| !Path::new(file).exists());
            let remedy = match file {
                Some(file) if missing => format!("`cannula config --example > {file}`, then change what differs"),
                _ => "mend that key; `cannula config --example` shows each with its meaning".to_owned(),
            };
            c.wrong("file", said.clone(), &remedy);
        }
    }
    c.list
}

/// Board and camera of a sound configuration; and the image size that the camera gives.
pub fn rig(rig: &Rig) -> (Vec<Check>, Option<(u32, u32)>) {
    let mut all = Vec::new();
    // The simulated camera hangs on the simulated board's trigger cable: they are opened together.
    if rig.board.port == SIMULATED && rig.camera.kind == CameraKind::Simulated {
        return match open::simulated(rig) {
            Ok(mut opened) => {
                all.extend(board::board(&opened.board, SIMULATED, rig));
                let (checks, size) = camera::camera(&mut opened, rig);
                all.extend(checks);
                (all, size)
            }
            Err(e) => {
                let mut c = Checks::new("board");
                let remedy = match e {
                    open::OpenError::Checkerboard(_) => {
                        "change [checkerboard], or simulation.profile"
                    }
                    _ => "take another simulation.seed",
                };
                c.wrong("connection", e.to_string(), remedy);
                (c.list, None)
            }
        };
    }
    let board = match open::board(rig) {
        Ok(board) => {
            all.extend(board::board(&board, &rig.board.port, rig));
            Some(board)
        }
        Err(e) => {
            all.push(board::not_connected(&e));
            None
        }
    };
    match open::camera(rig) {
        Ok((camera, stage)) => {
            let size = camera.size();
            match board {
                Some(board) => {
                    let mut opened = Opened {
                        board,
                        camera,
                        stage,
                        virtual_board: None,
                    };
                    all.extend(camera::camera(&mut opened, rig).0);
                }
                None => all.extend(camera::without_board(camera.as_ref(), rig)),
            }
            (all, Some(size))
        }
        Err(e) => {
            all.push(camera::not_found(&e, rig));
            (all, None)
        }
    }
}

/// Whether nothing is wrong.
pub fn fit(checks: &[Check]) -> bool {
    checks.iter().all(|c| c.state != State::Wrong)
}

#[cfg(test)]
mod tests;
