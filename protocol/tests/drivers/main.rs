//! The drivers at the virtual gripper, in virtual time: one body for each behaviour, run over the binary protocol and over
//! GCL, blocking and async.

mod bench;
mod cancelled;
mod client;
mod only_gcl;
mod same;
