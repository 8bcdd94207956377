//! Line editor with history and completion, independent of the terminal: takes keys, returns the text to show.
//!
//! rustyline and reedline own the terminal while they read a line. Receiving from the gripper and showing its state would need
//! a second thread that shares the terminal with them.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Maximum number of lines in the history.
const MAX_HISTORY: usize = 500;

/// A source of completions.
pub(crate) trait Complete {
    /// Returns the words that may follow these.
    fn choices(&self, words: &[&str]) -> Vec<String>;
}

/// The line being edited, and the history.
#[derive(Debug, Default)]
pub(crate) struct Editor {
    text: Vec<char>,
    cursor: usize,
    history: Vec<String>,
    /// Index of the history line shown; the length of the history if none is.
    shown: usize,
}

/// The effect of a key.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// The line may have changed and is not finished.
    Typing,
    /// The completions to list.
    Choices(Vec<String>),
    /// The finished line (Enter).
    Line(String),
    /// The line was discarded (Ctrl-C).
    Discarded,
    /// The user ended the input (Ctrl-D).
    End,
}

impl Editor {
    /// Returns the current text.
    pub(crate) fn text(&self) -> String {
        self.text.iter().collect()
    }

    /// Returns the number of characters before the cursor.
    pub(crate) const fn cursor(&self) -> usize {
        self.cursor
    }

    /// Processes a key event.
    pub(crate) fn key(&mut self, key: KeyEvent, complete: &impl Complete) -> Step {
        if key.kind == KeyEventKind::Release {
            return Step::Typing;
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return self.control(key.code);
        }
        match key.code {
            KeyCode::Enter => return self.enter(),
            KeyCode::Tab => return self.complete(complete),
            KeyCode::Char(character) if !character.is_control() => {
                self.text.insert(self.cursor, character);
                self.cursor += 1;
            }
            KeyCode::Backspace if self.cursor > 0 => {
                self.cursor -= 1;
                self.text.remove(self.cursor);
            }
            KeyCode::Delete if self.cursor < self.text.len() => drop(self.text.remove(self.cursor)),
            KeyCode::Left => self.cursor = self.cursor.saturating_sub(1),
            KeyCode::Right => self.cursor = (self.cursor + 1).min(self.text.len()),
            KeyCode::Home => self.cursor = 0,
            KeyCode::End => self.cursor = self.text.len(),
            KeyCode::Up => self.show(self.shown.saturating_sub(1)),
            KeyCode::Down => self.show((self.shown + 1).min(self.history.len())),
            _ => {}
        }
        Step::Typing
    }

    fn control(&mut self, code: KeyCode) -> Step {
        match code {
            KeyCode::Char('c') => {
                self.replace("");
                return Step::Discarded;
            }
            KeyCode::Char('d') if self.text.is_empty() => return Step::End,
            KeyCode::Char('a') => self.cursor = 0,
            KeyCode::Char('e') => self.cursor = self.text.len(),
            KeyCode::Char('k') => self.text.truncate(self.cursor),
            KeyCode::Char('u') => {
                self.text.drain(..self.cursor);
                self.cursor = 0;
            }
            KeyCode::Char('w') => {
                let begin = self.word_before();
                self.text.drain(begin..self.cursor);
                self.cursor = begin;
            }
            _ => {}
        }
        Step::Typing
    }

    fn enter(&mut self) -> Step {
        let line = self.text();
        if !line.trim().is_empty() && self.history.last() != Some(&line) {
            self.history.push(line.clone());
            if self.history.len() > MAX_HISTORY {
                self.history.remove(0);
            }
        }
        self.replace("");
        self.shown = self.history.len();
        Step::Line(line)
    }

    /// Inserts the common prefix of all completions, or lists them if there is nothing to insert.
    fn complete(&mut self, complete: &impl Complete) -> Step {
        let before: String = self.text.iter().take(self.cursor).collect();
        let mut words: Vec<&str> = before.split_whitespace().collect();
        let begun = if before.ends_with(char::is_whitespace) { None } else { words.pop() }.unwrap_or("");
        let mut choices = complete.choices(&words);
        choices.retain(|choice| choice.starts_with(begun));
        let Some(first) = choices.first() else { return Step::Typing };
        let common = choices.iter().fold(first.as_str(), |common, choice| {
            let same = common.char_indices().zip(choice.chars()).find(|((_, a), b)| a != b);
            let end = same.map_or(common.len().min(choice.len()), |((at, _), _)| at);
            common.get(..end).unwrap_or(common)
        });
        let mut rest = common.get(begun.len()..).unwrap_or("").to_owned();
        if choices.len() == 1 {
            rest.push(' ');
        }
        if rest.is_empty() {
            return Step::Choices(choices);
        }
        for character in rest.chars() {
            self.text.insert(self.cursor, character);
            self.cursor += 1;
        }
        Step::Typing
    }

