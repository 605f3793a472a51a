//! One HTML file that shows a scene in a browser, without a viewer and without a network.
//!
//! The file holds the page `page/one_file.html`, its modules as an import map of `data:` addresses,
//! the facts of the scene as JSON, and the splats as [`crate::splat_stream`] writes them, in pieces
//! of base64. What moves is sampled at equal steps, each sample 7 f32 in base64: a position
//! relative to the origin of the scene, meters, and a quaternion x, y, z, w.

mod tracks;

use std::fmt;
use std::io::{self, Write};
use std::path::Path;

use anyhow::{Result, ensure};
use base64::{Engine, engine::general_purpose::STANDARD};
use decouplegs::asset::{LoadedScene, write_atomically};
use decouplegs_cli::page::escaped;
use decouplegs_cli::progress;
use serde_json::{Value, json};

use self::tracks::Samples;
use crate::page_files::{ONE_FILE, PAGE, SORTER, modules};
use crate::source::Source;

/// Bytes that are written as one element: 1 MiB of base64, with no padding between them.
const PIECE_BYTES: usize = 768 << 10;
/// Byte of a chunk at which the number of splats of the whole stream stands.
const STREAM_COUNT_AT: usize = 16;

/// Facts of a page that was written.
pub struct Exported {
    /// Splats in the page.
    pub kept: usize,
    /// Splats of the scene.
    pub all: usize,
    /// Agents that move.
    pub moving: usize,
    /// First and last time, seconds.
    pub span_s: [f64; 2],
    /// Poses of each track per second; 0 where nothing moves.
    pub poses_per_s: f64,
    /// Size of the file.
    pub bytes: u64,
}

impl fmt::Display for Exported {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} of {} splats, ", self.kept, self.all)?;
        if self.poses_per_s > 0.0 {
            let [start_s, end_s] = self.span_s;
            let (duration_s, moving) = (end_s - start_s, self.moving);
            let (plural, per_s) = (if moving == 1 { "" } else { "s" }, self.poses_per_s);
            write!(
                out,
                "{moving} moving agent{plural}, {duration_s:.1} s at {per_s:.1} poses per second, "
            )?;
        }
        write!(out, "{:.1} MB", self.bytes as f64 / 1e6)
    }
}

/// Writes the page of `source`, with at most `splats_max` of its splats, to `path`.
///
/// # Errors
/// Returns an error if there is nothing to draw, or the file cannot be written.
pub fn export(source: &mut Source, path: &Path, splats_max: usize) -> Result<Exported> {
    let working = progress::spinner(format!("writing {}", path.display()));
    let splats = source.splats(splats_max);
    let kept = splats.get(STREAM_COUNT_AT..STREAM_COUNT_AT + 4);
    let kept = kept.map_or(0, |bytes| {
        bytes
            .iter()
            .rev()
            .fold(0, |sum, &byte| 256 * sum + usize::from(byte))
    });
    let loaded = source.loaded();
    let all = loaded.splat_scene.splats.len();
    let all = all
        + loaded
            .assets
            .iter()
            .map(|asset| asset.levels[0])
            .sum::<usize>();
    ensure!(
        kept > 0,
        "the scene has no splat that can be seen: there is nothing to write"
    );
    let first_s = source.time_s();
    let samples = Samples::take(source);
    let mut facts = facts(source, &samples, [kept, all]);
    if first_s > source.span_s()[0] {
        facts["first_s"] = first_s.into();
    }
    let mut bytes = 0;
    write_atomically(path, |file| {
        let mut counted = Counted(file, 0);
        write_page(&mut counted, &facts, &splats)?;
        bytes = counted.1;
        Ok(())
    })?;
    working.finish_and_clear();
    Ok(Exported {
        kept,
        all,
        moving: samples.moving(),
        span_s: source.span_s(),
        poses_per_s: samples.per_s(),
        bytes,
    })
}

/// A writer that counts its bytes.
struct Counted<W>(W, u64);

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.0.write(bytes)?;
        self.1 += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Facts of the scene for the page: those that the viewer tells it, with `samples` of what moves.
fn facts(source: &Source, samples: &Samples, [kept, all]: [usize; 2]) -> Value {
    let mut facts = source.facts();
    let loaded = source.loaded();
    let title = facts["title"].as_str().unwrap_or_default();
    let title = std::path::absolute(title).unwrap_or_else(|_| title.into());
    facts["title"] = name_of(&title).into();
    facts["lidars"] = json!([]);
    facts["cameras"] = samples.cameras();
    facts["span_s"] = json!(source.span_s());
    facts["tracks"] = samples.tracks(loaded.splat_scene.origin);
    facts["splats"] = json!({"kept": kept, "all": all});
    facts["missing"] = json!(missing(source));
    facts["version"] = env!("CARGO_PKG_VERSION").into();
    facts
}

/// Name for people of the scene at `path`: no folders of this machine, but that of a file which has
/// the name of all scene files.
fn name_of(path: &Path) -> String {
    let part = |path: &Path| {
        let name = path.file_name()?;
        Some(name.to_string_lossy().into_owned())
    };
    let name = part(path).unwrap_or_default();
    match path.parent().and_then(part) {
        Some(folder) if name == "scene.toml" => folder,
        _ => name,
    }
}

