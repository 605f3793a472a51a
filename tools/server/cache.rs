//! Cache with a size limit: the least recently used entries go first.

/// Values by name, bounded by how many they are and by the bytes that they say they take.
pub struct Cache<T> {
    /// Entries, least recently used first.
    entries: Vec<Entry<T>>,
    entries_max: usize,
    bytes_max: u64,
}

struct Entry<T> {
    name: String,
    value: T,
    bytes: u64,
}

impl<T> Cache<T> {
    /// Room for `entries_max` values, at least one, of `bytes_max` bytes together.
    pub fn new(entries_max: usize, bytes_max: u64) -> Self {
        Self {
            entries: Vec::new(),
            entries_max: entries_max.max(1),
            bytes_max,
        }
    }

    /// Bytes of all values.
    pub fn bytes(&self) -> u64 {
        self.entries.iter().map(|entry| entry.bytes).sum()
    }

    /// Bytes that all values may take.
    pub fn bytes_max(&self) -> u64 {
        self.bytes_max
    }

    /// Bytes of the value called `name`; zero if there is none.
    pub fn bytes_of(&self, name: &str) -> u64 {
        self.entries
            .iter()
            .find(|entry| entry.name == name)
            .map_or(0, |entry| entry.bytes)
    }

    /// Names, the longest unused first.
    pub fn names(&self) -> Vec<String> {
        self.entries
            .iter()
            .map(|entry| entry.name.clone())
            .collect()
    }

    /// The value called `name`, which counts as used now.
    pub fn get(&mut self, name: &str) -> Option<&mut T> {
        let place = self.entries.iter().position(|entry| entry.name == name)?;
        let entry = self.entries.remove(place);
        self.entries.push(entry);
        self.entries.last_mut().map(|entry| &mut entry.value)
    }

    /// Takes out the longest unused value if `bytes` more would not fit beside it: to be called
    /// until there is none.
    pub fn make_room(&mut self, bytes: u64) -> Option<(String, T)> {
        let full = self.entries.len() >= self.entries_max
            || self.bytes().saturating_add(bytes) > self.bytes_max;
        (full && !self.entries.is_empty()).then(|| {
            let entry = self.entries.remove(0);
            (entry.name, entry.value)
        })
    }

    /// Takes out the value called `name`.
    pub fn remove(&mut self, name: &str) {
        self.entries.retain(|entry| entry.name != name);
    }

    /// Takes out all values; their names.
    pub fn clear(&mut self) -> Vec<String> {
        let names = self.names();
        self.entries.clear();
        names
    }

    /// Adds a value for which there is room.
    pub fn insert(&mut self, name: String, value: T, bytes: u64) {
        self.remove(&name);
        self.entries.push(Entry { name, value, bytes });
    }

    /// Says that the value called `name` takes `bytes` now; those that no longer fit beside it are
    /// taken out.
    pub fn resize(&mut self, name: &str, bytes: u64) -> Vec<(String, T)> {
        if let Some(entry) = self.entries.iter_mut().find(|entry| entry.name == name) {
            entry.bytes = bytes;
        }
        let mut out = Vec::new();
        while self.bytes() > self.bytes_max
            && let Some(place) = self.entries.iter().position(|entry| entry.name != name)
        {
            let entry = self.entries.remove(place);
            out.push((entry.name, entry.value));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_unused_goes_first() {
        let mut cache = Cache::new(2, 100);
        for name in ["a", "b"] {
            assert!(cache.make_room(10).is_none());
            cache.insert(name.into(), name, 10);
        }
        assert_eq!(cache.get("a"), Some(&mut "a"));
        assert_eq!(cache.make_room(10), Some(("b".to_owned(), "b")));
        assert!(
            cache.make_room(10).is_none(),
            "there is room for one beside the one that is left"
        );
        assert_eq!((cache.names(), cache.bytes()), (vec!["a".to_owned()], 10));
    }

    #[test]
    fn bytes_are_bounded_however_they_grow() {
        let mut cache = Cache::new(10, 100);
        ["a", "b", "c"]
            .into_iter()
            .for_each(|name| cache.insert(name.into(), name, 30));
        assert_eq!(cache.resize("a", 60), [("b".to_owned(), "b")]);
        assert_eq!((cache.bytes(), cache.names().len()), (90, 2));
        assert_eq!(cache.make_room(20), Some(("a".to_owned(), "a")));
        assert_eq!(
            (cache.names(), cache.bytes_of("c"), cache.bytes_of("a")),
            (vec!["c".to_owned()], 30, 0)
        );
    }
}
