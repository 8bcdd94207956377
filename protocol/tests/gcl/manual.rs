//! Every line printed in the GCL manual, in both directions.

use wsg_protocol::gcl::{
    Answer, Autosend, CommandName, FingerReading, Grip, LineEvent, LineReader, Move, Named, Release, Request,
    Select, Selected, Setting, Tare, Text, Topic, Value, Vector,
};
use wsg_protocol::{
    DeviceTag, DeviceType, FingerFlags, FingerType, FirmwareVersion, GripperState, GrippingStatistics,
    HomingDirection, Status, SystemFlags,
};

/// Asserts that `typed` parses to `request`, which is written as `written`.
fn request(typed: &str, request: Request, written: &str) {
    assert_eq!(Request::parse(typed.as_bytes()), Ok(request), "{typed}");
    assert_eq!(request.to_string(), written);
    assert_eq!(Request::parse(written.as_bytes()), Ok(request), "{written}");
}

/// Asserts that `line` parses to `answer`, which is written the same.
fn answer(line: &str, answer: Answer<'_>) {
    assert_eq!(Answer::parse(line.as_bytes()), Ok(answer), "{line}");
    assert_eq!(answer.to_string(), line);
}

fn value(line: &str, value: Value<'_>) {
    answer(line, Answer::Value(value));
}

fn text(text: &str) -> Text<'_> {
    Text::new(text).unwrap()
}

#[test]
fn lower_and_mixed_case_is_understood_and_upper_case_is_written() {
    let to_50 = Request::Move(Move { width: 50.0, speed: None });
    for typed in ["move(50)", "MOVE(50)", "mOve(50)"] {
        request(typed, to_50, "MOVE(50.0)");
    }
}

#[test]
fn connection_commands_of_chapter_2_1() {
    request("VERBOSE=1", Request::Verbose(true), "VERBOSE=1");
    value("VERBOSE=0", Value::Verbose(false));
    request("BYE()", Request::Bye, "BYE()");
    answer("ACK BYE", Answer::Ack(CommandName::Bye));
}

#[test]
fn motion_commands_of_chapter_2_2() {
    request("HOME()", Request::Home(HomingDirection::Default), "HOME()");
    request("HOME(1)", Request::Home(HomingDirection::Positive), "HOME(1)");
    request("HOME(0)", Request::Home(HomingDirection::Negative), "HOME(0)");
    let faster = Request::Move(Move { width: 50.0, speed: Some(200.0) });
    request("MOVE(50, 200)", faster, "MOVE(50.0,200.0)");
    request("GRIP()", Request::Grip(Grip::Preset), "GRIP()");
    request("GRIP(40)", Request::Grip(Grip::Force { force: 40.0 }), "GRIP(40.0)");
    let part = Grip::Part { force: 40.0, width: 20.5 };
    request("GRIP(40, 20.5)", Request::Grip(part), "GRIP(40.0,20.5)");
    let slowly = Grip::PartAtSpeed { force: 40.0, width: 20.5, speed: 50.0 };
    request("GRIP(40, 20.5, 50)", Request::Grip(slowly), "GRIP(40.0,20.5,50.0)");
    request("RELEASE()", Request::Release(Release::Preset), "RELEASE()");
    request("RELEASE(5)", Request::Release(Release::By { distance: 5.0 }), "RELEASE(5.0)");
    let fast = Release::ByAtSpeed { distance: 5.0, speed: 100.0 };
    request("RELEASE(5, 100)", Request::Release(fast), "RELEASE(5.0,100.0)");
    for name in [CommandName::Home, CommandName::Move, CommandName::Grip, CommandName::Release] {
        answer(&format!("ACK {name}"), Answer::Ack(name));
        answer(&format!("FIN {name}"), Answer::Fin(name));
        assert_eq!(Answer::Ack(name).status(), Status::CmdPending);
        assert_eq!(Answer::Fin(name).status(), Status::Success);
    }
    request("PWT?", Request::Pwt(Setting::Ask), "PWT?");
    request("PWT=2.5", Request::Pwt(Setting::Set(2.5)), "PWT=2.5");
    value("PWT=2.5", Value::Pwt(2.5));
    request("CLT?", Request::Clt(Setting::Ask), "CLT?");
    request("CLT=3", Request::Clt(Setting::Set(3.0)), "CLT=3.0");
    value("CLT=3.0", Value::Clt(3.0));
}

