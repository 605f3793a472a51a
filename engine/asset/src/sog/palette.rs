//! A palette for more rows of coefficients than it has entries: k-means in a tree, so that a
//! million splats take seconds.
//!
//! Rows are parted by k-means into a few groups, groups into smaller ones, and the entries of the
//! palette are shared among them by the number of their rows. The same rows give the same palette.

use rayon::prelude::*;

/// Entries that are fitted at once; larger groups are parted into as many groups as [`PARTS`].
const LEAF_ENTRIES_MAX: usize = 192;
const PARTS: usize = 64;
/// Rounds of moving entries to the means of what is nearest to them.
const ROUNDS: usize = 6;
/// Rows of a group that are examined in these rounds at most, an even sample.
const SAMPLES_MAX: usize = 1 << 14;
/// Deepest parting: rows that k-means does not part share their entries.
const DEPTH_MAX: usize = 8;

/// Entries, one after the other, each of `stride` numbers, and the entry of each row.
pub(super) struct Palette {
    pub entries: Vec<f32>,
    pub labels: Vec<u16>,
}

/// A palette of at most `most` entries, 1 to 65,536, for the rows of `stride` numbers in `values`,
/// each of which `order` holds once. Entries of rows that have their own stand in this order.
pub(super) fn fit(values: &[f32], stride: usize, order: &[u32], most: usize) -> Palette {
    let rows = Rows { values, stride };
    let mut palette = Palette {
        entries: Vec::new(),
        labels: vec![0; values.len() / stride],
    };
    part(&rows, order.to_vec(), most, 0, &mut palette);
    palette
}

struct Rows<'a> {
    values: &'a [f32],
    stride: usize,
}

impl Rows<'_> {
    fn at(&self, row: u32) -> &[f32] {
        &self.values[row as usize * self.stride..][..self.stride]
    }

    /// The entry of `entries` that is nearest to `row`.
    fn nearest(&self, entries: &[f32], row: u32) -> usize {
        let row = self.at(row);
        let distances = entries.chunks_exact(self.stride).map(|entry| {
            let squares = entry.iter().zip(row).map(|(a, b)| (a - b) * (a - b));
            squares.sum::<f32>()
        });
        let mut best = (0, f32::INFINITY);
        for (at, distance) in distances.enumerate() {
            if distance < best.1 {
                best = (at, distance);
            }
        }
        best.0
    }

    /// Means of `rows` by their labels; entries without rows stay as they are.
    fn means(&self, rows: &[u32], labels: &[usize], entries: &mut [f32]) {
        let mut sums = vec![0.0f64; entries.len()];
        let mut counts = vec![0u32; entries.len() / self.stride];
        for (&row, &label) in rows.iter().zip(labels) {
            counts[label] += 1;
            let sum = &mut sums[label * self.stride..][..self.stride];
            for (sum, value) in sum.iter_mut().zip(self.at(row)) {
                *sum += f64::from(*value);
            }
        }
        for (label, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let at = label * self.stride;
            for (entry, sum) in entries[at..][..self.stride].iter_mut().zip(&sums[at..]) {
                *entry = (sum / f64::from(count)) as f32;
            }
        }
    }

    /// `count` entries for `rows`, and the nearest of each row.
    fn k_means(&self, rows: &[u32], count: usize) -> (Vec<f32>, Vec<usize>) {
        let every = rows.len().div_ceil(SAMPLES_MAX.max(8 * count)).max(1);
        let sample: Vec<u32> = rows.iter().copied().step_by(every).collect();
        let mut entries: Vec<f32> = (0..count)
            .flat_map(|entry| {
                self.at(sample[entry * sample.len() / count])
                    .iter()
                    .copied()
            })
            .collect();
        let labels_of = |rows: &[u32], entries: &[f32]| -> Vec<usize> {
            rows.par_iter()
                .map(|&row| self.nearest(entries, row))
                .collect()
        };
        for _ in 0..ROUNDS {
            let labels = labels_of(&sample, &entries);
            self.means(&sample, &labels, &mut entries);
        }
        let labels = labels_of(rows, &entries);
        self.means(rows, &labels, &mut entries);
        (entries, labels)
    }
}

