//! Breadth-first search over every order of actions. Equal states are visited once.
//!
//! The frontier holds paths of actions, not states: 8 bytes each instead of two thousand, so 10^8 states fit into memory. It
//! keeps the order of a depth-first walk: a state is rebuilt from the last common ancestor with its neighbour, which takes
//! little more than one action. `stateright` 0.31 holds each pending state and its path on the heap.

use std::collections::HashSet;
use std::fmt::Debug;
use std::hash::{BuildHasherDefault, Hasher};

use super::Bounds;

/// A state that can be explored.
pub(super) trait Model: Clone {
    /// A promise that can be broken.
    type Promise: Copy + Debug + Eq;

    /// The actions that are possible, one bit each.
    fn actions(&self) -> u32;

    /// Takes an action. The error is the promise that it breaks.
    fn act(&mut self, action: u32) -> Result<(), Self::Promise>;

    /// A number that is the same for equal states, and different for all others.
    fn key(&self) -> u64;

    /// The noteworthy situations in this state, one bit each.
    fn sights(&self) -> u64;
}

/// A root and the actions from there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path(u64);

const ACTION_BITS: u32 = 5;
const ROOT_BITS: u32 = 4;

impl Path {
    /// The most actions.
    const MAX_LEN: u32 = (u64::BITS - ROOT_BITS) / ACTION_BITS;
    /// The most roots.
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

    /// The number of the root.
    pub(super) const fn root(self) -> usize {
        (self.0 >> (u64::BITS - ROOT_BITS)) as usize
    }

    /// The action at this step.
    pub(super) const fn action(self, step: u32) -> u32 {
        (self.0 >> Self::shift(step)) as u32 & ((1 << ACTION_BITS) - 1)
    }

    /// How many actions both begin with; none for different roots.
    const fn common(self, other: Self) -> Option<u32> {
        let same = (self.0 ^ other.0).leading_zeros();
        match same.checked_sub(ROOT_BITS) {
            None => None,
            Some(bits) => Some(bits / ACTION_BITS),
        }
    }
}

/// A broken promise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Broken<P> {
    pub(super) promise: P,
    /// The fewest actions that break it.
    pub(super) path: Path,
    /// How many these are.
    pub(super) len: u32,
    /// How often it was broken.
    pub(super) ways: u64,
}

/// What a search met.
#[derive(Clone, Debug)]
pub(super) struct Outcome<P> {
    /// Different states, the roots among them.
    pub(super) states: u64,
    /// Actions that were tried.
    pub(super) tried: u64,
    /// New states at each depth. The last depth is incomplete if the bound of states ended the search.
    pub(super) new_at: Vec<u64>,
    /// The depth up to which every state was met.
    pub(super) complete_to: u32,
    /// Every broken promise, the one with the shortest path first.
    pub(super) broken: Vec<Broken<P>>,
    /// The situations of all states.
    pub(super) sights: u64,
}

/// Searches from all roots at the same time. It does not go on from where a promise is broken.
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
                again.expect("what was done once can be done again");
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

/// Keys are hashes already.
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

    /// A number below 100 that goes up by 1 or doubles, and must not be 7.
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
    fn every_state_is_met_once_and_the_shortest_way_to_break_a_promise_is_told() {
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
