//! `decouplegs drive --devices`: the first device of the machine, opened several times.

use super::drive::logs;
use super::*;

/// Arguments of three small drawn episodes, two images of each.
fn small(out: &Path) -> [&str; 17] {
    [
        "drive",
        "--level",
        "easy",
        "--episodes",
        "3",
        "--planner",
        "vision",
        "--size",
        "64x36",
        "--render",
        "12",
        "--background",
        "6000",
        "--agent-splats",
        "300",
        "--out",
        text(out),
    ]
}

fn on(out: &Path, more: &[&str]) -> String {
    succeed(&[&small(out)[..], more].concat())
}

/// The report without what only `--devices` says, and without wall-clock times.
fn scores(out: &Path) -> Value {
    let mut report = report(out);
    let fields = report.as_object_mut().unwrap();
    fields.remove("device_use");
    fields.remove("times");
    for episode in fields["episodes"].as_array_mut().unwrap() {
        let episode = episode.as_object_mut().unwrap();
        episode.remove("device");
        episode.remove("log");
    }
    report
}

/// The report of the run in the folder `out`.
pub fn report(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap()
}

/// Lines of `devices.jsonl`: episode, position of the device, and the fault if it is one.
fn lines(out: &Path) -> Vec<(String, u64, Option<String>)> {
    let text = fs::read_to_string(out.join("devices.jsonl")).unwrap();
    let line = |line: &str| {
        let line: Value = serde_json::from_str(line).unwrap();
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let position = line["device"]["position"].as_u64().unwrap();
        (
            text(&line["episode"]).unwrap(),
            position,
            text(&line["fault"]),
        )
    };
    text.lines().map(line).collect()
}

#[test]
fn two_devices_drive_what_one_does_and_the_report_says_which_drove() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    let alone = on(&one, &["--device", "0"]);
    let report_of_one = report(&one);
    assert!(
        report_of_one.get("device_use").is_none()
            && report_of_one["episodes"][0].get("device").is_none()
            && !one.join("devices.jsonl").exists(),
        "nothing is different without --devices"
    );
    let said = on(&two, &["--devices", "0,0"]);
    assert_eq!(logs(&two), logs(&one));
    assert_eq!(scores(&two), scores(&one));
    let table = |said: &str| said.lines().take(3).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(table(&said), table(&alone));
    let used = report(&two);
    let drove = lines(&two);
    assert_eq!(drove.len(), 3);
    for (episode, position, fault) in drove {
        let entries = used["episodes"].as_array().unwrap();
        let entry = entries.iter().find(|entry| entry["name"] == *episode);
        assert_eq!(entry.unwrap()["device"]["position"], position);
        assert_eq!(fault, None);
    }
    let devices = used["device_use"]["devices"].as_array().unwrap();
    let sum = |key: &str| -> u64 { devices.iter().map(|row| row[key].as_u64().unwrap()).sum() };
    assert_eq!((devices.len(), sum("episodes")), (2, 3));
    assert_eq!(used["device_use"]["driven"]["images"], sum("images"));
    assert!(sum("images") > 3 && sum("sweeps") == 0);
    assert!(
        said.contains("episodes/h") && said.contains("device 1, "),
        "{said}"
    );
    stress::assert_page_stands_alone(&fs::read_to_string(two.join("report.html")).unwrap());
}

#[test]
fn episodes_of_a_device_that_is_lost_or_full_are_driven_by_another() {
    let folder = tempfile::tempdir().unwrap();
    let one = folder.path().join("one");
    on(&one, &["--device", "0"]);
    for (drill, reason) in [
        ("1:lost:40", "device lost"),
        ("0:full:0", "out of device memory"),
    ] {
        let out = folder.path().join(drill);
        let said = on(&out, &["--devices", "0,0", "--drill", drill]);
        assert_eq!(logs(&out), logs(&one), "{drill}");
        let drove = lines(&out);
        let broken = if drill.starts_with('1') { 1 } else { 0 };
        let faults: Vec<_> = drove.iter().filter(|line| line.2.is_some()).collect();
        assert_eq!(faults.len(), 1, "{drove:?}");
        let (episode, position, fault) = faults[0];
        assert!(*position == broken && fault.as_ref().unwrap().contains(reason));
        let again = drove
            .iter()
            .filter(|line| line.0 == *episode && line.2.is_none());
        assert_eq!(again.map(|line| line.1).collect::<Vec<_>>(), [1 - broken]);
        assert!(
            said.contains("out of the run") && said.contains(reason),
            "{said}"
        );
    }
}

#[test]
fn workers_of_a_device_that_is_lost_leave_together() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    on(&one, &["--device", "0"]);
    let drill = ["--devices", "0,0", "--workers", "3", "--drill", "0:lost:5"];
    on(&two, &drill);
    assert_eq!(logs(&two), logs(&one));
    let (lost, driven): (Vec<_>, Vec<_>) =
        lines(&two).into_iter().partition(|line| line.2.is_some());
    assert!(driven.len() == 3 && driven.iter().all(|line| line.1 == 1));
    assert!(lost.iter().all(|line| line.1 == 0), "{lost:?}");
}

#[test]
fn a_run_whose_devices_are_all_gone_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let [one, out] = ["one", "out"].map(|name| folder.path().join(name));
    on(&one, &["--device", "0"]);
    let gone = [
        "--devices",
        "0,0",
        "--drill",
        "0:lost:40",
        "--drill",
        "1:lost:40",
    ];
    let said = fail(1, &[&small(&out)[..], &gone].concat());
    assert!(
        said.contains("no device is left") && said.contains("device lost"),
        "{said}"
    );
    let faults = lines(&out).into_iter().filter(|line| line.2.is_some());
    assert_eq!(faults.count(), 2);
    let done = logs(&out)
        .into_iter()
        .filter(|(name, _)| name.ends_with(".log"));
    let done: Vec<_> = done.collect();
    assert!(done.iter().all(|log| logs(&one).contains(log)));
    let said = on(&out, &["--devices", "0,0"]);
    assert!(
        !said.contains("out of the run"),
        "the fault was before: {said}"
    );
    assert_eq!(logs(&out), logs(&one));
}

#[test]
fn devices_without_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let refused = |code, more: &[&str]| fail(code, &[&small(&out)[..], more].concat());
    let said = refused(2, &["--device", "0", "--devices", "0,0"]);
    assert!(said.contains("--devices"), "{said}");
    let said = refused(2, &["--devices", "0,,0"]);
    assert!(said.contains("separated by commas"), "{said}");
    let said = refused(2, &["--devices", "0", "--drill", "0:gone:1"]);
    assert!(said.contains("lost:N"), "{said}");
    let said = refused(1, &["--devices", "0,no such device"]);
    assert!(said.contains("no such device"), "{said}");
    let blind = [
        "drive",
        "--level",
        "easy",
        "--planner",
        "lane-follow",
        "--render",
        "off",
    ];
    let said = fail(
        1,
        &[&blind[..], &["--devices", "all", "--out", text(&out)]].concat(),
    );
    assert!(said.contains("draws nothing"), "{said}");
}
