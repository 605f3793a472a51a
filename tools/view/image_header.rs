//! Header of each image that is sent to the page: 32 bytes, all fields little-endian.

/// First four bytes of each image: "DGSV".
const MAGIC: u32 = u32::from_le_bytes(*b"DGSV");
/// Bytes of the header of an image.
const HEADER_BYTES: usize = 32;
/// Flag of images that are rendered at full size and encoded without loss.
pub const FLAG_EXACT: u8 = 1;
/// Flag of the last image of an update.
pub const FLAG_LAST: u8 = 2;

/// Encoding of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageKind {
    /// JPEG, with losses.
    Jpeg = 2,
    /// PNG, without losses.
    Png = 3,
    /// Points of a LiDAR: for each x, y and z relative to the camera, meters, and the distance from
    /// the sensor, meters; four f32.
    Points = 4,
}

/// Header of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Pane that it is for.
    pub stream: u16,
    /// Encoding of the bytes behind the header.
    pub kind: ImageKind,
    /// [`FLAG_EXACT`], [`FLAG_LAST`].
    pub flags: u8,
    /// Number of the update.
    pub update: u32,
    /// Time of the scene, microseconds.
    pub time_us: i64,
    /// Width and height, pixels.
    pub size_px: [u16; 2],
}

impl Header {
    /// The 32 bytes, fields as in the module's table: magic u32, stream u16, kind u8, flags u8,
    /// update u32, time i64, width u16, height u16, row of the strip u16, strips u16, 0 u32.
    #[must_use]
    pub fn bytes(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let mut at = 0;
        let mut put = |part: &[u8]| {
            bytes[at..at + part.len()].copy_from_slice(part);
            at += part.len();
        };
        put(&MAGIC.to_le_bytes());
        put(&self.stream.to_le_bytes());
        put(&[self.kind as u8, self.flags]);
        put(&self.update.to_le_bytes());
        put(&self.time_us.to_le_bytes());
        put(&self.size_px[0].to_le_bytes());
        put(&self.size_px[1].to_le_bytes());
        // One strip, from row 0 on.
        put(&0u16.to_le_bytes());
        put(&1u16.to_le_bytes());
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_has_32_bytes_in_the_order_of_the_protocol() {
        let header = Header {
            stream: 0x0102,
            kind: ImageKind::Png,
            flags: FLAG_EXACT | FLAG_LAST,
            update: 5,
            time_us: -1,
            size_px: [640, 360],
        };
        let bytes = header.bytes();
        assert_eq!(&bytes[..8], b"DGSV\x02\x01\x03\x03");
        assert_eq!(
            &bytes[8..20],
            [5, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]
        );
        assert_eq!(&bytes[20..], [128, 2, 104, 1, 0, 0, 1, 0, 0, 0, 0, 0]);
    }
}
