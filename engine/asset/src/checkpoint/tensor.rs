//! Tensors: numbers somewhere in a storage.

use half::{bf16, f16};

use super::value::Id;
use crate::DecodeError;

/// Dimensions that a tensor may have.
const DIMENSIONS_MAX: usize = 8;

/// Largest product of the sizes of an empty tensor that are not 0, however small its file is.
/// Readers make lists as long as one dimension, so an empty tensor must not claim a large one. In
/// larger files the product may be as large as the file, because a model of N splats without
/// view-dependent colors has a tensor of shape [N, 0, 3].
const EMPTY_SIZES_MAX: u64 = 1 << 16;

/// The type of a storage's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    F64,
    F32,
    F16,
    Bf16,
    I64,
    I32,
    I16,
    I8,
    U8,
    Bool,
}

impl Scalar {
    /// The type of PyTorch's storage class called `name`.
    pub(super) fn of_class(name: &str) -> Option<Self> {
        Some(match name {
            "torch DoubleStorage" => Self::F64,
            "torch FloatStorage" => Self::F32,
            "torch HalfStorage" => Self::F16,
            "torch BFloat16Storage" => Self::Bf16,
            "torch LongStorage" => Self::I64,
            "torch IntStorage" => Self::I32,
            "torch ShortStorage" => Self::I16,
            "torch CharStorage" => Self::I8,
            "torch ByteStorage" => Self::U8,
            "torch BoolStorage" => Self::Bool,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::I32 => 4,
            Self::F16 | Self::Bf16 | Self::I16 => 2,
            Self::I8 | Self::U8 | Self::Bool => 1,
        }
    }

    /// The number that `bytes` hold, as many as [`Scalar::bytes`] says. Integers beyond 2^53 are
    /// rounded.
    fn read(self, bytes: &[u8]) -> f64 {
        fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
            std::array::from_fn(|i| bytes[i])
        }
        match self {
            Self::F64 => f64::from_le_bytes(first(bytes)),
            Self::F32 => f32::from_le_bytes(first(bytes)).into(),
            Self::F16 => f16::from_le_bytes(first(bytes)).into(),
            Self::Bf16 => bf16::from_le_bytes(first(bytes)).into(),
            Self::I64 => i64::from_le_bytes(first(bytes)) as f64,
            Self::I32 => i32::from_le_bytes(first(bytes)).into(),
            Self::I16 => i16::from_le_bytes(first(bytes)).into(),
            Self::I8 => (bytes[0] as i8).into(),
            Self::U8 => bytes[0].into(),
            Self::Bool => f64::from(u8::from(bytes[0] != 0)),
        }
    }
}

/// A tensor as a pickle describes it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Form {
    /// The node of its storage.
    pub(crate) storage: Id,
    /// Numbers of the storage before its first.
    pub(super) offset: u64,
    pub(super) shape: Vec<u64>,
    /// Numbers of the storage from one index to the next, a dimension each.
    pub(super) strides: Vec<u64>,
}

/// A tensor over its numbers, of which every index is there.
#[derive(Clone, Debug)]
pub(crate) struct Tensor<'a> {
    /// Bytes from the first number on.
    numbers: &'a [u8],
    scalar: Scalar,
    shape: Vec<usize>,
    strides: Vec<usize>,
}

impl<'a> Tensor<'a> {
    /// The tensor of `form` over the bytes of its storage.
    ///
    /// A tensor has no more numbers than its storage, so a small file makes no large one.
    pub(super) fn new(
        form: &Form,
        scalar: Scalar,
        storage: &'a [u8],
        file_bytes: usize,
        what: &str,
    ) -> Result<Self, DecodeError> {
        let there = (storage.len() / scalar.bytes()) as u64;
        let too_large = || {
            DecodeError::Malformed(format!(
                "tensor '{what}' of shape {:?} does not lie within the {there} numbers of its storage; save the checkpoint again",
                form.shape
            ))
        };
        if form.shape.len() != form.strides.len() || form.shape.len() > DIMENSIONS_MAX {
            return Err(too_large());
        }
        let mut sizes = form.shape.iter().filter(|&&size| size > 0);
        let product = sizes
            .try_fold(1u64, |product, &size| product.checked_mul(size))
            .ok_or_else(too_large)?;
        let is_empty = form.shape.contains(&0);
        let last = form
            .shape
            .iter()
            .zip(&form.strides)
            .try_fold(form.offset, |last, (&size, &stride)| {
                last.checked_add(size.saturating_sub(1).checked_mul(stride)?)
            });
        let is_inside = match is_empty {
            true => product <= EMPTY_SIZES_MAX.max(file_bytes as u64),
            false => product <= there && last.is_some_and(|last| last < there),
        };
        if !is_inside {
            return Err(too_large());
        }
        let first = if is_empty {
            0
        } else {
            form.offset as usize * scalar.bytes()
        };
        let all = |values: &[u64]| {
            values
                .iter()
                .map(|&value| usize::try_from(value).unwrap_or(0))
                .collect()
        };
        Ok(Self {
            numbers: &storage[first..],
            scalar,
            shape: all(&form.shape),
            strides: all(&form.strides),
        })
    }

