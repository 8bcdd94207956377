//! The two images as tables of coils and registers (fieldbus, chapter 4, with the byte order of `docs/decisions.md`).
//!
//! `bus_modbus` provides the MODBUS server.

use core::hash::{Hash, Hasher};

use bus_modbus::{Bits, Exception, Words};

use super::registers::{INPUT_REGISTERS, OUTPUT_REGISTERS, Register};
use super::{InputImage, OutputImage};

/// The output image as coils and holding registers, the input image as discrete inputs and input registers, each from
/// address 0.
///
/// - Register n holds bytes 2n and 2n + 1 of its image, the first as its high byte.
/// - Coil or discrete input n is bit n mod 8 of byte n div 8, over the whole image. So coil 0 (MOVE) is bit 8 of register 0.
/// - `swap_bytes` reverses the two bytes of each number, for a PLC that follows the manual's "low byte first"
///   literally. Bit vectors keep their order.
///
/// A write changes the image atomically; [`take_written`](Self::take_written) returns it once.
///
/// ```
/// use bus_modbus::Words;
/// use wsg_fieldbus::{CommandFlags, Images};
///
/// let mut images = Images::new(false);
/// // The manual's example: MOVE and IF6 are register 0 = 288.
/// images.write_registers(0, Words::new(&288u16.to_be_bytes())).unwrap();
/// assert_eq!(images.coil(0), Ok(true));
/// assert_eq!(images.coil(13), Ok(true), "IF6");
/// let image = images.take_written().unwrap();
/// assert_eq!((image.flags, image.user), (CommandFlags::MOVE, 1 << 5));
/// assert_eq!(images.take_written(), None);
/// ```
#[derive(Clone, Debug)]
pub struct Images {
    swap_bytes: bool,
    /// In transmission order: swapped if `swap_bytes` is set.
    output: [u8; OutputImage::LEN],
    input: [u8; InputImage::LEN],
    written: bool,
}

/// Excludes the input image, which is updated before each request.
impl Hash for Images {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { swap_bytes, output, input: _, written } = self;
        (swap_bytes, output, written).hash(state);
    }
}

impl Images {
    /// Number of coils, one for each bit of the output image.
    pub const COILS: u16 = 8 * OutputImage::LEN as u16;
    /// Number of discrete inputs, one for each bit of the input image.
    pub const DISCRETE_INPUTS: u16 = 8 * InputImage::LEN as u16;

    /// Creates two images of zeros.
    #[must_use]
    pub const fn new(swap_bytes: bool) -> Self {
        Self { swap_bytes, output: [0; OutputImage::LEN], input: [0; InputImage::LEN], written: false }
    }

    /// Sets whether numbers are swapped. The meaning of both images stays the same.
    pub fn set_swap_bytes(&mut self, swap_bytes: bool) {
        if self.swap_bytes != swap_bytes {
            swap_numbers(&mut self.output, &OUTPUT_REGISTERS);
            swap_numbers(&mut self.input, &INPUT_REGISTERS);
            self.swap_bytes = swap_bytes;
        }
    }

    /// Sets the input image to serve.
    pub fn set_input(&mut self, image: &InputImage) {
        self.input = image.to_bytes();
        if self.swap_bytes {
            swap_numbers(&mut self.input, &INPUT_REGISTERS);
        }
    }

    /// Sets the output image to serve, for a server that shows the image written to another one. It does not count as written.
    ///
    /// ```
    /// use wsg_fieldbus::{Images, OutputImage};
    ///
    /// let mut images = Images::new(false);
    /// images.set_output(&OutputImage { width: 12_20, ..OutputImage::ZERO });
    /// assert_eq!(images.holding_register(1), Ok(12_20));
    /// assert_eq!(images.take_written(), None);
    /// ```
    pub fn set_output(&mut self, image: &OutputImage) {
        self.output = image.to_bytes();
        if self.swap_bytes {
            swap_numbers(&mut self.output, &OUTPUT_REGISTERS);
        }
    }

    /// Returns the last written output image.
    #[must_use]
    pub fn output(&self) -> OutputImage {
        let mut bytes = self.output;
        if self.swap_bytes {
            swap_numbers(&mut bytes, &OUTPUT_REGISTERS);
        }
        OutputImage::from_bytes(bytes)
    }

