//! The emulator's process (`tests/emulator/serve.mjs`), and its USB as a byte pipe on virtual time.

use cannula::rig::link::Pipe;
use cannula_shared::units::Micros;
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use crate::edges::Edges;

/// Cycles of the board's clock in a microsecond.
pub const PER_MICRO: u64 = 125;

/// The ELF to run and the emulator's folder; `None`, with the reason printed in one word, where they
/// are missing and the environment does not insist (`CANNULA_REQUIRE_EMULATOR=1`).
pub fn find() -> Option<(PathBuf, PathBuf)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = root.join("tests/emulator");
    let built = root.join("target/thumb/thumbv6m-none-eabi/firmware/motion-board");
    let elf = std::env::var_os("CANNULA_ELF").map_or(built, PathBuf::from);
    let node = Command::new("node")
        .arg("--version")
        .output()
        .is_ok_and(|o| o.status.success());
    let missing = if !node {
        "no-node"
    } else if !folder.join("node_modules/rp2040js").exists() {
        "no-rp2040js"
    } else if !elf.exists() {
        "no-elf"
    } else {
        return Some((elf, folder));
    };
    assert!(
        std::env::var_os("CANNULA_REQUIRE_EMULATOR").is_none_or(|v| v != "1"),
        "the emulator is required here, but: {missing} ({})",
        elf.display()
    );
    println!("skipped:{missing}");
    None
}

/// A running emulator.
pub struct Emulator {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    /// Cycles since power-on.
    pub cycle: u64,
    /// STEP edges since power-on.
    pub steps: u64,
    /// Resets of the chip since power-on.
    pub resets: u32,
    /// Cycles in which the CPU slept.
    pub asleep: u64,
    outgoing: Vec<u8>,
    incoming: VecDeque<u8>,
}

impl Emulator {
    /// Powers a board up.
    pub fn start((elf, folder): &(PathBuf, PathBuf)) -> io::Result<Self> {
        let mut child = Command::new("node")
            .arg(folder.join("serve.mjs"))
            .arg(elf)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(io::Error::other("no pipes to node"));
        };
        Ok(Self {
            child,
            to,
            from: BufReader::new(from),
            cycle: 0,
            steps: 0,
            resets: 0,
            asleep: 0,
            outgoing: Vec::new(),
            incoming: VecDeque::new(),
        })
    }

    /// One command, one answer.
    pub fn command(&mut self, line: &str) -> io::Result<String> {
        self.to.write_all(line.as_bytes())?;
        self.to.write_all(b"\n")?;
        self.to.flush()?;
        let mut answer = String::new();
        if self.from.read_line(&mut answer)? == 0 {
            return Err(io::Error::other("the emulator has ended"));
        }
        let answer = answer.trim_end();
        match answer.strip_prefix("error ") {
            Some(error) => Err(io::Error::other(format!("{line}: {error}"))),
            None => Ok(answer.into()),
        }
    }

    /// Runs for so many cycles, or until the board has sent something.
    pub fn run(&mut self, cycles: u64) -> io::Result<()> {
        let bytes: String = self
            .outgoing
            .drain(..)
            .map(|b| format!("{b:02x}"))
            .collect();
        let answer = self.command(&format!("run {cycles} {bytes}"))?;
        let mut words = answer.split(' ');
        let mut number = || {
            words
                .next()
                .and_then(|w| w.parse::<u64>().ok())
                .ok_or_else(|| io::Error::other("a number is missing"))
        };
        self.cycle = number()?;
        self.steps = number()?;
        self.resets = number()? as u32;
        self.asleep = number()?;
        let hex = words.next().unwrap_or_default();
        for pair in hex.as_bytes().chunks(2) {
            let text = std::str::from_utf8(pair).map_err(io::Error::other)?;
            self.incoming
                .push_back(u8::from_str_radix(text, 16).map_err(io::Error::other)?);
        }
        Ok(())
    }

    /// Runs for so long, deaf to the board: what it sends is kept for the pipe.
    pub fn run_on(&mut self, micros: u64) -> io::Result<()> {
        let end = self.cycle + micros * PER_MICRO;
        while self.cycle < end {
            self.run(end - self.cycle)?;
        }
        Ok(())
    }

    /// The pins' edges since the last `mark`.
    pub fn edges(&mut self) -> io::Result<Edges> {
        let file = tempfile::NamedTempFile::new()?;
        self.command(&format!("edges {}", file.path().display()))?;
        Ok(Edges::parse(&std::fs::read(file.path())?))
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An emulator that the link's pipe and the test both hold.
#[derive(Clone)]
pub struct Shared(Arc<Mutex<Emulator>>);

impl Shared {
    /// Shares it.
    pub fn new(emulator: Emulator) -> Self {
        Self(Arc::new(Mutex::new(emulator)))
    }

    /// For the test's own use; never held while the link works.
    pub fn get(&self) -> MutexGuard<'_, Emulator> {
        self.0
            .lock()
            .expect("a test panicked while it held the emulator")
    }

    /// Its USB.
    pub fn pipe(&self) -> UsbPipe {
        UsbPipe {
            emulator: self.clone(),
            noise: None,
        }
    }

    /// Its USB with a bad cable: of 1000 pieces, so many are damaged in each direction.
    pub fn lossy_pipe(&self, damaged_of_1000: u64, seed: u64) -> UsbPipe {
        let noise = Noise {
            state: seed,
            damaged_of_1000,
            damaged: Default::default(),
        };
        UsbPipe {
            emulator: self.clone(),
            noise: Some(noise),
        }
    }
}

