//! Checks licences, bans and sources of the dependencies with cargo-deny. Advisories are not checked, because they need a network.

use anyhow::Result;

use crate::{
    process,
    tool::{self, CARGO_DENY},
    workspace::Workspace,
};

/// Checks the dependencies against deny.toml.
pub(crate) fn check(workspace: &Workspace) -> Result<()> {
    CARGO_DENY.require(workspace, "licences, bans and sources of the dependencies")?;
    let words = ["cargo", "deny", "--locked", "check", "licenses", "bans", "sources"];
    process::run(&mut tool::plain(workspace, &words))
}
