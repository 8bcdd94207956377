//! The programs of host-tests/probes, which are measured beside an empty one or run in the emulator.

use std::{fs, path::PathBuf, process::Command};

use anyhow::{Context, Result};
use footprint::Footprint;

use crate::{
    process,
    setup::{TRIPLE, ThumbToolchain},
    workspace::Workspace,
};

const PACKAGE: &str = "wsg-probes";

/// How a program is optimised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Profile {
    /// As the firmware is: opt-level s.
    Size,
    /// opt-level 3.
    Speed,
}

impl Profile {
    /// Both.
    pub(crate) const ALL: [Self; 2] = [Self::Size, Self::Speed];

    /// Cargo's name for it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Size => "firmware",
            Self::Speed => "firmware-o3",
        }
    }

    /// For a person.
    pub(crate) fn opt_level(self) -> &'static str {
        match self {
            Self::Size => "opt-level s",
            Self::Speed => "opt-level 3",
        }
    }
}

/// Builds probes for thumb targets.
pub(crate) struct Probes<'a> {
    /// Where they are.
    pub(crate) workspace: &'a Workspace,
    /// What builds them.
    pub(crate) toolchain: &'a ThumbToolchain,
}

impl Probes<'_> {
    /// Cargo's `build` of this program for a target.
    pub(crate) fn cargo(&self, triple: &str, name: &str, features: &str, profile: Profile) -> Command {
        let mut cargo = self.toolchain.cargo(self.workspace, "build", triple);
        cargo.args(["-p", PACKAGE, "--bin", name, "--features", features, "--profile", profile.name()]);
        cargo
    }

    /// Builds this program, and gives its path. The next one of its name takes its place.
    pub(crate) fn build(
        &self,
        triple: &str,
        name: &str,
        features: &str,
        profile: Profile,
    ) -> Result<PathBuf> {
        process::run(&mut self.cargo(triple, name, features, profile))?;
        Ok(self.toolchain.output_dir(self.workspace, triple, profile.name()).join(name))
    }

    /// What this program takes, at opt-level s.
    pub(crate) fn footprint(&self, name: &str, features: &str) -> Result<Footprint> {
        let path = self.build(TRIPLE, name, features, Profile::Size)?;
        let what_failed = || format!("cannot read the sections of {}", path.display());
        let bytes = fs::read(&path).with_context(what_failed)?;
        Ok(Footprint::of(&footprint::sections_of(&bytes).with_context(what_failed)?))
    }
}
