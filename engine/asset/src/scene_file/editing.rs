//! Agents of a scene file added, removed, moved, and shown as something else.

use std::path::PathBuf;

use decouplegs_scene::{Invalid, Pose, Presence, TimedPose, Trajectory};
use glam::{DQuat, DVec3};
use thiserror::Error;

use super::{SceneAgent, SceneFile};

/// Names that a complaint lists; a scene may have thousands.
const NAMES_TOLD: usize = 12;

/// Reason why a scene could not be edited. It is as it was.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum EditError {
    /// No agent has the name.
    #[error("the scene has no agent {name:?}; {there}")]
    NoAgent {
        /// The name asked for.
        name: String,
        /// Names of the agents, as a sentence.
        there: String,
    },
    /// Another agent has the name.
    #[error(
        "the scene has an agent {name:?} already; names must differ: choose another, or remove that agent first"
    )]
    NameTaken {
        /// The name asked for.
        name: String,
    },
    /// The name is empty.
    #[error("an agent needs a name; expected one letter at least, found none")]
    NoName,
    /// The instance ids are used up.
    #[error(
        "agent {name:?} has no room: instance ids name at most {max} agents in one scene; remove one first"
    )]
    TooMany {
        /// The agent that was to be added.
        name: String,
        /// Agents that can have ids.
        max: usize,
    },
    /// The motion leads nowhere.
    #[error(
        "agent {name:?} cannot be moved: {reason}; expected finite numbers of meters and radians"
    )]
    Motion {
        /// The agent that was to be moved.
        name: String,
        /// Error of the new poses.
        reason: String,
    },
}

impl EditError {
    /// The complaint that none of the agents called `names` is called `name`.
    #[must_use]
    pub fn no_agent<'a>(name: &str, names: impl IntoIterator<Item = &'a str>) -> Self {
        let names: Vec<&str> = names.into_iter().collect();
        let quoted: Vec<String> = names
            .iter()
            .take(NAMES_TOLD)
            .map(|name| format!("{name:?}"))
            .collect();
        let there = match names.len() {
            0 => "it has none at all".to_owned(),
            count if count > NAMES_TOLD => {
                format!(
                    "it has {} and {} more",
                    quoted.join(", "),
                    count - NAMES_TOLD
                )
            }
            _ => format!("it has {}", quoted.join(", ")),
        };
        Self::NoAgent {
            name: name.to_owned(),
            there,
        }
    }
}

/// `trajectory` moved as a whole so that it begins at `position_m`, its nose towards `yaw_rad`
/// there: turned about the vertical and carried along, so that pitch, roll and every turn of it
/// stay.
///
/// # Errors
/// A sentence, when a pose is not finite.
pub fn begun_at(
    trajectory: &Trajectory,
    position_m: DVec3,
    yaw_rad: f64,
) -> Result<Trajectory, Invalid> {
    passing(trajectory, trajectory.start_s(), position_m, yaw_rad)
}

/// `trajectory` moved as a whole, as [`begun_at`] does, so that it is at `position_m`, its nose
/// towards `yaw_rad`, at `time_s`.
///
/// # Errors
/// A sentence, when a pose is not finite.
pub fn passing(
    trajectory: &Trajectory,
    time_s: f64,
    position_m: DVec3,
    yaw_rad: f64,
) -> Result<Trajectory, Invalid> {
    let there = trajectory.at(time_s);
    let turn = DQuat::from_rotation_z(yaw_rad - there.heading_rad());
    // Relative to that pose: in UTM coordinates a turn about the origin would cost a nanometer and
    // look odd in the file.
    each_pose(trajectory, |pose| Pose {
        rotation: (turn * pose.rotation).normalize(),
        translation: position_m + turn * (pose.translation - there.translation),
    })
}

