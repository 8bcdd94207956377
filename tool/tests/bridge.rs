//! Runs `wsg bridge` against the bridge's library on a pseudo terminal, and against the flashed image in the emulator. The expected
//! output is in `golden/`; `WSG_UPDATE_DOCS=1` rewrites it.
#![cfg(unix)]

#[path = "common/program.rs"]
mod program;

use std::fs;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bus_modbus::rtu::Character;
use document::{hold_file, read};
use host_tests::addresses::{place, setting};
use host_tests::emulator::stm_board::B_L475E_IOT01A;
use host_tests::emulator::{Emulator, Extras};
use host_tests::flash_controller::FlashController;
use host_tests::flash_model::Fault;
use host_tests::gripper_end::GripperEnd;
use host_tests::rig::motions;
use host_tests::slot_model::{SlotModel, keys, signed};
use host_tests::terminal::Terminal;
use host_tests::trace::Trace;
use host_tests::world::BOARD;
use host_tests::world::modbus::Master;
use host_tests::world::service_line::ServiceLine;
use program::{printed, wsg, wsg_with};
use wsg_bridge_fw::registers::{FIRST_SETTING, MAP_VERSION, SETTINGS};
use wsg_bridge_fw::{BusPort, Config, ResetCause};
use wsg_protocol::SystemFlags;

/// The bridge's end of the service port, with injected faults.
struct Line {
    line: ServiceLine,
    faults: Arc<Faults>,
    /// A response to FC 16 or FC 21 was sent or suppressed.
    has_written: bool,
}

#[derive(Default)]
struct Faults {
    is_silent: AtomicBool,
    /// Suppresses the next response to FC 16 or FC 21.
    loses_answer: AtomicBool,
    /// Lets the PLC write RECIPE0_SPEED after the next FC 16.
    meddles: AtomicBool,
}

impl BusPort for Line {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.line.receive()
    }

    fn silence_us(&mut self) -> u32 {
        self.line.silence_us()
    }

    fn send(&mut self, frame: &[u8]) {
        let is_write = matches!(frame.get(1), Some(16 | 21));
        self.has_written |= is_write;
        let is_lost = is_write && self.faults.loses_answer.swap(false, Ordering::SeqCst);
        if !is_lost && !self.faults.is_silent.load(Ordering::SeqCst) {
            self.line.send(frame);
        }
    }
}

type Act = Box<dyn FnOnce(&mut Master) + Send>;

/// A bridge that runs in a thread. Its time never runs slower than the wall clock.
struct Served {
    terminal: Terminal,
    faults: Arc<Faults>,
    acts: Sender<Act>,
    plant: Option<JoinHandle<()>>,
    end: Arc<AtomicBool>,
}

impl Served {
    /// Starts a bridge whose fingers take long to home.
    fn new() -> Self {
        Self::with(2.0)
    }

    fn with(homing_speed: f32) -> Self {
        let faults = Arc::<Faults>::default();
        let (line, far) = ServiceLine::new();
        let mut line = Line { line, faults: Arc::clone(&faults), has_written: false };
        let end = Arc::new(AtomicBool::new(false));
        let (acts, to_do) = mpsc::channel::<Act>();
        let is_ended = Arc::clone(&end);
        let plant = thread::spawn(move || {
            let gripper = wsg_sim::Config { homing_speed: Some(homing_speed), ..wsg_sim::Config::default() };
            let mut plant = Master::new(Config::DEFAULT, gripper);
            while !is_ended.load(Ordering::SeqCst) {
                line.line.read();
                plant.turn(&mut line);
                if std::mem::take(&mut line.has_written) && line.faults.meddles.swap(false, Ordering::SeqCst)
                {
                    plant.write(setting("RECIPE0_SPEED"), &[12_34]);
                }
                to_do.try_iter().for_each(|act| act(&mut plant));
                if slot(&mut plant).is_some_and(|slot| std::mem::take(&mut slot.restarts) > 0) {
                    plant.restart_bridge(ResetCause::Firmware);
                }
            }
        });
        let served = Self { terminal: Terminal::to(far).unwrap(), faults, acts, plant: Some(plant), end };
        // Wait for the gripper.
        served.wait(|plant| plant.bridge().is_connected());
        served
    }

