//! MessagePack as a tree of values, bounded by what is really there.

use std::cell::Cell;
use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use crate::DecodeError;

/// Most values of a tree: a volume of all layers has some hundred, and one name for each track.
const VALUES_MAX: usize = 1 << 20;
/// Deepest nesting of maps and lists.
const DEPTH_MAX: usize = 32;

/// A value of MessagePack, whose bytes stay where they are.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value<'a> {
    /// Nil, or an extension type.
    None,
    Integer(i64),
    Float(f64),
    Text(String),
    Bytes(&'a [u8]),
    List(Vec<Value<'a>>),
    /// Pairs in the order of the file. Keys that are no text are written as one.
    Map(Vec<(String, Value<'a>)>),
}

impl Value<'_> {
    /// The value of `key` in a map; of equal keys the first.
    pub(super) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Map(pairs) = self else {
            return None;
        };
        let found = pairs.iter().find(|(name, _)| name == key);
        found.map(|(_, value)| value)
    }

    pub(super) fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// A number, whether it is written as an integer or not.
    pub(super) fn number(&self) -> Option<f64> {
        match self {
            Self::Integer(value) => Some(*value as f64),
            Self::Float(value) => Some(*value),
            _ => None,
        }
    }

    /// The sizes of a shape: a list of integers that are not negative.
    pub(super) fn sizes(&self) -> Option<Vec<usize>> {
        let Self::List(items) = self else {
            return None;
        };
        let size = |item: &Self| match item {
            Self::Integer(size) => usize::try_from(*size).ok(),
            _ => None,
        };
        items.iter().map(size).collect()
    }
}

/// Reads the one value that is in `bytes`.
///
/// # Errors
/// A sentence with the reader's own reason.
pub(super) fn read(bytes: &[u8]) -> Result<Value<'_>, DecodeError> {
    let mut decoder = rmp_serde::Deserializer::from_read_ref(bytes);
    decoder.set_max_depth(2 * DEPTH_MAX);
    let left = Cell::new(VALUES_MAX);
    Node {
        left: &left,
        depth: 0,
    }
    .deserialize(&mut decoder)
    .map_err(|error| {
        DecodeError::Malformed(format!("volume.nurec is no MessagePack in gzip: {error}"))
    })
}

/// A value that is read, with what may still be.
#[derive(Clone, Copy)]
struct Node<'c> {
    left: &'c Cell<usize>,
    depth: usize,
}

impl Node<'_> {
    fn inner<E: Error>(self) -> Result<Self, E> {
        if self.depth >= DEPTH_MAX {
            return Err(E::custom(format!("nested deeper than {DEPTH_MAX} levels")));
        }
        Ok(Self {
            depth: self.depth + 1,
            ..self
        })
    }
}

impl<'de> DeserializeSeed<'de> for Node<'_> {
    type Value = Value<'de>;

    fn deserialize<D: Deserializer<'de>>(self, decoder: D) -> Result<Value<'de>, D::Error> {
        let Some(left) = self.left.get().checked_sub(1) else {
            return Err(D::Error::custom(format!("more than {VALUES_MAX} values")));
        };
        self.left.set(left);
        decoder.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Node<'_> {
    type Value = Value<'de>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a value of MessagePack")
    }

    fn visit_unit<E>(self) -> Result<Value<'de>, E> {
        Ok(Value::None)
    }

    fn visit_none<E>(self) -> Result<Value<'de>, E> {
        Ok(Value::None)
    }

    fn visit_some<D: Deserializer<'de>>(self, decoder: D) -> Result<Value<'de>, D::Error> {
        decoder.deserialize_any(self)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value<'de>, E> {
        Ok(Value::Integer(value.into()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value<'de>, E> {
        Ok(Value::Integer(value))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Value<'de>, E> {
        i64::try_from(value)
            .map(Value::Integer)
            .map_err(|_| E::custom(format!("the integer {value} is too large")))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value<'de>, E> {
        Ok(Value::Float(value))
    }

    fn visit_str<E>(self, text: &str) -> Result<Value<'de>, E> {
        Ok(Value::Text(text.to_owned()))
    }

    fn visit_borrowed_bytes<E>(self, bytes: &'de [u8]) -> Result<Value<'de>, E> {
        Ok(Value::Bytes(bytes))
    }

    // Extension types, which hold nothing that is read here.
    fn visit_newtype_struct<D: Deserializer<'de>>(
        self,
        decoder: D,
    ) -> Result<Value<'de>, D::Error> {
        decoder
            .deserialize_ignored_any(IgnoredAny)
            .map(|_| Value::None)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Value<'de>, A::Error> {
        let inner = self.inner()?;
        // Grows with what is there: the count that the file claims is not believed.
        let mut items = Vec::new();
        while let Some(item) = sequence.next_element_seed(inner)? {
            items.push(item);
        }
        Ok(Value::List(items))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value<'de>, A::Error> {
        let inner = self.inner()?;
        let mut pairs = Vec::new();
        while let Some(key) = map.next_key_seed(inner)? {
            let key = match key {
                Value::Text(key) => key,
                Value::Integer(key) => key.to_string(),
                _ => return Err(A::Error::custom("a key that is no text")),
            };
            pairs.push((key, map.next_value_seed(inner)?));
        }
        Ok(Value::Map(pairs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(name: &str) -> Value<'_> {
        Value::Text(name.into())
    }

    #[test]
    fn all_kinds_of_values_are_read() {
        // {"a": [1, -1, 1.5, nil, true], "b": bytes 7 8, 5: "c"}
        let bytes = [
            &[0x83, 0xa1, b'a', 0x95, 1, 0xff, 0xcb][..],
            &1.5f64.to_be_bytes(),
            &[0xc0, 0xc3, 0xa1, b'b', 0xc4, 2, 7, 8, 5, 0xa1, b'c'],
        ]
        .concat();
        let value = read(&bytes[..]).unwrap();
        let list = [
            Value::Integer(1),
            Value::Integer(-1),
            Value::Float(1.5),
            Value::None,
            Value::Integer(1),
        ];
        assert_eq!(value.get("a"), Some(&Value::List(list.to_vec())));
        assert_eq!(value.get("b"), Some(&Value::Bytes(&[7, 8])));
        assert_eq!(value.get("5"), Some(&text("c")));
        assert_eq!(value.get("d"), None);
        // An extension type holds nothing that is read.
        assert_eq!(read(&[0xd4, 1, 0][..]).unwrap(), Value::None);
    }

    #[test]
    fn claims_are_not_believed() {
        // 2^32 - 1 bytes, values and pairs, none of which are there.
        for kind in [0xc6, 0xdd, 0xdf, 0xdb] {
            let bytes = [kind, 0xff, 0xff, 0xff, 0xff];
            let error = read(&bytes[..]).unwrap_err().to_string();
            assert!(error.contains("no MessagePack in gzip"), "{error}");
        }
        let deep = vec![0x91; 1000];
        assert!(read(&deep[..]).is_err());
        let many = [&[0xdd, 0, 0x20, 0, 0][..], &vec![0xc0; 1 << 21]].concat();
        let error = read(&many[..]).unwrap_err().to_string();
        assert!(error.contains("more than 1048576 values"), "{error}");
    }
}
