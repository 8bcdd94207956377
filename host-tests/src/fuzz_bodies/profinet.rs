//! The IO device with its network peers: DCP, RPC, cyclic frames and alarms, intact and damaged.

use bus_profinet::{Endpoint, Event, MAX_FRAME_LEN, MacAddress, State, Stored, Transmit};
use wsg_fieldbus::profinet::{Device, PROFILE};
use wsg_fieldbus::{InputImage, OutputImage};

use super::input::Input;

static PROFILE_OF_ALL: bus_profinet::Profile = PROFILE;

const DEVICE: MacAddress = MacAddress([0x02, 0, 0, 0, 0, 0x10]);
const CONTROLLERS: [MacAddress; 2] = [MacAddress([0x02, 0, 0, 0, 0, 1]), MacAddress([0x02, 0, 0, 0, 0, 2])];
const HOSTS: [Endpoint; 2] =
    [Endpoint { address: [10, 0, 0, 1], port: 40_000 }, Endpoint { address: [10, 0, 0, 2], port: 40_000 }];
const IDENTIFY: [u8; 6] = [0x01, 0x0E, 0xCF, 0, 0, 0];
const OUTPUT_ID: u16 = 0x8001;
const SESSION_KEY: u16 = 7;
/// Maximum number of frames at a time: the capacity of the device's queues.
const MAX_AT_ONCE: usize = 16;

const INDEXES: [u16; 20] = [
    0xAFF0, 0xAFF1, 0xAFF2, 0xAFF3, 0xF840, 0xF000, 0xE000, 0xE001, 0xE002, 0xC001, 0x8000, 0x8001, 0x800A,
    0xF80C, 0xF821, 0xF841, 0x802A, 0x8080, 0xE040, 0x1234,
];

struct Network {
    device: Device,
    now: u64,
    sequence: u32,
    counter: u16,
    /// The device's last call.
    call: Option<Vec<u8>>,
    /// Outputs of the last cyclic frame, if it was valid.
    offered: Option<[u8; OutputImage::LEN]>,
}

/// Each op is a byte with parameter bytes.
pub fn profinet(data: &[u8]) {
    let mut input = Input::new(data);
    let mut network = Network::new();
    while !input.is_empty() {
        network.offered = None;
        let before = network.device.state();
        let event = network.happen(&mut input);
        network.check(before, event);
        network.settle();
    }
}

impl Network {
    fn new() -> Self {
        Self {
            device: Device::new(&PROFILE_OF_ALL, DEVICE, Stored::NONE, 1),
            now: 0,
            sequence: 0,
            counter: 0,
            call: None,
            offered: None,
        }
    }

    fn happen(&mut self, input: &mut Input<'_>) -> Option<Event> {
        match input.byte() % 14 {
            0 => {
                self.now += 250 * u64::from(input.byte());
                None
            }
            1 => {
                let mut inputs = [0; InputImage::LEN];
                inputs.fill(input.byte());
                self.device.show_inputs(&inputs);
                self.device.show_faults(input.byte().into());
                None
            }
            2 => self.dcp(input),
            3 => {
                let who = who(input);
                let is_access = input.byte().is_multiple_of(4);
                let mut blocks = connect(who, is_access);
                input.damage(&mut blocks);
                self.request(who, 0, &blocks)
            }
            4 => self.control(who(input), 4, 0x0110, 1, input),
            5 => self.control(who(input), 1, 0x0114, 4, input),
            6 => self.confirm(input),
            7 | 8 => self.outputs(input),
            9 => self.record(input),
            10 => self.alarm(input),
            11 => self.device.receive(self.now, input.fewer_than(256)),
            12 => self.device.receive_datagram(self.now, HOSTS[0], input.fewer_than(256)),
            _ => {
                // The endpoint mapper, or an unknown operation.
                let operation = u16::from(input.byte() % 8);
                let body = input.fewer_than(64);
                self.sequence += 1;
                let interface = if operation % 2 == 0 { EPM } else { INTERFACE };
                let request = datagram(&interface, self.sequence, operation, body);
                self.device.receive_datagram(self.now, HOSTS[1], &request)
            }
        }
    }

