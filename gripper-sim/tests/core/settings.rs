//! Settings, device information, fingers, temperature, faults and flags (command set, 3.3 to 3.6 and appendix B).

use crate::common::{Rig, go_to, grip, release, texts};
use wsg_protocol::{
    Command, CommandId, DeviceTag, FingerFlags, GripperState, HomingDirection, LoopData, SoftLimits, Status,
    SystemFlags, Value,
};
use wsg_sim::{Config, Fault, Finger, Jaw, Model, Part, Tag};

fn raw(rig: &mut Rig, id: u8, payload: &[u8]) -> Status {
    rig.send_raw(id, payload);
    let frames = rig.frames();
    assert_eq!(frames.len(), 1);
    assert_eq!(frames[0].id(), id);
    frames[0].status()
}

#[test]
fn loop_returns_its_data() {
    let mut rig = Rig::new(Config::default());
    for len in [0, 1, 8, 256] {
        let data = vec![0xFF; len];
        let sent = rig.ask(Command::Loop { data: LoopData::new(&data).unwrap() });
        sent.with(|reply| assert_eq!(reply.value(), Some(Value::Loop(LoopData::new(&data).unwrap()))));
    }
    assert_eq!(raw(&mut rig, 0x06, &[0; 257]), Status::CmdFormatError);
}

#[test]
fn acceleration_and_force_limit_are_clamped_to_the_limits() {
    let mut rig = Rig::new(Config::default());
    for (set, get) in [(1.0, 100.0), (250.0, 250.0), (1e9, 5_000.0), (-5.0, 100.0)] {
        assert_eq!(rig.status(Command::SetAcceleration { acceleration: set }), Status::Success);
        assert_eq!(rig.ask(Command::GetAcceleration).f32(), get);
    }
    for (set, get) in [(1.0, 5.0), (33.0, 33.0), (100.0, 80.0)] {
        assert_eq!(rig.status(Command::SetForceLimit { force: set }), Status::Success);
        assert_eq!(rig.ask(Command::GetForceLimit).f32(), get);
    }
}

#[test]
fn overdrive_raises_the_force_limit_and_its_end_lowers_it_again() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    assert_eq!(rig.status(Command::OverdriveMode { enabled: true }), Status::Success);
    assert!(rig.flags().contains(SystemFlags::OVERDRIVE_MODE));
    rig.status(Command::SetForceLimit { force: 100.0 });
    assert_eq!(rig.ask(Command::GetForceLimit).f32(), 100.0);
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    assert_eq!(rig.force(), 100.0);
    rig.status(Command::OverdriveMode { enabled: false });
    assert!(!rig.flags().contains(SystemFlags::OVERDRIVE_MODE));
    assert_eq!(rig.ask(Command::GetForceLimit).f32(), 80.0);
}

#[test]
fn unused_flags_are_ignored_unless_fingers_would_move() {
    let mut rig = Rig::homed(None);
    for (flags, on) in [(0xFE, false), (0x02, false), (0x03, true), (0xFF, true), (0x80, false)] {
        assert_eq!(raw(&mut rig, 0x37, &[flags]), Status::Success, "{flags:02X}");
        assert_eq!(rig.flags().contains(SystemFlags::OVERDRIVE_MODE), on, "{flags:02X}");
    }
    for payload in [&[][..], &[0x03, 0], &[0; 4]] {
        assert_eq!(raw(&mut rig, 0x37, payload), Status::CmdFormatError, "{payload:?}");
    }
    for id in [0x40, 0x41, 0x43, 0x44, 0x45] {
        assert_eq!(raw(&mut rig, id, &[0xFC, 10, 0]), Status::Success, "{id:02X}h");
        assert!(rig.wait(50).is_empty(), "{id:02X}h once");
        assert_eq!(raw(&mut rig, id, &[0xFC]), Status::CmdFormatError, "{id:02X}h");
    }
    assert_eq!(raw(&mut rig, 0x40, &[0xFD, 10, 0]), Status::Success);
    assert!(rig.wait(50).len() > 3, "repeatedly");
    assert_eq!(raw(&mut rig, 0x40, &[0, 0, 0]), Status::Success);
    assert_eq!(raw(&mut rig, 0x42, &[0xFE]), Status::Success);
    let motion = [&[0x04][..], &40f32.to_le_bytes(), &50f32.to_le_bytes()].concat();
    assert_eq!(raw(&mut rig, 0x21, &motion), Status::CmdFormatError);
}

