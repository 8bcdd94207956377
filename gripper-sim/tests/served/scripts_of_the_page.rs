//! Scripts by the control interface: the folder, the runs, the errors, and the script that runs at the start.

use crate::common::program::Program;
use crate::control::request;
use crate::rig::await_some;
use serde_json::{Value, json};
use std::path::PathBuf;

struct ScriptsRig {
    program: Program,
    control: String,
    folder: PathBuf,
    config: PathBuf,
}

impl ScriptsRig {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("wsg-scripts-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let config = folder.join("wsg.toml");
        std::fs::write(&config, "").unwrap();
        let [path, scripts] = [&config, &folder].map(|path| path.to_str().unwrap());
        let (program, _, control) = Program::with_control(&["--config", path, "--scripts", scripts]);
        Self { program, control, folder, config }
    }

    fn request(&self, method: &str, path: &str, body: &str) -> (u16, Value) {
        request(&self.control, method, path, body)
    }

    fn act(&self, body: &Value) -> Value {
        let (status, answer) = self.request("POST", "/scripts", &body.to_string());
        assert_eq!(status, 200, "{body}: {answer}");
        answer
    }

    fn save(&self, name: &str, source: &str) {
        self.act(&json!({"action": "save", "name": name, "source": source}));
    }

    fn run(&self, name: &str) {
        self.act(&json!({"action": "run", "name": name}));
    }

    /// Waits until the latest script has this state.
    fn until(&self, name: &str, state: &str) -> Value {
        await_some(state, || {
            let answer = self.request("GET", "/scripts", "").1;
            let latest = &answer["latest"];
            (latest["name"] == name && latest["state"] == state).then_some(answer)
        })
    }
}

