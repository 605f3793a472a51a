//! Choices that a fuzzer makes: bytes are taken one by one, and none are zeros.

/// Bytes not used yet.
pub struct Choices<'a>(pub &'a [u8]);

/// Numbers that break arithmetic, counts and offsets.
const NASTY: [u64; 16] = [
    0,
    1,
    2,
    3,
    4,
    15,
    255,
    65_536,
    1 << 24,
    (1 << 26) + 1,
    (1 << 31) - 1,
    u32::MAX as u64,
    1 << 40,
    1 << 60,
    i64::MAX as u64,
    u64::MAX,
];

#[allow(dead_code, reason = "each target needs some of it")]
impl Choices<'_> {
    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    /// One of `count`.
    pub fn one_of(&mut self, count: usize) -> usize {
        usize::from(self.byte()) % count
    }

    /// Mostly a small number, now and then one that breaks things.
    pub fn number(&mut self) -> u64 {
        match self.byte() {
            small @ 0..=191 => u64::from(small % 24),
            nasty => NASTY[usize::from(nasty) % NASTY.len()],
        }
    }

    /// A choice that is rarely true.
    pub fn rarely(&mut self) -> bool {
        self.byte() > 224
    }
}
