//! Runs each fuzz body over generated inputs beyond the ones in the tests; built and run by `cargo xtask fuzz --inputs
//! N`. Names after the number select bodies.

use anyhow::{Context, Result, ensure};
use host_tests::fuzz_bodies::{ALL, Body, SMOKE_INPUTS};

/// Number of reports for each body.
const PARTS: u32 = 20;

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
        // In parts, because a long run otherwise shows nothing for an hour.
        for part in 0..PARTS {
            let bound =
                |part: u32| SMOKE_INPUTS + (u64::from(count) * u64::from(part) / u64::from(PARTS)) as u32;
            body.run_generated(bound(part)..bound(part + 1));
            println!("{}: inputs {SMOKE_INPUTS} to {} of {end}", body.name, bound(part + 1));
        }
    }
    Ok(())
}