    /// Returns the output image if a request has written to it since the last call. Call this after each request,
    /// because an edge that one request makes and the next one reverts would be lost.
    pub fn take_written(&mut self) -> Option<OutputImage> {
        core::mem::take(&mut self.written).then(|| self.output())
    }

    /// Returns the coil at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] beyond the last coil.
    pub fn coil(&self, address: u16) -> Result<bool, Exception> {
        bit(&self.output, address)
    }

    /// Returns the discrete input at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] beyond the last input.
    pub fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        bit(&self.input, address)
    }

    /// Returns the holding register at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] beyond the last register.
    pub fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        word(&self.output, address)
    }

    /// Returns the input register at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] beyond the last register.
    pub fn input_register(&self, address: u16) -> Result<u16, Exception> {
        word(&self.input, address)
    }

    /// Writes coils, starting at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] if one of them does not exist; then none is written.
    pub fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        let mut bytes = self.output;
        for (n, value) in (usize::from(first)..).zip(values.iter()) {
            let byte = bytes.get_mut(n / 8).ok_or(Exception::IllegalDataAddress)?;
            let mask = 1 << (n % 8);
            *byte = if value { *byte | mask } else { *byte & !mask };
        }
        self.accept(bytes);
        Ok(())
    }

    /// Writes holding registers, starting at this address.
    ///
    /// # Errors
    /// [`Exception::IllegalDataAddress`] if one of them does not exist; then none is written.
    pub fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        let mut bytes = self.output;
        let (pairs, _) = bytes.as_chunks_mut();
        for (n, value) in (usize::from(first)..).zip(values.iter()) {
            *pairs.get_mut(n).ok_or(Exception::IllegalDataAddress)? = value.to_be_bytes();
        }
        self.accept(bytes);
        Ok(())
    }

    fn accept(&mut self, bytes: [u8; OutputImage::LEN]) {
        self.output = bytes;
        self.written = true;
    }
}

fn bit(bytes: &[u8], address: u16) -> Result<bool, Exception> {
    let byte = bytes.get(usize::from(address / 8)).ok_or(Exception::IllegalDataAddress)?;
    Ok(byte & (1 << (address % 8)) != 0)
}

fn word(bytes: &[u8], address: u16) -> Result<u16, Exception> {
    let pair = bytes.as_chunks().0.get(usize::from(address));
    pair.map(|pair| u16::from_be_bytes(*pair)).ok_or(Exception::IllegalDataAddress)
}

