//! Checks the tables in docs/can.md against the code, and the bus load of a full configuration.
//!
//! `WSG_UPDATE_DOCS=1 cargo test -p host-tests --test can_docs` updates the generated parts.

use document::{hold, table};
use host_tests::plc_names::{command_flags, gripper_flags};
use wsg_bridge_fw::can::{BusOffPolicy, DEFAULT_NODE, NodeConfig};
use wsg_bridge_fw::plc::canopen::{DataType, FAULTS, INPUT_INDEX, OBJECTS, OUTPUT_INDEX};
use wsg_protocol::can::{HALF_MESSAGE_MS, Identifiers, Segments};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, FrameEncoder, GripperState, Payload, Reply, Status, SystemFlags, Value,
};

const NODE: NodeConfig = DEFAULT_NODE;

fn identifiers() -> String {
    let pair = Identifiers::DEFAULT.controller();
    let node = u16::from(NODE.node);
    let row = |id: u16, sum: &str, what: &str, from: &str| {
        [format!("{id:03X}h"), sum.to_owned(), what.to_owned(), from.to_owned()]
    };
    let of_node = |base: u16, what: &str, from: &str| {
        row(base | node, &format!("{base:03X}h + `CAN_NODE`"), what, from)
    };
    table(
        ["default", "identifier", "content", "sender"],
        [
            row(0, "000h", "NMT", "master"),
            row(0x080, "080h", "SYNC, for PDOs that wait for it", "master"),
            of_node(0x080, "EMCY", "bridge"),
            row(pair.transmit.as_raw(), "`CAN_ID`", "messages to the gripper", "bridge"),
            row(pair.receive.as_raw(), "`CAN_ID` + 1", "messages from the gripper", "gripper"),
            of_node(0x180, "TPDO1: GSTATE, OF, SYSSTATE, Status Code", "bridge"),
            of_node(0x200, "RPDO1: the output image", "master"),
            of_node(0x280, "TPDO2: WIDTH, Gripping Force", "bridge"),
            of_node(0x580, "SDO answers", "bridge"),
            of_node(0x600, "SDO requests", "master"),
            of_node(0x700, "heartbeat, boot-up", "bridge"),
            row(0x700 | u16::from(NODE.master), "700h + `CAN_MASTER`", "heartbeat of the master", "master"),
        ],
    )
}

/// Returns the table of PDO mappings from the dictionary.
fn pdos() -> String {
    let fields = |index: u16, order: &[u8]| {
        let mut at = 0;
        let mut rows = Vec::new();
        for &sub in order {
            let object = OBJECTS.iter().find(|object| (object.index, object.sub) == (index, sub)).unwrap();
            let len = object.kind.len();
            let bytes = if len == 1 { at.to_string() } else { format!("{at} to {}", at + len - 1) };
            let kind = match object.kind {
                DataType::U8 => "UNSIGNED8",
                DataType::U16 => "UNSIGNED16",
                DataType::U32 => "UNSIGNED32",
                DataType::I16 => "INTEGER16",
                DataType::Text | DataType::Domain => unreachable!("only numbers are mapped"),
            };
            rows.push((bytes, object.name, kind, format!("{index:04X}h, {sub}")));
            at += len;
        }
        rows
    };
    let pdos = [
        ("RPDO1", fields(OUTPUT_INDEX, &[1, 2, 3, 4, 5])),
        ("TPDO1", fields(INPUT_INDEX, &[1, 2, 3, 6])),
        ("TPDO2", fields(INPUT_INDEX, &[4, 5])),
    ];
    let rows = pdos.into_iter().flat_map(|(pdo, rows)| {
        rows.into_iter().map(move |(bytes, name, kind, object)| {
            [pdo.to_owned(), bytes, name.to_owned(), kind.to_owned(), object]
        })
    });
    table(["PDO", "bytes", "field", "type", "object"], rows)
}

