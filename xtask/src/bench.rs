//! Benchmarks: instruction counts per core in the emulator, compared with a committed baseline; throughput and latency on the host.

use std::{collections::BTreeMap, fs, process::Command};

use anyhow::{Context, Result, ensure};
use boards::{BOARDS, Board, MACHINE};

use crate::{
    gate::{Gate, Unit},
    probe::Profile,
    process,
    setup::ThumbToolchain,
    workspace::Workspace,
};

const BASELINE: &str = "host-tests/probes/baseline.txt";

/// Permitted increase over the baseline in percent.
const TOLERANCE: u64 = 2;

/// Instruction limits per byte or per request: figure, count, and one limit per core.
///
/// Per frame byte: byte by byte at the released opt-level, and in bulk at opt-level 3. Per bus request with its response, for
/// PROFIBUS from the last character of the request to the first of the response.
const LIMITS: [(&str, &str, [f64; 2]); 4] = [
    ("per byte, byte by byte at 64 B of payload, as flashed", "Os/byte-path/64", [32.0, 40.0]),
    ("per byte, in bulk at 64 B of payload, opt-level 3", "O3/bulk-path/64", [10.0, 16.0]),
    ("of a MODBUS request for 8 registers", "O3/modbus-8-registers", [610.0, 830.0]),
    ("of PROFIBUS Data_Exchange to answer, as flashed", "Os/profibus-data-exchange", [4_000.0; 2]),
];

/// From the main-loop turn in which an edge is accepted to the first byte sent, in the released firmware, for each wire.
const EDGES: &str = "Os/edge-to-first-byte/";
/// The core clock of the board in MHz, which the benchmark reports beside its counts.
const EDGE_CLOCK: &str = "Os/edge-clock-mhz";
const EDGE_LIMIT_US: f64 = 50.0;
/// The same up to the last byte of a GRIP with known force limit, including the transmission time.
const GRIP: &str = "Os/edge-to-last-byte/grip";
const GRIP_LIMIT_US: f64 = 1_600.0;
const BYTE_US: f64 = 10.0 / 0.1152;
/// Assumed cycles per instruction, because the emulator counts instructions only. A turn of the main loop exceeds the flash cache,
/// and a cache miss costs four wait states. Entry to and return from three exceptions add 72 cycles. Not measured.
const CYCLES_PER_INSTRUCTION: f64 = 2.0;
const EXCEPTION_CYCLES: f64 = 72.0;

const THROUGHPUT_LIMIT: f64 = 1.0;
/// Minimum speed relative to a plain table loop in the same run.
const SPEED_UP_LIMIT: f64 = 2.5;
/// Maximum number of measurements on a machine that is too busy to reach the limits.
const ATTEMPTS: usize = 5;

/// A number of instructions, and the number of bytes or turns that it covers.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Count {
    instructions: u64,
    of: u64,
}

type Counts = BTreeMap<String, Count>;

/// The result of counting.
pub(crate) struct Counted {
    pub(crate) gates: Vec<Gate>,
    /// Why the counts were not compared with the baseline, if so.
    pub(crate) not_compared: Option<String>,
}

/// Counts instructions in the emulator, and compares them with the baseline or updates it.
pub(crate) fn counted(toolchain: &ThumbToolchain<'_>, update: bool) -> Result<Counted> {
    let mut counts = Counts::new();
    for (board, profile) in BOARDS.iter().flat_map(|board| Profile::ALL.map(|profile| (board, profile))) {
        // The first board of a core represents the others in everything but their drivers, which count as released.
        let is_first = cores().any(|first| first == board);
        if !is_first && profile.name != Profile::SIZE.name {
            continue;
        }
        let features = if has_edges(board) { board.name } else { "bench" };
        let elf = toolchain.build_probe(board.triple, "bench", features, profile)?;
        let mut qemu = qemu(&elf);
        let first = process::output(&mut qemu)?;
        ensure!(
            first == process::output(&mut qemu)?,
            "two runs differ; this emulator does not count instructions reliably"
        );
        let named = |name| count_name(board, &format!("O{}/{name}", profile.level));
        let counted = parse(&first)?.into_iter().map(|(name, count)| (named(name), count));
        counts.extend(counted.filter(|(name, _)| is_first || name.contains("/edge-")));
    }
    for (name, count) in &counts {
        let each = count.instructions as f64 / count.of as f64;
        println!("  {name:<32} {:>7} instructions, {each:.1} each", count.instructions);
    }
    Ok(Counted { not_compared: hold(toolchain, &counts, update)?, gates: gates(&counts)? })
}

