//! The bridge over PROFIBUS, in virtual time: grip cycles, arbitration, time-outs and safety.

use bus_profibus::Baud;
use host_tests::world::plc::Plc;
use host_tests::world::profibus::*;
use host_tests::world::{quick, with_part};
use wsg_bridge_fw::{BusConfig, Config, ProfibusConfig};
use wsg_fieldbus::{CommandFlags as Flag, Diagnosis, GripperFlags as Shown, SilenceReaction};
use wsg_protocol::{CommandId, Status, SystemFlags};
use wsg_sim::{Fault, Time};

/// Watchdog factor for 200 ms.
const WATCHDOG: u8 = 20;
const WATCHDOG_MS: u32 = 200;

fn with_reaction(reaction: SilenceReaction) -> Config {
    Config { bus: BusConfig { reaction, ..AT_500K.bus }, ..AT_500K }
}

/// Returns a rig during a long MOVE.
fn moving(reaction: SilenceReaction) -> Master {
    moving_with(reaction, WATCHDOG)
}

/// Returns a rig during a long MOVE of a master with this watchdog.
fn moving_with(reaction: SilenceReaction, watchdog: u8) -> Master {
    let slow = wsg_sim::Config::default();
    let mut rig = Master::exchanging(with_reaction(reaction), slow, watchdog);
    rig.command(Flag::HOMING);
    rig.image.width = 10_00;
    rig.image.speed = 10_00;
    rig.set(Flag::MOVE);
    rig.pass(50);
    assert_eq!(rig.world.take_motions(), [CommandId::Homing, CommandId::PrePosition]);
    rig
}

fn stops(rig: &mut Master) -> Vec<CommandId> {
    let sent = rig.world.take_sent().into_iter();
    sent.filter(|id| matches!(id, CommandId::Stop | CommandId::FastStop)).collect()
}

/// Commands sent for each reaction.
const REACTIONS: [(SilenceReaction, &[CommandId]); 3] = [
    (SilenceReaction::Hold, &[]),
    (SilenceReaction::Stop, &[CommandId::Stop]),
    (SilenceReaction::FastStop, &[CommandId::FastStop]),
];

#[test]
fn clear_and_data_exchange_without_data_count_as_a_time_out() {
    let clear = |rig: &mut Master, function: u8, number: u8| {
        if number == 0 {
            rig.control(0x02, 0);
        } else {
            let answer = rig.send(&sd1(&[STATION, MASTER, function]));
            assert_eq!(answer[..4], [0x68, 15, 15, 0x68], "Fail_Safe: {answer:02X?}");
        }
    };
    for (reaction, expected) in REACTIONS {
        for number in 0..2 {
            let mut rig = moving(reaction);
            // Repeatedly, as a master in the operating mode Clear does.
            for function in [0x5D, 0x7D].into_iter().cycle().take(40) {
                clear(&mut rig, function, number);
                rig.pass_silent(5);
            }
            assert_eq!(stops(&mut rig), expected, "{reaction:?}, only once");
        }
    }
}

#[test]
fn outputs_after_clear_give_no_edge_until_the_flag_was_0() {
    // The first outputs after Clear are those before it, with the flag 0, or have the flag.
    for is_unchanged in [false, true] {
        let mut rig = Master::homed(AT_500K, quick());
        rig.control(0x02, 0);
        rig.pass_silent(10);
        rig.set(if is_unchanged { Flag::empty() } else { Flag::GRIP });
        rig.pass(20);
        assert_eq!(rig.world.take_motions(), [], "unchanged: {is_unchanged}");
        if !is_unchanged {
            rig.set(Flag::empty());
        }
        rig.set(Flag::GRIP);
        rig.pass(20);
        assert_eq!(rig.world.take_motions(), [CommandId::GripPart], "unchanged: {is_unchanged}");
    }
}

#[test]
fn jog_ends_when_the_master_leaves_at_any_reaction() {
    type Leave = fn(&mut Master);
    let ways: [(&str, Leave); 5] = [
        ("clears", |rig| rig.control(0x02, 0)),
        ("unlocks", |rig| assert_eq!(rig.service(points::SET_PRM, &[0x40, 0, 0, 0, 0x55, 0x55, 0]), SC)),
        ("sends parameters again", |rig| rig.start(WATCHDOG)),
        ("sends another configuration", |rig| assert_eq!(rig.service(points::CHK_CFG, &[0xA7, 0x9A]), SC)),
        ("sends outputs of another length", |rig| drop(rig.send(&sd2(&[STATION, MASTER, 0x6D, 1, 2])))),
    ];
    for (way, leave) in ways {
        let mut rig = Master::exchanging(with_reaction(SilenceReaction::Hold), quick(), WATCHDOG);
        rig.command(Flag::HOMING);
        rig.command(Flag::MOVE);
        rig.image.speed = 5_00;
        rig.set(Flag::JOG_PLUS);
        rig.pass(50);
        assert_eq!(rig.exchange().1.state, Shown::RELEASING);
        assert_eq!(stops(&mut rig), []);
        leave(&mut rig);
        rig.pass_silent(20);
        assert_eq!(stops(&mut rig), [CommandId::Stop], "a master that {way}");
        // The master resumes with its button still pressed.
        rig.start(WATCHDOG);
        rig.pass(100);
        assert_eq!(rig.world.take_motions(), [], "{way}");
    }
}

