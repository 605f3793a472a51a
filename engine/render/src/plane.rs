//! The planes of an image beside its color: one table. A plane is one 32-bit word per pixel.
//!
//! Accumulation and output of a pixel are in `shaders/include/planes.glsl`, its CPU mirror is
//! `twins/planes.rs`, and its definition in f64 `reference/blend.rs`.

use std::collections::BTreeMap;

/// A plane of an image beside its color.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Plane {
    /// Expected depth, meters, f32: camera-space z, or distance where the order is radial. 0 where
    /// nothing was blended.
    Depth,
    /// Instance of the splat with the largest weight, u16; 0 is the background.
    Instance,
}

/// Type of a plane's values on the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaneType {
    /// The word is the bits of an f32.
    F32,
    /// The word is a number below 65,536.
    U16,
}

/// Values of a plane on the host, one per pixel, row-major from the top left.
#[derive(Clone, Debug, PartialEq)]
pub enum PlaneValues {
    /// Values of [`PlaneType::F32`].
    F32(Vec<f32>),
    /// Values of [`PlaneType::U16`].
    U16(Vec<u16>),
}

/// Planes of one image, by plane.
pub type PlaneMap = BTreeMap<Plane, PlaneValues>;

impl Plane {
    /// All planes, in the order in which they lie in [`crate::OutputBuffers::planes`].
    pub const ALL: [Self; 2] = [Self::Depth, Self::Instance];

    /// Name in options, files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Instance => "instance",
        }
    }

    /// The plane called `name`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|plane| plane.name() == name)
    }

    /// Type of its values on the host.
    #[must_use]
    pub const fn value_type(self) -> PlaneType {
        match self {
            Self::Depth => PlaneType::F32,
            Self::Instance => PlaneType::U16,
        }
    }

    /// Name of the specialization constant that turns it on.
    pub(crate) const fn constant(self) -> &'static str {
        match self {
            Self::Depth => "DEPTH",
            Self::Instance => "INSTANCE",
        }
    }

    /// Words per pixel in the partial result of a segment.
    pub(crate) const fn partial_words(self) -> usize {
        match self {
            Self::Depth => 1,
            Self::Instance => 2,
        }
    }
}

/// A set of planes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Planes(u32);

impl Planes {
    /// Every plane.
    pub const ALL: Self = Self((1 << Plane::ALL.len()) - 1);

    /// True if `plane` is in the set.
    #[must_use]
    pub const fn contains(self, plane: Plane) -> bool {
        self.0 & 1 << plane as u32 != 0
    }

    /// True if the set has no plane.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Planes of the set, in the order of [`Plane::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Plane> {
        Plane::ALL
            .into_iter()
            .filter(move |plane| self.contains(*plane))
    }
}

impl FromIterator<Plane> for Planes {
    fn from_iter<I: IntoIterator<Item = Plane>>(planes: I) -> Self {
        Self(
            planes
                .into_iter()
                .fold(0, |bits, plane| bits | 1 << plane as u32),
        )
    }
}

impl<const N: usize> From<[Plane; N]> for Planes {
    fn from(planes: [Plane; N]) -> Self {
        planes.into_iter().collect()
    }
}

/// The names of the planes in the set.
impl serde::Serialize for Planes {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter().map(Plane::name))
    }
}

impl PlaneValues {
    /// The values of `plane` in `words`.
    #[must_use]
    pub fn new(plane: Plane, words: &[u32]) -> Self {
        match plane.value_type() {
            PlaneType::F32 => Self::F32(words.iter().map(|&word| f32::from_bits(word)).collect()),
            PlaneType::U16 => Self::U16(words.iter().map(|&word| word as u16).collect()),
        }
    }

    /// The values, if they are f32.
    #[must_use]
    pub fn as_f32(&self) -> Option<&[f32]> {
        match self {
            Self::F32(values) => Some(values),
            Self::U16(_) => None,
        }
    }

    /// The values, if they are u16.
    #[must_use]
    pub fn as_u16(&self) -> Option<&[u16]> {
        match self {
            Self::U16(values) => Some(values),
            Self::F32(_) => None,
        }
    }
}
