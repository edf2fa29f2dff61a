//! A scan under way: what comes next, which trigger is which, and when the laser is wanted.
//!
//! ```text
//! stop and shoot   approach ─► ( settle ─► laser, lead ─► fire ─► exposure ─► hop )ⁿ
//! on the fly       approach ─► settle ─► pass (triggers in hardware) ─► last exposure
//! ```

use crate::engine::TriggerEdge;
use crate::exposure::Exposures;
use crate::laser::Lights;
use crate::profile::Profile;
use crate::scan_plan::ScanPlan;
use cannula_shared::config::{Config, ExposureInput};
use cannula_shared::error::{Doing, Fault};
use cannula_shared::message::{LedgerSum, ScanLaser, ScanSummary, Trigger};
use cannula_shared::units::{Micros, Steps};

/// An exposure that lasts this much longer than twice its time will not end.
const OVERDUE: Micros = Micros(100_000);
/// How long a standing scan waits for the host to acknowledge events.
const PATIENCE: Micros = Micros(2_000_000);

/// Where the scan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Approach,
    Approaching,
    Settle(Micros),
    Lead(Micros),
    Exposing { since: Micros },
    Hopping,
    LeadIn(Micros),
    Passing,
    LastExposure { since: Micros },
}

/// A scan under way.
#[derive(Clone, Debug)]
pub struct Scan {
    plan: ScanPlan,
    job: u32,
    phase: Phase,
    fired: u32,
    exposures: Exposures,
    sum: LedgerSum,
    last_fired: Option<Micros>,
}

/// What is wanted of the laser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Off.
    Off,
    /// On for so long from now.
    Lease(Micros),
    /// As the light words say that were computed ahead.
    Planned,
}

/// What the scan wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing; ask again by then.
    Rest(Micros),
    /// Nothing until the move has ended.
    Wait,
    /// Go to this step.
    MoveTo(Steps),
    /// Start the pass over all triggers.
    Pass(Profile),
    /// Fire the trigger with this index now.
    Fire(u32),
    /// The scan is complete.
    Done,
    /// It failed.
    Failed(Fault),
}

impl Scan {
    /// Begins a checked scan.
    pub fn new(config: &Config, plan: ScanPlan, job: u32) -> Self {
        let counted = config.exposure_input == ExposureInput::Counted;
        let (delay, length) = (
            Micros(config.exposure_delay_us.into()),
            Micros(config.exposure_us.into()),
        );
        Scan {
            plan,
            job,
            phase: Phase::Approach,
            fired: 0,
            exposures: Exposures::new(counted, delay, length),
            sum: LedgerSum::default(),
            last_fired: None,
        }
    }

    /// The light of a pass, where the laser is timed: until the latest end of each exposure.
    pub fn lights(&self, config: &Config, pass: Profile) -> Option<Lights> {
        let plan = &self.plan;
        (plan.request.laser == ScanLaser::Timed).then(|| {
            let lead = Micros(config.laser_lead_us.into());
            let tail =
                Micros(config.exposure_delay_us.into()).after(Micros(config.exposure_us.into()));
            Lights::new(plan.triggers, pass, plan.begin, lead, tail)
        })
    }

    /// The job's number.
    pub const fn job(&self) -> u32 {
        self.job
    }

    /// The plan.
    pub const fn plan(&self) -> &ScanPlan {
        &self.plan
    }

    /// Triggers fired so far.
    pub const fn fired(&self) -> u32 {
        self.fired
    }

    /// The exposures' count.
    pub fn exposures(&mut self) -> &mut Exposures {
        &mut self.exposures
    }

    /// Places that a trigger takes in the ledger: its own line, and one for an exposure that may be missing.
    pub fn places(config: &Config) -> usize {
        1 + usize::from(config.exposure_input == ExposureInput::Counted)
    }

    /// The ledger's closing line.
    pub fn summary(&self) -> ScanSummary {
        ScanSummary {
            job: self.job,
            planned: self.plan.triggers.count(),
            fired: self.fired,
            exposures: self.exposures.seen(),
            missing: self.exposures.missing(),
            checksum: self.sum.value(),
        }
    }

    /// A trigger has fired: its line in the ledger; and the fault, if the laser was off though wanted.
    pub fn trigger(&mut self, edge: TriggerEdge) -> Option<(Trigger, Option<Fault>)> {
        let index = self.fired;
        let position = self.plan.triggers.position(index)?;
        let trigger = Trigger {
            job: self.job,
            index,
            position,
            time: edge.time,
            laser: edge.laser,
        };
        self.sum.add(&trigger);
        self.fired += 1;
        self.last_fired = Some(edge.time);
        self.exposures.trigger(index, edge.time);
        let dark = self.plan.request.laser != ScanLaser::Off && !edge.laser;
        Some((trigger, dark.then_some(Fault::LaserOff { index })))
    }

    /// The move under way has arrived.
    pub fn arrived(&mut self, now: Micros, config: &Config) -> Result<(), Fault> {
        self.phase = match self.phase {
            Phase::Approaching | Phase::Hopping => {
                Phase::Settle(now.after(Micros(config.settle_us.into())))
            }
            Phase::Passing if self.fired < self.plan.triggers.count() => {
                return Err(Fault::MissingTrigger { index: self.fired });
            }
            Phase::Passing => Phase::LastExposure { since: now },
            _ => {
                return Err(Fault::Timeout {
                    doing: Doing::Scanning,
                });
            }
        };
        Ok(())
    }