/// Returns whether edges are counted with the drivers of this board: the emulator's machine has the peripherals that they use. Its
/// core also runs programs for the other cores, with the same number of instructions.
fn has_edges(board: &Board) -> bool {
    board.triple == <&Board>::default().triple
}

/// Returns the first board of each core, which represents the others with that core.
fn cores() -> impl Iterator<Item = &'static Board> {
    let is_first = |(n, board): &(usize, &Board)| !BOARDS[..*n].iter().any(|it| it.triple == board.triple);
    BOARDS.iter().enumerate().filter(is_first).map(|(_, board)| board)
}

/// Returns the name of a count of this board. The default board has no prefix.
fn count_name(board: &Board, name: &str) -> String {
    if board == <&Board>::default() { name.to_owned() } else { format!("{}/{name}", board.name) }
}

/// Figures of a program by name.
type Figures = BTreeMap<String, f64>;

/// Runs a program of a package on this machine until its gates hold, and uses the best of its runs, because other load only makes a
/// figure worse.
fn best_of_runs<G: AsRef<[Gate]>>(
    workspace: &Workspace,
    program: &str,
    at_least: usize,
    better: fn(f64, f64) -> f64,
    gates: fn(&Figures) -> G,
) -> Result<G> {
    let mut best = Figures::new();
    for run in 1.. {
        let mut cargo = workspace.cargo("run -q --release");
        for line in process::output(cargo.args(program.split(' ')))?.lines() {
            println!("  {line}");
            let (name, figure) = line.split_once(' ').context("expected a name and a figure")?;
            let figure: f64 = figure.parse().with_context(|| format!("`{line}` is not a figure"))?;
            best.entry(name.to_owned()).and_modify(|known| *known = better(*known, figure)).or_insert(figure);
        }
        if run >= ATTEMPTS || run >= at_least && gates(&best).as_ref().iter().all(Gate::holds) {
            break;
        }
    }
    Ok(gates(&best))
}

/// Measures bulk throughput on this machine in GB/s, absolute and relative to a plain loop, which depends less on the machine.
pub(crate) fn throughput(workspace: &Workspace) -> Result<[Gate; 2]> {
    best_of_runs(
        workspace,
        "-p wsg-probes --features throughput --bin throughput",
        1,
        f64::max,
        throughput_gates,
    )
}

fn throughput_gates(best: &Figures) -> [Gate; 2] {
    let [bulk, table_loop] = ["bulk-path", "table-loop"].map(|name| of(best, name));
    let what = "host throughput in bulk, 64 B payloads";
    let relative = bulk / table_loop;
    [
        Gate::new(what, bulk, THROUGHPUT_LIMIT, Unit::GIGABYTES_PER_SECOND),
        Gate::new("ratio to a plain table loop", relative, SPEED_UP_LIMIT, Unit::TIMES_AS_FAST),
    ]
}

/// Returns a figure, or one that exceeds every limit if it was not measured.
fn of(best: &Figures, name: &str) -> f64 {
    best.get(name).copied().unwrap_or(f64::NAN)
}

/// Clients whose query is compared with a bare socket: description, name in the program, and name of the bare socket.
const CLIENTS: [(&str, &str, &str); 3] = [
    ("blocking driver", "blocking", "bare"),
    ("tokio", "tokio", "bare"),
    ("blocking driver over GCL", "gcl", "bare-gcl"),
];
/// Maximum duration of a query relative to the bare socket.
const QUERY_LIMITS: [(&str, f64); 2] = [("median", 1.5), ("p99", 3.0)];
/// Maximum time in µs from the call of FAST STOP to the other end of the socket.
const FAST_STOP_LIMITS: [(&str, &str, f64); 2] = [
    ("`fast_stop()` of an idle driver to bytes at the peer", "fast-stop-idle-median", 100.0),
    (
        "`fast_stop()` of a handle, while the driver waits, to bytes at the peer",
        "fast-stop-handle-median",
        1_000.0,
    ),
];

/// Minimum number of runs. In a single run, the system may place a client and its server on two cores, where a query takes 45 µs
/// instead of 20.
const LATENCY_RUNS: usize = 3;

/// Measures the latency of the drivers over loopback TCP. Figures under load are printed without a limit, because they depend on the
/// scheduler.
pub(crate) fn latency(workspace: &Workspace) -> Result<Vec<Gate>> {
    best_of_runs(
        workspace,
        "-p wsg-probes --features latency --bin latency",
        LATENCY_RUNS,
        f64::min,
        latency_gates,
    )
}

