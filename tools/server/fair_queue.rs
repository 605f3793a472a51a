//! Requests that wait for one thread, in an order that is fair to connections.

use std::collections::{HashMap, VecDeque};
use std::time::Duration;

/// Peers that are remembered, beside those whose items wait.
const KNOWN_MAX: usize = 1024;

/// Items of several peers, in an order that gives each peer the same time of the thread that works
/// on them (start-time fair queueing, Goyal, Vin and Cheng, 1996): a peer with many items, or with
/// items that take long, does not hold up one that has a short one now and then.
///
/// The time that an item takes is known once it was done. Peers are known after their first item:
/// one that asks now and then has its item done next, however many others wait with theirs.
pub struct FairQueue<T> {
    peers: HashMap<u64, Peer<T>>,
    /// Most time that a peer had used when it was chosen.
    floor: Duration,
    /// Moving average of the time of an item. Peers that come back begin that much before the
    /// floor, and new ones that much behind it: otherwise a client with a new connection for each
    /// request would keep all others waiting.
    usual: Duration,
    /// Number of items that were ever pushed.
    pushed: u64,
}

/// Items of one peer.
struct Peer<T> {
    /// Items in the order in which they came, each behind its number among all.
    items: VecDeque<(u64, T)>,
    used: Duration,
}

impl<T> Default for FairQueue<T> {
    fn default() -> Self {
        Self {
            peers: HashMap::new(),
            floor: Duration::ZERO,
            usual: Duration::ZERO,
            pushed: 0,
        }
    }
}

impl<T> FairQueue<T> {
    /// Adds an item of the peer with a number.
    pub fn push(&mut self, peer: u64, item: T) {
        // Of the time in which it asked for nothing, one item is saved up.
        let least = self.floor.saturating_sub(self.usual);
        let pushed = self.pushed;
        let peer = self.peer(peer);
        if peer.items.is_empty() {
            peer.used = peer.used.max(least);
        }
        peer.items.push_back((pushed, item));
        self.pushed += 1;
    }

    /// The next item and its peer: of the peers that used the least time, the one whose item came
    /// first.
    pub fn pop(&mut self) -> Option<(u64, T)> {
        let next = self.peers.iter().filter_map(|(number, peer)| {
            let (pushed, _) = peer.items.front()?;
            Some((peer.used, *pushed, *number))
        });
        let Some((used, _, number)) = next.min() else {
            // No item waits, so no peer has a claim to be served before another.
            let most = self.peers.values().map(|peer| peer.used).max();
            self.floor = self.floor.max(most.unwrap_or_default());
            return None;
        };
        self.floor = self.floor.max(used);
        let (_, item) = self.peers.get_mut(&number)?.items.pop_front()?;
        if self.peers.len() > KNOWN_MAX {
            let floor = self.floor;
            self.peers.retain(|other, peer| {
                *other == number || !peer.items.is_empty() || peer.used > floor
            });
        }
        Some((number, item))
    }

    /// Counts time that was used for `peer`.
    pub fn took(&mut self, peer: u64, time: Duration) {
        self.peer(peer).used += time;
        self.usual = (15 * self.usual + time) / 16;
    }

    fn peer(&mut self, number: u64) -> &mut Peer<T> {
        let used = self.floor + self.usual;
        self.peers.entry(number).or_insert_with(|| Peer {
            items: VecDeque::new(),
            used,
        })
    }

