//! An example for each command, shown by `--help` and in the manual.

use clap::Command;

/// Command and its examples, a line each; the first stands in the program's own help too.
const EXAMPLES: [(&str, &[&str]); 17] = [
    (
        "calibrate",
        &["cannula calibrate session --out calibration.json"],
    ),
    (
        "angle",
        &[
            "cannula angle session --calibration calibration.json --out result --needle-angle 25",
            "cannula angle session --calibration calibration.json --out result --xyz --csv",
        ],
    ),
    (
        "process",
        &[
            "cannula process session --out result",
            "cannula process session --out result --json | jq .needle",
        ],
    ),
    (
        "puncture",
        &[
            "cannula puncture --angles 30,45,60 --out puncture",
            "cannula puncture --angles 15,20,25,30 --criterion constrained --friction 0.3 --out puncture",
        ],
    ),
    (
        "plot",
        &[
            "cannula plot calibration session -o calibration.svg",
            "cannula plot cloud result -o cloud.png",
            "cannula plot stripes session --frame 12 -o stripes.svg",
            "cannula plot puncture puncture -o force.png",
        ],
    ),
    ("demo", &["cannula demo --out demo --seed 3"]),
    (
        "capture",
        &[
            "cannula capture camera --config rig.toml --out session",
            "cannula capture light --config rig.toml --out session",
        ],
    ),
    (
        "scan",
        &[
            "cannula scan --config rig.toml --calibration calibration.json --entry entry.json --out scan1",
        ],
    ),
    ("replay", &["cannula replay session --out again"]),
    (
        "motion",
        &[
            "cannula motion --port /dev/ttyACM0 status",
            "cannula motion --config rig.toml home",
            "cannula motion --config rig.toml move 25.5",
            "cannula motion --config rig.toml laser --laser --seconds 5",
        ],
    ),
    (
        "ports",
        &["cannula ports", "cannula ports --port /dev/ttyACM0"],
    ),
    (
        "config",
        &[
            "cannula config --example > rig.toml",
            "cannula config rig.toml",
        ],
    ),
    (
        "simulate",
        &[
            "cannula simulate --session recording --profile nominal --seed 7",
            "cannula simulate --pty",
        ],
    ),
    (
        "uf2",
        &["cannula uf2 target/thumbv6m-none-eabi/firmware/motion-board motion-board.uf2"],
    ),
    (
        "doctor",
        &[
            "cannula doctor --config rig.toml --calibration calibration.json",
            "cannula doctor --port simulated",
        ],
    ),
    (
        "completions",
        &["cannula completions bash > ~/.local/share/bash-completion/completions/cannula"],
    ),
    ("man", &["cannula man --out ~/.local/share/man/man1"]),
];

/// The same for the commands that have commands of their own; each example is taken there alone.
const NESTED: [(&str, &str, &str); 18] = [
    (
        "plot",
        "calibration",
        "cannula plot calibration session -o calibration.svg",
    ),
    ("plot", "cloud", "cannula plot cloud result -o cloud.png"),
    (
        "plot",
        "stripes",
        "cannula plot stripes session --frame 12 -o stripes.svg",
    ),
    (
        "plot",
        "puncture",
        "cannula plot puncture puncture -o force.png",
    ),
    (
        "capture",
        "camera",
        "cannula capture camera --config rig.toml --out session",
    ),
    (
        "capture",
        "light",
        "cannula capture light --config rig.toml --out session",
    ),
    (
        "capture",
        "scan",
        "cannula capture scan --config rig.toml --out session",
    ),
    (
        "motion",
        "status",
        "cannula motion --config rig.toml status",
    ),
    ("motion", "home", "cannula motion --config rig.toml home"),
    (
        "motion",
        "move",
        "cannula motion --config rig.toml move 25.5 --speed 10",
    ),
    ("motion", "jog", "cannula motion --config rig.toml jog -0.5"),
    (
        "motion",
        "laser",
        "cannula motion --config rig.toml laser --laser --seconds 5",
    ),
    (
        "motion",
        "trigger",
        "cannula motion --config rig.toml trigger",
    ),
    (
        "motion",
        "config",
        "cannula motion --config rig.toml config",
    ),
    ("motion", "stop", "cannula motion --config rig.toml stop"),
    ("motion", "rearm", "cannula motion --config rig.toml rearm"),
    (
        "motion",
        "release",
        "cannula motion --config rig.toml release",
    ),
    (
        "motion",
        "reboot",
        "cannula motion --config rig.toml reboot --bootloader",
    ),
];

/// Puts the examples into the help.
pub fn add(mut command: Command) -> Command {
    let mut all = String::from("Examples:\n");
    for (name, lines) in EXAMPLES {
        let Some(first) = lines.first() else { continue };
        all += &format!("  {first}\n");
        let word = if lines.len() > 1 {
            "Examples"
        } else {
            "Example"
        };
        let text = format!("{word}:\n  {}", lines.join("\n  "));
        command = command.mut_subcommand(name, |sub| sub.after_help(text));
    }
    for (name, inner, line) in NESTED {
        let text = format!("Example:\n  {line}");
        command = command.mut_subcommand(name, |sub| {
            sub.mut_subcommand(inner, |sub| sub.after_help(text))
        });
    }
    all += "\nExit status: 0 done, 1 failed (one sentence on standard error), 2 bad arguments.";
    command.after_help(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn every_command_has_an_example_and_every_example_is_taken() {
        let command = super::super::command();
        for sub in command.get_subcommands() {
            let help = sub
                .get_after_help()
                .map(ToString::to_string)
                .unwrap_or_default();
            let line = format!("cannula {}", sub.get_name());
            assert!(help.contains(&line), "{}: {help}", sub.get_name());
            assert!(
                command
                    .get_after_help()
                    .unwrap()
                    .to_string()
                    .contains(&line)
            );
        }
        let nested = NESTED.iter().map(|(.., line)| line);
        for line in EXAMPLES.iter().flat_map(|(_, lines)| *lines).chain(nested) {
            // What the shell takes away.
            let words = line
                .split_whitespace()
                .take_while(|w| *w != ">" && *w != "|");
            if let Err(e) = super::super::Cli::try_parse_from(words) {
                panic!("{line}: {e}");
            }
        }
    }

    /// Every command, however deep, ends its long help with an example of itself.
    #[test]
    fn every_help_ends_with_examples() {
        fn walk(command: &mut Command, names: &str, seen: &mut usize) {
            *seen += 1;
            let help = command.render_long_help().to_string();
            let end = help.split("Example").nth(1);
            let last = names.rsplit(' ').next().unwrap_or_default();
            let own = end.is_some_and(|e| e.contains("cannula ") && e.contains(last));
            assert!(own, "{names}: {help}");
            // clap's own `help` is none of ours.
            let subs = command.get_subcommands_mut();
            for sub in subs.filter(|s| s.get_name() != "help") {
                let names = format!("{names} {}", sub.get_name());
                walk(sub, &names, seen);
            }
        }
        let mut seen = 0;
        walk(&mut super::super::command(), "cannula", &mut seen);
        assert_eq!(seen, 1 + EXAMPLES.len() + NESTED.len());
    }
}
