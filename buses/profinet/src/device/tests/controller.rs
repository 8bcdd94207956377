//! A controller that follows the specification, without using the crate's own writers.

use crate::{
    Device, Endpoint, Event, Fault, MacAddress, Module, Priority, Profile, Stored, Submodule, Transmit,
};
use crate::{IpParameters, MAX_FRAME_LEN, Maintenance, StationName};
use std::vec;
use std::vec::Vec;

pub(super) const DEVICE: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x10]);
pub(super) const PLC: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x01]);
pub(super) const OTHER: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x02]);
pub(super) const HOST: Endpoint = Endpoint { address: [192, 168, 0, 1], port: 50_000 };
pub(super) const AR: [u8; 16] = [0xA5; 16];
/// Object UUIDs of the device (instance 1, device 5678h, vendor 1234h) and of a controller.
pub(super) const DEVICE_OBJECT: [u8; 16] =
    [0xDE, 0xA0, 0, 0, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 0x56, 0x78, 0x12, 0x34];
pub(super) const PLC_OBJECT: [u8; 16] =
    [0xDE, 0xA0, 0, 0, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 0x01, 0x0D, 0x00, 0x2A];
pub(super) const SESSION_KEY: u16 = 7;
/// The controller's reference for its end of the alarm connection.
pub(super) const PLC_REFERENCE: u16 = 3;
/// Cycle time: 32 x 4 x 31.25 µs.
pub(super) const CYCLE_US: u64 = 4_000;
/// Hold time: three cycles.
pub(super) const HOLD_US: u64 = 12_000;
pub(super) const INPUT_ID: u16 = 0xC001;
pub(super) const OUTPUT_ID: u16 = 0x8001;

pub(crate) static PROFILE: Profile = Profile {
    vendor_id: 0x1234,
    device_id: 0x5678,
    station_type: "example",
    order_id: "EX-1",
    serial_number: "42",
    hardware_revision: 3,
    software_revision: [1, 2, 13],
    min_interval: 32,
    modules: &[
        Module {
            slot: 0,
            ident: 0x10,
            name: "access point",
            submodules: &[
                Submodule { subslot: 1, ident: 0x11, input_len: 0, output_len: 0 },
                Submodule { subslot: 0x8000, ident: 0x12, input_len: 0, output_len: 0 },
                Submodule { subslot: 0x8001, ident: 0x13, input_len: 0, output_len: 0 },
            ],
        },
        Module {
            slot: 1,
            ident: 0x20,
            name: "both",
            submodules: &[Submodule { subslot: 1, ident: 0x21, input_len: 2, output_len: 1 }],
        },
        Module {
            slot: 2,
            ident: 0x30,
            name: "outputs",
            submodules: &[Submodule { subslot: 1, ident: 0x31, input_len: 0, output_len: 2 }],
        },
    ],
    faults: &[
        Fault { error_type: 0x0100, name: "hot", priority: Priority::Low },
        Fault { error_type: 0x0101, name: "stopped", priority: Priority::High },
        Fault { error_type: 0x0102, name: "cold", priority: Priority::Low },
    ],
};

/// Parameters of a Connect request that tests vary.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    pub(super) uuid: [u8; 16],
    pub(super) mac: MacAddress,
    /// Object UUID of the controller.
    pub(super) object: [u8; 16],
    pub(super) name: &'static [u8],
    pub(super) ar_type: u16,
    pub(super) properties: u32,
    pub(super) input_id: u16,
    pub(super) output_id: u16,
    pub(super) class: u32,
    pub(super) data_len: u16,
    pub(super) send_clock: u16,
    pub(super) reduction: u16,
    pub(super) phase: u16,
    pub(super) hold: u16,
    /// VLAN tags of cyclic data, of high-priority alarms and of low-priority alarms.
    pub(super) tags: [u16; 3],
    pub(super) modules: [u32; 2],
    pub(super) submodules: [u32; 2],
    pub(super) output_len: u16,
    /// Whether the frames have a place for the inputs of slot 1, the outputs of slot 1, and the outputs of slot 2.
    pub(super) placed: [bool; 3],
    pub(super) alarm_properties: u32,
    pub(super) retries: u16,
    /// Number of additional statuses of slot 2 in the frame of outputs.
    pub(super) statuses: u16,
    /// Additional blocks at the end.
    pub(super) more: Vec<u8>,
}

