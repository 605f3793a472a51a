//! The declarations of a SPIR-V module: everything before its first function, in tables by result
//! id.
//!
//! Numbers of instructions, decorations and storage classes are those of the SPIR-V specification
//! 1.6, section 3. We read them ourselves: the crate that reflects SPIR-V, spirq 1.3, folds
//! specialization constants while it parses, and refuses the comparisons that `if (DEGREE > 0)`
//! compiles to.

use std::collections::HashMap;

const MAGIC: u32 = 0x0723_0203;
const HEADER_WORDS: usize = 5;

/// Structures in structures that are followed; shaders of ours have two.
pub(super) const DEPTH_MAX: usize = 8;

pub(super) const TOO_LARGE: &str =
    "the SPIR-V module has a structure that is too large or too deep";
const NO_DATA: &str =
    "a buffer holds a type other than scalars, vectors, matrices, arrays and structures of them";

mod op {
    pub const NAME: u32 = 5;
    pub const MEMBER_NAME: u32 = 6;
    pub const ENTRY_POINT: u32 = 15;
    pub const EXECUTION_MODE: u32 = 16;
    pub const CAPABILITY: u32 = 17;
    pub const TYPE_BOOL: u32 = 20;
    pub const TYPE_INT: u32 = 21;
    pub const TYPE_FLOAT: u32 = 22;
    pub const TYPE_VECTOR: u32 = 23;
    pub const TYPE_MATRIX: u32 = 24;
    pub const TYPE_ARRAY: u32 = 28;
    pub const TYPE_RUNTIME_ARRAY: u32 = 29;
    pub const TYPE_STRUCT: u32 = 30;
    pub const TYPE_POINTER: u32 = 32;
    pub const CONSTANT: u32 = 43;
    pub const CONSTANT_COMPOSITE: u32 = 44;
    pub const SPEC_CONSTANT_TRUE: u32 = 48;
    pub const SPEC_CONSTANT_FALSE: u32 = 49;
    pub const SPEC_CONSTANT: u32 = 50;
    pub const SPEC_CONSTANT_COMPOSITE: u32 = 51;
    pub const FUNCTION: u32 = 54;
    pub const VARIABLE: u32 = 59;
    pub const DECORATE: u32 = 71;
    pub const MEMBER_DECORATE: u32 = 72;
    pub const EXECUTION_MODE_ID: u32 = 331;
}

pub(super) mod decoration {
    pub const BLOCK: u32 = 2;
    pub const SPEC_ID: u32 = 1;
    pub const BUILT_IN: u32 = 11;
    pub const ROW_MAJOR: u32 = 4;
    pub const ARRAY_STRIDE: u32 = 6;
    pub const MATRIX_STRIDE: u32 = 7;
    pub const NON_WRITABLE: u32 = 24;
    pub const NON_READABLE: u32 = 25;
    pub const BINDING: u32 = 33;
    pub const DESCRIPTOR_SET: u32 = 34;
    pub const OFFSET: u32 = 35;
}

const MODEL_COMPUTE: u32 = 5;
const MODE_LOCAL_SIZE: u32 = 17;
const MODE_LOCAL_SIZE_ID: u32 = 38;

/// Type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `bool`
    Bool,
    /// `uint`
    U32,
    /// `int`
    I32,
    /// `float`
    F32,
    /// Numbers of other sizes.
    Other,
}

#[derive(Debug)]
pub(super) enum Type {
    Scalar {
        kind: Kind,
        bytes: u32,
    },
    Vector {
        component: u32,
        count: u32,
    },
    /// Columns, each a vector; the stride between them belongs to the member that has the matrix.
    Matrix {
        column: u32,
        count: u32,
    },
    Array {
        element: u32,
        length: Option<u32>,
    },
    Struct {
        members: Vec<u32>,
    },
    Pointer {
        pointee: u32,
    },
}

/// The tables that the declarations of a module fill, by result id.
#[derive(Default)]
pub(super) struct Declarations {
    pub(super) entry_point: Option<String>,
    pub(super) capabilities: Vec<u32>,
    pub(super) names: HashMap<u32, String>,
    pub(super) member_names: HashMap<(u32, u32), String>,
    /// First operand of each decoration by id and decoration, 0 where it has none.
    pub(super) decorations: HashMap<(u32, u32), u32>,
    pub(super) member_decorations: HashMap<(u32, u32, u32), u32>,
    pub(super) types: HashMap<u32, Type>,
    /// Type and first word of the value.
    pub(super) constants: HashMap<u32, (u32, u32)>,
    pub(super) composites: HashMap<u32, Vec<u32>>,
    /// Id, pointer type and storage class, in order.
    pub(super) variables: Vec<(u32, u32, u32)>,
    pub(super) local_size: Option<[u32; 3]>,
    pub(super) local_size_ids: Option<[u32; 3]>,
}

