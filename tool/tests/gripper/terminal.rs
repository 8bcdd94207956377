//! `wsg gripper` on a terminal: prompt, full screen and Ctrl-C.

use std::fs::File;
use std::io::{Read, Write};
use std::process::{Child, Command, ExitStatus};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Instant;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use wsg_protocol::SystemFlags;

use crate::rig::{PATIENCE, TestRig, real};

/// A program on a pseudo terminal of its own. It is killed when dropped.
struct Terminal {
    child: Child,
    keys: Option<File>,
    shown: Option<Receiver<Vec<u8>>>,
    /// Output that `until` has not consumed yet.
    text: String,
}

impl Terminal {
    fn start(arguments: &[&str]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let size = Winsize { ws_row: 24, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&master, size).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        let side = || File::options().read(true).write(true).open(path.to_str().unwrap()).unwrap();
        // Ctrl-C sends a signal only to processes whose controlling terminal this is.
        let mut command = Command::new("setsid");
        command.args(["--ctty", "--wait", env!("CARGO_BIN_EXE_wsg"), "gripper"]).args(arguments);
        let child =
            command.stdin(side()).stdout(side()).stderr(side()).spawn().expect("util-linux has setsid");
        drop(command);
        let mut screen = File::from(master);
        let keys = screen.try_clone().unwrap();
        let (sender, shown) = mpsc::channel();
        thread::spawn(move || {
            let mut chunk = [0; 1024];
            loop {
                // Poll, and stop once the receiver is gone. A blocking read would keep the terminal open.
                let mut fds = [PollFd::new(&screen, PollFlags::IN)];
                let polled = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 50_000_000 }));
                match polled {
                    Ok(0) | Err(_) if sender.send(Vec::new()).is_ok() => continue,
                    Ok(1..) => {}
                    _ => return,
                }
                // Reading fails once no process has the terminal open.
                match uninterrupted_read(&mut screen, &mut chunk) {
                    Ok(count @ 1..) if sender.send(chunk[..count].to_vec()).is_ok() => {}
                    _ => return,
                }
            }
        });
        Self { child, keys: Some(keys), shown: Some(shown), text: String::new() }
    }

    /// Starts a prompt and homes the gripper.
    fn homed(rig: &TestRig) -> Self {
        let mut terminal = Self::start(&[&rig.tcp()]);
        terminal.until("> ");
        terminal.command("home", "done");
        terminal
    }

    /// Closes the terminal and waits for the program to exit.
    fn hang_up(mut self) {
        (self.keys, self.shown) = (None, None);
        let status = self.child.wait().expect("the program exits");
        assert!(!status.success(), "{status}");
    }

    /// Runs a command, and waits for the next prompt. Before it, the terminal would turn Enter into another key.
    fn command(&mut self, keys: &str, shown: &str) {
        self.press(&format!("{keys}{ENTER}"));
        self.until(shown);
        self.until("> ");
    }

    fn press(&mut self, keys: &str) {
        let file = self.keys.as_mut().expect("the terminal is open");
        file.write_all(keys.as_bytes()).expect("the program reads the terminal");
    }

    /// Waits until a text is shown, and returns the output up to its end.
    fn until(&mut self, text: &str) -> String {
        let begin = Instant::now();
        loop {
            if let Some(at) = self.text.find(text) {
                let rest = self.text.split_off(at + text.len());
                return std::mem::replace(&mut self.text, rest);
            }
            assert!(begin.elapsed() < PATIENCE, "{text:?} is not shown: {}", self.text);
            match self.shown.as_ref().expect("the terminal is open").recv_timeout(PATIENCE) {
                Ok(bytes) => self.text += &String::from_utf8_lossy(&bytes),
                Err(_) => panic!("{text:?} is not shown: {}", self.text),
            }
        }
    }

    /// Waits for the program to exit and returns its status.
    fn end(mut self) -> ExitStatus {
        // Read until the program has closed its side.
        let begin = Instant::now();
        while let Ok(bytes) = self.shown.as_ref().expect("the terminal is open").recv_timeout(PATIENCE) {
            self.text += &String::from_utf8_lossy(&bytes);
            assert!(begin.elapsed() < PATIENCE, "the program is still writing: {}", self.text);
        }
        self.child.wait().expect("the program has closed its terminal")
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // An error means that the program has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn uninterrupted_read(file: &mut File, buffer: &mut [u8]) -> std::io::Result<usize> {
    loop {
        #[expect(clippy::disallowed_methods, reason = "retried after an interruption")]
        match file.read(buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

const TAB: &str = "\t";
const ENTER: &str = "\r";
const UP: &str = "\x1b[A";
const CONTROL_C: &str = "\x03";
const CONTROL_D: &str = "\x04";

#[test]
fn prompt_completes_shows_the_state_and_remembers() {
    let mut rig = TestRig::new(real());
    let mut terminal = Terminal::start(&[&rig.tcp()]);
    terminal.until("[IDLE  ");
    terminal.until("> ");
    terminal.press(&format!("hom{TAB}pos{TAB}{ENTER}"));
    terminal.until("> home positive \r\n");
    terminal.until("done");
    terminal.until("> ");
    terminal.press(&format!("gri{TAB}20 400 --f{TAB}40{ENTER}"));
    terminal.until("> grip 20 400 --force 40\r\n");
    terminal.until("[GRIPPING  ");
    terminal.until("a part is held: width 19.");
    terminal.until("[HOLDING  19.");
    terminal.until("> ");
    terminal.press(&format!("fo{TAB}{TAB}"));
    terminal.until("force  force-limit\r\n");
    terminal.press(&format!("\x15{UP}{UP}{ENTER}"));
    terminal.until("> home positive \r\n");
    terminal.until("done");
    terminal.until("> ");
    terminal.press(&format!("grip{ENTER}"));
    terminal.until("required arguments were not provided");
    // Not "> " alone, which is part of the usage as well. Only the prompt reads Ctrl-C as a key.
    terminal.until("\r\n> ");
    terminal.press(&format!("move 5{CONTROL_C}{CONTROL_D}"));
    let status = terminal.end();
    assert_eq!(status.code(), Some(0));
    let flags = rig.flags();
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
}

#[test]
fn control_c_in_mid_travel_stops_fingers_and_returns_to_prompt() {
    let mut rig = TestRig::new(real());
    let mut terminal = Terminal::homed(&rig);
    terminal.press(&format!("move 5 5{ENTER}"));
    terminal.until("[POSITIONING  1");
    rig.until_moving();
    terminal.press(CONTROL_C);
    terminal.until("stopped\r\n");
    rig.assert_stopped();
    // Only the prompt reads Enter and Ctrl-D. Before, the terminal is not in raw mode.
    terminal.until("> ");
    terminal.press(&format!("state{ENTER}"));
    terminal.until("state IDLE");
    terminal.until("> ");
    terminal.press(CONTROL_D);
    assert_eq!(terminal.end().code(), Some(0));
    rig.assert_stopped();
}

#[test]
fn control_c_in_mid_travel_of_one_command_stops_it_and_ends() {
    let mut rig = TestRig::new(real());
    let mut terminal = Terminal::start(&[&rig.tcp(), "home"]);
    terminal.until("done");
    assert_eq!(terminal.end().code(), Some(0));
    let mut terminal = Terminal::start(&[&rig.tcp(), "move", "5", "5"]);
    rig.until_moving();
    terminal.press(CONTROL_C);
    assert_eq!(terminal.end().code(), Some(130));
    rig.assert_stopped();
}

#[test]
fn closing_the_terminal_in_mid_travel_stops_the_fingers() {
    let mut rig = TestRig::new(real());
    let mut terminal = Terminal::homed(&rig);
    terminal.press(&format!("move 5 5{ENTER}"));
    rig.until_moving();
    // The program receives SIGHUP, and every further write fails.
    terminal.hang_up();
    rig.assert_stopped();
}

#[test]
fn full_screen_shows_the_gripper_until_q() {
    let mut rig = TestRig::new(real());
    let mut terminal = Terminal::start(&[&rig.tcp(), "watch"]);
    terminal.until("\x1b[?1049h");
    terminal.until("width,");
    terminal.until("force,");
    terminal.press("q");
    terminal.until("\x1b[?1049l");
    assert_eq!(terminal.end().code(), Some(0));
    let flags = rig.flags();
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
}
