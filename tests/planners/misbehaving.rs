//! Planners of others that are slow, gone, babbling or wrong: each ends its episode with a
//! sentence, in time, and the next one begins.

use std::time::{Duration, Instant};

use decouplegs::planner::{Cameras, External, Planner, PlannerError, Reading, Timeouts, Transport};

use super::scene_ahead::{PATIENT, briefing, cameras, observation, opened, script};

/// Timeout for planners that never answer.
const SHORT: Timeouts = Timeouts {
    answer: Duration::from_millis(300),
    ..PATIENT
};
/// Time until an error is told, at most: half of what a planner sleeps who has to be ended, and far
/// more than a busy machine takes.
const TOLD_WITHIN: Duration = Duration::from_secs(30);

/// Step `step` with an image of `pixels` pixels.
fn plan(planner: &mut External, step: u32) -> Result<(), PlannerError> {
    let camera = &cameras()[0];
    let rgba = vec![100; 4 * camera.intrinsics.pixels() as usize];
    planner
        .plan(&observation(step, &[Reading::image(camera, &rgba)], None))
        .map(|_| ())
}

/// Error message about a planner that drives well at first and then misbehaves as `way` says. It is
/// begun anew after it.
fn said_of(way: &str, timeouts: Timeouts) -> String {
    let mut planner = opened("misbehaving.py", &[way], PATIENT);
    assert_eq!(
        (planner.name().as_str(), planner.sees().cameras),
        (way, Cameras::Front)
    );
    planner.begin(&briefing()).unwrap();
    plan(&mut planner, 0).unwrap();
    planner = planner.with_timeouts(timeouts);
    let begin = Instant::now();
    let said = plan(&mut planner, 1).expect_err(way).to_string();
    assert!(
        begin.elapsed() < TOLD_WITHIN,
        "{way}: told after {:?}",
        begin.elapsed()
    );
    assert!(
        said.starts_with("the external planner ") && said.len() < 1000 && !said.contains('\u{1b}'),
        "{said}"
    );
    planner = planner.with_timeouts(PATIENT);
    planner
        .begin(&briefing())
        .unwrap_or_else(|error| panic!("{way}: does not begin again: {error}"));
    plan(&mut planner, 0).unwrap_or_else(|error| panic!("{way}: does not drive again: {error}"));
    said
}

fn assert_says(way: &str, timeouts: Timeouts, parts: &[&str]) {
    let said = said_of(way, timeouts);
    for part in parts {
        assert!(said.contains(part), "{way}: {said:?} does not say {part:?}");
    }
}

#[test]
fn who_is_late_is_not_waited_for() {
    assert_says(
        "late",
        SHORT,
        &[
            "did not answer `observe` within 0.3 s",
            "went on running and was ended",
        ],
    );
    assert_says(
        "dribbling",
        SHORT,
        &["did not answer `observe` within 0.3 s"],
    );
}

#[test]
fn who_ends_is_named_with_status_and_last_words() {
    assert_says(
        "crashing",
        PATIENT,
        &[
            "closed the connection",
            "exit status: 3",
            "out of memory | at layer 7",
        ],
    );
    assert_says("killed", PATIENT, &["closed the connection", "signal: 9"]);
    assert_says(
        "complaining",
        PATIENT,
        &["exit status: 4", "noise | the last word"],
    );
    assert_says(
        "closing",
        PATIENT,
        &["closed the connection", "went on running and was ended"],
    );
}

#[test]
fn who_talks_too_much_is_cut_short() {
    assert_says(
        "babbling",
        PATIENT,
        &[
            "a line of more than 65536 bytes",
            "begins with \"babble babble",
        ],
    );
    assert_says("huger", PATIENT, &["a line of more than 65536 bytes"]);
    assert_says("nested", PATIENT, &["not JSON", "recursion limit"]);
}

#[test]
fn what_is_no_plan_is_refused() {
    assert_says(
        "nan",
        PATIENT,
        &["not JSON", "NaN and Infinity are not JSON"],
    );
    assert_says("infinity", PATIENT, &["NaN and Infinity are not JSON"]);
    assert_says("overflowing", PATIENT, &["not JSON", "number out of range"]);
    assert_says(
        "far",
        PATIENT,
        &["point 0 of the plan is 1000000000 m away"],
    );
    assert_says(
        "huge",
        PATIENT,
        &["a plan of 1499 points; expected 1 to 256"],
    );
    assert_says("backwards", PATIENT, &["point 1 of the plan is at 0.5 s"]);
}

#[test]
fn what_lacks_a_part_is_refused() {
    assert_says("empty", PATIENT, &["a plan of 0 points"]);
    assert_says(
        "flat",
        PATIENT,
        &["point 0 is not [seconds, meters ahead, meters to the left]"],
    );
    assert_says("wordy", PATIENT, &["point 0 is not ["]);
    assert_says("pointless", PATIENT, &["a plan without `points`"]);
    assert_says("laden", PATIENT, &["announced bytes after its line"]);
}

