//! Test harness: the released firmware image in an emulator, a virtual gripper on its serial line, and a PLC on its
//! wires.
//!
//! | module | content |
//! |---|---|
//! | [`addresses`] | register addresses of the bridge, by name |
//! | [`board_wiring`] | the pins of each board, for the documents, and the picture of them |
//! | [`bxcan`] | model of the STM32L4's CAN controller, per its manual |
//! | [`can_bus`] | model of a CAN bus: arbitration, acknowledgement, faults |
//! | [`can_controller`] | interface between a CAN bus and a controller model |
//! | [`can_hub`] | other participants on that bus: a gripper, a master |
//! | [`can_wire`] | bit-level encoding of a CAN frame |
//! | [`clock`] | clock that peers of an emulated board follow |
//! | [`device_files`] | file names of the PLC device descriptions and their bitmaps |
//! | [`emulator`] | the emulated board: inputs, outputs, lines, memory |
//! | [`ethernetip`] | an EtherNet/IP scanner, and what it requires of an adapter |
//! | [`chance`] | pseudo-random numbers, reproducible by seed |
//! | [`mod@explore`] | exhaustive exploration of event orders on the released bridge code |
//! | [`fault_sweep`] | every bit and byte fault around a FAST STOP, and the resulting stopping time |
//! | [`fdcan`] | model of the STM32G474's CAN controller, per its manual |
//! | [`faulty_link`] | fault injection for any byte link |
//! | [`flash_controller`] | model of the STM32L4's flash interface on the settings pages, per its manual |
//! | [`flash_model`] | the settings flash for the library: two pages and their faults |
//! | [`slot_flash`] | a board's flash for the boot loader, observed at each operation |
//! | [`flash_pages`] | contents of two flash pages, also after a power failure |
//! | [`fuzz_bodies`] | properties that must hold for any input bytes |
//! | [`mod@example`] | location of compiled examples; processes that end with their owner |
//! | [`gateway`] | `wsg gateway` as a process, with its address |
//! | [`gdb`] | client of the GDB remote protocol |
//! | [`gripper_end`] | the virtual gripper on an emulated board's line, with line faults |
//! | [`gripping_cycle`] | the demo cycle of the fieldbus manual, scan by scan |
//! | [`iwdg`] | model of the STM32L4's watchdog and reset flags |
//! | [`line_errors`] | framing, parity, noise and overrun errors on a UART |
//! | [`load_store`] | decoder for Thumb-2 loads and stores |
//! | [`masters`] | third-party masters for Modbus and CANopen |
//! | [`mcp2515`] | model of the SPI CAN controller, per its data sheet |
//! | [`modbus_master`] | a Modbus master on the emulated board's bus, byte by byte |
//! | [`modbus_tcp`] | a master of Modbus/TCP |
//! | `namespaces` | network namespaces with cables between them, on Linux |
//! | [`operation`] | what can happen around a bridge, as one type |
//! | [`plc_names`] | names of flags, states and status codes, for the documents |
//! | `promises` | the promises of the bridge, judged from outside |
//! | [`registers`] | models of peripherals that QEMU lacks |
//! | [`rig`] | board, gripper and PLC together |
//! | [`serial_gripper`] | the virtual gripper on a serial line in virtual time |
//! | [`station_promises`] | the promises of the bridge, judged on the station of the web page |
//! | [`terminal`] | a pseudo-terminal connected to the board's bus |
//! | [`trace`] | event recording, readable by people and comparable by tests |
//! | [`world`] | the whole bridge, its lines, a virtual gripper and a PLC, in virtual time |
//!
//! The emulators require their programs and the image (`cargo xtask test` provides both), and a system with Unix sockets.

pub mod addresses;
pub mod board_wiring;
pub mod bxcan;
pub mod can_bus;
pub mod can_controller;
pub mod can_hub;
pub mod can_wire;
pub mod chance;
pub mod clock;
pub mod device_files;
pub mod emulator;
pub mod ethernetip;
pub mod example;
pub mod explore;
pub mod extent;
pub mod fault_sweep;
pub mod faulty_link;
pub mod fdcan;
pub mod flash_controller;
pub mod flash_model;
pub mod flash_pages;
pub mod fuzz_bodies;
pub mod gateway;
pub mod gdb;
pub mod gripper_end;
mod gripper_states;
pub mod gripping_cycle;
pub mod iwdg;
pub mod line_errors;
pub mod load_store;
pub mod masters;
pub mod mcp2515;
pub mod modbus_master;
pub mod modbus_tcp;
#[cfg(target_os = "linux")]
pub mod namespaces;
pub mod operation;
pub mod plc_names;
mod promises;
pub mod qtest;
pub mod registers;
pub mod rig;
pub mod rtu_double;
pub mod serial_gripper;
pub mod slot_flash;
pub mod slot_model;
pub mod socket;
pub mod station_promises;
#[cfg(unix)]
pub mod terminal;
pub mod trace;
pub mod world;

/// Compiles the example in the README.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
