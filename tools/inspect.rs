//! `decouplegs inspect`: what is in a splat file, a compressed asset or a scene.

mod scene;
mod summary;

use std::path::{Path, PathBuf};

use anyhow::Result;
use decouplegs_asset::{
    CodedAsset, CodedSummary, SceneFile, SplatFormat, SplatSummary, coded_asset, is_scene_file,
    open_scene, read_coded,
};
use serde_json::Value;

use crate::arguments::print;
use summary::{Lines, splats_to_text};

/// Describe a splat file, a compressed asset or a scene: counts, bounds, histograms, invalid splats
#[derive(clap::Args)]
pub struct Arguments {
    #[arg(help = format!(
        "Splats or a compressed asset ({}), or a scene (.toml, .usdz)",
        SplatFormat::EXTENSIONS
    ))]
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let (text, value) = describe(&arguments.file)?;
    if arguments.json {
        return print(&format!("{value:#}\n"));
    }
    print(&format!("{}\n{text}", arguments.file.display()))
}

/// The report on a file, as text and as JSON.
fn describe(path: &Path) -> Result<(String, Value)> {
    if coded_asset::has_extension(path) {
        let asset = read_coded(path)?;
        let summary = CodedSummary::new(&asset, std::fs::metadata(path)?.len());
        return Ok((
            asset_to_text(&asset, &summary),
            serde_json::to_value(&summary)?,
        ));
    }
    if !is_scene_file(path) {
        let loaded = open_scene(path, 0.0)?;
        loaded.check_baked()?;
        // Of a package the agents as well.
        let summary = if loaded.agents.is_empty() {
            SplatSummary::new(&loaded.splat_scene.splats)
        } else {
            SplatSummary::new(&loaded.baked(0.0).splats)
        };
        return Ok((splats_to_text(&summary), serde_json::to_value(&summary)?));
    }
    let file = SceneFile::read(path)?;
    let loaded = file.load(path.parent().unwrap_or(Path::new("")), 0.0)?;
    loaded.check_baked()?;
    let splat_scene = loaded.baked(0.0);
    let summary = SplatSummary::new(&splat_scene.splats);
    let scene = scene::Listing::new(&file, &loaded, &splat_scene);
    let mut value = serde_json::to_value(&summary)?;
    if let (Value::Object(value), Value::Object(scene)) = (&mut value, scene.to_json()) {
        value.extend(scene);
    }
    Ok((scene.to_text() + &splats_to_text(&summary), value))
}

fn asset_to_text(asset: &CodedAsset, summary: &CodedSummary) -> String {
    let mut lines = Lines::default();
    let levels: Vec<String> = summary.levels.iter().map(u64::to_string).collect();
    lines.line(
        "levels",
        &format!("{} splats, the finest first", levels.join(", ")),
    );
    lines.line(
        "codebooks",
        &format!(
            "{} shapes, {} colors of degree {}",
            summary.shapes, summary.colors, asset.cloud.sh_degree
        ),
    );
    let each = summary.bytes_per_splat.map_or_else(String::new, |bytes| {
        format!(", {bytes:.2} for each splat of any level")
    });
    lines.line("bytes", &format!("{}{each}", summary.file_bytes));
    let [length, width, height] = summary.dims_m;
    lines.line(
        "shows",
        &format!("{length:.3} x {width:.3} x {height:.3} m (length, width, height)"),
    );
    lines.line(
        "colors are",
        if summary.sh_frame == "world" {
            "in the world's frame"
        } else {
            "in its own frame (canonical)"
        },
    );
    let step_mm = summary
        .position_step_m
        .map(|step_m| format!("{:.3}", f64::from(step_m) * 1e3));
    lines.line("position steps", &format!("{} mm", step_mm.join(", ")));
    lines.line("made from", &summary.source);
    lines.line("its SHA-256", &summary.source_sha256);
    lines.line("made by", &format!("decouplegs {}", summary.tool_version));
    for (key, value) in &summary.settings {
        lines.line("", &format!("{key} = {value}"));
    }
    format!(
        "{}\n  level 0, as it is drawn\n{}",
        lines.into_text(),
        splats_to_text(&summary.finest)
    )
}
