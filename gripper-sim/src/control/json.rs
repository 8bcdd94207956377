//! JSON with little code, because each visitor of the page without a server loads it. Errors name the member.

use crate::time::Time;
use std::fmt::Write as _;
use wsg_protocol::{Number, editor};

/// The deepest nesting of arrays and objects that is read.
const MAX_DEPTH: u8 = 16;

/// A value that can be written as JSON.
pub trait ToJson {
    /// Appends the value.
    fn write(&self, json: &mut String);

    /// Returns whether an object omits a member with this value.
    fn is_omitted(&self) -> bool {
        false
    }
}

/// A value that can be read from JSON.
pub trait FromJson: Sized {
    /// Returns the value.
    ///
    /// # Errors
    /// Fails on a value of another kind, and names the expected one.
    fn from_json(value: Value) -> Result<Self, String>;

    /// Returns the value of a missing member; `None` if an object must have it.
    #[must_use]
    fn missing() -> Option<Self> {
        None
    }
}

/// A value that an object omits without content.
#[derive(Debug)]
pub struct IfSome<T>(pub Option<T>);

/// A value that is JSON already.
#[derive(Debug)]
pub struct Json<'a>(pub &'a str);

/// A value that was read. A number is its text.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the kinds of JSON")]
pub enum Value {
    Null,
    Bool(bool),
    Number(String),
    Text(String),
    List(Vec<Value>),
    Object(Vec<(String, Value)>),
}

/// Returns an object with these members as JSON, or appends it to a text.
#[macro_export]
#[doc(hidden)]
macro_rules! json_object {
    ($json:ident; $($name:expr => $value:expr),* $(,)?) => {
        $json.push('{');
        $($crate::control::json::write_member($json, $name, &$value);)*
        $json.push('}');
    };
    ($($name:literal: $value:expr),* $(,)?) => {{
        let mut json = String::new();
        let text = &mut json;
        $crate::json_object!(text; $($name => $value),*);
        json
    }};
}

/// Implements [`ToJson`] for a struct, as an object with these members.
#[macro_export]
#[doc(hidden)]
macro_rules! json_members {
    ($type:ident: $($field:ident),*) => {
        impl $crate::control::json::ToJson for $type {
            fn write(&self, json: &mut String) {
                $crate::json_object!(json; $(stringify!($field) => self.$field),*);
            }
        }
    };
}

