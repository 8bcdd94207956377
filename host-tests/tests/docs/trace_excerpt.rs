//! The recorded frames in docs/quick-start.md and docs/protocol.md: their bytes have the meanings shown beside them.

use document::read;
use host_tests::trace::Entry;

/// The documents with recorded frames, and the column at which an entry begins: after the time, if it is shown.
const DOCUMENTS: [(&str, usize); 2] = [("docs/quick-start.md", 11), ("docs/protocol.md", 0)];

/// Returns the bytes at the end of a line: two-digit hexadecimal words, back to the first other word.
fn bytes_at_end(line: &str) -> Vec<u8> {
    let is_byte = |word: &&str| word.len() == 2 && word.bytes().all(|c| c.is_ascii_hexdigit());
    let words: Vec<&str> = line.split_whitespace().rev().take_while(is_byte).collect();
    words.iter().rev().map(|word| u8::from_str_radix(word, 16).unwrap()).collect()
}

#[test]
fn frames_of_the_excerpt_read_as_the_code_reads_them() {
    for (document, entry_at) in DOCUMENTS {
        let mut frames = 0;
        for line in read(document).lines() {
            let Some(entry) = line.get(entry_at..) else { continue };
            let wanted = match entry.get(..2) {
                Some("->") => Entry::ToGripper(bytes_at_end(line)),
                Some("<-") => Entry::FromGripper(bytes_at_end(line)),
                _ => continue,
            };
            frames += 1;
            assert_eq!(entry, wanted.to_string());
        }
        assert!(frames >= 4, "{document} shows {frames} frames");
    }
}

#[test]
fn step_of_the_excerpt_is_one_of_the_demonstration() {
    let document = read("docs/quick-start.md");
    let scenario = read("host-tests/src/bin/demo/scenario.rs");
    let steps = document.lines().filter_map(|line| line.strip_prefix("=== ")?.split_once(". "));
    let steps: Vec<&str> = steps.map(|(_, name)| name).collect();
    assert!(!steps.is_empty());
    let all = scenario.split("const STEPS: [Step; ").nth(1).and_then(|rest| rest.split(']').next()).unwrap();
    assert!(document.contains(&format!("`demo: {all} steps passed, 0 failed`")), "there are {all} steps");
    for step in steps {
        assert!(scenario.contains(&format!("\"{step}\"")), "the demonstration has no step \"{step}\"");
    }
}
