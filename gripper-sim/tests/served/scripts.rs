//! Lua scripts on the gripper. Every wait is bounded by a socket time-out.

use crate::common::program::Program;
#[cfg(unix)]
use crate::rig::{BOUND, recv_datagram, udp_socket};
use crate::rig::{Client, File, HOMING, Logged, QUICK, await_some, connect, serve, tcp_lines};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command as Process;
use std::time::Instant;
use wsg_protocol::{FrameEncoder, Status, SystemFlags};
use wsg_sim::server::Lines;
use wsg_sim::{Config, Part};

/// Creates a script file, which is deleted on drop.
pub(super) fn script(name: &str, source: &str) -> File {
    File::new(&format!("{name}.lua"), source)
}

fn remote() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/remote.lua")
}

fn lines(script: &Path) -> Lines {
    Lines { script: Some(script.to_owned()), ..tcp_lines() }
}

impl<S: Read + Write> Client<S> {
    fn call(&mut self, id: u8, payload: &[u8]) -> (Status, Vec<u8>) {
        let frame: Vec<u8> = FrameEncoder::new(id, payload).collect();
        self.0.write_all(&frame).unwrap();
        let (answered, payload) = self.recv();
        assert_eq!(answered, id);
        (Status::from_code(u16::from_le_bytes([payload[0], payload[1]])), payload[2..].to_vec())
    }

    fn home(&mut self) {
        assert_eq!(self.run(HOMING), Status::Success);
    }

    /// Repeats a call until the script has claimed the command.
    fn call_when_claimed(&mut self, id: u8, payload: &[u8]) -> (Status, Vec<u8>) {
        self.until(|client| {
            let answer = client.call(id, payload);
            (answer.0 != Status::CmdUnknown).then_some(answer)
        })
    }

    fn until<T>(&mut self, mut look: impl FnMut(&mut Self) -> Option<T>) -> T {
        await_some("an answer of the script", || look(self))
    }
}

/// Decodes width, speed and force from an answer of `remote.lua`.
fn measured(values: &[u8]) -> [f32; 3] {
    assert_eq!(values.len(), 1 + 4 * 4, "a state byte and four numbers");
    [1, 5, 9].map(|at| f32::from_le_bytes(values[at..at + 4].try_into().unwrap()))
}

fn floats(flag: u8, numbers: &[f32]) -> Vec<u8> {
    let mut payload = vec![flag];
    numbers.iter().for_each(|number| payload.extend(number.to_le_bytes()));
    payload
}

#[test]
fn script_controls_position_and_force_over_tcp() {
    let config = Config { part: Part::of_width(20.0), time_scale: QUICK, ..Config::default() };
    let served = serve(config, lines(&remote()));
    let mut client = Client::of(&served);
    client.home();
    let (status, values) = client.call_when_claimed(0xB0, &[]);
    assert_eq!(status, Status::Success);
    assert_eq!((values[0] & 1, measured(&values)[0]), (1, 110.0), "referenced, and open");

    assert_eq!(client.call(0xB1, &floats(1, &[60.0, 100.0])).0, Status::Success);
    client.until(|client| (measured(&client.call(0xB0, &[]).1)[0] == 60.0).then_some(()));

    // Closes on the part until the force is reached; the axis is blocked then.
    let [width, _, force] = client.until(|client| {
        let (_, values) = client.call(0xB1, &floats(1, &[15.0, 50.0, 5.0, 0.0, 30.0, 30.0]));
        let measured = measured(&values);
        (measured[0] < 20.0).then_some(measured)
    });
    assert!((19.6..20.0).contains(&width) && force <= 30.0, "{width} mm, {force} N");
    assert_eq!(client.call(0xB1, &[1, 2]).0, Status::CmdFormatError);
    assert_eq!(client.call(0xB2, &[]).0, Status::CmdUnknown, "the command is not claimed");
    served.stop().unwrap();
}

