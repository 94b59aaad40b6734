//! Changes to bytes, from a seed: the same on every machine.

/// A xorshift generator.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() >> 16) as usize % n.max(1)
    }
}

/// Numbers that formats stumble over.
const EXTREMES: [u32; 10] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x7fc0_0000, 0x7f80_0000];

/// Texts that parsers of text stumble over.
const WORDS: [&[u8]; 12] = [
    b"-1",
    b"0",
    b"1e99",
    b"18446744073709551616",
    b"NaN",
    b"null",
    b"[]",
    b"{}",
    b"\"",
    b"..",
    b"4294967295",
    b"\xff",
];

/// One to four changes.
pub fn mutate(mut bytes: Vec<u8>, r: &mut Random) -> Vec<u8> {
    for _ in 0..=r.below(4) {
        if bytes.is_empty() {
            return bytes;
        }
        let at = r.below(bytes.len());
        let end = (at + 1 + r.below(32)).min(bytes.len());
        match r.below(9) {
            0 | 1 => bytes[at] ^= 1 << r.below(8),
            2 => bytes[at] = r.next() as u8,
            3 => {
                let value = EXTREMES[r.below(EXTREMES.len())].to_le_bytes();
                let n = value.len().min(bytes.len() - at);
                bytes[at..at + n].copy_from_slice(&value[..n]);
            }
            4 => drop(bytes.drain(at..end)),
            5 => {
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            6 => bytes.truncate(at),
            7 => {
                let word = WORDS[r.below(WORDS.len())];
                bytes.splice(at..(at + r.below(4)).min(bytes.len()), word.iter().copied());
            }
            _ => {
                let part: Vec<u8> = (0..r.below(24)).map(|_| r.next() as u8).collect();
                bytes.splice(at..at, part);
            }
        }
    }
    bytes
}

/// Random bytes after a beginning.
pub fn noise(begin: &[u8], r: &mut Random) -> Vec<u8> {
    let mut bytes = begin.to_vec();
    bytes.extend((0..r.below(300)).map(|_| r.next() as u8));
    bytes
}
