//! Each fuzz body over so many generated inputs, behind those of the tests: `cargo xtask fuzz --inputs N` builds and runs it.
//! Names behind the number choose among the bodies.

use anyhow::{Context, Result, ensure};
use host_tests::fuzz_bodies::{ALL, Body, SMOKE_INPUTS};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let count = arguments.next().context("how many inputs? One number is expected")?;
    let count: u32 = count.parse().with_context(|| format!("{count} is no number of inputs"))?;
    let end = SMOKE_INPUTS.checked_add(count).context("there are fewer than 2^32 inputs")?;
    ensure!(count > 0, "no inputs, no check");
    let chosen = arguments
        .map(|name| Body::named(&name).with_context(|| format!("there is no body {name}")))
        .collect::<Result<Vec<_>>>()?;
    for body in if chosen.is_empty() { ALL.to_vec() } else { chosen } {
        body.run_generated(SMOKE_INPUTS..end);
        println!("{}: {count} inputs, from number {SMOKE_INPUTS} on", body.name);
    }
    Ok(())
}