#[test]
fn master_without_watchdog_times_out_by_bus_timeout_and_resumes() {
    let mut rig = Master::exchanging(AT_500K, quick(), 0);
    rig.command(Flag::HOMING);
    rig.image.speed = 5_00;
    rig.set(Flag::JOG_MINUS);
    rig.pass(50);
    rig.world.take_sent();
    rig.exchange();
    rig.pass_silent(Config::DEFAULT.bus.timeout_ms as u32 - 5);
    assert_eq!(stops(&mut rig), [], "too early");
    rig.pass_silent(10);
    assert_eq!(stops(&mut rig), [CommandId::Stop]);
    rig.pass(100);
    assert_eq!(rig.world.take_motions(), [], "the flag is unchanged");
    rig.set(Flag::empty());
    rig.pass(3);
    rig.set(Flag::JOG_MINUS);
    rig.pass(20);
    assert_eq!(rig.world.take_motions(), [CommandId::PrePosition]);
    // The outputs were 0 before the time-out, and are 0 when the master resumes. So the next flag is an edge.
    rig.set(Flag::empty());
    rig.pass(500);
    rig.pass_silent(2_000);
    rig.pass(5);
    rig.world.take_sent();
    rig.image.speed = 50_00;
    rig.set(Flag::MOVE);
    rig.pass(5);
    assert_eq!(rig.world.take_motions(), [CommandId::PrePosition]);
}

#[test]
fn master_without_watchdog_never_times_out_at_bus_timeout_0() {
    let bus = BusConfig { timeout_ms: 0, ..AT_500K.bus };
    let mut rig = Master::exchanging(Config { bus, ..AT_500K }, quick(), 0);
    rig.command(Flag::HOMING);
    rig.image.speed = 5_00;
    rig.set(Flag::JOG_MINUS);
    rig.pass(50);
    assert_eq!(rig.world.take_motions(), [CommandId::Homing, CommandId::PrePosition]);
    rig.pass_silent(5_000);
    assert_eq!(stops(&mut rig), []);
}

#[test]
fn bus_timeout_and_watchdog_count_as_one_time_out() {
    let mut rig = moving(SilenceReaction::Stop);
    // A watchdog of 2.5 s, longer than BUS_TIMEOUT.
    rig.start(250);
    rig.set(Flag::empty());
    rig.set(Flag::MOVE);
    rig.pass(50);
    rig.world.take_sent();
    rig.pass_silent(1_100);
    assert_eq!(stops(&mut rig), [CommandId::Stop]);
    rig.pass_silent(3_000);
    assert_eq!(stops(&mut rig), [], "only once");
}

#[test]
fn diagnosis_is_announced_when_a_fault_rises_and_read_once() {
    let mut rig = Master::exchanging(AT_500K, quick(), WATCHDOG);
    assert_eq!(rig.exchange().0, 0x08, "low priority");
    let now = Time::from_millis(rig.world.now_ms().into());
    rig.world.gripper().set_fault(Fault::OverTemperature, true, now);
    rig.pass(100);
    let (function, input) = rig.exchange();
    assert!(input.system.contains(SystemFlags::TEMP_FAULT));
    assert_eq!(function, 0x0A, "high priority: diagnosis available");
    let answer = rig.service(points::SLAVE_DIAG, &[]);
    let expected = Diagnosis { standard: [0x08, 0x0C, 0x00, MASTER], system: input.system }.to_bytes();
    assert_eq!(answer[9..25], expected);
    assert_eq!(rig.exchange().0, 0x08, "read");
    // The end of a fault is not announced. Without any fault, Diag.Ext_Diag is 0.
    let now = Time::from_millis(rig.world.now_ms().into());
    rig.world.gripper().set_fault(Fault::OverTemperature, false, now);
    rig.pass(100);
    rig.command(Flag::STOP_ACK);
    rig.pass(100);
    let (function, input) = rig.exchange();
    assert!(!input.system.intersects(Diagnosis::TRIGGERS), "{input:?}");
    assert_eq!((function, rig.service(points::SLAVE_DIAG, &[])[9]), (0x08, 0x00));
}

#[test]
fn diagnosis_has_16_bytes_even_while_no_flag_is_known() {
    let mut rig = Master::new(AT_500K, quick());
    rig.world.set_cut(true);
    rig.pass_silent(10);
    assert_eq!(rig.diagnosis(), [0x02, 0x05, 0x00, 0xFF]);
}

