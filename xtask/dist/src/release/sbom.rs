//! Lists of the parts of an artefact (CycloneDX), by cargo-cyclonedx.

use std::fs;

use anyhow::{Context, Result, ensure};
use document::root;

use super::{Release, cargo};
use crate::program::run_program;

/// Name of the lists that cargo-cyclonedx writes beside the manifest of every package of the workspace.
const LIST: &str = "release-parts";

/// Adds the list of the package in a folder, for a target. It has build-time parts, too, because build scripts compile
/// some of them into the artefact, and parts that only features for other packages need.
pub(super) fn add(
    release: &mut Release,
    name: &str,
    folder: &str,
    target: &str,
    features: &str,
) -> Result<()> {
    let mut cyclonedx = cargo("cyclonedx --format json --spec-version 1.5");
    cyclonedx.args(["--override-filename", LIST, "--target", target, "--manifest-path"]);
    cyclonedx.arg(root().join(folder).join("Cargo.toml")).args(["--features", features]);
    let outcome = run_program(cyclonedx, "");
    let list = fs::read_to_string(root().join(folder).join(LIST).with_extension("json"));
    // Beside the other manifests, too.
    let metadata = run_program(cargo("metadata --locked --no-deps --format-version 1"), "")?;
    for manifest in metadata.split("\"manifest_path\":\"").skip(1).filter_map(|rest| rest.split('"').next()) {
        let _ = fs::remove_file(std::path::Path::new(manifest).with_file_name(LIST).with_extension("json"));
    }
    outcome?;
    let list = list.with_context(|| format!("cargo-cyclonedx wrote no list for {folder}"))?;
    let list = list.replace(&root().display().to_string(), "/wsg");
    let parts = list.matches("\"purl\": \"pkg:cargo/").count();
    ensure!(parts > 1, "the list of {folder} has {parts} parts");
    release.add(&format!("{name}.cdx.json"), list.as_bytes(), format!("{parts} parts"))
}