#[test]
fn script_flags_show_running_and_failed_and_the_log_shows_why() {
    let script =
        script("fails", "cmd.register(0xB0)\ncmd.send(cmd.read(), etob(0))\nlocal t = nil\nt.x = 1\n");
    let logged = Logged::new("script", Config::default(), &lines(&script.0));
    let mut client = Client::of(&logged.served);
    client.until(|client| client.flags().contains(SystemFlags::SCRIPT_RUNNING).then_some(()));
    assert_eq!(client.call_when_claimed(0xB0, &[]).0, Status::Success);
    client.until(|client| {
        let flags = client.flags();
        let is_over = flags.contains(SystemFlags::SCRIPT_FAILURE);
        assert_ne!(is_over, flags.contains(SystemFlags::SCRIPT_RUNNING));
        is_over.then_some(())
    });
    assert_eq!(client.call(0xB0, &[]).0, Status::CmdUnknown, "the commands of the script are unknown again");
    let text = logged.stop();
    assert!(text.contains("failed") && text.contains("fails.lua:4:"), "{text}");
}

#[test]
fn script_that_loops_forever_or_exhausts_memory_harms_no_client() {
    for (name, source, fails) in [
        ("loops", "while true do end", false),
        ("loops-in-pcall", "while true do pcall(function() while true do end end) end", false),
        ("hogs", "local t = {} while true do t[#t + 1] = string.rep('x', 1000) .. #t end", true),
        ("recurses", "local function f() return f() + 1 end f()", true),
        ("hogs-at-once", "local t = string.rep('x', 2 ^ 30)", true),
        ("loops-in-a-coroutine", "coroutine.wrap(function() while true do end end)()", false),
    ] {
        let script = script(name, source);
        let served = serve(Config { time_scale: QUICK, ..Config::default() }, lines(&script.0));
        let mut client = Client::of(&served);
        client.home();
        if fails {
            client.until(|client| client.flags().contains(SystemFlags::SCRIPT_FAILURE).then_some(()));
        } else {
            assert!(client.flags().contains(SystemFlags::SCRIPT_RUNNING));
        }
        served.stop().unwrap();
    }
}

#[test]
fn script_that_claims_a_command_of_the_manual_receives_an_error() {
    let script = script("claims", "cmd.register(0x20)");
    let logged = Logged::new("claims", Config { time_scale: QUICK, ..Config::default() }, &lines(&script.0));
    let mut client = Client::of(&logged.served);
    client.until(|client| client.flags().contains(SystemFlags::SCRIPT_FAILURE).then_some(()));
    client.home();
    let text = logged.stop();
    assert!(text.contains("20h is not an id for scripts; expected A0h to BFh"), "{text}");
}

#[test]
fn missing_calls_and_refused_motions_are_logged_once() {
    let source =
        "for _ = 1, 3 do\n  local there = mc.grip\n  mc.move(50, 100)\nend\nprint('end', 7)\nsleep(1e9)";
    let text = log_of("misses", Config::default(), &script("misses", source).0, "end\t7");
    assert_eq!(text.matches("line 2: mc.grip does not exist").count(), 1, "{text}");
    assert_eq!(text.matches("line 3: mc.move: E_NOT_INITIALIZED").count(), 1, "{text}");
}

#[test]
fn values_cross_as_the_calls_say() {
    let source = r#"
        cmd.register(0xA0)
        cmd.register(0xBF)
        while true do
          local id, payload = cmd.read()
          if payload[1] == 1 then cmd.send(id, etob(E_RANGE_ERROR), ntob(bton({0, 0, 0x20, 0xC1})), {1, {2, {3}}}, 4)
          elseif payload[1] == 2 then cmd.send(id, etob(0), string.byte(cmd.interface(), 1, -1))
          elseif payload[1] == 3 then
            local ok, why = pcall(function() cmd.send(id, etob(0), 256) end)
            cmd.send(id, etob(ok and 0 or E_INVALID_PARAMETER), {string.byte(why, 1, -1)})
          elseif payload[1] == 4 then
            cmd.send(id, etob(0), {string.byte(finger.type(0) .. finger.type(1), 1, -1)}, ntob(finger.data(1)),
              finger.data(0) == nil and 1 or 0, math.nan ~= math.nan and 1 or 0, cmd.online() and 1 or 0)
          else cmd.send(id, etob(E_SUCCESS), payload) end
        end"#;
    let script = script("values", source);
    let config = Config { fingers: [wsg_sim::Finger::None, wsg_sim::Finger::Fmf], ..Config::default() };
    let served = serve(config, lines(&script.0));
    let mut client = Client::of(&served);
    let (status, values) = client.call_when_claimed(0xBF, &[1]);
    assert_eq!(status, Status::RangeError);
    assert_eq!(values, [&(-10.0f32).to_le_bytes()[..], &[1, 2, 3, 4]].concat());
    assert_eq!(client.call(0xA0, &[2]), (Status::Success, b"tcp".to_vec()));
    let (status, why) = client.call(0xA0, &[3]);
    assert_eq!(status, Status::InvalidParameter);
    let why = String::from_utf8(why).unwrap();
    assert!(why.ends_with("values.lua:9: cmd.send: 256 is not a byte; expected 0 to 255"), "{why}");
    let fingers = [&b"genericfmf"[..], &0f32.to_le_bytes(), &[1, 1, 1]].concat();
    assert_eq!(client.call(0xA0, &[4]), (Status::Success, fingers));
    let longest: Vec<u8> = (0..=255).collect();
    assert_eq!(client.call(0xA0, &longest), (Status::Success, longest.clone()));
    let too_long = [&longest[..], &[0]].concat();
    assert_eq!(client.call(0xA0, &too_long).0, Status::CmdFormatError);
    served.stop().unwrap();
}

