//! How a stage tells that it goes on, without knowing of a terminal.

/// Who listens to a job. Steps may come from several threads at once.
pub trait Progress: Sync {
    /// A stage begins; `steps` calls of [`Progress::step`] follow.
    fn start(&self, stage: &str, steps: usize) {
        let _ = (stage, steps);
    }
    /// One step of the stage is done.
    fn step(&self) {}
    /// The stage is over.
    fn finish(&self) {}
    /// Something that the user should know although the job goes on.
    fn warn(&self, message: &str) {
        let _ = message;
    }
}

/// Nobody listens.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {}
