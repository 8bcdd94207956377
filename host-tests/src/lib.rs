//! The harness: the flashed image in an emulator, a virtual gripper on its line, a PLC on its wires.
//!
//! | module | holds |
//! |---|---|
//! | [`addresses`] | the bridge's registers by their names |
//! | [`mod@bench`] | a [`world`] whose PLC has wires alone |
//! | [`bxcan`] | the CAN controller of the STM32L4, by its manual |
//! | [`can_bench`] | bridge and virtual gripper on a CAN bus, with a controller that goes bus-off on command |
//! | [`can_bus`] | a CAN bus between that controller and others: arbitration, acknowledgement, faults |
//! | [`can_controller`] | what a bus asks of a CAN controller |
//! | [`can_hub`] | those on that bus besides the board: a gripper, a master |
//! | [`can_wire`] | a frame as it is on the wire of a CAN bus |
//! | [`clock`] | the time that those beside an emulated board go by |
//! | [`device_files`] | the names of the device files for PLCs, and of their bitmaps |
//! | [`emulator`] | the board in QEMU: inputs, outputs, lines, memory |
//! | [`chance`] | numbers that look random, the same ones for the same seed |
//! | [`mod@explore`] | every order of events, on the bridge as it is flashed |
//! | [`fault_sweep`] | every fault of a bit or a byte around a FAST STOP, and how long the gripper takes to stop |
//! | [`faulty_link`] | a line on which bytes go wrong, round any byte link |
//! | [`flash_controller`] | the flash interface of the STM32L4 on the settings' pages, by its manual |
//! | [`flash_model`] | the settings' flash for the library: two pages, and what goes wrong with them |
//! | [`flash_pages`] | what two pages of flash hold, and what a power cut leaves of them |
//! | [`fuzz_bodies`] | what must hold for any bytes at all |
//! | [`mod@example`] | where cargo puts an example |
//! | [`gdb`] | the client's side of the gdb remote protocol |
//! | [`gripper_end`] | the virtual gripper at the other end of the line, and what can be done to that line |
//! | [`iwdg`] | the watchdog of the STM32L4, and the flags of the last reset |
//! | [`line_errors`] | framing, parity, noise and overrun on a UART |
//! | [`load_store`] | loads and stores of Thumb-2, decoded |
//! | [`masters`] | third-party masters of Modbus and CANopen |
//! | [`mcp2515`] | the CAN controller behind SPI, by its data sheet |
//! | [`modbus_bench`] | a [`world`] with a Modbus master |
//! | [`modbus_master`] | a Modbus master on the board's bus, byte by byte |
//! | [`plc_names`] | flags, states and status codes, for the documents |
//! | [`profibus_bench`] | a [`world`] with a PROFIBUS master |
//! | [`registers`] | peripherals that QEMU lacks, served by models |
//! | [`rig`] | board, gripper and PLC together |
//! | [`serial_gripper`] | the virtual gripper behind a serial line in virtual time |
//! | [`service_bench`] | the bridge library and a virtual gripper, with the service port at the end of a stream |
//! | [`terminal`] | a pseudo terminal in front of the board's bus |
//! | [`trace`] | what happened, as a person reads it and as a test compares it |
//! | [`wires`] | what a PLC does with the wires of a bench |
//! | [`world`] | bridge library and virtual gripper in virtual time, for any bus of the PLC |
//!
//! The emulator needs QEMU and the image: `cargo xtask test` sets both up. On systems without Unix sockets the harness
//! is empty.

pub mod addresses;
pub mod bench;
pub mod bxcan;
pub mod can_bench;
#[cfg(unix)]
pub mod can_bus;
pub mod can_controller;
#[cfg(unix)]
pub mod can_hub;
pub mod can_wire;
pub mod chance;
pub mod clock;
pub mod device_files;
#[cfg(unix)]
pub mod emulator;
pub mod example;
pub mod explore;
pub mod extent;
pub mod fault_sweep;
pub mod faulty_link;
#[cfg(unix)]
pub mod flash_controller;
pub mod flash_model;
pub mod flash_pages;
pub mod fuzz_bodies;
#[cfg(unix)]
pub mod gdb;
#[cfg(unix)]
pub mod gripper_end;
mod gripper_states;
#[cfg(unix)]
pub mod iwdg;
#[cfg(unix)]
pub mod line_errors;
pub mod load_store;
pub mod masters;
#[cfg(unix)]
pub mod mcp2515;
pub mod modbus_bench;
#[cfg(unix)]
pub mod modbus_master;
pub mod plc_names;
pub mod profibus_bench;
#[cfg(unix)]
pub mod qtest;
#[cfg(unix)]
pub mod registers;
#[cfg(unix)]
pub mod rig;
pub mod rtu_double;
pub mod serial_gripper;
#[cfg(unix)]
pub mod service_bench;
#[cfg(unix)]
pub mod terminal;
pub mod trace;
pub mod wires;
pub mod world;

/// Compiles the example in the README.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
