//! The bridge over Modbus RTU, in virtual time: grip cycles, arbitration, time-outs and safety.

use host_tests::addresses::{report, setting};
use host_tests::world::modbus::*;
use host_tests::world::{quick, with_part};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS};
use wsg_bridge_fw::{BusConfig, Config, RECIPES};
use wsg_protocol::{CommandId, Status};

#[test]
fn bus_timeout_of_0_is_unlimited() {
    let bus = BusConfig { timeout_ms: 0, ..BusConfig::DEFAULT };
    let mut rig = Master::ready_with(Config { bus, ..Config::DEFAULT }, wsg_sim::Config::default());
    rig.command(HOMING, 0, 0, 0);
    rig.take_sent();
    rig.write(0, &[u16::from(MOVE) << 8, 10_00, 5_00, 40_00]);
    rig.pass(5_000);
    let sent = rig.take_sent();
    assert!(sent.contains(&CommandId::PrePosition));
    assert!(!sent.iter().any(|id| matches!(id, CommandId::Stop | CommandId::FastStop)));
    assert_eq!(rig.input(report("BUS_TIMEOUTS"), 1), Ok(vec![0]));
}

#[test]
fn coils_read_as_they_were_written() {
    let mut rig = Master::ready();
    assert_eq!(rig.ask(&[1, 0, 0, 0, 8]), [1, 1, 0]);
    rig.write(0, &[u16::from(MOVE) << 8]);
    let flags = rig.ask(&[1, 0, 0, 0, 16]);
    assert_eq!(flags[2..].iter().map(|byte| byte.count_ones()).sum::<u32>(), 1, "{flags:?}");
}

#[test]
fn coil_of_a_flag_begins_and_ends_its_motion() {
    let mut rig = Master::homed(quick());
    rig.command(MOVE, 30_00, 400_00, 40_00);
    rig.write(2, &[20_00, 40_00]);
    for (value, state) in [(0xFF, RELEASING), (0, IDLE)] {
        let request = [5, 0, 6, value, 0];
        assert_eq!(rig.ask(&request), request);
        rig.pass(100);
        assert_eq!(rig.state(), state);
    }
}

#[test]
fn pause_inside_a_request_is_limited_by_the_setting() {
    // A master on a host with a scheduler: half a request, a pause, and the rest.
    for (character_timeout_ms, pause_us, is_answered) in
        [(50, 40_000, true), (50, 51_000, false), (2, 40_000, false)]
    {
        let bus = BusConfig { character_timeout_ms, ..BusConfig::DEFAULT };
        let mut rig = Master::ready_with(Config { bus, ..Config::DEFAULT }, quick());
        rig.pass(100);
        rig.answers();
        let frame = Master::frame(1, &[4, 0, 0, 0, 1]);
        let (first, second) = frame.split_at(4);
        rig.send_raw(first);
        rig.send_after(pause_us, second);
        rig.pass(100);
        assert_eq!(rig.answers() == 1, is_answered, "{pause_us} us of {character_timeout_ms} ms");
    }
}

#[test]
fn silent_master_that_only_read_stops_no_motion() {
    let mut rig = Master::ready();
    rig.input(0, 1).unwrap();
    rig.set(Inputs::HOME, true);
    rig.take_sent();
    rig.pass(2_000);
    let sent = rig.take_sent();
    assert!(sent.contains(&CommandId::Homing));
    assert!(!sent.iter().any(|id| matches!(id, CommandId::Stop | CommandId::FastStop)));
}

#[test]
fn first_write_of_a_master_starts_nothing_regardless_of_reads() {
    // The bridge has just started, but the cycle of the PLC continues with its flags set.
    let mut rig = Master::new(Config::DEFAULT, quick());
    rig.pass(200);
    for _ in 0..5 {
        assert_eq!(rig.holding(0, 1).map(|registers| registers.len()), Ok(1));
        rig.write(0, &[u16::from(HOMING) << 8, 0, 50_00, 40_00]);
        rig.pass(100);
    }
    assert_eq!(rig.take_motions(), []);
}