#[test]
fn program_runs_a_script_or_reports_an_unreadable_one() {
    let script = remote();
    let mut program = Program::start(&["--tcp", "127.0.0.1:0", "--script", script.to_str().unwrap()]);
    program.place_of("model");
    let mut client = Client(connect(program.place_of("tcp")));
    assert_eq!(client.call_when_claimed(0xB0, &[]).0, Status::Success);

    for (path, shown) in
        [("/nowhere.lua", "/nowhere.lua"), ("/no\nwh\u{1b}[2Jere.lua", "/no\\nwh\\u{1b}[2Jere.lua")]
    {
        let output = Process::new(env!("CARGO_BIN_EXE_wsg-sim")).args(["--script", path]).output().unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && error.lines().count() == 1, "{error}");
        assert!(error.contains(&format!("the script {shown} cannot be read")), "{error}");
    }
}

#[test]
fn example_answers_every_request_and_continues() {
    let config = Config { part: Part::of_width(20.0), time_scale: QUICK, ..Config::default() };
    let served = serve(config, lines(&remote()));
    let mut client = Client::of(&served);
    client.home();
    client.call_when_claimed(0xB0, &[]);
    let mut runner = proptest::test_runner::TestRunner::new(proptest::test_runner::Config {
        failure_persistence: None,
        ..proptest::test_runner::Config::default()
    });
    let client = std::cell::RefCell::new(client);
    let float = proptest::num::f32::ANY;
    let request = (
        0xB0u8..=0xB1,
        proptest::collection::vec(proptest::prelude::any::<u8>(), 0..40),
        proptest::option::of(proptest::collection::vec(float, 0..7)),
    );
    runner
        .run(&request, |(id, mut payload, numbers)| {
            if let Some(numbers) = numbers {
                payload = floats(1, &numbers);
            }
            let mut client = client.borrow_mut();
            let frame: Vec<u8> = FrameEncoder::new(id, &payload[..]).collect();
            client.0.write_all(&frame).unwrap();
            let (answered, answer) = client.recv();
            proptest::prop_assert_eq!((answered, answer.len()), (id, 19));
            Ok(())
        })
        .unwrap();
    assert!(client.borrow_mut().flags().contains(SystemFlags::SCRIPT_RUNNING));
    served.stop().unwrap();
}

/// Runs a script until its log has a line that ends with `last`; returns the log.
fn log_of(name: &str, config: Config, script: &Path, last: &str) -> String {
    let logged = Logged::new(name, config, &lines(script));
    logged.until(|text| text.lines().any(|line| line.ends_with(last)).then_some(()));
    logged.stop()
}

/// Returns the log of a script that prints `end` last.
fn printed(name: &str, source: &str) -> String {
    log_of(name, Config { time_scale: QUICK, ..Config::default() }, &script(name, source).0, " script end")
}

