//! The simulated camera: renders the scene whenever its trigger edge comes, with the slide where
//! the steps have truly put it and the laser as its pin truly stands. Or exposes by command, or by
//! itself, whatever slide and laser are doing then.

use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::config::TriggerSource;
use crate::simulation::mcu::{Exposed, VirtualPipe};
use crate::simulation::{Renderer, Still, Subject};
use cannula_shared::message::Trigger;
use cannula_shared::units::{CYCLES_PER_MICRO, Micros};
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The camera's clock runs this much faster than the board's, as crystals do.
const DRIFT: f64 = 2.3e-5;
/// What the camera's clock shows when the board's shows zero, µs.
const EPOCH_US: f64 = 86_400_000_000.0;
/// Exposures begin up to this long after their edge, µs.
const JITTER_US: u64 = 40;
/// From the end of an exposure to the frame, of a camera that exposes by command or by itself, µs.
const LATENCY_US: u64 = 12_000;
/// From one exposure to the next of a camera that runs by itself, µs.
const PERIOD_US: u64 = 25_000;
/// Frames that wait at most in a camera that runs by itself; later ones are dropped, as with
/// Video4Linux: what waits is old.
const QUEUE: usize = 4;

/// A rising edge on the TRIGGER pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// When, µs of the board's clock.
    pub time_us: u64,
    /// Where the slide truly stands, mm (from the step edges).
    pub slide_mm: f64,
    /// How fast it moves, mm/s.
    pub speed_mm_s: f64,
    /// Whether the laser's pin is high.
    pub laser: bool,
}

/// What becomes of an exposure, to test what the rig does about it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Fate {
    /// It arrives.
    #[default]
    Fine,
    /// The camera does not see the edge: no exposure, no count.
    Ignored,
    /// It is exposed and counted, but does not arrive.
    Lost,
    /// It arrives in part.
    Broken,
    /// It arrives twice.
    Double,
    /// It begins late by so many µs.
    Late(i64),
    /// It and what follows is held back until `wait` has timed out so many times.
    Held(u32),
    /// It arrives late by so many µs, and what follows after it (a camera that exposes by command
    /// or by itself).
    Delayed(u64),
}

/// Decides the fate of the n-th edge (from 0) since the camera was made.
pub type Fates = Box<dyn FnMut(u64) -> Fate + Send>;

struct Pending {
    sequence: u64,
    time_us: i64,
    /// When it comes, µs of the board's clock.
    comes_us: u64,
    picture: Option<Receiver<Picture>>,
}

struct State {
    still: Option<Arc<Still>>,
    exposure_ms: f64,
    armed: bool,
    edges: u64,
    sequence: u64,
    held: u32,
    fates: Option<Fates>,
    /// Of exposures that were asked for by command and have not begun.
    commanded: VecDeque<Fate>,
    pending: VecDeque<Pending>,
    /// Light planes of the frames taken with the laser on, for truth.json: slide in mm, D.
    lit: Vec<(f64, f64)>,
}

/// What the simulated trigger cable is wired to, and the hand that puts things before the camera.
#[derive(Clone)]
pub struct Stage {
    renderer: Arc<Renderer>,
    state: Arc<Mutex<State>>,
    laser_ms: f64,
}