    /// True if no item waits.
    pub fn is_empty(&self) -> bool {
        self.peers.values().all(|peer| peer.items.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUDE: u64 = 1;
    const POLITE: u64 = 2;

    fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    /// Serves the next item, which takes `time_ms`.
    fn serve(queue: &mut FairQueue<u64>) -> Option<(u64, u64)> {
        let (peer, time_ms) = queue.pop()?;
        queue.took(peer, ms(time_ms));
        Some((peer, time_ms))
    }

    #[test]
    fn items_of_one_peer_keep_their_order() {
        let mut queue = FairQueue::default();
        assert!(queue.is_empty() && queue.pop().is_none());
        for item in 0..100 {
            queue.push(RUDE, item);
        }
        assert!(!queue.is_empty());
        for item in 0..100 {
            assert_eq!(queue.pop(), Some((RUDE, item)));
        }
        assert!(queue.is_empty() && queue.pop().is_none());
    }

    #[test]
    fn one_item_does_not_wait_for_a_hundred_of_another_peer() {
        let mut queue = FairQueue::default();
        (0..100).for_each(|_| queue.push(RUDE, 10));
        assert_eq!(serve(&mut queue), Some((RUDE, 10)));
        for _ in 0..20 {
            queue.push(POLITE, 10);
            let next = [serve(&mut queue).unwrap().0, serve(&mut queue).unwrap().0];
            assert!(
                next.contains(&POLITE),
                "at most one of the other is before it"
            );
        }
    }

    #[test]
    fn peers_get_the_same_time_where_their_items_take_different_times() {
        let mut queue = FairQueue::default();
        let mut used = HashMap::<u64, u64>::new();
        for _ in 0..1000 {
            // Both always have one that waits.
            for (peer, time_ms) in [(RUDE, 100), (POLITE, 3)] {
                if queue
                    .peers
                    .get(&peer)
                    .is_none_or(|peer| peer.items.is_empty())
                {
                    queue.push(peer, time_ms);
                }
            }
            let (peer, time_ms) = serve(&mut queue).unwrap();
            *used.entry(peer).or_default() += time_ms;
        }
        let (rude, polite) = (used[&RUDE], used[&POLITE]);
        assert!(rude.abs_diff(polite) <= 100, "{rude} ms and {polite} ms");
    }

    #[test]
    fn time_without_items_is_not_saved_up() {
        let mut queue = FairQueue::default();
        (0..100).for_each(|_| queue.push(POLITE, 10));
        (0..50).for_each(|_| assert_eq!(serve(&mut queue), Some((POLITE, 10))));
        // One that comes late has no right to the 500 ms before it.
        (0..50).for_each(|_| queue.push(RUDE, 10));
        let next: Vec<u64> = (0..20).map(|_| serve(&mut queue).unwrap().0).collect();
        let rude = next.iter().filter(|&&peer| peer == RUDE).count();
        assert!((9..=11).contains(&rude), "{rude} of 20");
    }

    #[test]
    fn peers_that_are_always_new_do_not_keep_others_waiting() {
        let mut queue = FairQueue::default();
        queue.push(POLITE, 10);
        let (mut new, mut polite) = (100, 0);
        for _ in 0..1000 {
            // Four of them wait at any time, each under another number than before.
            while queue
                .peers
                .values()
                .filter(|peer| !peer.items.is_empty())
                .count()
                < 5
            {
                queue.push(new, 10);
                new += 1;
            }
            if serve(&mut queue).unwrap().0 == POLITE {
                polite += 1;
                queue.push(POLITE, 10);
            }
        }
        assert!(
            polite >= 150,
            "{polite} of 1000, where a fifth is its share"
        );
    }

    #[test]
    fn one_that_asks_now_and_then_is_next_among_many_that_always_wait() {
        let mut queue = FairQueue::default();
        queue.push(POLITE, 1);
        serve(&mut queue);
        let new = 10_000;
        for round in 0..20 {
            let rude = 100..150;
            rude.clone().for_each(|peer| queue.push(peer, 4));
            (0..rude.count()).for_each(|_| assert!(serve(&mut queue).is_some()));
            (100..150).for_each(|peer| queue.push(peer, 4));
            serve(&mut queue);
            // All 49 others wait with an item.
            queue.push(new + round, 1);
            queue.push(POLITE, 1);
            let next = [serve(&mut queue).unwrap().0, serve(&mut queue).unwrap().0];
            assert!(next.contains(&POLITE), "{next:?} in round {round}");
            // One that is new waits for a round of them.
            assert!(!next.contains(&(new + round)), "{next:?} in round {round}");
            while serve(&mut queue).is_some() {}
        }
    }

    #[test]
    fn peers_that_went_are_forgotten() {
        let mut queue = FairQueue::default();
        for peer in 0..10_000 {
            queue.push(peer, 1);
            serve(&mut queue);
        }
        assert!(queue.peers.len() <= KNOWN_MAX + 1);
        // Also beside one that always waits.
        (0..20_000).for_each(|_| queue.push(RUDE, 1));
        for peer in 10_000..20_000 {
            queue.push(peer, 1);
            serve(&mut queue);
            serve(&mut queue);
        }
        let known = queue.peers.len();
        assert!(known <= KNOWN_MAX + 10, "{known}");
    }
}
