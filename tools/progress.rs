//! Progress of long work, shown only to a person: nothing is drawn where standard error is no terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar of `steps` under the name of the work.
pub fn bar(work: &'static str, steps: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}").expect("the template is well-formed");
    ProgressBar::new(steps as u64).with_style(style).with_message(work)
}

/// A spinner for work whose length is not known. Ends when it is dropped or finished.
pub fn spinner(work: String) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(work);
    spinner.enable_steady_tick(Duration::from_millis(120));
    spinner
}
