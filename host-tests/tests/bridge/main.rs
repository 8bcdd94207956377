//! Tests of the bridge library in virtual time, with a PLC and a virtual gripper, for each PLC side and each gripper line.
//!
//! `cargo xtask mutants` runs these tests against `bridge-fw`.

mod canopen;
mod causes;
mod events;
mod every_bus;
mod gripper_on_can;
mod indicator;
mod mcp2515;
mod modbus;
mod outputs;
mod profibus;
mod service_port;
mod settings;
mod station;
mod storage;
mod update;
mod wires;