/// Adds at most `most` entries for `rows` to `palette`.
fn part(rows: &Rows, members: Vec<u32>, most: usize, depth: usize, palette: &mut Palette) {
    let first = palette.entries.len() / rows.stride;
    if members.len() <= most {
        for (at, &row) in members.iter().enumerate() {
            palette.entries.extend_from_slice(rows.at(row));
            palette.labels[row as usize] = (first + at) as u16;
        }
        return;
    }
    let is_leaf = most <= LEAF_ENTRIES_MAX || depth == DEPTH_MAX;
    let count = if is_leaf {
        most.min(LEAF_ENTRIES_MAX)
    } else {
        PARTS
    };
    let (entries, labels) = rows.k_means(&members, count);
    if is_leaf {
        for (&row, label) in members.iter().zip(labels) {
            palette.labels[row as usize] = (first + label) as u16;
        }
        palette.entries.extend(entries);
        return;
    }
    let mut groups: Vec<Vec<u32>> = vec![Vec::new(); count];
    for (&row, label) in members.iter().zip(labels) {
        groups[label].push(row);
    }
    groups.retain(|group| !group.is_empty());
    if groups.len() == 1 {
        // Rows that are all the same are not parted.
        palette.entries.extend_from_slice(rows.at(members[0]));
        for &row in &members {
            palette.labels[row as usize] = first as u16;
        }
        return;
    }
    // One entry each, and the rest by the number of rows.
    let spare = most - groups.len();
    let total = members.len();
    drop(members);
    for group in groups {
        let share = 1 + (spare as u128 * group.len() as u128 / total as u128) as usize;
        part(rows, group, share, depth + 1, palette);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(number: usize, stride: usize) -> impl Iterator<Item = f32> {
        // Rows near one of 500 points, apart from each other by 0.001.
        (0..stride).map(move |at| {
            let point = ((number % 500) * (at + 3) * 7919 % 1000) as f32 / 500.0 - 1.0;
            point + 0.001 * ((number * 31 + at * 17) % 7) as f32
        })
    }

    fn fit(values: &[f32], stride: usize, most: usize) -> Palette {
        let order: Vec<u32> = (0..(values.len() / stride) as u32).collect();
        super::fit(values, stride, &order, most)
    }

    #[test]
    fn few_rows_are_kept_and_many_are_near_to_an_entry() {
        let stride = 9;
        let values: Vec<f32> = (0..4000).flat_map(|number| row(number, stride)).collect();
        let exact = fit(&values[..300 * stride], stride, 65_536);
        assert_eq!(exact.entries, values[..300 * stride]);
        assert_eq!(exact.labels, (0..300).collect::<Vec<u16>>());
        let backward: Vec<u32> = (0..300).rev().collect();
        let turned = super::fit(&values[..300 * stride], stride, &backward, 65_536);
        assert_eq!(turned.labels, (0..300).rev().collect::<Vec<u16>>());
        assert_eq!(turned.entries[..stride], values[299 * stride..300 * stride]);
        let palette = fit(&values, stride, 1000);
        assert!(
            palette.entries.len() <= 1000 * stride,
            "{}",
            palette.entries.len()
        );
        let squares: f64 = values
            .chunks_exact(stride)
            .zip(&palette.labels)
            .flat_map(|(row, &label)| {
                let entry = &palette.entries[usize::from(label) * stride..][..stride];
                row.iter().zip(entry).map(|(a, b)| f64::from(a - b).powi(2))
            })
            .sum();
        let error = (squares / values.len() as f64).sqrt();
        assert!(error < 0.01, "{error}");
        let again = fit(&values, stride, 1000);
        assert!(again.entries == palette.entries && again.labels == palette.labels);
    }

    #[test]
    fn rows_that_are_all_the_same_share_entries() {
        let palette = fit(&vec![0.5; 70_000 * 3], 3, 65_536);
        assert_eq!(palette.entries, [0.5; 3]);
        assert!(palette.labels.iter().all(|label| *label == 0));
    }
}
