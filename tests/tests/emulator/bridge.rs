//! The host's real serial code and its command against the shipped ELF: `bridge.mjs` shows the
//! emulated board's USB as a serial port. Needs socat; says `skipped:no-socat` where it is missing.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use cannula::rig::link::Board;
use cannula_shared::message::{ScanLaser, ScanMode};
use cannula_shared::units::{Steps, StepsPerMm};

use crate::Outcome;
use crate::emulator;
use crate::rig::{config, nearest_step, on_the_fly};

struct Bridge(Child);

impl Drop for Bridge {
    fn drop(&mut self) {
        // Its own end, so that socat and the links go as well.
        let _ = Command::new("kill").arg(self.0.id().to_string()).status();
        let _ = self.0.wait();
    }
}

#[test]
fn the_serial_port_of_the_real_binary() -> Outcome {
    let Some((elf, folder)) = emulator::find() else {
        return Ok(());
    };
    if Command::new("socat").arg("-V").output().is_err() {
        assert!(
            std::env::var_os("CANNULA_REQUIRE_EMULATOR").is_none_or(|v| v != "1"),
            "socat is required here"
        );
        println!("skipped:no-socat");
        return Ok(());
    }
    let place = tempfile::tempdir()?;
    let link = place.path().join("board");
    let mut bridge = Bridge(
        Command::new("node")
            .arg(folder.join("bridge.mjs"))
            .arg(elf)
            .arg(&link)
            .stdout(Stdio::piped())
            .spawn()?,
    );
    let mut lines = BufReader::new(bridge.0.stdout.take().expect("piped")).lines();
    let mut ready = || -> Outcome {
        let line = lines.next().expect("the bridge goes on")?;
        assert!(line.starts_with("ready"), "{line}");
        Ok(())
    };
    ready()?;
    let port = link.to_str().expect("plain");

    let ratio = StepsPerMm::whole(800);
    let board = Board::connect(port)?;
    board.configure(&config(ratio, 100_000, 2_000_000))?;
    assert_eq!(board.home()?.position, Steps(0));
    let mut positions = Vec::new();
    let request = on_the_fly(10_000, 2_000, 8, ScanMode::Constant, ScanLaser::Timed);
    let summary = board.scan(&request)?.run(|event| {
        if let cannula::rig::link::ScanEvent::Trigger(t) = event {
            positions.push(i64::from(t.position.0));
        }
    })?;
    assert_eq!(summary.fired, 8);
    let planned: Vec<i64> = (0..8)
        .map(|k| nearest_step(ratio, 10_000 + 2_000 * k))
        .collect();
    assert_eq!(positions, planned);
    drop(board);

    // A second client, on a terminal of its own, as the command: it finds the board as it was left.
    ready()?;
    let words = ["cannula", "--quiet", "motion", "--port", port, "status"];
    let status = cannula::cli::main(words.map(std::ffi::OsString::from));
    assert_eq!(status, 0, "cannula motion status");
    Ok(())
}