impl Stage {
    /// An empty stage. `laser_ms`: the exposure at which laser images are well exposed.
    pub fn new(renderer: Arc<Renderer>, laser_ms: f64) -> Self {
        Self {
            renderer,
            laser_ms,
            state: Arc::new(Mutex::new(State {
                still: None,
                exposure_ms: laser_ms,
                armed: false,
                edges: 0,
                sequence: 0,
                held: 0,
                fates: None,
                commanded: VecDeque::new(),
                pending: VecDeque::new(),
                lit: Vec::new(),
            })),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The renderer.
    pub fn renderer(&self) -> &Arc<Renderer> {
        &self.renderer
    }

    /// Puts something before the camera.
    pub fn show(&self, subject: &Subject) {
        let still = Arc::new(self.renderer.still(subject));
        self.state().still = Some(still);
    }

    /// From now on edges have these fates.
    pub fn inject(&self, fates: Fates) {
        let mut state = self.state();
        state.fates = Some(fates);
        state.edges = 0;
    }

    /// The light planes of laser frames since the last call: slide by the steps, true D, mm.
    pub fn take_lit(&self) -> Vec<(f64, f64)> {
        std::mem::take(&mut self.state().lit)
    }

    /// A rising edge: exposes, if the camera is armed and something stands before it.
    pub fn edge(&self, edge: Edge) {
        let fate = self.next_fate();
        self.expose(edge, fate);
    }

    /// The next exposure's fate, if the camera is armed and something stands before it.
    fn next_fate(&self) -> Fate {
        let mut state = self.state();
        if state.still.is_none() || !state.armed {
            return Fate::Ignored;
        }
        let n = state.edges;
        state.edges += 1;
        state.fates.as_mut().map_or(Fate::Fine, |f| f(n))
    }

    fn expose(&self, edge: Edge, fate: Fate) {
        let mut state = self.state();
        let (Some(still), true) = (state.still.clone(), state.armed) else {
            return;
        };
        if fate == Fate::Ignored {
            return;
        }
        state.sequence += 1;
        let sequence = state.sequence;
        if fate == Fate::Lost {
            return;
        }
        let late = if let Fate::Late(us) = fate { us } else { 0 };
        if let Fate::Held(waits) = fate {
            state.held = waits;
        }
        let jitter = sequence.wrapping_mul(0x9E37_79B9_7F4A_7C15) % JITTER_US;
        let time = EPOCH_US + edge.time_us as f64 * (1.0 + DRIFT) + jitter as f64;
        let scene = self.renderer.scene();
        // The sheet sweeps on while the shutter is open: where it is in the middle stands for all
        // of it.
        let slide_mm = edge.slide_mm + 0.5e-3 * state.exposure_ms * edge.speed_mm_s;
        let plane = edge.laser.then(|| scene.lit_plane(slide_mm, sequence));
        if let Some(plane) = plane {
            state.lit.push((slide_mm, plane.d));
        }
        let exposure = state.exposure_ms / self.laser_ms;
        let render = |renderer: Arc<Renderer>, still: Arc<Still>| {
            let (send, receive) = channel();
            rayon::spawn(move || {
                let image = renderer.frame(&still, exposure, plane.as_ref(), sequence);
                // Nobody waits any more: nothing is lost.
                let _ = send.send(Picture::Eight(image));
            });
            receive
        };
        let delay = if let Fate::Delayed(us) = fate { us } else { 0 };
        let comes_us = edge.time_us + (1000.0 * state.exposure_ms) as u64 + LATENCY_US + delay;
        let copies = if fate == Fate::Double { 2 } else { 1 };
        for _ in 0..copies {
            let picture =
                (fate != Fate::Broken).then(|| render(self.renderer.clone(), still.clone()));
            state.pending.push_back(Pending {
                sequence,
                time_us: time as i64 + late,
                comes_us,
                picture,
            });
        }
    }
}

/// The camera at the end of the cable.
pub struct SimulatedCamera {
    stage: Stage,
    cable: Cable,
}

/// Where edges come from.
enum Cable {
    /// A simulated board in this process.
    Wired(Box<dyn FnMut() -> Vec<Edge> + Send>),
    /// The ledger: the board is behind a port, and no cable leads here.
    Ledger(FromLedger),
    /// None: it exposes by command or by itself, beside a simulated board.
    Own(Own),
}

/// What the ledger tells of the slide.
struct FromLedger {
    mm_per_step: f64,
    /// Speed of a scan on the fly, mm/s; 0 where scans stop.
    speed_mm_s: f64,
    /// The trigger before: its time, µs, and position, mm.
    before: Option<(u64, f64)>,
}

impl FromLedger {
    /// A trigger comes from a slide in motion if it follows the one before as fast as a scan
    /// travels; the first of a sweep passes for one at rest.
    fn edge(&mut self, trigger: &Trigger) -> Edge {
        let slide_mm = f64::from(trigger.position.0) * self.mm_per_step;
        let time_us = trigger.time.0;
        let moving = self.before.is_some_and(|(then, from)| {
            let seconds = 1e-6 * time_us.saturating_sub(then) as f64;
            let travel = self.speed_mm_s * seconds;
            travel > 0.0 && ((slide_mm - from) / travel - 1.0).abs() < 0.05
        });
        self.before = Some((time_us, slide_mm));
        Edge {
            time_us,
            slide_mm,
            speed_mm_s: if moving { self.speed_mm_s } else { 0.0 },
            laser: trigger.laser,
        }
    }
}

/// What a camera without a cable sees of the simulated board.
struct Own {
    board: VirtualPipe,
    free: bool,
    mm_per_step: f64,
    zero_mm: f64,
}

impl Own {
    fn edge(&self, e: &Exposed) -> Edge {
        Edge {
            time_us: e.cycle / CYCLES_PER_MICRO,
            slide_mm: e.slide as f64 * self.mm_per_step - self.zero_mm,
            speed_mm_s: e.speed * self.mm_per_step,
            laser: e.laser,
        }
    }

    fn now_us(&self) -> u64 {
        self.board.board().now().to_micros_down().0
    }
}

impl SimulatedCamera {
    /// A camera on the trigger pin of a simulated board: `edges` gives the edges since it was last
    /// asked.
    pub fn wired(stage: Stage, edges: Box<dyn FnMut() -> Vec<Edge> + Send>) -> Self {
        Self {
            stage,
            cable: Cable::Wired(edges),
        }
    }

    /// A camera that the board does not trigger: by command, or running by itself. `zero_mm`: from
    /// the home switch to the slide's zero.
    pub fn by_itself(
        stage: Stage,
        board: VirtualPipe,
        trigger: TriggerSource,
        mm_per_step: f64,
        zero_mm: f64,
    ) -> Self {
        Self {
            stage,
            cable: Cable::Own(Own {
                board,
                free: trigger == TriggerSource::Free,
                mm_per_step,
                zero_mm,
            }),
        }
    }

    /// A camera that takes the ledger's lines for edges.
    /// `speed_mm_s`: of a scan on the fly; 0 where scans stop.
    pub fn by_ledger(stage: Stage, mm_per_step: f64, speed_mm_s: f64) -> Self {
        Self {
            stage,
            cable: Cable::Ledger(FromLedger {
                mm_per_step,
                speed_mm_s,
                before: None,
            }),
        }
    }

    fn look(&mut self) {
        match &mut self.cable {
            Cable::Wired(edges) => edges().into_iter().for_each(|edge| self.stage.edge(edge)),
            Cable::Ledger(_) => {}
            Cable::Own(own) => {
                let exposed = own.board.board().take_exposed();
                for e in exposed.iter().filter(|e| e.trigger.is_none()) {
                    let fate = if !own.free {
                        self.stage.state().commanded.pop_front().unwrap_or_default()
                    } else if self.stage.state().pending.len() >= QUEUE {
                        // Exposed and counted, and no place for it.
                        Fate::Lost
                    } else {
                        self.stage.next_fate()
                    };
                    self.stage.expose(own.edge(e), fate);
                }
            }
        }
    }
}

impl Camera for SimulatedCamera {
    fn description(&self) -> String {
        let scene = self.stage.renderer.scene();
        format!("simulated camera (seed {}, {})", scene.seed, scene.profile)
    }

    fn size(&self) -> (u32, u32) {
        let camera = &self.stage.renderer.scene().camera;
        (camera.width, camera.height)
    }

    fn arm(&mut self, exposure: &Exposure) -> Result<(), CameraError> {
        self.look();
        let mut state = self.stage.state();
        state.pending.clear();
        state.held = 0;
        state.exposure_ms = exposure.ms;
        state.armed = true;
        state.commanded.clear();
        if let Cable::Own(own) = &self.cable
            && own.free
        {
            let period = PERIOD_US.max((1000.0 * exposure.ms) as u64);
            own.board.board().expose_every(Some(Micros(period)));
        }
        Ok(())
    }

    fn wait(&mut self, timeout: Duration) -> Result<Option<Frame>, CameraError> {
        self.look();
        let now_us = match &self.cable {
            Cable::Own(own) => own.now_us(),
            Cable::Wired(_) | Cable::Ledger(_) => u64::MAX,
        };
        let pending = {
            let mut state = self.stage.state();
            if state.held > 0 {
                if !timeout.is_zero() {
                    state.held -= 1;
                }
                return Ok(None);
            }
            if state.pending.front().is_some_and(|p| p.comes_us > now_us) {
                return Ok(None);
            }
            state.pending.pop_front()
        };
        // Simulated time stands still while nobody serves the board: there is nothing to wait for.
        let Some(pending) = pending else {
            return Ok(None);
        };
        let picture = match pending.picture {
            Some(receive) => Some(
                receive
                    .recv()
                    .map_err(|_| CameraError::Failed("the renderer gave no image".into()))?,
            ),
            None => None,
        };
        Ok(Some(Frame {
            sequence: pending.sequence,
            time_us: pending.time_us,
            picture,
        }))
    }

    fn ledger(&mut self, trigger: &Trigger) {
        if let Cable::Ledger(ledger) = &mut self.cable {
            let edge = ledger.edge(trigger);
            self.stage.edge(edge);
        }
    }

    fn fire(&mut self) -> Result<(), CameraError> {
        let Cable::Own(own) = &self.cable else {
            return Ok(());
        };
        if own.free {
            return Ok(());
        }
        let (late, fate) = match self.stage.next_fate() {
            Fate::Ignored => return Ok(()),
            // It truly begins then: slide and laser are as they are then.
            Fate::Late(us) => (us.max(0) as u64, Fate::Fine),
            fate => (0, fate),
        };
        self.stage.state().commanded.push_back(fate);
        own.board.board().expose_after(Micros(late));
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), CameraError> {
        self.stage.state().armed = false;
        if let Cable::Own(own) = &self.cable {
            own.board.board().expose_every(None);
        }
        Ok(())
    }
}