fn latency_gates(best: &Figures) -> Vec<Gate> {
    let of = |name: &str| of(best, name);
    let mut gates = Vec::new();
    for (what, client, beside) in CLIENTS {
        let query = format!("query over loopback TCP, {what}, median");
        let median = of(&format!("query-{client}-median-load-0"));
        gates.push(Gate::new(query, median, f64::INFINITY, Unit::MICROSECONDS));
        for (statistic, limit) in QUERY_LIMITS {
            let [it, bare] = [client, beside].map(|name| of(&format!("query-{name}-{statistic}-load-0")));
            let what = format!("ratio to a bare socket, {what}, {statistic}");
            gates.push(Gate::new(what, it / bare, limit, Unit::TIMES_AS_LONG));
        }
    }
    for (what, name, limit) in FAST_STOP_LIMITS {
        gates.push(Gate::new(what, of(name), limit, Unit::MICROSECONDS));
    }
    gates.push(Gate::new(
        "processor time of a driver that waits for a motion",
        of("cpu"),
        1.0,
        Unit::PERCENT_OF_CORE,
    ));
    gates
}

/// Commands of a gateway, and their names in the program.
const GATEWAY_COMMANDS: [(&str, &str); 2] = [("a motion", "move"), ("FAST STOP", "fast-stop")];
/// Maximum time in µs from the write of a register to the command at the gripper's end of the socket.
const GATEWAY_LIMITS: [(&str, f64); 2] = [("median", 1_000.0), ("p99", 3_000.0)];

/// Measures `wsg gateway` on this machine: its commands beside a process that copies bytes, and ten grippers without a master.
pub(crate) fn gateway(workspace: &Workspace) -> Result<Vec<Gate>> {
    process::run(&mut workspace.cargo("build -q --release -p wsg-tool --bin wsg"))?;
    best_of_runs(workspace, "-p host-tests --example gateway_figures", 1, f64::min, gateway_gates)
}

fn gateway_gates(best: &Figures) -> Vec<Gate> {
    let mut gates = Vec::new();
    for (what, name) in GATEWAY_COMMANDS {
        for (statistic, limit) in GATEWAY_LIMITS {
            let gateway =
                format!("write over Modbus/TCP to {what} at the gripper, `wsg gateway`, {statistic}");
            let copied = format!("the same bytes through a copying process, beside {what}, {statistic}");
            for (what, path, limit) in [(gateway, "gateway", limit), (copied, "copied", f64::INFINITY)] {
                let measured = of(best, &format!("{path}-{name}-{statistic}"));
                gates.push(Gate::new(what, measured, limit, Unit::MICROSECONDS));
            }
        }
    }
    let cpu = "processor time of an idle gateway with ten grippers";
    gates.push(Gate::new(cpu, of(best, "idle-cpu"), 2.0, Unit::PERCENT_OF_CORE));
    let memory = "memory of an idle gateway with ten grippers";
    gates.push(Gate::new(memory, of(best, "idle-memory"), 20.0 * 1024.0 * 1024.0, Unit::BYTES));
    gates
}

fn qemu(elf: &std::path::Path) -> Command {
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-M", MACHINE]);
    qemu.args("-display none -monitor none -serial null -no-reboot".split(' '));
    qemu.args(["-icount", "shift=10", "-semihosting-config", "enable=on,target=native", "-kernel"]).arg(elf);
    qemu
}

fn gates(counts: &Counts) -> Result<Vec<Gate>> {
    let of = |name: &str| {
        let found = counts.iter().filter(|(counted, _)| counted.starts_with(name)).map(|(_, count)| *count);
        let longest = found.max_by_key(|count| count.instructions);
        longest.with_context(|| format!("the benchmark did not count {name}"))
    };
    let mut gates = Vec::new();
    for (core, board) in cores().enumerate() {
        for (what, name, limits) in LIMITS {
            let Count { instructions, of } = of(&count_name(board, name))?;
            let unit = if of > 1 { Unit::INSTRUCTIONS_PER_BYTE } else { Unit::INSTRUCTIONS };
            let what = board.figure(&format!("instructions {what}"));
            gates.push(Gate::new(what, instructions as f64 / of as f64, limits[core], unit));
        }
    }
    for board in BOARDS.iter().filter(|board| has_edges(board)) {
        let of = |name| of(&count_name(board, name));
        let clock_mhz = of(EDGE_CLOCK)?.instructions as f64;
        let us = |count: Count| {
            (count.instructions as f64 * CYCLES_PER_INSTRUCTION + EXCEPTION_CYCLES) / clock_mhz
        };
        let first = board.figure("PLC edge to first byte, debounced");
        gates.push(Gate::new(first, us(of(EDGES)?), EDGE_LIMIT_US, Unit::MICROSECONDS));
        let grip = "PLC edge to the last byte of GRIP at 115 200 bit/s, debounced, force limit known";
        let grip_us = us(of(GRIP)?) + of(GRIP)?.of as f64 * BYTE_US;
        gates.push(Gate::new(board.figure(grip), grip_us, GRIP_LIMIT_US, Unit::MICROSECONDS));
    }
    Ok(gates)
}

