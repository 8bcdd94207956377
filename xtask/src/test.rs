//! Runs all checks of the workspace in order, up to the first failure.

use std::{
    ffi::OsString,
    num::NonZero,
    path::{Path, PathBuf},
    thread,
    time::Instant,
};

use anyhow::{Context, Result, ensure};
use boards::{BOARDS, Board};

use crate::{
    bench, commands, disturb,
    firmware::{self, Variant},
    gate,
    matrix::{self, Extent},
    panics, platforms, process, python,
    settings::Change,
    setup::{self, CLIPPY, Masters, NODE_VARIABLE, PYTHON_VARIABLE, RUSTFMT, ThumbToolchain},
    size, stack, web,
    workspace::Workspace,
};

const TESTS: &str = "tests, emulator included";

/// The start of the names of tests that need the Python package.
const TESTS_WITH_PYTHON: &str = "python_";

const TARGETS: [&str; 4] = ["--workspace", "--lib", "--bins", "--tests"];

/// Runs all checks, or with `filter` only the matching tests. Skipped checks are listed at the end, and fail a strict run. With a
/// seed, the tests run on a disturbed machine.
pub(crate) fn run(
    toolchain: &ThumbToolchain<'_>,
    filter: &[OsString],
    extent: Extent,
    is_strict: bool,
    disturbed: Option<u64>,
) -> Result<()> {
    let mut record = Record::default();
    let checks = Checks { toolchain, extent, disturbed };
    let outcome = if filter.is_empty() {
        checks.run_all(&mut record)
    } else {
        println!("test: running only tests that match {filter:?}; omit the filter to run all checks");
        let peers = checks.peers(&mut record)?;
        record.check(TESTS, || {
            build_tests(toolchain.workspace)?;
            disturb::during(disturbed, || checks.tests(&peers, filter))
        })
    };
    println!("{}", record.summary(outcome.is_err()));
    outcome.and_then(|()| record.verdict(is_strict))
}

/// Runs the checks that need neither the firmware nor an emulator, because these cannot be built or installed for the reason `why`,
/// which also names the commands that would install them.
pub(crate) fn run_without_emulators(
    workspace: &Workspace,
    filter: &[OsString],
    is_strict: bool,
    disturbed: Option<u64>,
    why: &anyhow::Error,
) -> Result<()> {
    let mut record = Record::default();
    record.not_checked("firmware, emulators, third-party masters, the packages for Python and C");
    let mut run = || {
        if filter.is_empty() {
            lint_and_build(workspace, &mut record, RUSTFMT.provide(workspace), CLIPPY.provide(workspace))?;
        }
        record.check("tests without emulators", || {
            disturb::during(disturbed, || {
                process::run(
                    workspace.cargo("test").args(TARGETS).args(["--no-fail-fast", "--"]).args(filter),
                )
            })
        })?;
        if filter.is_empty() { docs(workspace, &mut record) } else { Ok(()) }
    };
    let outcome = run();
    println!("{}\nFor the checks that were not made: {why:#}", record.summary(outcome.is_err()));
    outcome.and_then(|()| record.verdict(is_strict))
}

struct Checks<'a> {
    toolchain: &'a ThumbToolchain<'a>,
    extent: Extent,
    disturbed: Option<u64>,
}

/// What the tests run against.
struct Peers {
    masters: Masters,
    /// Images of all emulated boards and settings, and the C library, by the environment variable for the tests.
    emulated: Vec<(String, PathBuf)>,
    /// A virtual environment for the Python package, if it could be created.
    python: Option<PathBuf>,
}

