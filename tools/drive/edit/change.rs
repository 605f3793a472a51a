//! Changes to agents, as the command line says them.

use std::path::PathBuf;
use std::str::FromStr;

use decouplegs::scene::{Pose, Presence};
use glam::{DQuat, DVec3};

/// No agent is longer, meters.
const SIDE_M_MAX: f64 = 100.0;

/// An agent that comes: `NAME=ASSET,X,Y,Z,YAW_DEG`.
#[derive(Clone, Debug, PartialEq)]
pub struct Addition {
    pub name: String,
    pub asset: PathBuf,
    pub position_m: DVec3,
    pub yaw_rad: f64,
}

/// An agent that is cut out of the background: `NAME=X,Y,Z,YAW_DEG,LENGTH,WIDTH,HEIGHT`.
#[derive(Clone, Debug, PartialEq)]
pub struct CutBox {
    pub name: String,
    /// World from box.
    pub pose: Pose,
    /// Length, width and height, meters.
    pub dims_m: DVec3,
}

/// Another asset for an agent: `NAME=ASSET`.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    pub name: String,
    pub asset: PathBuf,
}

/// New start of an agent: `NAME=X,Y,Z,YAW_DEG`.
#[derive(Clone, Debug, PartialEq)]
pub struct Move {
    pub name: String,
    pub position_m: DVec3,
    pub yaw_rad: f64,
}

/// Times of an agent: `NAME=FROM,TO[,FROM,TO...]`, or `NAME=always`.
#[derive(Clone, Debug, PartialEq)]
pub struct Times {
    pub name: String,
    pub present: Presence,
}

/// Shift of an agent in its own frame: `NAME=FORWARD,LEFT[,YAW_DEG]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Shift {
    pub name: String,
    pub shift: Pose,
}

impl FromStr for Addition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('=').and_then(|(name, rest)| {
            // The path may have commas of its own; the four numbers are the last.
            let mut parts = rest.rsplitn(5, ',');
            let mut next = || number(parts.next()?);
            let (yaw_deg, z, y, x) = (next()?, next()?, next()?, next()?);
            let asset = parts.next().filter(|asset| !asset.is_empty())?;
            let position_m = DVec3::new(x, y, z);
            Some(Self {
                name: named(name)?,
                asset: asset.into(),
                position_m,
                yaw_rad: yaw_deg.to_radians(),
            })
        });
        parsed.ok_or_else(|| {
            format!("expected NAME=ASSET,X,Y,Z,YAW_DEG, like taxi=car.safetensors,12.5,-3,0.75,90, found {text:?}")
        })
    }
}

impl FromStr for CutBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = named_numbers(text).and_then(|(name, numbers)| match numbers[..] {
            [x, y, z, yaw_deg, length, width, height] => {
                let dims_m = DVec3::new(length, width, height);
                let is_box = dims_m.min_element() > 0.0 && dims_m.max_element() <= SIDE_M_MAX;
                // The name becomes that of a file.
                let is_plain = name
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-'));
                let rotation = DQuat::from_rotation_z(yaw_deg.to_radians());
                (is_box && is_plain).then(|| Self {
                    name,
                    pose: Pose::new(rotation, DVec3::new(x, y, z)),
                    dims_m,
                })
            }
            _ => None,
        });
        parsed.ok_or_else(|| {
            format!(
                "expected NAME=X,Y,Z,YAW_DEG,LENGTH,WIDTH,HEIGHT in meters and degrees, the name of letters, digits, - and _, \
                 like van_00=14.7,4.1,0.2,31.6,4.4,1.8,2.0, found {text:?}"
            )
        })
    }
}

impl FromStr for Swap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('=').filter(|(_, asset)| !asset.is_empty());
        let swap = parsed.and_then(|(name, asset)| {
            Some(Self {
                name: named(name)?,
                asset: asset.into(),
            })
        });
        swap.ok_or_else(|| {
            format!("expected NAME=ASSET, like car_03=van.safetensors, found {text:?}")
        })
    }
}

impl FromStr for Move {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = named_numbers(text).and_then(|(name, numbers)| match numbers[..] {
            [x, y, z, yaw_deg] => Some(Self {
                name,
                position_m: DVec3::new(x, y, z),
                yaw_rad: yaw_deg.to_radians(),
            }),
            _ => None,
        });
        parsed.ok_or_else(|| {
            format!("expected NAME=X,Y,Z,YAW_DEG in meters and degrees, like car_03=12.5,-3,0.75,90, found {text:?}")
        })
    }
}

