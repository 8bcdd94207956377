//! The deepest call path.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, bail};

use super::calls::Program;

/// A call path and its stack use.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// Bytes of stack.
    pub bytes: u64,
    /// The functions, outermost first, each with its frame.
    pub path: Vec<String>,
}

/// Result of the walk.
#[derive(Debug)]
pub struct Deepest {
    /// Deepest path from Reset.
    pub program: Path,
    /// Deepest path of each handler.
    pub handlers: Vec<Path>,
    /// Functions with indirect calls.
    pub indirect: BTreeSet<String>,
}

impl Program {
    /// Walks all paths from Reset and from each handler.
    ///
    /// # Errors
    /// Fails when a function calls itself directly or indirectly, because its stack is unbounded, and when a function sets the
    /// stack pointer in a way that is not understood.
    pub fn deepest(&self) -> Result<Deepest> {
        let mut walk = Walk { program: self, known: BTreeMap::new(), open: Vec::new() };
        let deepest = walk.from(self.reset)?;
        let handlers = self.handlers.iter().map(|handler| walk.from(*handler)).collect::<Result<Vec<_>>>()?;
        let reached = walk.known.keys().filter_map(|address| self.functions.get(address));
        let indirect = reached.filter(|it| it.is_indirect).map(|it| it.name.clone()).collect();
        Ok(Deepest { program: deepest, handlers, indirect })
    }
}

struct Walk<'a> {
    program: &'a Program,
    known: BTreeMap<u32, Path>,
    open: Vec<u32>,
}

impl Walk<'_> {
    fn from(&mut self, address: u32) -> Result<Path> {
        if let Some(known) = self.known.get(&address) {
            return Ok(known.clone());
        }
        let Some(function) = self.program.functions.get(&address) else {
            bail!("code at {address:#x} is not in any function")
        };
        if self.open.contains(&address) {
            bail!("{} calls itself directly or indirectly: its stack has no bound", function.name);
        }
        self.open.push(address);
        let mut below = Path::default();
        let anything = if function.is_indirect { self.program.taken.clone() } else { BTreeSet::new() };
        for callee in function.calls.union(&anything) {
            let path = self.from(*callee)?;
            if path.bytes >= below.bytes {
                below = path;
            }
        }
        self.open.pop();
        let what_failed = || format!("{} sets the stack pointer; its frame is unknown", function.name);
        let frame = function.frame.with_context(what_failed)?;
        let mut path = vec![format!("{} ({frame} B)", function.name)];
        path.extend(below.path);
        let deepest = Path { bytes: frame + below.bytes, path };
        self.known.insert(address, deepest.clone());
        Ok(deepest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calls::Function;

    fn function(name: &str, frame: u64, calls: &[u32]) -> Function {
        Function {
            name: name.into(),
            frame: Some(frame),
            calls: calls.iter().copied().collect(),
            ..Function::default()
        }
    }

    fn program(functions: Vec<(u32, Function)>) -> Program {
        let functions = functions.into_iter().collect();
        Program { functions, reset: 1, handlers: BTreeSet::from([9]), ..Program::default() }
    }

    #[test]
    fn the_deepest_path_counts_and_handlers_are_apart() {
        let functions = vec![
            (1, function("reset", 8, &[2, 3])),
            (2, function("shallow", 100, &[])),
            (3, function("deep", 60, &[4])),
            (4, function("deeper", 50, &[])),
            (9, function("handler", 16, &[])),
        ];

        let deepest = program(functions).deepest().unwrap();

        assert_eq!(deepest.program.bytes, 118);
        assert_eq!(deepest.program.path, ["reset (8 B)", "deep (60 B)", "deeper (50 B)"]);
        assert_eq!(deepest.handlers.iter().map(|it| it.bytes).collect::<Vec<_>>(), [16]);
    }

    #[test]
    fn recursion_has_no_bound() {
        let functions =
            vec![(1, function("one", 8, &[2])), (2, function("two", 8, &[1])), (9, function("h", 0, &[]))];

        assert!(program(functions).deepest().unwrap_err().to_string().contains("no bound"));
    }

    #[test]
    fn indirect_call_may_reach_any_function_whose_address_is_taken() {
        let mut caller = function("caller", 8, &[]);
        caller.is_indirect = true;
        let mut program = program(vec![
            (1, caller),
            (2, function("taken", 300, &[])),
            (3, function("never", 900, &[])),
            (9, function("h", 0, &[])),
        ]);
        program.taken = BTreeSet::from([2]);

        let deepest = program.deepest().unwrap();

        assert_eq!(deepest.program.bytes, 308);
        assert_eq!(deepest.indirect, BTreeSet::from(["caller".to_owned()]));
    }

    #[test]
    fn a_frame_that_the_code_does_not_show_fails_the_walk() {
        let mut odd = function("odd", 0, &[]);
        odd.frame = None;

        let printed = program(vec![(1, odd), (9, function("h", 0, &[]))]).deepest().unwrap_err().to_string();

        assert!(printed.contains("odd sets the stack pointer"), "{printed}");
    }
}
