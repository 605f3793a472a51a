//! The instructions of a pickle, protocols 2 to 5, read one by one.

use super::stack::Machine;
use super::value::{Node, Tree};
use crate::DecodeError;

/// Protocol that introduced nothing newer than what is read.
const PROTOCOL_MAX: u8 = 5;

/// Runs a pickle over a [`Machine`] that can build and nothing else.
pub(super) struct Unpickler<'a> {
    rest: &'a [u8],
    machine: Machine,
}

impl<'a> Unpickler<'a> {
    pub(super) fn new(pickle: &'a [u8]) -> Self {
        Self {
            rest: pickle,
            machine: Machine::new(),
        }
    }

    /// Runs the pickle and returns the tree that it builds.
    pub(super) fn run(mut self) -> Result<Tree, DecodeError> {
        let whole = self.rest.len();
        loop {
            let at = whole - self.rest.len();
            let instruction = self.byte()?;
            if instruction == b'.' {
                return self.machine.finish();
            }
            let done = match instruction {
                b'0' | b'1' | b'2' | b'(' => self.shuffle(instruction),
                b'a' | b'b' | b'e' | b's' | b'u' | 0x90 => self.fill(instruction),
                b'}' | b']' | b')' | b't' | 0x85..=0x87 | 0x8f | 0x91 => {
                    self.container(instruction)
                }
                b'N' | 0x88 | 0x89 | b'J' | b'K' | b'M' | 0x8a | b'G' => self.number(instruction),
                b'X' | 0x8c | 0x8d | b'B' | b'C' | 0x8e | 0x96 | b'T' | b'U' => {
                    self.text(instruction)
                }
                b'c' | 0x93 | b'R' | 0x81 | 0x92 | b'Q' => self.object(instruction),
                b'h' | b'j' | b'q' | b'r' | 0x94 => self.memo(instruction),
                0x80 => self.protocol(),
                // The length of a frame: frames are read as what they hold.
                0x95 => self.take(8).map(|_| ()),
                other => Err(malformed(format!(
                    "instruction {other:#04x} is in no checkpoint that PyTorch writes"
                ))),
            };
            done.map_err(|error| malformed(format!("the pickle, at byte {at}: {error}")))?;
        }
    }

    fn protocol(&mut self) -> Result<(), DecodeError> {
        match self.byte()? {
            0..=PROTOCOL_MAX => Ok(()),
            other => Err(malformed(format!(
                "protocol {other} is unknown; 2 to {PROTOCOL_MAX} are read"
            ))),
        }
    }

    /// Instructions that move what is on the stack.
    fn shuffle(&mut self, instruction: u8) -> Result<(), DecodeError> {
        match instruction {
            b'0' => self.machine.pop().map(|_| ()),
            b'1' => self.machine.pop_to_mark().map(|_| ()),
            b'2' => self.machine.duplicate(),
            _ => {
                self.machine.mark();
                Ok(())
            }
        }
    }

    /// Instructions that put things into a container below them.
    fn fill(&mut self, instruction: u8) -> Result<(), DecodeError> {
        match instruction {
            b'a' => {
                let item = self.machine.pop()?;
                self.machine.append(&[item])
            }
            b's' => {
                let value = self.machine.pop()?;
                let key = self.machine.pop()?;
                self.machine.set_items(&[key, value])
            }
            b'u' => {
                let pairs = self.machine.pop_to_mark()?;
                self.machine.set_items(&pairs)
            }
            // The state of an object: what is read of objects has none.
            b'b' => self.machine.pop().map(|_| ()),
            _ => {
                let items = self.machine.pop_to_mark()?;
                self.machine.append(&items)
            }
        }
    }

    /// Instructions that make a container.
    fn container(&mut self, instruction: u8) -> Result<(), DecodeError> {
        let node = match instruction {
            b'}' => Node::Dictionary(Vec::new()),
            b't' | 0x91 => Node::List(self.machine.pop_to_mark()?),
            0x85..=0x87 => Node::List(self.machine.pop_many(usize::from(instruction - 0x84))?),
            _ => Node::List(Vec::new()),
        };
        self.machine.push(node);
        Ok(())
    }

