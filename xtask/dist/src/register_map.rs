//! The registers as comma-separated values (RFC 4180), for PLC tools and spreadsheets.

use host_tests::plc_names::{command_flags, gripper_flags, system_flags};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS,
};
use wsg_fieldbus::{Content, INPUT_REGISTERS, OUTPUT_REGISTERS, Register};

const HEAD: [&str; 10] =
    ["table", "address", "number", "name", "access", "unit", "minimum", "maximum", "default", "meaning"];

/// Name of a Modbus table, and the offset that PLC tools add to its addresses.
#[derive(Clone, Copy)]
struct Table(&'static str, u32);

const COILS: Table = Table("coil", 1);
const DISCRETE_INPUTS: Table = Table("discrete input", 10_001);
const INPUT: Table = Table("input register", 30_001);
const HOLDING: Table = Table("holding register", 40_001);

type Row = [String; 10];

/// Returns all named registers, coils and discrete inputs.
pub(crate) fn csv() -> String {
    let mut text = line(&HEAD.map(str::to_owned));
    rows().iter().for_each(|row| text.push_str(&line(row)));
    text
}

fn rows() -> Vec<Row> {
    let mut rows = images();
    let settings = SETTINGS.iter().zip(Config::DEFAULT.record());
    for (address, (setting, delivered)) in (u32::from(FIRST_SETTING)..).zip(settings) {
        let limits = [setting.least.to_string(), setting.most.to_string()];
        let value = delivered.to_string();
        rows.push(row(
            HOLDING,
            address,
            setting.name,
            "read, write",
            setting.unit,
            limits,
            &value,
            setting.meaning,
        ));
    }
    for (address, command) in (u32::from(FIRST_COMMAND)..).zip(&COMMANDS) {
        let key = [COMMAND_KEY.to_string(), COMMAND_KEY.to_string()];
        rows.push(row(HOLDING, address, command.name, "write", "", key, "", command.meaning));
    }
    for (address, report) in (u32::from(FIRST_REPORT)..).zip(&REPORTS) {
        rows.push(row(INPUT, address, report.name, "read", "", none(), "", report.meaning));
    }
    rows
}

/// Returns the rows of both images, as registers and as bits.
fn images() -> Vec<Row> {
    let mut rows = Vec::new();
    for (table, access, registers) in
        [(HOLDING, "read, write", &OUTPUT_REGISTERS[..]), (INPUT, "read", &INPUT_REGISTERS[..])]
    {
        for (address, register) in (0..).zip(registers) {
            let Register { name, unit, .. } = *register;
            let limits = match register.content {
                Content::Bits => none(),
                Content::Unsigned => [u16::MIN.to_string(), u16::MAX.to_string()],
                Content::Signed => [i16::MIN.to_string(), i16::MAX.to_string()],
            };
            rows.push(row(table, address, name, access, unit, limits, "", ""));
        }
    }
    let bits = [
        (COILS, "read, write", 0, command_flags()),
        (DISCRETE_INPUTS, "read", 0, gripper_flags()),
        (DISCRETE_INPUTS, "read", 16, system_flags()),
    ];
    for (table, access, first, flags) in bits {
        for flag in flags {
            let limits = ["0".to_owned(), "1".to_owned()];
            rows.push(row(table, first + flag.bit, &flag.name, access, "", limits, "", &flag.meaning));
        }
    }
    rows
}

fn none() -> [String; 2] {
    [String::new(), String::new()]
}

#[expect(clippy::too_many_arguments, reason = "the columns of a row")]
fn row(
    table: Table,
    address: u32,
    name: &str,
    access: &str,
    unit: &str,
    [least, most]: [String; 2],
    delivered: &str,
    meaning: &str,
) -> Row {
    [
        table.0.to_owned(),
        address.to_string(),
        format!("{:05}", address + table.1),
        name.to_owned(),
        access.to_owned(),
        unit.to_owned(),
        least,
        most,
        delivered.to_owned(),
        meaning.to_owned(),
    ]
}

fn line(row: &Row) -> String {
    let fields = row.each_ref().map(|field| {
        if field.contains(['"', ',', '\n']) {
            format!("\"{}\"", field.replace('"', "\"\""))
        } else {
            field.clone()
        }
    });
    fields.join(",") + "\r\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_tests::world::modbus::Master;

    #[test]
    fn settings_are_those_that_a_master_reads() {
        let mut rig = Master::ready();
        let settings: Vec<Row> = rows().into_iter().filter(|row| !row[8].is_empty()).collect();
        assert_eq!(settings.len(), SETTINGS.len());
        for row in settings {
            let address = row[1].parse().unwrap();
            let read = rig.holding(address, 1).unwrap();
            assert_eq!(read[0].to_string(), row[8], "{}", row[3]);
        }
    }

    #[test]
    fn every_register_has_one_row_and_none_is_left_out() {
        let rows = rows();
        let of = |table: Table| -> Vec<u32> {
            rows.iter().filter(|row| row[0] == table.0).map(|row| row[1].parse().unwrap()).collect()
        };
        let run = |first: u16, len: usize| (first.into()..).take(len);
        let holding: Vec<u32> = run(0, OUTPUT_REGISTERS.len())
            .chain(run(FIRST_SETTING, SETTINGS.len()))
            .chain(run(FIRST_COMMAND, COMMANDS.len()))
            .collect();
        let input: Vec<u32> = run(0, INPUT_REGISTERS.len()).chain(run(FIRST_REPORT, REPORTS.len())).collect();
        assert_eq!((of(HOLDING), of(INPUT)), (holding, input));
        assert_eq!(of(COILS), Vec::from_iter(0..8));
    }

    #[test]
    fn fields_with_commas_and_quotes_are_quoted() {
        let mut fields: Row = Default::default();
        fields[0] = "a, b".to_owned();
        fields[1] = "say \"c\"".to_owned();
        assert_eq!(line(&fields), "\"a, b\",\"say \"\"c\"\"\",,,,,,,,\r\n");
        assert!(csv().is_ascii(), "spreadsheets guess the encoding of other characters");
    }
}
