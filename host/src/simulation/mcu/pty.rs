//! The simulated board in step with real time, behind a pseudo-terminal: any program that can
//! open a serial port can talk to it.

use super::{SimulatedBoard, VirtualPipe};
use crate::rig::link::open_terminal;
use cannula_shared::units::Micros;
use serialport::{SerialPort, TTYPort};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A terminal holds no more bytes than this: one read takes all that wait.
const WAITING: usize = 4096;
/// The board's time advances by no more than this between two looks at what has come for it. A round
/// that took longer was held up itself: bytes that came meanwhile have not come late, and their
/// sender has not been silent. What is beyond is waived.
const MOST: Micros = Micros(10_000);

/// The board's time against the world's.
#[derive(Default)]
struct Pace {
    board: u64,
    world: u64,
}

impl Pace {
    /// The board's time at the world's time `world`: as much later as the world's, and by at most
    /// [`MOST`].
    fn advance(&mut self, world: Micros) -> Micros {
        self.board += world.0.saturating_sub(self.world).min(MOST.0);
        self.world = world.0;
        Micros(self.board)
    }
}

/// A board behind a pseudo-terminal, with a thread that serves it.
pub struct Terminal {
    path: String,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// Kept open, or the pseudo-terminal hangs up between two clients. Not as a port: that would
    /// hold a lock that the client wants.
    _slave: File,
}

