//! Whatever the bytes: an error, or a map and tracks that hold together. The same holds of every
//! reader, so all read all.

use std::time::{Duration, Instant};

use decouplegs_asset::maps::{MapFormat, lane_json};
use decouplegs_asset::tracks::TrackFormat;
use decouplegs_asset::{maps, tracks};
use proptest::prelude::*;

use super::seed;

const MAP_FORMATS: [MapFormat; 5] = [
    MapFormat::OpenDrive,
    MapFormat::Lanelet2,
    MapFormat::Argoverse2,
    MapFormat::CommonRoad,
    MapFormat::LaneJson,
];
const TRACK_FORMATS: [TrackFormat; 3] =
    [TrackFormat::Csv, TrackFormat::Json, TrackFormat::CommonRoad];

const SEEDS: [&str; 7] = [
    "open_drive/crossing.xodr",
    "lanelet2/two.osm",
    "argoverse2/log_map_archive_two.json",
    "commonroad/2020a.xml",
    "lane_json/three.json",
    "track_table/two.csv",
    "track_table/two.json",
];

/// Values that are neither numbers, nor short, nor expected.
const POISON: [&str; 14] = [
    "NaN",
    "-inf",
    "1e308",
    "-1e308",
    "1e999",
    "0",
    "-1",
    "",
    "999999",
    "\u{0}",
    "&lt;",
    "9223372036854775808",
    "1e-320",
    "\"x\"",
];

/// Reads `bytes` as everything. Returns how many readers took them.
fn read_all(bytes: &[u8]) -> usize {
    let mut taken = 0;
    let _ = MapFormat::detect(bytes);
    for format in MAP_FORMATS {
        let Ok(map) = maps::decode(bytes, format) else {
            continue;
        };
        taken += 1;
        assert!(!map.lanes.is_empty() && map.check().is_ok());
        for (at, lane) in map.lanes.iter().enumerate() {
            assert!(
                lane.successors
                    .iter()
                    .all(|&next| map.lanes[next].predecessors.contains(&at))
            );
            assert!(
                lane.has_height
                    || lane
                        .centerline
                        .iter()
                        .chain(&lane.left)
                        .all(|point| point.z == 0.0)
            );
        }
        let written = lane_json::encode(&map).expect("a map that was read can be written");
        assert_eq!(
            lane_json::decode(&written).expect("what was written can be read"),
            map
        );
    }
    for format in TRACK_FORMATS {
        let Ok(tracks) = tracks::decode(bytes, format) else {
            continue;
        };
        taken += 1;
        assert!(!tracks.is_empty() && tracks.iter().all(|track| track.check().is_ok()));
    }
    taken
}

#[test]
fn every_seed_is_taken_by_its_reader() {
    for name in SEEDS {
        let expected = if name.starts_with("commonroad") { 2 } else { 1 };
        assert_eq!(read_all(&seed(name)), expected, "{name}");
    }
}

#[test]
fn every_cut_of_every_seed_is_survived() {
    for name in SEEDS {
        let bytes = seed(name);
        for end in 0..bytes.len() {
            read_all(&bytes[..end]);
        }
    }
}