    /// Runs a closure on the bridge between two turns.
    fn act<T: Send + 'static>(&self, act: impl FnOnce(&mut Master) -> T + Send + 'static) -> T {
        let (done, doing) = mpsc::channel();
        self.acts.send(Box::new(move |plant| done.send(act(plant)).expect("the caller waits"))).unwrap();
        doing.recv_timeout(BOUND).expect("the plant is running")
    }

    fn wait(&self, is_so: impl Fn(&mut Master) -> bool + Send + Clone + 'static) {
        let end = Instant::now() + BOUND;
        while !self.act(is_so.clone()) {
            assert!(Instant::now() < end, "the condition was not met");
        }
    }

    fn settings(&self) -> Vec<u16> {
        self.act(|plant| plant.holding(FIRST_SETTING, SETTINGS.len() as u8).unwrap())
    }

    /// Runs `wsg bridge PORT ...` and returns exit status and output.
    fn bridge(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let output = wsg(&[&["bridge", &self.terminal.path], arguments].concat(), b"");
        (output.status.code(), printed(&output))
    }

    #[track_caller]
    fn done(&self, arguments: &[&str]) -> String {
        let (code, printed) = self.bridge(arguments);
        assert_eq!(code, Some(0), "{printed}");
        printed
    }

    #[track_caller]
    fn refused(&self, arguments: &[&str], expected: &str) {
        let before = self.settings();
        let (code, printed) = self.bridge(arguments);
        assert_eq!(code, Some(1), "{printed}");
        assert!(
            printed.lines().last().is_some_and(|line| line.starts_with(&format!("wsg: {expected}"))),
            "{printed}"
        );
        assert_eq!(self.settings(), before);
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.end.store(true, Ordering::SeqCst);
        let _ = self.plant.take().map(JoinHandle::join);
    }
}

fn slot(plant: &mut Master) -> Option<&mut SlotModel> {
    plant.flash.slot.as_mut()
}

const BOUND: Duration = Duration::from_secs(60);

/// Starts a homing, with bus supervision switched off.
fn begin_to_home(plant: &mut Master) {
    plant.write(setting("BUS_TIMEOUT"), &[0]);
    plant.write(0, &[0, 0, 0, 0]);
    plant.write(0, &[0x0800, 0, 0, 0]);
}

/// The line of a settings file that states the register map version.
fn of_map(version: u16) -> String {
    format!("map_version = {version}\n")
}

