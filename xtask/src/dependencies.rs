//! Licences, bans and sources of what the workspace depends on: deny.toml, by cargo-deny. Its advisories need a network.

use anyhow::Result;

use crate::{
    process,
    tool::{self, CARGO_DENY},
    workspace::Workspace,
};

/// Holds the dependencies to deny.toml.
pub(crate) fn check(workspace: &Workspace) -> Result<()> {
    CARGO_DENY.require(workspace, "licences, bans and sources of the dependencies")?;
    let words = ["cargo", "deny", "--locked", "check", "licenses", "bans", "sources"];
    process::run(&mut tool::plain(workspace, &words))
}
