//! The service port, in virtual time: it reads all registers, changes settings, and never commands.

use bus_modbus::rtu::Character;
use host_tests::addresses::{report, setting};
use host_tests::chance::Chance;
use host_tests::world::modbus::*;
use host_tests::world::quick;
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::registers::{FIRST_SETTING, SETTINGS};
use wsg_bridge_fw::{BusConfig, BusPort, Config, ControlSource};
use wsg_protocol::CommandId;

#[test]
fn every_write_to_the_output_image_is_refused_without_effect() {
    // A PLC without a time-out.
    let bus = BusConfig { timeout_ms: 0, ..BusConfig::DEFAULT };
    let mut rig = Master::ready_with(Config { bus, ..Config::DEFAULT }, quick());
    rig.command(HOMING, 0, 0, 0);
    rig.take_sent();
    rig.pass(2_000);
    let received = rig.take_sent();
    let events = rig.input(report("EVENTS"), 1);
    rig.by_service(|rig| {
        for bit in 0..64 {
            for value in [0xFF, 0] {
                assert_eq!(rig.ask(&[5, 0, bit, value, 0]), [0x85, 1], "coil {bit}");
            }
            assert_eq!(rig.ask(&[15, 0, 0, 0, 64, 8, 1, 0, 0, 0, 0, 0, 0, bit]), [0x8F, 1]);
        }
        for flags in [MOVE, GRIP, RELEASE, HOMING, STOP_ACK, FASTSTOP, JOG_PLUS, 0] {
            assert_eq!(rig.try_write(0, &[u16::from(flags) << 8, 20_00, 50_00, 40_00]), Some(1));
            assert_eq!(rig.ask(&[6, 0, 0, flags, 0]), [0x86, 1]);
            assert_eq!(rig.ask(&[22, 0, 0, 0, 0, flags, 0]), [0x96, 1]);
            assert_eq!(rig.ask(&[23, 0, 0, 0, 1, 0, 0, 0, 1, 2, flags, 0]), [0x97, 1]);
        }
        assert_eq!(rig.try_write(3, &[1, 1]), Some(2), "the second register does not exist");
        assert_eq!(rig.try_write(4, &[1]), Some(2));
        assert_eq!(rig.ask(&[15, 0, 60, 0, 5, 1, 0x1F]), [0x8F, 2]);
        assert_eq!(rig.holding(0, 4), Ok(vec![0; 4]), "nothing was written");
    });
    rig.pass(2_000);
    let sent = rig.take_sent();
    assert_eq!(sent.iter().find(|id| !received.contains(id)), None, "only periodic requests are sent");
    assert_eq!(rig.input(report("EVENTS"), 1), events);
    assert_eq!(rig.bridge().control_source(), ControlSource::Bus, "the bus commanded the homing");
}

#[test]
fn service_port_reads_what_the_bus_reads() {
    let mut rig = Master::homed(quick());
    rig.command(MOVE, 33_00, 50_00, 40_00);
    rig.write(0, &[0, 12_34, 50_01, 40_02]);
    rig.pass(100);
    let (image, output) = (rig.input(0, 6), rig.holding(0, 4));
    assert!(image.is_ok());
    let settings = rig.holding(FIRST_SETTING, SETTINGS.len() as u8);
    let identification = rig.ask(&[43, 14, 1, 0]);
    let bits = rig.ask(&[2, 0, 0, 0, 96]);
    let coils = rig.ask(&[1, 0, 0, 0, 64]);
    rig.by_service(|rig| {
        assert_eq!(rig.input(0, 6), image);
        assert_eq!(rig.holding(0, 4), output, "the image written by the bus");
        assert_eq!(rig.holding(FIRST_SETTING, SETTINGS.len() as u8), settings);
        assert_eq!(rig.ask(&[43, 14, 1, 0]), identification);
        assert_eq!(rig.ask(&[2, 0, 0, 0, 96]), bits);
        assert_eq!(rig.ask(&[1, 0, 0, 0, 64]), coils);
        assert_eq!(rig.input(report("BUS_RATE"), 2), Ok(vec![192, 0]), "rate and format of the PLC's bus");
        assert_eq!(rig.input(report("SERVER_MESSAGES"), 1), Ok(vec![7]), "the port's own counter");
    });
}