fn temporary(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Compares the output with the golden file of this name.
fn hold(name: &str, shown: &str) {
    hold_file(&format!("tool/tests/golden/{name}"), shown);
}

#[test]
fn show_describes_bridge_and_gripper() {
    let served = Served::new();
    hold("show.txt", &served.done(&["show"]));
    hold("show_names.txt", &served.done(&["show", "recipe0_width", "PLC_BUS", "GRIPPER_LINK", "UNIT"]));
    hold("recipes.txt", &served.done(&["recipes"]));
    let all = served.done(&["show", "--all"]);
    assert!(
        all.contains("\nLINE_CHECKSUM          0\n") && all.contains("\nRESET_CAUSE            1  power-on"),
        "{all}"
    );
    served.refused(
        &["show", "RECIPE0_WITH"],
        "unknown setting or report `RECIPE0_WITH`; did you mean RECIPE0_WIDTH?",
    );
    let json: serde_json::Value = serde_json::from_str(&served.done(&["show", "--json"])).unwrap();
    assert_eq!(json["settings"]["RECIPE0_WIDTH"], 2000);
    assert_eq!(json["reports"]["GRIPPER_LINK"], 2);
    assert_eq!(json["input"]["state"][0], "IDLE");
}

#[test]
fn width_is_shown_once_the_fingers_are_referenced() {
    let served = Served::with(300.0);
    served.act(begin_to_home);
    // IDLE, and the width has been reported.
    served.wait(|plant| {
        let image = plant.input(0, 4).unwrap();
        image[0] >> 8 == 1 && image[3] != 0
    });
    let shown = served.done(&["show"]);
    assert!(
        shown
            .contains("\nfingers    IDLE, 110.00 mm, 0.00 N; last command: E_SUCCESS\nsystem     REFERENCED"),
        "{shown}"
    );
}

#[test]
fn events_are_described_with_their_remedies() {
    let served = Served::new();
    // A motion without prior homing, then FASTSTOP.
    served.act(|plant| {
        plant.write(0, &[0, 0, 0, 0]);
        plant.write(0, &[0x0100, 50_00, 50_00, 40_00]);
    });
    served.wait(|plant| plant.input(5, 1) == Ok(vec![3]));
    served.act(|plant| plant.write(0, &[0x2000, 50_00, 50_00, 40_00]));
    served.wait(|plant| plant.input(133, 1) == Ok(vec![11]));

    let events = served.done(&["events"]);
    // Ages depend on the wall clock.
    let ageless: String = events
        .lines()
        .map(|line| {
            line.split_once(" s ago").map_or(line.to_owned(), |(_, rest)| format!("  N s ago{rest}")) + "\n"
        })
        .collect();
    hold("events.txt", &ageless);
    let json: serde_json::Value = serde_json::from_str(&served.done(&["events", "--json"])).unwrap();
    assert_eq!(json["error"], "FAST_STOP_FLAG");
    assert_eq!(json["events"][1]["command"], "21h Pre-position Fingers");
    let watched = served.done(&["watch", "--times", "2", "--every", "50"]);
    assert_eq!(watched.matches("error      FAST_STOP_FLAG: ").count(), 2, "{watched}");
}

#[test]
fn settings_are_changed_stored_restored_and_reset() {
    let served = Served::new();
    let delivered = served.settings();
    let printed = served.done(&["set", "RECIPE0_WIDTH", "15mm", "plc_bus", "CANopen", "BUS_TIMEOUT", "0"]);
    hold("set.txt", &printed);
    let mut expected = delivered.clone();
    for (name, value) in [("RECIPE0_WIDTH", 15_00), ("PLC_BUS", 2), ("BUS_TIMEOUT", 0)] {
        expected[place(name)] = value;
    }
    assert_eq!(served.settings(), expected);
    assert_eq!(served.done(&["set", "PLC_BUS", "2"]), "no changes\n");

    assert!(served.done(&["restore"]).contains("PLC_BUS: CANopen becomes Modbus RTU (2 -> 1)"));
    assert_eq!(served.settings(), delivered);
    served.done(&["set", "RECIPE0_WIDTH", "1600"]);
    assert_eq!(served.done(&["save"]), "stored\n");
    served.act(|plant| plant.restart_bridge(ResetCause::PowerOn));
    assert_eq!(served.settings()[place("RECIPE0_WIDTH")], 16_00);
    assert!(served.done(&["show"]).contains("settings   source: stored; no unsaved changes"));

    served.refused(&["defaults"], "confirmation requires a terminal; pass --yes to skip it");
    assert!(
        served.done(&["defaults", "--yes"]).ends_with("16.00 mm becomes 20.00 mm (1600 -> 2000)\nstored\n")
    );
    served.act(|plant| plant.restart_bridge(ResetCause::PowerOn));
    assert_eq!(served.settings(), delivered);

    served.act(|plant| plant.flash.fault = Some(Fault::Protected));
    let (code, printed) = served.bridge(&["set", "RECIPE0_WIDTH", "1700", "--save"]);
    assert_eq!(code, Some(1));
    assert!(
        printed.ends_with(
            "wsg: the settings were not stored; run `events` for the cause. The stored settings are unchanged\n"
        ),
        "{printed}"
    );
    assert!(served.done(&["events"]).contains("SAVE_FAILED: the settings were not stored"));
}

#[test]
fn commands_of_the_quick_start_set_up_the_bridge() {
    let served = Served::new();
    let text = read("docs/quick-start.md");
    let commands = text.lines().filter_map(|line| line.strip_prefix("wsg bridge /dev/ttyACM0 "));
    let mut answers = String::new();
    for command in commands {
        if command.starts_with("show SETTINGS_FROM") {
            // The restart of the board.
            served.act(|plant| plant.restart_bridge(ResetCause::PowerOn));
        }
        answers.push_str(&served.done(&command.split(' ').collect::<Vec<_>>()));
    }
    assert!(answers.contains("stored\n"), "{answers}");
    let shown = served.done(&["show", "UNIT", "MODBUS_RATE", "RECIPE0_WIDTH", "SETTINGS_FROM"]);
    for value in ["UNIT                   5\n", "384", "20.00 mm", "1  stored"] {
        assert!(shown.contains(value), "{value}: {shown}");
    }
}

#[test]
fn invalid_values_are_rejected_in_one_line_before_any_write() {
    let served = Served::new();
    served.refused(&["set", "COLOUR", "3"], "unknown setting `COLOUR`");
    served.refused(
        &["set", "RECIPE0_WIDTH", "1500", "UNIT", "248"],
        "248 is out of range: UNIT takes 1 to 247",
    );
    served.refused(&["set", "UNIT", "5", "CAN_NODE"], "missing value for CAN_NODE");
    served.refused(&["set", "CAN_NODE", "127"], "invalid configuration: CAN_NODE takes 1 to 127");
    served.done(&["set", "CAN_NODE", "127", "CAN_MASTER", "16"]);
    served.act(begin_to_home);
    served.refused(&["set", "RECIPE0_WIDTH", "1500"], "nothing was changed: the fingers are moving");
}

#[test]
fn settings_file_is_imported_as_a_whole_or_not_at_all() {
    let served = Served::new();
    let file = temporary("settings.toml");
    let path = file.to_str().unwrap();
    served.done(&["export", path]);
    let exported = fs::read_to_string(&file).unwrap();
    hold("export.toml", &exported);
    assert_eq!(served.done(&["export", "-"]), exported);
    assert_eq!(served.done(&["import", path]), "no changes\n");
    fs::write(&file, format!("\u{FEFF}{}", exported.replace('\n', "\r\n"))).unwrap();
    assert_eq!(served.done(&["import", path]), "no changes\n", "saved by Notepad");
    fs::write(&file, "\u{FEFF}s".encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>()).unwrap();
    served.refused(&["import", path], &format!("cannot read {path}: the text is UTF-16; save it as UTF-8"));

    let changed = exported
        .replace("RECIPE0_WIDTH = 2000", "RECIPE0_WIDTH = \"15 mm\"")
        .replace("RECIPE15_SPEED = 5000", "RECIPE15_SPEED = 4000");
    fs::write(&file, &changed).unwrap();
    let before = served.settings();
    let described = served.done(&["import", "--dry-run", path]);
    assert_eq!(served.settings(), before);
    let printed = served.done(&["import", "--save", path]);
    assert_eq!(printed, described + "stored\n");
    served.act(|plant| plant.restart_bridge(ResetCause::PowerOn));
    assert_eq!(
        (served.settings()[place("RECIPE0_WIDTH")], served.settings()[place("RECIPE15_SPEED")]),
        (15_00, 40_00)
    );

    fs::write(&file, changed.replace("UNIT = 1 ", "UNIT = 300 ").replace("\"15 mm\"", "1800")).unwrap();
    let line = 1 + changed.lines().position(|line| line.starts_with("UNIT")).unwrap();
    served.refused(
        &["import", path],
        &format!("{path}: line {line}: 300 is out of range: UNIT takes 1 to 247"),
    );
    fs::write(&file, changed.replace(&of_map(MAP_VERSION), &of_map(MAP_VERSION + 1))).unwrap();
    let other = MAP_VERSION + 1;
    served.refused(
        &["import", path],
        &format!("{path}: line 3: the file is for register map version {other}, "),
    );
    fs::write(&file, changed.replace("\"15 mm\"", "1800")).unwrap();
    served.act(begin_to_home);
    served.refused(&["import", path], "nothing was changed: the fingers are moving");
    served.refused(&["import", "no/such/file"], "cannot read no/such/file: ");
}

#[test]
fn unanswered_write_is_read_back_and_disturbed_one_is_reverted() {
    let served = Served::new();
    served.faults.loses_answer.store(true, Ordering::SeqCst);
    let printed = served.done(&["set", "RECIPE0_WIDTH", "15mm"]);
    assert!(printed.contains("20.00 mm becomes 15.00 mm"), "{printed}");
    assert_eq!(served.settings()[place("RECIPE0_WIDTH")], 15_00);

    served.faults.meddles.store(true, Ordering::SeqCst);
    let refused = "the settings read back differ from those written, and the previous ones were restored";
    served.refused(&["set", "RECIPE0_WIDTH", "16mm", "RECIPE0_SPEED", "40mm/s"], refused);
}

#[test]
fn missing_port_and_foreign_device_are_reported_in_one_line() {
    let one_line = |arguments: &[&str]| {
        let output = wsg(arguments, b"");
        assert_eq!(output.status.code(), Some(1), "{}", printed(&output));
        let printed = printed(&output);
        assert_eq!(printed.matches('\n').count(), 1, "{printed}");
        printed
    };
    let printed = one_line(&["bridge", "/dev/no-such-port", "show"]);
    assert!(printed.starts_with("wsg: port /dev/no-such-port not found; available ports: "), "{printed}");
    let file = temporary("no_port");
    fs::write(&file, "").unwrap();
    let printed = one_line(&["bridge", file.to_str().unwrap(), "show"]);
    assert!(printed.contains(" as a serial port: "), "{printed}");

    let served = Served::new();
    served.faults.is_silent.store(true, Ordering::SeqCst);
    let printed = one_line(&["bridge", &served.terminal.path, "show"]);
    assert!(
        printed.starts_with("wsg: no response at ") && printed.contains("the board is powered"),
        "{printed}"
    );

    // A bridge with another register map.
    let (mut near, far) = UnixStream::pair().unwrap();
    let terminal = Terminal::to(far).unwrap();
    let other = thread::spawn(move || {
        let mut request = [0; 8];
        near.read_exact(&mut request).unwrap();
        let answer = [1, 4, 2, 0, MAP_VERSION as u8 + 1];
        near.write_all(&[&answer[..], &bus_modbus::rtu::crc(&answer).to_le_bytes()].concat()).unwrap();
        near
    });
    let printed = one_line(&["bridge", &terminal.path, "show"]);
    let versions = format!(
        "has register map version {}, but this wsg supports version {MAP_VERSION}; ",
        MAP_VERSION + 1
    );
    assert!(printed.contains(&versions), "{printed}");
    drop(other.join());
}

#[test]
fn watch_on_a_terminal_ends_with_q_and_with_ctrl_c() {
    let served = Served::new();
    for key in ["q", "\x03"] {
        let (mut screen, far) = UnixStream::pair().unwrap();
        screen.set_read_timeout(Some(BOUND)).unwrap();
        let terminal = Terminal::to(far).unwrap();
        let open = || fs::File::options().read(true).write(true).open(&terminal.path).unwrap();
        let mut watch = std::process::Command::new(env!("CARGO_BIN_EXE_wsg"))
            .args(["bridge", &served.terminal.path, "watch", "--every", "60000"])
            .stdin(open())
            .stdout(open())
            .spawn()
            .unwrap();
        let mut shown = Vec::new();
        while !String::from_utf8_lossy(&shown).contains("q: quit") {
            let mut byte = [0];
            screen.read_exact(&mut byte).expect("the screen is shown");
            shown.extend(byte);
        }
        assert!(String::from_utf8_lossy(&shown).contains("gripper    connected: WSG 50"));
        screen.write_all(key.as_bytes()).unwrap();
        assert!(watch.wait().unwrap().success(), "{key:?}");
    }
}

#[test]
fn image_is_written_by_matching_method_unless_fingers_move() {
    let served = Served::new();
    let folder = temporary("flash");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(folder.join("drive")).unwrap();
    let (elf, bin, note) =
        (folder.join("wsg-bridge.elf"), folder.join("wsg-bridge.bin"), folder.join("note"));
    fs::write(&elf, b"\x7FELF...").unwrap();
    fs::write(&bin, [0, 0x80, 1, 0x20, 0x89, 1, 0, 8]).unwrap();
    for program in ["probe-rs", "st-flash"] {
        let script =
            format!("#!/bin/sh\n[ \"$1\" = --version ] || echo {program} \"$@\" >> '{}'\n", note.display());
        // By another process: a program that a test beside this one starts would inherit the open file, which is then busy.
        let write = r#"printf %s "$1" > "$2" && chmod 755 "$2""#;
        let written = std::process::Command::new("sh")
            .args(["-c", write, "sh", &script])
            .arg(folder.join(program))
            .status();
        assert!(written.unwrap().success());
    }
    let path = format!("{}:/usr/bin:/bin", folder.display());
    let flash = |arguments: &[&str]| {
        let all = [&["bridge", &served.terminal.path, "flash"], arguments].concat();
        let output = wsg_with(&all, b"", &[("PATH", &path)]);
        (output.status.code(), printed(&output))
    };
    let noted = || fs::read_to_string(&note).unwrap_or_default();
    let (elf, bin) = (elf.to_str().unwrap(), bin.to_str().unwrap());

    let (code, printed) = flash(&[elf]);
    assert_eq!(
        (code, printed.as_str(), noted().as_str()),
        (Some(1), "wsg: confirmation requires a terminal; pass --yes to skip it\n", "")
    );
    let (code, printed) = flash(&[elf, "--yes"]);
    assert_eq!(code, Some(0), "{printed}");
    let expected = format!("probe-rs download --chip STM32L475VG {elf}\nprobe-rs reset --chip STM32L475VG\n");
    assert_eq!(noted(), expected);
    fs::remove_file(&note).unwrap();
    flash(&[bin, "--yes", "--with", "st-flash"]);
    assert_eq!(noted(), format!("st-flash --reset write {bin} 0x08000000\n"));
    fs::remove_file(&note).unwrap();
    let drive = folder.join("drive");
    let (code, printed) = flash(&[bin, "--yes", "--drive", drive.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{printed}");
    assert_eq!(fs::read(drive.join("wsg-bridge.bin")).unwrap(), fs::read(bin).unwrap());

    let (code, printed) = flash(&[bin, "--yes", "--with", "probe-rs"]);
    assert_eq!(code, Some(1), "{printed}");
    fs::write(bin, b"GRIP(20)").unwrap();
    let (_, printed) = flash(&[bin, "--yes", "--drive", drive.to_str().unwrap()]);
    assert!(
        printed.contains("is not valid firmware: no vector table for this board at the start"),
        "{printed}"
    );
    served.act(begin_to_home);
    let (code, printed) = flash(&[elf, "--yes"]);
    assert_eq!(
        (code, printed.as_str()),
        (Some(1), "wsg: the fingers are moving; flash again when they are at rest\n")
    );
    assert_eq!(noted(), "");
}

#[test]
fn update_is_checked_sent_with_repeats_continued_and_started() {
    let served = Served::new();
    let folder = temporary("update");
    fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let file = folder.join(name);
        fs::write(&file, bytes).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let running = [0, 1, 0];
    // Its file records are in two files.
    let image = signed(20_500, BOARD.name, running);
    let mut flipped = image.clone();
    flipped[1_000] ^= 1;
    let (file, foreign) = (write("image", &image), write("foreign", &signed(1_000, "pico", running)));
    let (damaged, other) =
        (write("damaged", &flipped), write("other", &signed(2_000, BOARD.name, [9, 9, 9])));
    let [first, second] = keys().map(|key| wsg_update::sign::public_pem(&key));
    let (first, second) = (write("first", first.as_bytes()), write("second", second.as_bytes()));

    served.refused(&["update", &file, "--yes"], "the bridge has no boot loader for updates; ");
    served.act(|plant| plant.flash.slot = Some(SlotModel::new()));
    served.wait(|plant| plant.input(221, 1) != Ok(vec![0]));
    served.refused(&["update", &file], "confirmation requires a terminal; pass --yes to skip it");
    served.refused(&["update", &foreign, "--yes"], &format!("{foreign} is for another board; "));
    served.refused(&["update", &first, "--yes"], &format!("{first} is no valid image: no manifest"));
    served.refused(
        &["update", &file, "--key", &file],
        &format!("{file}: expected a public key of Ed25519 as PEM"),
    );
    for (image, key) in [(&damaged, &second), (&file, &first)] {
        let expected = format!("{image} is no valid image: the signature is wrong");
        served.refused(&["update", image, "--yes", "--key", key], &expected);
    }
    assert_eq!(served.act(|plant| slot(plant).unwrap().flash.operations()), 0, "nothing was sent");
    let expected = "the bridge refused the image: the signature is wrong; it keeps firmware 0.1.0";
    served.refused(&["update", &damaged, "--yes"], expected);

    let block = image[..200].to_vec();
    served.act(move |plant| {
        let request = [&[21, 207, 6, 0, 1, 0, 0, 0, 100], &block[..]].concat();
        plant.by_service(|plant| assert_eq!(plant.ask(&request), request));
    });
    served.faults.loses_answer.store(true, Ordering::SeqCst);
    let expected = "continues after 200 bytes of an interrupted update\nsent and checked; the bridge restarts\n\
                    the bridge runs firmware 0.1.0; STOP/ACK ends the FAST STOP\n";
    assert_eq!(served.done(&["update", &file, "--yes", "--key", &second]), expected);
    assert!(!served.faults.loses_answer.load(Ordering::SeqCst), "a response was lost");
    assert_eq!(served.act(|plant| slot(plant).unwrap().marks), 1);
    // The model restarts the same firmware.
    served.refused(
        &["update", &other, "--yes"],
        "the bridge runs firmware 0.1.0: firmware 9.9.9 did not start",
    );
    served.wait(|plant| plant.bridge().is_connected());
    served.act(|plant| {
        plant.write(0, &[0, 0, 0, 0]);
        plant.write(0, &[0x1000, 0, 0, 0]);
    });
    served.wait(|plant| !plant.bridge().input_image().system.contains(SystemFlags::FAST_STOP));
    served.act(begin_to_home);
    served.refused(&["update", &file, "--yes"], "the fingers are moving; update again when they are at rest");
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn flashed_image_keeps_service_port_settings_over_a_power_cycle() {
    let elf = PathBuf::from(
        std::env::var_os("WSG_FIRMWARE_ELF").expect("WSG_FIRMWARE_ELF is not set; run `cargo xtask test`"),
    );
    let flash = FlashController::new(&B_L475E_IOT01A.flash);
    let trace = Trace::new(vec![]);
    let power_up = || {
        flash.power_cycle();
        let extras = Extras { models: flash.models(), ..Extras::default() };
        let mut board = Emulator::start_with(&elf, extras).unwrap();
        let gripper = GripperEnd::start(
            board.take_gripper_line().unwrap(),
            board.clock(),
            wsg_sim::Config::default(),
            &trace,
        )
        .unwrap();
        let cable = Terminal::to(board.take_service_line().unwrap()).unwrap();
        (board, gripper, cable)
    };
    let bridge = |cable: &Terminal, arguments: &[&str]| {
        let output = wsg(&[&["bridge", &cable.path], arguments].concat(), b"");
        assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
        printed(&output)
    };
    let plant = power_up();
    let cable = &plant.2;
    let shown =
        (0..50).map(|_| bridge(cable, &["show"])).find(|it| it.contains("gripper    connected: WSG 50"));
    assert!(shown.is_some(), "the gripper does not answer");
    assert!(bridge(cable, &["recipes"]).contains("\n     0    20.00 mm   50.00 mm/s"));
    assert!(bridge(cable, &["events"]).contains("START: the bridge started"));
    let file = temporary("emulated.toml");
    let path = file.to_str().unwrap();
    bridge(cable, &["export", path]);
    let changed =
        fs::read_to_string(&file).unwrap().replace("RECIPE15_WIDTH = 2000", "RECIPE15_WIDTH = 1234");
    fs::write(&file, changed).unwrap();
    let printed = bridge(cable, &["import", path, "--save"]);
    assert!(
        printed.contains("RECIPE15_WIDTH: 20.00 mm becomes 12.34 mm") && printed.ends_with("stored\n"),
        "{printed}"
    );
    bridge(cable, &["set", "PLC_BUS", "none", "UNIT", "9", "BUS_CHAR_TIMEOUT", "0"]);
    drop(plant);

    let plant = power_up();
    let shown = bridge(&plant.2, &["show", "RECIPE15_WIDTH", "PLC_BUS"]);
    assert!(shown.contains("RECIPE15_WIDTH      1234  12.34 mm") && shown.contains("Modbus RTU"), "{shown}");
    bridge(&plant.2, &["defaults", "--yes"]);
    assert!(bridge(&plant.2, &["show", "RECIPE15_WIDTH"]).contains("20.00 mm"));
    assert_eq!(motions(&trace.since(0)), []);
    assert!(flash.violations().is_empty(), "{:?}", flash.violations());
}