impl Declarations {
    /// # Errors
    /// A sentence, when the words are no SPIR-V module or are cut off inside an instruction.
    pub(super) fn parse(words: &[u32]) -> Result<Self, String> {
        if words.len() < HEADER_WORDS || words[0] != MAGIC {
            return Err("this is not a SPIR-V module".into());
        }
        let mut declarations = Self::default();
        let mut rest = &words[HEADER_WORDS..];
        while let [first, ..] = rest {
            let (length, opcode) = ((first >> 16) as usize, first & 0xffff);
            if length == 0 || length > rest.len() {
                return Err("the SPIR-V module is cut off".into());
            }
            if opcode == op::FUNCTION {
                break;
            }
            declarations.read(opcode, &rest[1..length]);
            rest = &rest[length..];
        }
        Ok(declarations)
    }

    fn read(&mut self, opcode: u32, operands: &[u32]) {
        match (opcode, operands) {
            (op::CAPABILITY, [capability, ..]) => self.capabilities.push(*capability),
            (op::ENTRY_POINT, [MODEL_COMPUTE, _, name @ ..]) => self.entry_point = Some(text(name)),
            (op::EXECUTION_MODE, [_, MODE_LOCAL_SIZE, x, y, z]) => {
                self.local_size = Some([*x, *y, *z]);
            }
            (op::EXECUTION_MODE_ID, [_, MODE_LOCAL_SIZE_ID, x, y, z]) => {
                self.local_size_ids = Some([*x, *y, *z]);
            }
            (op::NAME, [id, name @ ..]) => drop(self.names.insert(*id, text(name))),
            (op::MEMBER_NAME, [id, member, name @ ..]) => {
                self.member_names.insert((*id, *member), text(name));
            }
            (op::DECORATE, [id, decoration, value @ ..]) => {
                self.decorations
                    .insert((*id, *decoration), value.first().copied().unwrap_or(0));
            }
            (op::MEMBER_DECORATE, [id, member, decoration, value @ ..]) => {
                self.member_decorations.insert(
                    (*id, *member, *decoration),
                    value.first().copied().unwrap_or(0),
                );
            }
            (op::CONSTANT | op::SPEC_CONSTANT, [of, id, value, ..]) => {
                self.constants.insert(*id, (*of, *value));
            }
            (op::SPEC_CONSTANT_TRUE, [of, id]) => drop(self.constants.insert(*id, (*of, 1))),
            (op::SPEC_CONSTANT_FALSE, [of, id]) => drop(self.constants.insert(*id, (*of, 0))),
            (op::CONSTANT_COMPOSITE | op::SPEC_CONSTANT_COMPOSITE, [_, id, parts @ ..]) => {
                self.composites.insert(*id, parts.to_vec());
            }
            (op::VARIABLE, [of, id, class, ..]) => self.variables.push((*id, *of, *class)),
            _ => self.read_type(opcode, operands),
        }
    }

    fn read_type(&mut self, opcode: u32, operands: &[u32]) {
        let (id, read) = match (opcode, operands) {
            (op::TYPE_BOOL, [id]) => (
                id,
                Type::Scalar {
                    kind: Kind::Bool,
                    bytes: 4,
                },
            ),
            (op::TYPE_INT, [id, 32, 0]) => (
                id,
                Type::Scalar {
                    kind: Kind::U32,
                    bytes: 4,
                },
            ),
            (op::TYPE_INT, [id, 32, _]) => (
                id,
                Type::Scalar {
                    kind: Kind::I32,
                    bytes: 4,
                },
            ),
            (op::TYPE_FLOAT, [id, 32, ..]) => (
                id,
                Type::Scalar {
                    kind: Kind::F32,
                    bytes: 4,
                },
            ),
            (op::TYPE_INT | op::TYPE_FLOAT, [id, bits, ..]) => (
                id,
                Type::Scalar {
                    kind: Kind::Other,
                    bytes: bits / 8,
                },
            ),
            (op::TYPE_VECTOR, [id, component, count]) => (
                id,
                Type::Vector {
                    component: *component,
                    count: *count,
                },
            ),
            (op::TYPE_MATRIX, [id, column, count]) => (
                id,
                Type::Matrix {
                    column: *column,
                    count: *count,
                },
            ),
            (op::TYPE_ARRAY, [id, element, length]) => (
                id,
                Type::Array {
                    element: *element,
                    length: Some(*length),
                },
            ),
            (op::TYPE_RUNTIME_ARRAY, [id, element]) => (
                id,
                Type::Array {
                    element: *element,
                    length: None,
                },
            ),
            (op::TYPE_STRUCT, [id, members @ ..]) => (
                id,
                Type::Struct {
                    members: members.to_vec(),
                },
            ),
            (op::TYPE_POINTER, [id, _, pointee]) => (id, Type::Pointer { pointee: *pointee }),
            _ => return,
        };
        self.types.insert(*id, read);
    }