#[test]
fn no_call_however_deep_overflows_the_stack_of_a_script() {
    // Each attempt ends with or without a Lua error; a stack overflow would abort this process.
    let attempts = [
        r#"string.find(("a"):rep(50000), ("a?"):rep(50000))"#,
        r#"string.match(("a"):rep(50000), ("a?"):rep(50000))"#,
        r#"for _ in string.gmatch(("a"):rep(50000), ("a?"):rep(50000)) do end"#,
        r#"for _ in string.gfind(("a"):rep(50000), ("a?"):rep(50000)) do end"#,
        r#"string.gsub(("a"):rep(50000), ("a?"):rep(50000), "")"#,
        r#"("a"):rep(50000):find(("a-"):rep(50000) .. "b")"#,
        r#"string.find("a", ("("):rep(100000))"#,
        // The deepest recursion within the limits, at the bottom of as many calls as Lua allows.
        r#"local p = ("a?"):rep(512)
           local function f() return (("a"):gsub("a", function() p:rep(1):gsub(p, f) f() end)) end f()"#,
        r#"local function f() coroutine.wrap(f)() end f()"#,
        r#"local function f() coroutine.resume(coroutine.create(f)) end f()"#,
        r#"local t = setmetatable({}, {}) getmetatable(t).__tostring = function() print(t) return "" end print(t)"#,
        r#"local t = setmetatable({}, {}) getmetatable(t).__index = function(_, k) return t[k] end return t.x"#,
        r#"local function f() pcall(f) error(("x"):rep(100)) end f()"#,
        r#"local function f() return xpcall(f, f) end f()"#,
        r#"local function f() table.sort({1, 2, 3}, f) end f()"#,
        r#"assert(loadstring(("("):rep(100000)))"#,
        r#"assert(loadstring("return " .. ("{"):rep(100000)))"#,
        r#"assert(load(function() return "do " end))"#,
        r#"unpack({}, 1, 1e8) "#,
        r#"unpack({}, 0, 2^31 - 1)"#,
        r#"string.byte(("x"):rep(1e6), 1, -1)"#,
        // A table that contains itself.
        r#"cmd.register(0xA0) local t = {} t[1] = t cmd.send(0xA0, t)"#,
        r#"getmetatable(newproxy(true)).__gc = function() error("x") end"#,
    ];
    let mut source = String::new();
    for (number, attempt) in attempts.iter().enumerate() {
        source += &format!("print({number}, pcall(function() {attempt} end))\n");
    }
    let log = printed("deep", &(source + "print('end')"));
    let outcome = |number: usize| {
        let start = format!(" script {number}\t");
        log.lines()
            .find_map(|line| Some(line.split_once(&start)?.1))
            .unwrap_or_else(|| panic!("{number}: {log}"))
    };
    for number in 0..7 {
        assert!(outcome(number).contains("a pattern may have at most 1024 bytes"), "{}", outcome(number));
    }
    for number in 0..attempts.len() {
        assert!(!outcome(number).is_empty());
    }
}

