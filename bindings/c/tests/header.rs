//! `include/wsg.h` is what cbindgen and the protocol's tables give, and every compiler accepts it.

mod shared;

use std::fmt::Write as _;

use shared::Header;
use wsg_protocol::{CommandId, FingerFlags, GripperState, Status, SystemFlags};

const HEADER: Header = Header { name: "wsg", folder: env!("CARGO_MANIFEST_DIR") };

/// `GetFinger1Info` as `GET_FINGER1_INFO`.
fn screaming(name: &str) -> String {
    let is_word = |at: usize, letter: char| at > 0 && letter.is_uppercase();
    let letters = name
        .char_indices()
        .flat_map(|(at, letter)| is_word(at, letter).then_some('_').into_iter().chain(letter.to_uppercase()));
    letters.collect()
}

/// An enumeration of constants, with a comment for each.
fn constants(name: &str, about: &str, rows: impl Iterator<Item = (String, String, String)>) -> String {
    let mut text = format!("/* {about} */\nenum {name} {{\n");
    for (name, value, comment) in rows {
        writeln!(text, "    /* {comment} */\n    WSG_{name} = {value},").unwrap();
    }
    // C89 has no comma after the last enumerator.
    text.truncate(text.len() - 2);
    text + "\n};\n"
}

/// The parts that cbindgen cannot see, from the protocol's tables.
fn tables() -> String {
    let statuses = Status::ALL
        .iter()
        .map(|status| (status.symbol().to_owned(), status.code().to_string(), status.meaning().to_owned()));
    let commands = CommandId::ALL.iter().map(|id| {
        let name = format!("COMMAND_{}", screaming(&format!("{id:?}")));
        (name, format!("0x{:02X}", id.code()), format!("{} ({})", id.name(), id.section()))
    });
    let states = GripperState::ALL.iter().map(|state| {
        let name = format!("STATE_{}", screaming(&format!("{state:?}")));
        (name, state.code().to_string(), state.to_string())
    });
    let bits = |prefix: &'static str, names: Vec<(&'static str, u32)>| {
        names.into_iter().map(move |(name, bits)| {
            let value = format!("0x{bits:06X}");
            (format!("{prefix}{name}"), value, format!("D{}", bits.trailing_zeros()))
        })
    };
    let system = SystemFlags::all().iter_names().map(|(name, flag)| (name, flag.bits())).collect();
    let finger = FingerFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into())).collect();
    [
        constants("wsg_status", "Status codes (command set, appendix A).", statuses),
        constants("wsg_command", "Commands (command set, chapter 3).", commands),
        constants("wsg_state", "Gripper states (command set, appendix C).", states),
        constants("wsg_flag", "System state flags (command set, appendix B).", bits("FLAG_", system)),
        constants("wsg_finger_flag", "Finger flags (command set, 3.6.2).", bits("FINGER_FLAG_", finger)),
    ]
    .join("\n")
}

fn preamble() -> String {
    let words: String = [
        ("WORDS", wsg::session::WSG_WORDS, [80, 104]),
        ("PARSER_WORDS", wsg::frame::WSG_PARSER_WORDS, [11, 11]),
        ("CAN_WORDS", wsg::can::WSG_CAN_WORDS, [16, 16]),
        ("FIELDBUS_WORDS", wsg::fieldbus::WSG_FIELDBUS_WORDS, [32, 40]),
    ]
    .into_iter()
    .map(|(name, here, [on_32_bits, on_64_bits])| {
        assert_eq!(here, if cfg!(target_pointer_width = "64") { on_64_bits } else { on_32_bits }, "{name}");
        if on_32_bits == on_64_bits {
            return format!("#define WSG_{name} {here}\n");
        }
        format!("#define WSG_{name} (UINTPTR_MAX > 0xFFFFFFFFu ? {on_64_bits} : {on_32_bits})\n")
    })
    .collect();
    let [major, minor, patch] =
        [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")];
    format!(
        "\
/*
 * libwsg: the session with a Weiss Robotics WSG gripper.
 *
 * No heap, no clock, no I/O: the caller owns storage, bytes and time. In a main loop:
 *
 *     wsg_receive(&wsg, now_ms, bytes, length);      received bytes; events go to the callback
 *     wsg_tick(&wsg, now_ms);                        time-outs; events go to the callback
 *     while ((length = wsg_transmit(&wsg, now_ms, buffer, sizeof buffer)) > 0)
 *         send(buffer, length);                      all of them, in order
 *
 * now_ms is any millisecond counter, which may wrap. Requests such as wsg_grip_part() return at once; their outcome is an event.
 *
 * Rules for all functions:
 * - A pointer is null or points to an object of its type, or to an array of the length passed with it.
 * - An object is used by one thread or interrupt at a time. The library has no global state.
 * - Functions that return int32_t return a negative WSG_ERROR_... code on error.
 *
 * Generated from the crate wsg-c: do not edit.
 */
#include <stddef.h>
#include <stdint.h>

#define WSG_VERSION_MAJOR {major}
#define WSG_VERSION_MINOR {minor}
#define WSG_VERSION_PATCH {patch}

/* Changes when a program must be compiled again. */
#define WSG_ABI_VERSION 0

/* Storage in 64-bit words. */
{words}
{}",
        tables()
    )
}

#[test]
fn generated_header_matches_the_crate_and_its_abi_is_recorded() {
    HEADER.is_generated(preamble());
    HEADER.is_recorded();
}

#[test]
fn header_and_recorded_abi_compile_with_gcc() {
    HEADER.compiles("gcc", &[]);
    HEADER.compiles("gcc", &["-m32", "-ffreestanding"]);
}

#[test]
#[ignore = "needs clang: run `cargo xtask test`"]
fn header_and_recorded_abi_compile_with_clang() {
    HEADER.compiles("clang", &[]);
}

#[test]
#[ignore = "needs arm-none-eabi-gcc: run `cargo xtask test`"]
fn header_and_recorded_abi_compile_with_arm_none_eabi_gcc() {
    HEADER.compiles("arm-none-eabi-gcc", &["-mcpu=cortex-m4", "-mthumb", "-ffreestanding"]);
    HEADER.compiles("arm-none-eabi-gcc", &["-mcpu=cortex-m0", "-mthumb", "-ffreestanding"]);
}
