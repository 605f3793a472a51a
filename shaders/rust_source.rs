//! Interfaces of kernels as Rust: a table per kernel of what it takes, and one of the structures in
//! buffers, which are compared with those of the host.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use decouplegs_spirv::{Interface, Kind, Member, Record, Size, records, reflect};

/// First line of every file that is written.
const HEADER: &str = "// Written by `make shaders` from the SPIR-V. Changes here are lost.\n";

/// Paths in `folder` and contents of the Rust files for `modules`, each with its name.
///
/// # Errors
/// A sentence that names the module that cannot be read or has no Rust form, or that lays a
/// structure out in another way than the modules before it.
pub fn rust_files(
    modules: &[(String, Vec<u8>)],
    folder: &Path,
) -> Result<Vec<(PathBuf, Vec<u8>)>, String> {
    let (mut files, mut list, mut known) = (Vec::new(), HEADER.to_owned(), Vec::new());
    list += "\nmod records;\n\n";
    for (name, bytes) in modules {
        let (words, _) = bytes.as_chunks::<4>();
        let words: Vec<u32> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let refuse = |reason| format!("{name}.spv: {reason}");
        for record in records(&words).map_err(refuse)? {
            add_record(record, &mut known).map_err(refuse)?;
        }
        let interface = reflect(&words).map_err(refuse)?;
        let source = kernel_source(name, &interface).map_err(refuse)?;
        files.push((folder.join(format!("{name}.rs")), source.into_bytes()));
        line(&mut list, format_args!("pub mod {name};"));
    }
    known.sort_by(|a, b| a.name.cmp(&b.name));
    let records = records_source(&known).into_bytes();
    files.push((folder.join("records.rs"), records));
    files.push((folder.join("mod.rs"), list.into_bytes()));
    Ok(files)
}

/// Adds `record`, unless it is known.
fn add_record(record: Record, known: &mut Vec<Record>) -> Result<(), String> {
    match known.iter().find(|known| known.name == record.name) {
        None => known.push(record),
        Some(same) if *same == record => {}
        Some(other) => {
            return Err(format!(
                "expected structure {} as in the kernels before it, {other:?}, found {record:?}",
                record.name
            ));
        }
    }
    Ok(())
}

/// The table of one kernel.
fn kernel_source(name: &str, interface: &Interface) -> Result<String, String> {
    let mut text = HEADER.to_owned() + "\n";
    let held = interface.bindings.iter().map(|binding| &*binding.holds);
    let structures: BTreeSet<&str> = held
        .filter(|name| name.starts_with(char::is_uppercase))
        .collect();
    if !structures.is_empty() {
        let list: Vec<&str> = structures.into_iter().collect();
        line(
            &mut text,
            format_args!("use crate::interfaces::{{{}}};\n", list.join(", ")),
        );
    }
    line(&mut text, format_args!("decouplegs_gpu::shader! {{"));
    line(
        &mut text,
        format_args!(
            "    {name:?}, decouplegs_shaders::{}.spirv;",
            name.to_uppercase()
        ),
    );
    write_module(&mut text, interface);
    write_bindings(&mut text, interface);
    write_push(&mut text, interface);
    write_constants(&mut text, interface)?;
    text += "}\n";
    Ok(text)
}

fn write_module(text: &mut String, interface: &Interface) {
    let size = |size: &Size| format!("({}, {:?})", size.value, size.spec_id);
    let sizes: Vec<String> = interface.workgroup.iter().map(size).collect();
    line(
        text,
        format_args!("    entry_point: {:?};", interface.entry_point),
    );
    line(text, format_args!("    workgroup: [{}];", sizes.join(", ")));
    line(
        text,
        format_args!("    capabilities: {:?};", interface.capabilities),
    );
}

fn write_bindings(text: &mut String, interface: &Interface) {
    *text += "    bindings {\n";
    for found in interface.bindings.iter() {
        line(
            text,
            format_args!(
                "        {} {}: {}, {:?}, {:?};",
                found.number, found.name, found.holds, found.access, found.uniform_bytes
            ),
        );
    }
    *text += "    }\n";
}

fn write_push(text: &mut String, interface: &Interface) {
    line(text, format_args!("    push {} {{", interface.push_bytes));
    write_members(text, &interface.push);
    *text += "    }\n";
}

fn write_constants(text: &mut String, interface: &Interface) -> Result<(), String> {
    *text += "    constants {\n";
    for found in interface.constants.iter() {
        let kind = match found.kind {
            Kind::Bool => "bool",
            Kind::U32 => "u32",
            Kind::I32 => "i32",
            Kind::F32 => "f32",
            Kind::Other => {
                return Err(format!(
                    "expected constant {} to be a bool, int, uint or float, found another type",
                    found.name
                ));
            }
        };
        let field = found.name.to_lowercase();
        line(
            text,
            format_args!("        {} {} {field}: {kind};", found.spec_id, found.name),
        );
    }
    *text += "    }\n";
    Ok(())
}

/// The structures, each to be compared with the host's.
fn records_source(records: &[Record]) -> String {
    let mut text = HEADER.to_owned();
    text += "\nuse crate::interfaces::*;\n";
    for record in records {
        let (name, bytes) = (&record.name, record.bytes);
        line(
            &mut text,
            format_args!("\ndecouplegs_gpu::same_layout! {{\n    {name}, {bytes} {{"),
        );
        write_members(&mut text, &record.members);
        text += "    }\n}\n";
    }
    text
}

fn write_members(text: &mut String, members: &[Member]) {
    for member in members {
        let Member {
            name,
            holds,
            offset,
        } = member;
        line(text, format_args!("        {offset} {name}: {holds};"));
    }
}

fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    writeln!(text, "{content}").expect("writing to a string cannot fail");
}
