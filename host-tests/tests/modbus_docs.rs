//! Checks the tables in docs/registers.md against the code.
//!
//! `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test modbus_docs` updates the generated parts.

use bus_modbus::Function;
use document::{hold, table};
use host_tests::plc_names::{command_flags, gripper_flags, register_bit};
use host_tests::world::modbus::Master;
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, EVENTS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, FIRST_START_SETTING,
    MAP_VERSION, REPORTS, SETTINGS, Setting,
};
use wsg_fieldbus::{Content, INPUT_REGISTERS, OUTPUT_REGISTERS, Register};

fn line() -> String {
    let bus = Config::DEFAULT.bus;
    let timing = bus.timing();
    table(
        ["parameter", "default"],
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
        ["FC", "function", "access"],
        Function::ALL.map(|function| {
            let (name, what) = match function {
                Function::ReadCoils => ("Read Coils", "coils"),
                Function::ReadDiscreteInputs => ("Read Discrete Inputs", "discrete inputs"),
                Function::ReadHoldingRegisters => {
                    ("Read Holding Registers", "output image, settings; commands read as 0")
                }
                Function::ReadInputRegisters => {
                    ("Read Input Registers", "input image, counters and versions")
                }
                Function::WriteSingleCoil => ("Write Single Coil", "a coil"),
                Function::WriteSingleRegister => {
                    ("Write Single Register", "output image, settings, commands")
                }
                Function::Diagnostics => {
                    ("Diagnostics", "subfunctions 00, 01, 02, 04, 0Ah to 12h, 14h; not as a broadcast")
                }
                Function::WriteMultipleCoils => ("Write Multiple Coils", "coils, together"),
                Function::WriteMultipleRegisters => {
                    ("Write Multiple Registers", "output image or settings, together; one command")
                }
                Function::ReportServerId => {
                    ("Report Server ID", "unit, FFh (running), product code and revision as text")
                }
                Function::WriteFileRecord => {
                    ("Write File Record", "an image for an update; not as a broadcast")
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

/// Base addresses in PLC tools that count from 1 and prefix the number of the table.
const COILS: u32 = 1;
const DISCRETE_INPUTS: u32 = 10_001;
const INPUT: u32 = 30_001;
const HOLDING: u32 = 40_001;

/// Returns an address counted from 0 and in the notation of these tools.
fn both(address: u32, base: u32) -> [String; 2] {
    [address.to_string(), format!("{:05}", address + base)]
}

fn addresses() -> String {
    let tables = [
        ("coils", COILS),
        ("discrete inputs", DISCRETE_INPUTS),
        ("input registers", INPUT),
        ("holding registers", HOLDING),
    ];
    table(
        ["table", "first address", "in PLC tools that count from 1"],
        tables.map(|(name, base)| {
            let [address, numbered] = both(0, base);
            [name.to_owned(), address, numbered]
        }),
    )
}

fn registers(base: u32, registers: &[Register]) -> String {
    table(
        ["address", &format!("{base}-based"), "name", "kind", "unit, bits"],
        (0..).zip(registers).map(|(n, register)| {
            let kind = match register.content {
                Content::Bits => "bits",
                Content::Signed => "signed number",
                Content::Unsigned => "unsigned number",
            };
            let more = match register.name {
                "SYSSTATE" => ": [all of them](states.md#sysstate)",
                "Status Code" => ": [all codes](states.md#status-codes)",
                _ => "",
            };
            let [address, numbered] = both(n, base);
            [address, numbered, register.name.into(), kind.into(), format!("{}{more}", register.unit)]
        }),
    )
}

/// Returns a first and a last number as a range.
fn range(first: &impl std::fmt::Display, last: &impl std::fmt::Display) -> String {
    format!("{first} to {last}")
}

/// Returns the bits of both images by address: coils and discrete inputs, with their masks in register 0.
fn bits() -> String {
    let mask = |bit| {
        let (register, mask) = register_bit(bit);
        assert_eq!(register, 0);
        format!("{mask:04X}h")
    };
    let flags = command_flags().into_iter().zip(gripper_flags()).map(|(command, state)| {
        assert_eq!(command.bit, state.bit);
        [command.bit.to_string(), mask(command.bit), command.name, state.name]
    });
    let user_flags = [range(&8, &15), range(&mask(8), &mask(15)), "IF1 to IF8".into(), "OF1 to OF8".into()];
    // Each register has 16 bits.
    let values = [
        (16, 47, "WIDTH, SPEED", "SYSSTATE, D0 to D31"),
        (48, 63, "FORCELIMIT", "WIDTH"),
        (64, 95, "", "Gripping Force, Status Code"),
    ]
    .map(|(first, last, coils, inputs)| {
        [range(&first, &last), String::new(), coils.to_owned(), inputs.to_owned()]
    });
    table(
        ["address", "mask in register 0", "coil", "discrete input"],
        flags.chain([user_flags]).chain(values),
    )
}

/// Returns the table of settings with their default values. The recipes after the first have one row, with the rule for their addresses.
fn settings_table(settings: &[((u16, &'static Setting), u16)]) -> String {
    let is_further = |name: &str| name.starts_with("RECIPE") && !name.starts_with("RECIPE0_");
    let further: Vec<_> = settings.iter().filter(|it| is_further(it.0.1.name)).collect();
    let rows = settings.iter().filter_map(|((address, setting), delivered)| {
        if is_further(setting.name) {
            let ([first, ..], [.., last]) = (&further[..], &further[..]) else { unreachable!() };
            let rule = "as for recipe 0; [default values](wiring.md#recipes)".to_owned();
            let names = format!("`{}` to `{}`", first.0.1.name, last.0.1.name);
            let [unit, least, most, delivered] = [(); 4].map(|()| String::new());
            let row = [range(address, &last.0.0), names, unit, least, most, delivered, rule];
            return (setting.name == first.0.1.name).then_some(row);
        }
        Some([
            address.to_string(),
            format!("`{}`", setting.name),
            setting.unit.into(),
            setting.least.to_string(),
            setting.most.to_string(),
            delivered.to_string(),
            setting.meaning.into(),
        ])
    });
    table(["address", "name", "unit", "minimum", "maximum", "default", "meaning"], rows)
}

/// Returns all settings with their default register values.
fn delivered() -> Vec<((u16, &'static Setting), u16)> {
    let mut rig = Master::ready();
    let delivered = (FIRST_SETTING..).zip(&SETTINGS).map(|it| (it, rig.holding(it.0, 1).unwrap()[0]));
    delivered.collect()
}

fn settings() -> String {
    settings_table(&delivered()[..FIRST_START_SETTING])
}

fn start_settings() -> String {
    settings_table(&delivered()[FIRST_START_SETTING..])
}

fn commands() -> String {
    table(
        ["address", "name", "value", "effect"],
        (FIRST_COMMAND..).zip(&COMMANDS).map(|(address, command)| {
            let key = format!("{COMMAND_KEY} ({COMMAND_KEY:04X}h)");
            [address.to_string(), format!("`{}`", command.name), key, command.meaning.into()]
        }),
    )
}

fn reports() -> String {
    table(
        ["address", "name", "meaning"],
        // All recent events have the same layout; only the first is described.
        (FIRST_REPORT..).zip(&REPORTS).filter(|(_, report)| !report.meaning.is_empty()).map(
            |(address, report)| {
                let value = if report.name == "MAP_VERSION" {
                    format!(": {MAP_VERSION} here")
                } else {
                    String::new()
                };
                [address.to_string(), format!("`{}`", report.name), format!("{}{value}", report.meaning)]
            },
        ),
    )
}

fn events() -> String {
    table(
        ["code", "name", "event", "value", "remedy"],
        EVENTS.iter().map(|event| {
            [
                (event.code as u8).to_string(),
                format!("`{}`", event.name),
                event.meaning.into(),
                event.value.into(),
                event.remedy.into(),
            ]
        }),
    )
}

#[test]
fn registers_in_the_document_are_those_of_the_code() {
    for (name, wanted) in [
        ("line", line()),
        ("addresses", addresses()),
        ("functions", functions()),
        ("output", registers(HOLDING, &OUTPUT_REGISTERS)),
        ("input", registers(INPUT, &INPUT_REGISTERS)),
        ("bits", bits()),
        ("settings", settings()),
        ("start-settings", start_settings()),
        ("commands", commands()),
        ("reports", reports()),
        ("events", events()),
    ] {
        hold("docs/registers.md", name, &wanted);
    }
}

#[test]
fn names_of_registers_are_unique() {
    let names: Vec<_> = SETTINGS
        .iter()
        .map(|setting| setting.name)
        .chain(COMMANDS.iter().map(|command| command.name))
        .chain(REPORTS.iter().map(|report| report.name))
        .collect();
    for (n, name) in names.iter().enumerate() {
        assert!(!names[n + 1..].contains(name), "{name}");
    }
}