#[test]
fn service_port_setting_applies_to_bus_and_wires_at_once() {
    let mut rig = Master::homed(quick());
    rig.by_service(|rig| rig.write(setting("UNIT"), &[9]));
    assert!(rig.ask(&[4, 0, 0, 0, 1]).is_empty(), "address of another unit");
    rig.send_raw(&Master::frame(9, &[4, 0, 0, 0, 1]));
    rig.pass(5);
    assert_eq!(rig.answers(), 1);
    rig.by_service(|rig| {
        assert_eq!(rig.holding(setting("UNIT"), 1), Ok(vec![9]), "the port's own address stays 1");
        rig.write(setting("UNIT"), &[1]);
    });

    rig.by_service(|rig| rig.write(setting("SWAP_BYTES"), &[1]));
    let width = rig.by_service(|rig| rig.input(3, 1)).unwrap()[0];
    assert_ne!(width, width.swap_bytes());
    assert_eq!(rig.input(3, 1), Ok(vec![width.swap_bytes()]), "swapped only on the bus");
    rig.by_service(|rig| rig.write(setting("SWAP_BYTES"), &[0]));

    rig.by_service(|rig| rig.write(setting("BROADCAST"), &[1]));
    rig.send_raw(&Master::frame(0, &[6, 0, 1, 0x12, 0x34]));
    rig.pass(5);
    assert_eq!(rig.holding(1, 1), Ok(vec![0x1234]));
    rig.by_service(|rig| {
        rig.send_raw(&Master::frame(0, &[6, 0, setting("DEBOUNCE") as u8, 0, 99]));
        rig.pass(5);
        assert_eq!(rig.holding(setting("DEBOUNCE"), 1), Ok(vec![2]), "not on this port");
    });

    rig.by_service(|rig| rig.write(setting("BUS_CHAR_TIMEOUT"), &[0]));
    let is_answered = |rig: &mut Master| {
        let frame = Master::frame(1, &[4, 0, 0, 0, 1]);
        rig.pass(100);
        rig.answers();
        rig.send_raw(&frame[..4]);
        rig.send_after(40_000, &frame[4..]);
        rig.pass(100);
        rig.answers() == 1
    };
    assert!(!is_answered(&mut rig), "the bus is strict");
    assert!(rig.by_service(is_answered), "the port tolerates pauses");

    rig.by_service(|rig| rig.write(setting("RECIPE0_WIDTH"), &[33_00]));
    rig.pulse(Inputs::MOVE);
    rig.pass(3_000);
    assert!((rig.gripper().state().width - 33.0).abs() < 0.05, "{}", rig.gripper().state().width);
    rig.by_service(|rig| rig.write(setting("DEBOUNCE"), &[20]));
    rig.take_motions();
    rig.pulse(Inputs::GRIP);
    assert_eq!(rig.take_motions(), [], "5 ms are too short now");
}

#[test]
fn one_request_writes_all_recipes_over_several_turns() {
    let mut rig = Master::homed(quick());
    let first = setting("RECIPE0_WIDTH");
    for (by_service, from) in [(false, 1_000), (true, 2_000)] {
        // 137 characters, all available at the same time.
        let recipes: Vec<u16> = (from..from + 64).collect();
        if by_service {
            rig.by_service(|rig| rig.write(first, &recipes));
        } else {
            rig.write(first, &recipes);
        }
        assert_eq!(rig.holding(first, 64), Ok(recipes));
    }
}

#[test]
fn lines_are_served_in_parallel_and_port_silence_is_no_event() {
    let mut rig = Master::homed(quick());
    rig.take_motions();
    rig.write(0, &[u16::from(MOVE) << 8, 20_00, 10_00, 40_00]);
    let events = rig.input(report("EVENTS"), 1);
    let (mut on_bus, mut on_port) = (0, 0);
    for _ in 0..300 {
        // Both requests are complete in the same turn.
        rig.send_raw(&Master::frame(1, &[4, 0, 0, 0, 6]));
        rig.by_service(|rig| rig.send_raw(&Master::frame(1, &[4, 0, 100, 0, 40])));
        rig.pass(4);
        on_bus += rig.answers();
        on_port += rig.by_service(Master::answers);
    }
    assert_eq!((on_bus, on_port), (300, 300));
    assert_eq!(rig.take_motions(), [CommandId::PrePosition]);
    // The port becomes silent, but the PLC does not.
    for _ in 0..300 {
        assert!(rig.input(0, 1).is_ok());
        rig.pass(10);
    }
    assert_eq!(rig.input(report("EVENTS"), 1), events);
    assert_eq!(rig.input(report("BUS_TIMEOUTS"), 1), Ok(vec![0]));
}

