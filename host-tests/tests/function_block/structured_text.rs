//! An interpreter for the subset of IEC 61131-3 structured text that docs/*.st uses, and for the same subset of Siemens SCL.
//! It is strict: anything that a PLC compiler could reject or interpret differently is a panic here, such as an unknown name,
//! a wrong type, a number out of range, a write to an input, or a mixture of the two dialects.

use std::collections::{BTreeMap, BTreeSet};

/// A typed value. BYTE, WORD and DWORD are bit strings, which do not mix with numbers or with each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Value {
    Bool(bool),
    Bits(u32, u64),
    Int(i64),
    Time(i64),
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Token {
    Name(String),
    /// `#NAME`: a variable of an SCL block.
    Local(String),
    /// `"NAME"`: a block of an SCL source.
    Quoted(String),
    Value(Value),
    Symbol(&'static str),
}

/// A token with its line number.
type Placed = (usize, Token);

const SYMBOLS: [&str; 15] = [":=", "<>", "<=", ">=", "<", ">", "=", "+", "-", "(", ")", ";", ":", ",", "."];

/// Splits a text into tokens; comments are `(* *)`.
fn tokens(text: &str) -> Vec<Placed> {
    let mut found = Vec::new();
    let mut rest = text;
    loop {
        rest = rest.trim_start();
        let line = 1 + text[..text.len() - rest.len()].matches('\n').count();
        if rest.is_empty() {
            return found;
        }
        if let Some(comment) = rest.strip_prefix("(*") {
            let end = comment.find("*)").unwrap_or_else(|| panic!("line {line}: the comment does not end"));
            rest = &comment[end + 2..];
            continue;
        }
        if let Some(attributes) = rest.strip_prefix('{') {
            (_, rest) = attributes.split_once('}').unwrap_or_else(|| panic!("line {line}: missing }}"));
            continue;
        }
        if let Some(quoted) = rest.strip_prefix('"') {
            let name;
            (name, rest) = quoted.split_once('"').unwrap_or_else(|| panic!("line {line}: missing \""));
            found.push((line, Token::Quoted(name.to_owned())));
            continue;
        }
        let word: &str = {
            let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '#';
            &rest[..rest.find(|c| !is_word(c)).unwrap_or(rest.len())]
        };
        let token = if word.is_empty() {
            let symbol = SYMBOLS.iter().find(|symbol| rest.starts_with(**symbol));
            Token::Symbol(symbol.unwrap_or_else(|| panic!("line {line}: {}", &rest[..1])))
        } else if let Some(name) = word.strip_prefix('#') {
            Token::Local(name.to_owned())
        } else if let Some((kind, literal)) = word.split_once('#') {
            Token::Value(typed_literal(kind, literal).unwrap_or_else(|| panic!("line {line}: {word}")))
        } else if word.starts_with(|c: char| c.is_ascii_digit()) {
            Token::Value(Value::Int(word.parse().unwrap_or_else(|_| panic!("line {line}: {word}"))))
        } else {
            Token::Name(word.to_owned())
        };
        rest = match &token {
            Token::Symbol(symbol) => &rest[symbol.len()..],
            _ => &rest[word.len()..],
        };
        found.push((line, token));
    }
}

/// Parses a literal with a type, such as `T#500MS` or `BYTE#16#20`.
pub(crate) fn typed_literal(kind: &str, literal: &str) -> Option<Value> {
    if kind == "T" {
        let unit = literal.find(|c: char| !c.is_ascii_digit())?;
        let factor = match &literal[unit..] {
            "MS" => 1,
            "S" => 1_000,
            "H" => 3_600_000,
            _ => return None,
        };
        return Some(Value::Time(literal[..unit].parse::<i64>().ok()? * factor));
    }
    let bits = width_of(kind)?;
    let value = u64::from_str_radix(literal.strip_prefix("16#")?, 16).ok()?;
    (value >> bits == 0).then_some(Value::Bits(bits, value))
}

/// Returns the width of a bit string type.
fn width_of(kind: &str) -> Option<u32> {
    match kind {
        "BYTE" => Some(8),
        "WORD" => Some(16),
        "DWORD" => Some(32),
        _ => None,
    }
}

/// Returns the range of a number type.
fn range_of(kind: &str) -> Option<(i64, i64)> {
    match kind {
        "INT" => Some((i16::MIN.into(), i16::MAX.into())),
        "UINT" => Some((0, u16::MAX.into())),
        _ => None,
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Section {
    Input,
    Output,
    Local,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Variable {
    section: Section,
    kind: String,
    begins: Option<Value>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Expression {
    Literal(Value),
    Variable(Vec<String>),
    Not(Box<Expression>),
    Both(&'static str, Box<Expression>, Box<Expression>),
    Call(String, Vec<Expression>),
}

/// A statement with its line number, which comparisons ignore.
#[derive(Clone, Debug)]
struct Statement {
    line: usize,
    what: What,
}

impl PartialEq for Statement {
    fn eq(&self, other: &Self) -> bool {
        self.what == other.what
    }
}

#[derive(Clone, Debug, PartialEq)]
enum What {
    Assign(String, Expression),
    If(Vec<(Expression, Vec<Statement>)>),
    Case(Expression, Vec<(i64, Vec<Statement>)>),
    Invoke(String, Vec<(String, Expression)>),
}

/// A function block or program. Two of them are equal if they have the same variables and statements.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Unit {
    pub(crate) name: String,
    variables: BTreeMap<String, Variable>,
    body: Vec<Statement>,
}

impl Unit {
    /// Parses a text with exactly one function block or program.
    pub(crate) fn parse(text: &str) -> Self {
        let mut all = Parser { tokens: tokens(text), at: 0, is_scl: false }.units();
        assert_eq!(all.len(), 1, "expected one unit");
        all.remove(0)
    }

    /// Parses a text with any number of function blocks of SCL.
    pub(crate) fn parse_scl(text: &str) -> Vec<Self> {
        Parser { tokens: tokens(text), at: 0, is_scl: true }.units()
    }

    /// Returns the lines of all statements with an effect of their own.
    pub(crate) fn lines(&self) -> BTreeSet<usize> {
        fn add(statements: &[Statement], lines: &mut BTreeSet<usize>) {
            for statement in statements {
                match &statement.what {
                    What::Assign(..) | What::Invoke(..) => drop(lines.insert(statement.line)),
                    What::If(arms) => arms.iter().for_each(|(_, body)| add(body, lines)),
                    What::Case(_, arms) => arms.iter().for_each(|(_, body)| add(body, lines)),
                }
            }
        }
        let mut lines = BTreeSet::new();
        add(&self.body, &mut lines);
        lines
    }
}

struct Parser {
    tokens: Vec<Placed>,
    at: usize,
    is_scl: bool,
}

impl Parser {
    fn units(mut self) -> Vec<Unit> {
        let mut all = Vec::new();
        while self.at < self.tokens.len() {
            all.push(self.unit());
        }
        all
    }

    fn unit(&mut self) -> Unit {
        let kind = self.name();
        let kinds: &[&str] = if self.is_scl { &["FUNCTION_BLOCK"] } else { &["FUNCTION_BLOCK", "PROGRAM"] };
        assert!(kinds.contains(&&kind[..]), "{kind}");
        let name = self.block_name();
        if self.is_scl {
            self.word("VERSION");
            self.symbol(":");
            self.literal();
            self.symbol(".");
            self.literal();
        }
        let variables = self.variables();
        if self.is_scl {
            self.word("BEGIN");
        }
        let body = self.statements();
        self.word(&format!("END_{kind}"));
        Unit { name, variables, body }
    }

    /// Consumes the name of a block, which is in quotation marks in SCL.
    fn block_name(&mut self) -> String {
        match self.peek().cloned() {
            Some(Token::Quoted(name)) if self.is_scl => {
                self.at += 1;
                name
            }
            _ if self.is_scl => self.fail("a name in quotation marks"),
            _ => self.name(),
        }
    }

    /// Consumes the name of a type. SCL names its timer differently.
    fn kind(&mut self) -> String {
        if matches!(self.peek(), Some(Token::Quoted(_))) {
            return self.block_name();
        }
        let name = self.name();
        if self.is_scl && name == "TON_TIME" { "TON".to_owned() } else { name }
    }

    /// Consumes the name of a variable in a statement, which begins with # in SCL.
    fn variable(&mut self) -> String {
        match self.peek().cloned() {
            Some(Token::Local(name)) if self.is_scl => {
                self.at += 1;
                name
            }
            _ if self.is_scl => self.fail("a name with #"),
            _ => self.name(),
        }
    }

    fn peek(&self) -> Option<&Token> {
        self.tokens.get(self.at).map(|(_, token)| token)
    }

    fn line(&self) -> usize {
        self.tokens.get(self.at).map_or(0, |(line, _)| *line)
    }

    fn fail(&self, wanted: &str) -> ! {
        panic!("line {}: expected {wanted}, found {:?}", self.line(), self.peek())
    }

    fn takes(&mut self, symbol: &str) -> bool {
        let is = matches!(self.peek(), Some(Token::Symbol(other)) if *other == symbol);
        self.at += usize::from(is);
        is
    }

    fn symbol(&mut self, symbol: &str) {
        if !self.takes(symbol) {
            self.fail(symbol);
        }
    }

    fn takes_word(&mut self, word: &str) -> bool {
        let is = matches!(self.peek(), Some(Token::Name(other)) if other == word);
        self.at += usize::from(is);
        is
    }

    fn word(&mut self, word: &str) {
        if !self.takes_word(word) {
            self.fail(word);
        }
    }

    fn name(&mut self) -> String {
        let Some(Token::Name(name)) = self.peek().cloned() else { self.fail("a name") };
        self.at += 1;
        name
    }

    fn literal(&mut self) -> Value {
        let is_negative = self.takes("-");
        let Some(Token::Value(value)) = self.peek().cloned() else { self.fail("a value") };
        self.at += 1;
        match value {
            Value::Int(number) if is_negative => Value::Int(-number),
            value => value,
        }
    }

    fn variables(&mut self) -> BTreeMap<String, Variable> {
        let mut all: BTreeMap<String, Variable> = BTreeMap::new();
        loop {
            let section = if self.takes_word("VAR_INPUT") {
                Section::Input
            } else if self.takes_word("VAR_OUTPUT") {
                Section::Output
            } else if self.takes_word("VAR") {
                Section::Local
            } else {
                return all;
            };
            while !self.takes_word("END_VAR") {
                let name = self.name();
                self.symbol(":");
                let kind = self.kind();
                let begins = self.takes(":=").then(|| self.literal());
                self.symbol(";");
                // Names are case-insensitive.
                assert!(
                    all.keys().all(|other| !other.eq_ignore_ascii_case(&name)),
                    "{name} is declared twice"
                );
                all.insert(name, Variable { section, kind, begins });
            }
        }
    }

    /// Parses statements up to a word that ends them, without consuming it.
    fn statements(&mut self) -> Vec<Statement> {
        let mut all = Vec::new();
        loop {
            match self.peek() {
                Some(Token::Name(name))
                    if !(name.starts_with("END_") || name == "ELSIF" || name == "ELSE") => {}
                Some(Token::Local(_)) => {}
                _ => return all,
            }
            all.push(self.statement());
        }
    }

    fn statement(&mut self) -> Statement {
        let line = self.line();
        let what = if self.takes_word("IF") {
            let mut arms = Vec::new();
            loop {
                let condition = self.expression();
                self.word("THEN");
                arms.push((condition, self.statements()));
                if !self.takes_word("ELSIF") {
                    break;
                }
            }
            if self.takes_word("ELSE") {
                arms.push((Expression::Literal(Value::Bool(true)), self.statements()));
            }
            self.word("END_IF");
            What::If(arms)
        } else if self.takes_word("CASE") {
            let selector = self.expression();
            self.word("OF");
            let mut arms = Vec::new();
            while let Some(Token::Value(Value::Int(label))) = self.peek().cloned() {
                self.at += 1;
                self.symbol(":");
                arms.push((label, self.statements()));
            }
            self.word("END_CASE");
            What::Case(selector, arms)
        } else {
            let name = self.variable();
            if self.takes(":=") {
                What::Assign(name, self.expression())
            } else {
                self.symbol("(");
                let mut inputs = Vec::new();
                while !self.takes(")") {
                    let input = self.name();
                    self.symbol(":=");
                    inputs.push((input, self.expression()));
                    if !self.takes(",") {
                        self.symbol(")");
                        break;
                    }
                }
                What::Invoke(name, inputs)
            }
        };
        self.symbol(";");
        Statement { line, what }
    }

    fn expression(&mut self) -> Expression {
        self.level(0)
    }

    /// Parses operators from the lowest precedence: OR, AND, = and <>, < and the like, + and -.
    fn level(&mut self, level: usize) -> Expression {
        const LEVELS: [&[&str]; 5] = [&["OR"], &["AND"], &["=", "<>"], &["<=", ">=", "<", ">"], &["+", "-"]];
        let Some(operators) = LEVELS.get(level) else { return self.primary() };
        let mut left = self.level(level + 1);
        while let Some(operator) =
            operators.iter().find(|operator| self.takes(operator) || self.takes_word(operator))
        {
            let right = self.level(level + 1);
            left = Expression::Both(operator, Box::new(left), Box::new(right));
        }
        left
    }

    /// Parses an argument of a function. Some functions of SCL require the parameter's name.
    fn argument(&mut self, function: &str, parameter: &str) -> Expression {
        if self.is_scl && SHIFTS.contains(&function) {
            self.word(parameter);
            self.symbol(":=");
        }
        self.expression()
    }

    fn primary(&mut self) -> Expression {
        if self.takes("(") {
            let inner = self.expression();
            self.symbol(")");
            return inner;
        }
        if self.takes_word("NOT") {
            return Expression::Not(Box::new(self.primary()));
        }
        match self.peek() {
            Some(Token::Name(name)) if name == "TRUE" || name == "FALSE" => {
                let is_true = name == "TRUE";
                self.at += 1;
                Expression::Literal(Value::Bool(is_true))
            }
            Some(Token::Name(_)) if matches!(self.tokens.get(self.at + 1), Some((_, Token::Symbol("(")))) => {
                let name = self.name();
                self.symbol("(");
                let mut arguments = vec![self.argument(&name, "IN")];
                while self.takes(",") {
                    arguments.push(self.argument(&name, "N"));
                }
                self.symbol(")");
                Expression::Call(name, arguments)
            }
            Some(Token::Name(_) | Token::Local(_)) => {
                let mut path = vec![self.variable()];
                while self.takes(".") {
                    path.push(self.name());
                }
                Expression::Variable(path)
            }
            _ => Expression::Literal(self.literal()),
        }
    }
}

/// Functions whose parameters have names in SCL.
const SHIFTS: [&str; 3] = ["SHL", "SHR", "ROL"];

#[derive(Clone, Debug)]
enum Slot {
    Plain(Value),
    Timer(Timer),
    Block(Box<Instance>),
}

/// TON: on-delay timer.
#[derive(Clone, Debug, Default)]
struct Timer {
    since_ms: Option<i64>,
    elapsed_ms: i64,
    preset_ms: i64,
}

/// A function block or program with its variables.
#[derive(Clone, Debug)]
pub(crate) struct Instance {
    unit: Unit,
    slots: BTreeMap<String, Slot>,
    pub(crate) covered: BTreeSet<usize>,
}

impl Instance {
    /// Creates an instance of the unit with this name, with initial values.
    pub(crate) fn new(units: &[Unit], name: &str) -> Self {
        let unit = units.iter().find(|unit| unit.name == name);
        let unit = unit.unwrap_or_else(|| panic!("unknown unit {name}")).clone();
        let slots = unit.variables.iter().map(|(name, variable)| {
            let kind = &variable.kind[..];
            let slot = match (kind, width_of(kind), range_of(kind)) {
                ("BOOL", ..) => Slot::Plain(Value::Bool(false)),
                ("TIME", ..) => Slot::Plain(Value::Time(0)),
                ("TON", ..) => Slot::Timer(Timer::default()),
                (_, Some(bits), _) => Slot::Plain(Value::Bits(bits, 0)),
                (_, _, Some(_)) => Slot::Plain(Value::Int(0)),
                _ => Slot::Block(Box::new(Self::new(units, kind))),
            };
            (name.clone(), slot)
        });
        let mut instance = Self { slots: slots.collect(), unit: unit.clone(), covered: BTreeSet::new() };
        for (name, variable) in unit.variables {
            if let Some(value) = variable.begins {
                instance.set(&name, value);
            }
        }
        instance
    }

    /// Reads a variable, or a variable of a nested function block: `Gripper.Ready`.
    pub(crate) fn get(&self, path: &str) -> Value {
        let path: Vec<String> = path.split('.').map(str::to_owned).collect();
        self.read(&path)
    }

    /// Writes a variable; the types must agree.
    pub(crate) fn set(&mut self, name: &str, value: Value) {
        let variable =
            self.unit.variables.get(name).unwrap_or_else(|| panic!("{} has no {name}", self.unit.name));
        let kind = &variable.kind[..];
        let fits = match value {
            Value::Bool(_) => kind == "BOOL",
            Value::Time(_) => kind == "TIME",
            Value::Bits(bits, _) => width_of(kind) == Some(bits),
            Value::Int(number) => {
                range_of(kind).is_some_and(|(least, most)| (least..=most).contains(&number))
            }
        };
        assert!(fits, "{name}: {kind} does not accept {value:?}");
        self.slots.insert(name.to_owned(), Slot::Plain(value));
    }

    /// Runs one cycle of the PLC.
    pub(crate) fn scan(&mut self, now_ms: i64) {
        let body = self.unit.body.clone();
        self.run(&body, now_ms);
    }

    /// Returns the function block in this variable.
    pub(crate) fn block(&self, name: &str) -> &Self {
        let Some(Slot::Block(block)) = self.slots.get(name) else { panic!("{name} is not a function block") };
        block
    }

    fn run(&mut self, statements: &[Statement], now_ms: i64) {
        for Statement { line, what } in statements {
            match what {
                What::Assign(name, expression) => {
                    let value = self.value(expression);
                    let section = self.unit.variables.get(name).map(|variable| variable.section);
                    assert_ne!(section, Some(Section::Input), "line {line}: {name} is an input");
                    self.set(name, value);
                    self.covered.insert(*line);
                }
                What::If(arms) => {
                    let arm = arms.iter().find(|(condition, _)| self.truth(condition));
                    if let Some((_, body)) = arm {
                        self.run(body, now_ms);
                    }
                }
                What::Case(selector, arms) => {
                    let selected = self.value(selector);
                    let arm = arms.iter().find(|(label, _)| Value::Int(*label) == selected);
                    let (_, body) =
                        arm.unwrap_or_else(|| panic!("line {line}: CASE has no branch for {selected:?}"));
                    self.run(body, now_ms);
                }
                What::Invoke(name, inputs) => {
                    self.invoke(name, inputs, now_ms);
                    self.covered.insert(*line);
                }
            }
        }
    }

    fn invoke(&mut self, name: &str, inputs: &[(String, Expression)], now_ms: i64) {
        let values: Vec<_> = inputs.iter().map(|(input, value)| (&input[..], self.value(value))).collect();
        match self.slots.get_mut(name) {
            Some(Slot::Timer(timer)) => {
                let [("IN", Value::Bool(runs)), ("PT", Value::Time(preset_ms))] = values[..] else {
                    panic!("{name}: {values:?}")
                };
                let since_ms = timer.since_ms.filter(|_| runs).or(runs.then_some(now_ms));
                let elapsed_ms = since_ms.map_or(0, |since| (now_ms - since).min(preset_ms));
                *timer = Timer { since_ms, elapsed_ms, preset_ms };
            }
            Some(Slot::Block(block)) => {
                for (input, value) in values {
                    let section = block.unit.variables.get(input).map(|variable| variable.section);
                    assert_eq!(section, Some(Section::Input), "{name}.{input}");
                    block.set(input, value);
                }
                block.scan(now_ms);
            }
            _ => panic!("{name} is not a function block"),
        }
    }

    fn read(&self, path: &[String]) -> Value {
        let [name, rest @ ..] = path else { panic!("no name") };
        match self.slots.get(name).unwrap_or_else(|| panic!("{} has no {name}", self.unit.name)) {
            Slot::Plain(value) if rest.is_empty() => *value,
            Slot::Timer(timer) if rest == ["ET"] => Value::Time(timer.elapsed_ms),
            Slot::Timer(timer) if rest == ["Q"] => {
                Value::Bool(timer.since_ms.is_some() && timer.elapsed_ms >= timer.preset_ms)
            }
            Slot::Block(block) => block.read(rest),
            _ => panic!("{name} has no {rest:?}"),
        }
    }

    fn truth(&self, expression: &Expression) -> bool {
        let Value::Bool(value) = self.value(expression) else { panic!("{expression:?} is not a BOOL") };
        value
    }

    fn value(&self, expression: &Expression) -> Value {
        match expression {
            Expression::Literal(value) => *value,
            Expression::Variable(path) => self.read(path),
            Expression::Not(inner) => Value::Bool(!self.truth(inner)),
            Expression::Both(operator, left, right) => combine(operator, self.value(left), self.value(right)),
            Expression::Call(name, arguments) => {
                let values: Vec<Value> = arguments.iter().map(|argument| self.value(argument)).collect();
                call(name, &values)
            }
        }
    }
}

fn combine(operator: &str, left: Value, right: Value) -> Value {
    let order = match (left, right) {
        (Value::Int(a), Value::Int(b)) | (Value::Time(a), Value::Time(b)) => Some(a.cmp(&b)),
        _ => None,
    };
    match (operator, left, right) {
        ("OR", Value::Bool(a), Value::Bool(b)) => Value::Bool(a | b),
        ("AND", Value::Bool(a), Value::Bool(b)) => Value::Bool(a & b),
        ("OR", Value::Bits(n, a), Value::Bits(m, b)) if n == m => Value::Bits(n, a | b),
        ("AND", Value::Bits(n, a), Value::Bits(m, b)) if n == m => Value::Bits(n, a & b),
        ("=", Value::Bits(n, a), Value::Bits(m, b)) if n == m => Value::Bool(a == b),
        ("<>", Value::Bits(n, a), Value::Bits(m, b)) if n == m => Value::Bool(a != b),
        ("=", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_eq())),
        ("<>", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_ne())),
        ("<", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_lt())),
        (">", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_gt())),
        ("<=", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_le())),
        (">=", ..) if order.is_some() => Value::Bool(order.is_some_and(|order| order.is_ge())),
        ("-", Value::Int(a), Value::Int(b)) => int(a - b),
        ("+", Value::Int(a), Value::Int(b)) => int(a + b),
        _ => panic!("{left:?} {operator} {right:?}"),
    }
}

