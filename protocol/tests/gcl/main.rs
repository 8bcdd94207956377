//! The Gripper Control Language (GCL): the manual's lines, every value both ways, and lines that are none.

mod hostile;
mod manual;
mod names;
mod round_trip;
mod split;
mod strategies;
