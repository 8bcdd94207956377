//! The last 64 bytes of an image.

use crate::PublicKey;

/// First bytes of a manifest. Another format gets another number.
const MAGIC: [u8; 4] = *b"WSG1";

/// Board for which an image is built: a number derived from the board's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target(u32);

impl Target {
    /// Returns the target of a board's name, as in the workspace's table of boards: FNV-1a.
    #[must_use]
    pub const fn of(board: &str) -> Self {
        let (mut hash, mut rest) = (0x811C_9DC5_u32, board.as_bytes());
        while let [byte, after @ ..] = rest {
            hash = (hash ^ *byte as u32).wrapping_mul(0x0100_0193);
            rest = after;
        }
        Self(hash)
    }

    /// Returns the number.
    #[must_use]
    pub const fn number(self) -> u32 {
        self.0
    }
}

/// Version of a program: major, minor, patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version(pub [u8; 3]);

impl Version {
    /// Parses three numbers up to 255, such as 1.2.3. Returns `None` for any other text.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let mut numbers = text.split('.').map(|number| number.parse().ok());
        let version = [numbers.next()??, numbers.next()??, numbers.next()??];
        numbers.next().is_none().then_some(Self(version))
    }
}

impl core::fmt::Display for Version {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let [major, minor, patch] = self.0;
        write!(f, "{major}.{minor}.{patch}")
    }
}

/// Description of an image, in its last 64 bytes. All numbers are little-endian.
///
/// | bytes | content |
/// |---|---|
/// | 0 to 3 | `WSG1` |
/// | 4 to 7 | target: FNV-1a (32 bits) of the board's name |
/// | 8 to 10 | version: major, minor, patch |
/// | 12 to 15 | length of the image in bytes, with the manifest |
/// | 16 to 19 | rollback counter |
/// | 32 to 63 | public key that succeeds the second one, or zeros |
///
/// All other bytes are 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// The board.
    pub target: Target,
    /// Version of the program, for display. Only the rollback counter decides about an older program.
    pub version: Version,
    /// Length of the image in bytes, with the manifest and without the signature.
    pub length: u32,
    /// Rises with a security fix. A board refuses images with a lower one than that of the last confirmed image.
    pub counter: u32,
    /// Public key that succeeds the second one. Only an image signed with the first may name it.
    pub successor: Option<PublicKey>,
}

impl Manifest {
    /// Bytes of a manifest.
    pub const LEN: usize = 64;

    /// Returns the manifest's bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let [major, minor, patch] = self.version.0;
        let mut bytes = [0; Self::LEN];
        let words = [
            MAGIC,
            self.target.0.to_le_bytes(),
            [major, minor, patch, 0],
            self.length.to_le_bytes(),
            self.counter.to_le_bytes(),
        ];
        for (place, byte) in bytes.iter_mut().zip(words.as_flattened()) {
            *place = *byte;
        }
        if let (Some(place), Some(key)) = (bytes.last_chunk_mut(), self.successor) {
            *place = key;
        }
        bytes
    }

    /// Parses a manifest. Returns `None` for any bytes that [`encode`](Self::encode) cannot return.
    #[must_use]
    pub fn decode(bytes: &[u8; Self::LEN]) -> Option<Self> {
        let word = |at: usize| Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?));
        let key = *bytes.last_chunk()?;
        let manifest = Self {
            target: Target(word(4)?),
            version: Version(*bytes.get(8..)?.first_chunk()?),
            length: word(12)?,
            counter: word(16)?,
            successor: (key != [0; 32]).then_some(key),
        };
        (manifest.encode() == *bytes).then_some(manifest)
    }
}
