//! The Common Data Representation of ROS 2, little-endian.

/// Bytes that name the encoding, before the message. Alignment counts from behind them.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message that is being written.
pub(crate) struct Cdr(Vec<u8>);

impl Cdr {
    pub(crate) fn new() -> Self {
        Self(HEADER.to_vec())
    }

    /// A message that begins with `std_msgs/Header`.
    pub(crate) fn with_header(time_ns: u64, frame: &str) -> Self {
        let mut cdr = Self::new();
        cdr.header(time_ns, frame);
        cdr
    }

    /// A `std_msgs/Header`.
    pub(crate) fn header(&mut self, time_ns: u64, frame: &str) {
        self.time(time_ns);
        self.string(frame);
    }

    /// A `builtin_interfaces/Time`.
    pub(crate) fn time(&mut self, time_ns: u64) {
        self.u32((time_ns / 1_000_000_000) as u32);
        self.u32((time_ns % 1_000_000_000) as u32);
    }

    fn align(&mut self, size: usize) {
        while !(self.0.len() - HEADER.len()).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn f32(&mut self, value: f32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    /// Numbers of an array of fixed length, one after the other.
    pub(crate) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.f64(*value);
        }
    }

    /// Bytes of a sequence with their count.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
    }

    /// A text with its length and a final zero.
    pub(crate) fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_behind_the_header() {
        let mut cdr = Cdr::new();
        cdr.u8(7);
        cdr.f64(1.0);
        cdr.u8(8);
        cdr.u32(9);
        cdr.string("ab");
        cdr.bytes(&[5]);
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0];
        expected.extend(1.0f64.to_le_bytes());
        expected.extend([8, 0, 0, 0, 9, 0, 0, 0]);
        expected.extend([3, 0, 0, 0, b'a', b'b', 0, 0, 1, 0, 0, 0, 5]);
        assert_eq!(cdr.finish(), expected);
    }
}