#[test]
fn patterns_find_what_they_did_and_their_errors_name_the_line() {
    let log = printed(
        "patterns",
        r#"print(("a.b"):find(".", 1, true), ("x=1, y=2"):gsub("(%w+)=(%w+)", "%2=%1"), ("abc"):match("b(.)"))
        for word in ("one two"):gmatch("%a+") do print(word) end
        print(#("x"):rep(2000), (("x"):rep(2000) .. "y"):find(("x"):rep(2000), 1, true))
        print(("abc"):gsub("%w", { a = 1 }), ("abc"):gsub("%w", function(letter) return letter:upper() end, 2))
        print(pcall(function() local at = ("a"):find("[") end))
        print(pcall(function() return ("a"):gsub("a", function() error("own") end) end))
        print('end')"#,
    );
    for line in [
        " 2\t1=x, 2=y\tc",
        " script one",
        " script two",
        " 2000\t1\t2000",
        " 1bc\tABc\t2",
        " false\tpatterns.lua:5: malformed pattern (missing ']')",
        " false\tpatterns.lua:6: own",
    ] {
        let named = line.replace("patterns.lua", &format!("wsg-sim-{}-patterns.lua", std::process::id()));
        assert!(log.lines().any(|logged| logged.ends_with(&named)), "{named} in {log}");
    }
}

#[test]
fn script_is_text_and_has_no_way_to_bytecode() {
    let log = printed(
        "text",
        r#"print(string.dump, newproxy, dofile, loadfile)
        local code = "\27Lua" .. ("\0"):rep(100)
        print(loadstring(code))
        local sent = false
        print(load(function() if not sent then sent = true return code end end))
        print(loadstring("return 1 + 1")(), load(function() return nil end)())
        print('end')"#,
    );
    assert!(log.contains(" nil\tnil\tnil\tnil\n"), "{log}");
    assert_eq!(log.matches(" nil\ta script is text; expected no bytecode\n").count(), 2, "{log}");
    assert!(log.contains(" script 2\n"), "{log}");

    let bytecode = script("bytecode", "\u{1b}LuaQ");
    let log = log_of("bytecode", Config::default(), &bytecode.0, ")");
    assert!(log.contains("failed: ") && log.contains("binary"), "{log}");
}

#[test]
fn script_that_prints_without_end_fills_no_disk() {
    let start = Instant::now();
    let log = printed(
        "prints",
        "for _ = 1, 200000 do print('a line') end print(('long'):rep(100000))
        sleep(100) print('one\\ntwo\\27[2J\\n') printf('%s\\n', 'three') print('end')",
    );
    // A burst of a thousand lines, then a hundred a second, each possibly followed by a note of omitted lines.
    let most = 1_000 + 200 * (start.elapsed().as_secs() as usize + 1);
    let lines = log.lines().filter(|line| line.contains(" script ")).count();
    assert!((1_000..=most).contains(&lines), "{lines} lines");
    assert!(log.contains(" lines are omitted here: a script may write 100 a second\n"), "{log}");
    let longest = log.lines().map(str::len).max();
    assert!(longest.is_some_and(|len| len < 1_200), "{longest:?}");
    assert!(log.contains(" script one\n") && log.contains(" script two\\u{1b}[2J\n"), "{log}");
    assert!(log.contains(" script three\n"), "{log}");
}

#[test]
fn pieces_of_a_line_are_one_line_of_the_log() {
    let source =
        "printf('%d of ', 1) printf('%d', 3) printf('\\nnext: ') print('a') printf('b\\r\\nc') print()
        for _ = 1, 5000 do printf('long') end printf('\\n') print('end') printf('%s', 'rest')";
    let log = log_of("pieces", Config::default(), &script("pieces", source).0, " script ended");
    let lines: Vec<&str> = log.lines().filter_map(|line| Some(line.split_once(" script ")?.1)).collect();
    let long = "long".repeat(256) + "…";
    assert_eq!(lines, ["1 of 3", "next: a", "b", "c", &long, "end", "rest", "ended"]);
}

#[test]
fn scripts_of_any_editor_run() {
    // The line of an error must be that of the file.
    for (name, start) in
        [("mark", "\u{FEFF}"), ("shebang", "#!/usr/bin/env lua\n"), ("both", "\u{FEFF}#!/usr/bin/lua\n")]
    {
        let module = script(&format!("{name}-module"), &format!("{start}return 'module'"));
        let module = module.0.file_stem().unwrap().to_string_lossy().into_owned();
        let line = start.matches('\n').count() + 2;
        let source = format!("{start}print(require '{module}')\r\nerror('own')");
        let log = log_of(name, Config::default(), &script(name, &source).0, "own");
        assert!(
            log.contains(" script module\n") && log.contains(&format!("{name}.lua:{line}: own")),
            "{log}"
        );
    }
    let latin = script("latin", "");
    std::fs::write(&latin.0, b"print(#'\xE4')").unwrap();
    log_of("latin", Config::default(), &latin.0, " script 1");
    let wide = script("wide", "");
    std::fs::write(&wide.0, b"\xFF\xFEp\0").unwrap();
    let output = Process::new(env!("CARGO_BIN_EXE_wsg-sim")).arg("--script").arg(&wide.0).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("cannot be read: the text is UTF-16; save it as UTF-8"), "{error}");
}

