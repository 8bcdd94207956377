//! Each fuzz body over so many generated inputs, behind those of the tests: `cargo xtask fuzz --inputs N` builds and runs it.

use anyhow::{Context, Result, ensure};
use host_tests::fuzz_bodies::{ALL, SMOKE_INPUTS};

fn main() -> Result<()> {
    let count = std::env::args().nth(1).context("how many inputs? One number is expected")?;
    let count: u32 = count.parse().with_context(|| format!("{count} is no number of inputs"))?;
    let end = SMOKE_INPUTS.checked_add(count).context("there are fewer than 2^32 inputs")?;
    ensure!(count > 0, "no inputs, no check");
    for body in ALL {
        body.run_generated(SMOKE_INPUTS..end);
        println!("{}: {count} inputs, from number {SMOKE_INPUTS} on", body.name);
    }
    Ok(())
}
