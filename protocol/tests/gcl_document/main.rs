//! Checks docs/gcl.md: its grammar, its tables and its conversations.

mod grammar;
#[path = "../gcl/strategies.rs"]
#[allow(dead_code, reason = "each test file uses a part of it")]
mod strategies;

use crate::grammar::Grammar;
use crate::strategies::{answer, mutated, numbers, request, texts};
use document::{hold, read};
use proptest::prelude::*;
use std::sync::LazyLock;
use wsg_protocol::gcl::{Answer, CommandName, ParseError, Request};

const DOCUMENT: &str = "docs/gcl.md";

static GRAMMAR: LazyLock<Grammar> = LazyLock::new(|| {
    let mut grammar = Grammar::default();
    blocks("grammar").iter().for_each(|block| grammar.add(block));
    grammar
});

/// Returns the code blocks in this language.
fn blocks(language: &str) -> Vec<String> {
    let text = read(DOCUMENT);
    let blocks = text.split("```").skip(1).step_by(2);
    let ours = blocks.filter_map(|block| block.strip_prefix(language)?.strip_prefix('\n'));
    ours.map(str::to_owned).collect()
}

fn code(texts: impl IntoIterator<Item = String>) -> String {
    texts.into_iter().map(|text| format!("`{text}`")).collect::<Vec<_>>().join(", ")
}

#[test]
fn generated_parts_are_those_of_the_table_and_of_the_mistakes() {
    let mut commands = String::from("| request | answer | manual |\n|---|---|---|\n");
    for name in CommandName::ALL {
        let with_name = |form: &&str| format!("{name}{form}");
        let requests = code(name.forms().iter().map(with_name));
        let answers = match (name.is_acknowledged(), name.is_finished()) {
            (true, true) => code([format!("ACK {name}"), format!("FIN {name}")]),
            (true, false) => code([format!("ACK {name}")]),
            _ => code(name.value_forms().iter().map(with_name)),
        };
        commands.push_str(&format!("| {requests} | {answers} | {} |\n", name.section()));
    }
    hold(DOCUMENT, "commands", &commands);

    let mut mistakes = String::from("| error | status code |\n|---|---|\n");
    for mistake in [
        ParseError::NoName,
        ParseError::UnknownName,
        ParseError::Form,
        ParseError::TooFew,
        ParseError::TooMany,
        ParseError::Range,
        ParseError::Value,
        ParseError::Index,
        ParseError::TooLong,
    ] {
        let status = mistake.status();
        mistakes.push_str(&format!("| {mistake} | {} {status} |\n", status.code()));
    }
    hold(DOCUMENT, "mistakes", &mistakes);
}

#[test]
fn conversations_are_made_of_requests_and_their_answers() {
    let blocks = blocks("gcl");
    assert!(blocks.len() > 4);
    let mut seen = vec![];
    for block in &blocks {
        let mut asked: Vec<&str> = vec![];
        for line in block.lines() {
            let (mark, line) = line.split_at(2);
            if mark == "> " {
                asked.push(line);
                continue;
            }
            assert_eq!(mark, "< ");
            let answer = Answer::parse(line.as_bytes()).unwrap_or_else(|mistake| panic!("{line}: {mistake}"));
            assert_eq!(answer.to_string(), line);
            assert!(GRAMMAR.derives("answer", line), "{line}");
            let last = *asked.last().expect("a question before the answer");
            match Request::parse(last.as_bytes()) {
                Err(refused) => assert_eq!(refused.answer(false), answer, "{last}"),
                Ok(request) => {
                    seen.push(request.name());
                    let answers = |asked: &&str| {
                        Request::parse(asked.as_bytes())
                            .is_ok_and(|request| Some(request.name()) == answer.name().command())
                    };
                    let is_update = matches!(answer, Answer::Update(_));
                    assert!(is_update || asked.iter().any(answers), "{last} {line}");
                }
            }
        }
    }
    for name in CommandName::ALL {
        let unsaid = [CommandName::Clt, CommandName::Speed, CommandName::Force];
        assert!(seen.contains(name) || unsaid.contains(name), "{DOCUMENT} shows no {name}");
    }
}

#[test]
fn longest_request_is_as_long_as_the_document_says() {
    assert!(read(DOCUMENT).contains(&format!("at most\n  {} bytes", Request::MAX_LEN)));
}

/// Removes blanks outside texts.
fn without_blanks(line: &str) -> String {
    let mut inside = false;
    line.chars()
        .filter(|c| {
            inside ^= *c == '"';
            inside || !matches!(c, ' ' | '\t')
        })
        .collect()
}

proptest! {
    #[test]
    fn every_request_is_derived_by_the_grammar(request in request()) {
        let line = request.to_string();
        prop_assert!(GRAMMAR.derives("request", &line), "{}", line);
    }

    #[test]
    fn every_answer_is_derived_by_the_grammar(texts in texts(), kind in any::<u8>(), numbers in numbers()) {
        let line = answer(&texts, kind, numbers).to_string();
        prop_assert!(GRAMMAR.derives("answer", &line), "{}", line);
    }

    #[test]
    fn grammar_and_parser_agree_on_requests(
        line in request().prop_flat_map(|request| mutated(request.to_string())),
    ) {
        let Ok(text) = String::from_utf8(line) else { return Ok(()) };
        // The grammar does not cover blanks inside a word or around a text.
        let is_told = !text.contains([' ', '\t']) && text.trim_ascii().len() == text.len();
        let is_derived = GRAMMAR.derives("request", &without_blanks(&text));
        match Request::parse(text.as_bytes()) {
            Ok(_) => prop_assert!(is_derived || !is_told, "understood: {}", text),
            Err(refused) => {
                let is_of_value = matches!(refused.mistake, ParseError::Range | ParseError::Value | ParseError::Index);
                prop_assert!(!is_derived || is_of_value || !is_told, "{}: {}", refused, text);
            }
        }
    }
}