#[test]
fn state_queries_of_chapter_2_3() {
    request("POS?", Request::Pos, "POS?");
    value("POS=20.0", Value::Pos(20.0));
    request("SPEED?", Request::Speed, "SPEED?");
    value("SPEED=142.0", Value::Speed(142.0));
    request("FORCE?", Request::Force, "FORCE?");
    value("FORCE=23.0", Value::Force(23.0));
    request("GRIPSTATE?", Request::Gripstate, "GRIPSTATE?");
    value("GRIPSTATE=4", Value::Gripstate(GripperState::Holding));
}

#[test]
fn gripper_states_of_appendix_d_are_0_to_7() {
    for state in GripperState::ALL {
        value(&format!("GRIPSTATE={}", state.code()), Value::Gripstate(*state));
    }
    assert!(Answer::parse(b"GRIPSTATE=8").is_err());
    assert!(Answer::parse(b"GRIPSTATE=256").is_err());
}

#[test]
fn system_queries_of_chapter_3_1() {
    request("DEVTYPE?", Request::Devtype, "DEVTYPE?");
    value("DEVTYPE=\"WSG 32-068\"", Value::Devtype(text("WSG 32-068")));
    assert_eq!(text("WSG 32-068").device_type(), DeviceType::Wsg32);
    request("VERSION?", Request::Version, "VERSION?");
    value("VERSION=\"1.0.0\"", Value::Version(text("1.0.0")));
    assert_eq!(text("1.0.0").firmware_version(), Some(FirmwareVersion::new(1, 0, 0, 0)));
    request("SN?", Request::Sn, "SN?");
    value("SN=12345678", Value::Sn(12_345_678));
    request("TAG?", Request::Tag, "TAG?");
    request("TEMP?", Request::Temp, "TEMP?");
    value("TEMP=34.2", Value::Temp(34.2));
}

#[test]
fn version_is_three_numbers_and_a_release_candidate_or_unknown() {
    let version = |version: &str| text(version).firmware_version();
    assert_eq!(version("4.0.0-rc2"), Some(FirmwareVersion::new(4, 0, 0, 2)));
    assert_eq!(version("15.15.15"), Some(FirmwareVersion::new(15, 15, 15, 0)));
    let known = FirmwareVersion::new(2, 6, 4, 1);
    assert_eq!(version(&known.to_string()), Some(known));
    for unknown in
        ["", "4", "4.0", "4.0.0.0", "16.0.0", "4.0.x", "4.0.0-rc", "4.0.0-rc16", "4. 0.0", "4.0.0-beta"]
    {
        assert_eq!(version(unknown), None, "{unknown}");
    }
}

#[test]
fn tag_is_written_as_tag_and_also_understood_as_devtag() {
    let tag = Answer::Value(Value::Tag(DeviceTag::new("Meine Beschreibung").unwrap()));
    answer("TAG=\"Meine Beschreibung\"", tag);
    assert_eq!(Answer::parse(b"DEVTAG=\"Meine Beschreibung\""), Ok(tag));
}

#[test]
fn tag_may_hold_quotation_marks_and_keeps_its_blanks_and_case() {
    let tag = DeviceTag::new(" \"left\" Hand ").unwrap();
    value("TAG=\" \"left\" Hand \"", Value::Tag(tag));
}

#[test]
fn system_flags_of_chapter_3_1_5_are_ordered_by_index() {
    request("SYSFLAGS?", Request::Sysflags(Select::All), "SYSFLAGS?");
    request("SYSFLAGS[12]?", Request::Sysflags(Select::One(12)), "SYSFLAGS[12]?");
    let flags = SystemFlags::REFERENCED | SystemFlags::FAST_STOP;
    let vector: Vec<&str> = (0..32).map(|index| if index == 0 || index == 12 { "1" } else { "0" }).collect();
    value(&format!("SYSFLAGS=[{}]", vector.join(",")), Value::Sysflags(Selected::All(flags)));
    value("SYSFLAGS[12]=1", Value::Sysflags(Selected::One(12, true)));
}

#[test]
fn up_to_32_system_flags_are_understood_and_more_are_refused() {
    let all = |flags| Ok(Answer::Value(Value::Sysflags(Selected::All(flags))));
    assert_eq!(Answer::parse(b"SYSFLAGS=[1,0,0]"), all(SystemFlags::REFERENCED));
    let zeros = |count| format!("SYSFLAGS=[{}]", vec!["0"; count].join(", "));
    assert_eq!(Answer::parse(zeros(32).as_bytes()), all(SystemFlags::empty()));
    assert!(Answer::parse(zeros(33).as_bytes()).is_err());
    assert!(Answer::parse(b"SYSFLAGS=[]").is_err());
}

