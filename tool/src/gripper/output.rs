//! Results of commands, as text or as one JSON object per line.

use std::io::{self, Write};

use serde_json::{Value, json};

use super::answer::Answer;
use super::trouble::Trouble;

/// The output format. Error text goes to standard error; JSON always goes to standard output.
pub(crate) struct Output {
    pub(crate) is_json: bool,
}

impl Output {
    /// Prints the result of a command and returns its exit status. `line` is the line number and
    /// file name of a script.
    pub(crate) fn tell(
        &self,
        command: &str,
        result: &Result<Answer, Trouble>,
        line: Option<(usize, &str)>,
    ) -> io::Result<u8> {
        let mut stdout = io::stdout().lock();
        let place = line.map(|(number, file)| format!("{file}:{number}: ")).unwrap_or_default();
        if self.is_json {
            let mut object = match result {
                Ok(answer) => answer.to_json(command),
                Err(trouble) => trouble.to_json(command),
            };
            if let (Some((number, _)), Value::Object(object)) = (line, &mut object) {
                object.insert("line".to_owned(), json!(number));
            }
            writeln!(stdout, "{object}")?;
        } else {
            match result {
                Ok(answer) => writeln!(stdout, "{answer}")?,
                Err(trouble) => writeln!(io::stderr(), "wsg: {place}{command}: {trouble}")?,
            }
        }
        stdout.flush()?;
        Ok(match result {
            Ok(answer) => answer.outcome.exit_status(),
            Err(trouble) => trouble.exit_status(),
        })
    }
}