/// Checks the range of INT: a PLC calculates with 16 bits here.
fn int(number: i64) -> Value {
    assert!(i16::try_from(number).is_ok(), "{number} is not an INT");
    Value::Int(number)
}

fn call(name: &str, values: &[Value]) -> Value {
    match (name, values) {
        ("ABS", [Value::Int(number)]) => int(number.abs()),
        ("SHL", [Value::Bits(bits, value), Value::Int(by)]) => {
            Value::Bits(*bits, (value << by) & ((1 << bits) - 1))
        }
        ("SHR", [Value::Bits(bits, value), Value::Int(by)]) => Value::Bits(*bits, value >> by),
        ("ROL", [Value::Bits(16, value), Value::Int(by)]) => {
            let by = u32::try_from(*by).unwrap();
            Value::Bits(16, u64::from((*value as u16).rotate_left(by)))
        }
        ("WORD_TO_BYTE", [Value::Bits(16, value)]) => Value::Bits(8, value & 0xFF),
        ("BYTE_TO_WORD", [Value::Bits(8, value)]) => Value::Bits(16, *value),
        ("WORD_TO_DWORD", [Value::Bits(16, value)]) => Value::Bits(32, *value),
        ("WORD_TO_INT", [Value::Bits(16, value)]) => Value::Int((*value as u16).cast_signed().into()),
        ("WORD_TO_UINT", [Value::Bits(16, value)]) => Value::Int(i64::try_from(*value).unwrap()),
        ("INT_TO_WORD" | "UINT_TO_WORD", [Value::Int(number)]) => Value::Bits(16, (*number as u64) & 0xFFFF),
        _ => panic!("{name}({values:?})"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(body: &str) -> Instance {
        let text = format!(
            "PROGRAM P VAR a : INT; b : BOOL; w : WORD; t : TIME; n : TON; s : INT := -3; END_VAR {body} END_PROGRAM"
        );
        let mut instance = Instance::new(&[Unit::parse(&text)], "P");
        instance.scan(0);
        instance
    }

    #[test]
    fn operators_bind_as_the_standard_has_it() {
        assert_eq!(run("b := 1 + 1 = 2 AND NOT FALSE OR 3 < 2;").get("b"), Value::Bool(true));
        assert_eq!(run("b := TRUE OR TRUE AND FALSE;").get("b"), Value::Bool(true));
        assert_eq!(run("b := (TRUE OR TRUE) AND FALSE;").get("b"), Value::Bool(false));
        assert_eq!(run("a := ABS(s - 4) - 2;").get("a"), Value::Int(5));
        assert_eq!(
            run("w := SHL(WORD#16#00FF, 12) OR ROL(WORD#16#1203, 8);").get("w"),
            Value::Bits(16, 0xF312)
        );
    }

    #[test]
    fn timer_counts_while_its_input_is_true() {
        let text = "PROGRAM P VAR on : BOOL; n : TON; END_VAR n(IN := on, PT := T#30MS); END_PROGRAM";
        let mut instance = Instance::new(&[Unit::parse(text)], "P");
        let mut at = |now_ms, on| {
            instance.set("on", Value::Bool(on));
            instance.scan(now_ms);
            (instance.get("n.Q"), instance.get("n.ET"))
        };
        assert_eq!(at(0, false), (Value::Bool(false), Value::Time(0)));
        assert_eq!(at(10, true), (Value::Bool(false), Value::Time(0)));
        assert_eq!(at(39, true), (Value::Bool(false), Value::Time(29)));
        assert_eq!(at(50, true), (Value::Bool(true), Value::Time(30)));
        assert_eq!(at(51, false), (Value::Bool(false), Value::Time(0)));
    }

    #[test]
    #[should_panic(expected = "does not accept")]
    fn bit_strings_and_numbers_do_not_mix() {
        run("w := 3;");
    }

    #[test]
    #[should_panic(expected = "expected a name with #")]
    fn scl_variable_without_its_mark_is_refused() {
        Unit::parse_scl(
            "FUNCTION_BLOCK \"P\" VERSION : 0.1 VAR a : INT; END_VAR BEGIN #a := a; END_FUNCTION_BLOCK",
        );
    }

    #[test]
    #[should_panic(expected = "is not an INT")]
    fn overflow_is_a_panic() {
        run("a := 32000 + 1000;");
    }
}