#[test]
fn soft_limits_can_be_read_only_while_set() {
    let mut rig = Rig::new(Config::default());
    assert_eq!(rig.status(Command::GetSoftLimits), Status::NotAvailable);
    let limits = SoftLimits { minus: 10.0, plus: 90.0 };
    assert_eq!(rig.status(Command::SetSoftLimits { limits }), Status::Success);
    rig.ask(Command::GetSoftLimits)
        .with(|reply| assert_eq!(reply.value(), Some(Value::GetSoftLimits(limits))));
    let crossed = SoftLimits { minus: 90.0, plus: 10.0 };
    assert_eq!(rig.status(Command::SetSoftLimits { limits: crossed }), Status::CmdFormatError);
    assert_eq!(rig.status(Command::ClearSoftLimits), Status::Success);
    assert_eq!(rig.status(Command::GetSoftLimits), Status::NotAvailable);
}

#[test]
fn device_reports_model_serial_number_and_limits() {
    let config = Config { model: Model::Wsg32, serial_number: 4_711, ..Config::default() };
    let mut rig = Rig::new(config);
    assert_eq!(
        rig.ask(Command::GetSystemInfo).text(),
        "50h Get System Information E_SUCCESS WSG 32, revision 1, firmware 4.0.0, serial number 4711"
    );
    rig.ask(Command::GetSystemLimits).with(|reply| {
        assert_eq!(reply.value(), Some(Value::GetSystemLimits(Model::Wsg32.parameters().limits)));
    });
}

#[test]
fn device_tag_is_stored_and_an_invalid_one_is_refused() {
    let mut rig = Rig::new(Config::default());
    assert_eq!(rig.status(Command::GetDeviceTag), Status::NotAvailable);
    let tag = DeviceTag::new("cell 4, left").unwrap();
    assert_eq!(rig.status(Command::SetDeviceTag { tag }), Status::Success);
    rig.ask(Command::GetDeviceTag).with(|reply| assert_eq!(reply.value(), Some(Value::GetDeviceTag(tag))));
    assert_eq!(raw(&mut rig, 0x51, &[b'x'; 65]), Status::Overrun);
    assert_eq!(raw(&mut rig, 0x51, b"line\nfeed"), Status::InvalidParameter);
    assert_eq!(raw(&mut rig, 0x51, b"short\0\0"), Status::Success);
    assert_eq!(rig.ask(Command::GetDeviceTag).text(), "52h Get Device Tag E_SUCCESS \"short\"");
    let configured = Config { tag: Tag::new("from the start").unwrap(), ..Config::default() };
    let mut rig = Rig::new(configured);
    assert_eq!(rig.ask(Command::GetDeviceTag).text(), "52h Get Device Tag E_SUCCESS \"from the start\"");
}

#[test]
fn refused_payloads_get_the_status_that_the_manual_lists() {
    let mut rig = Rig::homed(None);
    for &id in CommandId::ALL {
        // These are too long for every command except Loop, the tag, and FAST STOP, which accepts any payload.
        if matches!(id, CommandId::Loop | CommandId::SetDeviceTag | CommandId::FastStop) {
            continue;
        }
        let status = raw(&mut rig, id.code(), &[0; 40]);
        assert!(id.immediate_statuses().contains(&status), "{id}: {status}");
        assert!(matches!(status, Status::NoParamExpected | Status::CmdFormatError), "{id}: {status}");
    }
    assert_eq!(raw(&mut rig, 0x20, &[3]), Status::InvalidParameter);
    let not_a_number = [&[0][..], &f32::NAN.to_le_bytes(), &50f32.to_le_bytes()].concat();
    assert_eq!(raw(&mut rig, 0x21, &not_a_number), Status::CmdFormatError);
    assert_eq!(rig.state(), GripperState::Idle);
}

