//! Reflection of a SPIR-V module: bindings by name, push constants, specialization constants,
//! workgroup size.

use crate::{
    Access, Binding, Interface, Kind, Member, Record, Size, SpecConstant,
    module::{DEPTH_MAX, Declarations, TOO_LARGE, Type, decoration},
};

const BUILT_IN_WORKGROUP_SIZE: u32 = 25;
const CLASS_UNIFORM_CONSTANT: u32 = 0;
const CLASS_UNIFORM: u32 = 2;
const CLASS_PUSH_CONSTANT: u32 = 9;
const CLASS_STORAGE_BUFFER: u32 = 12;

/// Reads the module's interface.
///
/// # Errors
/// A sentence, when it is no SPIR-V, has no compute entry point, or binds something other than
/// storage and uniform buffers in set 0.
pub fn reflect(words: &[u32]) -> Result<Interface, String> {
    Declarations::parse(words)?.interface()
}

/// Structures in the buffers of a module, each behind those that it holds.
///
/// # Errors
/// A sentence, as [`reflect`].
pub fn records(words: &[u32]) -> Result<Vec<Record>, String> {
    let declarations = Declarations::parse(words)?;
    let mut found = Vec::new();
    for &(_, pointer, class) in &declarations.variables {
        if [CLASS_STORAGE_BUFFER, CLASS_UNIFORM].contains(&class) {
            let held = declarations.held(declarations.pointee(pointer)?);
            declarations.add_records(held, 0, &mut found)?;
        }
    }
    Ok(found)
}

impl Declarations {
    fn interface(self) -> Result<Interface, String> {
        let entry_point = self
            .entry_point
            .clone()
            .ok_or("the SPIR-V module has no compute entry point")?;
        let mut bindings = Vec::new();
        let (mut push, mut push_bytes) = (Vec::new(), 0);
        for &(id, pointer, class) in &self.variables {
            match class {
                CLASS_STORAGE_BUFFER => bindings.push(self.binding(id, pointer, false)?),
                CLASS_UNIFORM if self.is_block(pointer) => {
                    bindings.push(self.binding(id, pointer, true)?);
                }
                CLASS_PUSH_CONSTANT => {
                    let block = self.pointee(pointer)?;
                    (push, push_bytes) = (self.members(block)?, self.bytes(block, 0)?);
                }
                CLASS_UNIFORM | CLASS_UNIFORM_CONSTANT => {
                    return Err(format!(
                        "{} is neither a storage nor a uniform buffer, and nothing else can be bound",
                        self.named(id)
                    ));
                }
                _ => {}
            }
        }
        bindings.sort_by_key(|binding: &Binding| binding.number);
        for pair in bindings.windows(2) {
            if pair[0].number == pair[1].number {
                return Err(format!(
                    "{} and {} share binding {}",
                    pair[0].name, pair[1].name, pair[0].number
                ));
            }
        }
        let workgroup = self.workgroup()?;
        let constants = self.specialization_constants(&workgroup);
        Ok(Interface {
            entry_point: entry_point.into(),
            bindings: bindings.into(),
            push: push.into(),
            push_bytes,
            constants: constants.into(),
            workgroup,
            capabilities: self.capabilities.into(),
        })
    }

    /// True if a pointer of storage class Uniform points to a uniform buffer, not to a storage
    /// buffer of SPIR-V before 1.3.
    fn is_block(&self, pointer: u32) -> bool {
        self.pointee(pointer)
            .is_ok_and(|block| self.decorations.contains_key(&(block, decoration::BLOCK)))
    }

