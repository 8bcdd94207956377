//! Results of successful commands, as text and as JSON.

use std::fmt::{self, Display, Formatter};

use serde_json::{Map, Value, json};
use wsg_sim::text::one_line;

/// The result of a command that was executed.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) outcome: Outcome,
    values: Vec<(&'static str, Datum)>,
}

/// How an executed command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    Done,
    Held,
    NoPart,
}

/// A value in a result.
#[derive(Debug)]
pub(crate) enum Datum {
    Number(f32, Unit),
    Count(u32),
    Text(String),
    Names(Vec<String>),
    Nothing,
}

/// A unit: its text, its suffix in the name of a JSON value, and the number of decimals shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unit {
    text: &'static str,
    suffix: &'static str,
    digits: usize,
}

pub(crate) const MM: Unit = Unit { text: "mm", suffix: "_mm", digits: 2 };
pub(crate) const MM_PER_S: Unit = Unit { text: "mm/s", suffix: "_mm_per_s", digits: 1 };
pub(crate) const MM_PER_S2: Unit = Unit { text: "mm/s²", suffix: "_mm_per_s2", digits: 1 };
pub(crate) const NEWTON: Unit = Unit { text: "N", suffix: "_n", digits: 1 };
pub(crate) const CELSIUS: Unit = Unit { text: "°C", suffix: "_celsius", digits: 1 };

impl Answer {
    /// Returns a result without values.
    pub(crate) const fn done() -> Self {
        Self::of(Outcome::Done)
    }

    pub(crate) const fn of(outcome: Outcome) -> Self {
        Self { outcome, values: Vec::new() }
    }

    /// Appends a value. Words of its name are separated by spaces.
    pub(crate) fn with(mut self, name: &'static str, datum: Datum) -> Self {
        self.values.push((name, datum));
        self
    }

    pub(crate) fn number(self, name: &'static str, number: f32, unit: Unit) -> Self {
        self.with(name, Datum::Number(number, unit))
    }

    pub(crate) fn text(self, name: &'static str, text: impl Display) -> Self {
        self.with(name, Datum::Text(text.to_string()))
    }

    /// Returns the result as a JSON object. Values carry the unit in their name.
    pub(crate) fn to_json(&self, command: &str) -> Value {
        let mut object = Map::new();
        object.insert("command".to_owned(), json!(command));
        object.insert("result".to_owned(), json!(self.outcome.name()));
        for (name, datum) in &self.values {
            let (suffix, value) = datum.to_json();
            object.insert(name.replace(' ', "_") + suffix, value);
        }
        Value::Object(object)
    }
}

impl Outcome {
    /// The value of `result` in JSON.
    const fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Held => "held",
            Self::NoPart => "no_part",
        }
    }
}

impl Datum {
    fn to_json(&self) -> (&'static str, Value) {
        match self {
            // The shortest form: 20.1 instead of 20.100000381469727.
            Self::Number(number, unit) => {
                (unit.suffix, json!(number.to_string().parse::<f64>().unwrap_or_default()))
            }
            Self::Count(count) => ("", json!(count)),
            Self::Text(text) => ("", json!(text)),
            Self::Names(names) => ("", json!(names)),
            Self::Nothing => ("", Value::Null),
        }
    }
}

impl Display for Datum {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number, Unit { text, digits, .. }) => {
                // Avoid "-0.0".
                let number = if *number == 0.0 { 0.0 } else { *number };
                write!(f, "{number:.digits$} {text}")
            }
            Self::Count(count) => write!(f, "{count}"),
            Self::Text(text) => f.write_str(&one_line(text)),
            Self::Names(names) if names.is_empty() => f.write_str("none"),
            Self::Names(names) => f.write_str(&names.join(" ")),
            Self::Nothing => f.write_str("none"),
        }
    }
}

impl Display for Answer {
    /// Writes one line per value, or the outcome of a grip followed by its values.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let words = |(name, datum): &(&str, Datum)| format!("{name} {datum}");
        let values: Vec<String> = self.values.iter().map(words).collect();
        let outcome = match self.outcome {
            Outcome::Done if values.is_empty() => return f.write_str("done"),
            Outcome::Done => return f.write_str(&values.join("\n")),
            Outcome::Held => "a part is held",
            Outcome::NoPart => "no part",
        };
        f.write_str(outcome)?;
        if values.is_empty() { Ok(()) } else { write!(f, ": {}", values.join(", ")) }
    }
}