/// Drops, flips, doubles bytes and whole pieces of the stream.
pub struct Noise {
    state: u64,
    damaged_of_1000: u64,
    /// How many pieces have been damaged.
    pub damaged: Arc<AtomicU64>,
}

impl Noise {
    /// Numbers from 0 to `n` − 1 (splitmix64).
    fn below(&mut self, n: u64) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ z >> 31) % n.max(1)
    }

    fn pass(&mut self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() || self.below(1000) >= self.damaged_of_1000 {
            return;
        }
        self.damaged.fetch_add(1, Ordering::Relaxed);
        let at = self.below(bytes.len() as u64) as usize;
        match self.below(4) {
            0 => {
                bytes.remove(at);
            }
            1 => bytes[at] ^= 1 << self.below(8),
            2 => bytes.insert(at, bytes[at]),
            _ => bytes.clear(),
        }
    }
}

/// The emulated board's USB, on the board's own time.
pub struct UsbPipe {
    emulator: Shared,
    noise: Option<Noise>,
}

impl UsbPipe {
    /// Counts the damaged pieces.
    pub fn damaged(&self) -> Arc<AtomicU64> {
        self.noise
            .as_ref()
            .map(|n| n.damaged.clone())
            .unwrap_or_default()
    }
}

impl Pipe for UsbPipe {
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize> {
        let mut emulator = self.emulator.get();
        if emulator.incoming.is_empty() {
            // A wait of nothing still lets time pass: on virtual time nothing else does.
            emulator.run((wait.0 * PER_MICRO).max(1000))?;
            if let Some(noise) = &mut self.noise {
                let mut bytes = Vec::from_iter(emulator.incoming.drain(..));
                noise.pass(&mut bytes);
                emulator.incoming.extend(bytes);
            }
        }
        let length = buffer.len().min(emulator.incoming.len());
        for (to, byte) in buffer.iter_mut().zip(emulator.incoming.drain(..length)) {
            *to = byte;
        }
        Ok(length)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut bytes = bytes.to_vec();
        if let Some(noise) = &mut self.noise {
            noise.pass(&mut bytes);
        }
        self.emulator.get().outgoing.extend(bytes);
        Ok(())
    }

    fn now(&mut self) -> Micros {
        Micros(self.emulator.get().cycle / PER_MICRO)
    }

    fn real_time(&self) -> bool {
        false
    }
}
