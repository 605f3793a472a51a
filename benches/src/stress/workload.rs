//! Test scene: a background, original and compressed assets, and agents that use them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::{
    LoadedAgent, LoadedScene, SceneFile, coded_asset, is_scene_file, read_coded, read_splats,
};
use decouplegs::gpu::Gpu;
use decouplegs::scene::{
    CodedCloud, Presence, ShFrame, SplatCloud, SplatScene, TimedPose, Trajectory,
};
use decouplegs::synth::street::{Street, StreetOptions};
use decouplegs::train::compress::{CompressOptions, Progress, Prune, compress};
use serde_json::{Value, json};

use super::mode::Coding;
use crate::{progress, views, visibility};

/// Side of the views from which the visibility of an asset's splats is measured, pixels: as
/// `compress` by default.
const VIEW_SIZE_PX: u32 = 256;

/// An asset in its own frame.
struct Asset {
    name: String,
    /// Original splats in spatial order.
    original: SplatCloud,
    /// Compressed asset, if it came compressed: then the original is its decoded form.
    stored: Option<CodedCloud>,
}

/// A scene whose agents can be drawn compressed and as they were.
pub struct Workload {
    /// Background, rig and ego; assets and agents are those that were staged last.
    staged: LoadedScene,
    assets: Vec<Asset>,
    /// All agents, of which the first are drawn, as many as a point asks for.
    agents: Vec<LoadedAgent>,
    /// Compressed assets of each coding.
    codings: Vec<(Coding, Vec<CodedCloud>)>,
    /// Source of the scene, for the report.
    source: Value,
}

/// A generated street.
pub struct StreetWish {
    pub background: usize,
    pub agents: usize,
    pub agent_splats: usize,
    pub assets: usize,
    pub sh_degree: u8,
    pub seed: u64,
}

impl Workload {
    /// The scene file at `path`, whose agents may be plain splats or compressed.
    pub fn open(path: &Path) -> Result<Self> {
        ensure!(
            is_scene_file(path),
            "{}: expected a scene file (.toml), which has agents",
            path.display()
        );
        let mut file = SceneFile::read(path)?;
        let directory = path.parent().unwrap_or(Path::new("")).to_owned();
        let listed = std::mem::take(&mut file.agents);
        let staged = file.load(&directory, 0.0)?;
        let (mut assets, mut places, mut agents) =
            (Vec::new(), HashMap::<PathBuf, usize>::new(), Vec::new());
        for agent in listed {
            let place = match places.get(&agent.asset) {
                Some(&place) => place,
                None => {
                    assets.push(Asset::read(&directory, &agent.asset)?);
                    places.insert(agent.asset, assets.len() - 1);
                    assets.len() - 1
                }
            };
            let own_frame = assets[place]
                .stored
                .as_ref()
                .map_or(ShFrame::Canonical, |stored| stored.sh_frame);
            agents.push(LoadedAgent {
                name: agent.name,
                asset: place,
                instance: u16::try_from(agents.len() + 1)
                    .context("there are more than 65535 agents")?,
                sh_frame: agent.sh_frame.unwrap_or(own_frame),
                trajectory: agent.trajectory,
                // The report counts agents: all of them are drawn at all times.
                present: Presence::ALWAYS,
            });
        }
        let source = json!({ "scene": path.display().to_string() });
        Ok(Self {
            staged,
            assets,
            agents,
            codings: Vec::new(),
            source,
        })
    }

