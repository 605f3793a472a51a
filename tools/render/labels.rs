//! Planes of labels: a value of each pixel by the agent that it shows.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use decouplegs_asset::write_atomically;
use decouplegs_render::rendered_image::Image;
use decouplegs_render::{Plane, PlaneValues};
use decouplegs_scene::Motion;

use crate::scene_source::DrawInput;

/// Class of the background, the first of all.
const BACKGROUND: &str = "background";

/// Class of agents whose class no file tells.
const UNKNOWN: &str = "unknown";

/// A plane that is written beside an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WrittenPlane {
    /// A plane of the renderer.
    Rendered(Plane),
    /// Class of the instance: its place in `classes.json`.
    Class,
    /// 1 where the instance moves, 0 elsewhere.
    Moving,
}

impl WrittenPlane {
    /// Name in options and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rendered(plane) => plane.name(),
            Self::Class => "class",
            Self::Moving => "moving",
        }
    }

    /// The plane of the renderer that it is made of.
    pub fn rendered(self) -> Plane {
        match self {
            Self::Rendered(plane) => plane,
            Self::Class | Self::Moving => Plane::Instance,
        }
    }

    /// Parser of names.
    pub fn parser() -> impl TypedValueParser<Value = Self> {
        let rendered = Plane::ALL.map(Self::Rendered).into_iter();
        let all: Vec<Self> = rendered.chain([Self::Class, Self::Moving]).collect();
        let names = PossibleValuesParser::new(all.iter().map(|plane| plane.name()));
        names.map(move |name| {
            let named = all.iter().find(|plane| plane.name() == name);
            *named.expect("it is one of the names")
        })
    }
}

/// Labels of the agents of a scene at its time, by instance; the background is 0.
pub struct Labels {
    /// Names of classes: the background, and those of agents in the order of the alphabet.
    classes: Vec<String>,
    /// Place of the class of each instance.
    class_of: Vec<u16>,
    /// 1 for instances that move.
    moves: Vec<u16>,
}

impl Labels {
    pub fn new(input: &DrawInput) -> Self {
        let loaded = &input.loaded;
        let classes_of = || {
            let labels = loaded.agent_labels.iter();
            labels.map(|label| label.class.as_deref().unwrap_or(UNKNOWN))
        };
        let distinct: BTreeSet<&str> = classes_of().filter(|class| *class != BACKGROUND).collect();
        let classes: Vec<&str> = std::iter::once(BACKGROUND).chain(distinct).collect();
        let places: BTreeMap<&str, u16> = classes.iter().copied().zip(0..).collect();
        let mut moves = vec![0; loaded.agent_labels.len() + 1];
        let mut set = |instance: u16, motion: Motion| {
            moves[usize::from(instance)] = u16::from(!motion.is_rest());
        };
        for plain in &loaded.plain_agents {
            set(plain.instance, plain.motion);
        }
        for agent in &loaded.agents {
            set(agent.instance, agent.trajectory.motion_at(input.time_s));
        }
        Self {
            class_of: std::iter::once(0)
                .chain(classes_of().map(|class| places[class]))
                .collect(),
            classes: classes.into_iter().map(str::to_owned).collect(),
            moves,
        }
    }

    /// Class of `instance`.
    pub fn class(&self, instance: usize) -> &str {
        &self.classes[usize::from(self.class_of[instance])]
    }

    /// True if `instance` moves.
    pub fn moves(&self, instance: usize) -> bool {
        self.moves[instance] != 0
    }

    /// `image` with `plane` in the place of instances. Planes of the renderer stay.
    pub fn applied<'a>(&self, image: &'a Image, plane: WrittenPlane) -> Cow<'a, Image> {
        let labels = match plane {
            WrittenPlane::Rendered(_) => return Cow::Borrowed(image),
            WrittenPlane::Class => &self.class_of,
            WrittenPlane::Moving => &self.moves,
        };
        let mut labeled = image.clone();
        if let Some(PlaneValues::U16(instances)) = labeled.planes.get_mut(&Plane::Instance) {
            for instance in instances {
                *instance = labels[usize::from(*instance)];
            }
        }
        Cow::Owned(labeled)
    }

    /// Writes the names of classes to `classes.json` in `folder`; returns its path.
    pub fn write(&self, folder: &Path) -> Result<PathBuf> {
        let path = folder.join("classes.json");
        let text = serde_json::to_string_pretty(&self.classes)?;
        write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        Ok(path)
    }
}
