//! The program as a process of its own: this test binary started again, running the command line.

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Where the arguments of the started program stand, a line each.
const ARGUMENTS: &str = "CANNULA_TEST_ARGUMENTS";

/// To be called by a test of the name `the_program` in every binary that uses [`start`]: does
/// nothing in an ordinary run, and becomes the program in a started one.
pub fn become_it() {
    if let Ok(arguments) = std::env::var(ARGUMENTS) {
        let words = ["cannula"].into_iter().chain(arguments.lines());
        std::process::exit(cannula::cli::main(words.map(Into::into)).into());
    }
}

/// Starts the program with these arguments; what it says is kept.
pub fn start(arguments: &[&str]) -> Child {
    let program = std::env::current_exe().expect("this test has a file");
    begin(Command::new(program), arguments)
}

fn begin(mut program: Command, arguments: &[&str]) -> Child {
    program
        .args(["the_program", "--exact", "--nocapture", "--test-threads=1"])
        .env(ARGUMENTS, arguments.join("\n"))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts")
}

/// Starts the program where no file may grow beyond so many bytes: writing then fails as on a full disk,
/// without one. `None` where the system has no prlimit.
pub fn start_limited(arguments: &[&str], bytes: u64) -> Option<Child> {
    if Command::new("prlimit").arg("--version").output().is_err() {
        println!("skipped:no-prlimit");
        return None;
    }
    // Without the trap the system ends a program that goes on writing.
    let limited = "trap '' XFSZ; exec prlimit --fsize=\"$0\" \"$@\"";
    let mut command = Command::new("sh");
    command
        .args(["-c", limited, &bytes.to_string()])
        .arg(std::env::current_exe().expect("this test has a file"));
    Some(begin(command, arguments))
}

/// How the program ended.
#[derive(Debug)]
pub struct Ended {
    /// Exit status; `None` if a signal ended it.
    pub status: Option<i32>,
    /// Standard output, with the test harness's lines around it.
    pub out: String,
    /// Standard error.
    pub said: String,
}

/// Runs it to its end: exit status and what it said on standard error.
pub fn run(arguments: &[&str]) -> (Option<i32>, String) {
    wait(start(arguments), Duration::from_secs(300))
}

/// Sends a signal (`INT`, `TERM`, `KILL`).
pub fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill")
        .args([format!("-{name}"), child.id().to_string()])
        .status()
        .expect("there is kill");
    assert!(sent.success());
}

/// Waits for the end within `limit`: exit status and what it said on standard error.
pub fn wait(child: Child, limit: Duration) -> (Option<i32>, String) {
    let ended = wait_output(child, limit);
    (ended.status, ended.said)
}

/// The same with standard output.
pub fn wait_output(mut child: Child, limit: Duration) -> Ended {
    let began = Instant::now();
    // Read while it runs: what it says may be more than a pipe holds.
    let out = reader(child.stdout.take());
    let said = reader(child.stderr.take());
    let mut cut = false;
    let status = loop {
        match child.try_wait().expect("a child") {
            Some(status) => break status,
            None if began.elapsed() > limit => {
                cut = true;
                let _ = child.kill();
                break child.wait().expect("a child");
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let text = |reader: JoinHandle<Vec<u8>>| {
        String::from_utf8_lossy(&reader.join().expect("it reads")).into_owned()
    };
    let (out, said) = (text(out), text(said));
    assert!(!cut, "it did not end within {limit:?}: {said}");
    assert!(!said.contains("panicked"), "{said}");
    Ended {
        status: status.code(),
        out,
        said,
    }
}

fn reader(pipe: Option<impl Read + Send + 'static>) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut all = Vec::new();
        if let Some(mut pipe) = pipe {
            let _ = pipe.read_to_end(&mut all);
        }
        all
    })
}

/// Every image below `folder` can be decoded, nothing half-written lies about, and a session.json
/// that stands is sound. Gives the number of images.
pub fn whole(folder: &Path) -> usize {
    let mut images = 0;
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("a folder's entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            images += whole(&path);
        } else if name.ends_with(".png") {
            cannula::session::decode(&path).unwrap_or_else(|e| panic!("{e}"));
            images += 1;
        } else if name == "session.json" {
            cannula::session::Session::open(folder).unwrap_or_else(|e| panic!("{e}"));
        } else {
            // Beside the images of a sweep that was broken off; of whoever records.
            let known = ["progress.jsonl", ".lock"].contains(&&*name);
            assert!(known, "{} lies about", path.display());
        }
    }
    images
}
