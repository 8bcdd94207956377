//! Equal hashes imply equal future behaviour. The exhaustive exploration relies on it.

use std::hash::{DefaultHasher, Hash, Hasher};

use bus_modbus::Words;
use wsg_fieldbus::{CommandFlags, Controller, GripperFlags, Images, InputImage, OutputImage};
use wsg_protocol::session::Known;
use wsg_protocol::{Command, Status, SystemFlags};

fn hash(state: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    state.hash(&mut hasher);
    hasher.finish()
}

/// Returns whether all hashes differ.
fn differ<T: Hash>(states: &[T]) -> bool {
    let mut hashes: Vec<_> = states.iter().map(hash).collect();
    hashes.sort_unstable();
    hashes.dedup();
    hashes.len() == states.len()
}

#[test]
fn images_differ_by_written_and_not_by_displayed_values() {
    let nothing = Images::new(false);
    let mut shown = nothing.clone();
    shown.set_input(&InputImage {
        state: GripperFlags::IDLE,
        user: 0,
        system: SystemFlags::empty(),
        width: 1,
        force: 1,
        status: Status::Success,
    });
    assert_eq!(hash(&shown), hash(&nothing));
    let mut written = nothing.clone();
    written.write_registers(0, Words::new(&[1, 0])).unwrap();
    let mut taken = written.clone();
    assert!(taken.take_written().is_some());
    assert!(differ(&[nothing, written, taken]));
}

#[test]
fn controllers_differ_by_the_commands_that_wait() {
    let mut waits = Controller::new();
    let image = OutputImage { flags: CommandFlags::FASTSTOP, ..OutputImage::ZERO };
    waits.set_output(&image, &Known::NOTHING);
    let mut fetched = waits.clone();
    assert_eq!(fetched.poll_command(), Some(Command::FastStop));
    assert!(differ(&[Controller::new(), waits, fetched]));
}