#[test]
fn unknown_commands_are_answered_as_such() {
    let mut rig = Rig::new(Config::default());
    for id in [0x00, 0x01, 0x90, 0xA0, 0xBF, 0xFF] {
        assert_eq!(raw(&mut rig, id, &[1, 2, 3]), Status::CmdUnknown);
    }
    rig.send_raw(0x90, &[]);
    let mut buffer = [0; wsg_sim::MAX_FRAME_LEN];
    // The example of the manual.
    assert_eq!(
        rig.gripper.transmit(rig.port, &mut buffer).unwrap(),
        [0xAA, 0xAA, 0xAA, 0x90, 0x02, 0x00, 0x0E, 0x00, 0xFD, 0x02]
    );
}

#[test]
fn command_failure_flag_ignores_successful_queries() {
    let mut rig = Rig::homed(None);
    let failed = |rig: &Rig| rig.flags().contains(SystemFlags::CMD_FAILURE);
    assert!(!failed(&rig));
    rig.run(grip(20.0));
    assert!(failed(&rig));
    // A query does not clear it.
    rig.ask(Command::GetSystemState { update: Default::default() })
        .with(|reply| assert!(reply.to_string().contains("CMD_FAILURE")));
    rig.ask(Command::GetGripperState { update: Default::default() });
    assert!(failed(&rig));
    rig.status(release(50.0));
    assert!(!failed(&rig));
    assert_eq!(raw(&mut rig, 0x90, &[]), Status::CmdUnknown);
    assert!(failed(&rig));
    for stop in [Command::Stop, Command::FastStop] {
        rig.status(release(80.0));
        rig.send(stop);
        let answers = rig.frames();
        assert_eq!(answers.len(), 2, "the answer to the stop, and E_CMD_ABORTED of the motion");
        assert!(!failed(&rig), "{stop}: the last command ended the motion and succeeded");
    }
    rig.status(Command::ACKNOWLEDGE);
    rig.status(release(60.0));
    rig.set_fault(Fault::MotorCurrent, true);
    assert_eq!(rig.next().status(), Status::CmdAborted);
    assert!(failed(&rig), "no command ended that motion");
}

#[test]
fn fingers_show_type_size_and_flags() {
    let fingers = [Finger::Fmf, Finger::Dsa];
    let mut rig = Rig::new(Config { fingers, ..Config::default() });
    assert_eq!(rig.ask(Command::GetFinger1Info).frame[8..11], [1, 4, 0]);
    assert_eq!(rig.ask(Command::GetFinger2Info).frame[8..11], [2, 0, 0]);
    rig.ask(Command::GetFinger1Flags).with(|reply| {
        let flags = FingerFlags::POWER_ON | FingerFlags::CONFIG_AVAIL | FingerFlags::COMM_OPEN;
        assert_eq!(reply.value(), Some(Value::GetFinger1Flags(flags)));
    });
    let mut rig = Rig::new(Config { fingers: [Finger::None, Finger::Generic], ..Config::default() });
    for (info, flags) in [
        (Command::GetFinger1Info, Command::GetFinger1Flags),
        (Command::GetFinger2Info, Command::GetFinger2Flags),
    ] {
        assert_eq!(rig.ask(info).frame[8..11], [0, 0, 0]);
        assert_eq!(rig.ask(flags).frame[8..10], [1, 0]);
    }
}

#[test]
fn finger_power_answers_twice_on_and_once_off() {
    let mut rig = Rig::new(Config { fingers: [Finger::Generic; 2], ..Config::default() });
    assert_eq!(rig.status(Command::Finger1Power { enabled: false }), Status::Success);
    assert_eq!(rig.ask(Command::GetFinger1Flags).frame[8], 0);
    assert_eq!(rig.status(Command::Finger1Power { enabled: true }), Status::CmdPending);
    assert_eq!(texts(&rig.wait(499)), Vec::<String>::new());
    assert_eq!(texts(&rig.wait(1)), ["62h Finger 1 Power Control E_SUCCESS"]);
    assert_eq!(rig.ask(Command::GetFinger1Flags).frame[8], 1);
}