/// `trajectory` with all its times `later_s` later.
///
/// # Errors
/// A sentence, when a time is not finite.
pub fn delayed(trajectory: &Trajectory, later_s: f64) -> Result<Trajectory, Invalid> {
    let timed = |timed: &TimedPose| TimedPose {
        time_s: timed.time_s + later_s,
        pose: timed.pose,
    };
    Trajectory::new(trajectory.poses().iter().map(timed).collect())
}

/// `trajectory` with each pose moved by `shift` in the agent's own frame: x forward, y left, z up.
///
/// # Errors
/// A sentence, when a pose is not finite.
pub fn shifted(trajectory: &Trajectory, shift: &Pose) -> Result<Trajectory, Invalid> {
    each_pose(trajectory, |pose| pose.then(shift))
}

fn each_pose(
    trajectory: &Trajectory,
    moved: impl Fn(&Pose) -> Pose,
) -> Result<Trajectory, Invalid> {
    let timed = |timed: &TimedPose| TimedPose {
        time_s: timed.time_s,
        pose: moved(&timed.pose),
    };
    Trajectory::new(trajectory.poses().iter().map(timed).collect())
}

impl SceneFile {
    /// The agent called `name`.
    ///
    /// # Errors
    /// [`EditError::NoAgent`], with the agents that there are.
    pub fn agent(&self, name: &str) -> Result<&SceneAgent, EditError> {
        Ok(&self.agents[self.index_of(name)?])
    }

    /// Takes the agent called `name` out. Those behind it move up, and their instance ids with
    /// them.
    ///
    /// # Errors
    /// [`EditError::NoAgent`].
    pub fn remove_agent(&mut self, name: &str) -> Result<SceneAgent, EditError> {
        let index = self.index_of(name)?;
        Ok(self.agents.remove(index))
    }

    /// Adds `agent` behind all others.
    ///
    /// # Errors
    /// Returns an error if its name is empty or taken, or there are as many agents as ids.
    pub fn add_agent(&mut self, agent: SceneAgent) -> Result<(), EditError> {
        let SceneAgent { name, .. } = &agent;
        if name.is_empty() {
            return Err(EditError::NoName);
        }
        if self.agents.iter().any(|other| other.name == *name) {
            return Err(EditError::NameTaken { name: name.clone() });
        }
        let max = usize::from(u16::MAX);
        if self.agents.len() >= max {
            return Err(EditError::TooMany {
                name: name.clone(),
                max,
            });
        }
        self.agents.push(agent);
        Ok(())
    }

    /// Lets the agent called `name` show `asset`, a path relative to the scene file. Its colors are
    /// meant as that asset says, whatever the file said of the asset before.
    ///
    /// Its pose stays: an asset of another height stands with its middle where the other's was.
    ///
    /// # Errors
    /// [`EditError::NoAgent`].
    pub fn swap_asset(&mut self, name: &str, asset: impl Into<PathBuf>) -> Result<(), EditError> {
        let index = self.index_of(name)?;
        let agent = &mut self.agents[index];
        agent.asset = asset.into();
        agent.sh_frame = None;
        agent.class = None;
        Ok(())
    }

    /// Lets the agent called `name` follow `trajectory`, world coordinates.
    ///
    /// # Errors
    /// [`EditError::NoAgent`].
    pub fn set_trajectory(&mut self, name: &str, trajectory: Trajectory) -> Result<(), EditError> {
        let index = self.index_of(name)?;
        self.agents[index].trajectory = trajectory;
        Ok(())
    }

    /// Lets the agent called `name` be in the scene at the times of `present` alone.
    ///
    /// # Errors
    /// [`EditError::NoAgent`].
    pub fn set_presence(&mut self, name: &str, present: Presence) -> Result<(), EditError> {
        let index = self.index_of(name)?;
        self.agents[index].present = present;
        Ok(())
    }

