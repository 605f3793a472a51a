//! Reflection of a SPIR-V module: bindings by name, push constants, specialization constants,
//! workgroup size.

use crate::{
    Access,
    module::{Declarations, Kind, Type, decoration},
};

const BUILT_IN_WORKGROUP_SIZE: u32 = 25;
const CLASS_UNIFORM_CONSTANT: u32 = 0;
const CLASS_UNIFORM: u32 = 2;
const CLASS_PUSH_CONSTANT: u32 = 9;
const CLASS_STORAGE_BUFFER: u32 = 12;

/// A compute module's interface.
#[derive(Debug)]
pub struct Interface {
    /// Name of the function that runs.
    pub entry_point: String,
    /// Bindings in the order of their number.
    pub bindings: Vec<ReflectedBinding>,
    /// Push constants.
    pub push: Option<Block>,
    /// Specialization constants in the order of their ids.
    pub constants: Vec<ReflectedConstant>,
    /// Numbers of the declared capabilities.
    pub capabilities: Vec<u32>,
    workgroup: [Size; 3],
}

/// A buffer that a module binds.
#[derive(Debug)]
pub struct ReflectedBinding {
    /// The block's instance name; without one, the name of its only member, else of the block.
    pub name: String,
    /// Binding number.
    pub binding: u32,
    /// Access of the module.
    pub access: Access,
    /// True for a uniform buffer, false for a storage buffer.
    pub uniform: bool,
    /// Layout of its content.
    pub block: Block,
}

/// The memory layout of what a buffer holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Block {
    /// Names and offsets of the members; of the element's, where the block is nothing but an array
    /// of structures.
    pub members: Vec<(String, u32)>,
    /// Bytes from element to element, where the block is nothing but an array.
    pub stride: Option<u32>,
    /// Size without a trailing array of open length.
    pub bytes: u32,
}

/// A specialization constant.
#[derive(Debug)]
pub struct ReflectedConstant {
    /// Name in the shader.
    pub name: String,
    /// Id in the shader.
    pub spec_id: u32,
    /// Type of its value.
    pub kind: Kind,
}

/// A workgroup's size along one axis: a number, which a specialization constant may replace.
#[derive(Clone, Copy, Debug)]
struct Size {
    value: u32,
    spec_id: Option<u32>,
}

impl Interface {
    /// The workgroup size when the constants in `specialized`, by their ids, have these bits.
    pub fn workgroup_size(&self, specialized: &[(u32, u32)]) -> [u32; 3] {
        self.workgroup.map(|size| {
            let replaced = specialized.iter().find(|(id, _)| Some(*id) == size.spec_id);
            replaced.map_or(size.value, |(_, bits)| *bits)
        })
    }
}

/// Reads the module's interface.
///
/// # Errors
/// A sentence, when it is no SPIR-V, has no compute entry point, or binds something other than
/// storage and uniform buffers in set 0.
pub fn reflect(words: &[u32]) -> Result<Interface, String> {
    Declarations::parse(words)?.interface()
}

impl Declarations {
    fn interface(self) -> Result<Interface, String> {
        let entry_point = self
            .entry_point
            .clone()
            .ok_or("the SPIR-V module has no compute entry point")?;
        let mut bindings = Vec::new();
        let mut push = None;
        for &(id, pointer, class) in &self.variables {
            match class {
                CLASS_STORAGE_BUFFER => bindings.push(self.binding(id, pointer, false)?),
                CLASS_UNIFORM if self.is_block(pointer) => {
                    bindings.push(self.binding(id, pointer, true)?);
                }
                CLASS_PUSH_CONSTANT => push = Some(self.block(self.pointee(pointer)?)?),
                CLASS_UNIFORM | CLASS_UNIFORM_CONSTANT => {
                    return Err(format!(
                        "{} is neither a storage nor a uniform buffer, and nothing else can be bound",
                        self.named(id)
                    ));
                }
                _ => {}
            }
        }
        bindings.sort_by_key(|binding| binding.binding);
        for pair in bindings.windows(2) {
            if pair[0].binding == pair[1].binding {
                return Err(format!(
                    "{} and {} share binding {}",
                    pair[0].name, pair[1].name, pair[0].binding
                ));
            }
        }
        let workgroup = self.workgroup()?;
        let constants = self.specialization_constants(&workgroup);
        Ok(Interface {
            entry_point,
            bindings,
            push,
            constants,
            workgroup,
            capabilities: self.capabilities,
        })
    }