impl FromStr for Shift {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shift = |forward_m, left_m, yaw_deg: f64| {
            Pose::new(
                DQuat::from_rotation_z(yaw_deg.to_radians()),
                DVec3::new(forward_m, left_m, 0.0),
            )
        };
        let parsed = named_numbers(text).and_then(|(name, numbers)| match numbers[..] {
            [forward_m, left_m] => Some(Self {
                name,
                shift: shift(forward_m, left_m, 0.0),
            }),
            [forward_m, left_m, yaw_deg] => Some(Self {
                name,
                shift: shift(forward_m, left_m, yaw_deg),
            }),
            _ => None,
        });
        parsed.ok_or_else(|| {
            format!("expected NAME=FORWARD,LEFT[,YAW_DEG] in meters and degrees, like car_03=5,-3.5, found {text:?}")
        })
    }
}

impl FromStr for Times {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || {
            format!(
                "expected NAME=FROM,TO[,FROM,TO...] in seconds, like car_03=0,4.5,8,12, or NAME=always, found {text:?}"
            )
        };
        if let Some(name) = text.strip_suffix("=always") {
            return Ok(Self {
                name: named(name).ok_or_else(expected)?,
                present: Presence::ALWAYS,
            });
        }
        let (name, times_s) = named_numbers(text).ok_or_else(expected)?;
        let (pairs, []) = times_s.as_chunks::<2>() else {
            return Err(expected());
        };
        let present =
            Presence::new(pairs.to_vec()).map_err(|reason| format!("{text:?}: {reason}"))?;
        Ok(Self { name, present })
    }
}

fn named(name: &str) -> Option<String> {
    (!name.is_empty()).then(|| name.to_owned())
}

fn number(text: &str) -> Option<f64> {
    text.trim()
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite())
}

fn named_numbers(text: &str) -> Option<(String, Vec<f64>)> {
    let (name, numbers) = text.rsplit_once('=')?;
    Some((
        named(name)?,
        numbers.split(',').map(number).collect::<Option<_>>()?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_read() {
        let addition: Addition = "taxi=a=b, c.ply,1,-2.5,3e1,90".parse().unwrap();
        assert_eq!(
            (addition.name.as_str(), addition.asset),
            ("taxi", "a=b, c.ply".into())
        );
        assert_eq!(
            (addition.position_m, addition.yaw_rad),
            (DVec3::new(1.0, -2.5, 30.0), 90f64.to_radians())
        );
        assert_eq!(
            "a=b.ply".parse(),
            Ok(Swap {
                name: "a".into(),
                asset: "b.ply".into()
            })
        );
        let moved: Move = "a=1, 2 ,3,-180".parse().unwrap();
        assert_eq!(
            (moved.position_m, moved.yaw_rad),
            (DVec3::new(1.0, 2.0, 3.0), -std::f64::consts::PI)
        );
        let [two, three]: [Shift; 2] =
            ["a=5,-3.5", "a=5,-3.5,90"].map(|text| text.parse().unwrap());
        assert_eq!(
            two.shift,
            Pose {
                translation: DVec3::new(5.0, -3.5, 0.0),
                ..Pose::IDENTITY
            }
        );
        let times: Times = "a=b=0,4.5, 8,12".parse().unwrap();
        assert_eq!(
            (times.name.as_str(), times.present.intervals_s()),
            ("a=b", &[[0.0, 4.5], [8.0, 12.0]][..])
        );
        assert_eq!(
            "a=always".parse::<Times>().unwrap().present,
            Presence::ALWAYS
        );
        for nonsense in ["a", "a=", "a=1", "a=1,2,3", "a=2,1", "a=0,3,3,4", "=always"] {
            assert!(nonsense.parse::<Times>().unwrap_err().contains(nonsense));
        }
        assert!((three.shift.transform(DVec3::X) - DVec3::new(5.0, -2.5, 0.0)).length() < 1e-12);
    }

    #[test]
    fn nonsense_is_refused_with_what_was_found() {
        for nonsense in [
            "",
            "a",
            "a=",
            "=b.ply,1,2,3,4",
            "a=b.ply,1,2,3",
            "a=,1,2,3,4",
            "a=b.ply,1,2,x,4",
            "a=b.ply,1,2,inf,4",
        ] {
            assert!(
                nonsense
                    .parse::<Addition>()
                    .unwrap_err()
                    .contains(&format!("{nonsense:?}"))
            );
        }
        for nonsense in ["", "a", "a=", "=b.ply"] {
            assert!(
                nonsense
                    .parse::<Swap>()
                    .unwrap_err()
                    .contains(&format!("{nonsense:?}"))
            );
        }
        for nonsense in [
            "",
            "a=1,2,3",
            "a=1,2,3,4,5",
            "a=1,2,NaN,4",
            "=1,2,3,4",
            "a=1;2;3;4",
        ] {
            assert!(
                nonsense
                    .parse::<Move>()
                    .unwrap_err()
                    .contains(&format!("{nonsense:?}"))
            );
        }
        for nonsense in ["", "a=1", "a=1,2,3,4", "=1,2", "a=1,east"] {
            assert!(
                nonsense
                    .parse::<Shift>()
                    .unwrap_err()
                    .contains(&format!("{nonsense:?}"))
            );
        }
    }
}
