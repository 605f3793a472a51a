//! Bodies in the images of an episode.

use decouplegs_scene::{Motion, RoadUser};
use decouplegs_session::{AgentInstance, SessionError, World};

use super::Simulation;

impl Simulation {
    /// Puts the agents, the lamps of traffic lights and the signs into `world` as they are now, and
    /// the bodies of all egos where there are several, and takes out all others.
    ///
    /// # Errors
    /// Returns an error if the scene of `world` has not the assets.
    pub fn show_all(&self, world: &mut World) -> Result<(), SessionError> {
        let mut placed = Vec::with_capacity(self.agent_sizes.len());
        for (index, state) in self.traffic.states().iter().enumerate() {
            let Some(state) = *state else {
                continue;
            };
            let (name, kind, asset) = self.scenario.agent(index);
            let (name, asset) = (name.to_owned(), self.site.asset_of(kind, asset));
            let pose = self.pose(index + 1, &state, &self.agent_sizes[index]);
            let instance = AgentInstance {
                asset,
                pose,
                motion: self.motion_of(index + 1, state, &pose),
                sh_frame: None,
                instance: u16::try_from(index + 1).unwrap_or(u16::MAX),
                shines: false,
            };
            placed.push((name, instance));
        }
        placed.extend(self.ego_bodies());
        // No agent has such names.
        let lamps = self
            .signals
            .iter()
            .enumerate()
            .map(|(index, &(light, pose))| {
                let color = self.lights().color_at(light, self.time_s());
                let asset = self.site.signal_asset(color);
                (format!("signal/{index}"), asset, pose, true)
            });
        let signs = self.sign_posts.iter().enumerate();
        let signs = signs.map(|(index, &(kind, pose))| {
            (
                format!("sign/{index}"),
                self.site.sign_asset(kind),
                pose,
                false,
            )
        });
        let first = self.traffic.states().len() + self.bodies() + 1;
        for (number, (name, asset, pose, shines)) in lamps.chain(signs).enumerate() {
            let instance = AgentInstance {
                asset,
                pose,
                motion: Motion::REST,
                sh_frame: None,
                instance: u16::try_from(first + number).unwrap_or(u16::MAX),
                shines,
            };
            placed.push((name, instance));
        }
        world.set_agents(placed)
    }

    /// Number of egos whose bodies are shown: none where there is one ego.
    fn bodies(&self) -> usize {
        match self.egos.len() {
            1 => 0,
            several => several,
        }
    }

    /// Instance id of the body of ego `ego`; `None` where there is one ego, which no image shows.
    pub(in crate::episode) fn ego_instance(&self, ego: usize) -> Option<u16> {
        let number = self.traffic.states().len() + 1 + ego;
        (self.bodies() > 0).then(|| u16::try_from(number).unwrap_or(u16::MAX))
    }

    /// Bodies of the egos that are on the road, where there are several.
    fn ego_bodies(&self) -> impl Iterator<Item = (String, AgentInstance)> {
        (0..self.bodies()).filter_map(|ego| {
            self.ego_state(ego)?;
            let identity = self.scenario.ego_identity(ego);
            let (pose, motion) = self.view(ego).pose();
            let instance = AgentInstance {
                asset: self.site.asset_of(RoadUser::Car, identity.asset),
                pose,
                motion,
                sh_frame: None,
                instance: self.ego_instance(ego)?,
                shines: false,
            };
            Some((identity.name.clone(), instance))
        })
    }
}
