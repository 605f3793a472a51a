//! The interface of a kernel, as a value.

use std::borrow::Cow;

use crate::{Access, Kind};

/// A compute kernel's interface. That of a kernel of the program is a constant, which the compiler
/// of the shaders writes; that of another is read from its SPIR-V.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Name of the function that runs.
    pub entry_point: Cow<'static, str>,
    /// Size of a workgroup along x, y and z.
    pub workgroup: [Size; 3],
    /// Numbers of the declared capabilities.
    pub capabilities: Cow<'static, [u32]>,
    /// Buffers in the order of their binding numbers.
    pub bindings: Cow<'static, [Binding]>,
    /// Members of the push constants.
    pub push: Cow<'static, [Member]>,
    /// Size of the push constants.
    pub push_bytes: u32,
    /// Specialization constants in the order of their ids.
    pub constants: Cow<'static, [SpecConstant]>,
}

/// A workgroup's size along one axis: a number, which a specialization constant may replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// The number without specialization.
    pub value: u32,
    /// Id of the constant.
    pub spec_id: Option<u32>,
}

/// A buffer that a kernel binds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Binding {
    /// The block's instance name; without one, the name of its only member, else of the block.
    pub name: Cow<'static, str>,
    /// Binding number.
    pub number: u32,
    /// Access of the kernel.
    pub access: Access,
    /// Type of the values in it, as Rust writes it.
    pub holds: Cow<'static, str>,
    /// Size of a uniform buffer; `None` for a storage buffer.
    pub uniform_bytes: Option<u32>,
}

/// A member of a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Name in the shader.
    pub name: Cow<'static, str>,
    /// Type of the value, as Rust writes it.
    pub holds: Cow<'static, str>,
    /// Offset in the structure, bytes.
    pub offset: u32,
}

/// A specialization constant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpecConstant {
    /// Name in the shader. One that only sizes the workgroup goes by the axis: `local_size_x`.
    pub name: Cow<'static, str>,
    /// Id in the shader.
    pub spec_id: u32,
    /// Type of its value.
    pub kind: Kind,
}

/// A structure in a buffer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Name in the shader.
    pub name: String,
    /// Members in the order of declaration.
    pub members: Vec<Member>,
    /// Size of the structure.
    pub bytes: u32,
}

impl Size {
    /// A size that no constant replaces.
    #[must_use]
    pub const fn fixed(value: u32) -> Self {
        let spec_id = None;
        Self { value, spec_id }
    }
}

impl Interface {
    /// The workgroup size when the constants in `specialized`, by their ids, have these bits.
    #[must_use]
    pub fn workgroup_size(&self, specialized: &[(u32, u32)]) -> [u32; 3] {
        self.workgroup.map(|size| {
            let replaced = specialized.iter().find(|(id, _)| Some(*id) == size.spec_id);
            replaced.map_or(size.value, |(_, bits)| *bits)
        })
    }

    /// Difference of the buffers, push constants and constants of `other` from those of `self`, if
    /// there is one. Access may differ, and `other` may have other constants, but not of the same
    /// name and another type.
    #[must_use]
    pub fn fault(&self, other: &Self) -> Option<String> {
        let differs = |what, expected: &[String], found: &[String]| {
            (expected != found).then(|| format!("expected {what} {expected:?}, found {found:?}"))
        };
        let constant = || {
            let mut constants = self.constants.iter();
            let (own, found) = constants.find_map(|own| {
                let mut others = other.constants.iter();
                let same_name = others.find(|found| found.name == own.name)?;
                (same_name.kind != own.kind).then_some((own, same_name))
            })?;
            Some(format!(
                "expected constant {} to be {:?}, found {:?}",
                own.name, own.kind, found.kind
            ))
        };
        differs("buffers", &self.buffer_texts(), &other.buffer_texts())
            .or_else(|| differs("push constants", &self.push_texts(), &other.push_texts()))
            .or_else(constant)
    }

    fn buffer_texts(&self) -> Vec<String> {
        let text = |found: &Binding| {
            let uniform = match found.uniform_bytes {
                None => String::new(),
                Some(bytes) => format!(" ({bytes} bytes, uniform)"),
            };
            format!("{} {}: {}{uniform}", found.number, found.name, found.holds)
        };
        self.bindings.iter().map(text).collect()
    }

    fn push_texts(&self) -> Vec<String> {
        let text = |found: &Member| format!("{} {}: {}", found.offset, found.name, found.holds);
        self.push.iter().map(text).collect()
    }
}