    /// Sizes of its dimensions.
    pub(crate) fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Numbers in it.
    pub(crate) fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// All numbers, the last dimension the fastest.
    pub(crate) fn f64s(&self) -> impl Iterator<Item = f64> + '_ {
        let (bytes, is_packed) = (self.scalar.bytes(), self.is_packed());
        (0..self.len()).map(move |index| {
            let at = if is_packed { index } else { self.place(index) };
            self.scalar.read(&self.numbers[at * bytes..])
        })
    }

    /// All numbers as 32-bit floats.
    pub(crate) fn f32s(&self) -> impl Iterator<Item = f32> + '_ {
        self.f64s().map(|value| value as f32)
    }

    /// True if the numbers stand one behind the other.
    fn is_packed(&self) -> bool {
        let mut expected = 1;
        self.shape
            .iter()
            .zip(&self.strides)
            .rev()
            .all(|(&size, &stride)| {
                let fits = size <= 1 || stride == expected;
                expected *= size;
                fits
            })
    }

    /// Offset of the number `index`, counted in order, in the storage.
    fn place(&self, index: usize) -> usize {
        let mut rest = index;
        self.shape
            .iter()
            .zip(&self.strides)
            .rev()
            .fold(0, |index, (&size, &stride)| {
                let here = rest % size;
                rest /= size;
                index + here * stride
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn form(offset: u64, shape: &[u64], strides: &[u64]) -> Form {
        Form {
            storage: 0,
            offset,
            shape: shape.to_vec(),
            strides: strides.to_vec(),
        }
    }

    #[test]
    fn a_transposed_tensor_is_read_in_its_own_order() {
        let storage: Vec<u8> = (0..7u8)
            .flat_map(|value| f32::from(value).to_le_bytes())
            .collect();
        let of = |form: &Form| {
            Tensor::new(form, Scalar::F32, &storage, storage.len(), "t")
                .unwrap()
                .f32s()
                .collect::<Vec<_>>()
        };
        assert_eq!(
            of(&form(1, &[2, 3], &[3, 1])),
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        );
        assert_eq!(
            of(&form(1, &[3, 2], &[1, 3])),
            [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]
        );
        assert_eq!(of(&form(9, &[0, 3], &[3, 1])), [0.0; 0]);
        assert_eq!(of(&form(6, &[], &[])), [6.0]);
        // A model of many splats without view-dependent colors, in a file that is large enough for
        // them.
        let of_file = |file_bytes| {
            Tensor::new(
                &form(0, &[1 << 20, 0, 3], &[0, 3, 1]),
                Scalar::F32,
                &[],
                file_bytes,
                "rest",
            )
        };
        assert_eq!(of_file(28 << 20).unwrap().len(), 0);
        assert!(of_file(1 << 20).is_err());
    }

    #[test]
    fn every_type_is_read() {
        let read = |scalar: Scalar, bytes: &[u8]| scalar.read(bytes);
        assert_eq!(read(Scalar::F64, &(-2.5f64).to_le_bytes()), -2.5);
        assert_eq!(read(Scalar::F16, &f16::from_f32(0.5).to_le_bytes()), 0.5);
        assert_eq!(
            read(Scalar::Bf16, &bf16::from_f32(-3.0).to_le_bytes()),
            -3.0
        );
        assert_eq!(read(Scalar::I64, &(-7i64).to_le_bytes()), -7.0);
        assert_eq!(read(Scalar::I32, &(-7i32).to_le_bytes()), -7.0);
        assert_eq!(read(Scalar::I16, &(-7i16).to_le_bytes()), -7.0);
        assert_eq!(
            [
                read(Scalar::I8, &[255]),
                read(Scalar::U8, &[255]),
                read(Scalar::Bool, &[2])
            ],
            [-1.0, 255.0, 1.0]
        );
    }

    #[test]
    fn what_reaches_beyond_its_storage_or_repeats_it_is_refused() {
        let storage = [0; 40];
        for (offset, shape, strides) in [
            (0, &[11][..], &[1][..]),
            (8, &[3], &[1]),
            (0, &[2, 2], &[9, 1]),
            // One number a thousand times over.
            (0, &[1000], &[0]),
            (0, &[u64::MAX, 2], &[1, 1]),
            (u64::MAX, &[2], &[1]),
            (0, &[2], &[u64::MAX]),
            (0, &[2], &[]),
            (0, &[1; 9], &[1; 9]),
            // Empty, with one dimension that a reader would make a list of.
            (0, &[0, 1 << 60], &[1, 1]),
            (0, &[0, 1 << 17], &[1, 1]),
            (0, &[1 << 40, 0, 1 << 40], &[1, 1, 1]),
        ] {
            let result = Tensor::new(
                &form(offset, shape, strides),
                Scalar::F32,
                &storage,
                storage.len(),
                "means",
            );
            assert!(
                result.unwrap_err().to_string().contains("'means'"),
                "{shape:?}"
            );
        }
    }
}