/// Implements [`FromJson`] for a struct, as an object with these members and no others. `#[default]` ones may be missing.
#[macro_export]
#[doc(hidden)]
macro_rules! json_body {
    ($type:ident: $($(#[$default:ident])? $field:ident),*) => {
        impl $crate::control::json::FromJson for $type {
            fn from_json(value: $crate::control::json::Value) -> Result<Self, String> {
                let mut members = value.into_members(Some(&[$(stringify!($field)),*]))?;
                Ok(Self { $($field: $crate::json_body!(@members $field $($default)?)),* })
            }
        }
    };
    (@$members:ident $field:ident) => { $crate::control::json::take(&mut $members, stringify!($field))? };
    (@$members:ident $field:ident default) => {
        $crate::control::json::take::<Option<_>>(&mut $members, stringify!($field))?.unwrap_or_default()
    };
}

/// Implements both traits for an enum of names.
macro_rules! json_names {
    ($type:ident: $($variant:ident $name:literal),*) => {
        impl $crate::control::json::ToJson for $type {
            fn write(&self, json: &mut String) {
                let name = match self { $(Self::$variant => $name),* };
                $crate::control::json::ToJson::write(name, json);
            }
        }

        impl $crate::control::json::FromJson for $type {
            fn from_json(value: $crate::control::json::Value) -> Result<Self, String> {
                let name = <String as $crate::control::json::FromJson>::from_json(value)?;
                $(if name == $name { return Ok(Self::$variant); })*
                Err($crate::control::json::unknown("variant", &name, &[$($name),*]))
            }
        }
    };
}

pub use crate::{json_body as body, json_members as members, json_object as object};
pub(crate) use json_names as names;

/// Appends a member to an object.
pub fn write_member(json: &mut String, name: &str, value: &dyn ToJson) {
    if !value.is_omitted() {
        json.push_str(if json.ends_with('{') { "\"" } else { ",\"" });
        json.push_str(name);
        json.push_str("\":");
        value.write(json);
    }
}

fn write_list(json: &mut String, items: &mut dyn Iterator<Item = &dyn ToJson>) {
    json.push('[');
    for item in items {
        json.push_str(if json.ends_with('[') { "" } else { "," });
        item.write(json);
    }
    json.push(']');
}

/// Takes a member out of the members of an object.
///
/// # Errors
/// Fails if the member is missing, or has another kind.
pub fn take<T: FromJson>(members: &mut Vec<(String, Value)>, name: &str) -> Result<T, String> {
    match taken(members, name) {
        Some(value) => T::from_json(value).map_err(|error| within(name, &error)),
        None => T::missing().ok_or_else(|| missing(name)),
    }
}

fn within(name: &str, error: &str) -> String {
    format!("`{name}`: {error}")
}

fn missing(name: &str) -> String {
    format!("missing field `{name}`")
}

fn taken(members: &mut Vec<(String, Value)>, name: &str) -> Option<Value> {
    let at = members.iter().position(|(known, _)| known == name)?;
    Some(members.swap_remove(at).1)
}

pub(crate) fn unknown(what: &str, name: &str, known: &[&str]) -> String {
    format!("unknown {what} `{name}`, expected one of `{}`", known.join("`, `"))
}

/// Returns the value of a text in JSON.
///
/// # Errors
/// Fails on another text, and on a value of another kind.
pub fn read<T: FromJson>(text: &[u8]) -> Result<T, String> {
    T::from_json(parse(text)?)
}

fn parse(text: &[u8]) -> Result<Value, String> {
    let mut reader = Reader { rest: str::from_utf8(text).map_err(|_| "no UTF-8")? };
    let value = reader.value(MAX_DEPTH);
    let rest = reader.rest.trim_ascii_start();
    let what = match value {
        Some(value) if rest.is_empty() => return Ok(value),
        Some(_) => "trailing characters",
        None if rest.is_empty() => "EOF",
        None => "invalid JSON",
    };
    Err(format!("{what} at column {}", text.len() - rest.len() + 1))
}

impl Value {
    /// Returns the members of an object that may have these ones, or any.
    ///
    /// # Errors
    /// Fails on a value that is no object, and on an object with another member, or with the same one twice.
    pub fn into_members(self, known: Option<&[&str]>) -> Result<Vec<(String, Self)>, String> {
        let Self::Object(members) = self else { return Err(self.is_not("an object")) };
        for (at, (name, _)) in members.iter().enumerate() {
            if let Some(known) = known.filter(|known| !known.contains(&&name[..])) {
                return Err(unknown("field", name, known));
            }
            if members.iter().take(at).any(|(other, _)| other == name) {
                return Err(format!("duplicate field `{name}`"));
            }
        }
        Ok(members)
    }

    /// Returns the error for a value of the wrong kind.
    fn is_not(&self, expected: &str) -> String {
        let found = match self {
            Self::Null => "null",
            Self::Bool(true) => "true",
            Self::Bool(false) => "false",
            Self::Number(text) => text,
            Self::Text(text) => return format!("{} is not {expected}", editor::Quoted(text)),
            Self::List(_) => "a list",
            Self::Object(_) => "an object",
        };
        format!("{found} is not {expected}")
    }
}

struct Reader<'a> {
    rest: &'a str,
}

impl Reader<'_> {
    fn takes(&mut self, token: &str) -> bool {
        self.rest = self.rest.trim_ascii_start();
        self.rest.strip_prefix(token).inspect(|rest| self.rest = rest).is_some()
    }

    fn value(&mut self, depth: u8) -> Option<Value> {
        let depth = depth.checked_sub(1)?;
        Some(if self.takes("\"") {
            Value::Text(self.text()?)
        } else if self.takes("{") {
            let mut members = Vec::new();
            while !self.ends(members.is_empty(), "}")? {
                let name = if self.takes("\"") { self.text()? } else { return None };
                members.push((name, if self.takes(":") { self.value(depth)? } else { return None }));
            }
            Value::Object(members)
        } else if self.takes("[") {
            let mut items = Vec::new();
            while !self.ends(items.is_empty(), "]")? {
                items.push(self.value(depth)?);
            }
            Value::List(items)
        } else if self.takes("null") {
            Value::Null
        } else if self.takes("true") {
            Value::Bool(true)
        } else if self.takes("false") {
            Value::Bool(false)
        } else {
            let is_other = |byte: u8| !matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E');
            let len = self.rest.bytes().position(is_other).unwrap_or(self.rest.len());
            let (number, rest) = self.rest.split_at_checked(len)?;
            if !is_number(number) {
                return None;
            }
            self.rest = rest;
            Value::Number(number.to_owned())
        })
    }

    /// Returns whether an array or object ends here, which has a comma before each further item.
    fn ends(&mut self, is_empty: bool, end: &str) -> Option<bool> {
        if self.takes(end) {
            return Some(true);
        }
        (is_empty || self.takes(",")).then_some(false)
    }

    /// Returns the text up to the next quotation mark.
    fn text(&mut self) -> Option<String> {
        let mut text = String::new();
        loop {
            text.push(match self.char()? {
                '"' => return Some(text),
                '\\' => match self.char()? {
                    char @ ('"' | '\\' | '/') => char,
                    'b' => '\u{8}',
                    'f' => '\u{C}',
                    'n' => '\n',
                    'r' => '\r',
                    't' => '\t',
                    'u' => match self.unit()? {
                        high @ 0xD800..0xDC00 => {
                            let is_pair = self.char()? == '\\' && self.char()? == 'u';
                            let low = self.unit().filter(|low| is_pair && (0xDC00..0xE000).contains(low))?;
                            char::from_u32(0x1_0000 + ((high & 0x3FF) << 10) + (low & 0x3FF))?
                        }
                        unit => char::from_u32(unit)?,
                    },
                    _ => return None,
                },
                char if char < ' ' => return None,
                char => char,
            });
        }
    }

    fn char(&mut self) -> Option<char> {
        let mut chars = self.rest.chars();
        let char = chars.next()?;
        self.rest = chars.as_str();
        Some(char)
    }

    /// Returns a unit of UTF-16 in four hexadecimal digits.
    fn unit(&mut self) -> Option<u32> {
        (0..4).try_fold(0, |unit, _| Some(unit * 16 + self.char()?.to_digit(16)?))
    }
}

