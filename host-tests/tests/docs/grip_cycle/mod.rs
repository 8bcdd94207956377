//! docs/grip-cycle.md: the messages of a grip cycle, recorded in virtual time.

mod canopen;
mod image;
mod modbus;
mod states;

const DOCUMENT: &str = "docs/grip-cycle.md";