#[test]
fn motion_after_another_is_sent_at_once_despite_lost_replies() {
    /// Returns the turns from the write to the motion, `after_ms` after the end of a grip. Replies are lost for `lost_ms`
    /// from the end on.
    fn turns_to_leave(after_ms: u32, lost_ms: u32) -> u32 {
        let mut rig = Master::homed(with_part(20.0));
        rig.write(0, &[u16::from(GRIP) << 8, 20_00, 50_00, 40_00]);
        rig.write(0, &[0, 20_00, 50_00, 40_00]);
        assert!(rig.until(10_000, |outputs| outputs.contains(Outputs::HOLDING)));
        for ms in 0..after_ms {
            rig.set_cut(ms < lost_ms);
            rig.pass(1);
        }
        rig.take_sent();
        let release = [16, 0, 0, 0, 4, 8, RELEASE, 0, 0x0F, 0xA0, 0x13, 0x88, 0x0F, 0xA0];
        rig.send_raw(&Master::frame(1, &release));
        (1..100)
            .find(|_| {
                rig.pass(1);
                rig.take_sent().contains(&CommandId::ReleasePart)
            })
            .expect("the motion is sent")
    }

    let at_rest = turns_to_leave(100, 0);
    for after_ms in 0..15 {
        assert_eq!(turns_to_leave(after_ms, 0), at_rest, "{after_ms} ms after the end");
        for lost_ms in 1..=after_ms {
            let turns = turns_to_leave(after_ms, lost_ms);
            assert_eq!(turns, at_rest, "{after_ms} ms after the end, {lost_ms} ms of replies lost");
        }
    }
}

#[test]
fn error_is_readable_in_the_turn_in_which_the_wires_show_it() {
    let blocked = || {
        let mut rig = Master::homed(with_part(20.0));
        rig.write(0, &[u16::from(MOVE) << 8, 10_00, 50_00, 40_00]);
        rig
    };
    let mut rig = blocked();
    let is_shown = |outputs: Outputs| outputs.contains(Outputs::ERROR);
    let shown_after = (1..20_000).find(|_| rig.until(1, is_shown)).unwrap();
    let shown_at = rig.now();
    let mut answers = 0;
    for ahead_ms in 0..10 {
        let mut rig = blocked();
        rig.pass(shown_after - ahead_ms);
        let status = rig.status();
        if rig.now() == shown_at {
            answers += 1;
            assert_eq!(status, Status::AxisBlocked.code());
        }
    }
    assert_eq!(answers, 1, "one request is answered in that turn");
}

#[test]
fn refusal_is_counted_and_shown_even_with_a_command_wire_high() {
    let mut rig = Master::homed(quick());
    rig.take_motions();
    rig.set(Inputs::HOME, true);
    assert!(rig.until(10_000, |outputs| outputs.contains(Outputs::BUSY)));
    assert!(rig.until(60_000, |outputs| outputs.contains(Outputs::READY)));
    for count in 1..=3 {
        rig.write(0, &[u16::from(MOVE) << 8, 80_00, 50_00, 40_00]);
        rig.write(0, &[0, 80_00, 50_00, 40_00]);
        let refused = rig.input(report("COMMANDS_REFUSED"), 1);
        assert_eq!((rig.status(), refused), (Status::AccessDenied.code(), Ok(vec![count])));
    }
    assert_eq!(rig.take_motions(), [CommandId::Homing], "the wire is high");
}

#[test]
fn exception_is_0a_if_gripper_never_answered_and_0b_if_lost() {
    let mut rig = Master::new(Config::DEFAULT, quick());
    rig.set_cut(true);
    rig.pass(500);
    assert_eq!(rig.input(0, 6), Err(0x0A));
    assert_eq!(rig.ask(&[2, 0, 0, 0, 1]), [0x82, 0x0A]);
    assert_eq!(rig.input(6, 1), Err(2), "register 6 never exists");
    assert_eq!(rig.input(report("GRIPPER_LINK"), 1), Ok(vec![0]));
    rig.set_cut(false);
    rig.pass(1_000);
    assert!(rig.input(0, 6).is_ok());
    assert_eq!(rig.input(report("GRIPPER_LINK"), 1), Ok(vec![2]));
    rig.set_cut(true);
    rig.pass(2_000);
    assert_eq!(rig.input(0, 6), Err(0x0B));
    assert_eq!(rig.input(report("GRIPPER_LINK"), 1), Ok(vec![1]));
    assert!(rig.holding(0, 4).is_ok(), "the output image is local");
}

