//! Eight digital inputs and outputs on a simulated bus. The master starts the module, switches outputs, reads an
//! object and then stops responding. `cargo run -p bus-canopen --example io_module` prints the frames; add `-- --eds`
//! to print the EDS file.

use bus_canopen::{
    Abort, Cause, Config, DataType, Device, Dictionary, Eds, EdsEntry, EdsFacts, Entry, Event, Fault, Object,
    Profile, Rpdo, Source, entries, find,
};
use bus_slcan::ClassicFrame;
use embedded_can::{Frame, Id, StandardId};

const CONFIG: Config<1> = Config {
    node: 0x20,
    master: 0x7F,
    heartbeat_ms: 1_000,
    emergency_inhibit: 100,
    inhibit: [50],
    event_ms: [0],
};

static PROFILE: Profile<1, 1> =
    Profile { rpdos: [Rpdo { len: 1, keep: [0; 8] }], tpdos: [1], faults: &FAULTS };

const FAULTS: [Fault; 2] = [
    Fault { code: 0x2300, register: 1 << 1, cause: Cause::Application },
    Fault { code: 0x8130, register: 1 << 4, cause: Cause::MasterSilent },
];
/// Bit of the first fault: short circuit at an output.
const SHORT_CIRCUIT: u16 = 1 << 0;

/// Application values that are not in a PDO.
#[derive(Clone, Copy, Debug)]
enum Key {
    /// Mask of the outputs that stay on after the master has timed out.
    HoldMask,
}

const fn ro(
    index: u16,
    sub: u8,
    kind: DataType,
    source: Source<Key>,
    record: &'static str,
    name: &'static str,
) -> Object<Key> {
    Object { index, sub, kind, writable: false, mappable: false, name, record, source }
}

const fn rw(
    index: u16,
    sub: u8,
    kind: DataType,
    source: Source<Key>,
    record: &'static str,
    name: &'static str,
) -> Object<Key> {
    Object { writable: true, ..ro(index, sub, kind, source, record, name) }
}

const OBJECTS: [Object<Key>; 20] = {
    use DataType::{U8, U16, U32};
    const COUNT: &str = "Number of entries";
    [
        ro(0x1000, 0, U32, Source::Fixed(0x0003_0191), "", "Device type"),
        ro(0x1001, 0, U8, Source::ErrorRegister, "", "Error register"),
        ro(0x1016, 0, U8, Source::Fixed(1), "Consumer heartbeat time", COUNT),
        rw(0x1016, 1, U32, Source::ConsumerHeartbeat, "Consumer heartbeat time", "Master and time"),
        rw(0x1017, 0, U16, Source::ProducerHeartbeat, "", "Producer heartbeat time"),
        ro(0x1018, 0, U8, Source::Fixed(3), "Identity", COUNT),
        ro(0x1018, 1, U32, Source::Fixed(0), "Identity", "Vendor-ID"),
        ro(0x1018, 2, U32, Source::Fixed(8), "Identity", "Product code"),
        ro(0x1018, 3, U32, Source::Fixed(1 << 16), "Identity", "Revision number"),
        ro(0x1400, 0, U8, Source::Fixed(2), "RPDO1 communication", COUNT),
        ro(0x1400, 1, U32, Source::PlusNode(0x200), "RPDO1 communication", "COB-ID"),
        ro(0x1400, 2, U8, Source::Fixed(255), "RPDO1 communication", "Transmission type"),
        ro(0x1800, 0, U8, Source::Fixed(5), "TPDO1 communication", COUNT),
        ro(0x1800, 1, U32, Source::PlusNode(0x4000_0180), "TPDO1 communication", "COB-ID"),
        ro(0x1800, 2, U8, Source::Fixed(255), "TPDO1 communication", "Transmission type"),
        rw(0x1800, 3, U16, Source::InhibitTime(0), "TPDO1 communication", "Inhibit time"),
        rw(0x1800, 5, U16, Source::EventTimer(0), "TPDO1 communication", "Event timer"),
        rw(0x2000, 0, U8, Source::Application(Key::HoldMask), "", "Outputs that stay on"),
        ro(0x6000, 1, U8, Source::Tpdo { number: 0, at: 0 }, "Inputs", "Inputs 1 to 8"),
        ro(0x6200, 1, U8, Source::Rpdo { number: 0, at: 0 }, "Outputs", "Outputs 1 to 8"),
    ]
};
const ENTRIES: [Entry<Key>; OBJECTS.len()] = entries(&OBJECTS);

