//! docs/grip-cycle.md: the messages of a grip cycle, recorded in virtual time.

mod canopen;
mod image;
mod modbus;

const DOCUMENT: &str = "docs/grip-cycle.md";
