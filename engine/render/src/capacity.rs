//! Capacities of a frame's buffers. Pure sizes: nothing here touches a device.
//!
//! No capacity truncates silently. The GPU counts what it wanted ([`RequiredCounts`]); when that is
//! more than there was room for, the frame grows and is drawn again, and says so.

use crate::layout::RequiredCounts;

/// Room for the lists of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Capacity {
    /// Visible (camera, splat).
    pub records: usize,
    /// (Coarse tile, record).
    pub pairs: usize,
    /// Results of segments that are not their coarse tile's only one.
    pub partials: usize,
    /// Fine tiles of such results that something is drawn in.
    pub tiles: usize,
}

/// Fine tiles per partial result that are expected to have something drawn in them, of 32.
const TILES_EXPECTED: usize = 16;

impl Capacity {
    /// A first guess for `splats` seen by `cameras`: a wrong one costs one redrawn frame.
    #[must_use]
    pub fn guess(splats: usize, cameras: usize) -> Self {
        let records = (splats * cameras).min(splats / 2 + splats * cameras / 16 + 1024);
        Self {
            records,
            pairs: records * 2 + 1024,
            partials: 64,
            tiles: 64 * TILES_EXPECTED,
        }
    }

    /// Room for what either has room for.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            records: self.records.max(other.records),
            pairs: self.pairs.max(other.pairs),
            partials: self.partials.max(other.partials),
            tiles: self.tiles.max(other.tiles),
        }
    }

    /// True if all required counts fit.
    #[must_use]
    pub fn holds(&self, required: &RequiredCounts) -> bool {
        required.records as usize <= self.records
            && required.pairs as usize <= self.pairs
            && required.partials as usize <= self.partials
            && required.tiles as usize <= self.tiles
    }

    /// Room for `required` with a share of them to `spare`, so that a moving camera does not
    /// outgrow it at every step. Never smaller.
    ///
    /// Counts found while an earlier list overflowed are too low: it may take another turn.
    #[must_use]
    pub fn grown_to(&self, required: &RequiredCounts, spare: f64) -> Self {
        let grown = self.grown_where(required, spare, |have, need| need > have);
        // Results that had no room did not count their tiles.
        let expected = match required.partials as usize > self.partials {
            true => grown.partials * TILES_EXPECTED,
            false => 0,
        };
        Self {
            tiles: grown.tiles.max(expected),
            ..grown
        }
    }

    /// Capacity with growth for lists of which less than half of what was to `spare` is left: a
    /// frame whose counts grow slowly finds room, and is not drawn twice.
    #[must_use]
    pub fn grown_ahead_of(&self, required: &RequiredCounts, spare: f64) -> Self {
        self.grown_where(required, spare, |have, need| {
            need as f64 * (1.0 + 0.5 * spare.max(0.0)) > have as f64
        })
    }

    /// Room for `required` where it `is_short`, given what there is and what is needed.
    fn grown_where(
        &self,
        required: &RequiredCounts,
        spare: f64,
        is_short: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let grown = |have: usize, need: u32| {
            let need = need as usize;
            match is_short(have, need) {
                true => have.max(need + (need as f64 * spare.max(0.0)) as usize + 64),
                false => have,
            }
        };
        Self {
            records: grown(self.records, required.records),
            pairs: grown(self.pairs, required.pairs),
            partials: grown(self.partials, required.partials),
            tiles: grown(self.tiles, required.tiles),
        }
    }

    /// Segments of coarse tiles: one for each of `bins` and one for each partial result.
    #[must_use]
    pub fn items(&self, bins: u32) -> usize {
        bins as usize + self.partials
    }

    /// Coarse tiles that can be cut, or parts of them: one with more than 16 partial results has an
    /// eighth as many parts at most.
    #[must_use]
    pub fn composites(&self, bins: u32) -> usize {
        bins as usize + self.partials / 8
    }
}

/// The device's limit of groups along an axis, for counts known on the host; `groups_for` in
/// `frame.glsl` is its twin.
#[must_use]
pub fn groups_for(count: usize) -> [u32; 3] {
    const GROUPS_X_MAX: usize = decouplegs_shaders::constants::GROUPS_X_MAX as usize;
    if count <= GROUPS_X_MAX {
        [count as u32, 1, 1]
    } else {
        [GROUPS_X_MAX as u32, count.div_ceil(GROUPS_X_MAX) as u32, 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_holds_what_was_needed_and_never_shrinks() {
        let start = Capacity {
            records: 100,
            pairs: 1000,
            partials: 64,
            tiles: 64,
        };
        let required = RequiredCounts {
            records: 5000,
            pairs: 10,
            partials: 65,
            tiles: 2000,
            ..RequiredCounts::default()
        };
        assert!(!start.holds(&required));
        let grown = start.grown_to(&required, 1.0 / 16.0);
        assert!(grown.holds(&required));
        assert_eq!(grown.pairs, 1000);
        assert!(
            !start.holds(&RequiredCounts {
                pairs: 1001,
                ..RequiredCounts::default()
            }),
            "one too many must be seen"
        );
    }

    #[test]
    fn room_grows_before_it_is_used_up() {
        let capacity = Capacity {
            records: 1500,
            pairs: 1500,
            partials: 1500,
            tiles: 1500,
        };
        let required = RequiredCounts {
            records: 1000,
            pairs: 1201,
            ..RequiredCounts::default()
        };
        let grown = capacity.grown_ahead_of(&required, 0.5);
        assert_eq!((grown.records, grown.partials), (1500, 1500));
        assert_eq!(grown.pairs, 1201 + 600 + 64);
        assert_eq!(grown.grown_ahead_of(&required, 0.5), grown);
        assert_eq!(capacity.grown_ahead_of(&required, 0.0), capacity);
    }

    #[test]
    fn groups_cover_the_count_within_the_limit() {
        for count in [0, 1, 65_535, 65_536, 10_000_000] {
            let [x, y, z] = groups_for(count);
            assert!(x <= 65_535 && y <= 65_535 && z == 1 && x as usize * y as usize >= count);
        }
    }
}
