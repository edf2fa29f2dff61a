//! A running scan as a stream of events, whose ledger is checked as it comes.

use super::Result;
use super::board::{Board, Incoming};
use super::error::LinkError;
use cannula_shared::message::{Event, LedgerSum, Outcome, ScanSummary, Telemetry, Trigger};
use cannula_shared::units::Micros;

/// What a scan reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanEvent {
    /// A trigger has fired.
    Trigger(Trigger),
    /// A trigger's exposure did not come (where that is a warning).
    MissingExposure {
        /// The trigger.
        index: u32,
    },
    /// Where the slide is; some may be missing.
    Position(Telemetry),
    /// The scan is complete: count and checksum agree with the triggers handed out.
    End(ScanSummary),
}

/// A running scan. Dropping it before its end stops it.
pub struct Scan<'a> {
    board: &'a Board,
    job: u32,
    planned: u32,
    sum: LedgerSum,
    summary: Option<ScanSummary>,
    over: bool,
}

impl<'a> Scan<'a> {
    pub(super) fn new(board: &'a Board, job: u32, planned: u32) -> Self {
        Scan {
            board,
            job,
            planned,
            sum: LedgerSum::default(),
            summary: None,
            over: false,
        }
    }

    /// The job's number.
    pub fn job(&self) -> u32 {
        self.job
    }

    /// The next event; `None` after the end. An error if the scan ended otherwise than asked, or
    /// its ledger does not add up.
    pub fn next_event(&mut self) -> Result<Option<ScanEvent>> {
        self.next_within(Micros(u64::MAX))
            .map(|found| found.unwrap_or(None))
    }

    /// As [`Self::next_event`], but waits no longer than `wait`: `None` then, `Some(None)` after the end.
    pub fn next_within(&mut self, wait: Micros) -> Result<Option<Option<ScanEvent>>> {
        if self.over {
            return Ok(Some(None));
        }
        let began = self.board.now();
        loop {
            let left = Micros(wait.0.saturating_sub(self.board.now().since(began).0));
            let incoming = self.board.next(left.min(Micros(20_000)));
            let event = match incoming.inspect_err(|_| self.over = true)? {
                Incoming::Position(telemetry) => {
                    return Ok(Some(Some(ScanEvent::Position(telemetry))));
                }
                Incoming::Event(event) => event,
                Incoming::Nothing { silent } => {
                    // First: who waits in short slices would never come to it.
                    self.board
                        .check_silence(silent, "scanning")
                        .inspect_err(|_| self.over = true)?;
                    if self.board.now().since(began) >= wait {
                        return Ok(None);
                    }
                    continue;
                }
            };
            if let Some(event) = self.take(event)? {
                return Ok(Some(Some(event)));
            }
            if self.over {
                return Ok(Some(None));
            }
        }
    }

    fn take(&mut self, event: Event) -> Result<Option<ScanEvent>> {
        match event {
            Event::Trigger(trigger) if trigger.job == self.job => {
                if trigger.index != self.sum.count() {
                    return Err(LinkError::Ledger(format!(
                        "trigger {} came where {} was due",
                        trigger.index,
                        self.sum.count()
                    )));
                }
                self.sum.add(&trigger);
                Ok(Some(ScanEvent::Trigger(trigger)))
            }
            Event::MissingExposure { job, index } if job == self.job => {
                Ok(Some(ScanEvent::MissingExposure { index }))
            }
            Event::ScanEnd(summary) if summary.job == self.job => {
                if summary.fired != self.sum.count() || summary.checksum != self.sum.value() {
                    return Err(LinkError::Ledger(format!(
                        "the board fired {} triggers (checksum {:08x}), {} arrived ({:08x})",
                        summary.fired,
                        summary.checksum,
                        self.sum.count(),
                        self.sum.value()
                    )));
                }
                self.summary = Some(summary);
                Ok(None)
            }
            Event::JobEnd { job, outcome, .. } if job == self.job => {
                self.over = true;
                match (outcome, self.summary) {
                    (Outcome::Done, Some(summary)) if summary.fired == self.planned => {
                        Ok(Some(ScanEvent::End(summary)))
                    }
                    (Outcome::Done, Some(summary)) => Err(LinkError::Ledger(format!(
                        "{} of {} triggers fired, and the board calls it done",
                        summary.fired, self.planned
                    ))),
                    (Outcome::Done, None) => Err(LinkError::Ledger(
                        "the scan ended without its summary".into(),
                    )),
                    (Outcome::Stopped, _) => Err(LinkError::Stopped),
                    (Outcome::Failed(fault), _) => Err(LinkError::Fault(fault)),
                }
            }
            // Of other jobs, or told again by the job's end.
            _ => Ok(None),
        }
    }

    /// The summary, once it has come; also after a stop or a fault.
    pub fn summary(&self) -> Option<ScanSummary> {
        self.summary
    }

    /// Stops the scan; its remaining events can still be taken.
    pub fn stop(&self) -> Result<()> {
        self.board.stop()
    }

    /// Stops the scan, of which nothing more is wanted: one short try.
    pub fn abandon(&mut self) -> Result<()> {
        self.over = true;
        self.board.ask_to_stop()
    }

    /// Runs to the end; `each` sees every event.
    pub fn run(mut self, mut each: impl FnMut(&ScanEvent)) -> Result<ScanSummary> {
        while let Some(event) = self.next_event()? {
            each(&event);
            if let ScanEvent::End(summary) = event {
                return Ok(summary);
            }
        }
        Err(LinkError::Ledger(
            "the scan ended without its summary".into(),
        ))
    }
}

impl Drop for Scan<'_> {
    fn drop(&mut self) {
        if !self.over {
            let _ = self.board.ask_to_stop();
        }
    }
}
