//! Byte pipes: a serial port (USB or pseudo-terminal), and whatever else implements [`Pipe`].

use super::error::LinkError;
use cannula_shared::units::Micros;
use serialport::SerialPortType;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Bytes to and from a board, with the clock by which time-outs count.
pub trait Pipe: Send {
    /// Reads what is there, waiting up to `wait` for the first byte; 0 bytes after that.
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize>;
    /// Writes all bytes.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// The pipe's clock. A simulated board's may run faster than the world's.
    fn now(&mut self) -> Micros;
    /// Whether that clock is the world's, so that the heartbeat needs a thread of its own.
    fn real_time(&self) -> bool;
}

/// Pieces that wait to be taken; the port holds back what comes beyond.
const PIECES: usize = 256;
/// How often the reader looks whether it is to end.
const LOOK: Duration = Duration::from_millis(20);
/// A port that takes nothing for so long has failed.
const STUCK: Duration = Duration::from_millis(500);

/// A serial port.
///
/// On a busy machine the system may hold a look at a terminal (`poll`, for writing too) for half a
/// second, whatever its time-out: Linux then waits for a kernel thread that carries the terminal's
/// bytes. So a thread of its own looks, and bytes are written without looking: the heartbeat goes out
/// meanwhile.
pub struct SerialPipe {
    writer: Box<dyn Write + Send>,
    /// What the reader has read. `None` only while it is dropped.
    pieces: Option<Receiver<io::Result<Vec<u8>>>>,
    /// Read, and not yet taken.
    rest: Vec<u8>,
    end: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
    began: Instant,
}

impl SerialPipe {
    /// Opens the port at `path`. The baud rate means nothing to USB CDC.
    pub fn open(path: &str) -> Result<Self, LinkError> {
        let failed = |source: io::Error| LinkError::Open {
            path: path.into(),
            source,
        };
        // Before the port, which keeps others out from then on.
        #[cfg(unix)]
        let writer = open_terminal(path).map_err(failed)?;
        let port = serialport::new(path, 115_200)
            .timeout(LOOK)
            .open()
            .map_err(|e| failed(e.into()))?;
        #[cfg(not(unix))]
        let writer = port.try_clone().map_err(|e| failed(e.into()))?;
        Self::between(port, writer).map_err(failed)
    }

    /// Over something that can be read from and something that can be written to without waiting.
    fn between(
        port: impl Read + Send + 'static,
        writer: impl Write + Send + 'static,
    ) -> io::Result<Self> {
        let (send, pieces) = sync_channel(PIECES);
        let end = Arc::new(AtomicBool::new(false));
        let ended = end.clone();
        let reader = std::thread::Builder::new()
            .name("port reader".into())
            .spawn(move || carry(port, &send, &ended))?;
        Ok(SerialPipe {
            writer: Box::new(writer),
            pieces: Some(pieces),
            rest: Vec::new(),
            end,
            reader: Some(reader),
            began: Instant::now(),
        })
    }
}

/// Reads until told to end, or the port fails.
fn carry(mut port: impl Read, pieces: &SyncSender<io::Result<Vec<u8>>>, end: &AtomicBool) {
    let mut buffer = [0; 1024];
    while !end.load(Ordering::Relaxed) {
        let piece = match port.read(&mut buffer) {
            // An end of file: the other end of a pseudo-terminal has gone.
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(n) => Ok(buffer.iter().take(n).copied().collect()),
            Err(e) if passing(&e) => continue,
            Err(e) => Err(e),
        };
        let failed = piece.is_err();
        if pieces.send(piece).is_err() || failed {
            return;
        }
    }
}

/// Nothing now; later there may be.
fn passing(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
    )
}

/// Opens a terminal to write to it without waiting, and without making it this process's own.
#[cfg(unix)]
pub(crate) fn open_terminal(path: &str) -> io::Result<std::fs::File> {
    use rustix::fs::{Mode, OFlags};
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    Ok(rustix::fs::open(path, flags, Mode::empty())?.into())
}

impl Pipe for SerialPipe {
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize> {
        if self.rest.is_empty()
            && let Some(pieces) = &self.pieces
        {
            match pieces.recv_timeout(Duration::from_micros(wait.0)) {
                Ok(piece) => self.rest = piece?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
            }
        }
        let count = self.rest.len().min(buffer.len());
        for (to, from) in buffer.iter_mut().zip(self.rest.drain(..count)) {
            *to = from;
        }
        Ok(count)
    }

    fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let began = Instant::now();
        while !bytes.is_empty() {
            match self.writer.write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(n) => bytes = bytes.get(n..).unwrap_or(&[]),
                Err(e) if passing(&e) && began.elapsed() < STUCK => {
                    std::thread::sleep(Duration::from_millis(1));
                }
                // "Resource temporarily unavailable" tells nobody what has happened.
                Err(e) if passing(&e) => {
                    return Err(io::Error::new(
                        ErrorKind::TimedOut,
                        "it takes no more bytes, so nobody reads at its other end",
                    ));
                }
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn now(&mut self) -> Micros {
        Micros(u64::try_from(self.began.elapsed().as_micros()).unwrap_or(u64::MAX))
    }

    fn real_time(&self) -> bool {
        true
    }
}

impl Drop for SerialPipe {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        // A reader that waits for room is let go.
        self.pieces = None;
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
    }
}

/// A port that a board may be behind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortDescription {
    /// What to give to `--port`.
    pub path: String,
    /// What it is, as far as the system knows: maker and product.
    pub description: String,
    /// USB vendor and product, as `16c0:27dd`.
    pub usb_id: Option<String>,
    /// The USB serial number, which tells boards apart.
    pub serial_number: Option<String>,
    /// Whether it calls itself Cannula's board.
    pub is_board: bool,
}

/// The serial ports of this machine, the likeliest first.
pub fn ports() -> Result<Vec<PortDescription>, LinkError> {
    let found = serialport::available_ports().map_err(|e| LinkError::Io(e.into()))?;
    let mut ports: Vec<PortDescription> = found
        .into_iter()
        .map(|port| {
            let plain = |words: &str| PortDescription {
                path: port.port_name.clone(),
                description: words.into(),
                usb_id: None,
                serial_number: None,
                is_board: false,
            };
            match port.port_type {
                SerialPortType::UsbPort(ref usb) => {
                    let words = [&usb.manufacturer, &usb.product].map(|w| w.as_deref());
                    let text = words.into_iter().flatten().collect::<Vec<_>>().join(" ");
                    let is_board = text.to_lowercase().contains("cannula");
                    PortDescription {
                        usb_id: Some(format!("{:04x}:{:04x}", usb.vid, usb.pid)),
                        serial_number: usb.serial_number.clone(),
                        is_board,
                        ..plain(&text)
                    }
                }
                SerialPortType::BluetoothPort => plain("Bluetooth"),
                SerialPortType::PciPort => plain("built in"),
                SerialPortType::Unknown => plain("unknown"),
            }
        })
        .collect();
    ports.sort_by(|a, b| {
        b.is_board
            .cmp(&a.is_board)
            .then_with(|| a.path.cmp(&b.path))
    });
    Ok(ports)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::sync::mpsc::channel;

    /// A port whose every look is held until it is let go.
    struct Held(Receiver<Vec<u8>>);

    impl Read for Held {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let piece = self.0.recv().map_err(|_| ErrorKind::BrokenPipe)?;
            buffer[..piece.len()].copy_from_slice(&piece);
            Ok(piece.len())
        }
    }

    #[derive(Clone, Default)]
    struct Written(Arc<Mutex<Vec<u8>>>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            // As much as there is room for.
            let count = bytes.len().min(3);
            self.0.lock().unwrap().extend(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// If a held look held up reading or writing, this would never end.
    #[test]
    fn a_look_that_the_system_holds_holds_up_nothing() {
        let (let_go, held) = channel();
        let written = Written::default();
        let mut pipe = SerialPipe::between(Held(held), written.clone()).unwrap();
        let mut buffer = [0; 4];
        for _ in 0..3 {
            assert_eq!(pipe.read(&mut buffer, Micros(2_000)).unwrap(), 0);
            pipe.write(b"alive").unwrap();
        }
        assert_eq!(&*written.0.lock().unwrap(), b"alivealivealive");
        let_go.send(b"answer".to_vec()).unwrap();
        // In order, and nothing twice, though it is more than asked for at once.
        assert_eq!(pipe.read(&mut buffer, Micros(60_000_000)).unwrap(), 4);
        assert_eq!(&buffer, b"answ");
        assert_eq!(pipe.read(&mut buffer, Micros(0)).unwrap(), 2);
        assert_eq!(&buffer[..2], b"er");
        // A port that fails says so.
        drop(let_go);
        let failed = pipe.read(&mut buffer, Micros(60_000_000)).unwrap_err();
        assert_eq!(failed.kind(), ErrorKind::BrokenPipe);
    }

    /// A stopped board's terminal, once it is full.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(ErrorKind::WouldBlock.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_port_that_takes_nothing_is_said_in_words() {
        let (open, held) = channel();
        let mut pipe = SerialPipe::between(Held(held), Full).unwrap();
        let began = Instant::now();
        let said = LinkError::from(pipe.write(b"alive").unwrap_err()).to_string();
        assert!(began.elapsed() >= STUCK);
        assert!(
            said.starts_with("the port to the motion board failed: it takes no more bytes"),
            "{said}"
        );
        // The reader is let go before the pipe waits for it.
        drop(open);
    }
}
