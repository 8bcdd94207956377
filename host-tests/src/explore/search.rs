//! Breadth-first search over every order of actions. Equal states are visited once.
//!
//! The frontier stores paths of actions of 8 bytes each, instead of states of about 2 kB, so 10^8 states fit into
//! memory. It keeps depth-first order: a state is rebuilt from the last common ancestor with its neighbour, at the
//! cost of little more than one action. `stateright` 0.31 keeps each pending state and its path on the heap.

use std::collections::HashSet;
use std::fmt::Debug;
use std::hash::{BuildHasherDefault, Hasher};

use super::Bounds;

/// A model that can be explored.
pub(super) trait Model: Clone {
    /// A property that must hold.
    type Promise: Copy + Debug + Eq;

    /// Returns the possible actions, one bit each.
    fn actions(&self) -> u32;

    /// Performs an action; fails with the promise that it breaks.
    fn act(&mut self, action: u32) -> Result<(), Self::Promise>;

    /// Returns a number that is equal for equal states and differs for all others.
    fn key(&self) -> u64;

    /// Returns the notable situations in this state, one bit each.
    fn sights(&self) -> u64;
}

/// A root and the actions from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path(u64);

const ACTION_BITS: u32 = 5;
const ROOT_BITS: u32 = 4;

impl Path {
    /// Maximum number of actions.
    const MAX_LEN: u32 = (u64::BITS - ROOT_BITS) / ACTION_BITS;
    /// Maximum number of roots.
    const MAX_ROOTS: usize = 1 << ROOT_BITS;

    const fn from(root: usize) -> Self {
        Self((root as u64) << (u64::BITS - ROOT_BITS))
    }

    const fn shift(step: u32) -> u32 {
        u64::BITS - ROOT_BITS - ACTION_BITS * (step + 1)
    }

    const fn then(self, step: u32, action: u32) -> Self {
        Self(self.0 | (action as u64) << Self::shift(step))
    }

    /// Returns the index of the root.
    pub(super) const fn root(self) -> usize {
        (self.0 >> (u64::BITS - ROOT_BITS)) as usize
    }

    /// Returns the action at this step.
    pub(super) const fn action(self, step: u32) -> u32 {
        (self.0 >> Self::shift(step)) as u32 & ((1 << ACTION_BITS) - 1)
    }