impl Drop for ScriptsRig {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

#[test]
fn script_is_saved_listed_read_run_and_deleted() {
    let rig = ScriptsRig::new("cycle");
    rig.save("hello.lua", "print('hello')\nprintf('%d', 7)\n");
    assert_eq!(
        std::fs::read_to_string(rig.folder.join("hello.lua")).unwrap(),
        "print('hello')\nprintf('%d', 7)\n"
    );
    let answer = rig.act(&json!({"action": "read", "name": "hello.lua"}));
    assert_eq!(answer["source"], "print('hello')\nprintf('%d', 7)\n");
    assert_eq!(answer["list"], json!([{"name": "hello.lua", "bytes": 31}]));
    rig.run("hello.lua");
    let answer = rig.until("hello.lua", "ended");
    let output: Vec<&str> =
        answer["output"].as_array().unwrap().iter().map(|line| line["text"].as_str().unwrap()).collect();
    assert_eq!(output, ["hello", "7"]);
    let answer = rig.act(&json!({"action": "delete", "name": "hello.lua"}));
    assert_eq!((&answer["list"], rig.folder.join("hello.lua").exists()), (&json!([]), false));
    let (_, log) = rig.request("GET", "/log", "");
    assert!(log.to_string().contains("hello.lua started"), "{log}");
}

#[test]
fn source_that_the_page_cannot_show_is_refused_and_not_replaced() {
    let rig = ScriptsRig::new("encodings");
    for (bytes, expected) in [
        (&b"\xEF\xBB\xBFprint(1)"[..], Ok("print(1)")),
        (b"print(1)\n-- gr\xFCn", Err("line 2 is not UTF-8")),
        (b"\xFF\xFEp\0", Err("the text is UTF-16")),
    ] {
        std::fs::write(rig.folder.join("x.lua"), bytes).unwrap();
        let (_, answer) = rig.request("POST", "/scripts", r#"{"action": "read", "name": "x.lua"}"#);
        match expected {
            Ok(source) => assert_eq!(answer["source"], source),
            Err(error) => assert!(answer["error"].as_str().unwrap().contains(error), "{answer}"),
        }
    }
}

#[test]
fn error_of_a_script_names_its_line() {
    let rig = ScriptsRig::new("error");
    rig.save("wrong.lua", "local x = 1\nx()\n");
    rig.run("wrong.lua");
    let answer = rig.until("wrong.lua", "failed");
    assert_eq!(answer["latest"]["line"], json!(2));
    assert!(answer["latest"]["error"].as_str().unwrap().starts_with("wrong.lua:2: "), "{answer}");
    // A script that follows clears the error.
    rig.save("right.lua", "");
    rig.run("right.lua");
    assert_eq!(rig.until("right.lua", "ended")["latest"]["error"], Value::Null);
}

#[test]
fn endless_script_is_stopped_and_replaced() {
    let rig = ScriptsRig::new("endless");
    let flags = || rig.request("GET", "/state", "").1["system_state"].to_string();
    rig.save(
        "endless.lua",
        "cmd.register(0xB0)\nwhile true do pcall(function() while true do end end) end\n",
    );
    rig.save("waiting.lua", "cmd.register(0xB0)\ncmd.read()\n");
    for name in ["endless.lua", "waiting.lua"] {
        rig.run(name);
        assert!(flags().contains("SCRIPT_RUNNING"));
        rig.act(&json!({"action": "stop"}));
        rig.until(name, "stopped");
        assert!(!flags().contains("SCRIPT_RUNNING"));
    }
    // The next one replaces the one that runs, whose end changes nothing any more.
    rig.save(
        "writes.lua",
        "while true do pcall(function() while true do fieldbus.outputs(255) end end) end\n",
    );
    rig.save("reads.lua", "fieldbus.outputs(1)\nfor _ = 1, 20 do sleep(5) assert(fieldbus.outputs() == 1) end\nprint('alone')\n");
    rig.run("writes.lua");
    rig.run("reads.lua");
    let answer = rig.until("reads.lua", "ended");
    assert_eq!(answer["output"][0]["text"], "alone");
}

#[test]
fn start_up_script_is_a_setting_that_survives() {
    let mut rig = ScriptsRig::new("start_up");
    rig.save("first.lua", "print('at the start')\n");
    let answer = rig.act(&json!({"action": "start_up", "name": "first.lua"}));
    assert_eq!(answer["start_up"], "first.lua");
    assert!(std::fs::read_to_string(&rig.config).unwrap().starts_with("script = \""));
    assert_eq!(rig.request("POST", "/restart", "").0, 200);
    rig.program.place_of("model");
    rig.program.place_of("tcp");
    assert_eq!(rig.program.place_of("control"), rig.control);
    rig.until("first.lua", "ended");
    let answer = rig.act(&json!({"action": "start_up"}));
    assert_eq!(answer["start_up"], Value::Null);
    assert_eq!(std::fs::read_to_string(&rig.config).unwrap().trim(), "");
}

#[test]
fn requests_about_scripts_are_bounded_and_lead_out_of_no_folder() {
    let rig = ScriptsRig::new("bounds");
    let outside = rig.folder.with_extension("lua");
    std::fs::write(&outside, "secret").unwrap();
    #[cfg(unix)]
    for link in ["link.lua", "a.lua.new"] {
        std::os::unix::fs::symlink(&outside, rig.folder.join(link)).unwrap();
    }
    let up = format!("../{}", outside.file_name().unwrap().to_str().unwrap());
    for (body, status, expected) in [
        (json!({"action": "read", "name": up}), 400, "the name of the script is invalid"),
        (
            json!({"action": "save", "name": "/etc/x.lua", "source": ""}),
            400,
            "the name of the script is invalid",
        ),
        (json!({"action": "run"}), 400, "the name of the script is invalid"),
        (json!({"action": "run", "name": "missing.lua"}), 404, "there is no script missing.lua"),
        (json!({"action": "save", "name": "a.lua"}), 400, "expected a source"),
        (
            json!({"action": "save", "name": "a.lua", "source": "x".repeat(65_537)}),
            400,
            "at most 65536 bytes",
        ),
        (json!({"action": "save", "name": "a.lua", "source": "x".repeat(400_000)}), 413, "too long"),
        (json!({"action": "burn", "name": "a.lua"}), 400, "unknown variant"),
        #[cfg(unix)]
        (json!({"action": "read", "name": "link.lua"}), 404, "there is no script link.lua"),
        #[cfg(unix)]
        (json!({"action": "run", "name": "link.lua"}), 404, "there is no script link.lua"),
        #[cfg(unix)]
        (json!({"action": "delete", "name": "link.lua"}), 404, "there is no script link.lua"),
        #[cfg(unix)]
        (json!({"action": "start_up", "name": "link.lua"}), 404, "there is no script link.lua"),
    ] {
        let (got, answer) = rig.request("POST", "/scripts", &body.to_string());
        let error = answer["error"].as_str().unwrap_or_default();
        assert!(got == status && error.contains(expected), "{got} {error}");
    }
    assert_eq!(rig.request("GET", "/scripts", "").1["list"], json!([]), "a link is not listed");
    // Saving replaces a link, instead of writing to the file that it leads to.
    for name in ["a.lua", "link.lua"] {
        rig.save(name, "new");
        assert_eq!(std::fs::read_to_string(rig.folder.join(name)).unwrap(), "new");
        assert_eq!(std::fs::read_to_string(&outside).unwrap(), "secret", "{name}");
    }
    std::fs::remove_file(&outside).unwrap();
}