    /// What to do now. `position` is where the slide stands if it does.
    pub fn next(&mut self, now: Micros, config: &Config, position: Steps, moving: bool) -> Next {
        if moving {
            return Next::Wait;
        }
        loop {
            match self.phase {
                Phase::Approach => {
                    self.phase = Phase::Approaching;
                    if position != self.plan.begin {
                        return Next::MoveTo(self.plan.begin);
                    }
                    self.phase = Phase::Settle(now.after(Micros(config.settle_us.into())));
                }
                Phase::Approaching | Phase::Hopping | Phase::Passing => return Next::Wait,
                Phase::Settle(until) | Phase::Lead(until) | Phase::LeadIn(until) if now < until => {
                    return Next::Rest(until);
                }
                Phase::Settle(_) => {
                    let lead = match (self.plan.request.laser, self.plan.pass) {
                        (ScanLaser::Off, _) | (ScanLaser::Timed, Some(_)) => 0,
                        _ => config.laser_lead_us,
                    };
                    let until = now.after(Micros(lead.into()));
                    self.phase = if self.plan.pass.is_some() {
                        Phase::LeadIn(until)
                    } else {
                        Phase::Lead(until)
                    };
                }
                Phase::LeadIn(_) => {
                    return match self.plan.pass {
                        Some(profile) => {
                            self.phase = Phase::Passing;
                            Next::Pass(profile)
                        }
                        None => Next::Failed(Fault::Timeout {
                            doing: Doing::Scanning,
                        }),
                    };
                }
                Phase::Lead(_) => {
                    let ready = self
                        .last_fired
                        .map_or(Micros(0), |then| then.after(config.min_trigger_gap()));
                    return if now < ready {
                        Next::Rest(ready)
                    } else {
                        Next::Fire(self.fired)
                    };
                }
                Phase::Exposing { since } => {
                    if !self.exposed(now) {
                        return self.wait_for_exposure(now, since, config);
                    }
                    match self.plan.triggers.position(self.fired) {
                        Some(next) => {
                            self.phase = Phase::Hopping;
                            return Next::MoveTo(next);
                        }
                        None => return Next::Done,
                    }
                }
                Phase::LastExposure { since } => {
                    return if self.exposed(now) {
                        Next::Done
                    } else {
                        self.wait_for_exposure(now, since, config)
                    };
                }
            }
        }
    }

    /// The trigger asked for by [`Next::Fire`] is on its way.
    pub fn firing(&mut self, now: Micros) {
        self.phase = Phase::Exposing { since: now };
    }

    /// The ledger has no place for the trigger asked for: waits, for so long.
    pub fn held_up(&self, now: Micros) -> Result<Micros, Fault> {
        match self.phase {
            Phase::Lead(until) if now > until.after(PATIENCE) => {
                Err(Fault::LedgerFull { index: self.fired })
            }
            _ => Ok(now.after(Micros(2000))),
        }
    }

    fn exposed(&self, now: Micros) -> bool {
        let fired = match self.phase {
            // The trigger's interrupt comes before its exposure can be over.
            Phase::Exposing { since } => self.last_fired.is_some_and(|then| then >= since),
            _ => true,
        };
        fired && self.exposures.settled(now)
    }

    fn wait_for_exposure(&self, now: Micros, since: Micros, config: &Config) -> Next {
        let length = u64::from(config.exposure_us);
        let latest = since
            .after(Micros(u64::from(config.exposure_delay_us) + 2 * length))
            .after(OVERDUE);
        if now <= latest {
            return Next::Rest(
                self.exposures
                    .settles_at()
                    .max(now.after(Micros(200)))
                    .min(now.after(Micros(1000))),
            );
        }
        let unfired = matches!(self.phase, Phase::Exposing { since } if self.last_fired.is_none_or(|then| then < since));
        Next::Failed(if unfired {
            Fault::MissingTrigger { index: self.fired }
        } else {
            Fault::Timeout {
                doing: Doing::Scanning,
            }
        })
    }

    /// What the scan wants of the laser now.
    pub fn laser(&self, lease: Micros) -> Light {
        let at_trigger = matches!(self.phase, Phase::Lead(_) | Phase::Exposing { .. });
        let passing = matches!(self.phase, Phase::Passing | Phase::LastExposure { .. });
        let wanted = match (self.plan.request.laser, self.plan.pass) {
            (ScanLaser::Off, _) => false,
            (ScanLaser::Timed, Some(_)) if passing => return Light::Planned,
            (ScanLaser::Timed, Some(_)) => false,
            (ScanLaser::Whole, Some(_)) => passing || matches!(self.phase, Phase::LeadIn(_)),
            (ScanLaser::Whole, None) => at_trigger || self.fired > 0,
            (ScanLaser::Timed, None) => at_trigger,
        };
        if wanted {
            Light::Lease(lease)
        } else {
            Light::Off
        }
    }
}
