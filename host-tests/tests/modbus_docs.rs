//! docs/registers.md says what the tables in the code say.
//!
//! `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test modbus_docs` writes the generated parts anew.

use bus_modbus::Function;
use host_tests::document::{hold, table};
use host_tests::modbus_bench::Bench;
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{
    FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS, START_SETTINGS, record_settings,
};
use wsg_protocol::SystemFlags;
use wsg_protocol::fieldbus::{
    CommandFlags, Content, GripperFlags, INPUT_REGISTERS, OUTPUT_REGISTERS, Register,
};

fn line() -> String {
    let bus = Config::DEFAULT.bus;
    let timing = bus.timing();
    table(
        ["what", "as delivered"],
        [
            ["rate".into(), format!("{} bit/s", bus.baud)],
            ["format".into(), bus.format.name().into()],
            ["unit".into(), bus.unit.to_string()],
            ["T1.5, T3.5".into(), format!("{} µs, {} µs", timing.t1_5_us, timing.t3_5_us)],
        ],
    )
}

fn functions() -> String {
    table(
        ["FC", "function", "what it reads or writes"],
        Function::ALL.map(|function| {
            let (name, what) = match function {
                Function::ReadCoils => ("Read Coils", "coils"),
                Function::ReadDiscreteInputs => ("Read Discrete Inputs", "discrete inputs"),
                Function::ReadHoldingRegisters => ("Read Holding Registers", "output image, settings"),
                Function::ReadInputRegisters => {
                    ("Read Input Registers", "input image, counters and versions")
                }
                Function::WriteSingleCoil => ("Write Single Coil", "a coil"),
                Function::WriteSingleRegister => ("Write Single Register", "output image, settings"),
                Function::Diagnostics => {
                    ("Diagnostics", "subfunctions 00, 01, 02, 04, 0Ah to 12h, 14h; not as a broadcast")
                }
                Function::WriteMultipleCoils => ("Write Multiple Coils", "coils, as one"),
                Function::WriteMultipleRegisters => {
                    ("Write Multiple Registers", "output image or settings, as one")
                }
                Function::ReportServerId => {
                    ("Report Server ID", "unit, FFh (it runs), product code and revision as text")
                }
                Function::MaskWriteRegister => ("Mask Write Register", "output image, settings"),
                Function::ReadWriteMultipleRegisters => {
                    ("Read/Write Multiple Registers", "writes first; output image, settings")
                }
                Function::EncapsulatedInterfaceTransport => (
                    "Read Device Identification (type 14)",
                    "vendor, product code, revision; no other objects",
                ),
            };
            [function.code().to_string(), name.into(), what.into()]
        }),
    )
}

fn registers(registers: &[Register]) -> String {
    table(
        ["register", "bytes", "name", "kind", "unit, bits"],
        registers.iter().enumerate().map(|(n, register)| {
            let kind = match register.content {
                Content::Bits => "bits",
                Content::Signed => "signed number",
                Content::Unsigned => "unsigned number",
            };
            [
                n.to_string(),
                format!("{}, {}", 2 * n, 2 * n + 1),
                register.name.into(),
                kind.into(),
                register.unit.into(),
            ]
        }),
    )
}

/// Names of bits, by the number of the first bit.
fn bits<'a>(parts: impl IntoIterator<Item = (usize, &'a str)>) -> String {
    table(["address", "bit"], parts.into_iter().map(|(address, name)| [address.to_string(), name.to_owned()]))
}

fn coils() -> String {
    let commands = CommandFlags::all().iter_names().map(|(name, flag)| {
        (
            flag.bits().trailing_zeros() as usize,
            name.replace("STOP_ACK", "STOP/ACK").replace("JOG_PLUS", "JOG+").replace("JOG_MINUS", "JOG-"),
        )
    });
    let users = (1..=8).map(|n| (7 + n, format!("IF{n}")));
    let all: Vec<_> = commands.chain(users).collect();
    bits(all.iter().map(|(address, name)| (*address, name.as_str())))
        + "| 16 to 63 | the bits of WIDTH, SPEED and FORCELIMIT, byte by byte |\n"
}

fn discrete_inputs() -> String {
    let states = GripperFlags::all()
        .iter_names()
        .map(|(name, flag)| (flag.bits().trailing_zeros() as usize, name.to_owned()));
    let users = (1..=8).map(|n| (7 + n, format!("OF{n}")));
    let system = SystemFlags::all()
        .iter_names()
        .map(|(name, flag)| (16 + flag.bits().trailing_zeros() as usize, format!("SYSSTATE {name}")));
    let all: Vec<_> = states.chain(users).chain(system).collect();
    bits(all.iter().map(|(address, name)| (*address, name.as_str())))
        + "| 48 to 95 | the bits of WIDTH, Gripping Force and Status Code, byte by byte |\n"
}

fn settings() -> String {
    // As a PLC reads them.
    let delivered = Bench::ready().holding(FIRST_SETTING, SETTINGS.len() as u8).unwrap();
    table(
        ["register", "name", "unit", "from", "to", "as delivered", "meaning"],
        (FIRST_SETTING..).zip(&SETTINGS).zip(delivered).map(|((address, setting), delivered)| {
            [
                address.to_string(),
                format!("`{}`", setting.name),
                setting.unit.into(),
                setting.least.to_string(),
                setting.most.to_string(),
                delivered.to_string(),
                setting.meaning.into(),
            ]
        }),
    )
}

fn start_settings() -> String {
    let delivered = Config::DEFAULT.record();
    table(
        ["name", "unit", "from", "to", "as delivered", "meaning"],
        START_SETTINGS.iter().zip(delivered).map(|(setting, delivered)| {
            [
                format!("`{}`", setting.name),
                setting.unit.into(),
                setting.least.to_string(),
                setting.most.to_string(),
                delivered.to_string(),
                setting.meaning.into(),
            ]
        }),
    )
}

fn reports() -> String {
    table(
        ["register", "name", "meaning"],
        (FIRST_REPORT..).zip(&REPORTS).map(|(address, report)| {
            [address.to_string(), format!("`{}`", report.name), report.meaning.into()]
        }),
    )
}

#[test]
fn registers_in_the_document_are_those_of_the_code() {
    for (name, wanted) in [
        ("line", line()),
        ("functions", functions()),
        ("output", registers(&OUTPUT_REGISTERS)),
        ("coils", coils()),
        ("input", registers(&INPUT_REGISTERS)),
        ("discrete", discrete_inputs()),
        ("settings", settings()),
        ("start-settings", start_settings()),
        ("reports", reports()),
    ] {
        hold("docs/registers.md", name, &wanted);
    }
}

#[test]
fn names_of_registers_are_unique() {
    let names: Vec<_> = record_settings()
        .map(|setting| setting.name)
        .chain(REPORTS.iter().map(|report| report.name))
        .collect();
    for (n, name) in names.iter().enumerate() {
        assert!(!names[n + 1..].contains(name), "{name}");
    }
}