fn is_number(text: &str) -> bool {
    let text = text.strip_prefix('-').unwrap_or(text);
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, "0"));
    let exponent = exponent.strip_prefix(['+', '-']).unwrap_or(exponent);
    let are_digits = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    [whole, fraction, exponent].into_iter().all(are_digits) && (whole == "0" || !whole.starts_with('0'))
}

/// Implements [`ToJson`] for types whose text is JSON.
macro_rules! by_display {
    ($($type:ty)*) => {$(
        impl ToJson for $type {
            fn write(&self, json: &mut String) {
                // Writing to a string cannot fail.
                let _ = write!(json, "{self}");
            }
        }
    )*};
}
by_display!(bool u8 u16 u32 u64 i16);

/// JSON has no infinite numbers.
impl ToJson for f32 {
    fn write(&self, json: &mut String) {
        let text = Number(*self).to_string();
        json.push_str(if self.is_finite() { &text } else { "null" });
        if self.is_finite() && text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'-') {
            json.push_str(".0");
        }
    }
}

/// A moment is its number of seconds.
impl ToJson for Time {
    fn write(&self, json: &mut String) {
        let micros = self.as_micros();
        let _ = write!(json, "{}.{:06}", micros / 1_000_000, micros % 1_000_000);
        json.truncate(json.trim_end_matches('0').len());
        json.push_str(if json.ends_with('.') { "0" } else { "" });
    }
}

/// Implements [`FromJson`] for whole numbers.
macro_rules! integers {
    ($($type:ty)*) => {$(
        impl FromJson for $type {
            fn from_json(value: Value) -> Result<Self, String> {
                let number = if let Value::Number(text) = &value { text.parse::<u64>().ok() } else { None };
                let number = number.and_then(|number| Self::try_from(number).ok());
                number.ok_or_else(|| value.is_not(&format!("a whole number from 0 to {}", Self::MAX)))
            }
        }
    )*};
}
integers!(u8 u32 u64);

