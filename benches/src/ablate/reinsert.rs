//! Cars put back where true ones stood, in several ways, and how far each is from the truth.

use anyhow::{Result, ensure};
use decouplegs::asset::{LoadedAgent, LoadedScene};
use decouplegs::gpu::Gpu;
use decouplegs::render::metrics::{MaskedDifference, MaskedErrors};
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, Image, Outputs, Plane, RenderOptions, Renderer,
};
use decouplegs::scene::light::{Lighting, LitAgent, ShadowOptions, bake_shadows};
use decouplegs::scene::{AmbientDescriptor, Camera, GroundShadow, ShFrame, SplatScene};
use decouplegs::synth::street::Weather;
use decouplegs::{Session, SessionOptions, World};

use super::affine;
use super::cars::Cars;
use super::example_crops::{self, ExampleCrops};
use super::reinsertion_street::{ReinsertionStreet, Truth};
use super::ring::{self, Darkness};

/// A way to put cars back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arm {
    NoRelighting,
    Transfer,
    Ours,
    ContactShadows,
    OursUnshadowed,
    OursUncompressed,
    BestAffine,
    TruthCompressed,
}

impl Arm {
    pub const ALL: [Self; 8] = [
        Self::NoRelighting,
        Self::Transfer,
        Self::Ours,
        Self::ContactShadows,
        Self::OursUnshadowed,
        Self::OursUncompressed,
        Self::BestAffine,
        Self::TruthCompressed,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::NoRelighting => "no relighting",
            Self::Transfer => "light transfer",
            Self::Ours => "ours",
            Self::ContactShadows => "ours, contact shadows",
            Self::OursUnshadowed => "ours, no shadows",
            Self::OursUncompressed => "ours, uncompressed",
            Self::BestAffine => "best affine on DC",
            Self::TruthCompressed => "truth colors, compressed",
        }
    }

    /// Description for the reader of a report.
    pub fn what(self) -> &'static str {
        match self {
            Self::NoRelighting => {
                "compressed cars as they were captured in neutral light, no shadows"
            }
            Self::Transfer => {
                "the paper's method: one factor and summand per coefficient for a whole car, from the mean colors of the street \
                 about it; shadows as in the next row"
            }
            Self::Ours => {
                "compressed cars, each splat lit by its normal: sky, ground, and the sun or the street lamps, whose positions the \
                 scene gives and whose colors the road tells; with contact shadows and cast ones"
            }
            Self::ContactShadows => {
                "ours with contact shadows only, as if the scene gave them neither sun nor lamps"
            }
            Self::OursUnshadowed => "ours without any shadows",
            Self::OursUncompressed => {
                "ours with every splat of the captured cars: what compression adds to the error"
            }
            Self::BestAffine => {
                "no method, for only the truth tells it: whole cars whose DC terms take the factor and the summand for each channel \
                 that come nearest to the true ones over all of the car; what bands above DC would change is left"
            }
            Self::TruthCompressed => {
                "no method, but what compression alone costs: cars in their true colors, compressed, on a street without shadows"
            }
        }
    }
}

/// Comparison data for the images of one moment.
pub struct Sample {
    pub time_s: f64,
    pub cameras: Vec<Camera>,
    /// Ground truth with instances, one image per camera.
    pub truth: Vec<Image>,
    /// Pixels that show vehicles, `[image][pixel]`.
    pub vehicles: Vec<Vec<bool>>,
    /// Pixels of the ground around vehicles, `[image][pixel]`.
    pub ground: Vec<Vec<bool>>,
}

/// Errors of one arm over all moments of a weather.
pub struct ArmFigures {
    pub arm: Arm,
    pub vehicles: MaskedDifference,
    /// Errors on the ground around vehicles, where shadows lie; `None` where vehicles fill all
    /// images.
    pub ground: Option<MaskedDifference>,
    /// Darkening of the ground around vehicles.
    pub darkness: Option<f64>,
}

/// All arms in one weather.
pub struct Reinserted {
    pub weather: Weather,
    pub arms: Vec<ArmFigures>,
    /// Darkening in the ground truth, as in [`ArmFigures::darkness`].
    pub truth_darkness: Option<f64>,
    /// I_dom, the mean over agents and moments.
    pub starkness: f64,
    /// Directionality of the light, the mean over agents and moments.
    pub directionality: f64,
    /// Agents, counted at each moment, about whose position the street tells nothing.
    pub unlit: usize,
    pub example_crops: ExampleCrops,
}

/// Setup of the reinsertion of cars into one street.
pub struct Reinsertion<'a> {
    pub gpu: &'a Gpu,
    pub stage: &'a ReinsertionStreet,
    pub cars: &'a Cars,
    /// The light of the street, without shading by normals.
    pub lighting: &'a Lighting,
    /// Colors shorter than this have no hue.
    pub floor: f64,
}

struct Errors {
    vehicles: MaskedErrors,
    ground: MaskedErrors,
    darkness: Darkness,
}

