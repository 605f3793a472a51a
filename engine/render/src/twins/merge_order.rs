//! Joins each camera's two sorted lists to its front-to-back order: `merge_order.comp`.

use crate::layout::ViewLists;

/// Writes the values of the first `camera_count` of `lists` by key, those of the background first where keys are equal.
pub fn merge_order(lists: &[ViewLists], keys: &[u32], values: &[u32], order: &mut [u32], camera_count: usize) {
    for list in &lists[..camera_count] {
        let mut background = (list.first_static..list.first_static + list.static_count).peekable();
        let mut agents = (list.first_moving..list.first_moving + list.moving_count).peekable();
        for place in list.first_ordered..list.first_ordered + list.static_count + list.moving_count {
            let nearer = match (background.peek(), agents.peek()) {
                (Some(&own), Some(&other)) if keys[own as usize] > keys[other as usize] => agents.next(),
                (Some(_), _) => background.next(),
                (None, _) => agents.next(),
            };
            if let Some(record) = nearer {
                order[place as usize] = values[record as usize];
            }
        }
    }
}
