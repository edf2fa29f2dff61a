//! The simulated board in step with real time, behind a pseudo-terminal: any program that can
//! open a serial port can talk to it.

use super::{SimulatedBoard, VirtualPipe};
use cannula_shared::units::Micros;
use serialport::{SerialPort, TTYPort};
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

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
    /// time since the beginning, and gives the bytes from it.
    pub fn serve(
        mut board: impl FnMut(&[u8], Micros) -> Vec<u8> + Send + 'static,
    ) -> io::Result<Self> {
        let (mut master, mut slave) = TTYPort::pair()?;
        slave.set_exclusive(false)?;
        let path = slave
            .name()
            .ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
        let held = hold_open(&path)?;
        drop(slave);
        master.set_timeout(Duration::from_millis(1))?;
        let end = Arc::new(AtomicBool::new(false));
        let ended = end.clone();
        let thread = std::thread::Builder::new()
            .name("board".into())
            .spawn(move || {
                let began = Instant::now();
                let mut buffer = [0; 1024];
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
                    let out = board(buffer.get(..read).unwrap_or(&[]), Micros(elapsed));
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
        let shared = board.clone();
        let start = board.board().now().to_micros_down().0;
        let terminal = Terminal::serve(move |bytes, elapsed| {
            let mut board = shared.board();
            if !bytes.is_empty() {
                board.send(bytes);
            }
            board.run_until(Micros(start + elapsed.0).to_cycles());
            board.receive()
        })?;
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

/// Opens a terminal without making it this process's own.
fn hold_open(path: &str) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    // O_NOCTTY, on the system where its value is known for sure.
    #[cfg(target_os = "linux")]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, 0o400);
    options.open(path)
}
