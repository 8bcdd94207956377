//! The text protocol at the virtual gripper in virtual time: effect and answers of each request.

use crate::common::{Rig, Sent};
use wsg_protocol::{Command, SoftLimits, SystemFlags};
use wsg_sim::{Config, Finger, Part, PortId, PortKind};

/// A gripper with a GCL client and virtual time.
struct Desk {
    rig: Rig,
}

impl Desk {
    fn new(config: Config) -> Self {
        Self { rig: Rig::on(PortKind::GclTcp, config) }
    }

    /// Returns a referenced gripper with the fingers wide open.
    fn homed(part: Option<Part>) -> Self {
        let mut desk = Self::new(Config { part, ..Config::default() });
        assert_eq!(desk.ask("HOME(1)"), ["ACK HOME"]);
        assert_eq!(desk.wait(5_000), ["FIN HOME"]);
        desk
    }

    /// Sends a line and returns the immediate answers.
    fn ask(&mut self, line: &str) -> Vec<String> {
        self.rig.send_bytes(format!("{line}\n").as_bytes());
        self.lines()
    }

    fn lines(&mut self) -> Vec<String> {
        lines_in(&self.rig.frames())
    }

    fn lines_of(&mut self, port: PortId) -> Vec<String> {
        lines_in(&self.rig.frames_of(port))
    }

    /// Advances time and returns the lines sent meanwhile.
    fn wait(&mut self, millis: u64) -> Vec<String> {
        lines_in(&self.rig.wait(millis))
    }

    /// Starts a motion, waits for its end and returns its last line.
    fn run(&mut self, line: &str) -> String {
        let mut lines = self.ask(line);
        lines.extend(self.wait(10_000));
        assert_eq!(lines.len(), 2, "{line}: {lines:?}");
        assert!(lines[0].starts_with("ACK "), "{line}: {lines:?}");
        lines.remove(1)
    }

    fn one(&mut self, line: &str) -> String {
        let mut lines = self.ask(line);
        assert_eq!(lines.len(), 1, "{line}: {lines:?}");
        lines.remove(0)
    }
}

fn lines_in(frames: &[Sent]) -> Vec<String> {
    let line = |sent: &Sent| {
        let text = str::from_utf8(&sent.frame).expect("a line is ASCII");
        let text = text.strip_suffix('\n').expect("a line at a time, with LF");
        assert!(!text.contains(['\n', '\r']), "{text:?}");
        text.to_owned()
    };
    frames.iter().map(line).collect()
}

fn part(width: f32) -> Option<Part> {
    Part::of_width(width)
}

/// Command set, 3.3.5.
#[test]
fn motions_from_outside_the_soft_limits_need_a_target_inside() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.run("MOVE(10)"), "FIN MOVE");
    let limits = SoftLimits { minus: 20.0, plus: 80.0 };
    desk.rig.gripper.command(&Command::SetSoftLimits { limits }, desk.rig.now);
    for line in ["MOVE(15)", "MOVE(10)", "MOVE(81)", "GRIP(40,19)"] {
        let name = line.split('(').next().unwrap();
        assert_eq!(desk.one(line), format!("ERR {name} 28"), "{line}");
    }
    assert_eq!(desk.rig.gripper.state().width, 10.0);
    assert_eq!(desk.run("MOVE(20)"), "FIN MOVE");

    let mut desk = Desk::homed(Part::of_width(50.0));
    desk.rig.gripper.command(&Command::SetSoftLimits { limits }, desk.rig.now);
    assert_eq!(desk.run("GRIP(40,50)"), "FIN GRIP");
    assert_eq!(desk.one("RELEASE(31)"), "ERR RELEASE 28");
    assert_eq!(desk.run("RELEASE(30)"), "FIN RELEASE");
}

