//! From the configuration to a connected board and an opened camera.

use super::camera::{Camera, CameraError};
use super::config::{CameraKind, Rig, TriggerSource};
use super::link::{self, Board, LinkError};
use super::simulated::{Edge, SimulatedCamera, Stage};
use crate::board::BoardGeometry;
use crate::simulation::mcu::{self, SimulatedBoard, VirtualPipe};
use crate::simulation::{Profile, Renderer, Scene};
use cannula_shared::message::{State, Status};
use cannula_shared::units::Micros;
use std::sync::Arc;

/// The port that means the simulated board, on virtual time, in this process.
pub const SIMULATED: &str = "simulated";

/// Why there is no rig.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// No board, or more than one.
    #[error("{0}")]
    Port(String),
    /// The simulated scene.
    #[error("simulation.seed {0} gives a scene that can't be rendered: take another")]
    Seed(u64),
    /// The simulated scene can't show the board.
    #[error(
        "the simulated rig can't show a checkerboard of {} × {} corners and {} mm squares whole, and crossed by every light plane, in each pose: give [checkerboard] another, 8 × 6 and 10 mm say",
        .0.columns, .0.rows, .0.square_mm
    )]
    Checkerboard(BoardGeometry),
}

/// An opened rig.
pub struct Opened {
    /// The board.
    pub board: Board,
    /// The camera.
    pub camera: Box<dyn Camera>,
    /// Where simulated things are put before a simulated camera.
    pub stage: Option<Stage>,
    /// The simulated board, to disturb it.
    pub virtual_board: Option<VirtualPipe>,
}

/// Connects the board that the configuration names.
pub fn board(rig: &Rig) -> Result<Board, OpenError> {
    if rig.board.port == SIMULATED {
        return Ok(Board::over(VirtualPipe::new(simulated_board(rig)))?);
    }
    Ok(Board::connect(&port(&rig.board.port)?)?)
}

/// The port to take: as named, or the only board that is plugged in.
fn port(name: &str) -> Result<String, OpenError> {
    if name != "auto" {
        return Ok(name.to_owned());
    }
    let mut boards = link::ports()?.into_iter().filter(|p| p.is_board);
    match (boards.next(), boards.next()) {
        (Some(one), None) => Ok(one.path),
        (None, _) => Err(OpenError::Port(
            "no motion board is plugged in (see `cannula ports`); name its port with --port, or --port simulated to try without one".into(),
        )),
        (Some(a), Some(b)) => Err(OpenError::Port(format!(
            "there is more than one motion board ({}, {}): name one with --port",
            a.path, b.path
        ))),
    }
}

/// A simulated board whose slide is as long as the configuration says.
pub fn simulated_board(rig: &Rig) -> SimulatedBoard {
    let [n, d] = rig.board.steps_per_mm;
    let steps = |mm: f64| (mm * f64::from(n) / f64::from(d)).round() as i64;
    let mut board = SimulatedBoard::new(mcu::Rig {
        slide: steps(0.07 * rig.board.travel_mm),
        far: steps(rig.board.travel_mm * 1.05 + 5.0),
        ..mcu::Rig::default()
    });
    // Hours of steps are not looked at here.
    board.trace().keep_steps = false;
    board
}

/// The simulated rig: the simulated board on virtual time behind the real link, and a rendered
/// camera on its trigger pin.
pub fn simulated(rig: &Rig) -> Result<Opened, OpenError> {
    let stage = stage(rig)?;
    let pipe = VirtualPipe::new(simulated_board(rig));
    let camera = beside(rig, &stage, &pipe);
    Ok(Opened {
        board: Board::over(pipe.clone())?,
        camera: Box::new(camera),
        stage: Some(stage),
        virtual_board: Some(pipe),
    })
}

/// A simulated camera beside a simulated board, started as the configuration says.
pub fn beside(rig: &Rig, stage: &Stage, pipe: &VirtualPipe) -> SimulatedCamera {
    match rig.camera.trigger {
        TriggerSource::Board => SimulatedCamera::wired(stage.clone(), wire(rig, pipe)),
        own => SimulatedCamera::by_itself(
            stage.clone(),
            pipe.clone(),
            own,
            rig.mm(1),
            rig.board.clearance_mm,
        ),
    }
}

/// A seed's scene with the configuration's checkerboard.
///
/// # Errors
/// [`OpenError::Checkerboard`].
pub fn scene(rig: &Rig, profile: Profile, seed: u64) -> Result<Scene, OpenError> {
    let board = rig.geometry();
    Scene::with_board(profile, seed, board).ok_or(OpenError::Checkerboard(board))
}

fn stage(rig: &Rig) -> Result<Stage, OpenError> {
    let seed = rig.simulation.seed;
    let scene = scene(rig, rig.profile(), seed)?;
    let renderer = Renderer::new(scene).ok_or(OpenError::Seed(seed))?;
    Ok(Stage::new(Arc::new(renderer), rig.camera.exposure_laser_ms))
}