#[test]
fn finger_power_is_for_fingers_without_a_known_type() {
    let mut rig = Rig::new(Config { fingers: [Finger::Fmf, Finger::Dsa], ..Config::default() });
    assert_eq!(rig.status(Command::Finger1Power { enabled: false }), Status::CmdFailed);
    assert_eq!(rig.status(Command::Finger2Power { enabled: true }), Status::CmdFailed);
}

#[test]
fn force_finger_measures_its_half_of_the_force() {
    let fingers = [Finger::Fmf, Finger::Generic];
    let mut rig = Rig::homed_with(Config { fingers, part: Part::of_width(20.0), ..Config::default() });
    assert_eq!(rig.ask(Command::GetFinger1Data).f32(), 0.0);
    assert_eq!(rig.status(Command::GetFinger2Data), Status::NotAvailable);
    rig.run(grip(20.0));
    assert_eq!(rig.ask(Command::GetFinger1Data).f32(), 20.0);
    assert_eq!(rig.ask(Command::GetForce { update: Default::default() }).f32(), 40.0);
    assert!(rig.flags().contains(SystemFlags::FORCECNTL_MODE));
    rig.run(release(50.0));
    assert!(!rig.flags().contains(SystemFlags::FORCECNTL_MODE));
}

#[test]
fn tare_requires_a_sensor_and_no_held_part() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.status(Command::TareForceSensor), Status::NotAvailable);
    let part = Part::of_width(20.0);
    let mut rig = Rig::homed_with(Config { fingers: [Finger::Fmf; 2], part, ..Config::default() });
    // Clamped on a block: pressing, but not gripping.
    assert_eq!(rig.run(go_to(10.0)), Status::AxisBlocked);
    assert_eq!(rig.ask(Command::GetFinger1Data).f32(), 20.0);
    assert_eq!(rig.status(Command::TareForceSensor), Status::Success);
    assert_eq!(rig.ask(Command::GetFinger1Data).f32(), 0.0);
    rig.run(release(50.0));
    rig.run(grip(20.0));
    assert_eq!(rig.status(Command::TareForceSensor), Status::AccessDenied);
}

#[test]
fn finger_faults_show_in_flags_and_answers() {
    let mut rig = Rig::new(Config { fingers: [Finger::Fmf, Finger::Generic], ..Config::default() });
    rig.set_fault(Fault::FingerCommunication(Jaw::One), true);
    assert!(rig.flags().contains(SystemFlags::FINGER_FAULT));
    assert_eq!(rig.status(Command::GetFinger1Data), Status::IoError);
    rig.set_fault(Fault::FingerCommunication(Jaw::One), false);
    assert!(!rig.flags().contains(SystemFlags::FINGER_FAULT));
    assert_eq!(rig.status(Command::GetFinger1Data), Status::Success);

    rig.set_fault(Fault::FingerShortCircuit(Jaw::Two), true);
    assert!(rig.flags().contains(SystemFlags::FINGER_FAULT));
    assert_eq!(rig.ask(Command::GetFinger2Flags).frame[8..10], [0, 1]);
    assert_eq!(rig.status(Command::Finger2Power { enabled: true }), Status::CmdFailed);
    rig.set_fault(Fault::FingerShortCircuit(Jaw::Two), false);
    assert_eq!(rig.status(Command::Finger2Power { enabled: true }), Status::CmdPending);
}