    fn binding(&self, id: u32, pointer: u32, uniform: bool) -> Result<Binding, String> {
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
        let number =
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
        let bytes = self.bytes(block_id, 0)?;
        Ok(Binding {
            number,
            access,
            holds: self.type_text(self.held(block_id), 0)?.into(),
            uniform_bytes: uniform.then_some(bytes),
            name: name.into(),
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

    /// Type of the values in a buffer: the elements, where the block is nothing but an array; its
    /// only member, where it has one; else the block itself.
    fn held(&self, block: u32) -> u32 {
        let Some(Type::Struct { members }) = self.types.get(&block) else {
            return block;
        };
        match members[..] {
            [only] => match self.types.get(&only) {
                Some(Type::Array { element, .. }) => *element,
                _ => only,
            },
            _ => block,
        }
    }

    /// Members of structure `id`.
    fn members(&self, id: u32) -> Result<Vec<Member>, String> {
        let Some(Type::Struct { members }) = self.types.get(&id) else {
            return Err("the SPIR-V module has a buffer that is no structure".into());
        };
        let member = |(i, of): (u32, &u32)| {
            let name = self.member_names.get(&(id, i)).cloned().unwrap_or_default();
            let offset = self.member_decorations.get(&(id, i, decoration::OFFSET));
            Ok(Member {
                name: name.into(),
                holds: self.type_text(*of, 0)?.into(),
                offset: offset.copied().unwrap_or(0),
            })
        };
        (0..).zip(members).map(member).collect()
    }

    /// Adds structure `id`, and before it those that it holds, unless they are there.
    fn add_records(&self, id: u32, depth: usize, found: &mut Vec<Record>) -> Result<(), String> {
        if depth > DEPTH_MAX {
            return Err(TOO_LARGE.to_owned());
        }
        match self.types.get(&id) {
            Some(Type::Array { element, .. }) => self.add_records(*element, depth + 1, found),
            Some(Type::Struct { members }) => {
                for member in members {
                    self.add_records(*member, depth + 1, found)?;
                }
                let record = Record {
                    name: self.named(id),
                    members: self.members(id)?,
                    bytes: self.bytes(id, 0)?,
                };
                if !found.contains(&record) {
                    found.push(record);
                }
                Ok(())
            }
            _ => Ok(()),
        }
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
            (None, Some(sizes)) => Ok(sizes.map(Size::fixed)),
            (None, None) => Err("the SPIR-V module has no workgroup size".into()),
        }
    }

    /// Specialization constants with a name, as only they can be set. Compilers drop the name of a
    /// constant that only sizes the workgroup, so it is named after its purpose.
    fn specialization_constants(&self, workgroup: &[Size; 3]) -> Vec<SpecConstant> {
        let mut found: Vec<SpecConstant> = self
            .constants
            .iter()
            .filter_map(|(id, (of, _))| {
                let spec_id = *self.decorations.get(&(*id, decoration::SPEC_ID))?;
                let name = self.names.get(id).filter(|name| !name.is_empty())?.clone();
                let kind = match self.types.get(of) {
                    Some(Type::Scalar { kind, .. }) => *kind,
                    _ => Kind::Other,
                };
                Some(SpecConstant {
                    name: name.into(),
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
                found.push(SpecConstant {
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
    fn interfaces_say_names_types_and_access() {
        let interface = reflect(&layout()).unwrap();
        let bindings = interface.bindings.iter();
        let bindings: Vec<_> = bindings
            .map(|found| (&*found.name, found.number, found.access, &*found.holds))
            .collect();
        // The block with an instance name goes by it, the others by their only
        // member.
        assert_eq!(
            bindings,
            [
                ("counted", 1, Access::ReadWrite, "Counted"),
                ("item", 3, Access::Write, "Item"),
                ("items", 5, Access::Read, "Item")
            ]
        );
        assert_eq!(interface.workgroup, [8, 4, 2].map(Size::fixed));
        let members = |members: &[Member]| {
            let members = members.iter();
            members
                .map(|found| format!("{} {}: {}", found.offset, found.name, found.holds))
                .collect::<Vec<_>>()
        };
        assert_eq!(
            members(&interface.push),
            [
                "0 origin: [f32; 3]",
                "12 count: u32",
                "16 turn: [[f32; 4]; 3]"
            ]
        );
        assert_eq!(interface.push_bytes, 16 + 3 * 16);
        let found = records(&layout()).unwrap();
        let named = |name: &str| found.iter().find(|record| record.name == name).unwrap();
        assert_eq!(
            members(&named("Item").members),
            ["0 mean: [f32; 3]", "12 id: u32", "16 extent: [f32; 2]"]
        );
        assert_eq!(named("Item").bytes, 24);
        assert_eq!(
            members(&named("Counted").members),
            ["0 count: u32", "4 weights: [f32; 4]", "20 ids: [u32; 0]"]
        );
    }

    #[test]
    fn other_buffers_and_push_constants_are_a_fault() {
        let interface = reflect(&layout()).unwrap();
        let mut other = interface.clone();
        other.bindings.to_mut()[1].access = Access::ReadWrite;
        other.capabilities = vec![1, 2].into();
        assert_eq!(interface.fault(&other), None);
        let change = |change: fn(&mut Interface)| {
            let mut other = interface.clone();
            change(&mut other);
            interface.fault(&other).unwrap()
        };
        let fault = change(|other| other.bindings.to_mut()[1].holds = "u32".into());
        assert!(
            fault.contains("\"3 item: Item\"") && fault.contains("\"3 item: u32\""),
            "{fault}"
        );
        let fault = change(|other| other.bindings.to_mut()[1].name = "thing".into());
        assert!(fault.contains("3 thing: Item"), "{fault}");
        assert!(change(|other| other.bindings.to_mut()[1].number = 7).contains("7 item"));
        let fault = change(|other| other.bindings.to_mut()[1].uniform_bytes = Some(24));
        assert!(fault.contains("item: Item (24 bytes, uniform)"), "{fault}");
        let fault = change(|other| other.push.to_mut()[1].offset = 16);
        assert!(fault.starts_with("expected push constants"), "{fault}");
        let mut scale =
            reflect(&words(include_bytes!("../../gpu/tests/kernels/scale.spv"))).unwrap();
        let whole = scale.clone();
        scale.constants.to_mut().remove(2);
        assert_eq!(whole.fault(&scale), None);
        scale.constants.to_mut()[1].kind = Kind::F32;
        assert_eq!(
            whole.fault(&scale).unwrap(),
            "expected constant FACTOR to be U32, found F32"
        );
    }

    #[test]
    fn constants_that_size_the_workgroup_do_so_by_name() {
        let interface =
            reflect(&words(include_bytes!("../../gpu/tests/kernels/scale.spv"))).unwrap();
        let names: Vec<(&str, Kind)> = interface
            .constants
            .iter()
            .map(|found| (found.name.as_ref(), found.kind))
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
                interface.constants[0].name.as_ref(),
                interface.constants[0].spec_id
            ),
            ("local_size_x", 0)
        );
    }

    #[test]
    fn other_things_than_buffers_and_other_files_are_refused() {
        let texture = words(include_bytes!("../../gpu/tests/kernels/texture.spv"));
        let error = reflect(&texture).unwrap_err();
        assert!(
            error.contains("is neither a storage nor a uniform buffer"),
            "{error}"
        );
        let error = reflect(&[1, 2, 3]).unwrap_err();
        assert!(error.contains("not a SPIR-V module"), "{error}");
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
