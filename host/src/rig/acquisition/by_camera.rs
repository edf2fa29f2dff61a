//! Stills and sweeps with a camera that the board does not trigger (by command, or running by
//! itself): position by position, and each takes a frame that cannot have begun before everything
//! stood ready there ([`super::super::request`]). What cannot be told is named and left out.

use super::{AcquireError, Acquisition, SLICE, Shot, Sink, Sweep, TRIES, frame_stamp};
use crate::rig::camera::Picture;
use crate::rig::config::TriggerSource;
use crate::rig::link::LinkError;
use crate::rig::matching::Fault;
use crate::rig::request::{Requests, Verdict};
use cannula_shared::message::{ScanLaser, ScanRequest, Trigger};
use cannula_shared::plan::TriggerPlan;
use cannula_shared::units::{Micros, Steps};
use std::time::Duration;

/// From this try on the camera is armed anew first: what it still owes is then discarded.
const REARM_FROM: u32 = 2;
/// How long frames that may have begun too early are passed over, beside the time-out: until a
/// camera that runs by itself is armed anew, its bounds are early by the time that its stream took to start.
const PASS_OVER: Micros = Micros(5_000_000);

/// A frame for a request, and when it can have begun at the earliest.
struct Served {
    picture: Picture,
    not_before_us: i64,
    tries: u32,
}