/// Compares the counts with the baseline. Returns the reason if it was created with another compiler.
fn hold(toolchain: &ThumbToolchain<'_>, counts: &Counts, update: bool) -> Result<Option<String>> {
    let path = toolchain.workspace.root.join(BASELINE);
    let version = process::answer(toolchain.rustc().arg("--version"));
    let compiler = version.context("rustc does not report its version")?.trim().to_owned();
    if update {
        let text = baseline_text(&compiler, counts);
        fs::write(&path, text).with_context(|| format!("cannot write {BASELINE}"))?;
        println!("  {BASELINE} updated");
        return Ok(None);
    }
    let text = fs::read_to_string(&path).with_context(|| format!("cannot read {BASELINE}"))?;
    let counted_with = text.lines().next().unwrap_or_default().trim_start_matches("# ");
    if counted_with != compiler {
        let why =
            format!("NOT COMPARED with {BASELINE}: it was created with {counted_with}, this is {compiler}");
        println!("  {why}; the limits still apply");
        return Ok(Some(why));
    }
    let worse = worse_than(&parse(&text)?, counts);
    ensure!(worse.is_empty(), "slower than {BASELINE} by more than {TOLERANCE} %: {}", worse.join(", "));
    println!("  within {TOLERANCE} % of {BASELINE} (update it with `cargo xtask bench --update`)");
    Ok(None)
}

fn baseline_text(compiler: &str, counts: &Counts) -> String {
    let lines =
        counts.iter().map(|(name, Count { instructions, of })| format!("{name} {instructions} {of}\n"));
    [format!("# {compiler}\n")].into_iter().chain(lines).collect()
}

/// Parses lines of a name, a number of instructions and what they cover.
fn parse(text: &str) -> Result<Counts> {
    let count = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, instructions, of] = words[..] else { return None };
        Some((name.to_owned(), Count { instructions: instructions.parse().ok()?, of: of.parse().ok()? }))
    };
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    lines.map(|line| count(line).with_context(|| format!("`{line}` is not a count"))).collect()
}