impl FromJson for f32 {
    fn from_json(value: Value) -> Result<Self, String> {
        let number = if let Value::Number(text) = &value { editor::number(text) } else { None };
        number.ok_or_else(|| value.is_not("a number"))
    }
}

impl FromJson for bool {
    fn from_json(value: Value) -> Result<Self, String> {
        if let Value::Bool(value) = value { Ok(value) } else { Err(value.is_not("true or false")) }
    }
}

impl FromJson for String {
    fn from_json(value: Value) -> Result<Self, String> {
        if let Value::Text(text) = value { Ok(text) } else { Err(value.is_not("a text")) }
    }
}

impl<T: FromJson> FromJson for Option<T> {
    fn from_json(value: Value) -> Result<Self, String> {
        if value == Value::Null { Ok(None) } else { T::from_json(value).map(Some) }
    }

    fn missing() -> Option<Self> {
        Some(None)
    }
}

impl<T: FromJson> FromJson for Vec<T> {
    fn from_json(value: Value) -> Result<Self, String> {
        let Value::List(items) = value else { return Err(value.is_not("a list")) };
        items.into_iter().map(T::from_json).collect()
    }
}

impl FromJson for Value {
    fn from_json(value: Value) -> Result<Self, String> {
        Ok(value)
    }
}

impl ToJson for str {
    fn write(&self, json: &mut String) {
        json.push('"');
        for char in self.chars() {
            match char {
                '"' | '\\' => json.extend(['\\', char]),
                '\n' => json.push_str("\\n"),
                '\0'..' ' => {
                    let _ = write!(json, "\\u{:04x}", u32::from(char));
                }
                char => json.push(char),
            }
        }
        json.push('"');
    }
}

impl ToJson for String {
    fn write(&self, json: &mut String) {
        (**self).write(json);
    }
}

impl ToJson for Json<'_> {
    fn write(&self, json: &mut String) {
        json.push_str(self.0);
    }
}

impl<T: ToJson + ?Sized> ToJson for &T {
    fn write(&self, json: &mut String) {
        (**self).write(json);
    }
}

impl<T: ToJson> ToJson for Option<T> {
    fn write(&self, json: &mut String) {
        match self {
            Some(value) => value.write(json),
            None => json.push_str("null"),
        }
    }
}

impl<T: ToJson> ToJson for IfSome<T> {
    fn write(&self, json: &mut String) {
        self.0.write(json);
    }

    fn is_omitted(&self) -> bool {
        self.0.is_none()
    }
}

impl<T: ToJson> ToJson for [T] {
    fn write(&self, json: &mut String) {
        write_list(json, &mut self.iter().map(|item| item as &dyn ToJson));
    }
}

impl<T: ToJson, const N: usize> ToJson for [T; N] {
    fn write(&self, json: &mut String) {
        self[..].write(json);
    }
}

impl<T: ToJson> ToJson for Vec<T> {
    fn write(&self, json: &mut String) {
        self[..].write(json);
    }
}