    /// A street with as many agents as `wish` says.
    pub fn street(wish: &StreetWish) -> Result<Self> {
        let working = progress::spinner(format!("a street of {} splats", wish.background));
        let options = StreetOptions {
            background: wish.background,
            agents: wish.agents,
            agent_splats: wish.agent_splats,
            sh_degree: wish.sh_degree,
            seed: wish.seed,
            ..StreetOptions::default()
        };
        let mut street = Street::generate(&options);
        let mut clouds = std::mem::take(&mut street.assets);
        // A street has at most twelve cars; more come from streets of other seeds, each car other
        // splats of the same kind.
        let mut seed = wish.seed;
        while clouds.len() < wish.assets.min(wish.agents) {
            seed = seed.wrapping_add(1 << 32);
            let more = StreetOptions {
                background: 1,
                agents: wish.assets - clouds.len(),
                seed,
                ..options
            };
            clouds.extend(Street::generate(&more).assets);
        }
        clouds.truncate(wish.assets);
        let agents = street
            .agents
            .iter()
            .zip(&street.agent_trajectories)
            .enumerate()
            .map(|(at, (agent, way))| {
                Ok(LoadedAgent {
                    name: agent.name.clone(),
                    asset: at % clouds.len(),
                    instance: u16::try_from(at + 1).context("there are more than 65535 agents")?,
                    sh_frame: agent.sh_frame,
                    trajectory: trajectory(way)?,
                    present: Presence::ALWAYS,
                })
            });
        let agents = agents.collect::<Result<Vec<_>>>()?;
        let splat_scene = SplatScene {
            sky: street.sky,
            ..SplatScene::from_splats(street.background.in_spatial_order())
        };
        let staged = LoadedScene {
            rig: street.rig.clone(),
            ego: trajectory(&street.ego)?,
            ..LoadedScene::of_world(splat_scene)
        };
        let named = |(at, cloud): (usize, &SplatCloud)| Asset {
            name: format!("car {at}"),
            original: cloud.in_spatial_order(),
            stored: None,
        };
        let assets = clouds.iter().enumerate().map(named).collect();
        working.finish_and_clear();
        let source = json!({ "synth": {
            "background": wish.background, "agent_splats": wish.agent_splats, "assets": wish.assets,
            "degree": wish.sh_degree, "seed": wish.seed,
        } });
        Ok(Self {
            staged,
            assets,
            agents,
            codings: Vec::new(),
            source,
        })
    }

    pub fn source(&self) -> &Value {
        &self.source
    }

    pub fn agents(&self) -> usize {
        self.agents.len()
    }

    /// Background, rig and ego.
    pub fn background(&self) -> &LoadedScene {
        &self.staged
    }

    pub fn background_mut(&mut self) -> &mut LoadedScene {
        &mut self.staged
    }

    /// Splats of the original and of the asset compressed by the defaults, where it was, by asset.
    pub fn asset_splats(&self) -> Vec<(String, usize, Option<usize>)> {
        let coded = self
            .codings
            .iter()
            .find(|(coding, _)| *coding == Coding::default())
            .map(|(_, coded)| coded);
        let of = |(at, asset): (usize, &Asset)| {
            (
                asset.name.clone(),
                asset.original.len(),
                coded.map(|coded| coded[at].levels[0]),
            )
        };
        self.assets.iter().enumerate().map(of).collect()
    }

    /// True if originals are known beside the decoded assets.
    pub fn has_originals(&self) -> bool {
        self.assets.iter().all(|asset| asset.stored.is_none())
    }

    /// Distinct assets that the first `count` agents show.
    pub fn unique_assets(&self, count: usize) -> usize {
        self.places(count).iter().flatten().count()
    }

    /// Place of each asset among those that the first `count` agents show; `None` for an asset that
    /// none shows.
    fn places(&self, count: usize) -> Vec<Option<usize>> {
        let (mut places, mut next) = (vec![None; self.assets.len()], 0);
        for agent in &self.agents[..count] {
            if places[agent.asset].is_none() {
                places[agent.asset] = Some(next);
                next += 1;
            }
        }
        places
    }

    /// Compresses all assets by `coding`, those that came compressed excepted; what was done before
    /// is kept.
    pub fn code(&mut self, gpu: &Gpu, coding: Coding, views: u32, seed: u64) -> Result<()> {
        if self.codings.iter().any(|(known, _)| *known == coding) {
            return Ok(());
        }
        let mut coded = Vec::new();
        for (at, asset) in self.assets.iter().enumerate() {
            coded.push(match &asset.stored {
                Some(stored) if coding == Coding::default() => stored.clone(),
                Some(_) => bail!(
                    "{}: is compressed already, so it cannot be compressed otherwise: leave out modes keep and colors, or name a \
                     scene of plain splats",
                    asset.name
                ),
                None => {
                    let working = format!("compressing {} ({} of {})", asset.name, at + 1, self.assets.len());
                    let failed = || format!("{} cannot be compressed", asset.name);
                    asset.coded(gpu, coding, views, seed, working).with_context(failed)?
                }
            });
        }
        self.codings.push((coding, coded));
        Ok(())
    }

