//! Inputs for the run on stable Rust: the same ones every time.

use crate::chance::Chance;

/// What generated inputs for a body are made of.
#[derive(Clone, Copy)]
pub enum Pieces {
    /// Groups of bytes in hexadecimal, with blanks between the pieces.
    Hex(&'static [&'static [&'static str]]),
    /// Text as it is.
    Text(&'static [&'static str]),
}

impl Pieces {
    /// One by one.
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

/// What the binary protocol is made of.
pub(super) const BINARY: &[&str] = &["AAAAAA AA 00 0000 01 FF 1A00 20 250800 400600 0000A041 61636B"];

/// What controllers, the application and time do to an IO device: ops of the body `profinet`.
pub(super) const PROFINET: &[&str] = &[
    // Connected, parameters ended, confirmed: whole, and by another one; for records alone.
    "03000100040000060000 03000100 03010100 03010000 040000 060000",
    // Damaged ones.
    "030001C20050FF007000 030001F00100 0400C1001D02",
    // Time: a cycle, the silence that ends it, more.
    "0020 0060 00FF",
    // Outputs, of another one, bad ones, old ones.
    "0701020304050607080100 0708070605040302011000 07010101010101010101C1001800 07010101010101010101C1003A25",
    // Faults, and what a controller says of their alarms.
    "01AA05 015500 0A000101000100 0A000000000100 0A010000000100 0A000300000100",
    // Records; a release.
    "090000000000 0900000F0000 090002120040 050000",
    // DCP: all, name, address, reset.
    "02000004FFFF000000 02020008020200040001616200 020200120102000E00010A000005FF0000000000000000 \
     0202000605060002000400 020100040202010200",
    // Where is what.
    "0D0228",
];

/// What masters, the application and time do to a DP slave: ops of the body `profibus`.
pub(super) const PROFIBUS: &[&str] = &[
    // Taken by a master; time; inputs and a diagnosis.
    "03 0164 01C8 0037AABB031000",
    // Data_Exchange as SD3 and as SD2, none, too short, repeated, of another master.
    "04FF0000000102030405060708000F00 04FF0000000807060504030201010F00 04FF000004000F00 \
     04FF00000501020304050607000F00 044F0000000909090909090909000F00 04FF0200000909090909090909000F00",
    // Set_Prm, Chk_Cfg, Global_Control, Set_Slave_Address, Slave_Diag, FDL_Status.
    "04FF0003010001050B000100010F00 04FF00040000010F00 04FF0005000200010F00 04FF0005002800010F00 \
     04FF0005001400010F00 04FF000701000000010F00 04FF00090000010F00 043F000004000F00",
];

/// What the wires do in each body of the whole bridge.
pub(super) const WIRES: &[&str] = &[
    // Wires: FAST_STOP_OK alone, none, STOP_ACK, a motion, time to settle.
    "00200706 00000704 00300704 02000704 0202 0203",
    // Edges of them: GRIP by two recipes, MOVE, RELEASE, STOP_ACK, a FAST STOP, one that is acknowledged.
    "0200070300200703 00A1070300200703 0202070300200703 0201070300200703 0030070300200703 0000070200200706 \
     00000702002007060030070300200703",
];

/// What its gripper does there, and time.
pub(super) const GRIPPER: &[&str] = &[
    // A gripper that answers no more, or again; late; one answer twice, none, refused; one command unheard, and for long.
    "0600 0601 060396 06050832 060764C802 0605D800 060BCC0000F000 06071EE000 0605EC00 0605F000 060764F000 \
     060900F0F000 0605FE00",
    // One that finds no part, is not referenced, too hot, in FAST STOP, moves.
    "06130C 0621 0631 0671 068302",
    // Time.
    "0705 071F 0F80 0FC8 FF",
];

/// What begins a case of the body `bridge`, and what its PLC does.
pub(super) const BRIDGE: [&[&str]; 2] = [
    &[
        // Ready, and not; a strict bus with broadcasts; a slow line; damaged settings; fingers that move.
        "01 03 05 09 10 15 00",
    ],
    &[
        // Images by the bus: zeros, motions, a stop, a FAST STOP, a jog and its dial.
        "0A00000400 0A01000400 0A02010400 0A05000400 0A06008400 0A07000400 0A07010400 0E0001 0E0002 0E0004 \
         0E0005 0E0107",
        // One coil, a mask, settings: BUS_TIMEOUT, BUS_REACTION, DEBOUNCE.
        "0C0001010400 0C0001000400 0D00020400 0B0040010400 0B0002020400 0B000A060400",
        // By bus and service port: recipes, BUS_RECIPE, SAVE, RESTORE, DEFAULTS, some without time behind them; a look at settings.
        "2B0003010400 AB0003000400 AB0000010400 4B00030400 CB00030400 CB00100400 6B00000400 EB00008400 \
         EB00010400 6B00028400 EB00020400 CB0080510400 4B0080510400",
        // A recipe and what it is for; what is saved, changed, restored and read; another UNIT, and a look at it.
        "AB00050104004B000504000E0002 2B0004000400CB000404000E0003 CB000304000E0001 4B000304006B000004000F3C \
         CB000204006B00010400CB00CD000400 8B00000504008D0800030400",
        // By the service port: DEBOUNCE, MIN_BUSY, UNIT, BUS_CHAR_TIMEOUT, SWAP_BYTES, an image, a coil, a mask, a look at the image.
        "8B00060A0400 8B0007C80400 8B0000050400 8B0003000400 8B0005010400 8A01000400 8C0001010400 8D00020400 \
         8D0800030400",
        // Bytes that are no ops.
        "AAAAAA",
    ],
];

/// The same of the body `bridge_can`.
pub(super) const BRIDGE_CAN: [&[&str]; 2] = [
    &[
        // Ready, and not; the gripper on RS-232; fingers that move.
        "01 03 10 13 00",
    ],
    &[
        // RPDOs: zeros, motions, a stop, a FAST STOP, a jog and its dial; one with a wrong length.
        "040000 040100 840201 040500 040600 040700 840701 050001 050002 050004 050005 050107 0E0207",
        // NMT: start, stop, pre-operational, both resets; heartbeat and boot-up of the master.
        "080000 080100 880201 880300 080400 090000 090001",
        // SDO: BUS_TIMEOUT, DEBOUNCE, the master's heartbeat.
        "0A004000 0A020A00 0A03400201",
        // Remote frame and 29-bit frame with an RPDO's identifier.
        "0308000001 03110000010100D0078813A00F",
        // Trouble: bus-off, overrun, nobody who acknowledges, a controller that refuses; none.
        "0D0000 0D01 0D0201 0D0401 0D07",
    ],
];

/// The same of the body `bridge_profibus`.
pub(super) const BRIDGE_PROFIBUS: [&[&str]; 2] = [
    &[
        // Ready, and not; an echo; fingers that move.
        "01 03 11 00",
    ],
    &[
        // Outputs: zeros, motions, a stop, a FAST STOP, a jog and its dial, some without time behind them; of a second master.
        "080000000F0000 880100000F0000 080201000F0000 080500000F0000 880600000F0000 880000000F0000 \
         080700000F0000 080701000F0000 080200030F0000 08020000020005 08020000030005 090001 090002 090004 \
         090005 090107",
        // Parameters and configuration: without a watchdog, with a short and a long one, late answers, of a second master.
        "0A00000B 0A05000B 0AC800C8 0A14030B",
        // Unlock, wrong ident and configuration, Slave_Diag, a service that is none.
        "0B000200000000000F0000 0B0000140B0200000F0000 0B0101000F0000 0B0400000F0000 8B0325000000000F0000",
        // Clear, Sync, to all and by group; the same again, no outputs, too few; FDL_Status.
        "0C000000000F0000 8C000001000F0000 0C000200000F0000 0D000F0000 0D01000F0000 0D0200000F0000 8E0000",
        // Noise; a master that speaks into an answer.
        "0503001000FF00006800 8B000014C80001000F00008E0000",
    ],
];

/// What pages hold and what is done with them: ops of the body `storage`.
pub(super) const STORAGE: &[&str] = &[
    // Whole records in both pages: at the begin, after another, at the end, too long for the store.
    "010008010007 810008020007 010310050007 81FD08060007 0120E0090007",
    // First double words alone.
    "0003A508000100090000 8000A5C8000100FFFF01",
    // Unreadable ones, and pages of one value.
    "0200 8204 0300 8301 0302 8303",
    // Saves, and the power cut in them: at the begin, in the first and the last double word after an erase.
    "050108 0502C8 0400060108 0401030108 0403050108",
];

/// What lines of text are made of.
#[rustfmt::skip]
pub(super) const TEXT: &[&str] = &[
    "\n", "\r\n", "()", "(", ")", "?", "=", ",", " ", "[", "]", "\"", "@", "ACK ", "FIN ", "ERR ",
    "MOVE", "GRIP", "RELEASE", "HOME", "POS", "FORCE", "AUTOSEND", "GRIPSTATE", "SYSFLAGS", "DATA",
    "FTYPE", "VERSION", "GRIPSTATS", "20.0", "-1.5e3", "0", "7", "true", "E_TIMEOUT", "WSG 50",
    "MOVE(50)\n", "ACK MOVE\n", "@POS=31.25\n",
];

/// The longest input.
const LONGEST: usize = 96;

/// The input of this number, made of chance and of these pieces.
#[must_use]
pub fn generated(number: u32, pieces: &[Vec<u8>]) -> Vec<u8> {
    let mut random = Chance::new(u64::from(number) << 32);
    let length = random.below(LONGEST as u64 + 1) as usize;
    // Inputs of pure chance, and of pieces: the mixture changes from one to the next.
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
