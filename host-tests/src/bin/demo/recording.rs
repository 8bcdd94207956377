//! An animated picture of a trace of the demonstration: a terminal that begins with a full screen, on which one line after the other
//! appears, with its real time at the beginning.

use std::fmt::Write as _;
use std::fs;

use anyhow::{Context, Result};

use crate::{options::Options, scenario};

/// Columns of the terminal. Longer lines end there: the bytes of frames are left out.
const COLUMNS: usize = 73;
const ROWS: usize = 22;

/// Size of a character cell and the margin, in pixels.
const WIDTH: f64 = 7.9;
const HEIGHT: usize = 18;
const MARGIN: usize = 12;

/// The shortest pause between two lines, in seconds. The trace has a dozen lines within 10 ms.
const SHORTEST_PAUSE: f64 = 0.12;
/// The longest pause between two lines, the pause with the first screen, and the pause before the recording repeats, in seconds.
const LONGEST_PAUSE: f64 = 0.7;
const PAUSE_AT_START: f64 = 2.0;
const PAUSE_AT_END: f64 = 5.0;

/// Plays the scenario, and writes the picture of its trace if that is requested. Returns whether all steps succeeded.
pub(crate) fn play(mut options: Options) -> Result<bool> {
    let Some(file) = options.record.take() else { return scenario::play(&options) };
    options.speed_up.get_or_insert(4.0);
    let trace = std::env::temp_dir().join(format!("wsg-demo-{}.trace", std::process::id()));
    options.trace = Some(trace.clone());
    let has_passed = scenario::play(&options)?;
    let text = fs::read_to_string(&trace).with_context(|| format!("cannot read {}", trace.display()))?;
    fs::remove_file(&trace).with_context(|| format!("cannot remove {}", trace.display()))?;
    if has_passed {
        fs::write(&file, picture(&text)).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(has_passed)
}

/// Returns the picture of a trace.
fn picture(trace: &str) -> String {
    let (mut last, mut at) = (0.0, PAUSE_AT_START);
    let mut lines = Vec::new();
    for line in trace.lines() {
        let time = line.get(..9).and_then(|time| time.trim().parse::<f64>().ok());
        if lines.len() >= ROWS {
            at += time.map_or(0.0, |time| time - last).clamp(SHORTEST_PAUSE, LONGEST_PAUSE);
        }
        last = time.unwrap_or(last);
        lines.push((at, line));
    }
    let duration = at + PAUSE_AT_END;
    let scrolled = |lines: usize| lines.saturating_sub(ROWS) * HEIGHT;
    let (mut keyframes, mut texts) = (String::new(), String::new());
    for (row, (at, line)) in lines.iter().enumerate() {
        if row >= ROWS {
            let y = scrolled(row + 1);
            let _ = write!(keyframes, "{:.3}%{{transform:translateY(-{y}px)}}", 100.0 * at / duration);
        }
        let text: String = line.chars().take(COLUMNS).collect();
        let text = text.trim_end().replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let _ = writeln!(texts, "<text class=\"{}\" y=\"{}\">{text}</text>", class(line), row * HEIGHT + 13);
    }
    let (width, height) = (COLUMNS as f64 * WIDTH, ROWS * HEIGHT);
    let end = scrolled(lines.len());
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\">\n\
         <title>A recording of cargo xtask demo</title>\n<style>\n\
         text{{font:13px monospace;fill:#ccd;white-space:pre}}\n\
         .step{{fill:#fff;font-weight:bold}}.passed{{fill:#7d7}}.to{{fill:#8cf}}.from{{fill:#db8}}\n\
         .lines{{transform:translateY(-{end}px);animation:scroll {duration:.2}s step-end infinite}}\n\
         @media(prefers-reduced-motion){{.lines{{animation:none}}}}\n\
         @keyframes scroll{{0%{{transform:none}}{keyframes}}}\n</style>\n\
         <rect width=\"100%\" height=\"100%\" rx=\"6\" fill=\"#14161f\"/>\n\
         <svg x=\"{MARGIN}\" y=\"{MARGIN}\" width=\"{width}\" height=\"{height}\"><g class=\"lines\">\n{texts}</g></svg>\n</svg>\n",
        width + 2.0 * MARGIN as f64,
        height + 2 * MARGIN,
    )
}

fn class(line: &str) -> &'static str {
    match line.get(11..13) {
        _ if line.starts_with("===") => "step",
        _ if line.contains("passed") => "passed",
        Some("->") => "to",
        Some("<-") => "from",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_appear_after_their_pauses_within_the_limits() {
        let first_screen = "=== 1. <start>\n".repeat(ROWS);
        let svg = picture(&format!(
            "{first_screen}    0.300  PLC     GRIP ↑\n   60.300  fingers 1.00 mm\n    passed\n"
        ));
        assert!(svg.contains("{0%{transform:none}"), "{svg}");
        let duration = 2.0 + 0.3 + 0.7 + 0.12 + 5.0;
        for (at, y) in [(2.3, 18), (3.0, 36), (3.12, 54)] {
            let keyframe = format!("{:.3}%{{transform:translateY(-{y}px)}}", 100.0 * at / duration);
            assert!(svg.contains(&keyframe), "{keyframe} is not in {svg}");
        }
        assert!(svg.contains(">=== 1. &lt;start&gt;</text>"), "{svg}");
    }

    #[test]
    fn bytes_of_frames_are_left_out() {
        let line = format!("    0.734  -> {:<58} AA AA AA", "32h Set Force Limit 40.0 N");
        let svg = picture(&line);
        assert!(svg.contains("32h Set Force Limit 40.0 N</text>"), "{svg}");
        assert!(svg.contains("class=\"to\""), "{svg}");
    }
}
