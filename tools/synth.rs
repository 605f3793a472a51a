//! `decouplegs synth`: synthetic scenes of any size.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::{Subcommand, ValueEnum};
use decouplegs_asset::memory::{self, cloud_bytes};
use decouplegs_synth::street::{AssetLight, Capture, Street, StreetOptions, Weather};

use crate::arguments::{Size, print};
use crate::outputs::Force;
use crate::progress;
use crate::street_files::{Cars, Content, write_street};

/// Generate a scene and write it as files
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    scene: SyntheticScene,
}

#[derive(Subcommand)]
enum SyntheticScene {
    Street(StreetArguments),
}

/// The light over the street.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum WeatherName {
    /// A sunny afternoon
    Clear,
    /// Gray light from all of the sky, no cast shadows
    Overcast,
    /// A low, orange sun and long shadows
    Dusk,
    /// Street lamps and lit windows
    Night,
}

impl WeatherName {
    fn weather(self) -> Weather {
        match self {
            Self::Clear => Weather::Clear,
            Self::Overcast => Weather::Overcast,
            Self::Dusk => Weather::Dusk,
            Self::Night => Weather::Night,
        }
    }
}

/// A street with traffic and a vehicle of six cameras: scene.toml, background.ply, assets/*.ply,
/// transforms.json, lanes.json and tracks.csv (where each car truly is, ten times a second)
#[derive(clap::Args)]
struct StreetArguments {
    /// Splats of the street without its traffic
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 200_000
    )]
    background: usize,
    /// Cars that drive
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 10
    )]
    agents: usize,
    /// Splats of each car
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 10_000
    )]
    agent_splats: usize,
    /// Degree of the spherical harmonics
    #[arg(long, value_name = "DEGREE", allow_negative_numbers = true, default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: u8,
    /// Seed of all randomness: the same seed gives the same bytes
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// The light over the street
    #[arg(long, value_name = "WEATHER", value_enum, default_value = "clear")]
    weather: WeatherName,
    /// Capture the cars in even white light, without sun, sheen and shadow, for relighting
    #[arg(long)]
    neutral_assets: bool,
    /// Capture the street from all of its lanes instead of the ego's path, for free driving
    #[arg(long)]
    all_lanes: bool,
    /// Size of the cameras' images
    #[arg(
        long,
        value_name = "WxH",
        allow_hyphen_values = true,
        default_value = "1600x900"
    )]
    size: Size,
    /// Compress the cars (.safetensors), so that they move when the scene is played, at some loss.
    /// Plain cars (.ply) stand still in one frame, without loss
    #[arg(long)]
    movable: bool,
    /// Let the cars throw shadows on the road, under the sun or the street lamps of the weather:
    /// a [light] table. Best with --neutral-assets, since other cars show the dark below them
    #[arg(long)]
    shadows: bool,
    /// Light the cars by the normals of their splats, as the road shows the light of the weather,
    /// and let them throw shadows. Best with --neutral-assets and --movable
    #[arg(long)]
    by_normals: bool,
    /// Write world.ply too: street and cars as one cloud of splats, for programs without agents
    #[arg(long)]
    baked: bool,
    /// Folder for the files; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    force: Force,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let SyntheticScene::Street(arguments) = &arguments.scene;
    arguments.force.outputs(&[]).folder(&arguments.out)?;
    check_size(arguments)?;
    let working = progress::spinner(format!("{} splats", arguments.background));
    let mut street = Street::generate(&StreetOptions {
        background: arguments.background,
        agents: arguments.agents,
        agent_splats: arguments.agent_splats,
        sh_degree: arguments.degree,
        seed: arguments.seed,
        weather: arguments.weather.weather(),
        asset_light: if arguments.neutral_assets {
            AssetLight::Neutral
        } else {
            AssetLight::Sun
        },
        capture: if arguments.all_lanes {
            Capture::Lanes
        } else {
            Capture::Ego
        },
    });
    for camera in street.rig.cameras_mut() {
        camera.intrinsics = camera
            .intrinsics
            .resized(arguments.size.width_px, arguments.size.height_px);
    }
    working.set_message(format!("writing {}", arguments.out.display()));
    let cars = match arguments.movable {
        true => Cars::Compressed,
        false => Cars::Plain,
    };
    let content = Content {
        cars,
        baked: arguments.baked,
        shadows: arguments.shadows,
        by_normals: arguments.by_normals,
    };
    write_street(&street, &arguments.out, content)?;
    working.finish_and_clear();
    let out = arguments.out.display();
    let mut text = format!(
        "{out}/scene.toml: {} splats, {} cars of {} kinds, {} cameras\n",
        street.background.len(),
        street.agents.len(),
        street.assets.len(),
        street.rig.sensors.len()
    );
    text += &format!(
        "  beside it: background.ply, assets/*.{}, transforms.json, lanes.json, tracks.csv{}\n",
        cars.extension(),
        if arguments.baked { ", world.ply" } else { "" }
    );
    text += &format!("  draw it:   decouplegs render {out}/scene.toml --out images\n");
    text += &format!("  view it:   decouplegs view {out}/scene.toml\n");
    text += &format!(
        "  drive it:  decouplegs drive --level easy --planner lane-follow --scene {out}/scene.toml --map {out}/lanes.json --out run\n"
    );
    print(&text)
}

/// Refuses what the memory cannot hold, before anything is made.
fn check_size(arguments: &StreetArguments) -> Result<()> {
    ensure!(
        arguments.agents <= usize::from(u16::MAX),
        "--agents {}: a scene has at most {} agents",
        arguments.agents,
        u16::MAX
    );
    // As many different cars as agents, at most.
    let cars = (arguments.agents as u64).saturating_mul(arguments.agent_splats as u64);
    let splats = (arguments.background as u64).saturating_add(cars);
    // Twice: the street is sorted into a copy.
    memory::require(
        "this street",
        cloud_bytes(splats, arguments.degree).saturating_mul(2),
    )
    .map_err(anyhow::Error::msg)
}
