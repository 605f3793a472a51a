//! The stack machine that a pickle instructs. It builds nodes; it calls nothing.

use std::collections::HashMap;

use super::tensor::{Form, Scalar};
use super::value::{Id, Node, Storage, Tree};
use crate::DecodeError;

/// Modules whose classes stand in checkpoints of trainers. They are names here and nothing more.
const MODULES: [&str; 8] = [
    "torch",
    "collections",
    "numpy",
    "_codecs",
    "omegaconf",
    "argparse",
    "pathlib",
    "easydict",
];
/// Python types that occur in checkpoints. All of them only hold data.
const TYPES: [&str; 12] = [
    "set",
    "frozenset",
    "dict",
    "list",
    "tuple",
    "int",
    "float",
    "bool",
    "str",
    "bytes",
    "complex",
    "slice",
];

/// Nodes, the stack and what is remembered. Each instruction adds a node at most, so a pickle takes
/// a small multiple of its length.
#[derive(Debug, Default)]
pub(super) struct Machine {
    nodes: Vec<Node>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
}

impl Machine {
    pub(super) fn new() -> Self {
        Self::default()
    }

    /// Result: the only object on the stack.
    pub(super) fn finish(mut self) -> Result<Tree, DecodeError> {
        let root = self.pop()?;
        Ok(Tree::new(self.nodes, root))
    }

    pub(super) fn push(&mut self, node: Node) {
        let id = self.nodes.len() as Id;
        self.nodes.push(node);
        self.stack.push(id);
    }

