//! Strategies for requests, answers and almost valid lines.

use proptest::prelude::*;
use wsg_protocol::gcl::{
    Answer, Autosend, CommandName, Description, Filter, FingerReading, Grip, Move, Named, Release, Request,
    Select, Selected, Setting, Tare, Text, Topic, Value, Vector,
};
use wsg_protocol::{
    DeviceTag, FingerFlags, GripperState, GrippingStatistics, HomingDirection, Status, SystemFlags,
};

pub(crate) fn number() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |number| number.is_finite())
}

fn any_of<T: Clone + std::fmt::Debug + 'static>(values: &'static [T]) -> impl Strategy<Value = T> {
    (0..values.len()).prop_map(|index| values[index].clone())
}

fn select<const LEN: u8>() -> impl Strategy<Value = Select<LEN>> {
    prop_oneof![Just(Select::All), (0..LEN).prop_map(Select::One)]
}

fn setting() -> impl Strategy<Value = Setting> {
    prop_oneof![Just(Setting::Ask), number().prop_map(Setting::Set)]
}

fn autosend() -> impl Strategy<Value = Autosend> {
    (any_of(&Topic::ALL), any::<u32>(), proptest::option::of((number(), any::<bool>()))).prop_map(
        |(topic, interval_ms, filter)| {
            let filter = match filter {
                None => Filter::None,
                Some((delta, _)) if topic.is_measured() => Filter::Delta(delta.abs()),
                Some((_, unchanged)) => Filter::Unchanged(unchanged),
            };
            Autosend { topic, interval_ms, filter }
        },
    )
}

pub(crate) fn request() -> BoxedStrategy<Request> {
    prop_oneof![
        any::<bool>().prop_map(Request::Verbose),
        any_of(HomingDirection::ALL).prop_map(Request::Home),
        (number(), proptest::option::of(number()))
            .prop_map(|(width, speed)| Request::Move(Move { width, speed })),
        (0..4, number(), number(), number()).prop_map(|(count, force, width, speed)| {
            Request::Grip(match count {
                0 => Grip::Preset,
                1 => Grip::Force { force },
                2 => Grip::Part { force, width },
                _ => Grip::PartAtSpeed { force, width, speed },
            })
        }),
        (0..3, number(), number()).prop_map(|(count, distance, speed)| {
            Request::Release(match count {
                0 => Release::Preset,
                1 => Release::By { distance },
                _ => Release::ByAtSpeed { distance, speed },
            })
        }),
        setting().prop_map(Request::Pwt),
        setting().prop_map(Request::Clt),
        select().prop_map(Request::Sysflags),
        autosend().prop_map(Request::Autosend),
        prop_oneof![Just(Tare::All), (0..2u8).prop_map(Tare::Finger)].prop_map(Request::Tare),
        select().prop_map(Request::Gripstats),
        select().prop_map(Request::Fdata),
        select().prop_map(Request::Ftype),
        select().prop_map(Request::Fflags),
        any_of(&[
            Request::Bye,
            Request::Pos,
            Request::Speed,
            Request::Force,
            Request::Gripstate,
            Request::Devtype,
            Request::Version,
            Request::Sn,
            Request::Tag,
            Request::Temp,
            Request::Stop,
            Request::Faststop,
            Request::Fsack,
        ]),
    ]
    .boxed()
}

/// Texts that answers borrow.
#[derive(Clone, Debug)]
pub(crate) struct Texts {
    tag: String,
    text: String,
    description: String,
    vector: String,
    name: String,
}

pub(crate) fn texts() -> impl Strategy<Value = Texts> {
    (
        "[ -~]{0,64}",
        "[ !#-~]{0,40}",
        "[ -~äöü]{0,60}",
        "(-?[0-9]{1,3}(\\.[0-9])?|\\[[0-9,]{0,9}\\]|,){0,8}",
        "[A-Za-z][A-Za-z0-9_]{0,15}",
    )
        .prop_map(|(tag, text, description, vector, name)| Texts {
            tag,
            text,
            description,
            vector,
            name,
        })
}

fn selected<W: Clone, E: Clone, const LEN: u8>(at: u32, all: W, one: E) -> Selected<W, E, LEN> {
    match at % (u32::from(LEN) + 1) {
        0 => Selected::All(all),
        index => Selected::One((index - 1) as u8, one),
    }
}