    /// Returns the number of common initial actions; `None` for different roots.
    const fn common(self, other: Self) -> Option<u32> {
        let same = (self.0 ^ other.0).leading_zeros();
        match same.checked_sub(ROOT_BITS) {
            None => None,
            Some(bits) => Some(bits / ACTION_BITS),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Broken<P> {
    pub(super) promise: P,
    /// Shortest sequence of actions that breaks it.
    pub(super) path: Path,
    /// Length of `path` in actions.
    pub(super) len: u32,
    /// Number of times it was broken.
    pub(super) ways: u64,
}

/// Result of a search.
#[derive(Clone, Debug)]
pub(super) struct Outcome<P> {
    /// Number of distinct states, including the roots.
    pub(super) states: u64,
    /// Number of actions tried.
    pub(super) tried: u64,
    /// New states at each depth. The last depth is incomplete if the state limit ended the search.
    pub(super) new_at: Vec<u64>,
    /// Depth up to which all states were visited.
    pub(super) complete_to: u32,
    /// Broken promises in order of path length.
    pub(super) broken: Vec<Broken<P>>,
    /// Situations encountered, one bit each.
    pub(super) sights: u64,
}

/// Searches from all roots at the same time. Does not continue after a broken promise.
pub(super) fn explore<M: Model>(roots: &[M], bounds: Bounds) -> Outcome<M::Promise> {
    assert!(roots.len() <= Path::MAX_ROOTS && bounds.depth <= Path::MAX_LEN);
    let mut met = KeySet::default();
    let mut outcome =
        Outcome { states: 0, tried: 0, new_at: Vec::new(), complete_to: 0, broken: Vec::new(), sights: 0 };
    let mut frontier = Vec::new();
    for (number, root) in roots.iter().enumerate() {
        outcome.sights |= root.sights();
        if met.insert(root.key()) {
            frontier.push(Path::from(number));
        }
    }
    outcome.states = frontier.len() as u64;
    outcome.new_at.push(outcome.states);
    for depth in 0..bounds.depth {
        let is_last = depth + 1 == bounds.depth;
        let before = outcome.states;
        let mut next = Vec::new();
        let mut ancestors: Vec<M> = Vec::new();
        let mut last = None;
        for path in frontier {
            let common = last.replace(path).and_then(|last| path.common(last));
            ancestors.truncate(common.map_or(0, |common| common as usize + 1));
            if ancestors.is_empty() {
                ancestors.push(roots[path.root()].clone());
            }
            for step in ancestors.len() as u32 - 1..depth {
                let mut state = ancestors[step as usize].clone();
                let again = state.act(path.action(step));
                again.expect("a successful action can be repeated");
                ancestors.push(state);
            }
            let state = &ancestors[depth as usize];
            let mut actions = state.actions();
            while actions != 0 {
                let action = actions.trailing_zeros();
                actions &= actions - 1;
                outcome.tried += 1;
                let mut child = state.clone();
                if let Err(promise) = child.act(action) {
                    note(&mut outcome.broken, promise, path.then(depth, action), depth + 1);
                } else if met.insert(child.key()) {
                    outcome.states += 1;
                    outcome.sights |= child.sights();
                    if !is_last {
                        next.push(path.then(depth, action));
                    }
                }
            }
            if outcome.states >= bounds.states {
                outcome.new_at.push(outcome.states - before);
                return outcome;
            }
        }
        outcome.new_at.push(outcome.states - before);
        outcome.complete_to = depth + 1;
        frontier = next;
    }
    outcome
}

fn note<P: Copy + Eq>(broken: &mut Vec<Broken<P>>, promise: P, path: Path, len: u32) {
    match broken.iter_mut().find(|broken| broken.promise == promise) {
        Some(known) => known.ways += 1,
        None => broken.push(Broken { promise, path, len, ways: 1 }),
    }
}

/// Hasher for keys, which are already hashes.
#[derive(Default)]
struct KeyOnly(u64);

type KeySet = HashSet<u64, BuildHasherDefault<KeyOnly>>;

impl Hasher for KeyOnly {
    fn write(&mut self, _: &[u8]) {
        unreachable!("keys are u64");
    }

    fn write_u64(&mut self, key: u64) {
        self.0 = key;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test model: a number below 100 that is incremented or doubled and must not become 7.
    #[derive(Clone)]
    struct Number(u64);

    impl Model for Number {
        type Promise = &'static str;

        fn actions(&self) -> u32 {
            if self.0 < 50 { 0b11 } else { 0b01 }
        }

        fn act(&mut self, action: u32) -> Result<(), &'static str> {
            self.0 = if action == 0 { (self.0 + 1) % 100 } else { self.0 * 2 };
            if self.0 == 7 { Err("not 7") } else { Ok(()) }
        }

        fn key(&self) -> u64 {
            self.0.wrapping_mul(0x9E37_79B9_7F4A_7C15)
        }

        fn sights(&self) -> u64 {
            u64::from(self.0 == 64)
        }
    }

    #[test]
    fn search_visits_each_state_once_and_finds_shortest_violation() {
        let outcome = explore(&[Number(1)], Bounds { depth: 12, states: 1_000 });
        // 1; 2; 3, 4; 6, 5, 8; ...
        assert_eq!(outcome.new_at[..4], [1, 1, 2, 3]);
        assert_eq!(outcome.complete_to, 12);
        assert_eq!(outcome.states, outcome.new_at.iter().sum::<u64>());
        assert_eq!(outcome.sights, 1);
        let [broken] = outcome.broken[..] else { panic!("{:?}", outcome.broken) };
        assert_eq!((broken.promise, broken.len, broken.ways), ("not 7", 4, 1));
        let actions: Vec<_> = (0..broken.len).map(|step| broken.path.action(step)).collect();
        let mut number = Number(1);
        assert!(actions[..3].iter().all(|action| number.act(*action).is_ok()));
        assert_eq!(number.act(actions[3]), Err("not 7"));
    }

    #[test]
    fn roots_are_explored_together() {
        let outcome = explore(&[Number(10), Number(11), Number(10)], Bounds { depth: 1, states: 1_000 });
        assert_eq!(outcome.new_at, [2, 3], "11 is met already; 20, 12 and 22 are new");
    }

    #[test]
    fn bound_of_states_ends_it() {
        let outcome = explore(&[Number(1)], Bounds { depth: 12, states: 10 });
        assert!(outcome.complete_to < 12 && (10..13).contains(&outcome.states), "{outcome:?}");
    }
}