impl Checks<'_> {
    fn run_all(&self, record: &mut Record) -> Result<()> {
        let (toolchain, workspace) = (self.toolchain, self.toolchain.workspace);
        // Here, because neither rustup nor apt can be called by both lists at the same time.
        let (has_rustfmt, has_clippy) = (RUSTFMT.provide(workspace), CLIPPY.provide(workspace));
        let has_thumb_clippy = CLIPPY.provide_for_thumb(toolchain);
        let ((), peers) = record.both(
            |it| lint_and_build(workspace, it, has_rustfmt, has_clippy),
            |it| {
                let peers = self.peers(it)?;
                self.lint_firmware(it, has_thumb_clippy).map(|()| peers)
            },
        )?;
        record.both(
            |it| {
                // Nothing else: a busy machine only makes builds longer.
                it.check(TESTS, || disturb::during(self.disturbed, || self.tests(&peers, &[])))?;
                self.on_the_host(it, peers.python.as_deref())
            },
            |it| self.of_the_images(it, &peers.masters),
        )?;
        record.check("host throughput", || {
            // Check only the ratio: the absolute throughput depends on the machine.
            let [_, beside_a_loop] = bench::throughput(workspace)?;
            gate::check(&[beside_a_loop])
        })
    }

    fn peers(&self, record: &mut Record) -> Result<Peers> {
        let toolchain = self.toolchain;
        let masters = setup::masters(toolchain.workspace);
        for program in &masters.missing {
            record.not_checked(&format!("tests with {program} (it is not installed)"));
        }
        record.check("images", || {
            let library = firmware::c_library(toolchain, setup::TRIPLE)?;
            let mut emulated = vec![("WSG_C_LIBRARY".to_owned(), library)];
            for (board, ending) in BOARDS.iter().filter_map(|board| Some((board, board.emulated?))) {
                for (variable, settings) in firmware::CHOICES {
                    let settings = settings.iter().map(|(name, value)| Change::new(name, *value));
                    let settings = settings.collect::<Result<_>>()?;
                    let image =
                        firmware::build(toolchain, &Variant { board, settings, ..Variant::default() })?;
                    if variable == firmware::IMAGE_VARIABLE {
                        crate::print_image(&image);
                    }
                    emulated.push((format!("{variable}{ending}"), image.path));
                }
                emulated
                    .push((format!("WSG_BOOT_ELF{ending}"), firmware::boot_loader(toolchain, board)?.path));
                emulated.push((
                    format!("WSG_SLOT_ELF{ending}"),
                    firmware::build_for_slot(toolchain, board)?.path,
                ));
            }
            Ok(Peers { masters, emulated, python: setup::python(toolchain.workspace) })
        })
    }

    fn lint_firmware(&self, record: &mut Record, has_clippy: bool) -> Result<()> {
        let probes = "-p wsg-probes --bins --features b-l475e-iot01a,every-function --profile firmware";
        let probes = (setup::TRIPLE, probes.split(' ').map(str::to_owned).collect());
        let image = |it: &Board| (it.triple, firmware::selection(it, &[], firmware::PROFILE));
        if !has_clippy {
            record.not_checked("clippy, firmware and probes (no clippy for that tool chain)");
            return Ok(());
        }
        record.check("clippy, firmware and probes", || {
            BOARDS.iter().map(image).chain([probes]).try_for_each(|(triple, selection)| {
                let mut clippy = self.toolchain.cargo("clippy", triple);
                process::run(clippy.args(selection).args(["--", "-D", "warnings"]))
            })
        })
    }

    /// The checks that mostly build with the development profile.
    fn on_the_host(&self, record: &mut Record, python: Option<&Path>) -> Result<()> {
        let workspace = self.toolchain.workspace;
        match python {
            Some(environment) => record.check("Python package", || {
                disturb::during(self.disturbed, || python::test(workspace, environment))?;
                python::sdist(workspace, environment).map(drop)
            })?,
            None => record.not_checked("Python package and the tests with it (its tools are not installed)"),
        }
        let built = record.check("protocol on other targets, oldest Rust, package", || {
            matrix::build(workspace, self.extent)
        })?;
        built.not_checked.iter().for_each(|what| record.not_checked(what));
        docs(workspace, record)
    }

    /// The checks that mostly build with the profiles of the firmware, whose linking uses one core. They run in a thread of their own,
    /// and leave the processor to the tests.
    fn of_the_images(&self, record: &mut Record, masters: &Masters) -> Result<()> {
        #[cfg(unix)]
        rustix::process::nice(10)?;
        let toolchain = self.toolchain;
        let images = firmware::build_all(toolchain)?;
        let sizes = || {
            let updates = size::of_updates(toolchain)?;
            anyhow::Ok([size::of_images(&images)?, updates, size::of_protocol(toolchain)?].concat())
        };
        record.check("size", || gate::check(&sizes()?))?;
        if masters.missing.contains(&"arm_none_eabi_gcc") {
            record.not_checked("size of the C library (no arm-none-eabi-gcc)");
        } else {
            record.check("size of the C library", || gate::check(&size::of_c_library(toolchain)?))?;
        }
        record.check("stack, walked", || gate::check(&stack::walked(&images)?))?;
        let not_compared = record.check("instructions", || {
            let counted = bench::counted(toolchain, false)?;
            gate::check(&counted.gates).map(|()| counted.not_compared)
        })?;
        not_compared.iter().for_each(|why| record.not_checked(&format!("instructions, {why}")));
        record.check("panic paths", || panics::check(toolchain))?;
        // Without rp2040js, only the default board's image, which is the first, can be emulated.
        let emulated = if masters.missing.contains(&"rp2040js") { &images[..1] } else { &images };
        record.check("stack, painted", || gate::check(&stack::painted(toolchain.workspace, emulated)?))?;
        // The throughput is measured when nothing else runs.
        let throughput = "build -q --release -p wsg-probes --features throughput --bin throughput";
        process::run(&mut toolchain.workspace.cargo(throughput))
    }

    /// Runs the tests. Doc examples are a separate check, because `--include-ignored` would run those marked `ignore`.
    fn tests(&self, Peers { masters, emulated, python }: &Peers, filter: &[OsString]) -> Result<()> {
        let mut tests = self.toolchain.workspace.cargo("test");
        if let Some(environment) = python {
            python::install(self.toolchain.workspace, environment)?;
            tests.env(python::VARIABLE, environment.join("bin/python"));
        }
        tests.env(PYTHON_VARIABLE, &masters.python).env(NODE_VARIABLE, &masters.node);
        // A run takes minutes, so it reports every failure.
        tests
            .args(TARGETS)
            .args(["--no-fail-fast", "--", "--include-ignored"])
            .envs(emulated.iter().cloned());
        // Emulator tests mostly wait. With two threads per core, the machine would be idle half of the time.
        let threads = thread::available_parallelism().map_or(1, NonZero::get).saturating_mul(4);
        tests.env("RUST_TEST_THREADS", threads.to_string());
        if self.extent == Extent::Whole {
            tests.env("WSG_WHOLE", "1");
        }
        let skipped = masters.missing.iter().chain([&platforms::TESTS, &commands::WHOLE_ARCHIVE]);
        let skipped = skipped.chain(python.is_none().then_some(&TESTS_WITH_PYTHON));
        let has_pages = self.toolchain.workspace.target_dir.join(web::FOLDER).exists();
        let skipped = skipped.chain((!has_pages).then_some(&web::TESTS));
        process::run(tests.args(skipped.flat_map(|name| ["--skip", name])).args(filter))
    }
}

