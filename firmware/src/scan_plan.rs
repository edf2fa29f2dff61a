//! From a scan request to what will be executed, and the check of it before anything moves.

use crate::laser::EARLIEST;
use crate::profile::{Profile, interval_of};
use crate::ramp::Ramp;
use crate::verify::{Check, Checked};
use cannula_shared::config::{Config, MIN_STEP_RATE};
use cannula_shared::error::Refusal;
use cannula_shared::message::{ScanLaser, ScanMode, ScanRequest};
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Cycles, Micros, Steps};

/// A planned scan.
#[derive(Clone, Copy, Debug)]
pub struct ScanPlan {
    /// What was asked for.
    pub request: ScanRequest,
    /// Where the triggers stand.
    pub triggers: TriggerPlan,
    /// Where the slide goes first: below the first trigger on the fly, onto it otherwise.
    pub begin: Steps,
    /// The pass over all triggers, on the fly.
    pub pass: Option<Profile>,
    /// Ramp of all moves.
    pub ramp: Ramp,
    /// Cruise interval of the scan.
    pub interval: u32,
}

/// The lowest position that a run-up may begin at: half-way to the home switch.
fn lowest(config: &Config) -> Steps {
    Steps(-i32::try_from(config.clearance_steps() / 2).unwrap_or(0))
}

/// The cruise interval of a speed in µm/s (0 = the configured maximum), or why it cannot be.
pub fn interval_for(config: &Config, speed_um_s: u32) -> Result<u32, Refusal> {
    let speed = if speed_um_s == 0 {
        config.max_speed_um_s
    } else {
        speed_um_s
    };
    if speed > config.max_speed_um_s {
        return Err(Refusal::SpeedTooHigh {
            asked_um_s: speed,
            max_um_s: config.max_speed_um_s,
        });
    }
    let rate = config.step_rate(speed);
    if rate < MIN_STEP_RATE {
        let r = config.steps_per_mm;
        let min = (u64::from(MIN_STEP_RATE) * u64::from(r.denominator) * 1000)
            .div_ceil(u64::from(r.numerator.max(1)));
        return Err(Refusal::SpeedTooLow {
            asked_um_s: speed,
            min_um_s: u32::try_from(min).unwrap_or(u32::MAX),
        });
    }
    Ok(interval_of(rate))
}

/// The profile of a way of `distance` steps at the given cruise interval.
pub fn move_profile(config: &Config, distance: u32, interval: u32) -> Profile {
    Profile::new(Ramp::new(config.acceleration()), distance, interval)
}

impl ScanPlan {
    /// Plans a scan, or says which limit it breaks and by how much. (The gaps between triggers
    /// are judged by [`ScanCheck`], from the compiled words.)
    pub fn new(config: &Config, request: ScanRequest) -> Result<Self, Refusal> {
        let interval = interval_for(config, request.speed_um_s)?;
        let triggers = TriggerPlan::new(
            config.steps_per_mm,
            request.start_um,
            request.spacing_um,
            request.count,
        )?;
        let ramp = Ramp::new(config.acceleration());
        let travel = Steps(i32::try_from(config.travel_steps()).unwrap_or(i32::MAX));
        let (first, last) = (triggers.first(), triggers.last());
        for position in [first, last] {
            if position.0 < 0 || position > travel {
                return Err(Refusal::OutOfTravel {
                    position,
                    min: Steps(0),
                    max: travel,
                });
            }
        }
        let plan = ScanPlan {
            request,
            triggers,
            begin: first,
            pass: None,
            ramp,
            interval,
        };
        let way = |from: i64, to: i64| u32::try_from(to - from).unwrap_or(0);
        let (first, last) = (i64::from(first.0), i64::from(last.0));
        let lowest = lowest(config);
        let run_up =
            i64::try_from(config.steps_per_mm.steps_up(config.run_up_um)).unwrap_or(i64::MAX);
        // The light's clock starts with the first STEP edge.
        let lead = if request.laser == ScanLaser::Timed && config.laser_lead_us > 0 {
            Micros(u64::from(config.laser_lead_us)).to_cycles().0
        } else {
            0
        };
        let dark = u64::from(ramp.time(1)) + EARLIEST.0;
        let (begin, end) = match request.mode {
            ScanMode::StopAndShoot => return Ok(plan),
            ScanMode::Constant => {
                // The length of the ramp, one step of cruise, and more if the laser's lead asks for it.
                let probe = Profile::new(ramp, u32::MAX / 2, interval);
                let r = i64::from(probe.ramp_steps()) + 1;
                let short = if lead > 0 {
                    (lead + dark).saturating_sub(probe.time(probe.ramp_steps()).0)
                } else {
                    0
                };
                let r_lead =
                    r + i64::try_from(short.div_ceil(u64::from(interval))).unwrap_or(i64::MAX / 4);
                (first - run_up.max(r_lead), last + r)
            }
            ScanMode::Ramped => (i64::from(lowest.0).max(first - run_up.max(1)), last),
        };
        let step = |position: i64| {
            Steps(i32::try_from(position).unwrap_or(if position < 0 { i32::MIN } else { i32::MAX }))
        };
        if begin < i64::from(lowest.0) || begin >= first {
            return Err(Refusal::OutOfTravel {
                position: step(begin),
                min: lowest,
                max: travel,
            });
        }
        if end > i64::from(travel.0) {
            return Err(Refusal::OutOfTravel {
                position: step(end),
                min: lowest,
                max: travel,
            });
        }
        let pass = Profile::new(ramp, way(begin, end), interval);
        let available = pass.time(way(begin, first)).0.saturating_sub(dark);
        if lead > available {
            return Err(Refusal::LeadTooLong {
                lead_us: config.laser_lead_us,
                available_us: u32::try_from(Cycles(available).to_micros_down().0)
                    .unwrap_or(u32::MAX),
            });
        }
        Ok(ScanPlan {
            begin: step(begin),
            pass: Some(pass),
            ..plan
        })
    }
}

