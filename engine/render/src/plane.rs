//! The planes of an image beside its color: one table. A plane has one or more 32-bit words per
//! pixel.
//!
//! All are found together with color: `shaders/include/planes.glsl`, its CPU mirror
//! `twins/planes.rs`, the definition of depth and instances in f64 `reference/blend.rs`. Range,
//! normal and motion are attributes of splats: `shaders/include/geometry.glsl`, with their
//! definition, and that of medians, in `reference/geometry.rs`.

use std::collections::BTreeMap;

/// A plane of an image beside its color.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Plane {
    /// Expected depth, meters, f32: camera-space z, or distance where the order is radial. 0 where
    /// nothing was blended.
    Depth,
    /// Instance of the splat with the largest weight, u16; 0 is the background.
    Instance,
    /// Expected distance from the camera, meters, f32. As all planes of geometry, the mean over the
    /// blended splats by weight, and 0 where nothing was blended.
    Range,
    /// Normal, three f32: the mean of the splats' thinnest axes, unit vectors in world axes that
    /// point towards the camera. Its length tells how far they agree.
    Normal,
    /// Displacement in the image to the time [`crate::RenderOptions::flow_interval_s`] later, two
    /// f32, pixels: cameras and agents go on with their motion. A splat that is behind the near
    /// plane then counts as 0.
    FlowForward,
    /// Displacement in the image to the time [`crate::RenderOptions::flow_interval_s`] earlier, two
    /// f32, pixels.
    FlowBackward,
    /// Velocity, three f32, meters per second, world axes; the background is at rest.
    SceneFlow,
    /// Median depth, meters, f32: that of [`Plane::Depth`] of the splat in which half of a pixel's
    /// light is gone. 0 where more than half is left.
    DepthMedian,
    /// Median range, meters, f32: that of [`Plane::Range`] of the splat in which half of a pixel's
    /// light is gone. 0 where more than half is left.
    RangeMedian,
}

/// Type of a plane's values on the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaneType {
    /// The word is the bits of an f32.
    F32,
    /// The word is a number below 65,536.
    U16,
}

/// Values of a plane on the host, row-major from the top left, those of a pixel together.
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
    pub const ALL: [Self; 9] = [
        Self::Depth,
        Self::Instance,
        Self::Range,
        Self::Normal,
        Self::FlowForward,
        Self::FlowBackward,
        Self::SceneFlow,
        Self::DepthMedian,
        Self::RangeMedian,
    ];

    /// Name in options, files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Instance => "instance",
            Self::Range => "range",
            Self::Normal => "normal",
            Self::FlowForward => "flow_forward",
            Self::FlowBackward => "flow_backward",
            Self::SceneFlow => "scene_flow",
            Self::DepthMedian => "depth_median",
            Self::RangeMedian => "range_median",
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
            Self::Instance => PlaneType::U16,
            _ => PlaneType::F32,
        }
    }

    /// Values per pixel.
    #[must_use]
    pub const fn channels(self) -> usize {
        match self {
            Self::Depth | Self::Instance | Self::Range | Self::DepthMedian | Self::RangeMedian => 1,
            Self::FlowForward | Self::FlowBackward => 2,
            Self::Normal | Self::SceneFlow => 3,
        }
    }

    /// True if the values are medians of the attribute, not means.
    #[must_use]
    pub const fn is_median(self) -> bool {
        matches!(self, Self::DepthMedian | Self::RangeMedian)
    }

    /// True if the values are means of an attribute that records hold for it.
    pub(crate) const fn is_attribute(self) -> bool {
        matches!(
            self,
            Self::Range | Self::Normal | Self::FlowForward | Self::FlowBackward | Self::SceneFlow
        )
    }

    /// Words per pixel of the sums in the partial result of a segment.
    pub(crate) const fn partial_words(self) -> usize {
        match self {
            Self::Depth => 1,
            Self::Instance => 2,
            Self::DepthMedian | Self::RangeMedian => 0,
            _ => self.channels(),
        }
    }
}

/// A set of planes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Planes(u32);

impl Planes {
    /// No plane.
    pub const NONE: Self = Self(0);
    /// Depth and instance.
    pub const BESIDE_COLOR: Self = Self(1 << Plane::Depth as u32 | 1 << Plane::Instance as u32);
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

    /// True if the set has a median.
    #[must_use]
    pub fn has_medians(self) -> bool {
        self.iter().any(Plane::is_median)
    }

    /// Words of a splat's attributes whose means are planes of the set.
    #[must_use]
    pub fn attribute_words(self) -> usize {
        let attributes = self.iter().filter(|plane| plane.is_attribute());
        attributes.map(Plane::channels).sum()
    }

    /// Words per pixel of all planes of the set.
    #[must_use]
    pub fn words(self) -> usize {
        self.iter().map(Plane::channels).sum()
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
