//! What may be, as pure functions of state and inputs.

use cannula_shared::error::Fault;
use cannula_shared::message::{Inputs, State};

/// Who wants the laser on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaserWish {
    /// Nobody.
    Off,
    /// The user, by command.
    Hand,
    /// The running scan.
    Scan,
}

/// Whether the laser may be on.
///
/// Only if the emergency stop is not pressed, the interlock closed and the host alive; then in a
/// scan that wants it, or by hand at rest. Every other combination is off.
pub const fn laser_permitted(
    state: State,
    inputs: Inputs,
    host_alive: bool,
    moving: bool,
    wish: LaserWish,
) -> bool {
    if inputs.estop || inputs.interlock || !host_alive {
        return false;
    }
    match (state, wish) {
        (State::Scanning, LaserWish::Scan) => true,
        (State::Idle | State::Ready, LaserWish::Hand) => !moving,
        _ => false,
    }
}

/// The fault that the inputs (levels and what was latched since) mean in this state, if any.
///
/// Emergency stop and interlock count in every state but boot (nothing is on yet) and fault
/// (which is latched). The switches count once the slide has been homed: before, it may stand
/// on either.
pub const fn fault_of(state: State, inputs: Inputs) -> Option<Fault> {
    match state {
        State::Boot | State::Fault(_) => None,
        _ if inputs.estop => Some(Fault::EStop),
        _ if inputs.interlock => Some(Fault::Interlock),
        State::Ready | State::Scanning if inputs.limit => Some(Fault::Limit),
        State::Ready | State::Scanning if inputs.home => Some(Fault::HomeSwitch),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    const STATES: [State; 8] = [
        State::Boot,
        State::Idle,
        State::Homing,
        State::Ready,
        State::Scanning,
        State::Stopping,
        State::Fault(Fault::EStop),
        State::Fault(Fault::LedgerFull { index: 3 }),
    ];

    fn all_inputs() -> impl Iterator<Item = Inputs> {
        (0..32u8).map(|bits| Inputs {
            home: bits & 1 != 0,
            limit: bits & 2 != 0,
            estop: bits & 4 != 0,
            interlock: bits & 8 != 0,
            exposure: bits & 16 != 0,
        })
    }

    /// The whole table: 8 states × 32 inputs × host × moving × 3 wishes. The rows that permit are
    /// listed; every other one must not.
    #[test]
    fn the_lasers_whole_table() {
        let mut rows = 0;
        let mut permitted = Vec::new();
        for state in STATES {
            for inputs in all_inputs() {
                for (host, moving) in [(false, false), (false, true), (true, false), (true, true)] {
                    for wish in [LaserWish::Off, LaserWish::Hand, LaserWish::Scan] {
                        rows += 1;
                        if laser_permitted(state, inputs, host, moving, wish) {
                            permitted.push((state, inputs, host, moving, wish));
                        }
                    }
                }
            }
        }
        assert_eq!(rows, 8 * 32 * 4 * 3);
        // Free inputs that do not matter: home, limit, exposure.
        let mut expected = Vec::new();
        for inputs in all_inputs().filter(|i| !i.estop && !i.interlock) {
            expected.push((State::Idle, inputs, true, false, LaserWish::Hand));
            expected.push((State::Ready, inputs, true, false, LaserWish::Hand));
            expected.push((State::Scanning, inputs, true, false, LaserWish::Scan));
            expected.push((State::Scanning, inputs, true, true, LaserWish::Scan));
        }
        assert_eq!(permitted.len(), expected.len());
        assert!(expected.iter().all(|row| permitted.contains(row)));
    }

    #[test]
    fn the_faults_whole_table() {
        for state in STATES {
            for inputs in all_inputs() {
                let fault = fault_of(state, inputs);
                let live = !matches!(state, State::Boot | State::Fault(_));
                let homed = matches!(state, State::Ready | State::Scanning);
                let expected = if !live {
                    None
                } else if inputs.estop {
                    Some(Fault::EStop)
                } else if inputs.interlock {
                    Some(Fault::Interlock)
                } else if homed && inputs.limit {
                    Some(Fault::Limit)
                } else if homed && inputs.home {
                    Some(Fault::HomeSwitch)
                } else {
                    None
                };
                assert_eq!(fault, expected, "{state:?} {inputs:?}");
                // Whatever faults, the laser is off in the state that follows.
                if let Some(fault) = fault {
                    for wish in [LaserWish::Hand, LaserWish::Scan] {
                        assert!(!laser_permitted(
                            State::Fault(fault),
                            Inputs::NONE,
                            true,
                            false,
                            wish
                        ));
                    }
                }
            }
        }
    }
}
