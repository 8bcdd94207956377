//! Executes the grammar of docs/gcl.md with backtracking.

use std::collections::{BTreeMap, BTreeSet};

/// The rules of a grammar, by name.
#[derive(Debug, Default)]
pub(crate) struct Grammar(BTreeMap<String, Node>);

#[derive(Debug)]
enum Node {
    Literal(String),
    Rule(String),
    Sequence(Vec<Node>),
    Choice(Vec<Node>),
    Optional(Box<Node>),
    Repeated(Box<Node>),
}

impl Grammar {
    /// Adds the rules of a block.
    pub(crate) fn add(&mut self, block: &str) {
        let mut tokens = tokens(block).into_iter().peekable();
        while let Some(name) = tokens.next() {
            assert_eq!(tokens.next().as_deref(), Some("="), "rule {name}");
            let rule = choice(&mut tokens);
            assert_eq!(tokens.next().as_deref(), Some(";"), "rule {name}");
            assert!(self.0.insert(name.clone(), rule).is_none(), "{name} has two rules");
        }
    }

    /// Returns whether the rule derives the complete line.
    pub(crate) fn derives(&self, rule: &str, line: &str) -> bool {
        let line: Vec<char> = line.chars().collect();
        self.ends(&Node::Rule(rule.to_owned()), &line, 0).contains(&line.len())
    }

    /// Returns the possible ends of the node's derivations from `at`.
    fn ends(&self, node: &Node, line: &[char], at: usize) -> BTreeSet<usize> {
        let one = |fits: bool| if fits { BTreeSet::from([at + 1]) } else { BTreeSet::new() };
        match node {
            Node::Literal(text) => {
                let end = at + text.chars().count();
                let here: Option<String> = line.get(at..end).map(|chars| chars.iter().collect());
                here.filter(|here| here.eq_ignore_ascii_case(text)).map(|_| end).into_iter().collect()
            }
            Node::Rule(name) => match (self.0.get(name), line.get(at)) {
                (Some(rule), _) => self.ends(rule, line, at),
                (None, c) => match name.as_str() {
                    "letter" => one(c.is_some_and(char::is_ascii_alphabetic)),
                    "digit" => one(c.is_some_and(char::is_ascii_digit)),
                    "character" => one(c.is_some()),
                    _ => panic!("no rule {name}"),
                },
            },
            Node::Sequence(nodes) => nodes.iter().fold(BTreeSet::from([at]), |starts, node| {
                starts.into_iter().flat_map(|start| self.ends(node, line, start)).collect()
            }),
            Node::Choice(nodes) => nodes.iter().flat_map(|node| self.ends(node, line, at)).collect(),
            Node::Optional(node) => {
                let mut ends = self.ends(node, line, at);
                ends.insert(at);
                ends
            }
            Node::Repeated(node) => {
                let mut ends = BTreeSet::from([at]);
                let mut new = ends.clone();
                while !new.is_empty() {
                    let next: BTreeSet<usize> =
                        new.iter().flat_map(|start| self.ends(node, line, *start)).collect();
                    new = next.difference(&ends).copied().collect();
                    ends.extend(&new);
                }
                ends
            }
        }
    }
}

fn tokens(block: &str) -> Vec<String> {
    let mut tokens = vec![];
    let mut rest = block.trim_start();
    while let Some(first) = rest.chars().next() {
        let len = match first {
            '"' => rest[1..].find('"').expect("a quotation mark at the end") + 2,
            c if c.is_ascii_alphabetic() => {
                rest.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(rest.len())
            }
            _ => 1,
        };
        tokens.push(rest[..len].to_owned());
        rest = rest[len..].trim_start();
    }
    tokens
}

type Tokens = std::iter::Peekable<std::vec::IntoIter<String>>;

fn choice(tokens: &mut Tokens) -> Node {
    let mut nodes = vec![sequence(tokens)];
    while tokens.next_if_eq("|").is_some() {
        nodes.push(sequence(tokens));
    }
    Node::Choice(nodes)
}

fn sequence(tokens: &mut Tokens) -> Node {
    let mut nodes = vec![];
    while let Some(token) = tokens.next_if(|token| !["|", ")", "]", "}", ";"].contains(&token.as_str())) {
        let (node, end) = match token.as_str() {
            "(" => (choice(tokens), ")"),
            "[" => (Node::Optional(Box::new(choice(tokens))), "]"),
            "{" => (Node::Repeated(Box::new(choice(tokens))), "}"),
            text if text.starts_with('"') => {
                // In a literal, `'` represents the quotation mark.
                (Node::Literal(text.trim_matches('"').replace('\'', "\"")), "")
            }
            name => (Node::Rule(name.to_owned()), ""),
        };
        if !end.is_empty() {
            assert_eq!(tokens.next().as_deref(), Some(end), "unbalanced bracket");
        }
        nodes.push(node);
    }
    Node::Sequence(nodes)
}