impl Terminal {
    /// Opens the terminal. About once a millisecond `board` gets the bytes for the board and the
    /// time since the beginning, and gives the bytes from it. That time goes on by at most 10 ms from
    /// one call to the next, also where the machine was held up for longer.
    pub fn serve(
        mut board: impl FnMut(&[u8], Micros) -> Vec<u8> + Send + 'static,
    ) -> io::Result<Self> {
        let (mut master, mut slave) = TTYPort::pair()?;
        slave.set_exclusive(false)?;
        let path = slave
            .name()
            .ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
        let held = open_terminal(&path)?;
        drop(slave);
        master.set_timeout(Duration::from_millis(1))?;
        let end = Arc::new(AtomicBool::new(false));
        let ended = end.clone();
        let thread = std::thread::Builder::new()
            .name("board".into())
            .spawn(move || {
                let began = Instant::now();
                let mut pace = Pace::default();
                let mut buffer = [0; WAITING];
                while !ended.load(Ordering::Relaxed) {
                    // Waits a millisecond for bytes: the pace of the loop.
                    let read = match master.read(&mut buffer) {
                        Ok(n) => n,
                        Err(e)
                            if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) =>
                        {
                            0
                        }
                        Err(_) => {
                            std::thread::sleep(Duration::from_millis(1));
                            0
                        }
                    };
                    let elapsed = u64::try_from(began.elapsed().as_micros()).unwrap_or(u64::MAX);
                    let time = pace.advance(Micros(elapsed));
                    let out = board(buffer.get(..read).unwrap_or(&[]), time);
                    // Nobody may be reading: what does not fit is lost, as on a cable.
                    if !out.is_empty() {
                        let _ = master.write_all(&out);
                    }
                }
            })?;
        Ok(Self {
            path,
            end,
            thread: Some(thread),
            _slave: held,
        })
    }

    /// The port to connect to.
    pub fn path(&self) -> &str {
        &self.path
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A simulated board that runs by itself.
pub struct RealTime {
    board: VirtualPipe,
    terminal: Terminal,
}

impl RealTime {
    /// Starts the board; see [`Self::path`] for where it listens.
    pub fn start(board: SimulatedBoard) -> io::Result<Self> {
        let board = VirtualPipe::new(board);
        let terminal = Terminal::serve(serving(board.clone()))?;
        Ok(Self { board, terminal })
    }

    /// The port to connect to.
    pub fn path(&self) -> &str {
        self.terminal.path()
    }

    /// The board, to look at and to disturb.
    pub fn board(&self) -> &VirtualPipe {
        &self.board
    }
}

/// Gives a board bytes, lets it run until a time since now, takes bytes from it.
fn serving(board: VirtualPipe) -> impl FnMut(&[u8], Micros) -> Vec<u8> + Send {
    let start = board.board().now().to_micros_down().0;
    move |bytes, elapsed| {
        let mut board = board.board();
        if !bytes.is_empty() {
            board.send(bytes);
        }
        board.run_until(Micros(start + elapsed.0).to_cycles());
        board.receive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::link::Session;
    use crate::simulation::mcu::{Pin, Rig};
    use cannula_shared::config::Config;
    use cannula_shared::error::Fault;
    use cannula_shared::message::{Command, Reply, State};

    type Serve = Box<dyn FnMut(&[u8], Micros) -> Vec<u8>>;

    /// A host and a board, each on its own rounds, with the bytes between them.
    struct World {
        now: u64,
        pipe: VirtualPipe,
        serve: Serve,
        pace: Option<Pace>,
        host: Session,
        to_board: Vec<u8>,
        to_host: Vec<u8>,
    }

    impl World {
        /// With the laser on; `paced` as [`Terminal`] does it.
        fn new(paced: bool) -> Self {
            let pipe = VirtualPipe::new(SimulatedBoard::new(Rig::default()));
            let mut world = Self {
                now: 0,
                serve: Box::new(serving(pipe.clone())),
                pipe,
                pace: paced.then(Pace::default),
                host: Session::new(7),
                to_board: Vec::new(),
                to_host: Vec::new(),
            };
            while world.host.hello().is_none() {
                world.round(true, true);
            }
            for command in [
                Command::Configure(Config::default()),
                Command::Laser { on: true },
            ] {
                world.ask(command);
            }
            assert!(world.lit());
            world
        }

        fn lit(&self) -> bool {
            self.pipe.board().level(Pin::Laser)
        }

        /// A millisecond, in which the host and the terminal's thread run, or do not.
        fn round(&mut self, host: bool, terminal: bool) {
            self.now += 1_000;
            if host {
                let now = Micros(self.now);
                self.host.receive(now, &std::mem::take(&mut self.to_host));
                self.host.poll(now);
                self.to_board.extend(self.host.take_output());
            }
            if terminal {
                let world = Micros(self.now);
                let time = self.pace.as_mut().map_or(world, |p| p.advance(world));
                let bytes = std::mem::take(&mut self.to_board);
                let out = (self.serve)(&bytes, time);
                self.to_host.extend(out);
            }
        }

        fn ask(&mut self, command: Command) -> Reply {
            self.host.command(Micros(self.now), command).unwrap();
            loop {
                self.round(true, true);
                if let Some(reply) = self.host.take_reply() {
                    return reply;
                }
                assert!(self.now < 60_000_000);
            }
        }

        fn state(&mut self) -> State {
            match self.ask(Command::Status) {
                Reply::Status(status) => status.state,
                other => panic!("{other:?}"),
            }
        }
    }

    /// The terminal's thread stands still for half a second while the host goes on saying that it
    /// lives: more than twice the patience of the board.
    #[test]
    fn what_holds_up_the_simulation_is_no_silence_of_the_host() {
        let held_up = |paced: bool| {
            let mut world = World::new(paced);
            for _ in 0..5 {
                (0..500).for_each(|_| world.round(true, false));
                (0..50).for_each(|_| world.round(true, true));
            }
            (world.lit(), world.state())
        };
        let (lit, state) = held_up(true);
        assert!(lit && state == State::Idle, "{state:?}");
        // It is the pace that does it.
        let (lit, state) = held_up(false);
        assert!(
            !lit && matches!(state, State::Fault(Fault::HostSilent { .. })),
            "{state:?}"
        );
    }

    /// A host that truly says nothing is noticed within the board's limits of the board's own
    /// time, on a machine that holds up every round, too.
    #[test]
    fn a_silent_host_is_noticed_however_busy_the_machine_is() {
        for every in [1u64, 60] {
            let mut world = World::new(true);
            let config = Config::default();
            let since = world.pipe.board().now();
            let mut rounds = 0;
            while world.pipe.board().now().0 - since.0 < Micros(300_000).to_cycles().0 {
                rounds += 1;
                let now = rounds % every == 0;
                world.round(false, now);
            }
            let off = world.pipe.board().trace().falls(Pin::Laser).last().unwrap();
            let after = (off - since.0) as f64 / Micros(1_000).to_cycles().0 as f64;
            // Heartbeats are 40 ms apart: the last may be that old, or come with the next round.
            let patience = 1e-3 * f64::from(config.heartbeat_us);
            let most = patience + 1e-3 * MOST.0 as f64 + 1.0;
            assert!(after > patience - 45.0 && after < most, "{after} ms");
            let state = world.state();
            assert!(
                matches!(state, State::Fault(Fault::HostSilent { .. })),
                "{state:?}"
            );
        }
    }
}
