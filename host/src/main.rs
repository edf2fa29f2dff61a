//! The `cannula` command; see [`cannula::cli`].
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(cannula::cli::main(std::env::args_os()))
}