#[test]
fn what_was_not_asked_for_is_refused() {
    assert_says(
        "stale",
        PATIENT,
        &["answered `observe` with plan; expected a plan for step 1"],
    );
    assert_says(
        "wrong",
        PATIENT,
        &["answered `observe` with ready; expected a plan for step 1 or fail"],
    );
    assert_says(
        "unknown",
        PATIENT,
        &["`type` is not hello, ready, plan or fail", "dance"],
    );
    assert_says("junk", PATIENT, &["not JSON", "Loading model weights"]);
    assert_says("binary", PATIENT, &["not UTF-8"]);
    assert_says("giving-up", PATIENT, &["failed: the road  [31mends"]);
}

#[test]
fn who_interrupts_is_refused_at_the_next_word() {
    let mut planner = opened("misbehaving.py", &["interrupting"], PATIENT);
    planner.begin(&briefing()).unwrap();
    let said = plan(&mut planner, 1).and_then(|()| {
        std::thread::sleep(Duration::from_millis(300));
        plan(&mut planner, 2)
    });
    assert!(
        said.unwrap_err()
            .to_string()
            .contains("spoke without being asked")
    );
    // Until the next episode begins there is nobody to ask.
    assert!(
        plan(&mut planner, 3)
            .unwrap_err()
            .to_string()
            .contains("was lost")
    );
}

#[test]
fn who_does_not_read_does_not_hold_us_up() {
    let mut planner = opened("misbehaving.py", &["deaf"], PATIENT);
    planner.begin(&briefing()).unwrap();
    planner = planner.with_timeouts(SHORT);
    let camera = &cameras()[0];
    let rgba = vec![0; 16 << 20];
    let begin = Instant::now();
    let said = planner
        .plan(&observation(0, &[Reading::image(camera, &rgba)], None))
        .unwrap_err()
        .to_string();
    assert!(
        said.contains("did not take `observe` within 0.3 s"),
        "{said}"
    );
    assert!(begin.elapsed() < TOLD_WITHIN);
}

#[test]
fn who_cannot_be_started_or_introduces_himself_badly_is_refused_at_once() {
    let refused = |attachment, timeouts| {
        External::open(attachment, timeouts)
            .unwrap_err()
            .to_string()
    };
    let missing = refused(Transport::Command(vec!["no-such-planner".into()]), PATIENT);
    assert!(
        missing.contains("cannot start \"no-such-planner\""),
        "{missing}"
    );
    assert!(refused(Transport::Command(vec![]), PATIENT).contains("no program is named"));
    let modern = refused(script("misbehaving.py", &["modern"]), PATIENT);
    assert!(modern.contains("speaks protocol 2; expected 1"), "{modern}");
    let short = Timeouts {
        hello: Duration::from_millis(300),
        ..PATIENT
    };
    let mute = refused(script("misbehaving.py", &["mute"]), short);
    assert!(
        mute.contains("did not answer `hello` within 0.3 s"),
        "{mute}"
    );
    let shell = |words: &str| {
        refused(
            Transport::Command(vec!["sh".into(), "-c".into(), words.into()]),
            PATIENT,
        )
    };
    assert!(
        shell("read line; echo '{\"type\":\"hello\",\"protocol\":1}'").contains("without a `name`")
    );
    let unsure = r#"{"type":"hello","protocol":1,"name":"x","cameras":"none","privileged":false,"localization":"yes"}"#;
    assert!(
        shell(&format!("read line; echo '{unsure}'"))
            .contains("other `localization` than true or false")
    );
    assert!(
        shell("read line; echo '{\"type\":\"ready\"}'")
            .contains("answered hello with ready; expected hello")
    );
    assert!(shell("exit 7").contains("exit status: 7"));
}

/// True if any process has `word` in its command line.
fn is_running(word: &str) -> bool {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut lines =
        processes.filter_map(|process| std::fs::read(process.path().join("cmdline")).ok());
    lines.any(|line| {
        line.windows(word.len())
            .any(|window| window == word.as_bytes())
    })
}

#[test]
fn nobody_is_left_when_a_planner_is_dropped() {
    // A shell that waits for a grandchild: ending the child alone would leave it.
    let word = format!(
        "{}.{}",
        86_000 + std::process::id() % 1000,
        std::process::id()
    );
    let hello = r#"{"type":"hello","protocol":1,"name":"sh","cameras":"none","privileged":false}"#;
    let words = format!("read line; echo '{hello}'; sleep {word} & wait");
    let planner = External::open(
        Transport::Command(vec!["sh".into(), "-c".into(), words]),
        PATIENT,
    )
    .unwrap();
    assert!(is_running(&word), "the grandchild runs");
    let begin = Instant::now();
    drop(planner);
    assert!(begin.elapsed() < TOLD_WITHIN);
    while is_running(&word) {
        assert!(begin.elapsed() < TOLD_WITHIN, "the grandchild is left");
        std::thread::sleep(Duration::from_millis(10));
    }
}