#[test]
fn master_on_the_port_does_not_keep_a_silent_plc_alive() {
    let mut rig = Master::ready_with(Config::DEFAULT, wsg_sim::Config::default());
    rig.command(HOMING, 0, 0, 0);
    rig.write(0, &[u16::from(MOVE) << 8, 10_00, 5_00, 40_00]);
    rig.take_sent();
    rig.by_service(|rig| {
        for _ in 0..120 {
            assert!(rig.input(0, 6).is_ok());
            rig.pass(10);
        }
        assert_eq!(rig.input(report("BUS_TIMEOUTS"), 1), Ok(vec![1]));
    });
    assert!(rig.take_sent().contains(&CommandId::Stop));
}

/// A line with an endless stream of characters, in which a frame never seems to end.
struct Babble(Chance);

impl BusPort for Babble {
    fn receive(&mut self) -> Option<(Character, u32)> {
        Some((Character::Byte(self.0.below(256) as u8), if self.0.below(50) == 0 { 60_000 } else { 0 }))
    }

    fn silence_us(&mut self) -> u32 {
        0
    }

    fn send(&mut self, _: &[u8]) {}
}

#[test]
fn endless_noise_changes_nothing_and_delays_nothing() {
    let mut rig = Master::homed(quick());
    let settings = rig.holding(FIRST_SETTING, SETTINGS.len() as u8);
    rig.take_motions();
    let mut chance = Chance::new(7);
    for _ in 0..200 {
        rig.by_service(|rig| {
            let noise: Vec<u8> = (0..200).map(|_| chance.below(256) as u8).collect();
            rig.send_after(60_000, &noise);
        });
        rig.pass(5);
    }
    assert_eq!(rig.take_motions(), []);
    // The noise does not delay an edge of a wire.
    let leaves_after = |rig: &mut Master, noisy: bool| {
        rig.take_motions();
        rig.set(Inputs::MOVE, true);
        let after = (1..50).find(|_| {
            if noisy {
                rig.by_service(|rig| rig.send_raw(&[0x55; 12]));
            }
            rig.pass(1);
            !rig.take_motions().is_empty()
        });
        rig.set(Inputs::MOVE, false);
        rig.pass(5_000);
        after
    };
    let quiet = leaves_after(&mut rig, false);
    assert!(quiet.is_some());
    assert_eq!(leaves_after(&mut rig, true), quiet);
    assert_eq!(rig.holding(FIRST_SETTING, SETTINGS.len() as u8), settings);

    let mut babble = Babble(Chance::new(8));
    for _ in 0..1_000 {
        rig.turn(&mut babble);
    }
    assert_eq!(rig.take_motions(), []);
}

#[test]
fn a_million_writes_to_the_settings_cause_no_motion() {
    let mut rig = Master::homed(quick());
    // The PLC that homed is silent from here on. Its time-out has passed, so later values of BUS_TIMEOUT and BUS_REACTION
    // have no effect.
    rig.pass(2_000);
    rig.take_motions();
    let mut chance = Chance::new(18);
    let last = FIRST_SETTING + SETTINGS.len() as u16 + 2;
    rig.by_service(|rig| {
        for _ in 0..1_000_000 {
            let first = FIRST_SETTING + chance.below(u64::from(last - FIRST_SETTING)) as u16;
            let [a1, a0] = first.to_be_bytes();
            let count = 1 + chance.below(4) as u8;
            let mut pdu = vec![16, a1, a0, 0, count, 2 * count];
            // Half of the values are within most ranges.
            let most = if chance.below(2) == 0 { 3 } else { 0x1_0000 };
            pdu.extend((0..count).flat_map(|_| (chance.below(most) as u16).to_be_bytes()));
            rig.send_after(60_000, &Master::frame(UNIT, &pdu));
            rig.step();
        }
        rig.pass(200);
    });
    assert!(rig.by_service(Master::answers) > 900_000);
    let motions = rig.take_motions();
    assert_eq!(motions, []);
    let reports = rig.by_service(|rig| rig.input(report("ERROR_CAUSE"), 1));
    assert_eq!(reports, Ok(vec![0]));
    for (at, setting) in SETTINGS.iter().enumerate() {
        let value = rig.by_service(|rig| rig.holding(FIRST_SETTING + at as u16, 1)).unwrap()[0];
        assert!((setting.least..=setting.most).contains(&value), "{}: {value}", setting.name);
    }
}
