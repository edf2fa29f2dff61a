//! `cannula ports`: the serial ports, and what each motion board says of itself.

use super::{BadArgument, Output};
use crate::rig::link::{self, Board, PortDescription};
use crate::rig::open::SIMULATED;
use serde_json::{Value, json};

/// Arguments of the command.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Ask at every port for a board, not only where the USB name says so.
    #[arg(long)]
    all: bool,
    /// Ask at this port only, listed or not (a simulated board's is not).
    #[arg(long, value_name = "PATH", conflicts_with = "all")]
    port: Option<String>,
}

/// Runs the command.
pub fn run(args: Args, out: &Output) -> anyhow::Result<()> {
    let mut lines = Vec::new();
    let mut found: Vec<Value> = Vec::new();
    let mut ports = link::ports()?;
    if let Some(path) = &args.port {
        if [SIMULATED, "auto"].contains(&path.as_str()) {
            return Err(BadArgument(format!(
                "--port {path}: give a port’s path; without --port the boards found are listed"
            ))
            .into());
        }
        // A link to a port is that port.
        let real = std::fs::canonicalize(path).ok();
        let real = real.and_then(|p| p.to_str().map(str::to_owned));
        let path = real.as_ref().unwrap_or(path);
        ports.retain(|port| port.path == *path);
        if ports.is_empty() {
            ports.push(PortDescription {
                path: path.clone(),
                description: "not listed by this system".into(),
                usb_id: None,
                serial_number: None,
                is_board: false,
            });
        }
    }
    for port in ports {
        let mut line = format!("{}  {}", port.path, port.description);
        if let Some(id) = &port.usb_id {
            line += &format!(" (USB {id})");
        }
        if let Some(number) = &port.serial_number {
            line += &format!(", serial number {number}");
        }
        let mut object = json!({
            "path": port.path, "description": port.description, "board": port.is_board,
            "usb_id": port.usb_id, "serial_number": port.serial_number,
        });
        if port.is_board || args.all || args.port.is_some() {
            match Board::connect(&port.path) {
                // The only thing that was asked for.
                Err(e) if args.port.is_some() => return Err(e.into()),
                Ok(board) => {
                    let hello = board.hello();
                    let (identity, firmware) = link::identity_words(&hello.identity);
                    line += &format!(
                        "\n    board {identity}, firmware {firmware}, protocol {}, schema {:016x}, last start: {}",
                        hello.protocol, hello.schema, hello.reset
                    );
                    object["board"] = true.into();
                    object["identity"] = identity.into();
                    object["firmware"] = firmware.into();
                    object["protocol"] = hello.protocol.into();
                    object["schema"] = format!("{:016x}", hello.schema).into();
                }
                Err(e) => {
                    line += &format!("\n    {e}");
                    object["error"] = e.to_string().into();
                }
            }
        }
        lines.push(line);
        found.push(object);
    }
    out.result(&json!({ "ports": found }), || {
        if lines.is_empty() {
            "no serial port on this machine".to_owned()
        } else {
            lines.join("\n")
        }
    })
}
