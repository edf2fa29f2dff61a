//! The motion board: found, of this version, sound inputs, a quick link, its configuration taken.

use super::{Check, Checks, State};
use crate::rig::config::Rig;
use crate::rig::link::{Board, LinkError, identity_words};
use crate::rig::open::OpenError;
use cannula_shared::hello::ResetReason;
use cannula_shared::message;

/// Questions asked to time the link.
const QUESTIONS: usize = 50;
/// A slower answer, at worst, endangers the laser's lease, ms.
const SLOW_MS: f64 = 50.0;

/// No board to look at.
pub fn not_connected(e: &OpenError) -> Check {
    let remedy = match e {
        OpenError::Link(LinkError::Open { source, .. })
            if source.kind() == std::io::ErrorKind::PermissionDenied =>
        {
            "join the group that owns the port: sudo usermod -aG dialout $USER, then log in anew"
        }
        OpenError::Link(LinkError::Open { .. }) => {
            "`cannula ports` lists the ports; close any other program that has it open"
        }
        OpenError::Link(LinkError::NoHello { .. }) => {
            "flash Cannula's firmware (firmware/README.md), or give the right --port"
        }
        OpenError::Link(LinkError::Version { .. } | LinkError::Schema { .. }) => {
            "flash the firmware of this version: `cannula uf2`, firmware/README.md"
        }
        OpenError::Port(_) => {
            "plug it in and look at `cannula ports`; a charge-only USB cable shows nothing; --port simulated tries without one"
        }
        _ => "unplug it, plug it in again, and look at `cannula ports`",
    };
    let mut c = Checks::new("board");
    c.wrong("connection", e.to_string(), remedy);
    c.list.remove(0)
}

/// Looks at a board that has answered.
pub fn board(board: &Board, port: &str, rig: &Rig) -> Vec<Check> {
    let mut c = Checks::new("board");
    let hello = board.hello();
    let (identity, firmware) = identity_words(&hello.identity);
    c.good("connection", format!("{port}: board {identity}"));
    let ours = env!("CARGO_PKG_VERSION");
    let found = format!(
        "firmware {firmware}, protocol {}, schema {:016x}",
        hello.protocol, hello.schema
    );
    // Protocol and schema agree, or there would be no session.
    if firmware == ours {
        c.good("firmware", found);
    } else {
        c.weak(
            "firmware",
            format!("{found}; this program is {ours}"),
            "flash the firmware that belongs to this version (firmware/README.md)",
        );
    }
    let start = hello.reset.to_string();
    match hello.reset {
        ResetReason::Watchdog | ResetReason::Panic => c.weak(
            "last start",
            start,
            "its program had failed before: report what it was doing; check its supply",
        ),
        _ => c.good("last start", start),
    }
    match board.status() {
        Ok(status) => self::status(&status, &mut c),
        Err(e) => {
            c.wrong("state", e.to_string(), "unplug the board, plug it in again");
            return c.list;
        }
    }
    link(board, &mut c);
    match board.configure(&rig.board_config(rig.camera.exposure_board_ms)) {
        Ok(_) => c.good("configuration", "the board has taken it".to_owned()),
        Err(e) => c.wrong(
            "configuration",
            e.to_string(),
            "mend what it names; a board in fault takes none before `cannula motion rearm`",
        ),
    }
    c.list
}

fn status(status: &message::Status, c: &mut Checks) {
    use message::State as Doing;
    match &status.state {
        Doing::Fault(fault) => c.wrong(
            "state",
            format!("in fault: {fault}"),
            "mend the cause, then `cannula motion rearm`",
        ),
        Doing::Homing | Doing::Scanning | Doing::Stopping => c.weak(
            "state",
            "it moves".to_owned(),
            "another program was driving it: end that one",
        ),
        Doing::Boot | Doing::Idle | Doing::Ready => c.good(
            "state",
            if status.position_known {
                "at rest, position known".to_owned()
            } else {
                "at rest, position not known yet: homing comes first".to_owned()
            },
        ),
    }
    if status.laser {
        c.wrong(
            "laser",
            "it is on, and nobody here asked for it".to_owned(),
            "end the other program; `cannula motion stop` turns it off",
        );
    } else {
        c.good("laser", "off".to_owned());
    }
    inputs(&status.inputs, c);
}

/// Switches are normally closed to ground: a broken wire reads as reached, open or pressed.
fn inputs(i: &message::Inputs, c: &mut Checks) {
    let mut sound = true;
    let mut say = |on: bool, state: State, found: &str, remedy: &str| {
        if on {
            sound = false;
            c.add(state, "inputs", found.to_owned(), remedy);
        }
    };
    say(
        i.estop,
        State::Wrong,
        "emergency stop is pressed, or not wired",
        "release it; with none, join GP12 to ground",
    );
    say(
        i.interlock,
        State::Wrong,
        "the interlock is open, or not wired: the laser can't light",
        "close it; with none, join GP13 to ground",
    );
    say(
        i.home && i.limit,
        State::Wrong,
        "home and far switch both say reached",
        "one wire is broken or missing (GP10, GP11): switches close to ground while free",
    );
    say(
        i.limit && !i.home,
        State::Weak,
        "the far switch says reached",
        "move the slide off it by hand (`cannula motion release`), or mend its wire (GP11)",
    );
    if sound {
        let home = if i.home { ", at the home switch" } else { "" };
        c.good(
            "inputs",
            format!("emergency stop and interlock closed{home}"),
        );
    }
}

/// Times questions and looks for damaged frames.
fn link(board: &Board, c: &mut Checks) {
    let mut times = Vec::new();
    for _ in 0..QUESTIONS {
        let began = board.now();
        if let Err(e) = board.status() {
            c.wrong(
                "link",
                e.to_string(),
                "try another cable and another USB port",
            );
            return;
        }
        times.push(board.now().since(began).0 as f64 * 1e-3);
    }
    times.sort_by(f64::total_cmp);
    let at = |k: usize| times.get(k).copied().unwrap_or(f64::NAN);
    let counts = board.counts();
    let found = format!(
        "an answer takes {:.1} ms, {:.1} ms at worst; {} damaged frames, {} commands repeated",
        at(times.len() / 2),
        at(times.len().saturating_sub(1)),
        counts.bad,
        counts.repeated
    );
    if at(times.len().saturating_sub(1)) > SLOW_MS || counts.bad > 0 || counts.repeated > 0 {
        c.weak(
            "link",
            found,
            "try another cable, no hub, and less load on this machine",
        );
    } else {
        c.good("link", found);
    }
}