    /// The scene with its first `count` agents and the assets that they show, compressed by
    /// `coding`, which was made before.
    pub fn staged(&mut self, count: usize, coding: Coding) -> &LoadedScene {
        let places = self.places(count);
        let coded = self
            .codings
            .iter()
            .find(|(known, _)| *known == coding)
            .map_or(&[][..], |(_, coded)| coded.as_slice());
        let mut shown: Vec<(usize, &CodedCloud)> = places
            .iter()
            .zip(coded)
            .filter_map(|(place, cloud)| Some(((*place)?, cloud)))
            .collect();
        shown.sort_by_key(|(place, _)| *place);
        self.staged.assets = shown.into_iter().map(|(_, cloud)| cloud.clone()).collect();
        let placed = |agent: &LoadedAgent| {
            Some(LoadedAgent {
                asset: places[agent.asset]?,
                ..agent.clone()
            })
        };
        self.staged.agents = self.agents[..count].iter().filter_map(placed).collect();
        &self.staged
    }

    /// Background and originals of the first `count` agents where they are at `time_s`, one cloud.
    pub fn copies(&self, count: usize, time_s: f64) -> SplatScene {
        let mut splat_scene = self.staged.splat_scene.clone();
        for agent in &self.agents[..count] {
            let pose = agent.trajectory.at(time_s);
            splat_scene.bake_instance(
                &self.assets[agent.asset].original,
                &pose,
                agent.sh_frame,
                agent.instance,
            );
        }
        splat_scene
    }
}

impl Asset {
    fn read(directory: &Path, file: &Path) -> Result<Self> {
        let (path, name) = (directory.join(file), file.display().to_string());
        if coded_asset::has_extension(&path) {
            let stored = read_coded(&path)?.cloud;
            return Ok(Self {
                name,
                original: stored.decoded(0),
                stored: Some(stored),
            });
        }
        let cloud = read_splats(&path)?;
        Ok(Self {
            name,
            original: cloud.in_spatial_order(),
            stored: None,
        })
    }

    fn coded(
        &self,
        gpu: &Gpu,
        coding: Coding,
        views: u32,
        seed: u64,
        working: String,
    ) -> Result<CodedCloud> {
        // The box of what can be drawn: a mean that is NaN has no place in it.
        let drawn: Vec<u32> = (0..self.original.len() as u32)
            .filter(|&splat| self.original.defect_of(splat as usize).is_none())
            .collect();
        ensure!(!drawn.is_empty(), "it has no splat that can be drawn");
        let cameras = views::sphere(
            &self.original.select(&drawn).bounds(),
            views as usize,
            VIEW_SIZE_PX,
            0.0,
        );
        let visibility = visibility::visibility(gpu, &self.original, &cameras)?;
        let defaults = CompressOptions::default();
        let options = CompressOptions {
            prune: coding.keep.map_or(defaults.prune, Prune::KeepRatio),
            colors: coding.colors.unwrap_or(defaults.colors),
            shapes: coding.colors.map_or(defaults.shapes, |colors| colors / 2),
            seed,
            ..defaults
        };
        let spinner = progress::spinner(working.clone());
        let compressed = compress(
            &self.original,
            &visibility,
            &options,
            &|progress| match progress {
                Progress::Pruning | Progress::Coding => spinner.set_message(working.clone()),
                Progress::Shapes(done) => {
                    spinner.set_message(format!("{working}, shapes: iteration {done}"));
                }
                Progress::Colors(done) => {
                    spinner.set_message(format!("{working}, colors: iteration {done}"));
                }
            },
        );
        spinner.finish_and_clear();
        Ok(compressed?.cloud)
    }
}

fn trajectory(knots: &[(f64, decouplegs::scene::Pose)]) -> Result<Trajectory> {
    let poses = knots
        .iter()
        .map(|&(time_s, pose)| TimedPose { time_s, pose })
        .collect();
    Trajectory::new(poses).map_err(anyhow::Error::msg)
}