    /// Instructions that make a number or nothing.
    fn number(&mut self, instruction: u8) -> Result<(), DecodeError> {
        let node = match instruction {
            b'N' => Node::None,
            0x88 => Node::Bool(true),
            0x89 => Node::Bool(false),
            b'J' => Node::Int(i32::from_le_bytes(self.array()?).into()),
            b'K' => Node::Int(self.byte()?.into()),
            b'M' => Node::Int(u16::from_le_bytes(self.array()?).into()),
            b'G' => Node::Float(f64::from_be_bytes(self.array()?)),
            _ => self.long()?,
        };
        self.machine.push(node);
        Ok(())
    }

    /// Reads an integer of up to 255 bytes. Integers beyond 64 bits are seeds and hashes, which are
    /// not used.
    fn long(&mut self) -> Result<Node, DecodeError> {
        let length = usize::from(self.byte()?);
        let bytes = self.take(length)?;
        if length > 8 {
            return Ok(Node::Opaque);
        }
        let fill = if bytes.last().is_some_and(|last| last & 0x80 != 0) {
            0xff
        } else {
            0
        };
        Ok(Node::Int(i64::from_le_bytes(std::array::from_fn(|i| {
            bytes.get(i).copied().unwrap_or(fill)
        }))))
    }

    /// Instructions that make a text, or bytes, which are not kept.
    fn text(&mut self, instruction: u8) -> Result<(), DecodeError> {
        let length = match instruction {
            0x8c | b'C' | b'U' => usize::from(self.byte()?),
            b'X' | b'B' | b'T' => u32::from_le_bytes(self.array()?) as usize,
            _ => usize::try_from(u64::from_le_bytes(self.array()?)).unwrap_or(usize::MAX),
        };
        let bytes = self.take(length)?;
        let is_text = matches!(instruction, b'X' | 0x8c | 0x8d | b'T' | b'U');
        let node = match std::str::from_utf8(bytes) {
            Ok(text) if is_text => Node::Text(text.to_owned()),
            Err(_) if matches!(instruction, b'X' | 0x8c | 0x8d) => {
                return Err(malformed("a text is not UTF-8".into()));
            }
            _ => Node::Opaque,
        };
        self.machine.push(node);
        Ok(())
    }

    /// Instructions that name a class, or would call it.
    fn object(&mut self, instruction: u8) -> Result<(), DecodeError> {
        match instruction {
            b'c' => {
                let module = self.line()?;
                let name = self.line()?;
                self.machine.global(module, name)
            }
            0x93 => self.machine.stack_global(),
            b'R' => self.machine.reduce(),
            0x81 => self.machine.new_object(),
            0x92 => {
                self.machine.pop()?;
                self.machine.new_object()
            }
            _ => self.machine.persistent(),
        }
    }

    /// Instructions that remember what is on top, or fetch it again.
    fn memo(&mut self, instruction: u8) -> Result<(), DecodeError> {
        match instruction {
            b'h' | b'q' => {
                let slot = self.byte()?.into();
                if instruction == b'h' {
                    self.machine.recall(slot)
                } else {
                    self.machine.remember(slot)
                }
            }
            b'j' | b'r' => {
                let slot = u32::from_le_bytes(self.array()?);
                if instruction == b'j' {
                    self.machine.recall(slot)
                } else {
                    self.machine.remember(slot)
                }
            }
            _ => self.machine.remember_next(),
        }
    }

    fn byte(&mut self) -> Result<u8, DecodeError> {
        Ok(self.array::<1>()?[0])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let bytes = self.take(N)?;
        Ok(std::array::from_fn(|i| bytes[i]))
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], DecodeError> {
        let Some((taken, rest)) = self.rest.split_at_checked(length) else {
            return Err(DecodeError::Truncated {
                what: "the pickle".into(),
                expected_bytes: length as u64,
                found_bytes: self.rest.len() as u64,
            });
        };
        self.rest = rest;
        Ok(taken)
    }