/// The trigger cable: what the simulated board has exposed since the last look.
pub fn wire(rig: &Rig, pipe: &VirtualPipe) -> Box<dyn FnMut() -> Vec<Edge> + Send> {
    let pipe = pipe.clone();
    let mm_per_step = rig.mm(1);
    let zero_mm = rig.board.clearance_mm;
    Box::new(move || {
        let mut board = pipe.board();
        board
            .take_exposed()
            .into_iter()
            .map(|e| Edge {
                time_us: e.cycle / cannula_shared::units::CYCLES_PER_MICRO,
                slide_mm: e.slide as f64 * mm_per_step - zero_mm,
                speed_mm_s: e.speed * mm_per_step,
                laser: e.laser,
            })
            .collect()
    })
}

/// Opens board and camera as the configuration says.
pub fn open(rig: &Rig) -> Result<Opened, OpenError> {
    let simulated_camera = rig.camera.kind == CameraKind::Simulated;
    if rig.board.port == SIMULATED && simulated_camera {
        return simulated(rig);
    }
    let board = board(rig)?;
    let (camera, stage) = camera(rig)?;
    Ok(Opened {
        board,
        camera,
        stage,
        virtual_board: None,
    })
}

/// Opens the camera that the configuration names, and the stage before a simulated one (which
/// learns of triggers from the ledger).
pub fn camera(rig: &Rig) -> Result<(Box<dyn Camera>, Option<Stage>), OpenError> {
    Ok(match rig.camera.kind {
        CameraKind::Simulated => {
            if rig.camera.trigger != TriggerSource::Board {
                return Err(OpenError::Port(
                    "camera.trigger: a simulated camera beside a board behind a port learns of exposures by the board's ledger: give \"board\", or --port simulated".into(),
                ));
            }
            let stage = stage(rig)?;
            (
                Box::new(SimulatedCamera::by_ledger(
                    stage.clone(),
                    rig.mm(1),
                    rig.travel_mm_s(&rig.scan_request()),
                )),
                Some(stage),
            )
        }
        CameraKind::Genicam => (genicam(rig)?, None),
        CameraKind::V4l => (v4l(rig)?, None),
    })
}

#[cfg(feature = "aravis")]
fn genicam(rig: &Rig) -> Result<Box<dyn Camera>, CameraError> {
    Ok(Box::new(super::genicam::GenicamCamera::open(&rig.camera)?))
}

#[cfg(not(feature = "aravis"))]
fn genicam(_rig: &Rig) -> Result<Box<dyn Camera>, CameraError> {
    Err(CameraError::NotBuilt("GenICam", "aravis"))
}

#[cfg(feature = "v4l")]
fn v4l(rig: &Rig) -> Result<Box<dyn Camera>, CameraError> {
    Ok(Box::new(super::uvc::UvcCamera::open(&rig.camera)?))
}

#[cfg(not(feature = "v4l"))]
fn v4l(_rig: &Rig) -> Result<Box<dyn Camera>, CameraError> {
    Err(CameraError::NotBuilt("UVC", "v4l"))
}

/// How long a board may take to come to rest: a slow ramp down from full speed.
const TO_REST: Micros = Micros(30_000_000);

/// Waits until the board stands: a host that was killed right before leaves it on its ramp down, and
/// a session that is opened ends what another one had begun.
///
/// # Errors
/// It still moves after half a minute, or the link fails.
pub fn at_rest(board: &Board) -> Result<Status, OpenError> {
    rest_asked(board, Board::status)
}

/// Has whatever runs stopped, the laser turned off, and waits until the slide stands; a board that does
/// not answer is not asked twice.
///
/// # Errors
/// It does not answer promptly, or [`at_rest`]'s.
pub fn stand(board: &Board) -> Result<(), OpenError> {
    board.ask_to_stop()?;
    if rest_asked(board, Board::status_promptly)?.laser {
        return Err(OpenError::Port(
            "the motion board says that the laser is still on".into(),
        ));
    }
    Ok(())
}

fn rest_asked(
    board: &Board,
    ask: impl Fn(&Board) -> link::Result<Status>,
) -> Result<Status, OpenError> {
    let began = board.now();
    loop {
        let status = ask(board)?;
        let busy = matches!(
            status.state,
            State::Stopping | State::Homing | State::Scanning
        );
        if !busy && !status.moving {
            return Ok(status);
        }
        if board.now().since(began) > TO_REST {
            return Err(OpenError::Port(format!(
                "the motion board still moves {} s after its last host went: `cannula motion stop`, or its emergency stop",
                TO_REST.0 / 1_000_000
            )));
        }
        board.keep_alive()?;
    }
}

/// Waits until the board stands, configures it, re-arms nothing, and homes it if it does not know
/// where it is. Gives what homing found, if it was needed.
pub fn ready(board: &Board, rig: &Rig) -> Result<Option<link::Homed>, OpenError> {
    if let State::Fault(fault) = at_rest(board)?.state {
        return Err(OpenError::Port(format!(
            "the motion board is in fault ({fault}); mend the cause, then `cannula motion rearm`"
        )));
    }
    board.configure(&rig.board_config(rig.camera.exposure_laser_ms))?;
    if board.status()?.position_known {
        return Ok(None);
    }
    Ok(Some(board.home()?))
}