/// Each command is sent as such a client sends it, and none spoils the next.
#[test]
fn bytes_between_lines_spoil_no_command() {
    for (client, end) in [
        ("telnet", &b"\r\0"[..]),
        ("telnet with LF", b"\r\n"),
        ("a C program with sizeof", b"\n\0"),
        ("a C program with a fixed buffer", b"\n\0\0\0\0\0\0"),
    ] {
        let mut desk = Desk::new(Config::default());
        for (request, answer) in [("HOME(1)", "ACK HOME"), ("STOP()", "ACK STOP"), ("FSACK()", "ACK FSACK")] {
            desk.rig.send_bytes(&[request.as_bytes(), end].concat());
            assert_eq!(desk.lines().first().map(String::as_str), Some(answer), "{client}: {request}");
        }
    }
    // A datagram is a line without a line end.
    let mut desk = Desk::new(Config::default());
    desk.rig.port = desk.rig.gripper.connect(PortKind::GclUdp).unwrap();
    for _ in 0..2 {
        desk.rig.send_bytes(b"FSACK()\0");
        assert_eq!(desk.lines(), ["ACK FSACK"]);
    }
}

#[test]
fn release_takes_the_presets_that_are_set() {
    let config = Config {
        part: Part::of_width(20.0),
        release_distance: 30.0,
        release_speed: Some(10.0),
        ..Config::default()
    };
    let mut desk = Desk::new(config);
    desk.ask("HOME(1)");
    assert_eq!(desk.wait(5_000), ["FIN HOME"]);
    desk.ask("GRIP(40,20)");
    assert_eq!(desk.wait(5_000), ["FIN GRIP"]);
    let held = desk.rig.gripper.state().width;
    assert_eq!(desk.ask("RELEASE()"), ["ACK RELEASE"]);
    assert!(desk.wait(2_900).is_empty(), "30 mm at 10 mm/s");
    assert_eq!(desk.wait(300), ["FIN RELEASE"]);
    assert!((desk.rig.gripper.state().width - held - 30.0).abs() < 0.01);
}

#[test]
fn gripper_says_what_it_is() {
    let mut desk = Desk::new(Config { serial_number: 12_345_678, ..Config::default() });
    assert_eq!(desk.one("devtype?"), "DEVTYPE=\"WSG 50-110\"");
    assert_eq!(desk.one("version?"), "VERSION=\"4.0.0\"");
    assert_eq!(desk.one("sn?"), "SN=12345678");
    assert_eq!(desk.one("tag?"), "TAG=\"\"");
    assert!(desk.one("temp?").starts_with("TEMP="));
    assert_eq!(desk.one("gripstate?"), "GRIPSTATE=0");
    assert_eq!(desk.one("gripstats?"), "GRIPSTATS=[0,0,0]");
    let mut small = Desk::new(Config { model: wsg_sim::Model::Wsg32, ..Config::default() });
    assert_eq!(small.one("DEVTYPE?"), "DEVTYPE=\"WSG 32-068\"");
}

#[test]
fn queries_are_answered_between_ack_and_fin_of_a_motion() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.ask("MOVE(50,100)"), ["ACK MOVE"]);
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=6");
    assert_eq!(desk.wait(200), Vec::<String>::new());
    assert_eq!(desk.one("SPEED?"), "SPEED=-100.0");
    assert_eq!(desk.one("MOVE(60)"), "ERR MOVE 4");
    assert_eq!(desk.wait(2_000), ["FIN MOVE"]);
    assert_eq!(desk.one("POS?"), "POS=50.0");
}

#[test]
fn move_onto_a_part_is_blocked() {
    let mut desk = Desk::homed(part(20.0));
    assert_eq!(desk.run("MOVE(10)"), "ERR MOVE 29");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=7");
}

#[test]
fn grip_of_a_part_holds_it_and_release_opens_by_a_distance() {
    let mut desk = Desk::homed(part(20.0));
    assert_eq!(desk.run("GRIP(40,20,100)"), "FIN GRIP");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
    assert_eq!(desk.one("FORCE?"), "FORCE=40.0");
    assert_eq!(desk.run("RELEASE(5)"), "FIN RELEASE");
    let width = desk.rig.gripper.state().width;
    assert!((width - 24.6).abs() < 0.2, "{width}");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=0");
    assert_eq!(desk.one("GRIPSTATS?"), "GRIPSTATS=[1,0,0]");
}

