//! The episodes of a run that workers take from one queue.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Episodes by their index. One that a worker could not drive may be put back for another.
pub struct EpisodeQueue {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    waiting: VecDeque<usize>,
    /// Episodes that workers have.
    taken: usize,
    /// Episodes that were taken at least once: the first ones.
    begun: usize,
    is_stopped: bool,
}

impl EpisodeQueue {
    /// A queue of episodes 0 to `count`, in this order.
    pub fn new(count: usize) -> Self {
        Self {
            state: Mutex::new(State {
                waiting: (0..count).collect(),
                taken: 0,
                begun: 0,
                is_stopped: false,
            }),
            changed: Condvar::new(),
        }
    }

    /// The next episode. Waits while there is none and another worker may put one back. `None`
    /// where none will come.
    pub fn take(&self) -> Option<usize> {
        let mut state = self.state();
        loop {
            if state.is_stopped {
                return None;
            }
            if let Some(index) = state.waiting.pop_front() {
                state.taken += 1;
                state.begun = state.begun.max(index + 1);
                return Some(index);
            }
            if state.taken == 0 {
                return None;
            }
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Says that an episode which was taken is finished.
    pub fn finish(&self) {
        self.state().taken -= 1;
        self.changed.notify_all();
    }

    /// Puts back an episode that was taken and could not be driven: it is the next one.
    pub fn put_back(&self, index: usize) {
        let mut state = self.state();
        state.waiting.push_front(index);
        state.taken -= 1;
        drop(state);
        self.changed.notify_all();
    }

    /// Gives out no more episodes.
    pub fn stop(&self) {
        self.state().is_stopped = true;
        self.changed.notify_all();
    }

    /// Number of episodes, from the first, that were taken at least once.
    pub fn begun(&self) -> usize {
        self.state().begun
    }

    /// Number of episodes that nobody has taken or that were put back.
    pub fn waiting(&self) -> usize {
        self.state().waiting.len()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_that_is_put_back_comes_to_a_worker_who_waits() {
        let queue = EpisodeQueue::new(2);
        assert_eq!((queue.take(), queue.take()), (Some(0), Some(1)));
        assert_eq!((queue.begun(), queue.waiting()), (2, 0));
        let found = std::thread::scope(|scope| {
            let waiting = scope.spawn(|| {
                let found = queue.take();
                queue.finish();
                (found, queue.take())
            });
            queue.finish();
            queue.put_back(0);
            waiting.join().unwrap()
        });
        assert_eq!(found, (Some(0), None), "and none is left after it");
    }

    #[test]
    fn a_queue_that_is_stopped_gives_nothing() {
        let queue = EpisodeQueue::new(3);
        assert_eq!(queue.take(), Some(0));
        queue.stop();
        assert_eq!((queue.take(), queue.waiting()), (None, 2));
    }
}