/// Parts of the images of the scene that the page does not draw, for people.
fn missing(source: &Source) -> Vec<String> {
    let loaded = source.loaded();
    let LoadedScene {
        splat_scene,
        assets,
        light,
        plain_agents,
        ..
    } = loaded;
    let degrees = assets.iter().map(|asset| asset.sh_degree);
    let degree = degrees.fold(splat_scene.splats.sh_degree, u8::max);
    let mut missing = Vec::new();
    if degree > 0 {
        missing.push(format!(
            "colors that change with the direction: those of degree 0 are drawn, of degree {degree}"
        ));
    }
    if !plain_agents.is_empty() {
        missing.push("the motion of agents that are plain splats: they stand still".into());
    }
    if light.is_some() {
        missing.push("light on agents, and their shadows".into());
    }
    if splat_scene.fog.is_some() {
        missing.push("fog".into());
    }
    if splat_scene.sky_map.is_some() {
        missing.push("the sky's colors by direction: it has their mean".into());
    }
    let mut cameras = source.cameras().iter();
    if cameras.any(|camera| !camera.intrinsics.is_pinhole()) {
        missing.push("lenses: their cameras are drawn as pinholes".into());
    }
    missing
}

/// `json` as the text of a script element.
fn script_json(json: &Value) -> String {
    json.to_string().replace('<', "\\u003c")
}

fn write_page(file: &mut impl Write, facts: &Value, splats: &[u8]) -> io::Result<()> {
    let address = |text: &str| {
        let text = STANDARD.encode(text);
        format!("data:text/javascript;charset=utf-8;base64,{text}")
    };
    // Modules of a `data:` address have no folder: they import each other by bare names.
    let modules = modules();
    let imports =
        modules.map(|(name, text)| (name, address(&text.replace("from \"./", "from \""))));
    let imports: serde_json::Map<String, Value> = imports
        .map(|(name, address)| (name.to_owned(), address.into()))
        .collect();
    let style = PAGE.iter().find(|(name, ..)| *name == "style.css");
    let style = style.map_or("", |(_, _, text)| text);
    let title = facts["title"].as_str().unwrap_or_default();
    let mut rest = ONE_FILE;
    let parts = [
        ("{title}", escaped(title)),
        ("{style}", style.to_owned()),
        ("{imports}", script_json(&json!({"imports": imports}))),
        ("{sorter}", SORTER.to_owned()),
        ("{scene}", script_json(facts)),
    ];
    for (mark, text) in parts {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        file.write_all(before.as_bytes())?;
        file.write_all(text.as_bytes())?;
        rest = after;
    }
    let (before, after) = rest.split_once("{splats}").unwrap_or((rest, ""));
    file.write_all(before.as_bytes())?;
    for piece in splats.chunks(PIECE_BYTES) {
        let piece = STANDARD.encode(piece);
        writeln!(
            file,
            "<script type=\"text/plain\" class=\"splats\">{piece}</script>"
        )?;
    }
    file.write_all(after.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_no_folders_of_the_machine() {
        for (title, name) in [
            ("/somewhere/garden.ply", "garden.ply"),
            ("garden.ply", "garden.ply"),
            ("/somewhere/street/scene.toml", "street"),
            ("scene.toml", "scene.toml"),
            ("run/hard_0001.log", "hard_0001.log"),
        ] {
            assert_eq!(name_of(Path::new(title)), name);
        }
    }

    #[test]
    fn the_page_is_one_file_whose_marks_are_all_replaced() {
        let facts = json!({"title": "a <b> & </script>", "tracks": null});
        let mut page = Vec::new();
        write_page(&mut page, &facts, &[7; 3 * PIECE_BYTES / 2]).unwrap();
        let page = String::from_utf8(page).unwrap();
        assert!(page.contains("<title>a &lt;b&gt; &amp; &lt;/script&gt; –"));
        for mark in [
            "{title}",
            "{style}",
            "{imports}",
            "{sorter}",
            "{scene}",
            "{splats}",
        ] {
            assert!(ONE_FILE.contains(mark) && !page.contains(mark), "{mark}");
        }
        assert_eq!(page.matches("class=\"splats\"").count(), 2);
        // As many ends of scripts as begins: no text ends one early.
        assert_eq!(
            page.matches("<script").count(),
            page.matches("</script>").count()
        );
        assert!(!page.contains(" src=") && !page.contains("<link rel=\"stylesheet\""));
    }

    #[test]
    fn modules_import_modules_of_the_page_alone() {
        let names: Vec<&str> = modules().map(|(name, _)| name).collect();
        for (name, text) in modules() {
            for part in text.split("from \"").skip(1) {
                let import = part.split('"').next().unwrap_or_default();
                let known = import.strip_prefix("./").filter(|one| names.contains(one));
                assert!(known.is_some(), "{name} imports {import}");
            }
            assert!(!text.contains("import("), "{name}");
        }
        assert!(names.contains(&"one_file.js") && !SORTER.contains("import "));
    }
}
