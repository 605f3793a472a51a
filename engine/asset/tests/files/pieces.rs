//! Files of many splats, read piece by piece.

use decouplegs_asset::{inria_ply, read_splat_pieces, read_splats, spz};
use decouplegs_scene::SplatCloud;

use crate::sample::cloud;

/// Splats of degree 3 that make several pieces.
const SPLATS: usize = 150_000;

#[test]
fn pieces_together_are_the_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let all = cloud(SPLATS, 3);
    let ply = inria_ply::encode(&all);
    let packed = spz::encode(&all).unwrap();
    for (name, bytes, whole) in [
        ("many.ply", &ply, inria_ply::decode(&ply).unwrap()),
        ("many.spz", &packed, spz::decode(&packed).unwrap()),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let (mut together, mut pieces) = (SplatCloud::with_degree(3), 0);
        let is_whole = read_splat_pieces(&path, |total, piece| {
            assert_eq!(total, SPLATS, "{name}");
            assert!(piece.len() < SPLATS, "{name} came in one piece");
            together.append(&piece);
            pieces += 1;
            true
        });
        assert!(is_whole.unwrap(), "{name}");
        assert!(pieces >= 2, "{name}: {pieces} pieces");
        assert!(together == whole, "{name}: pieces differ from the whole");
        assert!(read_splats(&path).unwrap() == whole, "{name}");
        // Two pieces in each other's place are another cloud.
        let turned: Vec<u32> = (SPLATS as u32 / 2..SPLATS as u32)
            .chain(0..SPLATS as u32 / 2)
            .collect();
        assert!(together.select(&turned) != whole, "{name}");
    }
}

#[test]
fn reading_ends_where_it_is_told_to() {
    let folder = tempfile::tempdir().unwrap();
    let all = cloud(SPLATS, 3);
    for (name, bytes) in [
        ("many.ply", inria_ply::encode(&all)),
        ("many.spz", spz::encode(&all).unwrap()),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let mut pieces = 0;
        let is_whole = read_splat_pieces(&path, |_, _| {
            pieces += 1;
            false
        });
        assert!(!is_whole.unwrap(), "{name}");
        assert_eq!(pieces, 1, "{name}");
    }
}
