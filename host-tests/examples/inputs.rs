//! Runs each fuzz body over generated inputs beyond the ones in the tests; built and run by `cargo xtask fuzz --inputs
//! N`. Names after the number select bodies.

use anyhow::{Context, Result, ensure};
use host_tests::fuzz_bodies::{ALL, Body, SMOKE_INPUTS};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let count = arguments.next().context("expected the number of inputs")?;
    let count: u32 = count.parse().with_context(|| format!("{count} is not a number of inputs"))?;
    let end =
        SMOKE_INPUTS.checked_add(count).context("too many inputs; expected fewer than 2^32 in total")?;
    ensure!(count > 0, "expected at least one input");
    let chosen = arguments
        .map(|name| Body::named(&name).with_context(|| format!("unknown fuzz body {name}")))
        .collect::<Result<Vec<_>>>()?;
    for body in if chosen.is_empty() { ALL.to_vec() } else { chosen } {
        body.run_generated(SMOKE_INPUTS..end);
        println!("{}: {count} inputs, from number {SMOKE_INPUTS} on", body.name);
    }
    Ok(())
}