#[test]
fn module_beside_the_script_is_loaded_once_and_nothing_else_is() {
    let module = format!("wsg-sim-{}-module", std::process::id());
    let _module = script(
        "module",
        "local NAME = ...\nlocal M = {}\nfunction M.name() return NAME end\nloads = (loads or 0) + 1\nreturn M",
    );
    let _wrong = script("wrong", "local a = = 1");
    let _raising = script("raising", "error('own')");
    let _circular = script("circular", &format!("require '{}'", module.replace("module", "circular")));
    let source = r#"
        local M = require "MODULE"
        print(M.name(), M == require "MODULE", loads, require "socket" == socket)
        for _, name in ipairs { "../MODULE", "/etc/passwd", "..", "a.b", "", "nowhere", "x\0y", ("x"):rep(1e6) } do
          print(pcall(require, name))
        end
        print(pcall(require))
        print(pcall(require, "WRONG"))
        print(pcall(require, "RAISING"))
        print(pcall(require, "RAISING"))
        print(pcall(require, "CIRCULAR"))
        print("end")"#;
    let source = ["wrong", "raising", "circular", "module"].iter().fold(source.to_owned(), |source, name| {
        source.replace(&name.to_uppercase(), &module.replace("module", name))
    });
    let log = printed("requires", &source);
    assert!(log.contains(&format!(" {module}\ttrue\t1\ttrue\n")), "{log}");
    assert_eq!(log.matches("is not a name; expected letters, digits, _ and -").count(), 7, "{log}");
    assert!(log.contains("there is no \"nowhere.lua\" beside the script"), "{log}");
    assert!(log.contains("-wrong.lua:1: unexpected symbol near '='"), "{log}");
    assert_eq!(log.matches("-raising.lua:1: own").count(), 2, "{log}");
    assert!(log.contains("-circular requires itself"), "{log}");
}

#[cfg(unix)]
#[test]
fn module_outside_of_the_folder_is_not_loaded_through_a_link() {
    use crate::rig::scratch;
    use std::os::unix::fs::symlink;
    let outside = scratch("outside");
    std::fs::create_dir_all(&outside).unwrap();
    std::fs::write(outside.join("x.lua"), "leaked = true").unwrap();
    let folder = scratch("folder");
    std::fs::create_dir_all(&folder).unwrap();
    symlink(outside.join("x.lua"), folder.join("x.lua")).unwrap();
    symlink(
        "../".to_owned() + outside.file_name().unwrap().to_str().unwrap() + "/x.lua",
        folder.join("y.lua"),
    )
    .unwrap();
    // A folder, and a link to one.
    std::fs::create_dir_all(folder.join("z.lua")).unwrap();
    symlink(&outside, folder.join("w.lua")).unwrap();
    std::fs::write(folder.join("own.lua"), "return 'own'").unwrap();
    symlink("own.lua", folder.join("alias.lua")).unwrap();
    let main = folder.join("main.lua");
    let source = r#"
        for _, name in ipairs { "x", "y", "z", "w" } do print(name, pcall(require, name)) end
        print("leaked", rawget(_G, "leaked"))
        print("alias", require "alias")
        print("end")"#;
    std::fs::write(&main, source).unwrap();
    let log = log_of("links", Config::default(), &main, " script end");
    for name in ["x", "y", "z", "w"] {
        let expected = format!(" script {name}\tfalse\trequire: there is no \"{name}.lua\" beside");
        assert!(log.contains(&expected), "{log}");
    }
    assert!(log.contains(" script leaked\tnil\n") && log.contains(" script alias\town\n"), "{log}");
    for folder in [folder, outside] {
        std::fs::remove_dir_all(folder).unwrap();
    }
}

/// Public scripts home with a boolean, and begin the next motion in the next line.
#[test]
fn homing_takes_a_boolean_and_waits_for_its_end() {
    for (call, width) in [
        ("mc.homing(false)", 0),
        ("mc.homing(true)", 110),
        ("mc.homing()", 110),
        ("mc.homing(0)", 110),
        ("mc.homing(1)", 110),
        ("mc.homing(2)", 0),
    ] {
        let source = format!(
            "print('homed', {call}, mc.busy(), mc.position())\n\
             print('moved', mc.move(60, 400), mc.busy())\n\
             print('wrong', pcall(mc.homing, 'inward'))\n\
             print('end')"
        );
        let log = printed("homing", &source);
        assert!(log.contains(&format!(" script homed\t0\tfalse\t{width}\n")), "{call}: {log}");
        assert!(log.contains(" script moved\t0\t"), "{call}: {log}");
        assert!(log.contains("expected true or 1 (outward), false or 2 (inward), or 0"), "{log}");
    }
}

