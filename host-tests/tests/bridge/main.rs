//! The library of the bridge in virtual time, with a PLC and a virtual gripper: what each PLC side and each gripper line does.
//!
//! `cargo xtask mutants` runs these tests against `bridge-fw`.

mod canopen;
mod causes;
mod events;
mod gripper_on_can;
mod indicator;
mod modbus;
mod outputs;
mod profibus;
mod profibus_master;
mod service_port;
mod settings;
mod station;
mod storage;
mod wires;