#[test]
fn settings_read_as_built_and_take_effect_when_written() {
    let mut rig = Master::homed(quick());
    let recipe = setting("RECIPE0_WIDTH");
    let Some(first) = RECIPES.first() else { unreachable!() };
    let values = [first.width as u16, first.speed, first.force as u16, first.release_width as u16];
    assert_eq!(rig.holding(recipe, 4), Ok(values.to_vec()));
    rig.write(recipe, &[33_00]);
    rig.pulse(Inputs::MOVE);
    rig.pass(3_000);
    rig.write(setting("DEBOUNCE"), &[20]);
    rig.take_motions();
    rig.pulse(Inputs::GRIP);
    assert_eq!(rig.take_motions(), [], "5 ms are too short now");
    rig.write(setting("SWAP_BYTES"), &[1]);
    assert_eq!(rig.input(3, 1).map(|width| width[0].swap_bytes()), Ok(33_00));

    let unit = setting("UNIT").to_be_bytes();
    let answer = rig.ask(&[6, unit[0], unit[1], 0, 9]);
    assert_eq!(answer, [6, unit[0], unit[1], 0, 9], "answered with the old address");
    assert!(rig.ask(&[4, 0, 0, 0, 1]).is_empty(), "the old address is no longer served");
    rig.send_raw(&Master::frame(9, &[4, 0, 0, 0, 1]));
    rig.pass(5);
    assert_eq!(rig.answers(), 1);
}

#[test]
fn settings_get_03_out_of_range_02_past_table_06_during_motion() {
    let mut rig = Master::homed(quick());
    assert_eq!(rig.try_write(setting("UNIT"), &[0]), Some(3));
    assert_eq!(rig.try_write(setting("UNIT"), &[248]), Some(3));
    assert_eq!(rig.try_write(setting("BUS_REACTION"), &[1, 2_000]), Some(3), "all or none");
    assert_eq!(rig.try_write(99, &[1]), Some(2));
    let last = FIRST_SETTING + SETTINGS.len() as u16 - 1;
    assert_eq!(rig.try_write(last, &[1, 1]), Some(2));
    rig.by_service(|rig| {
        assert_eq!((rig.try_write(setting("UNIT"), &[0]), rig.try_write(last + 1, &[1])), (Some(3), Some(2)));
    });
    assert_eq!(rig.try_write(3, &[40_00, 0]), Some(2), "no write across the gap");
    rig.write(0, &[u16::from(MOVE) << 8, 10_00, 20_00, 40_00]);
    assert_eq!(rig.try_write(setting("DEBOUNCE"), &[5]), Some(6));
    assert_eq!(rig.try_write(setting("UNIT"), &[0]), Some(3), "an invalid value is reported with priority");
    assert_eq!(rig.by_service(|rig| rig.try_write(setting("DEBOUNCE"), &[5])), Some(6));
    let counters = rig.input(report("SERVER_BUSY"), 1);
    assert_eq!(counters, Ok(vec![1]));
}

#[test]
fn reports_name_versions_and_the_gripper() {
    let gripper = wsg_sim::Config { serial_number: 0x0003_0002, ..quick() };
    let mut rig = Master::ready_with(Config::DEFAULT, gripper);
    let reports = rig.input(FIRST_REPORT, REPORTS.len() as u8).unwrap();
    let of = |name: &str| reports[usize::from(report(name) - FIRST_REPORT)];
    assert_eq!((of("MAP_VERSION"), of("BRIDGE_VERSION")), (8, 0x0001));
    assert_eq!((of("GRIPPER_TYPE"), of("GRIPPER_LINK")), (1, 2));
    assert_eq!((of("SERIAL_HIGH"), of("SERIAL_LOW")), (3, 2));
    assert_eq!((of("BUS_RATE"), of("BUS_FORMAT")), (192, 0));
    assert_eq!(of("SERVER_MESSAGES"), 1, "before this request");
    assert_eq!(rig.input(FIRST_REPORT + REPORTS.len() as u16, 1), Err(2));
}

