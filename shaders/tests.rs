//! Interfaces in `interfaces` are those of the modules in `spirv`.

mod rust_source;

use std::fs;
use std::path::Path;

use decouplegs_shaders::ALL;

/// The modules of the kernels, little endian.
fn modules() -> Vec<(String, Vec<u8>)> {
    let bytes = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let modules = ALL.iter();
    let mut modules: Vec<_> = modules
        .map(|kernel| (kernel.name.to_owned(), bytes(kernel.spirv)))
        .collect();
    modules.sort();
    modules
}

#[test]
fn interfaces_are_those_of_the_spirv() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("interfaces");
    let files = rust_source::rust_files(&modules(), &folder).unwrap();
    for (path, content) in &files {
        let found = fs::read(path).unwrap();
        assert!(found == *content, "{}: run `make shaders`", path.display());
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), files.len());
}

#[test]
fn a_structure_has_one_layout() {
    let mut modules = modules();
    let (_, cull) = modules.iter().find(|(name, _)| name == "cull").unwrap();
    let mut moved = cull.clone();
    // The offset of the second member of `Cluster`, 12, decorated: OpMemberDecorate, structure,
    // member 1, Offset.
    let (words, _) = cull.as_chunks::<4>();
    let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let records = decouplegs_spirv::records(&words).unwrap();
    assert!(records.iter().any(|record| record.name == "Cluster"));
    let is_offset =
        |at: &usize| words[*at] == 5 << 16 | 72 && words[*at + 2..*at + 5] == [1, 35, 12];
    let at = (0..words.len() - 5).find(is_offset).unwrap();
    moved[4 * (at + 4)] = 16;
    modules.push(("moved".into(), moved));
    let error = rust_source::rust_files(&modules, Path::new("")).unwrap_err();
    assert!(error.contains("moved.spv"), "{error}");
    assert!(error.contains("as in the kernels before it"), "{error}");
}
