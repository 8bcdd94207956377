//! Checks the tables of commands and finger flags in docs/protocol.md.

use document::{hold, read, table};
use wsg_protocol::{Command, CommandId, FingerFlags, Frame, Reply, Status};

const DOCUMENT: &str = "docs/protocol.md";

/// The payload layout of each type in the command table: in words, and its least and greatest length in bytes.
const LAYOUTS: [(&str, &str, usize, usize); 17] = [
    ("f32", "f32", 4, 4),
    ("bool", "u8 (D0)", 1, 1),
    ("LoopData<'a>", "0 to 256 bytes", 0, 256),
    ("HomingDirection", "u8 (0 as set, 1 positive, 2 negative)", 1, 1),
    ("PrePositionFlags", "u8 (D0 relative, D1 stop on block)", 1, 1),
    ("AckKey", "`ack`", 3, 3),
    ("SoftLimits", "minus f32 mm, plus f32 mm", 8, 8),
    ("AutoUpdate", "flags u8 (D0 automatic, D1 on change), period u16 ms", 3, 3),
    ("DeviceTag<'a>", "0 to 64 ASCII characters", 0, 64),
    ("SystemFlags", "flags u32", 4, 4),
    ("GripperState", "state u8", 1, 1),
    ("GrippingStatistics", "grips u32, without part u16, part lost u16", 8, 8),
    ("Temperature", "i16, 0.1 °C", 2, 2),
    (
        "SystemInfo",
        "type u8 (1 WSG 50, 2 WSG 32, 5 WSG 25, 6 WSG 70), revision u8, firmware u16 (D15 to D12 major, D11 to D4 minor), serial number u32",
        8,
        8,
    ),
    (
        "SystemLimits",
        "8 × f32: stroke, speed from, to, acceleration from, to, force from, nominal, overdrive",
        32,
        32,
    ),
    ("FingerInfo", "type u8 (0 generic or none, 1 WSG-FMF, 2 WSG-DSA), bytes of data u16", 3, 3),
    ("FingerFlags", "flags u16", 2, 2),
];
/// A type limited only by the longest message.
const FINGER_DATA: &str = "FingerData<'a>";

/// A row of the command table, as parsed from its source.
pub(super) struct Row {
    pub(super) id: CommandId,
    /// Name, type, unit.
    pub(super) request: Vec<(String, String, String)>,
    /// Type and unit.
    pub(super) reply: Option<(String, String)>,
}

/// Parses protocol/src/table.rs: `id Name "title" "section" Kind request { .. } reply (..) ..;`. Layouts are not public
/// and are therefore read from the source. A test below checks their lengths against the code.
pub(super) fn rows() -> Vec<Row> {
    let source = read("protocol/src/table.rs");
    let lines = source.lines().map(str::trim).filter(|line| !line.starts_with("//"));
    let text = lines.skip_while(|line| !line.starts_with("0x")).collect::<Vec<_>>().join(" ");
    let rows = text.split(';').map(str::trim).filter(|row| row.starts_with("0x"));
    rows.map(|row| {
        let (code, rest) = row[2..].split_once(' ').unwrap();
        let id = CommandId::from_code(u8::from_str_radix(code, 16).unwrap());
        let (request, reply) = rest.split_once(" request ").unwrap().1.split_once("reply").unwrap();
        let fields = request.trim().trim_start_matches('{').trim_end_matches('}').split(',');
        let request = fields.filter(|field| !field.trim().is_empty()).map(|field| {
            let (name, rest) = field.split_once(':').unwrap();
            let (kind, unit) = rest.split_once('=').unwrap();
            (name.trim().to_owned(), kind.trim().to_owned(), unit.trim().trim_matches('"').to_owned())
        });
        let reply = reply.split("immediate").next().unwrap().trim();
        let reply = reply.strip_prefix('(').map(|reply| {
            let (kind, unit) = reply.trim_end_matches(')').split_once(" = ").unwrap_or((reply, ""));
            (kind.trim_end_matches(')').to_owned(), unit.trim_matches('"').to_owned())
        });
        Row { id, request: request.collect(), reply }
    })
    .collect()
}

fn layout(kind: &str) -> (&'static str, usize, usize) {
    if kind == FINGER_DATA {
        return ("any bytes", 0, usize::MAX);
    }
    let (_, words, least, most) = LAYOUTS.iter().find(|layout| layout.0 == kind).unwrap();
    (words, *least, *most)
}

fn request_words(row: &Row) -> String {
    let word = |(name, kind, unit): &(String, String, String)| match layout(kind).0 {
        "f32" => format!("{name} f32 {unit}").trim_end().to_owned(),
        words if kind == "bool" => format!("{name} {words}"),
        words => words.to_owned(),
    };
    row.request.iter().map(word).collect::<Vec<_>>().join(", ")
}

