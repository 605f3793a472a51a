//! The light of a scene: from where an agent stands to its colors and its shadow.

use crate::{Invalid, Pose, ShFrame, SplatCloud};
use glam::DVec3;
use rayon::prelude::*;

use crate::light::confidence::on_brighter_ground;
use crate::light::environment::{linear_loss, shown_loss};
use crate::light::{
    AmbientDescriptor, AmbientField, CastingLights, ColorTransfer, GroundLight, GroundShadow,
    LightTransfer, RelightOptions, Shading, Surroundings, Trust,
};

/// Options of contact shadows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowOptions {
    /// lambda: share of the light that is gone under an agent in light that comes from one side, 0
    /// to 1.
    pub strength: f64,
    /// tau_decay: how fast a shadow fades outward.
    pub decay: f64,
    /// Splats whose mean is farther from the ground's plane are not darkened, meters.
    pub slab_m: f64,
    /// [`AmbientDescriptor::directionality`] at which light counts as coming from one side. Splats
    /// show little of it: what glitters in the sun, seen from all round.
    pub full_directionality: f64,
    /// Share of its full strength that a shadow has in light from nowhere: under a car it is dark
    /// on an overcast day too.
    pub floor: f64,
}

impl Default for ShadowOptions {
    fn default() -> Self {
        Self {
            strength: 1.0,
            decay: 1.5,
            slab_m: 0.15,
            full_directionality: 0.002,
            floor: 0.8,
        }
    }
}

impl ShadowOptions {
    /// Checks the options and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let shares = [("strength", self.strength), ("floor", self.floor)];
        if let Some((name, value)) = shares
            .iter()
            .find(|(_, value)| !(0.0..=1.0).contains(value))
        {
            return Err(Invalid::new(format!("{name} is {value}; expected 0 to 1")));
        }
        let sizes = [
            ("decay", self.decay),
            ("slab_m", self.slab_m),
            ("full_directionality", self.full_directionality),
        ];
        match sizes
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0))
        {
            Some((name, value)) => Err(Invalid::new(format!(
                "{name} is {value}; expected a number above zero"
            ))),
            None => Ok(()),
        }
    }

    /// I_dom: how stark the shadows of `light` are, 0 to 1. It follows how much the light comes
    /// from one side, not how bright it is, so that a bright overcast sky throws faint ones.
    #[must_use]
    pub fn starkness(&self, light: &AmbientDescriptor) -> f64 {
        let directed = (light.directionality() / self.full_directionality).min(1.0);
        self.floor + (1.0 - self.floor) * directed
    }

    /// The shadow of an agent of size `dims_m` (length, width, height) that stands at
    /// `world_from_agent` in `light`.
    #[must_use]
    pub fn shadow(
        &self,
        world_from_agent: &Pose,
        dims_m: [f32; 3],
        light: &AmbientDescriptor,
    ) -> GroundShadow {
        let [length_m, width_m, height_m] = dims_m.map(f64::from);
        let ground = Pose {
            translation: DVec3::new(0.0, 0.0, -0.5 * height_m),
            ..Pose::IDENTITY
        };
        GroundShadow {
            world_from_ground: world_from_agent.then(&ground),
            half_size_m: [0.5 * length_m, 0.5 * width_m].map(|half| half.max(1e-3)),
            strength: self.strength * self.starkness(light),
            decay: self.decay,
            sharpness: 0,
            slab_m: self.slab_m,
        }
    }
}

/// The light of a scene.
pub struct Lighting {
    /// Ambient light of the background.
    pub field: AmbientField,
    /// Effect of the light on agents' colors; `None`: none.
    pub transfer: Option<LightTransfer>,
    /// Options of that effect.
    pub relighting: RelightOptions,
    /// Options of contact shadows; `None`: no shadows.
    pub shadows: Option<ShadowOptions>,
    /// Lights that cast shadows; without options of contact shadows they cast none.
    pub casting: CastingLights,
    /// Light of the sky, and of the sun or the lamps, estimated from the ground where agents drive.
    /// `None` without shading by normals, without sun and lamps, or if the ground does not show it.
    pub ground_light: Option<GroundLight>,
}