#[test]
fn part_is_gripped_at_every_rate() {
    for rate in ProfibusConfig::RATES {
        let profibus = ProfibusConfig { rate: Some(rate), ..AT_500K.profibus };
        let mut rig = Master::homed(Config { profibus, ..AT_500K }, with_part(20.0));
        assert_eq!(rig.command(Flag::GRIP), Status::Success, "{rate:?}");
        assert_eq!(rig.exchange().1.state, Shown::HOLDING, "{rate:?}");
    }
}

#[test]
fn fast_stop_for_one_exchange_takes_effect_at_the_highest_rate() {
    let profibus = ProfibusConfig { rate: Some(Baud::M1_5), ..ProfibusConfig::DEFAULT };
    let slow = wsg_sim::Config::default();
    let mut rig = Master::exchanging(Config { profibus, ..AT_500K }, slow, WATCHDOG);
    rig.command(Flag::HOMING);
    rig.image.speed = 10_00;
    rig.set(Flag::MOVE);
    rig.pass(20);
    let turn = rig.world.now_ms();
    rig.set(Flag::MOVE | Flag::FASTSTOP);
    rig.set(Flag::empty());
    assert!(rig.world.now_ms() - turn <= 1, "both within one millisecond");
    rig.pass(20);
    assert_eq!(stops(&mut rig), [CommandId::FastStop]);
    assert!(rig.exchange().1.system.contains(SystemFlags::FAST_STOP));
}

#[test]
fn rate_is_searched_until_telegrams_are_received() {
    let mut rig = Master::new(Config { profibus: ProfibusConfig::DEFAULT, ..AT_500K }, quick());
    assert_eq!(rig.world.rate(), Some(Baud::K9_6));
    let mut tried = vec![];
    while rig.world.rate() != Some(Baud::K500) {
        if tried.last() != Some(&rig.world.rate()) {
            tried.push(rig.world.rate());
        }
        rig.pass_silent(1);
        assert!(rig.world.now_ms() < 5_000, "{tried:?}");
    }
    let slower = &ProfibusConfig::RATES[..5];
    assert_eq!(tried, slower.iter().copied().map(Some).collect::<Vec<_>>(), "in ascending order");
    rig.start(WATCHDOG);
    rig.pass(6_000);
    assert_eq!(rig.world.rate(), Some(Baud::K500));
    // After five seconds of silence, the search continues.
    rig.pass_silent(5_010);
    assert_eq!(rig.world.rate(), Some(Baud::M1_5));
}

/// The watchdog (IEC 61158-6-3) and BUS_TIMEOUT (docs/registers.md) start with the last request of the commanding master.
#[test]
fn silent_master_times_out_despite_other_profibus_traffic() {
    let image = [&[Flag::MOVE.bits(), 0][..], &[0; 6]].concat();
    let exchange = |station: u8, master: u8| sd3(&[&[station, master, 0x5D][..], &image].concat());
    let mut wrong_sum = exchange(STATION, MASTER);
    wrong_sum[11] ^= 1;
    let diagnosis = [STATION | 0x80, SECOND_MASTER | 0x80, 0x5D, points::SLAVE_DIAG, points::MASTER];
    let traffic = [
        ("the master's exchange with another slave", exchange(STATION + 1, MASTER)),
        ("the answer of another slave", sd2(&[&[MASTER, STATION + 1, 0x08][..], &[0; 12]].concat())),
        ("a token", vec![0xDC, SECOND_MASTER, MASTER]),
        ("an exchange with a wrong checksum", wrong_sum),
        ("half an exchange", exchange(STATION, MASTER)[..7].to_vec()),
        ("another master's exchange", exchange(STATION, SECOND_MASTER)),
        ("another master that reads the diagnosis", sd2(&diagnosis)),
        ("another master that looks for stations", sd1(&[STATION, SECOND_MASTER, 0x49])),
    ];
    let bus_timeout_ms = u32::from(Config::DEFAULT.bus.timeout_ms);
    for (watchdog, limit_ms) in [(WATCHDOG, WATCHDOG_MS), (0, bus_timeout_ms)] {
        for (what, telegram) in &traffic {
            let mut rig = moving_with(SilenceReaction::Stop, watchdog);
            rig.exchange();
            let from = rig.world.now_ms();
            let mut pass = |until_ms: u32| {
                while rig.world.now_ms() - from < until_ms {
                    rig.send(telegram);
                    rig.pass_silent(3);
                }
                stops(&mut rig)
            };
            assert_eq!(pass(limit_ms - 15), [], "too early with {what}");
            assert_eq!(pass(limit_ms + 15), [CommandId::Stop], "with {what}, watchdog {watchdog}");
        }
    }
}