#[test]
fn force_returns_the_limit_second_and_settings_read_back() {
    let source = r#"
        mc.homing(true)
        print("free", mc.force())
        print("set", mc.force(30))
        print("grasped", grasping.grasp(20, 100))
        local force, limit = mc.force()
        print("holding", force, limit, mc.aforce())
        print("acceleration", mc.acceleration(), mc.acceleration(2000), mc.acceleration())
        print("none", mc.softlimits())
        print("limits", mc.softlimits(10, 90))
        print("limits", mc.softlimits())
        print(pcall(mc.softlimits, 10))
        print("end")"#;
    let config = Config { part: Part::of_width(20.0), time_scale: QUICK, ..Config::default() };
    let log = log_of("force", config, &script("force", source).0, " script end");
    for line in [
        "free\t0\t40",
        "set\t0\t30",
        "grasped\t0",
        "holding\t30\t30\t30",
        "acceleration\t1000\t2000\t2000",
        "none\tnil\tnil",
        "limits\t10\t90",
    ] {
        assert!(log.contains(&format!(" script {line}\n")), "{line} in {log}");
    }
    assert!(log.contains("mc.softlimits: expected two widths in mm"), "{log}");
}

/// A public script sends measurements with a registered id, whether or not a command was read.
#[test]
fn frame_with_a_registered_id_is_a_push_if_no_command_was_read() {
    let source = r#"
        cmd.register(0xB0) cmd.register(0xB1)
        print("offline", pcall(cmd.send, 0xB0, etob(E_SUCCESS), 6))
        print("unknown", pcall(cmd.send, 0xB2, 1))
        while not cmd.online() do sleep(1) end
        cmd.send(0xB0, etob(E_SUCCESS), 7)
        local id = cmd.read()
        cmd.send(0xB0, etob(E_SUCCESS), 8)
        cmd.send(id, etob(E_SUCCESS), 9)
        cmd.send(id, etob(E_SUCCESS), 10)
        print("end")
        cmd.read()"#;
    let script = script("push", source);
    let logged = Logged::new("push", Config::default(), &lines(&script.0));
    logged.until(|text| text.contains(" script unknown\t").then_some(()));
    let mut client = Client::of(&logged.served);
    assert_eq!(client.recv(), (0xB0, vec![0, 0, 7]));
    let frame: Vec<u8> = FrameEncoder::new(0xB1, &[][..]).collect();
    client.0.write_all(&frame).unwrap();
    for (id, value) in [(0xB0, 8), (0xB1, 9), (0xB1, 10)] {
        assert_eq!(client.recv(), (id, vec![0, 0, value]));
    }
    let text = logged.stop();
    assert!(text.contains(" script offline\ttrue\n"), "{text}");
    assert!(text.contains("cmd.send: the command B2h is not registered"), "{text}");
}