/// Returns the counts that exceed the baseline or are missing from it.
fn worse_than(baseline: &Counts, counts: &Counts) -> Vec<String> {
    let worse = |(name, count): (&String, &Count)| match baseline.get(name) {
        Some(before) if count.instructions * 100 <= before.instructions * (100 + TOLERANCE) => None,
        Some(before) => Some(format!("{name} {} instead of {}", count.instructions, before.instructions)),
        None => Some(format!("{name} is missing from it")),
    };
    counts.iter().filter_map(worse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASELINE: &str = "# rustc 1.95.0\nO3/bulk-path/64 700 72\nOs/edge-to-first-byte/move 1000 1\n";

    #[test]
    fn two_percent_more_than_the_baseline_is_accepted_and_no_more() {
        let baseline = parse(BASELINE).unwrap();
        let with = |instructions| {
            let mut counts = baseline.clone();
            counts.insert("O3/bulk-path/64".into(), Count { instructions, of: 72 });
            worse_than(&baseline, &counts)
        };

        assert_eq!(with(714), [""; 0]);
        assert_eq!(with(715), ["O3/bulk-path/64 715 instead of 700"]);
        assert_eq!(with(300), [""; 0]);
    }

    #[test]
    fn a_count_missing_from_the_baseline_is_reported() {
        let counts = parse("new 1 1").unwrap();
        assert_eq!(worse_than(&Counts::new(), &counts), ["new is missing from it"]);
    }

    #[test]
    fn a_baseline_is_read_as_it_is_written() {
        let counts = parse(BASELINE).unwrap();
        assert_eq!(baseline_text("rustc 1.95.0", &counts), BASELINE);
        assert!(parse("nonsense").is_err());
    }

    /// Returns the figures that a program prints.
    fn figures(output: &str) -> Figures {
        let figures = output.lines().map(|line| line.split_once(' ').unwrap());
        figures.map(|(name, figure)| (name.to_owned(), figure.parse().unwrap())).collect()
    }

    #[test]
    fn unmeasured_or_too_low_throughput_is_past_its_limit() {
        let holds = |output| throughput_gates(&figures(output)).map(|gate| gate.holds());

        assert_eq!(holds(""), [false, false]);
        assert_eq!(holds("bulk-path 1.0\ntable-loop 0.4"), [true, true]);
        assert_eq!(holds("bulk-path 0.9\ntable-loop 0.3"), [false, true]);
        assert_eq!(holds("bulk-path 1.2\ntable-loop 0.5"), [true, false]);
    }

    #[test]
    fn latency_past_its_limit_or_not_measured_fails() {
        let failing = |output: &str| {
            let gates = latency_gates(&figures(output)).into_iter().filter(|gate| !gate.holds());
            gates.map(|gate| gate.what).collect::<Vec<_>>()
        };
        let of = |client: &str, median, p99| {
            format!("query-{client}-median-load-0 {median}\nquery-{client}-p99-load-0 {p99}\n")
        };
        let rest = "fast-stop-idle-median 99\nfast-stop-handle-median 999\ncpu 0.5\n";
        let bare = of("bare", 10.0, 20.0) + &of("bare-gcl", 10.0, 20.0) + rest;
        let within = ["blocking", "tokio", "gcl"].map(|client| of(client, 15.0, 60.0)).concat();
        let slow = of("blocking", 16.0, 20.0) + &of("tokio", 10.0, 61.0) + &of("gcl", 10.0, 20.0);

        assert_eq!(failing(&(bare.clone() + &within)), [""; 0]);
        let beside = "ratio to a bare socket";
        let expected = [format!("{beside}, blocking driver, median"), format!("{beside}, tokio, p99")];
        assert_eq!(failing(&(bare + &slow)), expected);
        assert_eq!(failing("").len(), latency_gates(&Figures::new()).len());
    }

    #[test]
    fn gateway_past_its_limit_or_not_measured_fails() {
        let failing =
            |output: &str| gateway_gates(&figures(output)).iter().filter(|gate| !gate.holds()).count();
        let of = |path: &str, name: &str| format!("{path}-{name}-median 1000\n{path}-{name}-p99 3000\n");
        let paths =
            [("gateway", "move"), ("gateway", "fast-stop"), ("copied", "move"), ("copied", "fast-stop")];
        let within = paths.map(|(path, name)| of(path, name)).concat() + "idle-cpu 2\nidle-memory 20971520\n";

        assert_eq!(failing(&within), 0);
        assert_eq!(failing(&within.replace("3000", "3001")), 2);
        assert_eq!(failing(&within.replace("cpu 2", "cpu 2.01")), 1);
        assert_eq!(failing(""), gateway_gates(&Figures::new()).len());
    }

    #[test]
    fn slow_byte_path_request_and_edge_are_past_their_limits() {
        let counts = parse(
            "O3/byte-path/64 100 72\nOs/byte-path/64 2305 72\nO3/bulk-path/64 700 72\n\
             O3/modbus-8-registers 611 1\nOs/profibus-data-exchange 4001 1\nOs/edge-to-first-byte/move 4000 1\n\
             Os/edge-to-last-byte/grip 4000 18\nOs/edge-clock-mhz 80 1\nnucleo-g474re/Os/edge-clock-mhz 144 1\n\
             nucleo-g474re/Os/edge-to-first-byte/move 3500 1\nnucleo-g474re/Os/edge-to-last-byte/grip 4000 17\n\
             pico/Os/byte-path/64 2880 72\npico/O3/bulk-path/64 1153 72\n\
             pico/O3/modbus-8-registers 611 1\npico/Os/profibus-data-exchange 4000 1",
        );
        let gates = gates(&counts.unwrap()).unwrap();

        let failed = crate::gate::check(&gates).unwrap_err().to_string();
        assert_eq!(
            failed,
            "past the limit: instructions per byte, byte by byte at 64 B of payload, as flashed, instructions of a MODBUS \
             request for 8 registers, instructions of PROFIBUS Data_Exchange to answer, as flashed, instructions per byte, in \
             bulk at 64 B of payload, opt-level 3, pico, PLC edge to first byte, \
             debounced, PLC edge to the last byte of GRIP at 115 200 bit/s, debounced, force limit known"
        );
    }
}
