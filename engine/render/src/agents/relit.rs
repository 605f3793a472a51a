//! Colors made for agents in their light, which a frame in flight keeps until it shows another
//! light.

use std::collections::{HashMap, HashSet};

use decouplegs_gpu::{Buffer, Gpu, MemoryKind, Recorder};

use crate::RenderError;
use crate::asset_pool::AssetId;
use crate::layout::RelightRecord;
use crate::range_allocator::RangeAllocator;
use crate::stages::{PURPOSE, RELIGHT_BLOCK, RelightWork, RelitColors};

/// An asset in a light: the bits of T and b.
type InLight = (AssetId, [u32; 96]);

/// The relit codebooks of one frame in flight. What the frame before in its slot made is used
/// again where asset and light are the same: an agent that stands still costs nothing, and alike
/// ones share.
pub(crate) struct RelitCodebooks {
    pub colors: RelitColors,
    ranges: RelitRanges,
    staged: Buffer<RelightRecord>,
    pub records: Buffer<RelightRecord>,
}

/// Codebooks that one frame relights.
#[derive(Default)]
pub(crate) struct Relights {
    /// First color of each wanted codebook.
    pub offsets: Vec<u32>,
    /// Placement of all codebooks once the frame was submitted.
    ranges: RelitRanges,
    /// Number of codebooks to make.
    pub count: usize,
    /// Workgroups that make them.
    groups: usize,
}

impl RelitCodebooks {
    /// None yet.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        Ok(Self {
            colors: RelitColors::new(gpu, 0)?,
            ranges: RelitRanges::default(),
            staged: gpu.buffer("staged_relights", PURPOSE, 0, MemoryKind::Upload)?,
            records: gpu.buffer("relights", PURPOSE, 0, MemoryKind::Device)?,
        })
    }

    /// Finds a range for each of `wanted`, and lists those that have to be made. Until the result
    /// is committed all others are forgotten: what was to be made may never be.
    pub fn plan(
        &mut self,
        gpu: &Gpu,
        wanted: &[(AssetId, RelightRecord)],
    ) -> Result<Relights, RenderError> {
        let mut ranges = std::mem::take(&mut self.ranges);
        let (mut offsets, mut to_make) = ranges.find(wanted);
        let room = ranges.allocator.end();
        if room > self.colors.dc.len() {
            self.colors = RelitColors::new(gpu, room + room / 4)?;
            // The old ones are gone: all are made again.
            ranges = RelitRanges::default();
            (offsets, to_make) = ranges.find(wanted);
        }
        if to_make.len() > self.staged.len() {
            let room = to_make.len() + to_make.len() / 4;
            self.staged = gpu.buffer("staged_relights", PURPOSE, room, MemoryKind::Upload)?;
            self.records = gpu.buffer("relights", PURPOSE, room, MemoryKind::Device)?;
        }
        self.staged.write_host(0, &to_make);
        Ok(Relights {
            offsets,
            ranges,
            count: to_make.len(),
            groups: to_make
                .last()
                .map_or(0, |last| last.first_group as usize + groups_of(last)),
        })
    }

    /// Keeps the codebooks of a frame that was submitted.
    pub fn commit(&mut self, relights: &mut Relights) {
        self.ranges = std::mem::take(&mut relights.ranges);
    }

    /// The codebooks that are to be made.
    pub fn work(&self, relights: &Relights) -> RelightWork<'_> {
        RelightWork {
            records: &self.records,
            count: relights.count,
            groups: relights.groups,
        }
    }

    /// Records the copy of what is to be made.
    pub fn copy(&self, recorder: &mut Recorder, relights: &Relights) {
        recorder.copy(&self.staged, 0, &self.records, 0, relights.count);
    }
}

/// Placement of relit codebooks.
#[derive(Default)]
struct RelitRanges {
    allocator: RangeAllocator,
    made: HashMap<InLight, (usize, usize)>,
}

impl RelitRanges {
    /// The first color of each of `wanted`, and those that are not there yet, with their range and
    /// workgroups.
    fn find(&mut self, wanted: &[(AssetId, RelightRecord)]) -> (Vec<u32>, Vec<RelightRecord>) {
        let keys: Vec<InLight> = wanted
            .iter()
            .map(|(asset, record)| (*asset, light_of(record)))
            .collect();
        self.drop_others(&keys);
        let mut to_make: Vec<RelightRecord> = Vec::new();
        let mut groups = 0;
        let mut offsets = Vec::with_capacity(wanted.len());
        for (key, (_, record)) in keys.into_iter().zip(wanted) {
            let (first, _) = *self.made.entry(key).or_insert_with(|| {
                let colors = record.colors as usize;
                let first = self.allocator.take(colors);
                to_make.push(RelightRecord {
                    first_relit: first as u32,
                    first_group: groups,
                    ..*record
                });
                groups += groups_of(record) as u32;
                (first, colors)
            });
            offsets.push(first as u32);
        }
        (offsets, to_make)
    }

    /// Frees the ranges of codebooks that are no longer in use.
    fn drop_others(&mut self, keys: &[InLight]) {
        let wanted: HashSet<&InLight> = keys.iter().collect();
        // In order of range: the order of a map differs from run to run.
        let mut dropped: Vec<(usize, usize)> = self
            .made
            .iter()
            .filter(|(key, _)| !wanted.contains(key))
            .map(|(_, range)| *range)
            .collect();
        dropped.sort_unstable();
        self.made.retain(|key, _| wanted.contains(key));
        dropped
            .into_iter()
            .for_each(|(first, colors)| self.allocator.give_back(first, colors));
    }
}

fn groups_of(record: &RelightRecord) -> usize {
    (record.colors as usize).div_ceil(RELIGHT_BLOCK)
}

fn light_of(record: &RelightRecord) -> [u32; 96] {
    let mut bits = [0; 96];
    for (bit, number) in bits
        .iter_mut()
        .zip(record.gain.iter().chain(&record.summand))
    {
        *bit = number.to_bits();
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn wanted(index: u32, gain: f32, colors: u32) -> (AssetId, RelightRecord) {
        (
            AssetId {
                index,
                generation: 1,
            },
            RelightRecord {
                gain: [gain; 48],
                colors,
                ..RelightRecord::zeroed()
            },
        )
    }

    #[test]
    fn what_stays_is_not_made_again_and_alike_ones_share() {
        let mut ranges = RelitRanges::default();
        let (first, made) =
            ranges.find(&[wanted(1, 1.0, 300), wanted(1, 1.0, 300), wanted(2, 1.0, 10)]);
        assert_eq!(
            (first, made.len(), made[1].first_group),
            (vec![0, 0, 300], 2, 2)
        );
        let (second, made) = ranges.find(&[wanted(2, 1.0, 10), wanted(1, 1.0, 300)]);
        assert_eq!((second, made.len()), (vec![300, 0], 0));
        // Another light of one of them; the other stays where it is.
        let (third, made) = ranges.find(&[wanted(1, 1.0, 300), wanted(2, 0.5, 10)]);
        assert_eq!(
            (third[0], made.len(), made[0].gain[0], made[0].first_group),
            (0, 1, 0.5, 0)
        );
        assert_ne!(third[1], 0);
        let (none, made) = ranges.find(&[]);
        assert_eq!((none.len(), made.len(), ranges.allocator.end()), (0, 0, 0));
    }
}