impl Default for Wanted {
    fn default() -> Self {
        Self {
            uuid: AR,
            mac: PLC,
            object: PLC_OBJECT,
            name: b"plc",
            ar_type: 1,
            properties: 0x11,
            input_id: INPUT_ID,
            output_id: OUTPUT_ID,
            class: 1,
            data_len: 40,
            send_clock: 32,
            reduction: 4,
            phase: 1,
            hold: 3,
            tags: [0xC000, 0xC000, 0xA000],
            modules: [0x20, 0x30],
            submodules: [0x21, 0x31],
            output_len: 2,
            placed: [true; 3],
            statuses: 0,
            alarm_properties: 0,
            retries: 3,
            more: vec![],
        }
    }
}

pub(super) fn block(kind: u16, body: &[u8]) -> Vec<u8> {
    let len = body.len() as u16 + 2;
    [&kind.to_be_bytes()[..], &len.to_be_bytes(), &[1, 0], body].concat()
}

fn numbers(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

impl Wanted {
    /// Creates a request for access to records only.
    pub(super) fn access(uuid: [u8; 16]) -> Self {
        Self { uuid, ar_type: 6, properties: 0x111, ..Self::default() }
    }

    pub(super) fn blocks(&self) -> Vec<u8> {
        let ar = [
            &numbers(&[self.ar_type])[..],
            &self.uuid,
            &numbers(&[SESSION_KEY]),
            &self.mac.0,
            &self.object,
            &self.properties.to_be_bytes(),
            // Time-out of 1 s, UDP port, name.
            &numbers(&[10, 0x8892, self.name.len() as u16]),
            self.name,
        ]
        .concat();
        let ar = block(0x0101, &ar);
        if self.ar_type == 6 {
            return [ar, self.more.clone()].concat();
        }
        // Data of slot 1 first, then of slot 2, then submodules without data; consumer statuses at the end.
        let objects = |objects: &[([u16; 3], bool)]| {
            let placed = objects.iter().filter(|(_, is_placed)| *is_placed);
            placed.flat_map(|(object, _)| *object).collect::<Vec<u16>>()
        };
        let [slot_1_in, slot_1_out, slot_2_out] = self.placed;
        let inputs = objects(&[
            ([0, 1, 0], true),
            ([0, 0x8000, 1], true),
            ([0, 0x8001, 2], true),
            ([1, 1, 3], slot_1_in),
        ]);
        let inputs: [&[u16]; 2] = [&inputs, &[1, 1, 6, 2, 1, 7]];
        let outputs = objects(&[([1, 1, 0], slot_1_out), ([2, 1, 2], slot_2_out)]);
        let mut consumers = vec![0, 1, 5, 0, 0x8000, 6, 0, 0x8001, 7, 1, 1, 8];
        consumers.extend((0..self.statuses).flat_map(|more| [2, 1, 9 + more]));
        let outputs: [&[u16]; 2] = [&outputs, &consumers];
        let [cyclic_tag, high_tag, low_tag] = self.tags;
        let iocr = |kind: u16, id: u16, [data, consumers]: [&[u16]; 2]| {
            let body = [
                &numbers(&[kind, 10 + kind, 0x8892])[..],
                &self.class.to_be_bytes(),
                &numbers(&[self.data_len, id, self.send_clock, self.reduction, self.phase, 0]),
                &[0xFF; 4],
                &numbers(&[self.hold, self.hold, cyclic_tag, 0, 0, 0]),
                &numbers(&[1, 0, 0, data.len() as u16 / 3]),
                &numbers(data),
                &numbers(&[consumers.len() as u16 / 3]),
                &numbers(consumers),
            ];
            block(0x0102, &body.concat())
        };
        let alarms = [
            &numbers(&[1, 0x8892])[..],
            &self.alarm_properties.to_be_bytes(),
            &numbers(&[1, self.retries, PLC_REFERENCE, 200, high_tag, low_tag]),
        ];
        let [first, second] = self.modules;
        let [first_submodule, second_submodule] = self.submodules;
        [
            ar,
            iocr(1, self.input_id, inputs),
            iocr(2, self.output_id, outputs),
            block(0x0103, &alarms.concat()),
            module(
                0,
                0x10,
                &[
                    submodule(1, 0x11, &[(1, 0)]),
                    submodule(0x8000, 0x12, &[(1, 0)]),
                    submodule(0x8001, 0x13, &[(1, 0)]),
                ],
            ),
            module(1, first, &[submodule(1, first_submodule, &[(1, 2), (2, 1)])]),
            module(2, second, &[submodule(1, second_submodule, &[(2, self.output_len)])]),
            self.more.clone(),
        ]
        .concat()
    }
}

/// Returns an expected submodule with the direction and length of its data.
fn submodule(subslot: u16, ident: u32, data: &[(u16, u16)]) -> Vec<u8> {
    let properties = data.iter().map(|(direction, len)| if *len > 0 { *direction } else { 0 }).sum();
    let mut bytes = [&numbers(&[subslot])[..], &ident.to_be_bytes(), &numbers(&[properties])].concat();
    for (direction, len) in data {
        bytes.extend([numbers(&[*direction, *len]), vec![1, 1]].concat());
    }
    bytes
}

/// Returns a block of an expected module.
fn module(slot: u16, ident: u32, submodules: &[Vec<u8>]) -> Vec<u8> {
    let head =
        [&numbers(&[1, 0, 0, slot])[..], &ident.to_be_bytes(), &numbers(&[0, submodules.len() as u16])];
    block(0x0104, &[head.concat(), submodules.concat()].concat())
}

/// Returns a Control or Release block.
pub(super) fn control(kind: u16, uuid: [u8; 16], command: u16) -> Vec<u8> {
    let body = [&[0, 0][..], &uuid, &numbers(&[SESSION_KEY, 0, command, 0])];
    block(kind, &body.concat())
}

/// Returns the header of a record to read (9) or write (8).
pub(super) fn record(kind: u16, uuid: [u8; 16], slot: u16, subslot: u16, index: u16, len: u32) -> Vec<u8> {
    let body = [
        &numbers(&[1])[..],
        &uuid,
        &[0; 4],
        &numbers(&[slot, subslot, 0, index]),
        &len.to_be_bytes(),
        &[0; 24],
    ];
    block(kind, &body.concat())
}

pub(super) const DEVICE_INTERFACE: [u8; 16] =
    [0xDE, 0xA0, 0, 1, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D];
const LOW_FIRST: [u8; 16] =
    [1, 0, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D];

/// Returns a datagram in little-endian or big-endian order.
pub(super) fn datagram(is_low_first: bool, kind: u8, sequence: u32, operation: u16, body: &[u8]) -> Vec<u8> {
    let long = |value: u32| if is_low_first { value.to_le_bytes() } else { value.to_be_bytes() };
    let short = |value: u16| if is_low_first { value.to_le_bytes() } else { value.to_be_bytes() };
    let interface = if is_low_first { LOW_FIRST } else { DEVICE_INTERFACE };
    let mut object = DEVICE_OBJECT;
    if is_low_first {
        for field in [0..4, 4..6, 6..8] {
            object[field].reverse();
        }
    }
    [
        &[4, kind, 0x20, 0, if is_low_first { 0x10 } else { 0 }, 0, 0, 0][..],
        &object,
        &interface,
        &[0xAC; 16],
        &long(0),
        &long(1),
        &long(sequence),
        &short(operation),
        &[0xFF; 4],
        &short(body.len() as u16),
        &[0; 4],
        body,
    ]
    .concat()
}

/// Returns the arguments of a call: maximum length of the answer, and the blocks as an array.
pub(super) fn arguments(is_low_first: bool, blocks: &[u8]) -> Vec<u8> {
    let len = blocks.len() as u32;
    let values = [4_096, len, 4_096, 0, len];
    let order = |value: u32| if is_low_first { value.to_le_bytes() } else { value.to_be_bytes() };
    [values.iter().flat_map(|value| order(*value)).collect(), blocks.to_vec()].concat()
}

/// The device and its peers.
pub(super) struct TestRig {
    pub(super) device: Device<3, 2>,
    pub(super) now: u64,
    pub(super) sequence: u32,
    counter: u16,
    /// Frames and datagrams sent together with the answer to a call.
    kept: Vec<(Option<Endpoint>, Vec<u8>)>,
}

pub(super) const NAMED: Stored = Stored {
    name: StationName::NONE,
    ip: IpParameters { address: [192, 168, 0, 5], mask: [255, 255, 255, 0], gateway: [0; 4] },
    maintenance: Maintenance::NONE,
};

impl TestRig {
    pub(super) fn new() -> Self {
        let stored = Stored { name: StationName::new("example-1").unwrap(), ..NAMED };
        let mut rig = Self {
            device: Device::new(&PROFILE, DEVICE, stored, 0xB007),
            now: 1_000_000,
            sequence: 0,
            counter: 0,
            kept: vec![],
        };
        // Discards the LLDP announcement sent at the start.
        assert_eq!(rig.sent().len(), 1);
        rig
    }

    /// Creates a device in data exchange.
    pub(super) fn in_data() -> Self {
        Self::in_data_as(&Wanted::default())
    }

    pub(super) fn in_data_as(wanted: &Wanted) -> Self {
        let mut rig = Self::new();
        let answer = rig.call(0, &wanted.blocks());
        assert_eq!(answer.status, 0, "{answer:?}");
        assert_eq!(rig.call(4, &control(0x0110, wanted.uuid, 1)).status, 0);
        let ready = rig.calls();
        assert_eq!(rig.confirm(&ready[0]), Some(Event::Connected));
        rig
    }

    /// Returns everything the device sends now or has sent with the answer to a call.
    pub(super) fn transmitted(&mut self) -> Vec<(Option<Endpoint>, Vec<u8>)> {
        let mut buffer = [0; MAX_FRAME_LEN];
        let mut all = std::mem::take(&mut self.kept);
        while let Some(transmit) = self.device.poll_transmit(self.now, &mut buffer) {
            all.push(match transmit {
                Transmit::Frame(len) => (None, buffer[..len].to_vec()),
                Transmit::Datagram(len, to) => (Some(to), buffer[..len].to_vec()),
            });
            assert!(all.len() < 100, "endless transmission");
        }
        all
    }

    /// Returns the frames sent now. Datagrams are discarded.
    pub(super) fn sent(&mut self) -> Vec<Vec<u8>> {
        self.transmitted().into_iter().filter(|(to, _)| to.is_none()).map(|(_, frame)| frame).collect()
    }

    /// Returns the frames sent now, except cyclic ones of the connection.
    pub(super) fn acyclic(&mut self) -> Vec<Vec<u8>> {
        let is_cyclic =
            |frame: &Vec<u8>| frame[12..14] == [0x81, 0] && frame[18..20] == INPUT_ID.to_be_bytes();
        self.sent().into_iter().filter(|frame| !is_cyclic(frame)).collect()
    }

    /// Returns the device's calls sent now.
    pub(super) fn calls(&mut self) -> Vec<Vec<u8>> {
        let calls = self
            .transmitted()
            .into_iter()
            .filter(|(to, _)| *to == Some(Endpoint { address: HOST.address, port: 0x8894 }));
        calls.map(|(_, call)| call).collect()
    }

    /// Calls an operation. Returns the answer with the event.
    pub(super) fn call(&mut self, operation: u16, blocks: &[u8]) -> Answer {
        self.sequence += 1;
        let request = datagram(true, 0, self.sequence, operation, &arguments(true, blocks));
        let event = self.device.receive_datagram(self.now, HOST, &request);
        let (answers, others): (Vec<_>, Vec<_>) =
            self.transmitted().into_iter().partition(|(to, _)| *to == Some(HOST));
        self.kept = others;
        let [(_, answer)] = &answers[..] else { panic!("{answers:?}") };
        Answer::of(event, answer)
    }

    /// Confirms a call of the device.
    pub(super) fn confirm(&mut self, call: &[u8]) -> Option<Event> {
        self.confirm_as(call, AR, 8, 0)
    }

    pub(super) fn confirm_as(
        &mut self,
        call: &[u8],
        uuid: [u8; 16],
        command: u16,
        status: u32,
    ) -> Option<Event> {
        let block = control(0x8112, uuid, command);
        let len = block.len() as u32;
        let values = [status, len, len, 0, len];
        let body = [values.iter().flat_map(|value| value.to_be_bytes()).collect(), block].concat();
        let mut answer = call[..80].to_vec();
        answer[1] = 2;
        answer[74..76].copy_from_slice(&(body.len() as u16).to_be_bytes());
        answer.extend(body);
        self.device.receive_datagram(self.now, HOST, &answer)
    }

    /// Sends the next frame of outputs.
    pub(super) fn outputs(&mut self, outputs: [u8; 3]) -> Option<Event> {
        self.counter = self.counter.wrapping_add(128);
        let frame = outputs_frame(outputs, self.counter, [0x80; 2], 0x35);
        self.device.receive(self.now, &frame)
    }

    /// Returns the first event due now.
    pub(super) fn poll(&mut self) -> Option<Event> {
        self.device.poll(self.now)
    }
}

/// Returns a frame of outputs with these provider statuses and this data status.
pub(super) fn outputs_frame(outputs: [u8; 3], counter: u16, [first, second]: [u8; 2], status: u8) -> Vec<u8> {
    let [a, b, c] = outputs;
    let mut frame =
        [&DEVICE.0[..], &PLC.0, &[0x81, 0x00, 0xC0, 0x00, 0x88, 0x92], &OUTPUT_ID.to_be_bytes()].concat();
    let mut data = vec![0x80; 40];
    data[..5].copy_from_slice(&[a, first, b, c, second]);
    frame.extend(data);
    frame.extend(counter.to_be_bytes());
    frame.extend([status, 0]);
    frame
}

/// An answer to a call.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) event: Option<Event>,
    pub(super) kind: u8,
    pub(super) status: u32,
    pub(super) blocks: Vec<u8>,
}

impl Answer {
    pub(super) fn of(event: Option<Event>, bytes: &[u8]) -> Self {
        let long = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(bytes.len(), 80 + usize::from(u16::from_le_bytes([bytes[74], bytes[75]])));
        let (kind, status) = (bytes[1], long(80));
        let blocks = bytes.get(100..).unwrap_or(&[]).to_vec();
        if kind == 2 {
            assert_eq!((long(84), long(92), long(96)), (blocks.len() as u32, 0, blocks.len() as u32));
        }
        Self { event, kind, status, blocks }
    }
}

/// Returns the blocks of an answer: types, and bodies without the version.
pub(super) fn blocks_of(mut bytes: &[u8]) -> Vec<(u16, Vec<u8>)> {
    let mut all = vec![];
    while !bytes.is_empty() {
        let len = usize::from(u16::from_be_bytes([bytes[2], bytes[3]]));
        all.push((u16::from_be_bytes([bytes[0], bytes[1]]), bytes[6..4 + len].to_vec()));
        bytes = &bytes[4 + len..];
    }
    all
}