impl Reinsertion<'_> {
    /// Puts the cars back by every arm at `moments_s`; `done` is told each moment.
    pub fn measure(&self, moments_s: &[f64], done: &dyn Fn()) -> Result<(Reinserted, Vec<Sample>)> {
        let mut renderer = self.renderer();
        let world = self.world(&self.stage.loaded)?;
        let new = |_| Errors {
            vehicles: MaskedErrors::new(self.floor),
            ground: MaskedErrors::new(self.floor),
            darkness: Darkness::default(),
        };
        let mut errors: Vec<Errors> = Arm::ALL.iter().map(new).collect();
        let (mut truth_darkness, mut shown, mut samples) = (Darkness::default(), None, Vec::new());
        for &time_s in moments_s {
            let truth = self.stage.truth(self.cars, time_s);
            let sample = self.sample(&mut renderer, &truth, time_s)?;
            renderer.render(world.scene().background(), &sample.cameras)?;
            let empty = renderer.read_images()?;
            let mut drawn = Vec::new();
            for (&arm, errors) in Arm::ALL.iter().zip(&mut errors) {
                let images = self.images(&mut renderer, &world, arm, &truth, &sample)?;
                for (at, found) in images.iter().enumerate() {
                    errors
                        .vehicles
                        .add(found, &sample.truth[at], |pixel| sample.vehicles[at][pixel])?;
                    errors
                        .ground
                        .add(found, &sample.truth[at], |pixel| sample.ground[at][pixel])?;
                    errors.darkness.add(found, &empty[at], &sample.ground[at]);
                }
                drawn.push(images);
            }
            for (at, image) in sample.truth.iter().enumerate() {
                truth_darkness.add(image, &empty[at], &sample.ground[at]);
            }
            let [plain, ours] = [&drawn[0], &drawn[2]];
            shown = example_crops::better(shown, &sample, ours, plain, self.floor);
            samples.push(sample);
            done();
        }
        let (starkness, directionality, unlit) = self.light(&world, moments_s);
        let reinserted = Reinserted {
            weather: self.stage.weather(),
            arms: figures(errors)?,
            truth_darkness: truth_darkness.share(),
            starkness,
            directionality,
            unlit,
            example_crops: shown
                .map(|(_, example_crops)| example_crops)
                .unwrap_or_default(),
        };
        Ok((reinserted, samples))
    }

    /// One that draws as exactly as can be.
    pub fn renderer(&self) -> Renderer {
        let outputs = Outputs {
            planes: [Plane::Instance].into(),
            ..Outputs::default()
        };
        Renderer::new(
            self.gpu,
            RenderOptions {
                outputs,
                frames_in_flight: 1,
                ..RenderOptions::default()
            },
        )
    }

    /// A world over `loaded` on the device.
    pub fn world(&self, loaded: &LoadedScene) -> Result<World> {
        let session = Session::on(self.gpu, &SessionOptions::default());
        Ok(World::new(&session.add_scene(loaded)?))
    }

    fn sample(&self, renderer: &mut Renderer, truth: &Truth, time_s: f64) -> Result<Sample> {
        let cameras = self.stage.cameras(time_s);
        let splat_scene = renderer.upload(&truth.splat_scene)?;
        renderer.render(&splat_scene, &cameras)?;
        let truth = renderer.read_images()?;
        let vehicles: Vec<Vec<bool>> = truth
            .iter()
            .map(|image| {
                image
                    .instance()
                    .into_iter()
                    .flatten()
                    .map(|&id| id != 0)
                    .collect()
            })
            .collect();
        let ground = vehicles
            .iter()
            .zip(&truth)
            .map(|(mask, image)| ring::around(mask, image.width as usize))
            .collect();
        Ok(Sample {
            time_s,
            cameras,
            truth,
            vehicles,
            ground,
        })
    }

    fn images(
        &self,
        renderer: &mut Renderer,
        world: &World,
        arm: Arm,
        truth: &Truth,
        sample: &Sample,
    ) -> Result<Vec<Image>> {
        let mut cars = agents_at(world, sample.time_s);
        match arm {
            Arm::Ours => {}
            Arm::ContactShadows => cars.shadows = self.contact_shadows(&cars),
            Arm::OursUnshadowed => cars.shadows.clear(),
            Arm::NoRelighting => unlight(&mut cars),
            Arm::BestAffine => {
                for ((agent, car), placed) in cars
                    .agents
                    .iter_mut()
                    .zip(&truth.cars)
                    .zip(&self.stage.loaded.agents)
                {
                    let weights = &self.cars.visibility[placed.asset];
                    agent.shading = None;
                    agent.relight = Some(affine::best_on_dc(
                        &self.cars.originals[placed.asset],
                        car,
                        weights,
                    ));
                }
            }
            Arm::Transfer => {
                for agent in &mut cars.agents {
                    let pose = &agent.world_from_agent;
                    let light = self.lighting.at(pose.translation).0;
                    agent.shading = None;
                    agent.relight = self.lighting.relight(&light, pose, ShFrame::Canonical);
                }
            }
            Arm::OursUncompressed => {}
            Arm::TruthCompressed => {
                return self.images_in_true_colors(renderer, world, &cars, truth, sample);
            }
        }
        if matches!(arm, Arm::OursUncompressed | Arm::BestAffine) {
            let splat_scene = renderer.upload(&self.copies(&cars))?;
            renderer.render(&splat_scene, &sample.cameras)?;
        } else {
            let render = |splats: FrameSplats<'_>| renderer.render(splats, &sample.cameras);
            world.scene().lend(&cars, render)?;
        }
        Ok(renderer.read_images()?)
    }

    /// Shadows of `cars` where nothing is known of sun and lamps.
    fn contact_shadows(&self, cars: &FrameAgents) -> Vec<GroundShadow> {
        let placed = cars.agents.iter().zip(&self.stage.loaded.agents);
        let shadow = |(agent, placed): (&Agent, &LoadedAgent)| {
            let pose = &agent.world_from_agent;
            let light = self.lighting.at(pose.translation).0;
            let dims_m = self.cars.coded[placed.asset].dims_m;
            ShadowOptions::default().shadow(pose, dims_m, &light)
        };
        placed.map(shadow).collect()
    }

    /// The true cars compressed, those that are seen: it takes long.
    fn images_in_true_colors(
        &self,
        renderer: &mut Renderer,
        world: &World,
        cars: &FrameAgents,
        truth: &Truth,
        sample: &Sample,
    ) -> Result<Vec<Image>> {
        let is_seen = |instance: u16| {
            sample
                .truth
                .iter()
                .flat_map(|image| image.instance().into_iter().flatten())
                .any(|&id| id == instance)
        };
        let placed = &self.stage.loaded.agents;
        let seen: Vec<usize> = (0..placed.len())
            .filter(|&at| is_seen(placed[at].instance))
            .collect();
        let clouds: Vec<_> = seen
            .iter()
            .map(|&at| (placed[at].asset, &truth.cars[at]))
            .collect();
        let mut pool = AssetPool::new(renderer.gpu())?;
        let mut agents = Vec::new();
        for (coded, at) in self.cars.compressed(&clouds)?.iter().zip(seen) {
            agents.push(Agent {
                asset: pool.add(coded)?,
                ..cars.agents[at].unlit()
            });
        }
        renderer.render(
            FrameSplats::with_agents(world.scene().background(), &pool, &FrameAgents::new(agents)),
            &sample.cameras,
        )?;
        Ok(renderer.read_images()?)
    }

    /// The background under the shadows of `cars`, and world-space copies of the whole cars in
    /// its light.
    pub fn copies(&self, cars: &FrameAgents) -> SplatScene {
        let mut splat_scene = self.stage.loaded.splat_scene.clone();
        bake_shadows(&mut splat_scene, &cars.shadows);
        for (agent, placed) in cars.agents.iter().zip(&self.stage.loaded.agents) {
            let original = &self.cars.originals[placed.asset];
            let lit = LitAgent {
                relight: agent.relight,
                shading: agent.shading,
                ..LitAgent::default()
            };
            let relit = lit.relit(original);
            let shown = relit.as_ref().unwrap_or(original);
            splat_scene.bake_instance(
                shown,
                &agent.world_from_agent,
                ShFrame::Canonical,
                agent.instance,
            );
        }
        splat_scene
    }

    /// Means of I_dom and of directionality, and how many agents stand where nothing tells of the
    /// light.
    fn light(&self, world: &World, moments_s: &[f64]) -> (f64, f64, usize) {
        let agents = moments_s
            .iter()
            .flat_map(|&time_s| agents_at(world, time_s).agents);
        let lights: Vec<_> = agents
            .map(|agent| self.lighting.at(agent.world_from_agent.translation))
            .collect();
        let starkness = |(light, _): &_| ShadowOptions::default().starkness(light);
        let directionality = |(light, _): &(AmbientDescriptor, _)| light.directionality();
        (
            mean(lights.iter().map(starkness)),
            mean(lights.iter().map(directionality)),
            lights.iter().filter(|(_, known)| !known).count(),
        )
    }
}

/// The agents of `world` at `time_s` of their trajectories, in the light of the scene.
pub fn agents_at(world: &World, time_s: f64) -> FrameAgents {
    let mut world = world.clone();
    world.set_time(time_s);
    world.frame_agents()
}

/// Takes light and shadows of the scene from `cars`.
pub fn unlight(cars: &mut FrameAgents) {
    cars.shadows.clear();
    for agent in &mut cars.agents {
        *agent = agent.unlit();
    }
}

fn figures(errors: Vec<Errors>) -> Result<Vec<ArmFigures>> {
    let mut figures = Vec::new();
    for (arm, errors) in Arm::ALL.into_iter().zip(errors) {
        let Some(vehicles) = errors.vehicles.finish() else {
            continue;
        };
        figures.push(ArmFigures {
            arm,
            vehicles,
            ground: errors.ground.finish(),
            darkness: errors.darkness.share(),
        });
    }
    ensure!(
        !figures.is_empty(),
        "no camera sees a car at any moment: ask for more --agents, --moments or --cameras-used"
    );
    Ok(figures)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    if count > 0 {
        sum / f64::from(count)
    } else {
        0.0
    }
}