#[test]
fn release_is_for_after_a_grip_only() {
    let mut desk = Desk::homed(part(20.0));
    assert_eq!(desk.one("RELEASE()"), "ERR RELEASE 1");
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
    assert_eq!(desk.one("GRIP(40,20)"), "ERR GRIP 4");
    assert_eq!(desk.run("RELEASE()"), "FIN RELEASE");
    assert_eq!(desk.one("RELEASE()"), "ERR RELEASE 1");
}

/// 2.2.3: "Es ist nicht möglich, auf einen Greifbefehl hin einen weiteren Greifbefehl auszuführen."
#[test]
fn grip_after_grip_is_refused_until_release_or_move() {
    for (held, outcome) in [(part(20.0), "FIN GRIP"), (None, "ERR GRIP 18")] {
        let mut desk = Desk::homed(held);
        assert_eq!(desk.run("GRIP(40,20)"), outcome);
        for again in ["GRIP()", "GRIP(20)", "GRIP(40,20)", "GRIP(40,90,50)"] {
            assert_eq!(desk.one(again), "ERR GRIP 4", "{outcome}");
        }
        assert_eq!(desk.run("RELEASE(30)"), "FIN RELEASE");
        assert_eq!(desk.run("GRIP(40,20)"), outcome);
    }
    let mut desk = Desk::homed(part(20.0));
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
    desk.rig.gripper.set_part(None, desk.rig.now);
    assert_eq!(desk.one("GRIP(40,20)"), "ERR GRIP 4", "PART LOST");
    assert_eq!(desk.run("MOVE(50)"), "FIN MOVE");
    assert_eq!(desk.run("GRIP(40,20)"), "ERR GRIP 18");
}

/// 2.2.2: "Der Befehl MOVE kann nicht zum Greifen oder Loslassen von Teilen verwendet werden."
#[test]
fn move_does_not_release_a_part_that_is_held() {
    let mut desk = Desk::homed(part(20.0));
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
    assert_eq!(desk.one("MOVE(100)"), "ERR MOVE 4");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
    assert_eq!(desk.one("FORCE?"), "FORCE=40.0");
    assert_eq!(desk.run("RELEASE(30)"), "FIN RELEASE");
    assert_eq!(desk.run("MOVE(100)"), "FIN MOVE");
    assert_eq!(desk.one("GRIPSTATS?"), "GRIPSTATS=[1,0,0]");
}

/// 2.2.3, cases 1 and 2: the end stop counts as a part, once the force is established.
#[test]
fn force_against_the_end_stop_rises_before_the_grip_counts() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.ask("GRIP(60)"), ["ACK GRIP"]);
    let mut rising = vec![];
    while desk.wait(1).is_empty() {
        rising.push(desk.rig.gripper.state().force);
        assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=1");
    }
    assert!(rising.iter().filter(|force| (1.0..59.0).contains(*force)).count() > 10, "{rising:?}");
    assert!(rising.windows(2).all(|pair| pair[0] <= pair[1]), "{rising:?}");
    assert_eq!(desk.one("FORCE?"), "FORCE=60.0");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
}

#[test]
fn release_after_an_outward_grip_goes_inward() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.run("MOVE(20)"), "FIN MOVE");
    assert_eq!(desk.run("GRIP(40,110)"), "ERR GRIP 18");
    assert_eq!(desk.run("RELEASE(5)"), "FIN RELEASE");
    let width = desk.rig.gripper.state().width;
    assert!((width - 105.0).abs() < 0.5, "{width}");
}

#[test]
fn grip_without_a_part_at_its_width_finds_none() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.run("GRIP(40,20)"), "ERR GRIP 18");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=2");
    assert_eq!(desk.one("GRIPSTATS?"), "GRIPSTATS=[1,1,0]");
    assert_eq!(desk.run("RELEASE(10)"), "FIN RELEASE");
}

#[test]
fn grip_without_a_width_holds_what_it_meets() {
    let mut desk = Desk::homed(part(35.0));
    assert_eq!(desk.run("GRIP(30)"), "FIN GRIP");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
    assert_eq!(desk.one("FORCE?"), "FORCE=30.0");
}

#[test]
fn grip_without_a_width_ends_holding_at_the_end_stop() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.run("GRIP()"), "FIN GRIP");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
    assert_eq!(desk.one("POS?"), "POS=0.0");
    assert_eq!(desk.wait(1_000), Vec::<String>::new());
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=4");
}