/// Returns the table of bits in the two flag bytes.
fn flag_bytes() -> String {
    table(
        ["bit", "hexadecimal", "CMDFLAGS (RPDO1, byte 0)", "GSTATE (TPDO1, byte 0)"],
        command_flags().into_iter().zip(gripper_flags()).map(|(command, state)| {
            assert_eq!(command.bit, state.bit);
            [command.bit.to_string(), format!("{:02X}h", 1 << command.bit), command.name, state.name]
        }),
    )
}

fn times() -> String {
    let policy = BusOffPolicy::DEFAULT;
    let ms = |ms: u32| format!("{ms} ms");
    table(
        ["time", "default", "setting"],
        [
            ["heartbeat of the bridge".into(), ms(NODE.heartbeat_ms.into()), "1017h".into()],
            ["EMCY: minimum interval".into(), ms(u32::from(NODE.emergency_inhibit) / 10), "1015h".into()],
            ["TPDO1: minimum, maximum interval".into(), pdo_times(0), "1800h, 3 and 5".into()],
            ["TPDO2: minimum, maximum interval".into(), pdo_times(1), "1801h, 3 and 5".into()],
            [
                "time-out of the master".into(),
                ms(wsg_bridge_fw::Config::DEFAULT.bus.timeout_ms.into()),
                "1016h, or BUS_TIMEOUT".into(),
            ],
            [
                "time-out of an incomplete message from the gripper".into(),
                ms(HALF_MESSAGE_MS),
                "fixed".into(),
            ],
            ["bus-off: delay before recovery".into(), ms(policy.delay_ms), "fixed".into()],
            [
                "bus-off: failures before recovery is abandoned".into(),
                policy.limit.to_string(),
                "fixed".into(),
            ],
            [
                "bus-off: stable time after which failures are cleared".into(),
                ms(policy.stable_ms),
                "fixed".into(),
            ],
        ],
    )
}

fn pdo_times(number: usize) -> String {
    format!("{} ms, {} ms", f64::from(NODE.inhibit[number]) / 10.0, NODE.event_ms[number])
}

fn faults() -> String {
    let row = |fault: &wsg_bridge_fw::plc::canopen::Fault| {
        [format!("{:04X}h", fault.code), format!("{:02X}h", fault.register | 1), fault.meaning.to_owned()]
    };
    table(["code", "error register", "fault"], FAULTS.iter().map(row))
}

/// Bits of a data frame with an 11-bit identifier and worst-case stuffing, including the interframe space. 34 bits and
/// the data are subject to stuffing, at most one bit in four after the first.
fn worst_bits(len: usize) -> usize {
    47 + 8 * len + (34 + 8 * len - 1) / 4
}

/// Worst-case bits of a message over CAN.
fn message_bits<P: Payload>(id: u8, payload: P) -> usize {
    Segments::new(FrameEncoder::new(id, payload)).map(|segment| worst_bits(segment.data().len())).sum()
}

