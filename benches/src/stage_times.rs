//! Times of the stages of frames.

use decouplegs::render::FrameStatistics;

/// Milliseconds per frame of each stage that some of `frames` had, in the order they run.
/// `stages_of` gives name and nanoseconds of the stages of a frame; those of one name are added up.
pub fn stage_times_ms<'a, S>(
    frames: &'a [FrameStatistics],
    stages_of: impl Fn(&'a FrameStatistics) -> S,
) -> Vec<(&'static str, Vec<f64>)>
where
    S: Iterator<Item = (&'static str, u64)>,
{
    let mut times: Vec<(&'static str, Vec<f64>)> = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        for (name, duration_ns) in stages_of(frame) {
            let at = times.iter().position(|(known, _)| *known == name);
            let at = at.unwrap_or_else(|| {
                times.push((name, vec![0.0; frames.len()]));
                times.len() - 1
            });
            times[at].1[index] += duration_ns as f64 / 1e6;
        }
    }
    times
}