/// Effect of light on one agent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LitAgent {
    /// Effect on colors, in the frame that these are meant in.
    pub relight: Option<ColorTransfer>,
    /// Light on each side of it; `None`: colors do not follow normals.
    pub shading: Option<Shading>,
    /// Shadows that it throws on the ground: its contact shadow first, then those that it casts.
    pub shadows: Vec<GroundShadow>,
    /// True if the light is from the background; false if it is the neutral light of the assets.
    pub known: bool,
}

impl LitAgent {
    /// The splats of `cloud`, the agent's, in this light; `None`: as they are.
    #[must_use]
    pub fn relit(&self, cloud: &SplatCloud) -> Option<SplatCloud> {
        match (&self.shading, &self.relight) {
            (Some(shading), _) => Some(shading.relit(cloud)),
            (None, Some(transfer)) => Some(transfer.relit(cloud)),
            (None, None) => None,
        }
    }
}

impl Lighting {
    /// Effect of the light on an agent of size `dims_m` at `world_from_agent` whose colors are in
    /// the frame `sh_frame`.
    #[must_use]
    pub fn of_agent(
        &self,
        world_from_agent: &Pose,
        dims_m: [f32; 3],
        sh_frame: ShFrame,
    ) -> LitAgent {
        let (light, known) = self.at(world_from_agent.translation);
        LitAgent {
            relight: self.relight(&light, world_from_agent, sh_frame),
            shading: self.shading(world_from_agent, dims_m),
            shadows: self.shadows_of(world_from_agent, dims_m, &light),
            known,
        }
    }

    /// Shadows of an agent in `light`.
    ///
    /// A contact shadow alone stands for all light that the agent hides. Where lights cast shadows
    /// of their own, it is what the agent hides of the sky.
    fn shadows_of(
        &self,
        world_from_agent: &Pose,
        dims_m: [f32; 3],
        light: &AmbientDescriptor,
    ) -> Vec<GroundShadow> {
        let Some(options) = self.shadows else {
            return Vec::new();
        };
        let contact = options.shadow(world_from_agent, dims_m, light);
        if self.casting.is_empty() {
            return vec![contact];
        }
        let sunlit = self.casting.sun.map_or(0.0, |sun| {
            self.field.open_share(world_from_agent, dims_m, sun.towards)
        });
        let (cast, sky) = self
            .casting
            .shadows(world_from_agent, dims_m, sunlit, options.slab_m);
        let hidden = linear_loss(options.strength * options.floor);
        let contact = GroundShadow {
            strength: shown_loss(sky * hidden),
            ..contact
        };
        std::iter::once(contact).chain(cast).collect()
    }

    /// [`Lighting::of_agent`] for many: pose, size and frame of the colors of each. On as many
    /// threads as there are.
    #[must_use]
    pub fn of_agents(&self, agents: &[(Pose, [f32; 3], ShFrame)]) -> Vec<LitAgent> {
        let lit = |(pose, dims_m, sh_frame): &(Pose, [f32; 3], ShFrame)| {
            self.of_agent(pose, *dims_m, *sh_frame)
        };
        // Some microseconds an agent: fewer are not worth waking a thread for.
        agents.par_iter().with_min_len(8).map(lit).collect()
    }

    /// The light at `position`, as a ground of the calibrated albedo would show it, and whether the
    /// background told it: else it is the one that assets are shown in as they are.
    #[must_use]
    pub fn at(&self, position: DVec3) -> (AmbientDescriptor, bool) {
        match self.field.at(position) {
            Some(light) => (self.on_calibrated_ground(light), true),
            None => (
                self.transfer
                    .as_ref()
                    .map_or(AmbientDescriptor::uniform([0.5; 3]), |transfer| {
                        transfer.neutral
                    }),
                false,
            ),
        }
    }

    /// Albedo that the ground is taken to have: that of the options, else that of the calibration
    /// or, for shading by normals, of [`Surroundings`]. `None` where colors stay as they are.
    #[must_use]
    pub fn ground_albedo(&self) -> Option<f64> {
        let assumed = match self.relighting.by_normals {
            true => Some(Surroundings::default().albedo),
            false => self.transfer.as_ref().map(LightTransfer::ground_albedo),
        };
        assumed.map(|assumed| self.relighting.ground_albedo.unwrap_or(assumed))
    }

