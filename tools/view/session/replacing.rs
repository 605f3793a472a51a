//! Files of pages, which take the place of what is shown.

use super::{Recording, Viewer};
use crate::protocol::View;
use crate::render_command::RenderOptions;
use crate::source::Source;

impl Viewer {
    /// Shows `source` alone, from its first time on. Pages learn it by facts with another number.
    ///
    /// # Errors
    /// A sentence, while a recording goes on: it is of what is shown.
    pub(super) fn show(&mut self, source: Source) -> Result<(), String> {
        if !matches!(self.recording, Recording::None) {
            return Err("a recording goes on: wait until it is done".into());
        }
        self.end_steps(&Ok(()));
        let begin_s = source.span_s()[0];
        self.sources = vec![source];
        self.shown += 1;
        // Options of the command line were for what it named.
        self.options = RenderOptions {
            words: std::mem::take(&mut self.options.words),
            ..RenderOptions::default()
        };
        self.clock.playing = false;
        for client in self.clients.values_mut() {
            client.view = View::default();
        }
        self.set_time(begin_s);
        self.tell(&self.facts());
        self.tell_changes();
        Ok(())
    }
}
