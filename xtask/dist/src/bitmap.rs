//! The gripper's picture for engineering tools: a device-independent bitmap (DIB) of 70 x 40 pixels and 16 colours,
//! as the specifications of GSD and GSDML files require.

const WIDTH: usize = 70;
const HEIGHT: usize = 40;
/// Two pixels per byte; rows are aligned to four bytes.
const ROW_LEN: usize = (WIDTH / 2).next_multiple_of(4);
const HEADERS_LEN: usize = 14 + 40 + 16 * 4;
const LEN: usize = HEADERS_LEN + ROW_LEN * HEIGHT;

/// The 16 VGA colours: red, green, blue.
const PALETTE: [[u8; 3]; 16] = [
    [0, 0, 0],
    [0x80, 0, 0],
    [0, 0x80, 0],
    [0x80, 0x80, 0],
    [0, 0, 0x80],
    [0x80, 0, 0x80],
    [0, 0x80, 0x80],
    [0xC0, 0xC0, 0xC0],
    [0x80, 0x80, 0x80],
    [0xFF, 0, 0],
    [0, 0xFF, 0],
    [0xFF, 0xFF, 0],
    [0, 0, 0xFF],
    [0xFF, 0, 0xFF],
    [0, 0xFF, 0xFF],
    [0xFF, 0xFF, 0xFF],
];
const BLACK: u8 = 0;
const TEAL: u8 = 6;
const SILVER: u8 = 7;
const GREY: u8 = 8;
const WHITE: u8 = 15;

/// Colour of the device's lamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lamp {
    /// Normal operation.
    Green = 10,
    /// Diagnosis.
    Red = 9,
    /// Special operating mode.
    Yellow = 11,
}

/// Returns the bitmap: two fingers holding a part, above a housing with a lamp.
pub(crate) fn gripper(lamp: Lamp) -> Vec<u8> {
    // Left, top, right, bottom, colour; later boxes cover earlier ones.
    let boxes = [
        (0, 0, WIDTH, HEIGHT, WHITE),
        (26, 7, 44, 19, TEAL),
        (18, 3, 26, 24, SILVER),
        (44, 3, 52, 24, SILVER),
        (18, 3, 20, 24, GREY),
        (50, 3, 52, 24, GREY),
        (8, 22, 62, 26, BLACK),
        (14, 26, 56, 38, GREY),
        (16, 28, 54, 36, SILVER),
        (44, 30, 50, 34, lamp as u8),
    ];
    let mut bitmap = headers();
    // Bottom row first.
    for y in (0..HEIGHT).rev() {
        let colour = |x: usize| {
            let covers = |(left, top, right, bottom, _): &&(usize, usize, usize, usize, u8)| {
                (*left..*right).contains(&x) && (*top..*bottom).contains(&y)
            };
            boxes.iter().rev().find(covers).map_or(WHITE, |(.., colour)| *colour)
        };
        let row = (0..WIDTH).step_by(2).map(|x| colour(x) << 4 | colour(x + 1));
        bitmap.extend(row.chain([0; ROW_LEN - WIDTH / 2]));
    }
    bitmap
}

/// Returns BITMAPFILEHEADER, BITMAPINFOHEADER and the colour table.
fn headers() -> Vec<u8> {
    let mut bytes = b"BM".to_vec();
    let words = |bytes: &mut Vec<u8>, values: &[usize]| {
        values.iter().for_each(|value| bytes.extend((*value as u32).to_le_bytes()));
    };
    words(&mut bytes, &[LEN, 0, HEADERS_LEN, 40, WIDTH, HEIGHT]);
    // One plane, 4 bits per pixel.
    bytes.extend([1, 0, 4, 0]);
    // No compression; size of the pixels; no resolution; all colours.
    words(&mut bytes, &[0, ROW_LEN * HEIGHT, 0, 0, 16, 0]);
    PALETTE.iter().for_each(|[red, green, blue]| bytes.extend([*blue, *green, *red, 0]));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bitmap_of_70_by_40_pixels_in_16_colours_differs_by_its_lamp() {
        let bitmap = gripper(Lamp::Green);
        let word = |at: usize| u32::from_le_bytes(bitmap[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bitmap[..2], word(2), bitmap.len()), (&b"BM"[..], LEN, LEN));
        assert_eq!((word(18), word(22), bitmap[28], word(30), word(46)), (70, 40, 4, 0, 16));
        assert_eq!((word(10), bitmap.len() - word(10)), (118, 36 * 40));
        for lamp in [Lamp::Red, Lamp::Yellow] {
            let other = gripper(lamp);
            let differing = bitmap.iter().zip(&other).filter(|(one, other)| one != other).count();
            // 6 x 4 pixels.
            assert_eq!((other.len(), differing), (LEN, 12));
        }
    }
}