    /// True if a pointer of storage class Uniform points to a uniform buffer, not to a storage
    /// buffer of SPIR-V before 1.3.
    fn is_block(&self, pointer: u32) -> bool {
        self.pointee(pointer)
            .is_ok_and(|block| self.decorations.contains_key(&(block, decoration::BLOCK)))
    }

    fn binding(&self, id: u32, pointer: u32, uniform: bool) -> Result<ReflectedBinding, String> {
        let block_id = self.pointee(pointer)?;
        let name = self.binding_name(id, block_id);
        let of = |decoration| self.decorations.get(&(id, decoration)).copied();
        match of(decoration::DESCRIPTOR_SET) {
            Some(0) => {}
            set => {
                return Err(format!(
                    "{name} is in descriptor set {set:?}, expected set 0"
                ));
            }
        }
        let binding =
            of(decoration::BINDING).ok_or_else(|| format!("{name} has no binding number"))?;
        let Some(Type::Struct { members }) = self.types.get(&block_id) else {
            return Err(format!(
                "{name} is an array of buffers, and only single buffers can be bound"
            ));
        };
        let all = |decoration| {
            let whole = self.decorations.contains_key(&(id, decoration));
            let mut each = (0..members.len() as u32).map(|member| {
                self.member_decorations
                    .contains_key(&(block_id, member, decoration))
            });
            whole || (!members.is_empty() && each.all(|there| there))
        };
        let read_only = uniform || all(decoration::NON_WRITABLE);
        let access = match (read_only, all(decoration::NON_READABLE)) {
            (true, _) => Access::Read,
            (false, true) => Access::Write,
            (false, false) => Access::ReadWrite,
        };
        Ok(ReflectedBinding {
            binding,
            access,
            uniform,
            block: self.block(block_id)?,
            name,
        })
    }

    /// The instance's name; where the block has none, its only member's, which is what the shader
    /// writes then; else the block's.
    fn binding_name(&self, id: u32, block: u32) -> String {
        let instance = self.names.get(&id).filter(|name| !name.is_empty());
        let only_member = match self.types.get(&block) {
            Some(Type::Struct { members }) if members.len() == 1 => {
                self.member_names.get(&(block, 0))
            }
            _ => None,
        };
        instance
            .or(only_member)
            .or_else(|| self.names.get(&block))
            .cloned()
            .unwrap_or_default()
    }

    fn block(&self, id: u32) -> Result<Block, String> {
        let bytes = self.bytes(id, 0)?;
        let Some(Type::Struct { members }) = self.types.get(&id) else {
            return Err("the SPIR-V module has a buffer that is no structure".into());
        };
        if let [only] = members[..] {
            match self.types.get(&only) {
                Some(Type::Array { element, .. }) => {
                    let described = if self.is_struct(*element) {
                        *element
                    } else {
                        id
                    };
                    let stride = self
                        .decorations
                        .get(&(only, decoration::ARRAY_STRIDE))
                        .copied();
                    return Ok(Block {
                        members: self.members(described),
                        stride,
                        bytes,
                    });
                }
                Some(Type::Struct { .. }) => {
                    return Ok(Block {
                        members: self.members(only),
                        stride: None,
                        bytes,
                    });
                }
                _ => {}
            }
        }
        Ok(Block {
            members: self.members(id),
            stride: None,
            bytes,
        })
    }

    /// `WorkgroupSize`, where a module has it, goes before the execution mode.
    fn workgroup(&self) -> Result<[Size; 3], String> {
        let built_in = self.composites.iter().find_map(|(id, parts)| {
            let is_size = self.decorations.get(&(*id, decoration::BUILT_IN))
                == Some(&BUILT_IN_WORKGROUP_SIZE);
            is_size.then(|| parts.as_slice().try_into().ok()).flatten()
        });
        let ids: Option<[u32; 3]> = built_in.or(self.local_size_ids);
        match (ids, self.local_size) {
            (Some(ids), _) => {
                let sizes = ids.map(|id| {
                    let value = self.constants.get(&id).map(|(_, value)| *value)?;
                    Some(Size {
                        value,
                        spec_id: self.decorations.get(&(id, decoration::SPEC_ID)).copied(),
                    })
                });
                match sizes {
                    [Some(x), Some(y), Some(z)] => Ok([x, y, z]),
                    _ => Err(
                        "the workgroup size is computed from constants: give it as constants"
                            .into(),
                    ),
                }
            }
            (None, Some(sizes)) => Ok(sizes.map(|value| Size {
                value,
                spec_id: None,
            })),
            (None, None) => Err("the SPIR-V module has no workgroup size".into()),
        }
    }

