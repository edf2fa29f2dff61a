//! The watchdog's roll call: it is fed only when every task has checked in since the last time.

/// A task of the binary, by its place in the roll (0 to 31).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task(pub u8);

/// Who must check in, and who has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckIns {
    all: u32,
    present: u32,
}

impl CheckIns {
    /// A roll of `tasks` tasks, [`Task`] 0 to `tasks` − 1 (32 at most).
    pub const fn new(tasks: u8) -> Self {
        let all = if tasks >= 32 {
            u32::MAX
        } else {
            (1 << tasks) - 1
        };
        CheckIns { all, present: 0 }
    }

    /// `task` is alive.
    pub fn check_in(&mut self, task: Task) {
        if let Some(bit) = 1u32.checked_shl(u32::from(task.0)) {
            self.present |= bit & self.all;
        }
    }

    /// Whether the watchdog may be fed now; if so, the roll starts afresh.
    pub fn complete(&mut self) -> bool {
        let complete = self.all != 0 && self.present == self.all;
        if complete {
            self.present = 0;
        }
        complete
    }

    /// The tasks that are missing, as bits: for the log.
    pub const fn missing(&self) -> u32 {
        self.all & !self.present
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_missing_task_starves_the_watchdog() {
        for tasks in 1..=32u8 {
            for absent in 0..tasks {
                let mut roll = CheckIns::new(tasks);
                for round in 0..3 {
                    (0..tasks)
                        .filter(|&t| t != absent)
                        .for_each(|t| roll.check_in(Task(t)));
                    assert!(
                        !roll.complete(),
                        "{tasks} tasks, {absent} absent, round {round}"
                    );
                    assert_eq!(roll.missing(), 1 << absent);
                }
                roll.check_in(Task(absent));
                assert!(roll.complete());
                assert!(!roll.complete(), "must check in again");
            }
        }
        let mut none = CheckIns::new(0);
        assert!(!none.complete(), "nobody to ask: not fed");
        none.check_in(Task(40));
        assert!(!none.complete());
    }
}
