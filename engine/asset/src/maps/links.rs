//! Lanes by name, and what joins them.

use std::collections::HashMap;

use decouplegs_scene::Lane;

use crate::DecodeError;
use crate::xml::excerpt;

/// Index of each lane by its id.
pub(super) struct LaneIndices(HashMap<String, usize>);

impl LaneIndices {
    /// The indices of `lanes`.
    ///
    /// # Errors
    /// A [`DecodeError`] naming an id that two lanes have.
    pub(super) fn new(lanes: &[Lane]) -> Result<Self, DecodeError> {
        let mut indices = HashMap::with_capacity(lanes.len());
        for (at, lane) in lanes.iter().enumerate() {
            if indices.insert(lane.id.clone(), at).is_some() {
                let id = excerpt(&lane.id);
                return Err(DecodeError::Malformed(format!(
                    "two lanes have the id {id}; ids must be unique in a map"
                )));
            }
        }
        Ok(Self(indices))
    }

    /// The lane of an id. Files cut out of larger ones name lanes that they do not hold: those have
    /// none.
    pub(super) fn get(&self, id: &str) -> Option<usize> {
        self.0.get(id).copied()
    }
}

/// Makes `to` a successor of `from`. To do so twice is no harm, see [`tidy`].
pub(super) fn join(lanes: &mut [Lane], from: usize, to: usize) {
    lanes[from].successors.push(to);
    lanes[to].predecessors.push(from);
}

/// Sorts the links of each lane and leaves one of each.
pub(super) fn tidy(lanes: &mut [Lane]) {
    for lane in lanes {
        for links in [&mut lane.successors, &mut lane.predecessors] {
            links.sort_unstable();
            links.dedup();
        }
    }
}