/// GCL, appendix C, bit 10: "Während der Initialisierung des Fingers ist ein Fehler aufgetreten"; bit 9: "Während der Laufzeit".
#[test]
fn finger_silent_at_power_on_shows_init_fault_until_it_answers() {
    let flags = |rig: &mut Rig| {
        let frame = rig.ask(Command::GetFinger1Flags).frame;
        FingerFlags::from_bits_retain(u16::from_le_bytes([frame[8], frame[9]]))
    };
    let works = FingerFlags::POWER_ON | FingerFlags::CONFIG_AVAIL | FingerFlags::COMM_OPEN;
    for finger in [Finger::Fmf, Finger::Dsa] {
        let mut rig = Rig::new(Config { fingers: [finger, Finger::None], ..Config::default() });
        assert_eq!(flags(&mut rig), works);
        let (short, silent) = (Fault::FingerShortCircuit(Jaw::One), Fault::FingerCommunication(Jaw::One));
        rig.set_fault(short, true);
        assert_eq!(flags(&mut rig), FingerFlags::POWER_FAULT);
        rig.set_fault(silent, true);
        rig.set_fault(short, false);
        assert_eq!(flags(&mut rig), FingerFlags::POWER_ON | FingerFlags::INIT_FAULT);
        assert!(rig.flags().contains(SystemFlags::FINGER_FAULT));
        rig.set_fault(silent, false);
        assert_eq!(flags(&mut rig), works, "it clears once the finger answers");
        assert!(!rig.flags().contains(SystemFlags::FINGER_FAULT));
        // At run time, the other flag is set.
        rig.set_fault(silent, true);
        let open = FingerFlags::POWER_ON | FingerFlags::CONFIG_AVAIL;
        assert_eq!(flags(&mut rig), open | FingerFlags::COMM_FAULT);
    }
}

/// Appendix B, D16: "The engine has reached its maximum thermal power consumption. The flag will be reset automatically as soon
/// as the engine has recovered. Then the corresponding Fast Stop can be committed."
#[test]
fn motor_overheated_by_overdrive_recovers_and_is_acknowledged() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    rig.status(Command::OverdriveMode { enabled: true });
    rig.status(Command::SetForceLimit { force: 120.0 });
    assert_eq!(rig.run(grip(20.0)), Status::Success);
    let fault = |rig: &Rig| rig.flags().contains(SystemFlags::CURR_FAULT);
    let start = rig.now;
    while !fault(&rig) {
        assert_eq!(rig.state(), GripperState::Holding);
        rig.wait(100);
        assert!(rig.now < start.plus_millis(120_000), "the fault did not occur");
    }
    assert!(rig.now > start.plus_millis(30_000), "{}", rig.now);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP) && rig.force() == 0.0);
    assert!(!rig.flags().contains(SystemFlags::TEMP_FAULT), "the electronics heat up more slowly");
    // The motor must recover first.
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    let wake = rig.gripper.next_wake().expect("a flag is about to change");
    assert!(wake <= rig.now.plus_millis(100), "{wake}");
    rig.wait(10_000);
    assert!(fault(&rig), "the motor needs time to recover");
    rig.wait(50_000);
    assert!(!fault(&rig) && rig.flags().contains(SystemFlags::FAST_STOP));
    assert_eq!(rig.status(go_to(50.0)), Status::AccessDenied);
    rig.status(Command::ACKNOWLEDGE);
    assert_eq!(rig.run(go_to(50.0)), Status::Success);
}

/// Appendix B, D14: "All motion-related commands are disabled until the temperature falls below the critical level."
#[test]
fn temperature_and_supply_faults_disable_motion_until_they_end() {
    let homing = Command::Homing { direction: HomingDirection::Positive };
    for (fault, flag) in [
        (Fault::OverTemperature, SystemFlags::TEMP_FAULT | SystemFlags::TEMP_WARNING),
        (Fault::SupplyOutOfRange, SystemFlags::POWER_FAULT),
    ] {
        // During a motion, while a part is held, clamped on a block, and at rest.
        for (command, ended, state) in [
            (Some(go_to(30.0)), Some("21h Pre-position Fingers E_CMD_ABORTED"), GripperState::Error),
            (Some(grip(20.0)), None, GripperState::Error),
            (Some(go_to(10.0)), None, GripperState::Error),
            (None, None, GripperState::Idle),
        ] {
            let mut rig = Rig::homed(Part::of_width(20.0));
            if let Some(command) = command {
                rig.status(command);
                rig.wait(if ended.is_some() { 100 } else { 3_000 });
            }
            rig.set_fault(fault, true);
            assert_eq!(texts(&rig.frames()), Vec::from_iter(ended), "{fault:?}");
            assert!(rig.flags().contains(flag) && !rig.flags().contains(SystemFlags::FAST_STOP), "{fault:?}");
            assert_eq!((rig.state(), rig.force(), rig.gripper.state().speed), (state, 0.0, 0.0), "{fault:?}");
            for command in [go_to(90.0), grip(20.0), release(90.0), homing] {
                assert_eq!(rig.status(command), Status::AccessDenied, "{fault:?}: {command}");
            }
            assert_eq!(rig.gripper.run_for_script(10.0, rig.now), Status::AccessDenied);
            // An acknowledgement changes nothing about it.
            assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
            assert_eq!(rig.status(go_to(90.0)), Status::AccessDenied);
            rig.set_fault(fault, false);
            assert!(!rig.flags().intersects(flag | SystemFlags::FAST_STOP), "{fault:?}");
            assert_eq!(rig.run(go_to(90.0)), Status::Success, "{fault:?}: no acknowledgement is needed");
        }
    }
}