/// Reverses the bytes of each register that is a number.
fn swap_numbers(bytes: &mut [u8], registers: &[Register]) {
    let (pairs, _) = bytes.as_chunks_mut::<2>();
    for (pair, register) in pairs.iter_mut().zip(registers) {
        if register.content.is_number() {
            pair.reverse();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CommandFlags, GripperFlags};
    use wsg_protocol::types::{Status, SystemFlags};

    const INPUT: InputImage = InputImage {
        state: GripperFlags::IDLE,
        user: 1,
        system: SystemFlags::REFERENCED,
        width: 1220,
        force: 405,
        status: Status::CmdPending,
    };

    const OUTPUT: OutputImage =
        OutputImage { flags: CommandFlags::MOVE, user: 0x20, width: 1220, speed: 50_00, force_limit: 40_00 };

    #[test]
    fn registers_hold_the_image_byte_0_first() {
        let mut images = Images::new(false);
        images.set_input(&INPUT);
        let registers = [0, 1, 2, 3, 4, 5].map(|address| images.input_register(address).unwrap());
        // A master that reads SYSSTATE as one 32-bit value sees REFERENCED as 01000000h.
        assert_eq!(registers, [0x0101, 0x0100, 0x0000, 1220, 405, 26]);
        assert_eq!(images.input_register(6), Err(Exception::IllegalDataAddress));
    }

    #[test]
    fn bits_count_from_byte_0_bit_0_over_the_whole_image() {
        let mut images = Images::new(false);
        images.set_input(&INPUT);
        let bytes = INPUT.to_bytes();
        for n in 0..Images::DISCRETE_INPUTS {
            let expected = bytes[usize::from(n / 8)] >> (n % 8) & 1 == 1;
            assert_eq!(images.discrete_input(n), Ok(expected), "{n}");
        }
        let set = (0..Images::DISCRETE_INPUTS).filter(|n| images.discrete_input(*n) == Ok(true));
        assert!(set.take(3).eq([0, 8, 16]), "IDLE, OF1, REFERENCED");
        assert_eq!(images.discrete_input(96), Err(Exception::IllegalDataAddress));
        assert_eq!(images.coil(64), Err(Exception::IllegalDataAddress));
    }

    #[test]
    fn swap_bytes_reverses_numbers_and_leaves_bits() {
        let mut images = Images::new(true);
        images.set_input(&INPUT);
        let registers = [0, 1, 2, 3, 4, 5].map(|address| images.input_register(address).unwrap());
        assert_eq!(registers, [0x0101, 0x0100, 0x0000, 0xC404, 0x9501, 0x1A00]);
        images.write_registers(0, Words::new(&[0x01, 0x20, 0xC4, 0x04, 0x88, 0x13, 0xA0, 0x0F])).unwrap();
        assert_eq!(images.take_written(), Some(OUTPUT));
        images.set_swap_bytes(false);
        assert_eq!(images.output(), OUTPUT, "the meaning stays");
        assert_eq!(images.holding_register(1), Ok(1220));
        assert_eq!(images.input_register(3), Ok(1220));
    }

    #[test]
    fn write_that_reaches_past_the_end_writes_nothing() {
        let mut images = Images::new(false);
        assert_eq!(images.write_registers(3, Words::new(&[1; 4])), Err(Exception::IllegalDataAddress));
        assert_eq!(images.write_coils(60, Bits::new(&[0xFF], 5)), Err(Exception::IllegalDataAddress));
        assert_eq!(images.take_written(), None);
        assert_eq!(images.output(), OutputImage::ZERO);
    }

    #[test]
    fn coils_that_are_written_leave_their_neighbours() {
        let mut images = Images::new(false);
        images.write_registers(0, Words::new(&[0x02, 0xFF])).unwrap();
        images.write_coils(1, Bits::new(&[0b0000_0010, 0b11], 10)).unwrap();
        let image = images.take_written().unwrap();
        assert_eq!((image.flags, image.user), (CommandFlags::RELEASE, 0xFE));
        images.write_coils(13, Bits::new(&[0], 1)).unwrap();
        assert_eq!(images.take_written().map(|image| image.user), Some(0xFE & !(1 << 5)));
    }

    #[test]
    fn write_is_handed_over_once() {
        let mut images = Images::new(false);
        assert_eq!(images.take_written(), None);
        images.write_registers(0, Words::new(&[0x02, 0, 0x07, 0xD0, 0x13, 0x88, 0x0F, 0xA0])).unwrap();
        let image = OutputImage {
            flags: CommandFlags::GRIP,
            user: 0,
            width: 20_00,
            speed: 50_00,
            force_limit: 40_00,
        };
        assert_eq!(images.take_written(), Some(image));
        assert_eq!(images.take_written(), None);
        assert_eq!(images.output(), image, "it stays to be read");
    }

    #[test]
    fn shown_output_image_reads_like_a_written_one_but_is_not_taken() {
        for swap_bytes in [false, true] {
            let mut written = Images::new(swap_bytes);
            let width = if swap_bytes { [0xC4, 0x04] } else { [0x04, 0xC4] };
            written.write_registers(1, Words::new(&width)).unwrap();
            let mut shown = Images::new(swap_bytes);
            shown.set_output(&OUTPUT);
            assert_eq!(shown.holding_register(1), written.holding_register(1));
            assert_eq!(shown.output(), OUTPUT);
            assert_eq!(shown.take_written(), None);
        }
    }

    #[test]
    fn images_have_eight_bits_per_byte_and_no_address_beyond() {
        assert_eq!((Images::COILS, Images::DISCRETE_INPUTS), (64, 96));
        let images = Images::new(false);
        for last in [images.coil(Images::COILS - 1), images.discrete_input(Images::DISCRETE_INPUTS - 1)] {
            assert_eq!(last, Ok(false));
        }
        for next in [images.coil(Images::COILS), images.discrete_input(Images::DISCRETE_INPUTS)] {
            assert_eq!(next, Err(Exception::IllegalDataAddress));
        }
    }
}