    /// Sends a DCP request of either controller.
    fn dcp(&mut self, input: &mut Input<'_>) -> Option<Event> {
        let (to, id, service) = input.pick(&[
            (IDENTIFY, 0xFEFE, 5),
            (DEVICE.0, 0xFEFD, 3),
            (DEVICE.0, 0xFEFD, 4),
            (DEVICE.0, 0xFEFE, 5),
        ]);
        let delay = input.pick(&[1, 2, 0x80, 0x1900]);
        let blocks = input.fewer_than(64);
        let who = CONTROLLERS[who(input)];
        let len = numbers(&[delay, blocks.len() as u16]);
        let head = [&to[..], &who.0, &numbers(&[0x8892, id]), &[service, 0, 0, 0, 0, 1], &len];
        self.device.receive(self.now, &[&head.concat(), blocks].concat())
    }

    /// Confirms the device's last call, as the controller.
    fn confirm(&mut self, input: &mut Input<'_>) -> Option<Event> {
        let call = self.call.clone()?;
        let mut block = control(0x8112, uuid(who(input)), 8);
        input.damage(&mut block);
        let len = block.len() as u32;
        let body: Vec<u8> = [0, len, len, 0, len].iter().flat_map(|value| value.to_be_bytes()).collect();
        let mut answer = [&call[..80], &body, &block].concat();
        answer[1] = 2;
        answer[74..76].copy_from_slice(&((body.len() + block.len()) as u16).to_be_bytes());
        self.device.receive_datagram(self.now, HOSTS[0], &answer)
    }

    /// Reads or writes a record.
    fn record(&mut self, input: &mut Input<'_>) -> Option<Event> {
        let who = who(input);
        let (operation, kind) = input.pick(&[(2, 9), (5, 9), (3, 8)]);
        let index = input.pick(&INDEXES);
        let (slot, subslot) = input.pick(&[(0, 1), (0, 0x8000), (0, 0x8001), (1, 1), (2, 1), (3, 1)]);
        let count = usize::from(input.byte() % 96);
        let data = if kind == 8 { input.bytes(count) } else { &[] };
        let len = if kind == 8 { data.len() as u32 } else { 1_000 };
        let body = [
            &numbers(&[1])[..],
            &uuid(who),
            &[0; 4],
            &numbers(&[slot, subslot, 0, index]),
            &len.to_be_bytes(),
            &[0; 24],
        ];
        let mut blocks = [&block(kind, &body.concat()), data].concat();
        input.damage(&mut blocks);
        self.request(who, operation, &blocks)
    }

    /// Sends an alarm, an acknowledgement or an abort.
    fn alarm(&mut self, input: &mut Input<'_>) -> Option<Event> {
        let id = input.pick(&[0xFE01, 0xFC01]);
        let kind = input.pick(&[0x11, 0x13, 0x13, 0x14, 0x12]);
        let numbers_of = [0xFFFF, 0xFFFE, 0, 1];
        let (number, acknowledged) = (input.pick(&numbers_of), input.pick(&numbers_of));
        let reference = u16::from(input.byte() % 4);
        let alarm = u16::from(input.byte() % 4);
        let ack = block(if id == 0xFC01 { 0x8001 } else { 0x8002 }, &numbers(&[1, 0, 0, 0, 1, alarm, 0, 0]));
        let data = if kind == 0x11 { &ack[..] } else { &[] };
        let head = numbers(&[0x8892, id, reference, 3]);
        let rest = numbers(&[number, acknowledged, data.len() as u16]);
        let frame = [&DEVICE.0[..], &CONTROLLERS[0].0, &head, &[kind, 0x11], &rest, data];
        self.device.receive(self.now, &frame.concat())
    }

    fn request(&mut self, who: usize, operation: u16, blocks: &[u8]) -> Option<Event> {
        self.sequence += 1;
        let len = blocks.len() as u32;
        let head: Vec<u8> =
            [1_400, len, 4_096, 0, len].iter().flat_map(|value| value.to_be_bytes()).collect();
        let request = datagram(&INTERFACE, self.sequence, operation, &[head, blocks.to_vec()].concat());
        self.device.receive_datagram(self.now, HOSTS[who], &request)
    }