/// Implements [`ToJson`] for tuples.
macro_rules! tuples {
    ($(($($type:ident $at:tt),*))*) => {$(
        impl<$($type: ToJson),*> ToJson for ($($type),*) {
            fn write(&self, json: &mut String) {
                write_list(json, &mut [$(&self.$at as &dyn ToJson),*].into_iter());
            }
        }
    )*};
}
tuples! {
    (A 0, B 1)
    (A 0, B 1, C 2, D 3)
    (A 0, B 1, C 2, D 3, E 4)
    (A 0, B 1, C 2, D 3, E 4, F 5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_in_json_is_read_as_serde_reads_it() {
        for text in [
            r#"{"a": [1, -2.5e+3, 0.1], "b": {"c": null}, "d":true , "e":false}"#,
            " [] ",
            "{}",
            "\"\"",
            "7",
            "-0",
            "0e0",
            r#""\u0041\ud83d\ude00\"\\\/\b\f\n\r\t\u00e4ä""#,
            "[[[[]]]]",
            // Invalid ones.
            "",
            "[1,]",
            "[,1]",
            "[1 2]",
            "{\"a\"}",
            "{a:1}",
            "{\"a\":1,}",
            "01",
            "1.",
            ".5",
            "+1",
            "1e",
            "-",
            "nul",
            "truefalse",
            "\"",
            "\"\n\"",
            r#""\x""#,
            r#""\ud83d""#,
            r#""\ud83dA""#,
            r#""\ude00""#,
            r#""\u12""#,
            "1 1",
            "[",
            "{\"a\":",
            "]",
        ] {
            let known = serde_json::from_str::<serde_json::Value>(text);
            match (parse(text.as_bytes()), known) {
                (Ok(value), Ok(known)) => assert_eq!(as_known(&value), known, "{text}"),
                (Err(_), Err(_)) => {}
                (ours, known) => panic!("{text}: {ours:?}, {known:?}"),
            }
        }
        let deep = |depth| "[".repeat(depth) + &"]".repeat(depth);
        assert!(parse(deep(16).as_bytes()).is_ok() && parse(deep(100_000).as_bytes()).is_err());
        assert!(parse(b"\"\xFF\"").is_err());
    }

    fn as_known(value: &Value) -> serde_json::Value {
        match value {
            Value::Null => serde_json::Value::Null,
            Value::Bool(value) => (*value).into(),
            Value::Number(number) => serde_json::from_str(number).unwrap(),
            Value::Text(text) => text.as_str().into(),
            Value::List(items) => items.iter().map(as_known).collect(),
            Value::Object(members) => {
                members.iter().map(|(name, value)| (name.clone(), as_known(value))).collect()
            }
        }
    }

    #[test]
    fn value_is_written_as_json() {
        let text = "a\"\\\n\t\u{1}\u{7f}ä😀[{";
        let numbers = [0.1f32, 50.0, -1.5e-7, 1e16, f32::NAN];
        let json = object! {
            "text": text, "numbers": numbers, "times": [0, 12_345_678, 2_500_000, 10_000_000].map(Time::from_micros), "none": None::<u8>, "left": IfSome(None::<u8>),
            "pair": (true, u64::MAX), "lists": [vec!["["], vec![]], "inner": Json(&object! {}),
        };
        let expected = concat!(
            r#"{"text":"a\"\\\n\u0009\u0001"#,
            "\u{7f}ä😀[{\"",
            r#","numbers":[0.1,50.0,-1.5e-7,1e16,null],"times":[0.0,12.345678,2.5,10.0],"none":null,"#,
            r#""pair":[true,18446744073709551615],"lists":[["["],[]],"inner":{}}"#
        );
        assert_eq!(json, expected);
        let known: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(known["text"], text);
    }

    #[derive(Debug, PartialEq)]
    struct Body {
        on: bool,
        count: u8,
        width: Option<f32>,
    }
    body!(Body: on, #[default] count, width);

    #[test]
    fn object_has_the_members_of_its_struct_and_the_error_names_the_wrong_one() {
        let all = Body { on: true, count: 3, width: Some(1.5) };
        assert_eq!(read(br#"{"width":1.5,"on":true,"count":3}"#), Ok(all));
        assert_eq!(read(br#"{"on":false,"width":null}"#), Ok(Body { on: false, count: 0, width: None }));
        for (text, error) in [
            ("{}", "missing field `on`"),
            (r#"{"on":1}"#, "`on`: 1 is not true or false"),
            (r#"{"on":true,"count":256}"#, "`count`: 256 is not a whole number from 0 to 255"),
            (r#"{"on":true,"count":1.0}"#, "`count`: 1.0 is not a whole number from 0 to 255"),
            (r#"{"on":true,"width":"1"}"#, "`width`: \"1\" is not a number"),
            (r#"{"on":true,"off":1}"#, "unknown field `off`, expected one of `on`, `count`, `width`"),
            (r#"{"on":true,"on":true}"#, "duplicate field `on`"),
            ("[]", "a list is not an object"),
            ("", "EOF at column 1"),
            (r#"{"on":true} x"#, "trailing characters at column 13"),
            (r#"{"on":x}"#, "invalid JSON at column 7"),
        ] {
            assert_eq!(read::<Body>(text.as_bytes()), Err(error.to_owned()), "{text}");
        }
    }
}
