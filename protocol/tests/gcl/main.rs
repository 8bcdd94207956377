//! The Gripper Control Language (GCL): the manual's lines, every value in both directions, and invalid lines.

mod hostile;
mod manual;
mod names;
mod round_trip;
mod split;
mod strategies;