const FACTS: EdsFacts<'_> = EdsFacts {
    file_name: "io-module.eds",
    description: "Eight inputs and eight outputs",
    time: "12:00AM",
    date: "01-01-2026",
    author: "example",
    vendor: "example",
    product: "io-module",
    order_code: "IO-8-8",
    kbit_rates: &[125, 250, 500],
};

struct Module {
    outputs: u8,
    hold_mask: u8,
    master_time_ms: u16,
}

impl Dictionary for Module {
    type Key = Key;

    fn find(&self, index: u16, sub: u8) -> Result<Entry<Key>, Abort> {
        find(&ENTRIES, index, sub)
    }

    fn read(&self, key: Key) -> Result<u32, Abort> {
        match key {
            Key::HoldMask => Ok(self.hold_mask.into()),
        }
    }

    fn write(&mut self, key: Key, value: u32) -> Result<(), Abort> {
        match key {
            Key::HoldMask => self.hold_mask = value as u8,
        }
        Ok(())
    }

    fn consumer_time_ms(&self) -> u16 {
        self.master_time_ms
    }

    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort> {
        self.master_time_ms = time_ms;
        Ok(())
    }
}

/// Frames from the master: time in milliseconds, identifier and data.
const SCRIPT: [(u32, u16, &[u8]); 5] = [
    (10, 0x000, &[0x01, 0x20]),
    (20, 0x77F, &[0x05]),
    (30, 0x220, &[0x0F]),
    (40, 0x620, &[0x2F, 0x00, 0x20, 0x00, 0x03, 0, 0, 0]),
    (50, 0x620, &[0x40, 0x00, 0x62, 0x01, 0, 0, 0, 0]),
];

fn main() {
    if std::env::args().any(|argument| argument == "--eds") {
        let entries = OBJECTS.iter().map(|object| EdsEntry::new(*object));
        print!("{}", Eds { facts: FACTS, entries, config: CONFIG });
        return;
    }
    let mut device = Device::<1, 1, 8>::new(&PROFILE, CONFIG);
    let mut module = Module { outputs: 0, hold_mask: 0, master_time_ms: 300 };
    for now_ms in 0..500 {
        for (_, id, data) in SCRIPT.iter().filter(|(at, ..)| *at == now_ms) {
            let frame = ClassicFrame::new(StandardId::new(*id).unwrap(), data).unwrap();
            print(now_ms, "master", &frame);
            device.on_frame(now_ms, &frame);
        }
        while let Some(event) = device.poll_event(now_ms, &mut module) {
            match event {
                Event::Rpdo { data: [outputs, ..], .. } => module.outputs = outputs,
                Event::Left { .. } | Event::Reset { .. } => module.outputs &= module.hold_mask,
                Event::Sdo { .. } => {}
            }
        }
        // Each input is wired to the output of the same number; the last output has a short circuit.
        device.show_tpdo(0, [module.outputs, 0, 0, 0, 0, 0, 0, 0]);
        device.show_faults(if module.outputs & 0x80 != 0 { SHORT_CIRCUIT } else { 0 }, [0; 5]);
        while let Some(frame) = device.poll_transmit::<ClassicFrame>(now_ms) {
            print(now_ms, "module", &frame);
        }
    }
}

fn print(now_ms: u32, whose: &str, frame: &ClassicFrame) {
    let Id::Standard(id) = frame.id() else { return };
    println!("{now_ms:>4} ms  {whose}  {:03X}  {:02X?}", id.as_raw(), frame.data());
}