#[test]
fn calls_that_public_scripts_make_are_there() {
    let source = r#"
        cmd.unregister(0xB0)
        cmd.register(0xB0) cmd.register(0xB1)
        print("pid", mc.pid())
        mc.pid(0.1, 2, 3)
        print("pid", mc.pid())
        for i = 0, finger.count() - 1 do
          finger.interface(i, "uart", 115200)
          finger.write(i, "z") finger.write(i, {0x7E, 0xFF})
          print("finger", finger.type(i), finger.bytes_available(i), #finger.read(i), #finger.read(i, 50))
          finger.interface(i, "spi", 140625, 8, 0, 0)
          print("spi", #finger.spi(i, {1, 2, 3}), #finger.spi(i, 7))
          print("power", finger.power(i, false), finger.power(i, true))
        end
        print(pcall(finger.write, 0, {256}))
        print(pcall(finger.interface, 0, "i2c"))
        while cmd.available() == 0 do sleep(1) end
        local id = cmd.read()
        cmd.send(id, true, false, "ab", {1, {"c", {{{2}}}}})
        print("nested", pcall(cmd.send, id, {{{{{{1}}}}}}))
        cmd.unregister(0xB0)
        print("end")
        cmd.read()"#;
    let script = script("public", source);
    let config = Config { fingers: [wsg_sim::Finger::Generic, wsg_sim::Finger::Fmf], ..Config::default() };
    let logged = Logged::new("public", config, &lines(&script.0));
    let mut client = Client::of(&logged.served);
    let answer = client.call_when_claimed(0xB0, &[]);
    assert_eq!(
        (answer.0.code(), answer.1),
        (0x0001, b"ab\x01c\x02".to_vec()),
        "true and false as bytes 1 and 0"
    );
    logged.until(|text| text.contains(" script end\n").then_some(()));
    assert_eq!(client.call(0xB0, &[]).0, Status::CmdUnknown, "the command was released");
    let text = logged.stop();
    for line in [
        "pid\t1\t0\t0",
        "pid\t0.1\t2\t3",
        "finger\tgeneric\t0\t0\t0",
        "finger\tfmf\t0\t0\t0",
        "spi\t3\t1",
        "power\t0\t0",
        // Only the gripper powers a WSG-FMF (3.6.3).
        "power\t18\t18",
    ] {
        assert!(text.contains(&format!(" script {line}\n")), "{line} in {text}");
    }
    assert!(text.contains("finger.write: 256 is not a byte; expected 0 to 255"), "{text}");
    assert!(text.contains("finger.interface: \"i2c\" is unknown; expected \"uart\" or \"spi\""), "{text}");
    assert!(text.contains("nested\tfalse") && text.contains("tables may be nested at most 5 deep"), "{text}");
    assert!(!text.contains(" does not exist"), "{text}");
}

#[test]
fn grasping_waits_for_the_end_of_its_motions() {
    let source = r#"
        while mc.busy() do sleep(1) end
        mc.homing(1)
        while mc.busy() do sleep(1) end
        print("open", grasping.move(60, 400), mc.position(), grasping.state())
        print("grasped", grasping.grasp(20, 100, 30), mc.force(), grasping.state())
        print("released", grasping.release(50, 100), mc.position(), grasping.state())
        print("missed", grasping.grasp(10, 100), grasping.state())
        print("released", grasping.release(40, 100), mc.position())
        print("clamped", grasping.clamp(2, 20), mc.aforce())
        print("near", grasping.move(22, 100))
        print("clamped", grasping.clamp(3, 20), mc.blocked(), mc.aforce())
        print("stopped", grasping.stop_clamping(), mc.aforce())
        print("refused", grasping.move(500, 100))
        print("end")"#;
    let config = Config { part: Part::of_width(20.0), time_scale: 20.0, ..Config::default() };
    let log = log_of("grasping", config, &script("grasping", source).0, " script end");
    for line in [
        "open\t0\t60\t0",
        "grasped\t0\t30\t4",
        "released\t0\t50\t0",
        "missed\t18\t2",
        "released\t0\t40",
        "clamped\t18\t0",
        "near\t0",
        "clamped\t0\ttrue\t20",
        "stopped\t0\t0",
        "refused\t",
    ] {
        assert!(log.contains(&format!(" script {line}")), "{line} in {log}");
    }
}

/// A script that mirrors each user flag of the PLC to the flag on the opposite side, and sets OF8 by its number.
pub(super) const MIRRORS_USER_FLAGS: &str = "
    while true do
      local flags = 0
      for number = 1, 7 do if fieldbus.input(number) then flags = flags + 2 ^ (7 - number) end end
      fieldbus.outputs(flags)
      fieldbus.output(8, fieldbus.inputs() >= 128)
      sleep(1)
    end";

/// A Unix socket used as a serial line.
#[cfg(unix)]
mod unix {
    use super::*;
    use crate::common::parse;
    use crate::rig::{any_port, scratch};
    use std::os::unix::net::UnixStream;
    use wsg_sim::server::{SerialLine, UdpLine};

    #[test]
    fn script_answers_the_requester_over_udp_and_a_serial_line() {
        let [answers, asks] = [0; 2].map(|_| udp_socket());
        let remote_port = answers.local_addr().unwrap().port();
        let path = scratch("script-serial");
        let lines = Lines {
            udp: any_port().map(|address| UdpLine { address, remote_port }),
            serial: Some(SerialLine::Unix(path.clone())),
            ..lines(&remote())
        };
        let served = serve(Config::default(), lines);
        let stream = UnixStream::connect(&path).unwrap();
        stream.set_read_timeout(Some(BOUND)).unwrap();
        let mut serial = Client(stream);
        assert_eq!(serial.call_when_claimed(0xB0, &[]).0, Status::Success);

        let request: Vec<u8> = FrameEncoder::new(0xB0, &[0][..]).collect();
        uninterrupted::send_to(&asks, &request, served.udp_address().unwrap()).unwrap();
        let (id, payload) = parse(&recv_datagram(&answers).0).pop().unwrap();
        assert_eq!((id, payload.len()), (0xB0, 19));
        assert_eq!(serial.call(0xB0, &[]).0, Status::Success, "each client gets its own answer");
        served.stop().unwrap();
    }
}