    /// Moves the agent called `name` with its whole trajectory, as [`begun_at`] does.
    ///
    /// # Errors
    /// Returns an error if there is no such agent, or a number is not finite.
    pub fn move_agent(
        &mut self,
        name: &str,
        position_m: DVec3,
        yaw_rad: f64,
    ) -> Result<(), EditError> {
        self.with_trajectory(name, |trajectory| begun_at(trajectory, position_m, yaw_rad))
    }

    /// Moves the agent called `name` in its own frame all along its trajectory, as [`shifted`]
    /// does.
    ///
    /// # Errors
    /// Returns an error if there is no such agent, or a number is not finite.
    pub fn shift_agent(&mut self, name: &str, shift: &Pose) -> Result<(), EditError> {
        self.with_trajectory(name, |trajectory| shifted(trajectory, shift))
    }

    fn with_trajectory(
        &mut self,
        name: &str,
        edited: impl Fn(&Trajectory) -> Result<Trajectory, Invalid>,
    ) -> Result<(), EditError> {
        let index = self.index_of(name)?;
        let agent = &mut self.agents[index];
        agent.trajectory = edited(&agent.trajectory).map_err(|reason| EditError::Motion {
            name: name.to_owned(),
            reason: reason.into(),
        })?;
        Ok(())
    }