fn reply_words(row: &Row) -> String {
    row.reply
        .as_ref()
        .map_or_else(String::new, |(kind, unit)| format!("{} {unit}", layout(kind).0).trim_end().to_owned())
}

fn statuses(list: &[Status]) -> String {
    list.iter().map(|status| status.symbol()).collect::<Vec<_>>().join(", ")
}

#[test]
fn commands_in_the_document_are_those_of_the_code() {
    let rows = rows();
    assert!(
        rows.iter().map(|row| &row.id).eq(CommandId::ALL),
        "the rows of table.rs differ from CommandId::ALL; check the parser of this test"
    );
    let layouts = table(
        ["id", "name", "manual", "kind", "request", "reply after E_SUCCESS"],
        rows.iter().map(|row| {
            let id = row.id;
            [
                format!("{:02X}h", id.code()),
                id.name().to_owned(),
                id.section().to_owned(),
                format!("{:?}", id.kind()).to_lowercase(),
                request_words(row),
                reply_words(row),
            ]
        }),
    );
    hold(DOCUMENT, "commands", &layouts);
    // Commands with the same status codes share a row.
    let mut answers: Vec<[String; 3]> = Vec::new();
    for id in CommandId::ALL {
        let code = format!("{:02X}h", id.code());
        let (first, second) = (statuses(id.immediate_statuses()), statuses(id.completion_statuses()));
        if let Some(row) = answers.iter_mut().find(|row| row[1] == first && row[2] == second) {
            row[0] += &format!(", {code}");
        } else {
            answers.push([code, first, second]);
        }
    }
    hold(DOCUMENT, "answers", &table(["id", "first answer", "second answer"], answers));
}

/// The document has a sentence instead of a column.
#[test]
fn repeatable_commands_are_those_of_the_document() {
    for id in CommandId::ALL {
        let kind = format!("{:?}", id.kind());
        let is_repeatable = *id == CommandId::Loop || ["Query", "Setting", "Stop"].contains(&&kind[..]);
        assert_eq!(id.is_repeatable(), is_repeatable, "{id}");
    }
    let sentence = "You may repeat an unanswered query, setting, stop or Loop.";
    assert!(read(DOCUMENT).contains(sentence), "{DOCUMENT} must contain: {sentence}");
}

/// Each finger flag and its meaning.
const FINGER_FLAGS: [(FingerFlags, &str); 6] = [
    (FingerFlags::POWER_ON, "the finger is powered"),
    (FingerFlags::CONFIG_AVAIL, "the finger provides configuration data"),
    (FingerFlags::COMM_OPEN, "a communication interface is open"),
    (FingerFlags::POWER_FAULT, "over-current was detected"),
    (FingerFlags::COMM_FAULT, "communication failed at run time"),
    (FingerFlags::INIT_FAULT, "the finger failed to initialize"),
];

#[test]
fn finger_flags_in_the_document_are_those_of_the_code() {
    let named = FingerFlags::all().iter_names().map(|(name, flag)| {
        let (_, meaning) = FINGER_FLAGS.iter().find(|(other, _)| *other == flag).expect("a meaning");
        [flag.bits().trailing_zeros().to_string(), name.to_owned(), (*meaning).to_owned()]
    });
    hold(DOCUMENT, "finger flags", &table(["bit", "name", "meaning"], named));
}

#[test]
fn layouts_in_the_document_are_as_long_as_the_code_says() {
    /// A length above every payload except a finger's data.
    const LONGEST: usize = 300;
    let lengths = |kinds: &[&String]| {
        let sum = |add: fn((&str, usize, usize)) -> usize| {
            kinds.iter().fold(0usize, |sum, kind| sum.saturating_add(add(layout(kind))))
        };
        sum(|layout| layout.1)..=sum(|layout| layout.2)
    };
    for row in rows() {
        let id = row.id.code();
        let request = lengths(&row.request.iter().map(|(_, kind, _)| kind).collect::<Vec<_>>());
        let reply = lengths(&row.reply.iter().map(|(kind, _)| kind).collect::<Vec<_>>());
        for length in 0..LONGEST {
            // The key is the only request that zeros cannot form, and a tag ends before its zeros.
            let mut payload = match row.id {
                CommandId::Acknowledge => b"ack".repeat(LONGEST),
                CommandId::SetDeviceTag => vec![b' '; LONGEST],
                _ => vec![0; LONGEST],
            };
            payload.truncate(length);
            let taken = Command::decode(&Frame { id, payload: &payload }).is_ok();
            assert_eq!(taken, request.contains(&length), "{} request, {length} bytes", row.id);

            let fill = if row.id == CommandId::GetDeviceTag { b' ' } else { 0 };
            let mut payload = vec![fill; 2 + length];
            payload[..2].fill(0);
            let taken = Reply::decode(&Frame { id, payload: &payload }).is_ok();
            assert_eq!(taken, reply.contains(&length), "{} reply, {length} bytes", row.id);
        }
    }
}
