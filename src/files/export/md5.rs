//! MD5 (RFC 1321), which X3P requires as a checksum.

/// Rotations of a step, by rounds.
const ROTATIONS: [[u32; 4]; 4] = [[7, 12, 17, 22], [5, 9, 14, 20], [4, 11, 16, 23], [6, 10, 15, 21]];

/// Returns the digest as 32 hexadecimal digits.
pub(super) fn digest(bytes: &[u8]) -> String {
    let mut state = [0x6745_2301u32, 0xefcd_ab89, 0x98ba_dcfe, 0x1032_5476];
    let chunks = bytes.chunks_exact(64);
    let mut rest = chunks.remainder().to_vec();
    chunks.for_each(|block| state = mixed(state, block));
    rest.push(0x80);
    rest.resize(if rest.len() > 56 { 120 } else { 56 }, 0);
    rest.extend((8 * bytes.len() as u64).to_le_bytes());
    rest.chunks_exact(64).for_each(|block| state = mixed(state, block));
    state.iter().flat_map(|word| word.to_le_bytes()).map(|byte| format!("{byte:02x}")).collect()
}

/// Mixes a block of 64 bytes into the state.
fn mixed(state: [u32; 4], block: &[u8]) -> [u32; 4] {
    let word = |i: usize| u32::from_le_bytes([block[4 * i], block[4 * i + 1], block[4 * i + 2], block[4 * i + 3]]);
    let [mut a, mut b, mut c, mut d] = state;
    for i in 0..64 {
        let (f, at) = match i / 16 {
            0 => ((b & c) | (!b & d), i),
            1 => ((d & b) | (!d & c), (5 * i + 1) % 16),
            2 => (b ^ c ^ d, (3 * i + 5) % 16),
            _ => (c ^ (b | !d), (7 * i) % 16),
        };
        // The integer part of 2^32 |sin(i + 1)|.
        let sine = (((i + 1) as f64).sin().abs() * 4_294_967_296.0) as u32;
        let sum = a.wrapping_add(f).wrapping_add(sine).wrapping_add(word(at));
        (a, d, c) = (d, c, b);
        b = b.wrapping_add(sum.rotate_left(ROTATIONS[i / 16][i % 4]));
    }
    let new = [a, b, c, d];
    std::array::from_fn(|n| state[n].wrapping_add(new[n]))
}

#[cfg(test)]
mod tests {
    #[test]
    fn digests_are_those_of_the_rfc() {
        for (text, digest) in [
            ("", "d41d8cd98f00b204e9800998ecf8427e"),
            ("abc", "900150983cd24fb0d6963f7d28e17f72"),
            ("abcdefghijklmnopqrstuvwxyz", "c3fcd3d76192e4007dfb496cca67e13b"),
            (
                "12345678901234567890123456789012345678901234567890123456789012345678901234567890",
                "57edf4a22be3c955ac49da2e2107b67a",
            ),
        ] {
            assert_eq!(super::digest(text.as_bytes()), digest, "{text}");
        }
        // A rest of 56 to 63 bytes needs a second block.
        assert_eq!(super::digest(&[b'a'; 60]), "cc7ed669cf88f201c3297c6a91e1d18d");
    }
}