    fn on_calibrated_ground(&self, light: AmbientDescriptor) -> AmbientDescriptor {
        match (self.relighting.ground_albedo, &self.transfer) {
            (Some(albedo), Some(transfer)) => {
                on_brighter_ground(&light, transfer.ground_albedo() / albedo)
            }
            _ => light,
        }
    }

    /// Effect of `light` on the colors of an agent at `world_from_agent`, which are in the frame
    /// `sh_frame`; `None` without a transfer, or where colors follow normals.
    #[must_use]
    pub fn relight(
        &self,
        light: &AmbientDescriptor,
        world_from_agent: &Pose,
        sh_frame: ShFrame,
    ) -> Option<ColorTransfer> {
        let transfer = self.transfer.as_ref()?;
        if self.relighting.by_normals {
            return None;
        }
        let light = in_frame(light, world_from_agent, sh_frame);
        Some(if self.relighting.full_effect {
            transfer.at(&light)
        } else {
            transfer
                .trusted_at(&light, self.relighting.albedo_spread())
                .0
        })
    }

    /// Trust in the effect of `light` on the colors of an agent; `None` if nothing is
    /// known of its errors. Arguments as in [`Lighting::relight`].
    #[must_use]
    pub fn trust(
        &self,
        light: &AmbientDescriptor,
        world_from_agent: &Pose,
        sh_frame: ShFrame,
    ) -> Option<Trust> {
        let light = in_frame(light, world_from_agent, sh_frame);
        let spread = self.relighting.albedo_spread();
        self.transfer.as_ref()?.trusted_at(&light, spread).1
    }
}

