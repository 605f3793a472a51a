//! Scalar properties, and reading them from a row.

/// A scalar type of a PLY property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    pub(super) fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// Position of one property in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    /// Bytes from the start of the row.
    pub(super) offset: usize,
    pub(crate) scalar: Scalar,
}

impl Column {
    /// The property's value in `row` as f32; integers keep their number, doubles are rounded.
    // Called for every number of a file, also from other codegen units.
    #[inline]
    pub(crate) fn f32_of(self, row: &[u8]) -> f32 {
        match self.scalar {
            Scalar::F32 => f32::from_le_bytes(self.bytes_of(row)),
            Scalar::F64 => f64::from_le_bytes(self.bytes_of(row)) as f32,
            Scalar::I8 => f32::from(i8::from_le_bytes(self.bytes_of(row))),
            Scalar::U8 => f32::from(row[self.offset]),
            Scalar::I16 => f32::from(i16::from_le_bytes(self.bytes_of(row))),
            Scalar::U16 => f32::from(u16::from_le_bytes(self.bytes_of(row))),
            Scalar::I32 => i32::from_le_bytes(self.bytes_of(row)) as f32,
            Scalar::U32 => u32::from_le_bytes(self.bytes_of(row)) as f32,
        }
    }

    /// The property's value in `row` as f64; all types keep their number.
    pub(crate) fn f64_of(self, row: &[u8]) -> f64 {
        match self.scalar {
            Scalar::F64 => f64::from_le_bytes(self.bytes_of(row)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.bytes_of(row))),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.bytes_of(row))),
            _ => f64::from(self.f32_of(row)),
        }
    }

    /// The property's value in `row` as a color: integers as shares of their largest value.
    pub(crate) fn share_of(self, row: &[u8]) -> f32 {
        let most = match self.scalar {
            Scalar::U8 => f32::from(u8::MAX),
            Scalar::U16 => f32::from(u16::MAX),
            _ => 1.0,
        };
        self.f32_of(row) / most
    }

    /// The bits of a four-byte property.
    pub(crate) fn u32_of(self, row: &[u8]) -> u32 {
        debug_assert_eq!(self.scalar.bytes(), 4);
        u32::from_le_bytes(self.bytes_of(row))
    }

    fn bytes_of<const N: usize>(self, row: &[u8]) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&row[self.offset..self.offset + N]);
        bytes
    }
}
