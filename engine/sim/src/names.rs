//! Names of scenarios, and of what is in them.

use std::collections::{HashMap, HashSet};

/// `text` as a name that scenarios can have: letters, digits, `-` and `_`, at most 80 of them.
#[must_use]
pub fn scenario_name(text: &str) -> String {
    let letter = |letter: char| match letter {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '-' | '_' => letter,
        _ => '_',
    };
    let name: String = text.chars().map(letter).take(80).collect();
    if name.is_empty() { "_".into() } else { name }
}

/// Names of which no two are the same.
#[derive(Debug, Default)]
pub struct UniqueNames {
    taken: HashSet<String>,
    /// Number that the next equal name tries first: many equal names take linear time.
    next_number: HashMap<String, u32>,
}

impl UniqueNames {
    /// `name`, with a number where it is taken.
    pub fn give(&mut self, name: String) -> String {
        let number = self.next_number.entry(name.clone()).or_insert(1);
        loop {
            let candidate = match *number {
                1 => name.clone(),
                number => format!("{name}_{number}"),
            };
            *number += 1;
            if self.taken.insert(candidate.clone()) {
                return candidate;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_get_numbers_in_linear_time() {
        let mut names = UniqueNames::default();
        let given = ["a", "a_2", "a", "a", "b"].map(|name| names.give(name.into()));
        assert_eq!(given, ["a", "a_2", "a_3", "a_4", "b"]);
        // Trying all numbers for each name would take hours.
        let last = (0..300_000).map(|_| names.give("c".into())).last();
        assert_eq!(last.as_deref(), Some("c_300000"));
    }
}
