//! Keeps a state machine's FIFO full from a ring of words, by two DMA channels in turn.
//!
//! A ring that the DMA read by itself would replay old steps for ever if the CPU died. So a channel
//! only ever gets words that have been pushed, and it is chained to the other one only once that one
//! has been armed with further words; otherwise it is chained to itself, which means to nothing:
//!
//! ```text
//!   ring   ......[ A: armed, running ][ B: armed, chained ][ pushed, not armed ]......
//!                 ^ DMA reads here                                             ^ head
//! ```
//!
//! When A completes, the hardware starts B in the same instant (no gap between the two), and the
//! interrupt arms A behind B. It has the whole of B's length to do so. If the CPU stops, A and B run
//! out and the motion starves.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, AtomicUsize, Ordering, compiler_fence};

use critical_section::{CriticalSection, Mutex};
use embassy_rp::pac;
use embassy_rp::pac::dma::regs::CtrlTrig;
use embassy_rp::pac::dma::vals::{DataSize, TreqSel};

/// A second channel is armed behind a running one only with at least this many words: a shorter run
/// would leave the interrupt little time. What remains waits for the running channel's end; the
/// FIFO's eight words cover the interrupt's latency then.
const WORTH_ARMING: usize = 64;
/// The most words given to a channel at once.
const MOST_ARMED: usize = 1024;

/// One of the two channels.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Which {
    A,
    B,
}

impl Which {
    const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// The words that a channel was armed with, as addresses.
#[derive(Clone, Copy)]
struct Run {
    /// Position of its first word, counted without end.
    from: usize,
    /// The address that the channel's read pointer has when it has read them all; 0: never armed.
    end: u32,
}

#[derive(Clone, Copy)]
struct Arming {
    /// Words given to a channel so far (counted without end, reduced at the ring).
    armed: usize,
    a: Run,
    b: Run,
    last: Which,
}

impl Arming {
    const EMPTY: Self = Self {
        armed: 0,
        a: Run { from: 0, end: 0 },
        b: Run { from: 0, end: 0 },
        last: Which::B,
    };

    const fn run(&self, which: Which) -> Run {
        match which {
            Which::A => self.a,
            Which::B => self.b,
        }
    }
}

/// A ring of words. Atomics, so that the DMA's reads of it need no `unsafe`: only slots that no
/// channel is armed with are written.
pub type Ring<const N: usize> = [AtomicU32; N];

/// An empty ring.
pub const fn ring<const N: usize>() -> Ring<N> {
    [const { AtomicU32::new(0) }; N]
}

/// A PIO block.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Block {
    /// PIO0.
    First,
    /// PIO1.
    Second,
}

/// A ring of `N` words, its two DMA channels and the FIFO that they feed.
pub struct Feed<const N: usize> {
    ring: &'static Ring<N>,
    /// Words pushed so far; written by the one task that pushes.
    head: AtomicUsize,
    /// Up to where pushing is known to be free; found anew only when it is reached.
    limit: AtomicUsize,
    arming: Mutex<Cell<Arming>>,
    channels: (u8, u8),
    block: Block,
    machine: u8,
}

impl<const N: usize> Feed<N> {
    /// A feed from `ring` to state machine `machine` of a block by the two DMA channels given.
    pub const fn new(
        ring: &'static Ring<N>,
        block: Block,
        machine: u8,
        channels: (u8, u8),
    ) -> Self {
        assert!(N.is_power_of_two() && channels.0 != channels.1 && machine < 4);
        Self {
            ring,
            head: AtomicUsize::new(0),
            limit: AtomicUsize::new(0),
            arming: Mutex::new(Cell::new(Arming::EMPTY)),
            channels,
            block,
            machine,
        }
    }

    const fn number(&self, which: Which) -> u8 {
        match which {
            Which::A => self.channels.0,
            Which::B => self.channels.1,
        }
    }

    fn channel(&self, which: Which) -> pac::dma::Channel {
        pac::DMA.ch(usize::from(self.number(which)))
    }

    /// The channels as a bit mask.
    pub const fn mask(&self) -> u16 {
        (1 << self.channels.0) | (1 << self.channels.1)
    }

    /// The control word of a channel that starts `chain_to` when it completes.
    fn control(&self, chain_to: Which) -> CtrlTrig {
        let mut ctrl = CtrlTrig(0);
        ctrl.set_en(true);
        ctrl.set_high_priority(true);
        ctrl.set_data_size(DataSize::SIZE_WORD);
        ctrl.set_incr_read(true);
        // The request numbers of PIO0's TX FIFOs are 0 to 3, of PIO1's 8 to 11.
        let first = match self.block {
            Block::First => 0,
            Block::Second => 8,
        };
        ctrl.set_treq_sel(TreqSel::from_bits(first + self.machine));
        ctrl.set_chain_to(self.number(chain_to));
        ctrl
    }

    fn fifo(&self) -> pac::common::Reg<u32, pac::common::RW> {
        let block = match self.block {
            Block::First => pac::PIO0,
            Block::Second => pac::PIO1,
        };
        block.txf(usize::from(self.machine))
    }

    fn busy(&self, which: Which) -> bool {
        self.channel(which).ctrl_trig().read().busy()
    }

