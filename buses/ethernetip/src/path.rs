//! Padded paths (volume 1, appendix C): segments, the target of a request, and electronic keys.

use crate::cursor::Reader;
use crate::profile::{Profile, Status};

/// A segment of a path. Logical segments have 8, 16 or 32 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Segment<'a> {
    Class(u32),
    Instance(u32),
    Point(u32),
    Attribute(u32),
    Key(Key),
    Data(&'a [u8]),
}

/// Iterates over the segments of a path. A malformed or unsupported one is `None`; nothing valid follows it.
#[derive(Clone, Debug)]
pub(crate) struct Segments<'a>(Reader<'a>);

impl<'a> Segments<'a> {
    pub(crate) const fn new(path: &'a [u8]) -> Self {
        Self(Reader::new(path))
    }

    fn segment(&mut self) -> Option<Segment<'a>> {
        let reader = &mut self.0;
        let kind = reader.u8()?;
        let value = match kind {
            0x80 => {
                let words = reader.u8()?;
                return reader.bytes(usize::from(words).saturating_mul(2)).map(Segment::Data);
            }
            0x34 => {
                let is_usual = reader.u8()? == 4;
                let (vendor, device_type, product_code) = (reader.u16()?, reader.u16()?, reader.u16()?);
                let key = Key { vendor, device_type, product_code, revision: reader.array()? };
                return is_usual.then_some(Segment::Key(key));
            }
            // 16 and 32 bits follow a pad byte.
            0x20..=0x33 => match (kind & 3, reader.u8()?) {
                (0, value) => value.into(),
                (1, _) => reader.u16()?.into(),
                (2, _) => reader.u32()?,
                _ => return None,
            },
            _ => return None,
        };
        match kind & 0xFC {
            0x20 => Some(Segment::Class(value)),
            0x24 => Some(Segment::Instance(value)),
            0x2C => Some(Segment::Point(value)),
            0x30 => Some(Segment::Attribute(value)),
            _ => None,
        }
    }
}

impl<'a> Iterator for Segments<'a> {
    type Item = Option<Segment<'a>>;

    fn next(&mut self) -> Option<Self::Item> {
        (!self.0.rest().is_empty()).then(|| self.segment())
    }
}

/// An electronic key: the device that an originator expects. Zeros match any device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    vendor: u16,
    device_type: u16,
    product_code: u16,
    /// Compatibility bit and major revision, minor revision.
    revision: [u8; 2],
}

impl Key {
    /// Returns the extended status of a connection for another device.
    pub(crate) fn mismatch(&self, profile: &Profile) -> Option<u16> {
        let differs = |key: u16, own: u16| key != 0 && key != own;
        let ([flags, minor], [own_major, own_minor]) = (self.revision, profile.revision);
        let major = flags & 0x7F;
        let is_minor_right =
            if flags & 0x80 != 0 { own_minor >= minor } else { minor == 0 || minor == own_minor };
        if differs(self.vendor, profile.vendor_id) || differs(self.product_code, profile.product_code) {
            Some(0x0114)
        } else if differs(self.device_type, profile.device_type) {
            Some(0x0115)
        } else if major != 0 && (major != own_major || !is_minor_right) {
            Some(0x0116)
        } else {
            None
        }
    }
}

/// Target of a request: an attribute, an instance, or instance 0, which stands for the class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Target {
    pub(crate) class: u32,
    pub(crate) instance: u32,
    pub(crate) attribute: Option<u32>,
}

impl Target {
    /// Parses a path: an optional key, a class, an instance, an attribute.
    pub(crate) fn parse(path: &[u8], profile: &Profile) -> Result<Self, Status> {
        let (mut class, mut instance, mut attribute) = (None, None, None);
        for segment in Segments::new(path) {
            match (segment.ok_or(Status::PathSegment)?, class, instance, attribute) {
                (Segment::Key(key), None, ..) => {
                    if key.mismatch(profile).is_some() {
                        return Err(Status::KeyFailure);
                    }
                }
                (Segment::Class(value), None, ..) => class = Some(value),
                (Segment::Instance(value) | Segment::Point(value), Some(_), None, None) => {
                    instance = Some(value);
                }
                (Segment::Attribute(value), Some(_), _, None) => attribute = Some(value),
                _ => return Err(Status::PathSegment),
            }
        }
        let class = class.ok_or(Status::PathSegment)?;
        Ok(Self { class, instance: instance.unwrap_or(0), attribute })
    }
}