    /// A line without its end: names of classes stand in lines.
    fn line(&mut self) -> Result<&'a str, DecodeError> {
        let end = self
            .rest
            .iter()
            .position(|&byte| byte == b'\n')
            .ok_or_else(|| malformed("a name has no end".into()))?;
        let line = self.take(end)?;
        self.take(1)?;
        std::str::from_utf8(line).map_err(|_| malformed("a name is not UTF-8".into()))
    }
}

fn malformed(message: String) -> DecodeError {
    DecodeError::Malformed(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(pickle: &[u8]) -> Result<Tree, DecodeError> {
        Unpickler::new(pickle).run()
    }

    #[test]
    fn a_dictionary_is_built_and_shared_things_are_shared() {
        // {'a': [1, -2, 2.5], 'b': the same list, to which 7 is added afterwards}
        let pickle = b"\x80\x02}q\x00(X\x01\x00\x00\x00a]q\x01(K\x01J\xfe\xff\xff\xffG\x40\x04\x00\x00\x00\x00\x00\x00eX\x01\x00\x00\x00bh\x01K\x07au.";
        let tree = run(pickle).unwrap();
        let (a, b) = (
            tree.get(tree.root(), "a").unwrap(),
            tree.get(tree.root(), "b").unwrap(),
        );
        assert_eq!(a, b);
        let Node::List(items) = a else {
            panic!("{a:?}")
        };
        let items: Vec<&Node> = items.iter().map(|&id| tree.node(id)).collect();
        assert_eq!(
            items,
            [
                &Node::Int(1),
                &Node::Int(-2),
                &Node::Float(2.5),
                &Node::Int(7)
            ]
        );
        assert_eq!(tree.keys(tree.root()).collect::<Vec<_>>(), ["a", "b"]);
    }

    #[test]
    fn a_pickle_that_would_run_something_is_refused_and_runs_nothing() {
        for (pickle, name) in [
            (
                &b"\x80\x02cposix\nsystem\nX\x02\x00\x00\x00id\x85R."[..],
                "posix system",
            ),
            (
                b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x02id\x85R.",
                "os system",
            ),
            (
                b"\x80\x02cbuiltins\neval\nX\x01\x00\x00\x001\x85R.",
                "builtins eval",
            ),
            (b"\x80\x02c__builtin__\nexec\n.", "__builtin__ exec"),
            (b"\x80\x02csubprocess\nPopen\n.", "subprocess Popen"),
        ] {
            let message = run(pickle).unwrap_err().to_string();
            assert!(
                message.contains(name) && message.contains("Nothing was run"),
                "{message}"
            );
        }
        // An instruction by which a class is called without its being named in a line.
        assert!(
            run(b"\x80\x02(iposix\nsystem\n.")
                .unwrap_err()
                .to_string()
                .contains("0x69")
        );
    }

    #[test]
    fn integers_of_many_bytes_keep_their_sign() {
        let tree = run(b"\x80\x02\x8a\x02\x00\xff.").unwrap();
        assert_eq!(tree.root(), &Node::Int(-256));
        assert_eq!(run(b"\x80\x02\x8a\x00.").unwrap().root(), &Node::Int(0));
        assert_eq!(
            run(b"\x80\x02\x8a\x09\x00\x00\x00\x00\x00\x00\x00\x00\x01.")
                .unwrap()
                .root(),
            &Node::Opaque
        );
    }

    #[test]
    fn a_stack_that_is_short_and_a_list_in_itself_do_no_harm() {
        for pickle in [
            &b"\x80\x02."[..],
            b"\x80\x02a.",
            b"\x80\x02e.",
            b"\x80\x02R.",
            b"\x80\x02h\x05.",
            b"\x80\x02u.",
            b"0.",
            b"Q.",
        ] {
            assert!(run(pickle).is_err(), "{pickle:?}");
        }
        let tree = run(b"\x80\x02]q\x00h\x00a.").unwrap();
        let Node::List(items) = tree.root() else {
            panic!()
        };
        assert_eq!(tree.node(items[0]), tree.root());
    }
}