/// The check of a scan before it moves, in slices.
#[derive(Clone, Copy, Debug)]
pub struct ScanCheck {
    plan: ScanPlan,
    least_gap: Micros,
    /// The way to where the scan begins.
    approach: Option<Check>,
    stage: Stage,
    duration: Micros,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    Pass(Check),
    /// Stop and shoot: the way from one trigger to the next. Only two lengths occur (rounding),
    /// so a length that has been checked is not checked again.
    Hops {
        index: u32,
        known: [Option<(u32, Cycles)>; 2],
        current: Option<Check>,
    },
}

/// Edges looked at in one slice: a fraction of a millisecond of the board's CPU.
pub const SLICE: u32 = 256;

impl ScanCheck {
    /// A check of `plan` from where the slide stands.
    pub fn new(config: &Config, plan: ScanPlan, position: Steps) -> Self {
        let distance = position.0.abs_diff(plan.begin.0);
        let fastest = interval_of(config.step_rate(config.max_speed_um_s));
        let approach =
            (distance > 0).then(|| Check::of_move(move_profile(config, distance, fastest)));
        let stage = match plan.pass {
            Some(profile) => Stage::Pass(Check::of_pass(profile, plan.begin, plan.triggers)),
            None => Stage::Hops {
                index: 1,
                known: [None; 2],
                current: None,
            },
        };
        let rest = if plan.pass.is_some() {
            0
        } else {
            u64::from(config.settle_us)
                + u64::from(config.laser_lead_us)
                + u64::from(config.exposure_us)
        };
        ScanCheck {
            plan,
            least_gap: config.min_trigger_gap(),
            approach,
            stage,
            duration: Micros(rest * u64::from(plan.triggers.count())),
        }
    }

    /// The plan under check.
    pub const fn plan(&self) -> &ScanPlan {
        &self.plan
    }

    /// Checks a slice; the expected duration of the scan once all is checked.
    pub fn run(&mut self) -> Result<Option<Micros>, Refusal> {
        if let Some(check) = &mut self.approach {
            let Some(done) = check.run(SLICE).map_err(Refusal::PlanCheck)? else {
                return Ok(None);
            };
            self.duration = self.duration.after(done.duration.to_micros_up());
            self.approach = None;
            return Ok(None);
        }
        match &mut self.stage {
            Stage::Pass(check) => {
                let Some(done) = check.run(SLICE).map_err(Refusal::PlanCheck)? else {
                    return Ok(None);
                };
                self.judge(&done)?;
                Ok(Some(self.duration.after(done.duration.to_micros_up())))
            }
            Stage::Hops {
                index,
                known,
                current,
            } => {
                if let Some(check) = current {
                    let Some(done) = check.run(SLICE).map_err(Refusal::PlanCheck)? else {
                        return Ok(None);
                    };
                    known.swap(0, 1);
                    known[0] = Some((done.steps, done.duration));
                    *current = None;
                }
                for _ in 0..SLICE {
                    let from = index
                        .checked_sub(1)
                        .and_then(|k| self.plan.triggers.position(k));
                    let (Some(from), Some(to)) = (from, self.plan.triggers.position(*index)) else {
                        return Ok(Some(self.duration));
                    };
                    let distance = from.0.abs_diff(to.0);
                    match known.iter().flatten().find(|(steps, _)| *steps == distance) {
                        Some((_, time)) => {
                            self.duration = self.duration.after(time.to_micros_up());
                            *index += 1;
                        }
                        None => {
                            let profile =
                                Profile::new(self.plan.ramp, distance, self.plan.interval);
                            *current = Some(Check::of_move(profile));
                            break;
                        }
                    }
                }
                Ok(None)
            }
        }
    }