/// "Overdrive mode is not supported by all WSG grippers" (3.3.8, 3.5.4).
#[test]
fn gripper_without_overdrive_keeps_to_its_nominal_force() {
    for model in Model::ALL {
        let config = Config { model: *model, overdrive: false, ..Config::default() };
        let nominal = model.parameters().limits.nominal_force;
        let mut rig = Rig::new(config);
        rig.ask(Command::GetSystemLimits).with(|reply| match reply.value() {
            Some(Value::GetSystemLimits(limits)) => assert_eq!(limits.overdrive_force, nominal, "{model}"),
            other => panic!("{other:?}"),
        });
        assert_eq!(rig.status(Command::OverdriveMode { enabled: true }), Status::Success);
        assert!(!rig.flags().contains(SystemFlags::OVERDRIVE_MODE), "{model}");
        assert_eq!(rig.status(Command::SetForceLimit { force: 2.0 * nominal }), Status::Success);
        assert_eq!(rig.ask(Command::GetForceLimit).f32(), nominal, "{model}");
    }
}

#[test]
fn severe_fault_causes_a_fast_stop_that_outlasts_it() {
    let mut rig = Rig::homed(None);
    rig.status(go_to(30.0));
    rig.wait(100);
    rig.set_fault(Fault::MotorCurrent, true);
    assert_eq!(texts(&rig.frames()), ["21h Pre-position Fingers E_CMD_ABORTED"]);
    assert!(rig.flags().contains(SystemFlags::CURR_FAULT | SystemFlags::FAST_STOP));
    // Nothing unlocks it while the cause lasts.
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    assert_eq!(rig.status(go_to(30.0)), Status::AccessDenied);
    rig.set_fault(Fault::MotorCurrent, false);
    assert!(!rig.flags().intersects(SystemFlags::CURR_FAULT));
    assert_eq!(rig.status(go_to(30.0)), Status::AccessDenied);
    rig.status(Command::ACKNOWLEDGE);
    assert_eq!(rig.run(go_to(30.0)), Status::Success);
}

#[test]
fn temperature_rises_with_load_and_limits_overdrive() {
    let mut rig = Rig::homed(Part::of_width(20.0));
    let temperature = |rig: &Rig| rig.gripper.state().temperature.0;
    let idle = temperature(&rig);
    rig.status(Command::SetForceLimit { force: 80.0 });
    rig.run(grip(20.0));
    let wait_minutes = |rig: &mut Rig, minutes: u64| {
        rig.now = rig.now.plus_millis(minutes * 60_000);
        rig.gripper.advance(rig.now);
    };
    wait_minutes(&mut rig, 2);
    let warm = temperature(&rig);
    assert!(warm > idle + 100, "{idle} to {warm}");
    wait_minutes(&mut rig, 60);
    assert!(temperature(&rig) > warm);
    assert_eq!(rig.state(), GripperState::Holding, "the nominal force can be held indefinitely");
    assert!(!rig.flags().contains(SystemFlags::TEMP_WARNING));

    rig.status(Command::OverdriveMode { enabled: true });
    rig.status(Command::SetForceLimit { force: 120.0 });
    rig.run(grip(20.0));
    wait_minutes(&mut rig, 60);
    assert!(rig.flags().contains(SystemFlags::FAST_STOP));
    // It cools down without force.
    assert!(!rig.flags().contains(SystemFlags::TEMP_FAULT));
    assert_eq!(rig.ask(Command::GetTemperature).text(), "46h Get Temperature E_SUCCESS 32.0 °C");
}
