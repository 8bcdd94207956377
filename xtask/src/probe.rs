//! The programs in host-tests/probes, which are measured relative to an empty one or run in the emulator.

use std::{path::PathBuf, process::Command};

use anyhow::Result;
use footprint::Footprint;

use crate::{
    process,
    setup::{TRIPLE, ThumbToolchain},
    size,
};

/// A profile of cargo for programs.
#[derive(Clone, Copy)]
pub(crate) struct Profile {
    /// Name of the profile.
    pub(crate) name: &'static str,
    /// Its optimisation level, as for the option of rustc.
    pub(crate) level: char,
}

impl Profile {
    /// Optimised for size, as the firmware.
    pub(crate) const SIZE: Self = Self { name: "firmware", level: 's' };

    /// Both profiles, for checks at each optimisation level: the other one is optimised for speed.
    pub(crate) const ALL: [Self; 2] = [Self::SIZE, Self { name: "firmware-o3", level: '3' }];
}

impl ThumbToolchain<'_> {
    /// Returns the `cargo build` command of a program for a target.
    pub(crate) fn probe(&self, triple: &str, name: &str, features: &str, profile: Profile) -> Command {
        let mut cargo = self.cargo("build", triple);
        cargo.args(["-p", "wsg-probes", "--bin", name, "--features", features, "--profile", profile.name]);
        cargo
    }

    /// Builds a program and returns its path. The next build of the same program overwrites it.
    pub(crate) fn build_probe(
        &self,
        triple: &str,
        name: &str,
        features: &str,
        profile: Profile,
    ) -> Result<PathBuf> {
        process::run(&mut self.probe(triple, name, features, profile))?;
        Ok(self.output_dir(triple, profile.name).join(name))
    }

    /// Returns the flash and RAM footprint of a program at opt-level s.
    pub(crate) fn footprint(&self, name: &str, features: &str) -> Result<Footprint> {
        let path = self.build_probe(TRIPLE, name, features, Profile::SIZE)?;
        Ok(Footprint::of(&size::sections_of(&path)?))
    }
}
