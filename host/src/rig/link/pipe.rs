//! Byte pipes: a serial port (USB or pseudo-terminal), and whatever else implements [`Pipe`].

use super::error::LinkError;
use cannula_shared::units::Micros;
use serialport::{SerialPort, SerialPortType};
use std::io::{self, ErrorKind, Read, Write};
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

/// A serial port.
pub struct SerialPipe {
    port: Box<dyn SerialPort>,
    began: Instant,
}

impl SerialPipe {
    /// Opens the port at `path`. The baud rate means nothing to USB CDC.
    pub fn open(path: &str) -> Result<Self, LinkError> {
        let port = serialport::new(path, 115_200)
            .timeout(Duration::from_millis(5))
            .open()
            .map_err(|e| LinkError::Open {
                path: path.into(),
                source: e.into(),
            })?;
        Ok(Self::over(port))
    }

    /// Takes an open port.
    pub fn over(port: Box<dyn SerialPort>) -> Self {
        SerialPipe {
            port,
            began: Instant::now(),
        }
    }
}

impl Pipe for SerialPipe {
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize> {
        self.port
            .set_timeout(Duration::from_micros(wait.0.max(1000)))?;
        match self.port.read(buffer) {
            // An end of file: the other end of a pseudo-terminal has gone.
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(n) => Ok(n),
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
                ) =>
            {
                Ok(0)
            }
            Err(e) => Err(e),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.set_timeout(Duration::from_millis(500))?;
        self.port.write_all(bytes)
    }

    fn now(&mut self) -> Micros {
        Micros(u64::try_from(self.began.elapsed().as_micros()).unwrap_or(u64::MAX))
    }

    fn real_time(&self) -> bool {
        true
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
