//! States of what is edited, for undo and redo.

use std::sync::Arc;

use serde_json::{Value, json};

/// Changes that can be undone.
const UNDO_MAX: usize = 200;

/// State before or after a change.
struct Step<T> {
    /// The change, in words.
    change: String,
    state: Arc<T>,
}

/// A state, and those that undo and redo lead to. Copies share the states.
pub struct History<T> {
    state: Arc<T>,
    undo: Vec<Step<T>>,
    redo: Vec<Step<T>>,
}

impl<T> Clone for Step<T> {
    fn clone(&self) -> Self {
        Self {
            change: self.change.clone(),
            state: self.state.clone(),
        }
    }
}

impl<T> Clone for History<T> {
    fn clone(&self) -> Self {
        Self {
            state: self.state.clone(),
            undo: self.undo.clone(),
            redo: self.redo.clone(),
        }
    }
}

impl<T> History<T> {
    /// The start, without changes.
    pub fn new(state: T) -> Self {
        Self {
            state: Arc::new(state),
            undo: Vec::new(),
            redo: Vec::new(),
        }
    }

    /// The state as it is now.
    pub fn state(&self) -> &T {
        &self.state
    }

    /// Sets the state that `change`, in words, leads to.
    pub fn commit(&mut self, state: T, change: String) {
        let state = std::mem::replace(&mut self.state, Arc::new(state));
        self.undo.push(Step { change, state });
        if self.undo.len() > UNDO_MAX {
            self.undo.remove(0);
        }
        self.redo.clear();
    }

    /// Takes the last change back.
    ///
    /// # Errors
    /// A sentence, if there is none.
    pub fn undo(&mut self) -> Result<(), String> {
        exchange(&mut self.state, &mut self.undo, &mut self.redo)
            .ok_or_else(|| "there is nothing to undo".into())
    }

    /// Makes the change again that was taken back last.
    ///
    /// # Errors
    /// A sentence, if there is none.
    pub fn redo(&mut self) -> Result<(), String> {
        exchange(&mut self.state, &mut self.redo, &mut self.undo)
            .ok_or_else(|| "there is nothing to redo".into())
    }

    /// The changes that undo and redo would take, in words, as JSON.
    pub fn facts(&self) -> Value {
        let last = |steps: &[Step<T>]| steps.last().map(|step| step.change.clone());
        json!({"undo": last(&self.undo), "redo": last(&self.redo)})
    }
}

/// Puts the last state of `from` in the place of `state`, and that onto `to`; `None` where there is
/// none.
fn exchange<T>(state: &mut Arc<T>, from: &mut Vec<Step<T>>, to: &mut Vec<Step<T>>) -> Option<()> {
    let step = from.pop()?;
    let state = std::mem::replace(state, step.state);
    let change = step.change;
    to.push(Step { change, state });
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_taken_back_and_made_again() {
        let mut history = History::new(1);
        assert!(history.undo().is_err() && history.redo().is_err());
        history.commit(2, "two".into());
        history.commit(3, "three".into());
        history.undo().unwrap();
        assert_eq!(
            (*history.state(), history.facts()),
            (2, json!({"undo": "two", "redo": "three"}))
        );
        history.redo().unwrap();
        history.undo().unwrap();
        // Another change forgets what could be made again.
        history.commit(4, "four".into());
        assert!(history.redo().is_err());
        assert_eq!(*history.state(), 4);
        for number in 0..2 * UNDO_MAX {
            history.commit(number, "more".into());
        }
        let undone = (0..).take_while(|_| history.undo().is_ok()).count();
        assert_eq!(undone, UNDO_MAX);
    }
}