    fn control(
        &mut self,
        who: usize,
        operation: u16,
        kind: u16,
        command: u16,
        input: &mut Input<'_>,
    ) -> Option<Event> {
        let mut block = control(kind, uuid(who), command);
        input.damage(&mut block);
        self.request(who, operation, &block)
    }

    fn outputs(&mut self, input: &mut Input<'_>) -> Option<Event> {
        let image: [u8; OutputImage::LEN] = input.array();
        self.counter = self.counter.wrapping_add(256);
        let who = usize::from(input.byte().is_multiple_of(16));
        let mut frame = [&DEVICE.0[..], &CONTROLLERS[who].0, &numbers(&[0x8892, OUTPUT_ID])].concat();
        let mut data = vec![0x80; 40];
        data[..8].copy_from_slice(&image);
        frame.extend(data);
        frame.extend(self.counter.to_be_bytes());
        frame.extend([0x35, 0]);
        input.damage(&mut frame);
        // Independently checks that the frame is from the controller and valid.
        let is_good = frame.len() == 60
            && frame[..16] == [&DEVICE.0[..], &CONTROLLERS[0].0, &numbers(&[0x8892, OUTPUT_ID])].concat()
            && frame[24] & 0x80 != 0
            && frame[58] & 0x15 == 0x15
            && frame[59] == 0;
        self.offered = is_good.then(|| frame[16..24].try_into().expect("eight"));
        self.device.receive(self.now, &frame)
    }

    /// Checks that outputs occur only in data exchange and were received.
    fn check(&self, before: State, event: Option<Event>) {
        let outputs = *self.device.outputs();
        if event == Some(Event::Outputs) {
            assert_eq!(
                (before, self.device.state()),
                (State::Data, State::Data),
                "outputs without a controller"
            );
            assert_eq!(Some(outputs), self.offered, "outputs that were not received");
        }
        if self.device.state() != State::Data || matches!(event, Some(Event::Cleared | Event::Left(_))) {
            assert_eq!(outputs, [0; OutputImage::LEN], "{event:?}");
        }
        if event == Some(Event::Connected) {
            assert_eq!((before, self.device.state()), (State::Ready, State::Data));
        }
    }

    /// Fetches all due events and frames, and checks that none is due afterwards.
    fn settle(&mut self) {
        for _ in 0..MAX_AT_ONCE {
            let before = self.device.state();
            let Some(event) = self.device.poll(self.now) else { break };
            self.check(before, Some(event));
        }
        assert_eq!(self.device.poll(self.now), None, "the number of events is bounded");
        let mut buffer = [0; MAX_FRAME_LEN];
        for _ in 0..MAX_AT_ONCE {
            match self.device.poll_transmit(self.now, &mut buffer) {
                Some(Transmit::Frame(len)) => {
                    assert!((60..=MAX_FRAME_LEN).contains(&len), "{len}");
                    assert_eq!(buffer[6..12], DEVICE.0, "a foreign source address");
                }
                Some(Transmit::Datagram(len, _)) => {
                    assert!((80..=1_472).contains(&len), "{len}");
                    if buffer[1] == 0 {
                        self.call = Some(buffer[..len].to_vec());
                    }
                }
                None => {
                    assert!(self.device.poll_timeout(self.now) > self.now, "an overdue action");
                    return;
                }
            }
        }
        panic!("the number of frames is not bounded");
    }
}

fn who(input: &mut Input<'_>) -> usize {
    usize::from(input.byte()) % 2
}

const INTERFACE: [u8; 16] =
    [0xDE, 0xA0, 0, 1, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D];
const EPM: [u8; 16] = [0xE1, 0xAF, 0x83, 8, 0x5D, 0x1F, 0x11, 0xC9, 0x91, 0xA4, 8, 0, 0x2B, 0x14, 0xA0, 0xFA];

/// Object UUID of the device: instance 1, device 0001h, vendor 02A2h.
const OBJECT: [u8; 16] = [0xDE, 0xA0, 0, 0, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 0, 1, 0x02, 0xA2];

fn uuid(who: usize) -> [u8; 16] {
    [0xA0 + who as u8; 16]
}

