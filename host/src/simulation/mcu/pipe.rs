//! The simulated board as a pipe on virtual time: waiting for bytes lets time pass.

use super::SimulatedBoard;
use crate::rig::link::Pipe;
use cannula_shared::units::{Cycles, Micros};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A simulated board that others may look at and disturb while a [`Pipe`] drives it.
#[derive(Clone)]
pub struct VirtualPipe(Arc<Mutex<SimulatedBoard>>);

impl VirtualPipe {
    /// Wraps a board. Clones are the same board.
    pub fn new(board: SimulatedBoard) -> Self {
        VirtualPipe(Arc::new(Mutex::new(board)))
    }

    /// The board itself. Do not hold it while calling the link.
    pub fn board(&self) -> MutexGuard<'_, SimulatedBoard> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Pipe for VirtualPipe {
    fn read(&mut self, buffer: &mut [u8], wait: Micros) -> io::Result<usize> {
        let mut board = self.board();
        let until = Cycles(board.now().0 + wait.to_cycles().0);
        board.run_until_bytes(until);
        let bytes = board.receive_up_to(buffer.len());
        for (to, from) in buffer.iter_mut().zip(&bytes) {
            *to = *from;
        }
        Ok(bytes.len())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.board().send(bytes);
        Ok(())
    }

    fn now(&mut self) -> Micros {
        self.board().now().to_micros_down()
    }

    fn real_time(&self) -> bool {
        false
    }
}