#[test]
fn device_identification_names_the_bridge() {
    let mut rig = Master::ready();
    let answer = rig.ask(&[43, 14, 1, 0]);
    let text = String::from_utf8_lossy(&answer);
    assert!(text.contains("wsg-bridge-fw") && text.contains("V0.1.0"), "{text}");
    assert_eq!(rig.ask(&[17]), [&[17, 22, 1, 0xFF][..], b"wsg-bridge-fw V0.1.0"].concat());
    let extended = rig.ask(&[43, 14, 3, 0x80]);
    assert_eq!((&extended[..7], &extended[7..]), (&[43, 14, 3, 0x81, 0, 0, 3][..], &answer[7..]));
}

#[test]
fn width_and_force_are_queried_only_once_a_master_communicates() {
    for by_service in [false, true] {
        let mut rig = Master::new(Config::DEFAULT, quick());
        rig.pass(1_000);
        let asks = |sent: Vec<CommandId>| {
            sent.iter().any(|id| matches!(id, CommandId::GetOpeningWidth | CommandId::GetForce))
        };
        assert!(!asks(rig.take_sent()));
        if by_service {
            rig.by_service(|rig| rig.input(0, 1)).unwrap();
        } else {
            rig.input(0, 1).unwrap();
        }
        rig.pass(100);
        assert!(asks(rig.take_sent()), "by the service port: {by_service}");
    }
}

#[test]
fn broadcast_takes_effect_only_if_enabled() {
    let stop = Master::frame(0, &[6, 0, 0, FASTSTOP, 0]);
    let mut rig = Master::homed(quick());
    rig.send_raw(&stop);
    rig.pass(20);
    assert!(!rig.bit(28));
    rig.write(setting("BROADCAST"), &[1]);
    rig.pass(5);
    rig.send_raw(&stop);
    rig.pass(20);
    assert_eq!(rig.answers(), 0);
    assert!(rig.bit(28));
}

/// BUS_TIMEOUT (docs/registers.md) starts with the last intact request for this unit.
#[test]
fn silent_master_times_out_despite_other_modbus_traffic() {
    let read = [4, 0, 0, 0, 1];
    let request = Master::frame(UNIT, &read);
    let mut wrong_checksum = request.clone();
    wrong_checksum[6] ^= 1;
    let traffic = [
        ("a request for another unit", Master::frame(UNIT + 1, &read)),
        ("the response of another unit", Master::frame(UNIT + 1, &[4, 2, 0, 0])),
        ("a broadcast that is switched off", Master::frame(0, &[6, 0, 1, 0, 0])),
        ("a request with a wrong checksum", wrong_checksum),
        ("half a request", request[..4].to_vec()),
        ("noise", vec![0xFF]),
    ];
    for (what, bytes) in traffic {
        let bus = BusConfig { timeout_ms: 300, broadcast: false, ..BusConfig::DEFAULT };
        let mut rig = Master::ready_with(Config { bus, ..Config::DEFAULT }, wsg_sim::Config::default());
        rig.command(HOMING, 0, 0, 0);
        rig.write(0, &[u16::from(MOVE) << 8, 10_00, 10_00, 40_00]);
        rig.take_sent();
        let mut pass = |ms: u32| {
            for _ in 0..ms / 10 {
                rig.send_raw(&bytes);
                rig.pass(10);
            }
            rig.take_sent().contains(&CommandId::Stop)
        };
        assert!(!pass(280), "too early with {what}");
        assert!(pass(50), "not detected with {what}");
    }
}
