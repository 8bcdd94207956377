//! The drivers with the virtual gripper in virtual time. Each behaviour has one test body for both protocols and both drivers.

mod cancelled;
mod client;
mod only_gcl;
mod rig;
mod same;
mod transports;
