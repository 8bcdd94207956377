//! The recorded frames in docs/protocol.md: their bytes have the meanings shown beside them.

use document::read;
use host_tests::trace::Entry;

/// The document with recorded frames.
const DOCUMENT: &str = "docs/protocol.md";

/// Returns the bytes at the end of a line: two-digit hexadecimal words, back to the first other word.
fn bytes_at_end(line: &str) -> Vec<u8> {
    let is_byte = |word: &&str| word.len() == 2 && word.bytes().all(|c| c.is_ascii_hexdigit());
    let words: Vec<&str> = line.split_whitespace().rev().take_while(is_byte).collect();
    words.iter().rev().map(|word| u8::from_str_radix(word, 16).unwrap()).collect()
}

#[test]
fn frames_of_the_excerpt_read_as_the_code_reads_them() {
    let mut frames = 0;
    for line in read(DOCUMENT).lines() {
        let wanted = match line.get(..2) {
            Some("->") => Entry::ToGripper(bytes_at_end(line)),
            Some("<-") => Entry::FromGripper(bytes_at_end(line)),
            _ => continue,
        };
        frames += 1;
        assert_eq!(line, wanted.to_string());
    }
    assert!(frames >= 4, "{DOCUMENT} shows {frames} frames");
}

#[test]
fn quick_start_has_the_number_of_steps_of_the_demonstration() {
    let scenario = read("host-tests/src/bin/demo/scenario.rs");
    let all = scenario.split("const STEPS: [Step; ").nth(1).and_then(|rest| rest.split(']').next()).unwrap();
    let wanted = format!("`demo: {all} steps passed, 0 failed`");
    assert!(read("docs/quick-start.md").contains(&wanted), "there are {all} steps");
}