    /// Specialization constants with a name, as only they can be set. Compilers drop the name of a
    /// constant that only sizes the workgroup, so it is named after its purpose.
    fn specialization_constants(&self, workgroup: &[Size; 3]) -> Vec<ReflectedConstant> {
        let mut found: Vec<ReflectedConstant> = self
            .constants
            .iter()
            .filter_map(|(id, (of, _))| {
                let spec_id = *self.decorations.get(&(*id, decoration::SPEC_ID))?;
                let name = self.names.get(id).filter(|name| !name.is_empty())?.clone();
                let kind = match self.types.get(of) {
                    Some(Type::Scalar { kind, .. }) => *kind,
                    _ => Kind::Other,
                };
                Some(ReflectedConstant {
                    name,
                    spec_id,
                    kind,
                })
            })
            .collect();
        for (size, name) in workgroup
            .iter()
            .zip(["local_size_x", "local_size_y", "local_size_z"])
        {
            if let Some(spec_id) = size
                .spec_id
                .filter(|id| found.iter().all(|constant| constant.spec_id != *id))
            {
                found.push(ReflectedConstant {
                    name: name.into(),
                    spec_id,
                    kind: Kind::U32,
                });
            }
        }
        found.sort_by_key(|constant| constant.spec_id);
        found
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn words(bytes: &[u8]) -> Vec<u32> {
        bytes
            .chunks_exact(4)
            .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
            .collect()
    }

    fn layout() -> Vec<u32> {
        words(include_bytes!("../../gpu/tests/kernels/layout.spv"))
    }

    #[test]
    fn constants_that_size_the_workgroup_do_so_by_name() {
        let interface =
            reflect(&words(include_bytes!("../../gpu/tests/kernels/scale.spv"))).unwrap();
        let names: Vec<(&str, Kind)> = interface
            .constants
            .iter()
            .map(|found| (found.name.as_str(), found.kind))
            .collect();
        let expected = [
            ("GROUP_SIZE", Kind::U32),
            ("FACTOR", Kind::U32),
            ("NEGATE", Kind::Bool),
            ("UNUSED_SCALE", Kind::F32),
        ];
        assert_eq!(names, expected);
        assert_eq!(interface.workgroup_size(&[(1, 5), (0, 256)]), [256, 1, 1]);
        // GLSL's default for a size that is a constant is 1, whatever the named constant's is.
        assert_eq!(interface.workgroup_size(&[]), [1, 1, 1]);
    }

    #[test]
    fn a_constant_without_a_name_goes_by_what_it_sizes() {
        let mut words = words(include_bytes!("../../gpu/tests/kernels/scale.spv"));
        // Take the name GROUP_SIZE out of the module, as an optimizer does when nothing else uses
        // the constant.
        let start = [u32::from_le_bytes(*b"GROU"), u32::from_le_bytes(*b"P_SI")];
        const OP_NAME: u32 = 5;
        let is_name =
            |at: &usize| words[*at..].starts_with(&start) && words[*at - 2] & 0xffff == OP_NAME;
        let name = (2..words.len()).find(is_name).unwrap();
        words[name] = 0;
        let interface = reflect(&words).unwrap();
        assert_eq!(
            (
                interface.constants[0].name.as_str(),
                interface.constants[0].spec_id
            ),
            ("local_size_x", 0)
        );
    }

    #[test]
    fn every_truncation_is_read_without_panic() {
        let words = layout();
        for length in 0..words.len() {
            // Cut behind the first function there is nothing left to read: that is as good as
            // whole.
            let _ = reflect(&words[..length]);
        }
        assert!(reflect(&words[..words.len() / 4]).is_err());
        assert!(reflect(&words).is_ok());
    }

    proptest! {
        #[test]
        fn changed_words_are_read_without_panic(at in 0..layout().len(), word: u32, more in 0..layout().len(), small in 0_u32..100) {
            let mut words = layout();
            words[at] = word;
            words[more] = small;
            let _ = reflect(&words);
        }
    }
}
