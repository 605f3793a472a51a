//! Progress of long work, on standard error: a bar for a person at a terminal, a line now and then
//! where there is none.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle, WeakProgressBar};

/// Work that takes less time is not reported without a terminal.
const FIRST_LINE: Duration = Duration::from_secs(2);
/// The time between two lines doubles up to this.
const LINE_EVERY_MAX: Duration = Duration::from_secs(30);
/// Time between two looks at whether the work has ended.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A bar of `steps` under the name of the work.
pub fn bar(work: &'static str, steps: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}")
        .expect("the template is well-formed");
    let bar = ProgressBar::new(steps as u64)
        .with_style(style)
        .with_message(work);
    report_without_terminal(&bar);
    bar
}

/// A spinner for work whose length is not known. Ends when it is dropped or finished.
pub fn spinner(work: String) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(work);
    if std::io::stderr().is_terminal() {
        spinner.enable_steady_tick(Duration::from_millis(120));
    }
    report_without_terminal(&spinner);
    spinner
}

/// Reports on `bar` by lines, from a thread that ends with it.
fn report_without_terminal(bar: &ProgressBar) {
    if std::io::stderr().is_terminal() {
        return;
    }
    let bar = bar.downgrade();
    // Without a thread there are no lines, and the work goes on.
    let _ = std::thread::Builder::new()
        .name("progress".into())
        .spawn(move || report(&bar));
}

fn report(bar: &WeakProgressBar) {
    let since = Instant::now();
    let (mut next, mut wait) = (FIRST_LINE, FIRST_LINE);
    loop {
        std::thread::sleep(LOOK_EVERY);
        let Some(bar) = bar.upgrade().filter(|bar| !bar.is_finished()) else {
            return;
        };
        if since.elapsed() < next {
            continue;
        }
        // A standard error that is closed or full is nobody to tell.
        let _ = writeln!(
            std::io::stderr(),
            "{}",
            line(
                &bar.message(),
                bar.position(),
                bar.length(),
                since.elapsed()
            )
        );
        wait = (2 * wait).min(LINE_EVERY_MAX);
        next += wait;
    }
}

fn line(work: &str, done: u64, steps: Option<u64>, elapsed: Duration) -> String {
    let seconds = elapsed.as_secs();
    match steps {
        Some(steps) => format!("{work}: {done} of {steps} after {seconds} s"),
        None => format!("{work}: {seconds} s so far"),
    }
}

/// Converts a duration to milliseconds.
pub fn to_ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_say_how_far_the_work_is() {
        assert_eq!(
            line("episodes", 3, Some(10), Duration::from_millis(4900)),
            "episodes: 3 of 10 after 4 s"
        );
        assert_eq!(
            line("reading a.ply", 0, None, Duration::from_secs(7)),
            "reading a.ply: 7 s so far"
        );
    }
}
