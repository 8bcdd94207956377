//! Soak test: a longer run of the host-tests test that sends commands to the image in the emulator on a faulty line.

use anyhow::{Context, Result};
use lexopt::{Arg, Parser, ValueExt};

use crate::{
    firmware::{IMAGE_VARIABLE, Image},
    process,
    workspace::Workspace,
};

/// The length and seed of a run.
#[derive(Debug, PartialEq)]
pub(crate) struct Extent {
    commands: u64,
    seed: u64,
}

impl Extent {
    /// The extent for `ci`, about 90 s.
    pub(crate) const CI: Self = Self { commands: 700, seed: 1 };

    /// Parses `--commands N` and `--seed N`.
    pub(crate) fn from(mut arguments: Parser) -> Result<Self> {
        let mut extent = Self { commands: 10_000, seed: 1 };
        while let Some(argument) = arguments.next()? {
            match argument {
                Arg::Long("commands") => extent.commands = arguments.value()?.parse()?,
                Arg::Long("seed") => extent.seed = arguments.value()?.parse()?,
                other => return Err(other.unexpected()).context("see `cargo xtask help`"),
            }
        }
        Ok(extent)
    }
}

/// Runs the test. Its last line summarizes the results of the commands.
pub(crate) fn run(workspace: &Workspace, image: &Image, extent: &Extent) -> Result<()> {
    let mut cargo = workspace.cargo("test");
    cargo.args(["-q", "-p", "host-tests", "--test", "end_to_end", "soak_on_a_faulty_line"]);
    cargo.args(["--", "--include-ignored", "--nocapture"]);
    cargo.env(IMAGE_VARIABLE, &image.path);
    cargo.env("WSG_SOAK_COMMANDS", extent.commands.to_string());
    cargo.env("WSG_SOAK_SEED", extent.seed.to_string());
    process::run(&mut cargo)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_thousand_commands_are_the_default() {
        let of = |arguments: &[&str]| Extent::from(Parser::from_args(arguments));

        assert_eq!(of(&[]).unwrap(), Extent { commands: 10_000, seed: 1 });
        let some = of(&["--commands", "300", "--seed", "7"]).unwrap();
        assert_eq!(some, Extent { commands: 300, seed: 7 });
        assert!(of(&["--hours", "1"]).is_err());
    }
}
