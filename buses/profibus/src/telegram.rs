//! FDL telegrams as bytes (EN 50170-2, part 4; IEC 61158-4-3): delimiters, addresses, function codes, check sum.

/// Start delimiters of request and answer telegrams, and of the token (SD4).
pub(crate) const SD1: u8 = 0x10;
pub(crate) const SD2: u8 = 0x68;
pub(crate) const SD3: u8 = 0xA2;
pub(crate) const SD4: u8 = 0xDC;
/// End delimiter of SD1, SD2 and SD3.
pub(crate) const ED: u8 = 0x16;
/// Short acknowledgement: a complete telegram of one character.
pub(crate) const SC: u8 = 0xE5;

/// Lengths of the fixed-length telegrams, in bytes.
pub(crate) const SD1_LEN: usize = 6;
pub(crate) const SD3_LEN: usize = 14;
pub(crate) const SD4_LEN: usize = 3;

/// Number of bytes before the destination address: the start delimiter; for SD2 also the length
/// twice and the delimiter again.
const HEAD_LEN: usize = 1;
pub(crate) const SD2_HEAD_LEN: usize = 4;
/// Number of bytes after the data: check sum and end delimiter.
pub(crate) const TAIL_LEN: usize = 2;

/// Valid LE of an SD2 telegram: destination, source, function code, and 1 to 246 bytes of data.
pub(crate) const LE: core::ops::RangeInclusive<u8> = 4..=249;

/// Maximum length of a telegram in bytes.
pub(crate) const MAX_TELEGRAM_LEN: usize = SD2_HEAD_LEN + MAX_BODY_LEN + TAIL_LEN;
const MAX_BODY_LEN: usize = *LE.end() as usize;

/// Flag in an address: the data starts with a service access point.
const EXTENSION: u8 = 0x80;

/// Destination address of broadcasts, not a valid station.
pub(crate) const BROADCAST: u8 = 127;

/// Flag in a function code: request.
const REQUEST: u8 = 0x40;
/// Includes the flag of clock synchronisation, which is not a request.
const REQUEST_MASK: u8 = 0xC0;
const FCB: u8 = 1 << 5;
const FCV: u8 = 1 << 4;

/// Function codes of answers from a passive station: positive.
pub(crate) const OK: u8 = 0x00;
/// Negative: no service activated (RS).
pub(crate) const NO_SERVICE: u8 = 0x03;
/// Low-priority data (DL).
pub(crate) const DATA_LOW: u8 = 0x08;
/// High-priority data (DH).
pub(crate) const DATA_HIGH: u8 = 0x0A;

/// Function codes of requests, as far as DP distinguishes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Function {
    /// Send Data with No acknowledge.
    Sdn,
    /// Send and Request Data.
    Srd,
    FdlStatus,
    /// Send Data with Acknowledge, Ident or LSAP status: requires an answer, but DP does not use it.
    Unserved,
}

/// An intact telegram with start delimiter 1, 2 or 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Telegram<'a> {
    pub(crate) destination: u8,
    pub(crate) source: u8,
    function_code: u8,
    /// Destination service access point, if present.
    pub(crate) dsap: Option<u8>,
    /// Source service access point, if present.
    pub(crate) ssap: Option<u8>,
    pub(crate) data: &'a [u8],
}

impl<'a> Telegram<'a> {
    /// Parses a telegram whose length matches its start delimiter. Returns `None` if check sum
    /// or end delimiter are wrong.
    pub(crate) fn parse(bytes: &'a [u8]) -> Option<Self> {
        let head_len = if bytes.first() == Some(&SD2) { SD2_HEAD_LEN } else { HEAD_LEN };
        let (body, tail) = bytes.get(head_len..)?.split_last_chunk::<TAIL_LEN>()?;
        if *tail != [check_sum(body), ED] {
            return None;
        }
        let &[destination, source, function_code, ref data @ ..] = body else { return None };
        let (dsap, data) = service_access_point(destination, data)?;
        let (ssap, data) = service_access_point(source, data)?;
        let (destination, source) = (destination & !EXTENSION, source & !EXTENSION);
        Some(Self { destination, source, function_code, dsap, ssap, data })
    }

    /// Returns the function of a request; `None` for answers, clock synchronisation and reserved codes.
    pub(crate) const fn function(&self) -> Option<Function> {
        if self.function_code & REQUEST_MASK != REQUEST {
            return None;
        }
        match self.function_code & 0x0F {
            4 | 6 => Some(Function::Sdn),
            12 | 13 => Some(Function::Srd),
            9 => Some(Function::FdlStatus),
            3 | 5 | 14 | 15 => Some(Function::Unserved),
            _ => None,
        }
    }

    /// Returns the frame count bit.
    pub(crate) const fn fcb(&self) -> bool {
        self.function_code & FCB != 0
    }

    /// Returns the frame count valid bit. If set, the request may be a repetition.
    pub(crate) const fn fcv(&self) -> bool {
        self.function_code & FCV != 0
    }
}

/// Splits off the service access point at the start of the data, if the address flags one. `None` if it is missing.
fn service_access_point(address: u8, data: &[u8]) -> Option<(Option<u8>, &[u8])> {
    if address & EXTENSION == 0 {
        return Some((None, data));
    }
    let (&point, rest) = data.split_first()?;
    Some((Some(point), rest))
}

fn check_sum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// Returns an answer without data.
pub(crate) const fn sd1(destination: u8, source: u8, function_code: u8) -> [u8; SD1_LEN] {
    let sum = destination.wrapping_add(source).wrapping_add(function_code);
    [SD1, destination, source, function_code, sum, ED]
}

/// Writes an SD2 telegram with optional service access points, then `data`; at most 246 bytes
/// in total. Returns its length.
pub(crate) fn write_sd2(
    bytes: &mut [u8; MAX_TELEGRAM_LEN],
    [destination, source, function_code]: [u8; 3],
    points: Option<[u8; 2]>,
    data: [&[u8]; 2],
) -> usize {
    let extension = if points.is_some() { EXTENSION } else { 0 };
    let addresses = [destination | extension, source | extension, function_code];
    let points = points.as_ref().map_or(&[][..], |points| points);
    let [first, second] = data;
    let [h0, h1, h2, h3, body @ .., _, _] = bytes;
    let (mut len, mut sum) = (0u8, 0u8);
    let mut places = body.iter_mut();
    for part in [&addresses[..], points, first, second] {
        for (byte, place) in part.iter().zip(&mut places) {
            *place = *byte;
            sum = sum.wrapping_add(*byte);
            len = len.wrapping_add(1);
        }
    }
    (*h0, *h1, *h2, *h3) = (SD2, len, len, SD2);
    let end = usize::from(len).saturating_add(SD2_HEAD_LEN);
    if let Some(tail) = bytes.get_mut(end..).and_then(|rest| rest.first_chunk_mut::<TAIL_LEN>()) {
        *tail = [sum, ED];
    }
    end.saturating_add(TAIL_LEN)
}

/// The body fills the space between head and tail, so its length is always a valid LE.
const _: () = assert!(MAX_TELEGRAM_LEN == 255 && MAX_BODY_LEN == 249);
