//! Third-party masters update a bridge in virtual time, which has a boot loader's slot.

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::Duration;

use bus_slcan::{Adapter, ClassicFrame, Decoder, Line, encode};
use embedded_can::{Frame, Id, StandardId};
use host_tests::masters::{self, printed};
use host_tests::slot_model::{SlotModel, signed};
use host_tests::terminal::Terminal;
use host_tests::world::service_line::ServiceLine;
use host_tests::world::{BOARD, World, quick};
use wsg_bridge_fw::{Config, PlcBus};

/// Runs a master's script on a terminal, and the world meanwhile by `turn`. Checks that the bridge restarts with the image.
fn updates(config: Config, far: UnixStream, script: &'static str, mut turn: impl FnMut(&mut World)) {
    // Two files of records.
    let image = signed(20_500, BOARD.name, [1, 2, 3]);
    let terminal = Terminal::to(far).unwrap();
    let digits: String = image.iter().map(|byte| format!("{byte:02x}")).collect();
    let path = terminal.path.clone();
    let eds = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/wsg-bridge.eds");
    let master = thread::spawn(move || masters::python(script, &[&path, &digits, eds]));
    let mut world = World::new(config, quick());
    world.flash.slot = Some(SlotModel::new());
    while !master.is_finished() {
        turn(&mut world);
    }
    let output = master.join().unwrap();
    assert!(output.status.success() && printed(&output).contains("passed"), "{}", printed(&output));
    world.pass(1_100);
    let slot = world.flash.slot.as_ref().unwrap();
    assert_eq!((slot.marks, slot.restarts), (1, 1));
    assert!(slot.bytes(image.len()) == image);
}

#[test]
#[ignore = "needs pymodbus: run `cargo xtask test`"]
fn pymodbus_writes_an_image_as_file_records() {
    let (mut line, far) = ServiceLine::new();
    updates(Config::DEFAULT, far, include_str!("update/pymodbus.py"), |world| {
        line.read();
        world.turn(&mut line);
    });
}

#[test]
#[ignore = "needs canopen: run `cargo xtask test`"]
fn canopen_downloads_an_image_as_program_data() {
    let (mut near, far) = UnixStream::pair().unwrap();
    near.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let (mut decoder, mut adapter) = (Decoder::new(), Adapter::new());
    let config = Config { plc_bus: PlcBus::Canopen, ..Config::DEFAULT };
    updates(config, far, include_str!("update/canopen.py"), |world| {
        let mut bytes = [0; 256];
        let count = uninterrupted::read(&mut near, &mut bytes).unwrap_or(0);
        for byte in &bytes[..count] {
            let Some(line) = decoder.push::<ClassicFrame>(*byte) else { continue };
            near.write_all(adapter.answer(&line)).unwrap();
            if let Line::Frame(frame) = line
                && let Id::Standard(id) = frame.id()
            {
                world.can.send(id.as_raw(), frame.data());
            }
        }
        world.step();
        for (_, id, data) in world.can.take_frames() {
            let frame = ClassicFrame::new(StandardId::new(id).unwrap(), &data).unwrap();
            if adapter.is_open() {
                near.write_all(encode(&frame).as_bytes()).unwrap();
            }
        }
    });
}
