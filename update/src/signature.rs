//! Ed25519 (RFC 8032, 5.1.7) over a digest.

use curve25519_dalek::{EdwardsPoint, Scalar, edwards::CompressedEdwardsY};
use sha2::{Digest, Sha512};

use crate::{PublicKey, SIGNATURE_LEN};

/// Returns whether this is the signature of the message with the key.
///
/// Like `ed25519-dalek`, it rejects a scalar that is not reduced. It uses that crate's arithmetic, in constant time, because
/// the variable one has a panic path.
#[must_use]
pub fn verify(key: &PublicKey, message: &[u8], signature: &[u8; SIGNATURE_LEN]) -> bool {
    let (Some(r), Some(s)) = (signature.first_chunk::<32>(), signature.last_chunk::<32>()) else {
        return false;
    };
    let s: Option<Scalar> = Scalar::from_canonical_bytes(*s).into();
    let (Some(s), Some(key_point)) = (s, CompressedEdwardsY(*key).decompress()) else { return false };
    let mut hash = Sha512::new();
    hash.update(r);
    hash.update(key);
    hash.update(message);
    let k = Scalar::from_bytes_mod_order_wide(&hash.finalize().into());
    #[expect(clippy::arithmetic_side_effects, reason = "points of the curve: no overflow")]
    let expected = EdwardsPoint::mul_base(&s) - k * key_point;
    expected.compress().0 == *r
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hex<const N: usize>(digits: &str) -> [u8; N] {
        core::array::from_fn(|at| u8::from_str_radix(&digits[2 * at..][..2], 16).unwrap())
    }

    /// RFC 8032, 7.1, test 3.
    #[test]
    fn signature_of_the_standard_verifies_and_none_with_another_bit() {
        let key = hex("fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025");
        let signature: [u8; 64] = hex(concat!(
            "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac",
            "18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a"
        ));
        assert!(verify(&key, &[0xAF, 0x82], &signature));
        assert!(!verify(&key, &[0xAF, 0x83], &signature));
        for bit in 0..512 {
            let mut changed = signature;
            changed[bit / 8] ^= 1 << (bit % 8);
            assert!(!verify(&key, &[0xAF, 0x82], &changed), "bit {bit}");
        }
    }

    #[test]
    fn scalar_that_is_not_reduced_is_rejected() {
        let key = hex("fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025");
        // The signature of the standard, with the order of the group added to its scalar.
        let signature: [u8; 64] = hex(concat!(
            "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac",
            "05d391b0a77904e98404ef037747a56e4a7c15e9716ed28dc027beceea1ec41a"
        ));
        assert!(!verify(&key, &[0xAF, 0x82], &signature));
    }
}
