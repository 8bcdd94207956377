//! Measures all figures and writes docs/figures.md.

use std::fs;

use anyhow::{Context, Result};

use crate::{bench, commands, firmware::Image, gate::Gate, panics, setup::ThumbToolchain, size, stack, web};

const DOCUMENT: &str = "docs/figures.md";

/// Measures all figures, writes them to `docs/figures.md`, and returns the gates.
pub(crate) fn write(toolchain: &ThumbToolchain<'_>, images: &[Image]) -> Result<Vec<Gate>> {
    panics::check(toolchain)?;
    let mut gates = size::of_all(toolchain, images)?;
    gates.push(web::size(&web::build(toolchain.workspace)?)?);
    gates.extend(stack::walked(images)?);
    gates.extend(stack::painted(toolchain.workspace, images)?);
    gates.extend(bench::counted(toolchain, false)?.gates);
    gates.extend(bench::throughput(toolchain.workspace)?);
    gates.extend(bench::latency(toolchain.workspace)?);
    gates.extend(bench::gateway(toolchain.workspace)?);

    let path = toolchain.workspace.root.join(DOCUMENT);
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {DOCUMENT}"))?;
    let parts = [
        ("figures", table(&gates)),
        ("fast-stop", commands::fast_stop(toolchain.workspace)?),
        ("updates", commands::update_times(toolchain)?),
    ];
    let text = parts.iter().try_fold(text, |text, (name, part)| document::with_part(&text, name, part));
    let text = text.with_context(|| format!("{DOCUMENT} lacks a generated part"))?;
    fs::write(&path, text).with_context(|| format!("cannot write {DOCUMENT}"))?;
    println!("{DOCUMENT} updated");
    Ok(gates)
}

fn table(gates: &[Gate]) -> String {
    let panic_paths = "panic paths, firmware and every public function of the protocol";
    let rows = gates.iter().map(|gate| [gate.what.clone(), gate.measured_text(), gate.limit_text()]);
    document::table(
        ["figure", "measured", "limit"],
        rows.chain([[panic_paths.to_owned(), "0".to_owned(), "0".to_owned()]]),
    )
}
