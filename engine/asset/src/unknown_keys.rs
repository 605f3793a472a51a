//! Keys, columns and properties of files that no reader here knows: each is warned of once.

use std::collections::BTreeMap;

use crate::xml::excerpt;

/// Most names that a warning lists; others are counted.
const NAMED_MAX: usize = 12;
/// Most names that are kept.
const KEPT_MAX: usize = 1000;

/// Names that were found and are not read, with how often.
#[derive(Default)]
pub(crate) struct UnknownKeys {
    counts: BTreeMap<String, usize>,
}

impl UnknownKeys {
    /// Counts a name.
    pub(crate) fn add(&mut self, name: &str) {
        if let Some(count) = self.counts.get_mut(name) {
            *count += 1;
        } else if self.counts.len() < KEPT_MAX {
            self.counts.insert(name.to_owned(), 1);
        }
    }

    /// A sentence that lists the names; `None` if there are none. `kind` is what they are.
    pub(crate) fn sentence(&self, kind: &str) -> Option<String> {
        if self.counts.is_empty() {
            return None;
        }
        let named = self.counts.iter().take(NAMED_MAX).map(|(name, count)| {
            let times = if *count == 1 {
                String::new()
            } else {
                format!(" ({count} times)")
            };
            format!("'{}'{times}", excerpt(name))
        });
        let mut text = named.collect::<Vec<_>>().join(", ");
        if self.counts.len() > NAMED_MAX {
            text += &format!(" and {} more", self.counts.len() - NAMED_MAX);
        }
        Some(format!("{kind} that are not read: {text}"))
    }

    /// Warns of the names, if there are any.
    pub(crate) fn warn(&self, kind: &str) {
        if let Some(sentence) = self.sentence(kind) {
            log::warn!("{sentence}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_is_told_once_with_its_count() {
        let mut keys = UnknownKeys::default();
        assert_eq!(keys.sentence("keys"), None);
        for name in ["zoom", "tint", "zoom"] {
            keys.add(name);
        }
        let sentence = keys.sentence("keys").unwrap();
        assert!(sentence.ends_with("'tint', 'zoom' (2 times)"), "{sentence}");
        (0..100_000).for_each(|number| keys.add(&number.to_string()));
        let sentence = keys.sentence("keys").unwrap();
        assert!(
            sentence.len() < 300 && sentence.contains("988 more"),
            "{sentence}"
        );
    }
}