#[test]
fn size_without_sense_costs_neither_stack_nor_time() {
    let deep_json = "[".repeat(300_000);
    let deep_xml = [
        "<OpenDRIVE>",
        "<osm>",
        "<commonRoad commonRoadVersion='2018b'>",
    ]
    .map(|root| root.to_owned() + &"<road>".repeat(200_000));
    let many_sections = format!(
        "<OpenDRIVE><road id='1'><planView><geometry s='0' x='0' y='0' hdg='0' length='9'><line/></geometry></planView>\
         <lanes>{}</lanes></road></OpenDRIVE>",
        (0..20_000)
            .map(|at| format!(
                "<laneSection s='{}'><right><lane id='-1'/></right></laneSection>",
                f64::from(at) * 4e-4
            ))
            .collect::<String>()
    );
    let linked = |count: u32| {
        let all: Vec<String> = (0..count).map(|id| id.to_string()).collect();
        let lane = |id: &String| {
            format!(
                "{{\"id\":{id},\"centerline\":[[0,0],[1,1]],\"successors\":[{}]}}",
                all.join(",")
            )
        };
        format!(
            "{{\"lanes\":[{}]}}",
            all.iter().map(lane).collect::<Vec<_>>().join(",")
        )
    };
    let ways = "<nd ref='1'/>".repeat(20_000);
    let shared_way: String = (0..2_000)
        .map(|id| {
            format!(
                "<relation id='{id}'><member type='way' role='left' ref='1'/>\
                 <member type='way' role='right' ref='1'/><tag k='type' v='lanelet'/></relation>"
            )
        })
        .collect();
    let lanelets =
        format!("<osm><node id='1' lat='1' lon='1'/><way id='1'>{ways}</way>{shared_way}</osm>");
    let endless_spiral = "<OpenDRIVE><road id='1'><planView><geometry s='0' x='0' y='0' hdg='0' length='9999'>\
        <spiral curvStart='0' curvEnd='0.003'/></geometry></planView><lanes><laneSection s='0'><right><lane id='-1'><width a='1'/>\
        </lane></right></laneSection></lanes></road></OpenDRIVE>";
    let cubic = endless_spiral.replace(
        "<spiral curvStart='0' curvEnd='0.003'/>",
        "<poly3 a='0' b='3' c='9e5' d='-1e9'/>",
    );
    let texts = [
        deep_json,
        many_sections,
        linked(600),
        lanelets,
        endless_spiral.to_owned(),
        cubic,
    ];
    for text in texts.iter().chain(&deep_xml) {
        let start = Instant::now();
        let taken = read_all(text.as_bytes());
        println!(
            "{} bytes, {taken} readers, {:?}",
            text.len(),
            start.elapsed()
        );
        assert!(
            start.elapsed() < Duration::from_secs(20),
            "{} took {:?}",
            &text[..60],
            start.elapsed()
        );
    }
}

/// Places in a text where a number or a quoted value stands, as ranges.
fn values(text: &str) -> Vec<std::ops::Range<usize>> {
    let part_of_a_value = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '+' | '_');
    let mut values = Vec::new();
    let mut start = None;
    for (at, c) in text.char_indices() {
        match (start, part_of_a_value(c)) {
            (None, true) => start = Some(at),
            (Some(from), false) => {
                values.push(from..at);
                start = None;
            }
            _ => {}
        }
    }
    values
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..400), first in prop::sample::select(vec!["", "<", "{", "[", "t,id,x,y\n"])) {
        read_all(&[first.as_bytes(), &bytes].concat());
    }

    #[test]
    fn seeds_with_poison_in_them_are_survived(
        name in prop::sample::select(SEEDS.to_vec()),
        changes in prop::collection::vec((any::<prop::sample::Index>(), prop::sample::select(POISON.to_vec())), 1..4),
    ) {
        let mut text = String::from_utf8(seed(name)).unwrap();
        for (place, poison) in changes {
            let values = values(&text);
            let range = values[place.index(values.len())].clone();
            text.replace_range(range, poison);
        }
        read_all(text.as_bytes());
    }

    #[test]
    fn seeds_with_bytes_changed_doubled_and_lost_are_survived(
        name in prop::sample::select(SEEDS.to_vec()),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4_u8), 1..6),
    ) {
        let mut bytes = seed(name);
        for (place, byte, how) in changes {
            let at = place.index(bytes.len());
            match how {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                2 => { bytes.remove(at); }
                _ => {
                    // A stretch again, so that ids and elements stand twice.
                    let end = bytes.len().min(at + 3 * usize::from(byte));
                    let stretch = bytes[at..end].to_vec();
                    bytes.splice(end..end, stretch);
                }
            }
        }
        read_all(&bytes);
    }
}