    pub(super) fn named(&self, id: u32) -> String {
        self.names
            .get(&id)
            .filter(|name| !name.is_empty())
            .cloned()
            .unwrap_or_else(|| format!("variable {id}"))
    }

    pub(super) fn pointee(&self, pointer: u32) -> Result<u32, String> {
        match self.types.get(&pointer) {
            Some(Type::Pointer { pointee }) => Ok(*pointee),
            _ => Err("the SPIR-V module has a variable that is no pointer".into()),
        }
    }

    /// A type as Rust writes it: `u32`, `[f32; 3]`, the name of a structure.
    pub(super) fn type_text(&self, id: u32, depth: usize) -> Result<String, String> {
        if depth > DEPTH_MAX {
            return Err(TOO_LARGE.to_owned());
        }
        let array =
            |of: u32, count: u32| Ok(format!("[{}; {count}]", self.type_text(of, depth + 1)?));
        match self.types.get(&id) {
            Some(Type::Scalar { kind, bytes }) => Ok(match kind {
                Kind::Bool => "bool".to_owned(),
                Kind::U32 => "u32".to_owned(),
                Kind::I32 => "i32".to_owned(),
                Kind::F32 => "f32".to_owned(),
                Kind::Other => format!("number of {bytes} bytes"),
            }),
            Some(
                Type::Vector {
                    component: of,
                    count,
                }
                | Type::Matrix { column: of, count },
            ) => array(*of, *count),
            Some(Type::Array { element, length }) => {
                let length = length.and_then(|length| self.constants.get(&length));
                array(*element, length.map_or(0, |(_, value)| *value))
            }
            Some(Type::Struct { .. }) => Ok(self.named(id)),
            _ => Err(NO_DATA.to_owned()),
        }
    }

    /// Size of a type in memory; an array of open length counts nothing.
    pub(super) fn bytes(&self, id: u32, depth: usize) -> Result<u32, String> {
        let too_large = || TOO_LARGE.to_owned();
        if depth > DEPTH_MAX {
            return Err(too_large());
        }
        match self.types.get(&id) {
            Some(Type::Scalar { bytes, .. }) => Ok(*bytes),
            Some(Type::Vector { component, count }) => self
                .bytes(*component, depth + 1)?
                .checked_mul(*count)
                .ok_or_else(too_large),
            Some(Type::Array { length: None, .. }) => Ok(0),
            Some(Type::Array {
                length: Some(length),
                ..
            }) => {
                let stride = self
                    .decorations
                    .get(&(id, decoration::ARRAY_STRIDE))
                    .copied()
                    .unwrap_or(0);
                let count = self.constants.get(length).map_or(0, |(_, value)| *value);
                stride.checked_mul(count).ok_or_else(too_large)
            }
            Some(Type::Struct { members }) => {
                let mut end = 0;
                for (i, member) in members.iter().enumerate() {
                    let offset = self
                        .member_decorations
                        .get(&(id, i as u32, decoration::OFFSET))
                        .copied()
                        .unwrap_or(0);
                    let bytes = match self.matrix_bytes(id, i as u32, *member) {
                        Some(bytes) => bytes,
                        None => self.bytes(*member, depth + 1)?,
                    };
                    end = end.max(offset.checked_add(bytes).ok_or_else(too_large)?);
                }
                Ok(end)
            }
            _ => Err(NO_DATA.to_owned()),
        }
    }

    /// Size of a matrix that is member `i` of structure `id`; `None` when it is none.
    fn matrix_bytes(&self, id: u32, i: u32, member: u32) -> Option<u32> {
        let Some(Type::Matrix { column, count }) = self.types.get(&member) else {
            return None;
        };
        let of = |decoration| self.member_decorations.get(&(id, i, decoration)).copied();
        let vectors = match (of(decoration::ROW_MAJOR), self.types.get(column)) {
            (Some(_), Some(Type::Vector { count: rows, .. })) => *rows,
            _ => *count,
        };
        of(decoration::MATRIX_STRIDE)?.checked_mul(vectors)
    }
}

/// A literal string: UTF-8 in little-endian words, ended by a zero byte.
fn text(words: &[u32]) -> String {
    let bytes: Vec<u8> = words
        .iter()
        .flat_map(|word| word.to_le_bytes())
        .take_while(|&byte| byte != 0)
        .collect();
    String::from_utf8_lossy(&bytes).into_owned()
}
