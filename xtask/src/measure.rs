//! The commands for measurements, proofs and long-running checks.

use anyhow::{Context, Result, bail, ensure};
use lexopt::{Arg, Parser, ValueExt};

use crate::{
    bench, coverage, dependencies, explore, fast_stop, figures,
    firmware::{self, Image, Variant},
    fuzz, gate, interleavings,
    matrix::Extent,
    mutants, no_more, panics, platforms,
    probe::Probes,
    process,
    setup::{self, ThumbToolchain},
    size, soak, stack, test, undefined_behaviour,
    workspace::Workspace,
};

/// Runs a command by name.
pub(crate) fn run(command: &str, arguments: Parser) -> Result<()> {
    match command {
        "size" => {
            no_more(arguments)?;
            let built = Built::new()?;
            let mut gates = size::of_images(&built.images()?)?;
            gates.extend(size::of_protocol(&built.probes())?);
            gate::check(&gates)
        }
        "stack" => {
            no_more(arguments)?;
            let built = Built::new()?;
            let images = built.images()?;
            let mut gates = stack::walked(&built.workspace, &built.toolchain, &images)?;
            gates.extend(stack::painted(&built.workspace, &images)?);
            gate::check(&gates)
        }
        "panics" => {
            no_more(arguments)?;
            panics::check(&Built::new()?.probes())
        }
        "bench" => {
            let update = flag(arguments, "update")?;
            let built = Built::new()?;
            let mut gates = bench::counted(&built.probes(), update)?.gates;
            gates.extend(bench::throughput(&built.workspace)?);
            gates.extend(bench::latency(&built.workspace)?);
            gate::check(&gates)
        }
        "figures" => {
            no_more(arguments)?;
            let built = Built::new()?;
            gate::check(&figures::write(&built.probes(), &built.images()?)?)
        }
        "ci" => {
            no_more(arguments)?;
            let Built { workspace, toolchain, image, .. } = Built::new()?;
            dependencies::check(&workspace)?;
            test::run(&workspace, &toolchain, &[], Extent::Whole, true)?;
            telemetry(&workspace)?;
            platforms::run(&workspace)?;
            soak::run(&workspace, &image, &soak::Extent::CI)?;
            fast_stop::run(&workspace)?;
            explore::run(&workspace, explore::STATES)?;
            interleavings::run(&workspace)?;
            undefined_behaviour::run(&workspace)
        }
        "fast-stop" => {
            no_more(arguments)?;
            fast_stop::run(&Workspace::from_env()?).map(drop)
        }
        "platforms" => {
            no_more(arguments)?;
            platforms::run(&Workspace::from_env()?)
        }
        "deny" => {
            no_more(arguments)?;
            dependencies::check(&Workspace::from_env()?)
        }
        "explore" => explore::run(&Workspace::from_env()?, explore::states(arguments)?),
        "fuzz" => {
            let extent = fuzz_extent(arguments)?;
            fuzz::run(&Workspace::from_env()?, &extent)
        }
        "soak" => {
            let extent = soak::Extent::from(arguments)?;
            let built = Built::new()?;
            soak::run(&built.workspace, &built.image, &extent)
        }
        "mutants" => mutants::run(&Workspace::from_env()?, &mutants_extent(arguments)?),
        "loom" => {
            no_more(arguments)?;
            interleavings::run(&Workspace::from_env()?)
        }
        "miri" => {
            no_more(arguments)?;
            undefined_behaviour::run(&Workspace::from_env()?)
        }
        "coverage" => {
            no_more(arguments)?;
            coverage::run(&Workspace::from_env()?)
        }
        unknown => bail!("unknown command `{unknown}`; see `cargo xtask help`"),
    }
}

/// Runs the load test of `wsg telemetry` with 500 virtual grippers, separately from all other tests.
fn telemetry(workspace: &Workspace) -> Result<()> {
    let test = ["--release", "-p", "wsg-tool", "--test", "telemetry", "five_hundred", "--", "--nocapture"];
    process::run(workspace.cargo("test").args(test).env("WSG_LOAD", "1"))
}

/// The subject of a measurement: the default image and the tool chain.
struct Built {
    workspace: Workspace,
    toolchain: ThumbToolchain,
    image: Image,
}

impl Built {
    fn new() -> Result<Self> {
        let workspace = Workspace::from_env()?;
        let toolchain = setup::thumb_and_qemu(&workspace)?;
        let image = firmware::build(&workspace, &toolchain, &Variant::default())?;
        Ok(Self { workspace, toolchain, image })
    }

    /// Builds the images of all boards.
    fn images(&self) -> Result<Vec<Image>> {
        firmware::build_all(&self.workspace, &self.toolchain)
    }

    fn probes(&self) -> Probes<'_> {
        Probes { workspace: &self.workspace, toolchain: &self.toolchain }
    }
}

/// Parses files, `--again`, `--shard K/N` and `--jobs N`.
fn mutants_extent(mut arguments: Parser) -> Result<mutants::Extent> {
    let mut extent = mutants::Extent::default();
    while let Some(argument) = arguments.next()? {
        match argument {
            Arg::Long("shard") => extent.shard = Some(arguments.value()?.string()?),
            Arg::Long("again") => extent.again = true,
            Arg::Long("jobs") => extent.jobs = Some(arguments.value()?.parse()?),
            Arg::Value(file) => extent.files.push(file.string()?),
            other => return Err(other.unexpected()).context("see `cargo xtask help`"),
        }
    }
    Ok(extent)
}

/// Parses `--seconds N` or `--inputs N`.
fn fuzz_extent(mut arguments: Parser) -> Result<fuzz::Extent> {
    let mut extent = None;
    while let Some(argument) = arguments.next()? {
        let given = match argument {
            Arg::Long("seconds") => fuzz::Extent::Seconds(arguments.value()?.parse()?),
            Arg::Long("inputs") => fuzz::Extent::Inputs(arguments.value()?.parse()?),
            other => return Err(other.unexpected()).context("see `cargo xtask help`"),
        };
        ensure!(extent.replace(given).is_none(), "expected either --seconds or --inputs, once");
    }
    Ok(extent.unwrap_or(fuzz::Extent::Seconds(fuzz::SECONDS)))
}

/// Returns whether the only permitted option is given.
fn flag(mut arguments: Parser, name: &str) -> Result<bool> {
    match arguments.next()? {
        None => Ok(false),
        Some(Arg::Long(given)) if given == name => no_more(arguments).map(|()| true),
        Some(other) => Err(other.unexpected()).context("see `cargo xtask help`"),
    }
}