    fn index_of(&self, name: &str) -> Result<usize, EditError> {
        let index = self.agents.iter().position(|agent| agent.name == name);
        index.ok_or_else(|| {
            EditError::no_agent(name, self.agents.iter().map(|agent| agent.name.as_str()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::ShFrame;

    fn scene(names: &[&str]) -> SceneFile {
        let agent = |name: &&str| SceneAgent {
            name: (*name).to_owned(),
            class: None,
            asset: "car.ply".into(),
            sh_frame: Some(ShFrame::World),
            trajectory: Trajectory::standing(Pose::from_yaw(
                0.5,
                DVec3::new(458_000.0, 5_428_000.0, 112.0),
            )),
            present: Presence::ALWAYS,
        };
        SceneFile {
            agents: names.iter().map(agent).collect(),
            ..SceneFile::of_background("street.ply")
        }
    }

    #[test]
    fn agents_come_and_go_by_name() {
        let mut edited = scene(&["a", "b", "c"]);
        let taken = edited.remove_agent("b").unwrap();
        assert_eq!((taken.name.as_str(), &edited), ("b", &scene(&["a", "c"])));
        edited.add_agent(taken.clone()).unwrap();
        assert_eq!(edited, scene(&["a", "c", "b"]));
        edited.swap_asset("c", "van.ply").unwrap();
        assert_eq!(
            (&edited.agents[1].asset, edited.agents[1].sh_frame),
            (&PathBuf::from("van.ply"), None)
        );
        edited
            .set_trajectory("a", Trajectory::standing(Pose::IDENTITY))
            .unwrap();
        assert_eq!(
            edited.agent("a").unwrap().trajectory,
            Trajectory::standing(Pose::IDENTITY)
        );
        assert_eq!(
            SceneFile::parse(&edited.to_toml().unwrap()).unwrap(),
            edited
        );
    }

    #[test]
    fn a_complaint_names_the_agent_and_those_that_there_are_and_changes_nothing() {
        let mut edited = scene(&["a", "b"]);
        let message = |error: EditError| error.to_string();
        assert_eq!(
            message(edited.remove_agent("x").unwrap_err()),
            r#"the scene has no agent "x"; it has "a", "b""#
        );
        assert!(message(edited.swap_asset("x", "van.ply").unwrap_err()).contains(r#""x""#));
        assert!(
            message(edited.move_agent("b", DVec3::NAN, 0.0).unwrap_err())
                .contains(r#""b" cannot be moved"#)
        );
        let infinite = Pose {
            translation: DVec3::INFINITY,
            ..Pose::IDENTITY
        };
        assert!(message(edited.shift_agent("b", &infinite).unwrap_err()).contains("not finite"));
        let twin = edited.agents[0].clone();
        assert!(
            message(edited.add_agent(twin.clone()).unwrap_err())
                .contains(r#"an agent "a" already"#)
        );
        assert_eq!(
            edited.add_agent(SceneAgent {
                name: String::new(),
                ..twin.clone()
            }),
            Err(EditError::NoName)
        );
        assert_eq!(edited, scene(&["a", "b"]));
        assert!(message(scene(&[]).remove_agent("x").unwrap_err()).contains("none at all"));
        let many: Vec<String> = (0..65_535).map(|index| format!("car{index}")).collect();
        let mut full = scene(&many.iter().map(String::as_str).collect::<Vec<_>>());
        let said = message(full.remove_agent("x\u{1b}").unwrap_err());
        assert!(
            said.ends_with("\"car11\" and 65523 more") && !said.contains('\u{1b}'),
            "{said}"
        );
        assert!(message(full.add_agent(twin).unwrap_err()).contains("65535"));
    }

    #[test]
    fn a_way_is_moved_as_a_whole_and_shifted_in_its_own_frame() {
        // A quarter of a circle to the left, uphill.
        let pose = |turn: f64| {
            let rotation = DQuat::from_rotation_z(turn) * DQuat::from_rotation_y(-0.1);
            Pose::new(
                rotation,
                DVec3::new(
                    458_000.0 + 20.0 * turn.sin(),
                    5_428_020.0 - 20.0 * turn.cos(),
                    112.0 + turn,
                ),
            )
        };
        let knots = [0.0, 0.8, 1.57].map(|turn| TimedPose {
            time_s: 2.0 * turn,
            pose: pose(turn),
        });
        let way = Trajectory::new(knots.to_vec()).unwrap();
        let begin = DVec3::new(-3.0, 7.0, 1.0);
        let moved = begun_at(&way, begin, 2.0).unwrap();
        assert_eq!(moved.poses()[0].pose.translation, begin);
        assert!((moved.poses()[0].pose.heading_rad() - 2.0).abs() < 1e-12);
        // A rigid motion about the vertical: how each pose is seen from the first stays, and so
        // does the slope.
        for (old, new) in way.poses().iter().zip(moved.poses()) {
            assert_eq!(old.time_s, new.time_s);
            let relative = |way: &Trajectory, pose: &Pose| way.poses()[0].pose.inverse().then(pose);
            let (old_seen, new_seen) = (relative(&way, &old.pose), relative(&moved, &new.pose));
            assert!(
                (old_seen.translation - new_seen.translation).length() < 1e-8,
                "{old_seen:?} {new_seen:?}"
            );
            assert!(
                ((old.pose.rotation * DVec3::X).z - (new.pose.rotation * DVec3::X).z).abs() < 1e-12
            );
        }
        // Between two knots: there it is where it was asked to be, and moved as rigidly.
        let (time_s, later) = (2.0, passing(&way, 2.0, begin, -1.0).unwrap());
        assert!((later.at(time_s).translation - begin).length() < 1e-9);
        assert!((later.at(time_s).heading_rad() + 1.0).abs() < 1e-9);
        let apart = |way: &Trajectory| {
            let knots = way.poses();
            (knots[0].pose.translation - knots[2].pose.translation).length()
        };
        assert!((apart(&way) - apart(&later)).abs() < 1e-8);
        let late = delayed(&way, 1.5).unwrap();
        assert_eq!((late.start_s(), late.at(2.5)), (1.5, way.at(1.0)));
        let shift = Pose::new(DQuat::from_rotation_z(0.25), DVec3::new(4.0, -3.5, 0.0));
        for (old, new) in way
            .poses()
            .iter()
            .zip(shifted(&way, &shift).unwrap().poses())
        {
            let seen = old.pose.inverse().transform(new.pose.translation);
            assert!((seen - shift.translation).length() < 1e-8, "{seen}");
            assert!((old.pose.rotation.angle_between(new.pose.rotation) - 0.25).abs() < 1e-7);
        }
    }
}
