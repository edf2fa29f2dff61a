//! What a command says: results to standard output, everything else to standard error.

use crate::progress::Progress;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Options that every command takes.
#[derive(clap::Args, Debug)]
pub struct Options {
    /// Print the result object as JSON to standard output, and nothing else there.
    #[arg(long, global = true)]
    json: bool,
    /// Say nothing but errors.
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more: what each stage did and how long it took; twice for every setting as well.
    #[arg(long, short, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Threads to work on (all cores if not given).
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl Options {
    /// Makes the thread pool of the asked size.
    pub(super) fn apply(&self) -> anyhow::Result<()> {
        if let Some(n) = self.threads {
            // Fails only if a pool stands already (tests in one process): that one is used then.
            let _ = rayon::ThreadPoolBuilder::new()
                .num_threads(n.into())
                .build_global();
        }
        Ok(())
    }
}

/// An argument that clap could not know to be wrong: exit status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadArgument(pub String);

/// Where a command speaks.
pub struct Output {
    /// The result object is printed as JSON.
    pub json: bool,
    /// Nothing but errors.
    pub quiet: bool,
    /// How much more to say.
    pub verbose: u8,
    bar: Mutex<Option<ProgressBar>>,
    stage: Mutex<Option<Stage>>,
}

/// The stage under way, for `-v`.
struct Stage {
    name: String,
    done: usize,
    of: usize,
    began: Instant,
}

impl Output {
    /// As the options ask.
    pub fn new(options: &Options) -> Self {
        Self {
            json: options.json,
            quiet: options.quiet,
            verbose: options.verbose,
            bar: Mutex::new(None),
            stage: Mutex::new(None),
        }
    }

    /// Prints the result object if `--json` was given, else what `text` says (unless quiet).
    pub fn result(
        &self,
        object: &impl serde::Serialize,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        let line = if self.json {
            serde_json::to_string_pretty(object)?
        } else if self.quiet {
            return Ok(());
        } else {
            text()
        };
        // A reader that closed the pipe has what it wanted.
        match writeln!(std::io::stdout().lock(), "{line}") {
            Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e.into()),
            _ => Ok(()),
        }
    }

    /// A line for the user, on standard error, unless quiet.
    pub fn say(&self, line: &str) {
        if !self.quiet {
            self.line(line);
        }
    }

    /// A line for the curious (-v).
    pub fn detail(&self, line: &str) {
        if self.verbose > 0 {
            self.line(line);
        }
    }

    /// One sentence on standard error: what failed, and each cause after a colon.
    pub fn error(&self, e: &anyhow::Error) {
        let mut sentence = String::new();
        for cause in e.chain() {
            let cause = cause.to_string().replace(['\n', '\r'], " ");
            // Errors that print their source themselves would say it twice.
            if !sentence.ends_with(&cause) && !sentence.contains(&cause) {
                if !sentence.is_empty() {
                    sentence.push_str(": ");
                }
                sentence.push_str(&cause);
            }
        }
        let name = console::style("cannula:").for_stderr().red().bold();
        self.line(&format!("{name} {sentence}"));
    }

    fn line(&self, line: &str) {
        let print = || {
            let _ = writeln!(std::io::stderr().lock(), "{line}");
        };
        match self.bar.lock().ok().as_deref() {
            Some(Some(bar)) => bar.suspend(print),
            _ => print(),
        }
    }
}

impl Progress for Output {
    fn start(&self, stage: &str, steps: usize) {
        if let Ok(mut place) = self.stage.lock() {
            *place = Some(Stage {
                name: stage.to_owned(),
                done: 0,
                of: steps,
                began: Instant::now(),
            });
        }
        if self.quiet || !std::io::stderr().is_terminal() {
            return;
        }
        let bar = ProgressBar::with_draw_target(
            Some(steps as u64),
            ProgressDrawTarget::stderr_with_hz(10),
        );
        let rate = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = match state.per_sec() {
                slow if slow < 10.0 => write!(out, "{slow:.1}"),
                fast => write!(out, "{fast:.0}"),
            };
        };
        // Nothing is known of the rest before the first step.
        let left = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = match state.pos() {
                0 => write!(out, "–"),
                _ => write!(out, "{}", HumanDuration(state.eta())),
            };
        };
        if let Ok(style) =
            ProgressStyle::with_template("{msg:22} {bar:24} {pos}/{len}  {rate}/s  {left} left")
        {
            bar.set_style(style.with_key("rate", rate).with_key("left", left));
        }
        bar.set_message(stage.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        if let Ok(mut place) = self.bar.lock()
            && let Some(old) = place.replace(bar)
        {
            old.finish_and_clear();
        }
    }

    fn step(&self) {
        if let Ok(Some(stage)) = self.stage.lock().as_deref_mut() {
            stage.done += 1;
        }
        if let Ok(Some(bar)) = self.bar.lock().as_deref() {
            bar.inc(1);
        }
    }

    fn finish(&self) {
        if let Ok(mut place) = self.bar.lock()
            && let Some(bar) = place.take()
        {
            bar.finish_and_clear();
        }
        if let Ok(Some(stage)) = self.stage.lock().map(|mut place| place.take()) {
            let seconds = stage.began.elapsed().as_secs_f64();
            self.detail(&format!(
                "{}: {} of {} in {seconds:.2} s ({:.0} a second)",
                stage.name,
                stage.done,
                stage.of,
                stage.done as f64 / seconds.max(1e-9)
            ));
        }
    }

    fn warn(&self, message: &str) {
        let word = console::style("warning:").for_stderr().yellow().bold();
        self.say(&format!("{word} {message}"));
    }
}