fn numbers(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

fn block(kind: u16, body: &[u8]) -> Vec<u8> {
    [&numbers(&[kind, body.len() as u16 + 2])[..], &[1, 0], body].concat()
}

fn control(kind: u16, uuid: [u8; 16], command: u16) -> Vec<u8> {
    block(kind, &[&[0, 0][..], &uuid, &numbers(&[SESSION_KEY, 0, command, 0])].concat())
}

fn datagram(interface: &[u8; 16], sequence: u32, operation: u16, body: &[u8]) -> Vec<u8> {
    [
        &[4, 0, 0x20, 0, 0, 0, 0, 0][..],
        &OBJECT,
        interface,
        &[0xAC; 16],
        &[0, 0, 0, 0, 0, 0, 0, 1],
        &sequence.to_be_bytes(),
        &numbers(&[operation, 0xFFFF, 0xFFFF, body.len() as u16, 0, 0]),
        body,
    ]
    .concat()
}

/// Returns the blocks of a connection (8 ms cycle, 24 ms time-out), or of one for records alone.
fn connect(who: usize, is_access: bool) -> Vec<u8> {
    let (kind, properties) = if is_access { (6, 0x111_u32) } else { (1, 0x11) };
    let ar = [
        &numbers(&[kind])[..],
        &uuid(who),
        &numbers(&[SESSION_KEY]),
        &CONTROLLERS[who].0,
        &OBJECT,
        &properties.to_be_bytes(),
        &numbers(&[10, 0x8892, 3]),
        b"plc",
    ];
    let ar = block(0x0101, &ar.concat());
    if is_access {
        return ar;
    }
    let iocr = |kind: u16, id: u16, data: &[u16], consumers: &[u16]| {
        let body = [
            numbers(&[
                kind, kind, 0x8892, 0, 1, 40, id, 32, 8, 1, 0, 0xFFFF, 0xFFFF, 3, 3, 0xC000, 0, 0, 0, 1, 0, 0,
            ]),
            numbers(&[data.len() as u16 / 3]),
            numbers(data),
            numbers(&[consumers.len() as u16 / 3]),
            numbers(consumers),
        ];
        block(0x0102, &body.concat())
    };
    let submodule = |subslot: u16, ident: u16, direction: u16, len: u16| {
        let properties = if len == 0 { 0 } else { direction };
        [numbers(&[subslot, 0, ident, properties, direction, len]), vec![1, 1]].concat()
    };
    let module = |slot: u16, ident: u16, submodules: &[Vec<u8>]| {
        let head = numbers(&[1, 0, 0, slot, 0, ident, 0, submodules.len() as u16]);
        block(0x0104, &[head, submodules.concat()].concat())
    };
    [
        ar,
        iocr(1, 0xC001, &[0, 1, 0, 0, 0x8000, 1, 0, 0x8001, 2, 1, 1, 3], &[2, 1, 16]),
        iocr(2, OUTPUT_ID, &[2, 1, 0], &[0, 1, 9, 0, 0x8000, 10, 0, 0x8001, 11, 1, 1, 12]),
        block(0x0103, &numbers(&[1, 0x8892, 0, 0, 1, 3, 3, 200, 0xC000, 0xA000])),
        module(
            0,
            1,
            &[submodule(1, 1, 1, 0), submodule(0x8000, 0x8000, 1, 0), submodule(0x8001, 0x8001, 1, 0)],
        ),
        module(1, 0x10, &[submodule(1, 0x11, 1, 12)]),
        module(2, 0x20, &[submodule(1, 0x21, 2, 8)]),
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The seeds' ops achieve their purpose.
    #[test]
    fn connection_of_this_body_leads_to_outputs() {
        let mut network = Network::new();
        let mut events = vec![];
        for op in [&[3, 0, 1, 0][..], &[4, 0, 0], &[6, 0, 0], &[7, 1, 2, 3, 4, 5, 6, 7, 8, 1, 0]] {
            events.extend(network.happen(&mut Input::new(op)));
            network.settle();
        }
        assert_eq!(events, [Event::Connected, Event::Outputs]);
        assert_eq!(network.device.outputs(), &[1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
