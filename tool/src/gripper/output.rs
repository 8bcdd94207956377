//! Results of commands, as text or as one JSON object per line.

use std::io::{self, Write};

use serde_json::{Value, json};
use wsg_sim::text::one_line;

use super::answer::Answer;
use super::trouble::Trouble;

/// The output format. Error text goes to standard error; JSON always goes to standard output.
pub(crate) struct Output {
    pub(crate) is_json: bool,
}

impl Output {
    /// Prints the result of a command and returns its exit status. `line` is the line number and
    /// file name of a script.
    pub(crate) fn report(
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
                Err(trouble) => {
                    let text = trouble.to_string();
                    // The mistakes of a script are one line each.
                    let text = match trouble {
                        Trouble::Usage(_) => text.split('\n').map(one_line).collect::<Vec<_>>().join("\n"),
                        _ => one_line(&text).into_owned(),
                    };
                    writeln!(io::stderr(), "wsg: {place}{}: {text}", one_line(command))?;
                }
            }
        }
        stdout.flush()?;
        Ok(match result {
            Ok(answer) => answer.outcome.exit_status(),
            Err(trouble) => trouble.exit_status(),
        })
    }
}
