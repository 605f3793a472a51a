//! The clock that all clients share.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Shortest time between two messages about a clock that plays.
const TOLD_EVERY: Duration = Duration::from_millis(50);

/// The clock: the time that is shown, and whether it goes on.
pub struct Clock {
    /// Time, seconds.
    pub time_s: f64,
    /// True while it goes on by itself.
    pub playing: bool,
    /// True if it begins again at the end.
    pub looping: bool,
    /// Seconds of the scene per second.
    pub speed: f64,
    /// Instant at which it was set last.
    pub advanced: Instant,
    /// Number of changes that images have to follow.
    pub revision: u64,
    told: Option<(Value, Instant)>,
}

impl Clock {
    /// A clock that stands at 0 s.
    pub fn new() -> Self {
        Self {
            time_s: 0.0,
            playing: false,
            looping: false,
            speed: 1.0,
            advanced: Instant::now(),
            revision: 0,
            told: None,
        }
    }

    /// Message about the clock, as JSON. `shown_s` is the time of the moment that is shown.
    pub fn message(&self, shown_s: f64) -> Value {
        json!({
            "type": "clock",
            "time_s": shown_s,
            "playing": self.playing,
            "looping": self.looping,
            "speed": self.speed,
            "revision": self.revision,
        })
    }

    /// The message, if it is not the one that was told last; while it plays, not too often.
    pub fn news(&mut self, shown_s: f64) -> Option<Value> {
        let message = self.message(shown_s);
        if let Some((told, at)) = &self.told {
            let waits = self.playing && told["playing"] == true && at.elapsed() < TOLD_EVERY;
            if waits || *told == message {
                return None;
            }
        }
        self.told = Some((message.clone(), Instant::now()));
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn news_are_told_once_and_not_too_often() {
        let mut clock = Clock::new();
        assert_eq!(clock.news(0.0).unwrap()["time_s"], 0.0);
        assert_eq!(clock.news(0.0), None);
        assert_eq!(clock.news(1.0).unwrap()["time_s"], 1.0);
        clock.playing = true;
        // The first message of a clock that plays does not wait, nor does the one that it stands.
        assert!(clock.news(1.0).is_some());
        clock.told = clock.told.map(|(told, _)| (told, Instant::now()));
        assert_eq!(clock.news(1.1), None);
        clock.playing = false;
        assert_eq!(clock.news(1.2).unwrap()["playing"], false);
    }
}