    fn judge(&self, done: &Checked) -> Result<(), Refusal> {
        match done.closest {
            Some((gap, index)) if gap < self.least_gap.to_cycles() => {
                Err(Refusal::TriggersTooClose {
                    index,
                    gap_us: u32::try_from(gap.to_micros_down().0).unwrap_or(u32::MAX),
                    needed_us: u32::try_from(self.least_gap.0).unwrap_or(u32::MAX),
                })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(mode: ScanMode) -> ScanRequest {
        ScanRequest {
            start_um: 10_000,
            spacing_um: 2000,
            count: 100,
            speed_um_s: 20_000,
            mode,
            laser: ScanLaser::Timed,
        }
    }

    fn judge(config: &Config, request: ScanRequest) -> Result<(ScanPlan, Micros), Refusal> {
        let plan = ScanPlan::new(config, request)?;
        let mut check = ScanCheck::new(config, plan, Steps(0));
        loop {
            if let Some(duration) = check.run()? {
                return Ok((plan, duration));
            }
        }
    }

    #[test]
    fn each_mode_stands_with_its_duration() {
        let c = Config::default();
        // 20 mm/s = 16 000 steps/s, 160 000 000 steps/s² … 200 mm/s² = 160 000 steps/s²: ramp 800 steps, 0.1 s.
        let (plan, time) = judge(&c, request(ScanMode::Constant)).unwrap();
        assert_eq!(plan.pass.map(|p| p.ramp_steps()), Some(800));
        assert_eq!(plan.begin, Steps(8000 - 801));
        // Approach of 9 mm at 50 mm/s (triangle of 2·√(9/200) s) and 198 mm of pass at 20 mm/s with 0.1 s of ramps beside.
        let expected = 2.0 * (9.0f64 / 200.0).sqrt() + 198.0 / 20.0 + 0.2;
        assert!(
            (time.0 as f64 * 1e-6 - expected).abs() < 0.02,
            "{time} {expected}"
        );

        let (plan, time) = judge(&c, request(ScanMode::StopAndShoot)).unwrap();
        assert_eq!((plan.begin, plan.pass), (Steps(8000), None));
        // 99 hops of 2 mm: triangles, 2·√(2/200) s each; 100 rests of 107 ms; approach of 10 mm.
        let expected = 99.0 * 2.0 * (2.0f64 / 200.0).sqrt() + 10.7 + 2.0 * (10.0f64 / 200.0).sqrt();
        assert!(
            (time.0 as f64 * 1e-6 - expected).abs() < 0.02,
            "{time} {expected}"
        );

        let (plan, _) = judge(&c, request(ScanMode::Ramped)).unwrap();
        assert_eq!(plan.begin, Steps(8000 - 400));
    }

    #[test]
    fn each_limit_is_named_with_its_numbers() {
        let c = Config::default();
        let r = request(ScanMode::Constant);
        let refusal = |r| judge(&c, r).map(|_| ()).unwrap_err();
        assert_eq!(
            refusal(ScanRequest {
                speed_um_s: 60_000,
                ..r
            }),
            Refusal::SpeedTooHigh {
                asked_um_s: 60_000,
                max_um_s: 50_000
            }
        );
        assert_eq!(
            refusal(ScanRequest {
                speed_um_s: 50,
                ..r
            }),
            Refusal::SpeedTooLow {
                asked_um_s: 50,
                min_um_s: 75
            }
        );
        assert_eq!(
            refusal(ScanRequest { count: 147, ..r }),
            Refusal::OutOfTravel {
                position: Steps(800 * 302),
                min: Steps(0),
                max: Steps(240_000)
            }
        );
        // The last trigger fits, the ramp after it does not.
        assert_eq!(
            refusal(ScanRequest { count: 146, ..r }),
            Refusal::OutOfTravel {
                position: Steps(240_801),
                min: Steps(-400),
                max: Steps(240_000)
            }
        );
        assert_eq!(
            refusal(ScanRequest { start_um: 0, ..r }),
            Refusal::OutOfTravel {
                position: Steps(-801),
                min: Steps(-400),
                max: Steps(240_000)
            }
        );
        // 320 steps of 7813 cycles (16 000 steps/s in whole cycles); pulse and frame need 20 100 µs.
        assert!(matches!(
            refusal(ScanRequest {
                spacing_um: 400,
                ..r
            }),
            Refusal::TriggersTooClose {
                gap_us: 20_001,
                needed_us: 20_100,
                ..
            }
        ));
        assert_eq!(
            refusal(ScanRequest { spacing_um: 1, ..r }),
            Refusal::SpacingTooFine {
                spacing_um: 1,
                min_um: 2
            }
        );
        assert!(matches!(
            refusal(ScanRequest { count: 0, ..r }),
            Refusal::Count { count: 0, .. }
        ));
        let c = Config {
            laser_lead_us: 80_000,
            ..c
        };
        // 0.5 mm of run-up at 200 mm/s² take 70.711 ms, the first of its 400 steps 3.536 ms.
        assert!(matches!(
            judge(&c, request(ScanMode::Ramped)).map(|_| ()),
            Err(Refusal::LeadTooLong {
                lead_us: 80_000,
                available_us: 67_174
            })
        ));
        // At constant speed, the run-up grows instead.
        let c = Config {
            laser_lead_us: 180_000,
            ..c
        };
        let (plan, _) = judge(&c, r).unwrap();
        assert!(
            plan.pass
                .is_some_and(|p| (p.time(8000 - plan.begin.0 as u32).0 - p.time(1).0)
                    > Micros(180_000).to_cycles().0)
        );
    }
}