/// `light` in the frame of the colors of an agent at `world_from_agent`.
fn in_frame(
    light: &AmbientDescriptor,
    world_from_agent: &Pose,
    sh_frame: ShFrame,
) -> AmbientDescriptor {
    match sh_frame {
        ShFrame::Canonical => light.turned(world_from_agent.rotation.normalize().inverse()),
        ShFrame::World => *light,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{AmbientOptions, Sun};
    use crate::{SplatCloud, sh};

    /// A gray light of which `share` comes from one side.
    fn light(gray: f32, share: f32) -> AmbientDescriptor {
        let mut light = AmbientDescriptor::uniform([gray; 3]);
        light.coefficients[3] = [share * 3f32.sqrt() * gray / sh::Y0 as f32; 3];
        light
    }

    #[test]
    fn overcast_shadows_are_fainter_than_sunny_ones_however_bright_the_sky() {
        let options = ShadowOptions::default();
        let strength = |light: &AmbientDescriptor| {
            options
                .shadow(&Pose::IDENTITY, [4.5, 1.9, 1.5], light)
                .strength
        };
        let (sunny, overcast) = (strength(&light(0.3, 0.0016)), strength(&light(0.9, 0.0002)));
        assert!(
            (sunny - 0.96).abs() < 1e-5 && (overcast - 0.82).abs() < 1e-5,
            "{sunny} {overcast}"
        );
        assert!(
            (strength(&light(0.3, 0.5)) - 1.0).abs() < 1e-9,
            "never more than lambda"
        );
    }

    #[test]
    fn the_shadow_lies_under_the_wheels() {
        let pose = Pose::from_yaw(0.5, DVec3::new(10.0, 20.0, 3.75));
        let shadow = ShadowOptions::default().shadow(&pose, [4.0, 2.0, 1.5], &light(0.5, 0.01));
        let off_m = (shadow.world_from_ground.translation - DVec3::new(10.0, 20.0, 3.0)).length();
        assert!(shadow.half_size_m == [2.0, 1.0] && off_m < 1e-12);
        shadow.check().unwrap();
    }

    /// Level ground of gray `display`, and a transfer calibrated on ground that shows 0.4 in
    /// neutral light, whose gains are the light over neutral.
    fn over_ground(display: f32, relighting: RelightOptions) -> Lighting {
        let ground = SplatCloud {
            means: vec![[0.0; 3]],
            scales: vec![[0.5, 0.5, 0.01]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![0.9],
            sh_degree: 0,
            sh_dc: vec![[(display - 0.5) / sh::Y0 as f32; 3]],
            sh_rest: Vec::new(),
        };
        let row = ([0.0; AmbientDescriptor::LEN], 0.0);
        let mut gain = vec![row; 3];
        for (channel, (weights, _)) in gain.iter_mut().enumerate() {
            weights[channel] = sh::Y0 as f32 / 0.4;
        }
        Lighting {
            field: AmbientField::new(&ground, 1, DVec3::ZERO, &AmbientOptions::default()),
            transfer: Some(LightTransfer {
                sh_degree: 0,
                gain,
                offset: vec![row; 3],
                neutral: AmbientDescriptor::uniform([0.4; 3]),
                confidence: None,
            }),
            relighting,
            shadows: None,
            casting: CastingLights::default(),
            ground_light: None,
        }
    }

    #[test]
    fn light_is_as_bright_as_the_albedo_of_the_ground_says() {
        let gain = |display: f32, ground_albedo: Option<f64>| {
            let relighting = RelightOptions {
                ground_albedo,
                ..RelightOptions::default()
            };
            let lit = over_ground(display, relighting).of_agent(
                &Pose::IDENTITY,
                [4.0, 2.0, 1.5],
                ShFrame::World,
            );
            f64::from(lit.relight.unwrap().gain[0][1])
        };
        let calibrated = over_ground(0.4, RelightOptions::default());
        assert_eq!(
            calibrated.at(DVec3::ZERO).0,
            calibrated.field.at(DVec3::ZERO).unwrap(),
            "an albedo that nobody gives changes no bit"
        );
        let assumed = calibrated.ground_albedo().unwrap();
        assert!((assumed - 0.4f64.powf(2.2)).abs() < 1e-6);
        // Twice the albedo shows half the light alike.
        let doubled = 0.4 * 2f64.powf(1.0 / 2.2);
        for (display, albedo, expected) in [
            (0.4, None, 1.0),
            (0.4, Some(assumed), 1.0),
            (doubled as f32, Some(2.0 * assumed), 1.0),
            (doubled as f32, None, doubled / 0.4),
        ] {
            let found = gain(display, albedo);
            assert!((found - expected).abs() < 1e-5, "{albedo:?}: {found}");
        }
        // Where the ground does not tell of the light, its albedo is of no account.
        let far = over_ground(
            0.4,
            RelightOptions {
                ground_albedo: Some(0.5),
                full_effect: true,
                ..RelightOptions::default()
            },
        );
        let (light, known) = far.at(DVec3::new(500.0, 0.0, 0.0));
        assert!(!known && light == AmbientDescriptor::uniform([0.4; 3]));
        for albedo in [0.0, -0.1, 1.5, f64::NAN] {
            let options = RelightOptions {
                ground_albedo: Some(albedo),
                full_effect: false,
                ..RelightOptions::default()
            };
            let error = options.check().unwrap_err();
            assert!(error.reason().contains("ground_albedo is"), "{error:?}");
        }
    }

    /// Checks that without lights that cast shadows an agent has its contact shadow, to the bit,
    /// and that with a sun the contact shadow is what is hidden of the sky.
    #[test]
    fn a_cast_shadow_takes_its_part_from_the_contact_shadow() {
        let options = ShadowOptions::default();
        let shadows = |sun: Option<Sun>| {
            let lighting = Lighting {
                shadows: Some(options),
                casting: CastingLights {
                    sun,
                    ..CastingLights::default()
                },
                ..over_ground(0.4, RelightOptions::default())
            };
            let pose = Pose::from_yaw(0.3, DVec3::new(1.0, 0.0, 0.75));
            let lit = lighting.of_agent(&pose, [4.0, 2.0, 1.5], ShFrame::World);
            let light = lighting.field.at(pose.translation).unwrap();
            (lit.shadows, options.shadow(&pose, [4.0, 2.0, 1.5], &light))
        };
        let (alone, contact) = shadows(None);
        assert_eq!(alone, [contact]);
        let (lit, contact) = shadows(Some(Sun {
            towards: DVec3::new(0.5, 0.0, 0.8),
            share: 0.7,
        }));
        let [ofsky, cast] = lit[..] else {
            panic!("{lit:?}");
        };
        assert!(ofsky.strength < 0.4 * contact.strength, "{ofsky:?}");
        assert_eq!(
            GroundShadow {
                strength: contact.strength,
                ..ofsky
            },
            contact
        );
        assert!(cast.sharpness > 0 && cast.strength > ofsky.strength);
    }

    #[test]
    fn options_that_make_no_shadow_are_named() {
        ShadowOptions::default().check().unwrap();
        assert!(
            ShadowOptions {
                strength: 2.0,
                ..ShadowOptions::default()
            }
            .check()
            .unwrap_err()
            .reason()
            .contains("strength is 2")
        );
        assert!(
            ShadowOptions {
                decay: 0.0,
                ..ShadowOptions::default()
            }
            .check()
            .unwrap_err()
            .reason()
            .contains("decay is 0")
        );
    }

    /// Share of an even sky that a car of `dims_m`, a cabin on a body 0.2 m above the ground, hides
    /// from the ground at `at`, by cosine-weighted directions in f64.
    fn hidden_sky(dims_m: [f32; 3], at: DVec3) -> f64 {
        let [length_m, width_m, height_m] = dims_m.map(f64::from);
        let body = [[-0.5, -0.5, 0.13], [0.5, 0.5, 0.55]];
        let cabin = [[-0.33, -0.43, 0.5], [0.25, 0.43, 1.0]];
        let size = DVec3::new(length_m, width_m, height_m);
        let boxes = [body, cabin].map(|corners| corners.map(|at| size * DVec3::from_array(at)));
        const RAYS: usize = 4000;
        let hits = |ray: usize| {
            let share = (ray as f64 + 0.5) / RAYS as f64;
            let (sin, cos) = (ray as f64 * 2.399_963_229_728_653).sin_cos();
            let radius = share.sqrt();
            let direction = DVec3::new(radius * cos, radius * sin, (1.0 - share).sqrt());
            boxes.iter().any(|[low, high]| {
                let (a, b) = ((low - at) / direction, (high - at) / direction);
                a.max(b).min_element() > a.min(b).max_element().max(0.0)
            })
        };
        (0..RAYS).filter(|ray| hits(*ray)).count() as f64 / RAYS as f64
    }

    /// Ground within a meter of a car under an even sky: the contact shadow darkens it as geometry
    /// does, to 30 %. Without the floor that it has in light from nowhere it would not.
    #[test]
    fn an_overcast_shadow_is_as_dark_as_geometry_makes_it() {
        let dims_m = [4.5, 1.85, 1.5];
        let overcast = light(0.5, 0.0004);
        let darkness = |options: &ShadowOptions| {
            let pose = Pose::from_yaw(0.0, DVec3::new(0.0, 0.0, 0.75));
            let shadow = options.shadow(&pose, dims_m, &overcast);
            let (mut found, mut truth) = (0.0, 0.0);
            for off_m in [0.05, 0.2, 0.4, 0.6, 0.8, 1.0] {
                let side = (-9..=9).map(|i| (0.25 * f64::from(i), 0.925 + off_m));
                let front = (-3..=3).map(|i| (2.25 + off_m, 0.3 * f64::from(i)));
                for (x, y) in side.chain(front) {
                    let at = DVec3::new(x, y, 0.0);
                    found += 1.0 - shadow.factor(at);
                    // Displays show light by its 2.2th root.
                    truth += 1.0 - (1.0 - hidden_sky(dims_m, at)).powf(1.0 / 2.2);
                }
            }
            found / truth
        };
        let ratio = darkness(&ShadowOptions::default());
        println!("overcast shadow over geometry: {ratio:.2}");
        assert!((0.7..1.3).contains(&ratio), "{ratio}");
        let faint = ShadowOptions {
            floor: 0.3,
            ..ShadowOptions::default()
        };
        assert!(darkness(&faint) < 0.7);
    }
}