fn lint_and_build(
    workspace: &Workspace,
    record: &mut Record,
    has_rustfmt: bool,
    has_clippy: bool,
) -> Result<()> {
    if has_rustfmt {
        record.check("format", || process::run(&mut workspace.cargo("fmt --all -- --check")))?;
    } else {
        record.not_checked("format (no rustfmt)");
    }
    if has_clippy {
        let clippy = "clippy --workspace --all-targets -- -D warnings";
        record.check("clippy, host", || process::run(&mut workspace.cargo(clippy)))?;
    } else {
        record.not_checked("clippy, host (no clippy)");
    }
    record.check("build", || build_tests(workspace))?;
    if setup::provide_target(workspace, web::TRIPLE) {
        record.check("pages without a server", || web::build(workspace).map(drop))
    } else {
        record.not_checked(&format!("pages without a server (no {})", web::TRIPLE));
        Ok(())
    }
}

fn build_tests(workspace: &Workspace) -> Result<()> {
    // Tests execute the examples. `cargo test --examples` would link each a second time, and most contain no tests. Those that
    // do have `test = true` in the manifest.
    process::run(workspace.cargo("build --examples").args(TARGETS))
}

/// Tests the examples in the documentation, and builds it.
fn docs(workspace: &Workspace, record: &mut Record) -> Result<()> {
    let mut examples = workspace.cargo("test --workspace --doc");
    record.check("examples in the docs", || process::run(&mut examples))?;
    record.check("docs", || {
        let doc = format!("doc --workspace --no-deps --lib --bins {}", Workspace::FEATURES_OF_TESTS);
        process::run(workspace.cargo(&doc).env("RUSTDOCFLAGS", "-D warnings"))
    })
}

/// The checks that passed and the skipped ones.
#[derive(Default)]
struct Record {
    passed: Vec<&'static str>,
    not_checked: Vec<String>,
}

impl Record {
    fn check<T>(&mut self, name: &'static str, check: impl FnOnce() -> Result<T>) -> Result<T> {
        println!("== {name}");
        let start = Instant::now();
        let value = check().with_context(|| format!("check \"{name}\""))?;
        println!("== {name}: passed in {} s", start.elapsed().as_secs());
        self.passed.push(name);
        Ok(value)
    }

