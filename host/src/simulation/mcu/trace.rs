//! The record of pin edges.

/// A pin of the board, by its signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Pin {
    /// STEP (GP2).
    Step,
    /// DIR (GP3).
    Direction,
    /// ENABLE (GP4), low = driver on.
    Enable,
    /// TRIGGER (GP6).
    Trigger,
    /// LASER (GP7).
    Laser,
    /// HOME (GP10).
    Home,
    /// LIMIT (GP11).
    Limit,
    /// ESTOP (GP12).
    EStop,
    /// INTERLOCK (GP13).
    Interlock,
    /// EXPOSURE (GP14).
    Exposure,
    /// LED (GP25).
    Led,
}

const PINS: usize = 11;

/// A change of level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When, in cycles since power came on.
    pub cycle: u64,
    /// Which pin.
    pub pin: Pin,
    /// Its level from then on.
    pub high: bool,
}

/// Edges in the order of time.
#[derive(Clone, Debug)]
pub struct Trace {
    edges: Vec<Edge>,
    levels: [bool; PINS],
    steps: u64,
    /// Whether STEP edges are recorded (they are counted always): a long session has millions.
    pub keep_steps: bool,
}

impl Default for Trace {
    fn default() -> Self {
        let mut levels = [false; PINS];
        // The pull-up: driver off.
        levels[Pin::Enable as usize] = true;
        Trace {
            edges: Vec::new(),
            levels,
            steps: 0,
            keep_steps: true,
        }
    }
}

impl Trace {
    /// Notes the level of a pin; an edge if it differs from before.
    pub(super) fn record(&mut self, cycle: u64, pin: Pin, high: bool) {
        if self.levels[pin as usize] == high {
            return;
        }
        self.levels[pin as usize] = high;
        if pin == Pin::Step {
            self.steps += u64::from(high);
            if !self.keep_steps {
                return;
            }
        }
        self.edges.push(Edge { cycle, pin, high });
    }

    /// The level of a pin now.
    pub fn level(&self, pin: Pin) -> bool {
        self.levels[pin as usize]
    }

    /// All edges since the last [`Self::clear`].
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// Times of the rising edges of a pin.
    pub fn rises(&self, pin: Pin) -> impl Iterator<Item = u64> + '_ {
        self.edges
            .iter()
            .filter(move |e| e.pin == pin && e.high)
            .map(|e| e.cycle)
    }

    /// Times of the falling edges of a pin.
    pub fn falls(&self, pin: Pin) -> impl Iterator<Item = u64> + '_ {
        self.edges
            .iter()
            .filter(move |e| e.pin == pin && !e.high)
            .map(|e| e.cycle)
    }

    /// STEP edges since power came on.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Forgets the edges; levels and counts stay.
    pub fn clear(&mut self) {
        self.edges.clear();
    }
}