#[test]
fn autosend_of_chapter_3_1_7() {
    let every = Autosend::every(Topic::Pos, 10);
    request("AUTOSEND(\"POS\",10)", Request::Autosend(every), "AUTOSEND(\"POS\",10)");
    let by_two = Autosend::by(Topic::Pos, 10, 2.0);
    request("AUTOSEND(\"POS\",10, 2)", Request::Autosend(by_two), "AUTOSEND(\"POS\",10,2.0)");
    let on_change = Autosend::on_change(Topic::Sysflags, 20);
    request("AUTOSEND(\"sysflags\",20, 1)", Request::Autosend(on_change), "AUTOSEND(\"SYSFLAGS\",20,1)");
    let off = Autosend::off(Topic::Temp);
    request("AUTOSEND(\"TEMP\",0)", Request::Autosend(off), "AUTOSEND(\"TEMP\",0)");
    answer("ACK AUTOSEND", Answer::Ack(CommandName::Autosend));
    answer("@POS=20.0", Answer::Update(Value::Pos(20.0)));
    answer("@FORCE=23.0", Answer::Update(Value::Force(23.0)));
    answer("@SPEED=142.0", Answer::Update(Value::Speed(142.0)));
    answer("@GRIPSTATE=6", Answer::Update(Value::Gripstate(GripperState::Positioning)));
    answer("@TEMP=34.2", Answer::Update(Value::Temp(34.2)));
    let flags = Selected::All(SystemFlags::MOVING);
    let zeros = vec!["0"; 30].join(",");
    answer(&format!("@SYSFLAGS=[0,1,{zeros}]"), Answer::Update(Value::Sysflags(flags)));
}

#[test]
fn every_signal_can_be_subscribed_to_in_every_way_that_suits_it() {
    for topic in Topic::ALL {
        for autosend in [Autosend::every(topic, 10), Autosend::on_change(topic, 10), Autosend::off(topic)] {
            let written = Request::Autosend(autosend).to_string();
            assert_eq!(Request::parse(written.as_bytes()), Ok(Request::Autosend(autosend)), "{written}");
        }
    }
}

#[test]
fn only_topics_of_autosend_are_accepted_as_updates() {
    for line in ["@SN=1", "@SYSFLAGS[3]=1", "@ACK MOVE", "@PWT=1.0", "@"] {
        assert!(Answer::parse(line.as_bytes()).is_err(), "{line}");
    }
}

#[test]
fn stops_of_chapter_3_2() {
    for (line, command) in
        [("STOP()", Request::Stop), ("FASTSTOP()", Request::Faststop), ("FSACK()", Request::Fsack)]
    {
        request(line, command, line);
        answer(&format!("ACK {}", command.name()), Answer::Ack(command.name()));
        assert_eq!(Answer::Ack(command.name()).status(), Status::Success, "completed");
    }
    // The manual calls code 19 E_AXIS_STOPPED here, but E_CMD_ABORTED in its own table.
    answer("ERR MOVE 19", Answer::failed(CommandName::Move, Status::CmdAborted));
    answer("ERR MOVE 16", Answer::failed(CommandName::Move, Status::AccessDenied));
}

#[test]
fn tare_and_statistics_of_chapter_3_3() {
    request("TARE()", Request::Tare(Tare::All), "TARE()");
    request("TARE(1)", Request::Tare(Tare::Finger(1)), "TARE(1)");
    answer("ACK TARE", Answer::Ack(CommandName::Tare));
    request("GRIPSTATS?", Request::Gripstats(Select::All), "GRIPSTATS?");
    request("GRIPSTATS[2]?", Request::Gripstats(Select::One(2)), "GRIPSTATS[2]?");
    let statistics = GrippingStatistics { total: 70_000, no_part: 3, part_lost: 1 };
    value("GRIPSTATS=[70000,3,1]", Value::Gripstats(Selected::All(statistics)));
    value("GRIPSTATS[0]=70000", Value::Gripstats(Selected::One(0, 70_000)));
}