    /// Runs two lists of checks at the same time, each up to its first failure.
    fn both<T, U: Send>(
        &mut self,
        one: impl FnOnce(&mut Self) -> Result<T>,
        other: impl FnOnce(&mut Self) -> Result<U> + Send,
    ) -> Result<(T, U)> {
        let mut beside = Self::default();
        let (one, other) = thread::scope(|scope| {
            let other = scope.spawn(|| other(&mut beside).inspect_err(|error| eprintln!("error: {error:#}")));
            (one(self), other.join().expect("a panic is a defect, and was printed"))
        });
        self.passed.append(&mut beside.passed);
        self.not_checked.append(&mut beside.not_checked);
        Ok((one?, other?))
    }

    fn not_checked(&mut self, name: &str) {
        println!("== NOT CHECKED: {name}");
        self.not_checked.push(name.to_owned());
    }

    fn summary(&self, failed: bool) -> String {
        let mut text = format!("test: {} passed ({})", self.passed.len(), self.passed.join("; "));
        if failed {
            text.push_str(", then one FAILED; the remaining checks did not all run");
        }
        if !self.not_checked.is_empty() {
            let (count, names) = (self.not_checked.len(), self.not_checked.join("; "));
            text += &format!("; {count} NOT CHECKED ({names})");
        }
        text
    }

    /// Fails a strict run if any check was skipped.
    fn verdict(&self, is_strict: bool) -> Result<()> {
        ensure!(
            !is_strict || self.not_checked.is_empty(),
            "all checks that ran have passed, but --strict does not allow skipped checks (NOT CHECKED)"
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path};

    use anyhow::bail;
    use serde_json::Value;

    use super::*;

    fn has_tests(source: &Path) -> bool {
        let Ok(entries) = fs::read_dir(source) else {
            return fs::read_to_string(source).unwrap().contains("#[test]");
        };
        entries.into_iter().any(|entry| has_tests(&entry.unwrap().path()))
    }

    /// `cargo test --tests` silently ignores examples without `test = true`.
    #[test]
    fn examples_with_tests_say_so_in_their_manifest() {
        let packages = Workspace::from_env().unwrap().packages().unwrap();
        let targets = packages.iter().flat_map(|package| package["targets"].as_array().unwrap());
        let examples: Vec<&Value> =
            targets.filter(|target| target["kind"] == serde_json::json!(["example"])).collect();
        assert!(examples.len() >= 10, "{examples:?}");
        for example in examples {
            let path = Path::new(example["src_path"].as_str().unwrap());
            let source = if path.ends_with("main.rs") { path.parent().unwrap() } else { path };
            // `gripper-sim/tests/host.rs` includes this file and runs its test, which needs a server.
            let runs_elsewhere = path.ends_with("protocol/examples/quick_start.rs");
            assert_eq!(
                example["test"] == true || runs_elsewhere,
                has_tests(source),
                "`test` of the example {}",
                path.display()
            );
        }
    }

    #[test]
    fn the_summary_names_passed_failed_and_skipped_checks() {
        let mut record = Record::default();
        record.not_checked("format (no rustfmt)");
        record.check("size", || Ok(())).unwrap();
        let failed = record.check("docs", || -> Result<()> { bail!("x") }).is_err();

        let expected = "test: 1 passed (size), then one FAILED; the remaining checks did not all run; \
                        1 NOT CHECKED (format (no rustfmt))";
        assert_eq!(record.summary(failed), expected);
    }

    #[test]
    fn two_lists_are_recorded_together_and_either_can_fail() {
        let mut record = Record::default();
        let mut fails = |[one, other]: [bool; 2]| {
            let check = |is_ok: bool| is_ok.then_some(()).context("x");
            record.both(|it| it.check("one", || check(one)), |it| it.check("other", || check(other))).is_err()
        };
        assert_eq!([[false, true], [true, false], [true, true]].map(&mut fails), [true, true, false]);
        assert_eq!(record.passed, ["other", "one", "one", "other"]);
    }

    #[test]
    fn a_skipped_check_fails_only_a_strict_run() {
        let mut record = Record::default();
        assert!(record.verdict(true).is_ok());

        record.not_checked("instructions, NOT COMPARED with the baseline");

        assert!(record.verdict(false).is_ok());
        assert!(record.verdict(true).is_err());
    }
}
