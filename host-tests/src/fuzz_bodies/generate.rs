//! Reproducible inputs for runs on stable Rust.

use crate::chance::Chance;

/// Pieces of generated inputs for a body.
#[derive(Clone, Copy)]
pub enum Pieces {
    /// Groups of hexadecimal byte strings, separated by blanks.
    Hex(&'static [&'static [&'static str]]),
    /// Literal text.
    Text(&'static [&'static str]),
}

impl Pieces {
    /// Returns the individual pieces.
    pub(super) fn list(self) -> Vec<Vec<u8>> {
        match self {
            Self::Hex(groups) => groups.concat().iter().flat_map(|line| line.split(' ')).map(bytes).collect(),
            Self::Text(pieces) => pieces.iter().map(|piece| piece.as_bytes().to_vec()).collect(),
        }
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("two hexadecimal digits");
    (0..hex.len()).step_by(2).map(byte).collect()
}

/// Pieces of the binary protocol.
pub(super) const BINARY: &[&str] = &["AAAAAA AA 00 0000 01 FF 1A00 20 250800 400600 0000A041 61636B"];

/// Ops of the body `profinet`: controllers, application and time.
pub(super) const PROFINET: &[&str] = &[
    // Connected, parameters ended, confirmed: complete, and by another controller; for records alone.
    "03000100040000060000 03000100 03010100 03010000 040000 060000",
    // Damaged ones.
    "030001C20050FF007000 030001F00100 0400C1001D02",
    // Time: a cycle, the silence that ends the connection, more.
    "0020 0060 00FF",
    // Outputs: valid, from another controller, bad, outdated.
    "0701020304050607080100 0708070605040302011000 07010101010101010101C1001800 07010101010101010101C1003A25",
    // Faults, and a controller's replies to their alarms.
    "01AA05 015500 0A000101000100 0A000000000100 0A010000000100 0A000300000100",
    // Records, and a release.
    "090000000000 0900000F0000 090002120040 050000",
    // DCP: all, name, address, reset.
    "02000004FFFF000000 02020008020200040001616200 020200120102000E00010A000005FF0000000000000000 \
     0202000605060002000400 020100040202010200",
    // Endpoint mapper.
    "0D0228",
];

/// Ops of the body `ethernetip`: originators, tools and time.
pub(super) const ETHERNETIP: &[&str] = &[
    // Sessions: of both stations, of a second connection; with the wrong handle; ended by TCP and by a command.
    "0100 0101 0102 03000100 0200 0201 03000000",
    // Owners at several intervals, from another station, with another's session, damaged, closed.
    "04000000010000 04000000021200 0401000003F600 0400FF00010000 04000000010000C1001096 06000100 06010100 06000200",
    // Input only, listen only, explicit.
    "04000001040000 04010001052500 04000002060000 04010002070000 04000003080000 04010003090000 06000400",
    // Packets: run, idle, with a frozen count, old, from another station, damaged.
    "070000010203040506070800 070108070605040302010000 070018010101010101010100 0700C1090909090909090900 \
     070003090909090909090900 070064090909090909090900 0700000909090909090909C1000E05 070002010203040506070800",
    // Explicit messages in connections and without, one damaged; a reset.
    "0900000100 0900010200 0901010300 0900000400 0900000500 0900000700 090001030300C1000B01",
    // Time: a cycle, the time-outs, the inactivity of a session.
    "000014 000050 000108 0001FF 00020B 000279",
    // Discovery, and noise.
    "0A000000 0A000100 0B0106020002800800",
];

/// Ops of the body `profibus`: masters, application and time.
pub(super) const PROFIBUS: &[&str] = &[
    // Start by a master; time; inputs and a diagnosis.
    "03 0164 01C8 0037AABB031000",
    // Data_Exchange as SD3 and as SD2, without data, too short, repeated, from another master.
    "04FF0000000102030405060708000F00 04FF0000000807060504030201010F00 04FF000004000F00 \
     04FF00000501020304050607000F00 044F0000000909090909090909000F00 04FF0200000909090909090909000F00",
    // Set_Prm, Chk_Cfg, Global_Control, Set_Slave_Address, Slave_Diag, FDL_Status.
    "04FF0003010001050B000100010F00 04FF00040000010F00 04FF0005000200010F00 04FF0005002800010F00 \
     04FF0005001400010F00 04FF000701000000010F00 04FF00090000010F00 043F000004000F00",
];

/// Wire ops of the whole-bridge bodies.
pub(super) const WIRES: &[&str] = &[
    // Levels: FAST_STOP_OK alone, none, STOP_ACK, a motion, time to settle.
    "00200706 00000704 00300704 02000704 0202 0203",
    // Edges: GRIP with two recipes, MOVE, RELEASE, STOP_ACK, a FAST STOP, an acknowledged FAST STOP.
    "0200070300200703 00A1070300200703 0202070300200703 0201070300200703 0030070300200703 0000070200200706 \
     00000702002007060030070300200703",
];

/// Gripper and time ops of the whole-bridge bodies.
pub(super) const GRIPPER: &[&str] = &[
    // Silent, answering again, late; an answer duplicated, missing, rejected; commands lost briefly and for long.
    "0600 0601 060396 06050832 060764C802 0605D800 060BCC0000F000 06071EE000 0605EC00 0605F000 060764F000 \
     060900F0F000 0605FE00",
    // Gripper without part, not referenced, too hot, in FAST STOP, moving.
    "06130C 0621 0631 0671 068302",
    // Time.
    "0705 071F 0F80 0FC8 FF",
];

/// Start and PLC ops of the body `bridge`.
pub(super) const BRIDGE: [&[&str]; 2] = [
    &[
        // Ready and not ready; a strict bus with broadcasts; a slow line; damaged settings; moving fingers.
        "01 03 05 09 10 15 00",
    ],
    &[
        // Images over the bus: zeros, motions, a stop, a FAST STOP, a jog with its parameters.
        "0A00000400 0A01000400 0A02010400 0A05000400 0A06008400 0A07000400 0A07010400 0E0001 0E0002 0E0004 \
         0E0005 0E0107",
        // A coil, a mask write, settings: BUS_TIMEOUT, BUS_REACTION, DEBOUNCE.
        "0C0001010400 0C0001000400 0D00020400 0B0040010400 0B0002020400 0B000A060400",
        // Both ports: recipes, BUS_RECIPE, SAVE, RESTORE, DEFAULTS, some without time after them; reads.
        "2B0003010400 AB0003000400 AB0000010400 4B00030400 CB00030400 CB00100400 6B00000400 EB00008400 \
         EB00010400 6B00028400 EB00020400 CB0080510400 4B0080510400",
        // A recipe and its use; settings saved, changed, restored and read; another UNIT, and a read of it.
        "AB00050104004B000504000E0002 2B0004000400CB000404000E0003 CB000304000E0001 4B000304006B000004000F3C \
         CB000204006B00010400CB00CD000400 8B00000504008D0800030400",
        // Service port: DEBOUNCE, MIN_BUSY, UNIT, BUS_CHAR_TIMEOUT, SWAP_BYTES, image, coil, mask write, read.
        "8B00060A0400 8B0007C80400 8B0000050400 8B0003000400 8B0005010400 8A01000400 8C0001010400 8D00020400 \
         8D0800030400",
        // Not ops.
        "AAAAAA",
    ],
];

/// Start and PLC ops of the body `bridge_can`.
pub(super) const BRIDGE_CAN: [&[&str]; 2] = [
    &[
        // Ready and not ready; the gripper on RS-232; moving fingers.
        "01 03 10 13 00",
    ],
    &[
        // RPDOs: zeros, motions, a stop, a FAST STOP, a jog with its parameters; one of wrong length.
        "040000 040100 840201 040500 040600 040700 840701 050001 050002 050004 050005 050107 0E0207",
        // NMT: start, stop, pre-operational, both resets; the master's heartbeat and boot-up.
        "080000 080100 880201 880300 080400 090000 090001",
        // SDO: BUS_TIMEOUT, DEBOUNCE, the master's heartbeat.
        "0A004000 0A020A00 0A03400201",
        // A remote frame and a 29-bit frame with an RPDO's identifier.
        "0308000001 03110000010100D0078813A00F",
        // Faults: bus-off, overrun, missing acknowledgement, rejecting controller; recovery.
        "0D0000 0D01 0D0201 0D0401 0D07",
    ],
];

/// Start and PLC ops of the body `bridge_profibus`.
pub(super) const BRIDGE_PROFIBUS: [&[&str]; 2] = [
    &[
        // Ready and not ready; an echo; moving fingers.
        "01 03 11 00",
    ],
    &[
        // Outputs: zeros, motions, a stop, a FAST STOP, a jog, some without time after them; from a second master.
        "080000000F0000 880100000F0000 080201000F0000 080500000F0000 880600000F0000 880000000F0000 \
         080700000F0000 080701000F0000 080200030F0000 08020000020005 08020000030005 090001 090002 090004 \
         090005 090107",
        // Parameters and configuration: watchdog off, short and long, late answers, from a second master.
        "0A00000B 0A05000B 0AC800C8 0A14030B",
        // Unlock, wrong ident and configuration, Slave_Diag, an unknown service.
        "0B000200000000000F0000 0B0000140B0200000F0000 0B0101000F0000 0B0400000F0000 8B0325000000000F0000",
        // Clear, Sync, to all and by group; a repetition, no outputs, too few; FDL_Status.
        "0C000000000F0000 8C000001000F0000 0C000200000F0000 0D000F0000 0D01000F0000 0D0200000F0000 8E0000",
        // Noise; a master that transmits during an answer.
        "0503001000FF00006800 8B000014C80001000F00008E0000",
    ],
];

/// Start and master ops of the body `bridge_gateway`.
pub(super) const BRIDGE_GATEWAY: &[&str] = &[
    // Ready and not ready; turns every 5 ms; damaged settings; moving fingers.
    "01 01 03 09 11 00",
    // Images: zeros, motions, a stop, a FAST STOP, a jog with its parameters, some in one millisecond; edges. By both masters.
    "0A00000400 0A01000400 4A02010400 0A05000400 0A06000400 0A07000400 0A07010400 8A00000400 CA01000400 8A02010400 8A06000400 \
     0E0001 0E0002 0E0004 0E0005 0E0107 8E0001 8E0006",
    // A coil, mask writes, reads by both masters.
    "0C0001010400 0C0001000400 0D00020400 0D080000030400 8D080000030400",
    // Settings: BUS_TIMEOUT, BUS_REACTION, DEBOUNCE, SWAP_BYTES, recipes and their use; SAVE, RESTORE, DEFAULTS; reads.
    "0B0001FA0400 0B0001000400 0B0002020400 0B0002010400 0B00060A0400 0B0005010400 1B0003010400 9B0003000400 2B00030400 2B00100400 \
     3B00000400 3B00010400 3B00020400 2B8000510400",
    // Pauses, late turns, lost connections to the gripper with and without its FAST STOP, the end of a master's connection, also
    // during a jog that the other one has changed or only read.
    "080000 080040 080128 0801C8 08023F 080605 8802FF 080300 880300 0E000707058A07000400080300 0E000707058A07000400880300 \
     0E000707058D080000030400880300080300",
    // Images of the cyclic masters: zeros, motions, stops, FAST STOPs and jogs, also while others write; their ends.
    "1A0000 1A0100 1A0201 1A0500 1A0600 5A0700 1A0701 1A0800 9A0000 9A0100 9A0600 DA0700 1A00001A0100 1A00001A0700 9A00009A0201 \
     1A01000E00001A0101 1A06009A00000A0000 0400 1A07000E00001A0800 1A05000E00001A0A00 2A AA \
     1A00001A07000FFF1A07000FFF1A07000FFF1A07000FFF1A07000FFF",
];

/// Ops of the body `storage`: contents of pages and operations on them.
pub(super) const STORAGE: &[&str] = &[
    // Complete records in both pages: at the start, after another, at the end, too long for the store.
    "010008010007 810008020007 010310050007 81FD08060007 0120E0090007",
    // Only first double words.
    "0003A508000100090000 8000A5C8000100FFFF01",
    // Unreadable double words, and pages of a single value.
    "0200 8204 0300 8301 0302 8303",
    // Saves, and power failures during them: at the start, in the first and last double word after an erase.
    "050108 0502C8 0400060108 0401030108 0403050108",
];

/// Pieces of text lines.
#[rustfmt::skip]
pub(super) const TEXT: &[&str] = &[
    "\n", "\r\n", "()", "(", ")", "?", "=", ",", " ", "[", "]", "\"", "@", "ACK ", "FIN ", "ERR ",
    "MOVE", "GRIP", "RELEASE", "HOME", "POS", "FORCE", "AUTOSEND", "GRIPSTATE", "SYSFLAGS", "DATA",
    "FTYPE", "VERSION", "GRIPSTATS", "20.0", "-1.5e3", "0", "7", "true", "E_TIMEOUT", "WSG 50",
    "MOVE(50)\n", "ACK MOVE\n", "@POS=31.25\n",
];

/// Maximum length of an input.
const LONGEST: usize = 96;

/// Returns the input with this number, composed of these pieces and random bytes.
#[must_use]
pub fn generated(number: u32, pieces: &[Vec<u8>]) -> Vec<u8> {
    let mut random = Chance::new(u64::from(number) << 32);
    let length = random.below(LONGEST as u64 + 1) as usize;
    // The ratio of random bytes to pieces varies between inputs.
    let chance = random.below(5);
    let mut bytes = Vec::with_capacity(length + 4);
    while bytes.len() < length {
        if random.below(5) < chance {
            bytes.push(random.below(256) as u8);
        } else {
            bytes.extend_from_slice(&pieces[random.below(pieces.len() as u64) as usize]);
        }
    }
    bytes.truncate(length);
    bytes
}