    /// The channel has words still to read or to write, started or waiting for its chain. (Its busy
    /// bit alone would miss one that the other is about to start.)
    fn pending(&self, arming: &Arming, which: Which) -> bool {
        let run = arming.run(which);
        run.end != 0 && (self.busy(which) || self.channel(which).read_addr().read() != run.end)
    }

    /// Stops both channels, forgets all words. Bounded: an abort takes a few bus cycles.
    pub fn clear(&self) {
        critical_section::with(|cs| {
            for which in [Which::A, Which::B] {
                // Disabled and chained to nothing first: an aborted channel must not start the other.
                let mut off = self.control(which);
                off.set_en(false);
                self.channel(which).al1_ctrl().write_value(off.0);
            }
            pac::DMA
                .chan_abort()
                .write(|w| w.set_chan_abort(self.mask()));
            for _ in 0..1000 {
                if pac::DMA.chan_abort().read().chan_abort() & self.mask() == 0 {
                    break;
                }
            }
            // RP2040-E13: an abort may leave a completion interrupt behind.
            pac::DMA.ints(1).write_value(u32::from(self.mask()));
            pac::DMA.inte(1).modify(|w| *w |= u32::from(self.mask()));
            self.arming.borrow(cs).set(Arming::EMPTY);
            self.head.store(0, Ordering::Relaxed);
            self.limit.store(0, Ordering::Relaxed);
        });
    }

    /// Words that may be pushed now.
    pub fn room(&self) -> usize {
        let limit = critical_section::with(|cs| {
            let arming = self.arming.borrow(cs).get();
            let first = arming.last.other();
            let oldest = if self.pending(&arming, first) {
                arming.run(first).from
            } else if self.pending(&arming, arming.last) {
                arming.run(arming.last).from
            } else {
                arming.armed
            };
            oldest.wrapping_add(N)
        });
        self.limit.store(limit, Ordering::Relaxed);
        limit.wrapping_sub(self.head.load(Ordering::Relaxed))
    }

    /// Appends a word; `false` if there is no room. It is played after [`Self::pump`].
    pub fn push(&self, word: u32) -> bool {
        let head = self.head.load(Ordering::Relaxed);
        if head == self.limit.load(Ordering::Relaxed) && self.room() == 0 {
            return false;
        }
        if let Some(slot) = self.ring.get(head % N) {
            slot.store(word, Ordering::Relaxed);
        }
        self.head.store(head.wrapping_add(1), Ordering::Release);
        true
    }

    /// Gives waiting words to free channels. Called after pushing and from the DMA's interrupt.
    pub fn pump(&self) {
        critical_section::with(|cs| {
            // At most two channels can be armed.
            while self.arm_one(cs) {}
        });
    }

    /// Arms a free channel, if there is one and words for it. Each success takes a channel, so a
    /// caller's loop over this ends after two.
    fn arm_one(&self, cs: CriticalSection<'_>) -> bool {
        let cell = self.arming.borrow(cs);
        let mut arming = cell.get();
        let waiting = self.head.load(Ordering::Acquire).wrapping_sub(arming.armed);
        let (last, free) = (arming.last, arming.last.other());
        if waiting == 0 || self.pending(&arming, free) {
            return false;
        }
        let behind = self.pending(&arming, last);
        if behind && waiting < WORTH_ARMING {
            return false;
        }
        // Up to the ring's end: the next run begins at its start.
        let start = arming.armed % N;
        let count = waiting.min(MOST_ARMED).min(N - start);
        let Some(first) = self.ring.get(start) else {
            return false;
        };
        let address = first.as_ptr() as u32;
        let channel = self.channel(free);
        channel.read_addr().write_value(address);
        channel
            .write_addr()
            .write_value(self.fifo().as_ptr() as u32);
        #[cfg(feature = "rp2040")]
        channel.trans_count().write(|w| *w = count as u32);
        // Mode 0: once.
        #[cfg(feature = "rp2350")]
        channel.trans_count().write(|w| w.set_count(count as u32));
        // The words are in memory before the DMA is told of them.
        compiler_fence(Ordering::SeqCst);
        cortex_m::asm::dmb();
        if behind {
            channel.al1_ctrl().write_value(self.control(free).0);
            let before = self.channel(last);
            before.al1_ctrl().write_value(self.control(free).0);
            // It may have completed before it was chained: then nobody has started this one.
            if !self.busy(last) && !self.busy(free) && channel.read_addr().read() == address {
                channel.ctrl_trig().write_value(self.control(free));
            }
        } else {
            channel.ctrl_trig().write_value(self.control(free));
        }
        let run = Run {
            from: arming.armed,
            end: address.wrapping_add(4 * count as u32),
        };
        match free {
            Which::A => arming.a = run,
            Which::B => arming.b = run,
        }
        arming.armed = arming.armed.wrapping_add(count);
        arming.last = free;
        cell.set(arming);
        true
    }

    /// No word waits in the ring or in a channel (the FIFO may still hold some).
    pub fn drained(&self) -> bool {
        critical_section::with(|cs| {
            let arming = self.arming.borrow(cs).get();
            self.head.load(Ordering::Relaxed) == arming.armed
                && !self.pending(&arming, Which::A)
                && !self.pending(&arming, Which::B)
        })
    }
}