/// The numbers that select and fill an answer.
pub(crate) type Numbers = (usize, u32, u32, f32, f32);

/// Generates numbers for an answer.
pub(crate) fn numbers() -> impl Strategy<Value = Numbers> {
    (any::<usize>(), any::<u32>(), any::<u32>(), number(), number())
}

fn value<'a>(texts: &'a Texts, (which, at, bits, first, second): Numbers) -> Value<'a> {
    let text = Text::new(&texts.text).unwrap();
    let reading = match bits % 3 {
        0 => FingerReading::Number(second),
        1 => FingerReading::Vector(Vector::EMPTY),
        _ => FingerReading::Vector(Vector::new(&texts.vector).unwrap()),
    };
    let system = SystemFlags::from_bits_retain(bits);
    let finger = FingerFlags::from_bits_retain(bits as u16);
    let statistics = GrippingStatistics { total: bits, no_part: bits as u16, part_lost: (bits >> 16) as u16 };
    match which % 18 {
        0 => Value::Verbose(bits & 1 == 1),
        1 => Value::Pwt(first),
        2 => Value::Clt(first),
        3 => Value::Pos(first),
        4 => Value::Speed(first),
        5 => Value::Force(first),
        6 => Value::Gripstate(GripperState::ALL[bits as usize % 8]),
        7 => Value::Devtype(text),
        8 => Value::Version(text),
        9 => Value::Sn(bits),
        10 => Value::Tag(DeviceTag::new(&texts.tag).unwrap()),
        11 => Value::Temp(first),
        12 => Value::Sysflags(selected(at, system, bits & 1 == 1)),
        13 => Value::Gripstats(selected(at, statistics, bits)),
        14 => Value::Fdata(selected(at, [FingerReading::Number(first), reading], reading)),
        15 => Value::Ftype(selected(at, [text, Text::default()], text)),
        16 => Value::Fflags(selected(at, [finger, !finger], finger)),
        _ => Value::Sysflags(Selected::All(system)),
    }
}

/// Builds an answer from texts and numbers.
pub(crate) fn answer<'a>(texts: &'a Texts, kind: u8, numbers: Numbers) -> Answer<'a> {
    let (which, _, bits, ..) = numbers;
    let pick = |wanted: fn(CommandName) -> bool| {
        let names: Vec<CommandName> = CommandName::ALL.iter().copied().filter(|name| wanted(*name)).collect();
        names[which % names.len()]
    };
    match kind % 5 {
        0 => Answer::Ack(pick(CommandName::is_acknowledged)),
        1 => Answer::Fin(pick(CommandName::is_finished)),
        2 => Answer::Err {
            name: match which % 3 {
                0 => Named::Command(pick(|_| true)),
                1 => Named::at_start_of(texts.name.as_bytes()),
                _ => Named::at_start_of(b""),
            },
            status: Status::from_code(bits as u16),
            description: Description::new(texts.description.as_bytes()),
        },
        3 => Answer::Value(value(texts, numbers)),
        _ => match value(texts, numbers) {
            update @ (Value::Pos(_)
            | Value::Speed(_)
            | Value::Force(_)
            | Value::Gripstate(_)
            | Value::Temp(_)
            | Value::Sysflags(Selected::All(_))) => Answer::Update(update),
            other => Answer::Value(other),
        },
    }
}

/// Generates a line with some bytes changed, removed, doubled or inserted.
pub(crate) fn mutated(line: String) -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![any::<u8>(), proptest::sample::select(b"()[],=?\"@ .-+0123456789eE".to_vec())];
    proptest::collection::vec((any::<proptest::sample::Index>(), 0..4u8, byte), 0..4).prop_map(
        move |changes| {
            let mut line = line.clone().into_bytes();
            for (at, change, byte) in changes {
                let at = at.index(line.len() + 1);
                match (change, line.get(at).copied()) {
                    (0, Some(_)) => line[at] = byte,
                    (1, Some(_)) => drop(line.remove(at)),
                    (2, Some(old)) => line.insert(at, old),
                    _ => line.insert(at, byte),
                }
            }
            line.retain(|byte| !matches!(byte, b'\n' | b'\r'));
            line
        },
    )
}