#[test]
fn part_outside_the_tolerance_blocks_the_axis() {
    let mut desk = Desk::homed(part(30.0));
    assert_eq!(desk.run("GRIP(40,20)"), "ERR GRIP 29");
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=7");
    assert_eq!(desk.run("RELEASE(20)"), "FIN RELEASE");
    assert_eq!(desk.one("PWT=11"), "PWT=11.0");
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
}

#[test]
fn clamping_travel_bounds_what_a_soft_part_may_give_way() {
    let soft = Part::new(20.0, 5.0);
    let mut desk = Desk::homed(soft);
    assert_eq!(desk.one("CLT=1"), "CLT=1.0");
    assert_eq!(desk.run("GRIP(40,20)"), "ERR GRIP 18");
    assert_eq!(desk.run("RELEASE(20)"), "FIN RELEASE");
    assert_eq!(desk.one("CLT=10"), "CLT=10.0");
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
}

#[test]
fn tolerance_and_clamping_travel_are_those_of_the_connection() {
    let mut desk = Desk::homed(None);
    let other = desk.rig.gripper.connect(PortKind::GclTcp).unwrap();
    assert_eq!(desk.one("PWT=2.5"), "PWT=2.5");
    assert_eq!(desk.one("CLT=1.5"), "CLT=1.5");
    assert_eq!(desk.one("PWT=-1"), "ERR PWT 28");
    assert_eq!(desk.one("PWT?"), "PWT=2.5");
    desk.rig.gripper.receive(other, desk.rig.now, b"PWT?\nCLT?\n");
    assert_eq!(desk.lines_of(other), ["PWT=5.0", "CLT=5.0"]);
    desk.ask("BYE()");
    desk.rig.gripper.disconnect(desk.rig.port, desk.rig.now);
    desk.rig.port = desk.rig.gripper.connect(PortKind::GclTcp).unwrap();
    assert_eq!(desk.one("PWT?"), "PWT=5.0");
}

#[test]
fn grip_force_does_not_change_the_binary_force_limit() {
    let mut desk = Desk::homed(part(20.0));
    let before = desk.rig.gripper.state().force_limit;
    assert_eq!(desk.run("GRIP(12,20)"), "FIN GRIP");
    assert_eq!(desk.rig.gripper.state().force, 12.0);
    assert_eq!(desk.rig.gripper.state().force_limit, before);
}

#[test]
fn stop_aborts_the_motion() {
    let mut desk = Desk::homed(None);
    desk.ask("MOVE(20)");
    desk.wait(100);
    assert_eq!(desk.ask("STOP()"), ["ACK STOP", "ERR MOVE 19"]);
    assert_eq!(desk.one("GRIPSTATE?"), "GRIPSTATE=0");
    assert_eq!(desk.one("SYSFLAGS[6]?"), "SYSFLAGS[6]=1");
}

#[test]
fn fast_stop_locks_motion_until_fsack() {
    let mut desk = Desk::homed(None);
    desk.ask("MOVE(20)");
    desk.wait(100);
    assert_eq!(desk.ask("faststop()"), ["ACK FASTSTOP", "ERR MOVE 19"]);
    for motion in ["MOVE(30)", "GRIP()", "RELEASE()", "HOME()"] {
        let name = motion.split('(').next().unwrap();
        assert_eq!(desk.one(motion), format!("ERR {name} 16"));
    }
    assert_eq!(desk.one("SYSFLAGS[12]?"), "SYSFLAGS[12]=1");
    assert_eq!(desk.one("FSACK()"), "ACK FSACK");
    assert_eq!(desk.run("MOVE(30)"), "FIN MOVE");
    assert_eq!(desk.one("FSACK()"), "ACK FSACK");
}

