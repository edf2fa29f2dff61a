//! `cannula completions SHELL` and `cannula man --out DIR`, from the same description of the
//! commands that parses them.

use super::Output;
use crate::output::write_whole;
use clap::Command;
use serde_json::json;
use std::path::PathBuf;

/// Arguments of `completions`.
#[derive(clap::Args, Debug)]
pub struct CompletionArgs {
    /// For which shell.
    shell: clap_complete::Shell,
}

/// Arguments of `man`.
#[derive(clap::Args, Debug)]
pub struct ManArgs {
    /// The folder to write cannula.1 and a page for each command into.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints a completion script.
pub fn completions(args: &CompletionArgs, out: &Output) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::command(), "cannula", &mut script);
    let script = String::from_utf8(script)?;
    let object = json!({ "shell": args.shell.to_string(), "script": script });
    out.result(&object, || script.trim_end().to_owned())
}

/// Writes the pages.
pub fn man(args: &ManArgs, out: &Output) -> anyhow::Result<()> {
    let mut command = super::command();
    command.build();
    let mut written = Vec::new();
    pages(&command, &args.out, &mut written)?;
    out.result(&json!({ "files": written }), || {
        format!(
            "{} pages written: man {}",
            written.len(),
            args.out.join("cannula.1").display()
        )
    })
}

fn pages(
    command: &Command,
    folder: &std::path::Path,
    written: &mut Vec<PathBuf>,
) -> anyhow::Result<()> {
    let name = command
        .get_display_name()
        .unwrap_or(command.get_name())
        .to_owned();
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    let path = folder.join(format!("{name}.1"));
    write_whole(&path, |w| w.write_all(&page))?;
    written.push(path);
    for sub in command.get_subcommands().filter(|s| s.get_name() != "help") {
        pages(sub, folder, written)?;
    }
    Ok(())
}