    pub(super) fn pop(&mut self) -> Result<Id, DecodeError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let found = if self.stack.len() > floor {
            self.stack.pop()
        } else {
            None
        };
        found.ok_or_else(|| malformed("an instruction wants more than there is"))
    }

    /// The last `count` things, in the order in which they came.
    pub(super) fn pop_many(&mut self, count: usize) -> Result<Vec<Id>, DecodeError> {
        let mut items = (0..count)
            .map(|_| self.pop())
            .collect::<Result<Vec<Id>, _>>()?;
        items.reverse();
        Ok(items)
    }

    pub(super) fn mark(&mut self) {
        self.marks.push(self.stack.len());
    }

    /// Pops everything above the last mark, and the mark.
    pub(super) fn pop_to_mark(&mut self) -> Result<Vec<Id>, DecodeError> {
        let mark = self
            .marks
            .pop()
            .ok_or_else(|| malformed("an instruction wants a mark that nobody set"))?;
        Ok(self.stack.split_off(mark.min(self.stack.len())))
    }

    pub(super) fn duplicate(&mut self) -> Result<(), DecodeError> {
        let top = self.pop()?;
        self.stack.extend([top, top]);
        Ok(())
    }

    pub(super) fn remember(&mut self, slot: u32) -> Result<(), DecodeError> {
        let top = *self
            .stack
            .last()
            .ok_or_else(|| malformed("there is nothing to remember"))?;
        self.memo.insert(slot, top);
        Ok(())
    }

    /// Remembers in the next slot, as protocol 4 numbers them.
    pub(super) fn remember_next(&mut self) -> Result<(), DecodeError> {
        let slot = self.memo.len() as u32;
        self.remember(slot)
    }

    pub(super) fn recall(&mut self, slot: u32) -> Result<(), DecodeError> {
        let id = *self
            .memo
            .get(&slot)
            .ok_or_else(|| malformed("it recalls what it never remembered"))?;
        self.stack.push(id);
        Ok(())
    }

    /// Adds `items` to the list on the stack.
    pub(super) fn append(&mut self, items: &[Id]) -> Result<(), DecodeError> {
        match self.top()? {
            Node::List(list) => list.extend_from_slice(items),
            Node::Opaque => {}
            other => return Err(malformed(&format!("it appends to {}", other.kind()))),
        }
        Ok(())
    }

    /// Sets keys and values, alternating in `pairs`, in the dictionary on the stack.
    pub(super) fn set_items(&mut self, pairs: &[Id]) -> Result<(), DecodeError> {
        match self.top()? {
            Node::Dictionary(dictionary) => {
                dictionary.extend(pairs.chunks_exact(2).map(|pair| (pair[0], pair[1])));
            }
            Node::Opaque => {}
            other => return Err(malformed(&format!("it sets items of {}", other.kind()))),
        }
        Ok(())
    }

    fn top(&mut self) -> Result<&mut Node, DecodeError> {
        let top = *self
            .stack
            .last()
            .ok_or_else(|| malformed("there is nothing to put into"))?;
        Ok(&mut self.nodes[top as usize])
    }

    /// The name of a class or function, if it is one that checkpoints have.
    pub(super) fn global(&mut self, module: &str, name: &str) -> Result<(), DecodeError> {
        let family = module.split('.').next().unwrap_or_default();
        let is_type = matches!(family, "builtins" | "__builtin__") && TYPES.contains(&name);
        if !is_type && !MODULES.contains(&family) {
            let shown: String = format!("{module} {name}").chars().take(80).collect();
            return Err(DecodeError::Unsupported(format!(
                "it names '{shown}', which no checkpoint of splats needs: it would run that. Nothing was run; save tensors alone"
            )));
        }
        self.push(Node::Global(format!("{module} {name}")));
        Ok(())
    }

    pub(super) fn stack_global(&mut self) -> Result<(), DecodeError> {
        let names = self.pop_many(2)?;
        match [self.node(names[0]), self.node(names[1])] {
            [Node::Text(module), Node::Text(name)] => {
                let (module, name) = (module.clone(), name.clone());
                self.global(&module, &name)
            }
            _ => Err(malformed("the name of a class is no text")),
        }
    }

    /// Replaces the function and the arguments on top of the stack by the result of the call, for
    /// known functions.
    pub(super) fn reduce(&mut self) -> Result<(), DecodeError> {
        let arguments = self.pop()?;
        let function = self.pop()?;
        let Node::Global(name) = self.node(function) else {
            // A call of what another call made.
            self.push(Node::Opaque);
            return Ok(());
        };
        let items = if let Node::List(items) = self.node(arguments) {
            items.as_slice()
        } else {
            &[]
        };
        let first = items.first().copied();
        match (name.as_str(), first) {
            ("torch._utils _rebuild_tensor_v2" | "torch._utils _rebuild_tensor", _) => {
                let tensor = self.tensor(items)?;
                self.push(tensor);
            }
            (
                "torch._utils _rebuild_parameter"
                | "torch._utils _rebuild_parameter_with_state"
                | "torch Size",
                Some(id),
            ) => {
                self.stack.push(id);
            }
            (
                "collections OrderedDict"
                | "collections defaultdict"
                | "builtins dict"
                | "__builtin__ dict",
                _,
            ) => {
                self.push(Node::Dictionary(Vec::new()));
            }
            ("builtins set" | "__builtin__ set", Some(id)) => self.stack.push(id),
            _ => self.push(Node::Opaque),
        }
        Ok(())
    }

    /// An object of the class below: a dictionary where it is a kind of one.
    pub(super) fn new_object(&mut self) -> Result<(), DecodeError> {
        self.pop()?;
        let class = self.pop()?;
        let is_dictionary =
            matches!(self.node(class), Node::Global(name) if name == "collections OrderedDict");
        self.push(if is_dictionary {
            Node::Dictionary(Vec::new())
        } else {
            Node::Opaque
        });
        Ok(())
    }

    /// Resolves data outside of the pickle: the storage of a tensor, named by ('storage', class,
    /// key, device, count).
    pub(super) fn persistent(&mut self) -> Result<(), DecodeError> {
        let id = self.pop()?;
        let Node::List(items) = self.node(id) else {
            return Err(malformed("a storage is named by no tuple"));
        };
        let of = |at: usize| items.get(at).map_or(&Node::None, |&id| self.node(id));
        let (Node::Text(kind), Node::Global(class), Node::Text(key)) = (of(0), of(1), of(2)) else {
            return Err(malformed(
                "a storage is named by other things than 'storage', a class and a key",
            ));
        };
        let is_plain = !key.is_empty()
            && key
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
        if kind != "storage" || !is_plain {
            return Err(malformed("a storage has no plain name"));
        }
        let Some(scalar) = Scalar::of_class(class) else {
            return Err(DecodeError::Unsupported(format!(
                "numbers of '{class}' are not read; save floats and integers"
            )));
        };
        let node = Node::Storage(Box::new(Storage {
            key: key.clone(),
            scalar,
        }));
        self.push(node);
        Ok(())
    }

    /// The tensor of (storage, offset, shape, strides, ...).
    fn tensor(&self, arguments: &[Id]) -> Result<Node, DecodeError> {
        let &[storage, offset, shape, strides, ..] = arguments else {
            return Err(malformed("a tensor has fewer than four arguments"));
        };
        let sizes = |id: Id| {
            let Node::List(items) = self.node(id) else {
                return None;
            };
            items
                .iter()
                .map(|&id| self.size(id))
                .collect::<Option<Vec<u64>>>()
        };
        match (
            self.node(storage),
            self.size(offset),
            sizes(shape),
            sizes(strides),
        ) {
            (Node::Storage(_), Some(offset), Some(shape), Some(strides)) => {
                Ok(Node::Tensor(Box::new(Form {
                    storage,
                    offset,
                    shape,
                    strides,
                })))
            }
            _ => Err(malformed(
                "a tensor is not a storage, an offset, sizes and strides",
            )),
        }
    }

    fn size(&self, id: Id) -> Option<u64> {
        if let Node::Int(value) = self.node(id) {
            u64::try_from(*value).ok()
        } else {
            None
        }
    }

    fn node(&self, id: Id) -> &Node {
        &self.nodes[id as usize]
    }
}

fn malformed(message: &str) -> DecodeError {
    DecodeError::Malformed(message.to_owned())
}