#[test]
fn bye_refuses_all_that_follows_and_the_end_is_no_error() {
    let mut desk = Desk::homed(None);
    desk.ask("AUTOSEND(\"TEMP\",10)");
    desk.ask("MOVE(20)");
    desk.wait(100);
    assert_eq!(desk.ask("BYE()"), ["ACK BYE", "ERR MOVE 19"]);
    assert_eq!(desk.wait(100), Vec::<String>::new());
    assert_eq!(desk.one("POS?"), "ERR POS 16");
    desk.rig.gripper.disconnect(desk.rig.port, desk.rig.now);
    assert!(!desk.rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn connection_that_ends_without_bye_latches_a_fast_stop() {
    let mut desk = Desk::homed(None);
    desk.rig.gripper.disconnect(desk.rig.port, desk.rig.now);
    assert!(desk.rig.flags().contains(SystemFlags::FAST_STOP));
    let mut tolerant = Desk::new(Config { disconnect_error: false, ..Config::default() });
    tolerant.rig.gripper.disconnect(tolerant.rig.port, tolerant.rig.now);
    assert!(!tolerant.rig.flags().contains(SystemFlags::FAST_STOP));
}

#[test]
fn datagrams_have_no_bye_and_end_their_line() {
    let mut desk = Desk { rig: Rig::on(PortKind::GclUdp, Config::default()) };
    desk.rig.send_bytes(b"GRIPSTATE?");
    assert_eq!(desk.lines(), ["GRIPSTATE=0"]);
    assert_eq!(desk.one("BYE()"), "ERR BYE 1");
    desk.rig.gripper.disconnect(desk.rig.port, desk.rig.now);
    assert!(!desk.rig.flags().contains(SystemFlags::FAST_STOP));
}

/// The session command of 2.1.1, as a setting.
#[test]
fn connection_begins_in_verbose_mode_if_that_is_set() {
    let mut desk = Desk::new(Config { gcl_verbose: true, ..Config::default() });
    let refused = desk.one("MOVE(20)");
    assert!(refused.starts_with("ERR MOVE 3 "), "{refused}");
}

/// 1.3: "eine textuelle Beschreibung des aufgetretenen Fehlers".
#[test]
fn verbose_mode_adds_a_text_on_this_connection() {
    let mut desk = Desk::new(Config::default());
    assert_eq!(desk.one("MOVE(50)"), "ERR MOVE 3");
    assert_eq!(desk.one("VERBOSE=1"), "VERBOSE=1");
    assert_eq!(desk.one("MOVE(50)"), "ERR MOVE 3 device not initialized: the fingers are not referenced");
    assert_eq!(desk.one("dance()"), "ERR DANCE 14 unknown command");
    assert_eq!(desk.run("HOME(1)"), "FIN HOME");
    assert_eq!(desk.run("GRIP(40)"), "FIN GRIP");
    assert_eq!(desk.one("MOVE(50)"), "ERR MOVE 4 already running: the fingers move or hold a part");
    assert_eq!(desk.one("VERBOSE=0"), "VERBOSE=0");
    assert_eq!(desk.one("MOVE(50)"), "ERR MOVE 4");
}

#[test]
fn invalid_and_overlong_lines_are_answered() {
    let mut desk = Desk::new(Config::default());
    assert_eq!(desk.ask("%&!"), ["ERR ? 15"]);
    assert_eq!(desk.ask(""), Vec::<String>::new());
    let long = format!("MOVE({})", "0".repeat(400));
    assert_eq!(desk.ask(&long), ["ERR MOVE 27"]);
    assert_eq!(desk.one("POS?"), "POS=0.0");
    let counters = desk.rig.gripper.counters(desk.rig.port).unwrap();
    assert_eq!((counters.parser.oversize, counters.parser.dropped), (1, 406));
}

#[test]
fn several_lines_at_once_are_answered_in_order() {
    let mut desk = Desk::homed(None);
    desk.rig.send_bytes(b"POS?\r\nSPEED?\rFORCE?\n\nGRIP");
    assert_eq!(desk.lines(), ["POS=110.0", "SPEED=0.0", "FORCE=0.0"]);
    assert_eq!(desk.ask("STATE?"), ["GRIPSTATE=0"]);
}

#[test]
fn autosend_sends_at_its_interval_and_ends_with_0() {
    let mut desk = Desk::homed(None);
    assert_eq!(desk.one("AUTOSEND(\"POS\",50)"), "ACK AUTOSEND");
    assert_eq!(desk.wait(200), vec!["@POS=110.0"; 4]);
    assert_eq!(desk.one("AUTOSEND(\"POS\",1)"), "ACK AUTOSEND");
    assert_eq!(desk.wait(50).len(), 5, "the interval is at least 10 ms");
    assert_eq!(desk.one("AUTOSEND(\"POS\",0)"), "ACK AUTOSEND");
    assert_eq!(desk.wait(200), Vec::<String>::new());
}

#[test]
fn autosend_with_a_delta_waits_for_that_change() {
    let mut desk = Desk::homed(None);
    desk.ask("AUTOSEND(\"POS\",10,2)");
    assert_eq!(desk.wait(500), ["@POS=110.0"]);
    desk.ask("MOVE(90,100)");
    let lines = desk.wait(1_000);
    let widths: Vec<f32> = lines.iter().filter_map(|line| line.strip_prefix("@POS=")?.parse().ok()).collect();
    assert!((7..=10).contains(&widths.len()), "{lines:?}");
    assert!(widths.windows(2).all(|pair| pair[0] - pair[1] >= 2.0), "{widths:?}");
}

#[test]
fn autosend_on_change_is_sent_once_and_then_at_changes() {
    let mut desk = Desk::homed(part(20.0));
    desk.ask("AUTOSEND(\"GRIPSTATE\",10,1)");
    assert_eq!(desk.wait(200), ["@GRIPSTATE=0"]);
    let mut lines = desk.ask("GRIP(40,20)");
    lines.extend(desk.wait(3_000));
    assert_eq!(lines, ["ACK GRIP", "@GRIPSTATE=1", "FIN GRIP", "@GRIPSTATE=4"]);
}

#[test]
fn autosend_leaves_the_command_failure_to_be_read() {
    let mut desk = Desk::new(Config::default());
    assert_eq!(desk.one("MOVE(50)"), "ERR MOVE 3");
    assert_eq!(desk.one("AUTOSEND(\"SYSFLAGS\",10,1)"), "ACK AUTOSEND");
    assert!(desk.rig.flags().contains(SystemFlags::CMD_FAILURE));
    assert_eq!(desk.one("AUTOSEND(\"SYSFLAGS\",10,2)"), "ERR AUTOSEND 24");
    assert_eq!(desk.one("STOP()"), "ACK STOP");
    assert!(!desk.rig.flags().contains(SystemFlags::CMD_FAILURE));
}

#[test]
fn width_is_not_sent_while_not_referenced() {
    let mut desk = Desk::new(Config::default());
    desk.ask("AUTOSEND(\"POS\",10)");
    assert_eq!(desk.wait(100), Vec::<String>::new());
}

#[test]
fn fingers_are_queried_one_by_one_and_together() {
    let mut desk =
        Desk::new(Config { fingers: [Finger::Fmf, Finger::None], part: part(20.0), ..Config::default() });
    assert_eq!(desk.one("FTYPE?"), "FTYPE=[\"WSG-FMF\",\"\"]");
    assert_eq!(desk.one("FTYPE[1]?"), "FTYPE[1]=\"\"");
    assert_eq!(desk.one("FDATA?"), "FDATA=[0.0,[]]");
    assert_eq!(desk.one("FDATA[0]?"), "FDATA[0]=0.0");
    assert_eq!(desk.one("FDATA[1]?"), "ERR FDATA 1");
    assert_eq!(desk.one("FFLAGS[0]?"), "FFLAGS[0]=[1,1,1,0,0,0,0,0,0,0,0,0,0,0,0,0]");
    assert!(desk.one("FFLAGS?").starts_with("FFLAGS=[[1,1,1,"));
    assert_eq!(desk.one("TARE()"), "ACK TARE");
    assert_eq!(desk.one("TARE(0)"), "ACK TARE");
    assert_eq!(desk.one("TARE(1)"), "ERR TARE 1");
    assert_eq!(desk.run("HOME(1)"), "FIN HOME");
    assert_eq!(desk.run("GRIP(40,20)"), "FIN GRIP");
    assert_eq!(desk.one("FDATA[0]?"), "FDATA[0]=20.0");
    assert_eq!(desk.one("TARE(0)"), "ERR TARE 16");
}
