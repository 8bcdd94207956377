use std::io::Read;

use super::*;

/// A client, and a stub that has said `answers` already.
fn client_hears(answers: &[&str]) -> (Gdb, UnixStream) {
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    for answer in answers {
        let sum = answer.bytes().fold(0u8, u8::wrapping_add);
        write!(theirs, "+${answer}#{sum:02x}").unwrap();
    }
    (Gdb::new(ours, Duration::from_millis(20)).unwrap(), theirs)
}

fn said_to(client: Gdb, mut stub: UnixStream) -> String {
    drop(client);
    let mut said = String::new();
    stub.read_to_string(&mut said).unwrap();
    said
}

#[test]
fn a_range_is_watched_for_loads_and_stores() {
    let (mut gdb, stub) = client_hears(&["OK"]);
    gdb.watch(0x4000_6400, 0x400).unwrap();
    assert_eq!(said_to(gdb, stub), "+$Z4,40006400,400#08");
}

#[test]
fn a_refusal_names_the_packet() {
    let (mut gdb, _stub) = client_hears(&["E22"]);
    let refusal = gdb.watch(0, 0).unwrap_err().to_string();
    assert!(refusal.contains("`Z4,0,0`") && refusal.contains("E22"), "{refusal}");
}

#[test]
fn registers_and_memory_are_read_in_one_go() {
    let words: String = (1..=17).map(|n| format!("{n:02x}000000")).collect();
    let (mut gdb, stub) = client_hears(&[&words, "0102"]);
    let (registers, [memory]) = gdb.look([(0x2000_0000, 2)]).unwrap();
    assert_eq!((registers.r[0], registers.r[15], registers.xpsr), (1, 16, 17));
    assert_eq!(memory, [1, 2]);
    assert_eq!(said_to(gdb, stub), "+$g#67+$m20000000,2#4d");
}

#[test]
fn registers_go_back_as_they_came() {
    let words: String = (1..=17).map(|n| format!("{n:02x}3456c0")).collect();
    let (mut gdb, stub) = client_hears(&[&words, "OK"]);
    let registers = gdb.core_registers().unwrap();
    gdb.run_from(&registers).unwrap();
    let said = said_to(gdb, stub);
    assert!(said.contains(&format!("$G{words}#")) && said.ends_with("+$c#63"), "{said}");
}

#[test]
fn a_watchpoint_stops_the_machine_and_nothing_else_may() {
    let (mut gdb, _stub) = client_hears(&["T05thread:01;awatch:40006400;"]);
    assert!(gdb.stops_within(Duration::from_millis(20)).unwrap());
    assert!(!gdb.stops_within(Duration::from_millis(1)).unwrap());

    let (mut gdb, _stub) = client_hears(&["T02thread:01;"]);
    assert!(gdb.stops_within(Duration::from_millis(20)).is_err());
}

#[test]
fn a_damaged_packet_is_an_error() {
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    theirs.write_all(b"+$OK#00").unwrap();
    let mut gdb = Gdb::new(ours, Duration::from_millis(20)).unwrap();
    assert!(gdb.watch(0, 4).unwrap_err().to_string().contains("checksum"));
}

#[test]
fn a_stub_that_hangs_up_is_an_error() {
    let (mut gdb, stub) = client_hears(&[]);
    drop(stub);
    assert!(gdb.stops_within(Duration::from_millis(20)).is_err());
}
