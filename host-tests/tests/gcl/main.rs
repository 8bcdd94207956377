//! docs/gcl.md: what it says of the Gripper Control Language (GCL) holds, and its conversation can be typed. The language
//! itself is tested in the protocol crate.

mod by_hand;
mod document;
mod grammar;
#[path = "../../../protocol/tests/gcl/strategies.rs"]
mod strategies;