#[test]
fn fingers_of_chapter_3_4() {
    request("FDATA?", Request::Fdata(Select::All), "FDATA?");
    request("FDATA[0]?", Request::Fdata(Select::One(0)), "FDATA[0]?");
    let tactile = match Answer::parse(b"FDATA[1]=[[0,12],[3,4]]").unwrap() {
        Answer::Value(Value::Fdata(Selected::One(1, reading @ FingerReading::Vector(_)))) => reading,
        other => panic!("{other:?}"),
    };
    value("FDATA[1]=[[0,12],[3,4]]", Value::Fdata(Selected::One(1, tactile)));
    let vector = Vector::new("[0,12],[3, -0.5e1]").unwrap();
    assert_eq!(vector.as_str(), "[0,12],[3, -0.5e1]");
    assert_eq!(vector.numbers().collect::<Vec<_>>(), [0.0, 12.0, 3.0, -5.0]);
    assert_eq!(Vector::EMPTY.numbers().count(), 0);
    let both = [FingerReading::Number(12.5), tactile];
    value("FDATA=[12.5,[[0,12],[3,4]]]", Value::Fdata(Selected::All(both)));

    request("FTYPE?", Request::Ftype(Select::All), "FTYPE?");
    request("FTYPE[1]?", Request::Ftype(Select::One(1)), "FTYPE[1]?");
    value("FTYPE=[\"WSG-FMF\",\"\"]", Value::Ftype(Selected::All([text("WSG-FMF"), text("")])));
    value("FTYPE[0]=\"WSG-DSA\"", Value::Ftype(Selected::One(0, text("WSG-DSA"))));
    for (name, finger) in [
        ("WSG-FMF", FingerType::Fmf),
        ("WSG-DSA", FingerType::Dsa),
        ("WSG-LONG", FingerType::Generic),
        ("FM", FingerType::Generic),
        ("", FingerType::Generic),
    ] {
        assert_eq!((text(name).finger_type(), text(name).as_str()), (finger, name));
    }

    request("FFLAGS?", Request::Fflags(Select::All), "FFLAGS?");
    request("FFLAGS[0]?", Request::Fflags(Select::One(0)), "FFLAGS[0]?");
    let flags = FingerFlags::POWER_ON | FingerFlags::INIT_FAULT;
    let vector = "1,0,0,0,0,0,0,0,0,0,1,0,0,0,0,0";
    value(&format!("FFLAGS[0]=[{vector}]"), Value::Fflags(Selected::One(0, flags)));
    let none = vec!["0"; 16].join(",");
    let both = [flags, FingerFlags::empty()];
    value(&format!("FFLAGS=[[{vector}],[{none}]]"), Value::Fflags(Selected::All(both)));
}

#[test]
fn errors_of_chapter_1_3_with_and_without_a_text() {
    answer("ERR GRIP 18", Answer::failed(CommandName::Grip, Status::CmdFailed));
    let Ok(Answer::Err { name, status, description: Some(description) }) =
        Answer::parse("ERR GRIP 18 Fehler während der Ausführung".as_bytes())
    else {
        panic!("not parsed as an error with a text");
    };
    assert_eq!((name, status), (Named::Command(CommandName::Grip), Status::CmdFailed));
    assert_eq!(description.to_string(), "Fehler während der Ausführung");
    // In another character set, the code matters and not the text.
    assert!(Answer::parse(b"ERR GRIP 18 Ausf\xFChrung").is_ok());
    answer("ERR ? 15", Answer::parse(b"ERR ? 15").unwrap());
}

#[test]
fn every_status_code_of_appendix_a_occurs_in_an_error() {
    for status in Status::ALL {
        answer(&format!("ERR MOVE {}", status.code()), Answer::failed(CommandName::Move, *status));
    }
    answer("ERR MOVE 999", Answer::failed(CommandName::Move, Status::Unknown(999)));
}

#[test]
fn lines_end_in_lf_when_written_and_in_lf_cr_or_both_when_read() {
    let mut buffer = [0; 16];
    let length = Request::Home(HomingDirection::Default).write_line_into(&mut buffer).unwrap();
    assert_eq!(&buffer[..length], b"HOME()\n");
    for end in ["\n", "\r", "\r\n"] {
        let mut reader = LineReader::<16>::new();
        let typed = format!("HOME(){end}");
        let (_, event) = reader.push_slice(typed.as_bytes());
        assert_eq!(event, Some(LineEvent::Line(b"HOME()")));
        assert_eq!(reader.finish(), None);
    }
}

#[test]
fn table_holds_the_commands_of_the_manual_in_its_order() {
    let names: Vec<&str> = CommandName::ALL.iter().map(|name| name.text()).collect();
    let manual = "VERBOSE BYE HOME MOVE GRIP RELEASE PWT CLT POS SPEED FORCE GRIPSTATE DEVTYPE VERSION SN TAG \
                  SYSFLAGS TEMP AUTOSEND STOP FASTSTOP FSACK TARE GRIPSTATS FDATA FTYPE FFLAGS";
    assert_eq!(names, manual.split_whitespace().collect::<Vec<_>>());
    assert!(CommandName::ALL.is_sorted_by_key(|name| name.section()));
    for name in CommandName::ALL {
        assert_eq!(name.is_acknowledged(), name.value_forms().is_empty(), "{name}: one kind of answer");
        assert_eq!(name.is_finished(), name.kind() == wsg_protocol::Kind::Motion, "{name}");
    }
}
