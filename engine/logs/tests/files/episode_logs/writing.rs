//! Writing of logs.

use super::*;

#[test]
fn a_log_gets_its_name_with_its_end() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("easy-0001.log");
    let episode = small();
    let mut log = EpisodeLog::create(&path, &episode.head, &episode.start).unwrap();
    let part = log.part_path().to_owned();
    assert_eq!(part, directory.path().join("easy-0001.log.part"));
    for (index, step) in episode.steps.iter().enumerate() {
        log.append(step).unwrap();
        // As it would be if the program died here.
        let so_far = std::fs::read(&part).unwrap();
        assert_eq!(lines_of(&so_far).len(), index + 2);
        assert!(
            complaint(&so_far)
                .contains("is missing: the log ends without telling how the episode ended")
        );
        assert!(!path.exists());
    }
    log.finish(&episode.end).unwrap();
    assert!(!part.exists());
    assert_eq!(std::fs::read(&path).unwrap(), encode(&episode).unwrap());
    assert_eq!(read_episode_log(&path).unwrap(), episode);

    std::fs::write(&path, b"no log\n").unwrap();
    let error = read_episode_log(&path).unwrap_err().to_string();
    assert!(
        error.contains("easy-0001.log") && error.contains("line 1: does not begin with a checksum"),
        "{error}"
    );
}

#[test]
fn what_no_log_can_hold_is_refused_and_the_log_goes_on() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.log");
    let episode = small();
    let mut log = EpisodeLog::create(&path, &episode.head, &episode.start).unwrap();
    let mut bad = episode.steps[0].clone();
    bad.instants[1].agents[0].as_mut().unwrap().yaw_rad = f64::NAN;
    let error = log.append(&bad).unwrap_err().to_string();
    assert!(
        error.contains("a.log")
            && error.contains("instant 1 of step 0 has a number that is not finite"),
        "{error}"
    );
    assert!(
        log.append(&episode.steps[1])
            .unwrap_err()
            .to_string()
            .contains("step 1; expected step 0")
    );
    episode
        .steps
        .iter()
        .for_each(|step| log.append(step).unwrap());
    log.finish(&episode.end).unwrap();
    assert_eq!(read_episode_log(&path).unwrap(), episode);

    let mut head = episode.head.clone();
    head.route_m[1].x = f64::INFINITY;
    let error = EpisodeLog::create(&directory.path().join("b.log"), &head, &episode.start)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("b.log") && error.contains("not finite"),
        "{error}"
    );
    assert_eq!(
        std::fs::read_dir(directory.path()).unwrap().count(),
        1,
        "nothing is begun that cannot be"
    );
}

#[test]
fn what_the_system_refuses_names_the_file() {
    let episode = small();
    let missing = std::path::Path::new("/nowhere/at/all/a.log");
    let error = EpisodeLog::create(missing, &episode.head, &episode.start)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("cannot write /nowhere/at/all/a.log.part"),
        "{error}"
    );
    // A directory stands where the log shall be.
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("taken.log");
    std::fs::create_dir_all(path.join("inside")).unwrap();
    let log = EpisodeLog::create(&path, &episode.head, &episode.start).unwrap();
    let error = log.finish(&episode.end).unwrap_err().to_string();
    assert!(
        error.contains("cannot write") && error.contains("taken.log"),
        "{error}"
    );
}

/// `/dev/full` takes no byte: a full disk without one.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told_and_nothing_gets_the_name() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("full.log");
    std::os::unix::fs::symlink("/dev/full", directory.path().join("full.log.part")).unwrap();
    let episode = small();
    let error = EpisodeLog::create(&path, &episode.head, &episode.start)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("full.log.part") && error.contains("No space left"),
        "{error}"
    );
    assert!(!path.exists());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn an_episode_reads_back_as_it_was_written(episode in episodes()) {
        let bytes = encode(&episode).unwrap();
        let back = decode(&bytes);
        prop_assert_eq!(back.as_ref(), Ok(&episode));
        // The same bytes: bits are equal where numbers are, minus zero included.
        prop_assert_eq!(encode(&back.unwrap()).unwrap(), bytes);
    }

    #[test]
    fn any_bytes_are_a_log_or_a_complaint(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(decode(&bytes).is_err());
    }

    /// Good checksums over any payload at all.
    #[test]
    fn any_records_are_a_log_or_a_complaint(payloads in prop::collection::vec("(\\{\"end\"|\\{\"step\":0|)[ -~]{0,40}", 1..4)) {
        let mut bytes = lines_of(&encode(&small()).unwrap()).swap_remove(0);
        for payload in payloads {
            let before: [u8; 16] = bytes[bytes.len() - lines_of(&bytes).pop().unwrap().len()..][..16].try_into().unwrap();
            bytes.extend(sealed(&before, &payload));
        }
        let _ = decode(&bytes);
    }
}
