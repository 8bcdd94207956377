//! docs/figures.md: every figure with its limit, written by what measured it.

use std::fs;

use anyhow::{Context, Result};

use crate::{
    bench, fast_stop,
    firmware::Image,
    gate::Gate,
    mutants, panics,
    probe::Probes,
    process, size,
    stack::{self},
    workspace::Workspace,
};

const DOCUMENT: &str = "docs/figures.md";
const README: &str = "README.md";
const END: &str = "<!-- end -->";

/// Measures everything that `docs/figures.md` tells, writes it, and has the README take it over; gives the gates.
pub(crate) fn write(probes: &Probes<'_>, image: &Image) -> Result<Vec<Gate>> {
    panics::check(probes)?;
    let mut gates = size::of_image(image)?;
    gates.extend(size::of_protocol(probes)?);
    gates.push(stack::walked(probes.workspace, probes.toolchain, image)?);
    gates.push(stack::painted(probes.workspace, image)?);
    gates.extend(bench::counted(probes, false)?.gates);
    gates.extend(bench::throughput(probes.workspace)?);

    let table = table(&gates) + &mutants::rows(&probes.workspace.root)?;
    write_part(probes.workspace, "figures", &table)?;
    write_part(probes.workspace, "fast-stop", &fast_stop::run(probes.workspace)?)?;
    let mut readme = probes.workspace.cargo();
    readme.env("WSG_UPDATE_DOCS", "1").args([
        "test",
        "-q",
        "-p",
        "host-tests",
        "--test",
        "docs",
        "figures_in_the_readme",
    ]);
    process::run(&mut readme)?;
    println!("{DOCUMENT} and README.md are written");
    Ok(gates)
}

/// Writes the rows on mutants anew, which follow from what is kept of their runs, into the document and the README.
pub(crate) fn write_mutants(workspace: &Workspace) -> Result<()> {
    let rows = mutants::rows(&workspace.root)?;
    for document in [DOCUMENT, README] {
        let path = workspace.root.join(document);
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {document}"))?;
        let text = with_rows(&text, &rows).with_context(|| format!("{document} has no part `figures`"))?;
        fs::write(&path, text).with_context(|| format!("cannot write {document}"))?;
    }
    Ok(())
}

/// Writes what stands between `<!-- generated: NAME -->` and the next end in the document.
pub(crate) fn write_part(workspace: &Workspace, name: &str, part: &str) -> Result<()> {
    let path = workspace.root.join(DOCUMENT);
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {DOCUMENT}"))?;
    let text = with_part(&text, name, part).with_context(|| format!("{DOCUMENT} has no part `{name}`"))?;
    fs::write(&path, text).with_context(|| format!("cannot write {DOCUMENT}"))
}

fn table(gates: &[Gate]) -> String {
    let mut text = "| what | measured | limit |\n|---|---|---|\n".to_owned();
    for gate in gates {
        let missed = if gate.holds() { "" } else { ", **missed**" };
        text.push_str(&format!(
            "| {} | {} | {}{missed} |\n",
            gate.what,
            gate.measured_text(),
            gate.limit_text()
        ));
    }
    text.push_str("| panic paths, firmware and every public function of the protocol | 0 | 0 |\n");
    text
}

fn with_part(text: &str, name: &str, part: &str) -> Option<String> {
    let begin = format!("<!-- generated: {name} -->");
    let (before, rest) = text.split_once(&begin)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{begin}\n{part}{END}{after}"))
}

/// The figures with these rows in place of those that begin as they do, or behind the others.
fn with_rows(text: &str, rows: &str) -> Option<String> {
    let (_, rest) = text.split_once("<!-- generated: figures -->\n")?;
    let (part, _) = rest.split_once(END)?;
    let first_cell = |row: &str| row.split('|').nth(1).map(str::to_owned);
    let new: Vec<_> = rows.lines().map(first_cell).collect();
    let mut table = String::new();
    for row in part.lines().filter(|row| !new.contains(&first_cell(row))).chain(rows.lines()) {
        table.push_str(row);
        table.push('\n');
    }
    with_part(text, "figures", &table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generated_part_is_replaced_and_nothing_else() {
        let text = "# Figures\n\n<!-- generated: figures -->\nold\n<!-- end -->\n\nText.\n";
        let gates = [Gate::bytes("flash", 90, 100), Gate::bytes("RAM", 120, 100).standing_at(130.0)];

        let written = with_part(text, "figures", &table(&gates)).unwrap();

        assert!(written.starts_with("# Figures\n") && written.ends_with("<!-- end -->\n\nText.\n"));
        assert!(written.contains("| flash | 90 B | 100 B |\n| RAM | 120 B | 100 B, **missed** |\n"));
        assert!(!written.contains("old"));
        assert_eq!(with_part("no part", "figures", ""), None);
    }

    #[test]
    fn rows_take_the_place_of_their_likes_and_the_others_stay() {
        let text = "A\n<!-- generated: figures -->\n| what | measured |\n|---|---|\n| RAM | 80 B |\n<!-- end -->\nB\n";

        let first = with_rows(text, "| mutants | 7 of 8 |\n").unwrap();
        let second = with_rows(&first, "| mutants | 8 of 8 |\n").unwrap();

        assert_eq!(first, text.replace("80 B |\n", "80 B |\n| mutants | 7 of 8 |\n"));
        assert_eq!(second, first.replace("7 of 8", "8 of 8"));
        assert_eq!(with_rows("no part", ""), None);
    }
}
