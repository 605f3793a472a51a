//! Tree that a pickle builds: nodes refer to each other by index, because a node may be in several
//! containers or in itself.

use super::tensor::{Form, Scalar};

/// The index of a node.
pub(crate) type Id = u32;

/// Something that a pickle built. Small, because a byte of a pickle may build one: see
/// `PICKLE_BYTES_MAX`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Node {
    /// Python's `None`, and what is not there.
    None,
    /// A truth value.
    Bool(bool),
    /// An integer of 64 bits.
    Int(i64),
    /// A floating point number.
    Float(f64),
    /// A string of text.
    Text(String),
    /// A list, tuple or set.
    List(Vec<Id>),
    /// Keys and values of a dictionary in the order they were set.
    Dictionary(Vec<(Id, Id)>),
    /// The name of a class or function, `module name`.
    Global(String),
    /// An object of a class that is not read.
    Opaque,
    /// The numbers of tensors.
    Storage(Box<Storage>),
    /// A tensor.
    Tensor(Box<Form>),
}

/// The numbers of tensors, an entry of the zip.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Storage {
    /// Names the entry.
    pub(crate) key: String,
    /// Scalar type of the elements.
    pub(crate) scalar: Scalar,
}

impl Node {
    /// Kind of the node, for messages.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::None => "None",
            Self::Bool(_) => "a truth value",
            Self::Int(_) => "an integer",
            Self::Float(_) => "a number",
            Self::Text(_) => "a text",
            Self::List(_) => "a list",
            Self::Dictionary(_) => "a dictionary",
            Self::Global(_) => "a class",
            Self::Opaque => "an object of a class that is not read",
            Self::Storage(_) => "a storage",
            Self::Tensor(_) => "a tensor",
        }
    }
}

/// All nodes of a pickle.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    nodes: Vec<Node>,
    root: Id,
}

impl Tree {
    pub(super) fn new(nodes: Vec<Node>, root: Id) -> Self {
        Self { nodes, root }
    }

    /// The node at an index; ids come from the same tree.
    pub(crate) fn node(&self, id: Id) -> &Node {
        self.nodes.get(id as usize).unwrap_or(&Node::None)
    }

    /// Root node.
    pub(crate) fn root(&self) -> &Node {
        self.node(self.root)
    }

    /// The value at `key` of a dictionary, the last one set. None where there is no such key or no
    /// dictionary.
    pub(crate) fn get(&self, node: &Node, key: &str) -> Option<&Node> {
        let Node::Dictionary(pairs) = node else {
            return None;
        };
        let is_key = |id: Id| matches!(self.node(id), Node::Text(text) if text == key);
        pairs
            .iter()
            .rev()
            .find(|(id, _)| is_key(*id))
            .map(|(_, value)| self.node(*value))
    }

    /// Items of a list or tuple; none of what is no list.
    pub(crate) fn items<'t>(&'t self, node: &'t Node) -> impl ExactSizeIterator<Item = &'t Node> {
        let ids = if let Node::List(ids) = node {
            ids.as_slice()
        } else {
            &[]
        };
        ids.iter().map(|&id| self.node(id))
    }

    /// The keys of a dictionary that are texts, in order.
    pub(crate) fn keys<'t>(&'t self, node: &'t Node) -> impl Iterator<Item = &'t str> {
        let pairs = if let Node::Dictionary(pairs) = node {
            pairs.as_slice()
        } else {
            &[]
        };
        pairs.iter().filter_map(|(key, _)| {
            if let Node::Text(text) = self.node(*key) {
                Some(text.as_str())
            } else {
                None
            }
        })
    }
}