impl Acquisition<'_> {
    fn by_command(&self) -> bool {
        self.rig.camera.trigger == TriggerSource::Software
    }

    fn host_us(&self) -> i64 {
        self.board.now().0 as i64
    }

    /// A picture at rest, where the slide stands, and the tries that it took.
    pub(super) fn still_by_camera(
        &mut self,
        index: u32,
        laser: bool,
        faults: &mut Vec<Fault>,
    ) -> Result<(Shot, u32), AcquireError> {
        let stands = self.board.status()?;
        if laser {
            self.board.laser(true)?;
            self.rest(self.rig.laser.lead_ms)?;
        }
        let since = self.host_us();
        let served = self.serve(since, index, faults);
        // Why there was no frame comes first.
        let status = self.board.status();
        let off = if laser {
            self.board.laser(false)
        } else {
            Ok(())
        };
        let served = served?;
        let status = status?;
        off?;
        if laser && !status.laser {
            return Err(AcquireError::Dark(index));
        }
        // Back from the board's time of this status by the host's clock.
        let ago = self.host_us() - served.not_before_us;
        let time = status.uptime.0.saturating_sub(ago.max(0) as u64);
        let trigger = Trigger {
            job: 0,
            index,
            position: stands.position,
            time: Micros(time.max(stands.uptime.0)),
            laser,
        };
        Ok((self.shot(index, &trigger, served.picture), served.tries))
    }

    /// A whole frame that cannot have begun before `since`.
    fn serve(
        &mut self,
        since: i64,
        index: u32,
        faults: &mut Vec<Fault>,
    ) -> Result<Served, AcquireError> {
        let mut came = false;
        for tries in 1..=TRIES {
            self.go_on()?;
            if tries > REARM_FROM || self.requests.is_none() {
                self.arm()?;
            }
            let before = self.host_us();
            if let (Some(camera_us), Some(requests)) = (self.camera.clock_us(), &mut self.requests)
            {
                requests.clock(camera_us, before);
            }
            // What waits there counts, too.
            while let Some(served) = self.look(Duration::ZERO, since, index, faults)? {
                if let Some(served) = served {
                    return Ok(Served { tries, ..served });
                }
            }
            let began = self.board.now();
            let named = faults.len();
            let Some(requests) = &mut self.requests else {
                continue;
            };
            requests.command(began.0 as i64);
            self.camera.fire()?;
            let mut quiet = began;
            let timeout = Micros(self.timeout().as_micros() as u64);
            loop {
                self.go_on()?;
                let looked = self.look(SLICE, since, index, faults)?;
                let now = self.board.now();
                match looked {
                    Some(Some(served)) => return Ok(Served { tries, ..served }),
                    Some(None) => {
                        came = true;
                        quiet = now;
                    }
                    None => {}
                }
                let armed = self.requests.is_some();
                if !armed
                    || now.since(quiet) >= timeout
                    || now.since(began).0 >= timeout.0 + PASS_OVER.0
                {
                    break;
                }
                self.board.keep_alive()?;
            }
            if faults.len() == named {
                faults.push(Fault::Lost { trigger: index });
            }
        }
        let camera = self.camera.description();
        Err(if came {
            AcquireError::Untold(camera)
        } else {
            AcquireError::NoFrames {
                tries: TRIES,
                camera,
            }
        })
    }

    fn arm(&mut self) -> Result<(), AcquireError> {
        if let Some(exposure) = self.armed {
            let now = self.host_us();
            self.camera.arm(&exposure)?;
            self.requests = Some(Requests::armed(now, self.by_command()));
        }
        Ok(())
    }

    /// The next frame within `wait`: `None` if none came, `Some(None)` if it does not serve.
    fn look(
        &mut self,
        wait: Duration,
        since: i64,
        index: u32,
        faults: &mut Vec<Fault>,
    ) -> Result<Option<Option<Served>>, AcquireError> {
        let Some(frame) = self.camera.wait(wait)? else {
            return Ok(None);
        };
        let now = self.host_us();
        let Some(requests) = &mut self.requests else {
            return Ok(Some(None));
        };
        let stamp = frame_stamp(&frame);
        let sequence = frame.sequence;
        match (requests.frame(&stamp, now), frame.picture) {
            (Verdict::NotBefore(bound), Some(picture)) if bound >= since => {
                return Ok(Some(Some(Served {
                    picture,
                    not_before_us: bound,
                    tries: 0,
                })));
            }
            (Verdict::NotBefore(bound), None) if bound >= since => {
                faults.push(Fault::Broken {
                    trigger: index,
                    sequence,
                });
            }
            // Of a camera that runs by itself most frames are of before: no fault.
            (Verdict::NotBefore(_), _) if !self.by_command() => {}
            (Verdict::NotBefore(bound), _) => faults.push(Fault::Before {
                trigger: index,
                sequence,
                by_ms: (since - bound) as f64 / 1000.0,
            }),
            (Verdict::Again, _) => faults.push(Fault::Double {
                trigger: index,
                sequence,
            }),
            (Verdict::Contradiction, _) => {
                faults.push(Fault::Stray { sequence });
                self.requests = None;
            }
        }
        Ok(Some(None))
    }

    /// Visits positions of a sweep (by their index) one by one and takes a picture at rest at each,
    /// whatever the sweep's mode. One that gives none is named and left out.
    pub fn visit(
        &mut self,
        request: &ScanRequest,
        indices: &[u32],
        sink: &mut Sink,
    ) -> Result<Sweep, AcquireError> {
        let mut sweep = Sweep {
            planned: indices.len() as u32,
            ..Sweep::default()
        };
        self.visit_into(request, indices, &mut sweep, false, sink)?;
        Ok(sweep)
    }

    /// As [`Self::visit`], for a sweep under way; `again` if each has been visited before.
    pub(super) fn visit_into(
        &mut self,
        request: &ScanRequest,
        indices: &[u32],
        sweep: &mut Sweep,
        again: bool,
        sink: &mut Sink,
    ) -> Result<(), AcquireError> {
        let steps_per_mm = self.rig.board_config(1.0).steps_per_mm;
        let plan = TriggerPlan::new(
            steps_per_mm,
            request.start_um,
            request.spacing_um,
            request.count,
        )
        .map_err(|e| LinkError::Unexpected(format!("no such plan: {e:?}")))?;
        let positions: Vec<Steps> = plan.positions().collect();
        let laser = request.laser != ScanLaser::Off;
        let by_board = self.rig.camera.trigger == TriggerSource::Board;
        for &index in indices {
            let Some(&position) = positions.get(index as usize) else {
                continue;
            };
            self.go_on()?;
            self.board.move_to(position, 0)?;
            self.rest(self.rig.board.settle_ms)?;
            let told = if by_board {
                self.still(index, laser).map(|shot| (shot, 1))
            } else {
                self.still_by_camera(index, laser, &mut sweep.faults)
            };
            match told {
                Ok((shot, tries)) => {
                    if again || tries > 1 {
                        sweep.reshot.push(index);
                    }
                    sweep.shots += 1;
                    sink(shot)?;
                }
                Err(AcquireError::NoFrames { .. } | AcquireError::Untold(_)) => {
                    let lost = Fault::Lost { trigger: index };
                    if by_board && !again {
                        sweep.faults.push(lost);
                    }
                    sweep.missing.push(index);
                }
                Err(e) => return Err(e),
            }
        }
        sweep.faults.dedup();
        Ok(())
    }
}
