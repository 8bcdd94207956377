//! Requests and their command names, in any dialect.

use core::fmt::Debug;
use core::hash::Hash;

use crate::command::Kind;

/// The name of a command.
pub trait Name: Copy + PartialEq + Debug + Hash + 'static {
    /// Returns the kind of the command.
    fn kind(self) -> Kind;

    /// Returns whether the command can be sent twice with the same effect as once.
    fn is_repeatable(self) -> bool;
}

/// A request with its parameters, ready to be encoded.
pub trait Message: Copy + PartialEq + Debug + 'static {
    /// The names of the dialect's commands.
    type Name: Name;

    /// The request that ends a motion (22h, STOP).
    const STOP: Self;
    /// The FAST STOP request.
    const FAST_STOP: Self;

    /// Returns the command name of the request.
    fn name(&self) -> Self::Name;

    /// Returns whether the request can be sent twice with the same effect as once.
    fn is_repeatable(&self) -> bool;
}