/// Traffic sources during a motion, with default settings. PDOs are counted at their inhibit time, their highest rate.
fn load() -> Vec<(String, usize, bool, bool)> {
    let per_second = |period_ms: usize| 1_000 / period_ms;
    let update = usize::from(AutoUpdate::MIN_PERIOD_MS);
    let state = message_bits(0x40, Reply::success(Value::GetSystemState(SystemFlags::empty())))
        + message_bits(0x41, Reply::success(Value::GetGripperState(GripperState::Idle)));
    let measured = message_bits(0x43, Reply::success(Value::GetOpeningWidth(0.0)))
        + message_bits(0x45, Reply::success(Value::GetForce(0.0)));
    let refresh = usize::try_from(wsg_bridge_fw::Config::DEFAULT.session.refresh_ms).unwrap();
    let asked = AutoUpdate::on_change(AutoUpdate::MIN_PERIOD_MS);
    let subscription = message_bits(0x40, Command::GetSystemState { update: asked });
    let limit = message_bits(0x33, Command::GetForceLimit)
        + message_bits(0x33, Reply::success(Value::GetForceLimit(0.0)));
    let grip = Command::GripPart { width: 0.0, speed: 0.0 };
    let motion = message_bits(0x32, Command::SetForceLimit { force: 0.0 })
        + message_bits(0x32, Reply::status_only(CommandId::SetForceLimit, Status::Success))
        + message_bits(0x25, grip)
        + 2 * message_bits(0x25, Reply::status_only(CommandId::GripPart, Status::CmdPending));
    let pdo = |number: usize, len: usize| worst_bits(len) * 10_000 / usize::from(NODE.inhibit[number]);
    // Source, bits per second, whether it belongs to the gripper, whether it sends at rest.
    vec![
        (
            "gripper: updates of state and system state every 10 ms".into(),
            state * per_second(update),
            true,
            false,
        ),
        (
            "gripper: updates of width and force every 10 ms".into(),
            measured * per_second(update),
            true,
            false,
        ),
        (
            format!("gripper: states, width and force polled every {refresh} ms"),
            (4 * subscription + state + measured) * per_second(refresh),
            true,
            true,
        ),
        (
            format!("gripper: force limit polled every {} ms", refresh / 2),
            limit * per_second(refresh / 2),
            true,
            true,
        ),
        ("gripper: one Grip Part per second, after a force limit".into(), motion, true, false),
        (format!("PLC: TPDO1, every {} ms", NODE.inhibit[0] / 10), pdo(0, 8), false, false),
        (format!("PLC: TPDO2, every {} ms", NODE.inhibit[1] / 10), pdo(1, 4), false, false),
        (
            "PLC: TPDO1 and TPDO2 at rest".into(),
            2 * worst_bits(8) * per_second(NODE.event_ms[0].into()),
            false,
            true,
        ),
        ("PLC: RPDO1, every 10 ms".into(), worst_bits(8) * per_second(10), false, true),
        (
            "PLC: two heartbeats".into(),
            worst_bits(1) * (per_second(NODE.heartbeat_ms.into()) + per_second(200)),
            false,
            true,
        ),
    ]
}

const RATES: [usize; 4] = [125_000, 250_000, 500_000, 1_000_000];

fn percent(bits: usize, rate: usize) -> String {
    format!("{:.1}", bits as f64 * 100.0 / rate as f64)
}

/// Returns the table of the bus load. The messages of the gripper have no setting, so only their sum has a row.
fn bus_load() -> String {
    let load = load();
    let sum = |which: fn(&(String, usize, bool, bool)) -> bool| -> usize {
        load.iter().filter(|row| which(row)).map(|row| row.1).sum()
    };
    let of_plc = load.iter().filter(|row| !row.2);
    let mut rows: Vec<(String, usize)> = of_plc.map(|row| (row.0.clone(), row.1)).collect();
    rows.push(("**gripper alone, during a grip**".into(), sum(|row| row.2)));
    rows.push(("**PLC alone, during a grip**".into(), sum(|row| !row.2)));
    rows.push(("**both, during a grip**".into(), sum(|_| true)));
    rows.push(("**both, at rest**".into(), sum(|row| row.3)));
    let row = |(what, bits): (String, usize)| {
        let [a, b, c, d] = RATES.map(|rate| percent(bits, rate));
        [what, bits.to_string(), a, b, c, d]
    };
    table(["traffic", "bit/s", "% of 125 kbit/s", "250", "500", "1000"], rows.into_iter().map(row))
}

#[test]
fn worst_frames_are_as_long_as_the_literature_says() {
    // 8 data bytes: 111 bits without stuffing, including the interframe space of 3, and 24 stuff bits.
    assert_eq!((worst_bits(0), worst_bits(8)), (55, 135));
}

#[test]
fn everything_at_once_fits_at_500_kbit_s() {
    let sum: usize = load().iter().map(|row| row.1).sum();
    assert!(sum * 100 / 500_000 < 70, "{sum} bit/s");
}

#[test]
fn tables_in_the_document_are_those_of_the_code() {
    for (name, made) in [
        ("identifiers", identifiers()),
        ("pdos", pdos()),
        ("flags", flag_bytes()),
        ("times", times()),
        ("faults", faults()),
        ("load", bus_load()),
    ] {
        hold("docs/can.md", name, &made);
    }
}
