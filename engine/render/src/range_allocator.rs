//! First-fit allocator of ranges of a buffer.

/// Ranges of a list that can grow at its end.
#[derive(Debug, Default)]
pub(crate) struct RangeAllocator {
    /// First and count of what is free before the end, in order, no two of them touching.
    free: Vec<(usize, usize)>,
    end: usize,
}

impl RangeAllocator {
    /// The first of `count` free elements; the list grows when there is no such gap.
    pub fn take(&mut self, count: usize) -> usize {
        if let Some(gap) = self.free.iter().position(|&(_, free)| free >= count) {
            let (first, free) = self.free[gap];
            if free == count {
                self.free.remove(gap);
            } else {
                self.free[gap] = (first + count, free - count);
            }
            return first;
        }
        let first = self.end;
        self.end += count;
        first
    }

    /// Frees the `count` elements from `first` on, which were taken together.
    pub fn give_back(&mut self, first: usize, count: usize) {
        if count == 0 {
            return;
        }
        let index = self.free.partition_point(|&(start, _)| start < first);
        self.free.insert(index, (first, count));
        if index + 1 < self.free.len() && first + count == self.free[index + 1].0 {
            self.free[index].1 += self.free.remove(index + 1).1;
        }
        if index > 0 && self.free[index - 1].0 + self.free[index - 1].1 == first {
            self.free[index - 1].1 += self.free.remove(index).1;
        }
        if let Some(&(start, free)) = self.free.last()
            && start + free == self.end
        {
            self.end = start;
            self.free.pop();
        }
    }

    /// Required length of the list.
    pub fn end(&self) -> usize {
        self.end
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_two_ranges_overlap_and_all_come_back(steps in prop::collection::vec((0usize..20, any::<prop::sample::Index>(), any::<bool>()), 1..80)) {
            let mut allocator = RangeAllocator::default();
            let mut taken: Vec<(usize, usize)> = Vec::new();
            for (count, which, give_back) in steps {
                if give_back && !taken.is_empty() {
                    let (first, count) = taken.swap_remove(which.index(taken.len()));
                    allocator.give_back(first, count);
                } else {
                    let first = allocator.take(count);
                    prop_assert!(first + count <= allocator.end());
                    for &(other, length) in &taken {
                        prop_assert!(count == 0 || length == 0 || first + count <= other || other + length <= first);
                    }
                    taken.push((first, count));
                }
            }
            for (first, count) in taken {
                allocator.give_back(first, count);
            }
            prop_assert_eq!((allocator.end(), allocator.free.len()), (0, 0));
        }
    }

    #[test]
    fn a_gap_is_filled_before_the_list_grows() {
        let mut allocator = RangeAllocator::default();
        assert_eq!([10, 5, 10].map(|count| allocator.take(count)), [0, 10, 15]);
        allocator.give_back(10, 5);
        assert_eq!([6, 3, 2].map(|count| allocator.take(count)), [25, 10, 13]);
    }
}