    fn word_before(&self) -> usize {
        let before = self.text.get(..self.cursor).unwrap_or(&[]);
        let end = before.iter().rposition(|character| !character.is_whitespace());
        let begin = end.and_then(|end| before[..end].iter().rposition(|character| character.is_whitespace()));
        begin.map_or(0, |begin| begin + 1)
    }

    fn show(&mut self, line: usize) {
        let text = self.history.get(line).cloned().unwrap_or_default();
        self.replace(&text);
        self.shown = line;
    }

    fn replace(&mut self, text: &str) {
        self.text = text.chars().collect();
        self.cursor = self.text.len();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Words;

    impl Complete for Words {
        fn choices(&self, words: &[&str]) -> Vec<String> {
            let choices: &[&str] = match words {
                [] => &["force", "force-limit", "grip"],
                ["grip", ..] => &["--force", "--help"],
                _ => &[],
            };
            choices.iter().map(ToString::to_string).collect()
        }
    }

    fn press(editor: &mut Editor, code: KeyCode) -> Step {
        editor.key(KeyEvent::new(code, KeyModifiers::NONE), &Words)
    }

    fn control(editor: &mut Editor, character: char) -> Step {
        editor.key(KeyEvent::new(KeyCode::Char(character), KeyModifiers::CONTROL), &Words)
    }

    fn typed(editor: &mut Editor, text: &str) {
        text.chars().for_each(|character| assert_eq!(press(editor, KeyCode::Char(character)), Step::Typing));
    }

    #[test]
    fn line_is_edited_at_the_cursor() {
        let mut editor = Editor::default();
        typed(&mut editor, "gip 20 5");
        control(&mut editor, 'a');
        press(&mut editor, KeyCode::Right);
        typed(&mut editor, "r");
        press(&mut editor, KeyCode::End);
        typed(&mut editor, "0x");
        press(&mut editor, KeyCode::Backspace);
        assert_eq!(press(&mut editor, KeyCode::Enter), Step::Line("grip 20 50".to_owned()));
        assert_eq!((editor.text(), editor.cursor()), (String::new(), 0));
        typed(&mut editor, "grip 20  50");
        control(&mut editor, 'w');
        assert_eq!(editor.text(), "grip 20  ");
        control(&mut editor, 'w');
        assert_eq!(editor.text(), "grip ");
        control(&mut editor, 'a');
        press(&mut editor, KeyCode::Delete);
        control(&mut editor, 'k');
        assert_eq!(editor.text(), "");
    }

    #[test]
    fn up_and_down_recall_the_history() {
        let mut editor = Editor::default();
        for line in ["home", "width", "width", " "] {
            typed(&mut editor, line);
            press(&mut editor, KeyCode::Enter);
        }
        let mut shown = |code| {
            press(&mut editor, code);
            editor.text()
        };
        assert_eq!([shown(KeyCode::Up), shown(KeyCode::Up), shown(KeyCode::Up)], ["width", "home", "home"]);
        assert_eq!([shown(KeyCode::Down), shown(KeyCode::Down), shown(KeyCode::Down)], ["width", "", ""]);
    }

    #[test]
    fn word_is_completed_as_far_as_all_choices_agree() {
        let mut editor = Editor::default();
        typed(&mut editor, "f");
        assert_eq!(press(&mut editor, KeyCode::Tab), Step::Typing);
        assert_eq!(editor.text(), "force");
        let choices = vec!["force".to_owned(), "force-limit".to_owned()];
        assert_eq!(press(&mut editor, KeyCode::Tab), Step::Choices(choices));
        typed(&mut editor, "-");
        press(&mut editor, KeyCode::Tab);
        assert_eq!(editor.text(), "force-limit ");
        control(&mut editor, 'u');
        typed(&mut editor, "grip 20 50 --f");
        press(&mut editor, KeyCode::Tab);
        assert_eq!(editor.text(), "grip 20 50 --force ");
    }

    #[test]
    fn control_c_discards_the_line_and_control_d_ends_an_empty_one() {
        let mut editor = Editor::default();
        typed(&mut editor, "move");
        assert_eq!(control(&mut editor, 'd'), Step::Typing);
        assert_eq!(control(&mut editor, 'c'), Step::Discarded);
        assert_eq!(editor.text(), "");
        assert_eq!(control(&mut editor, 'd'), Step::End);
    }
}
