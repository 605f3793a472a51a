//! Ways to draw the same drive.

use std::str::FromStr;

use decouplegs::render::{ColorFormat, Outputs, RenderOptions, Storage};
use decouplegs::scene::{Rules, sh};

/// Representation of the agents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Agents {
    /// Copies of the original assets in world space, part of one cloud of splats.
    Copies {
        /// Share of that cloud that is kept, the most important splats; 1 keeps it as it is.
        keep: f64,
    },
    /// Compressed assets that move.
    Coded(Coding),
}

/// Compression options other than the defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coding {
    /// Share of the splats that are kept, instead of a threshold.
    pub keep: Option<f32>,
    /// Entries of the color codebook, and twice as many as of the shape codebook.
    pub colors: Option<usize>,
}

/// One way to draw the drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// Name as requested.
    pub name: String,
    /// Description for the reader of a report.
    pub what: String,
    pub agents: Agents,
    keep_keys: bool,
    level_pitch_px: Option<f64>,
    sh_degree_max: u8,
    overlap: bool,
    frames_in_flight: usize,
    pub storage: Storage,
    pub background_pitch_px: Option<f64>,
}

/// Default modes.
pub const DEFAULT_MODES: &str = "vanilla,decoupled";

const KNOWN: &str = "vanilla, prune[=SHARE], decoupled, decoupled-serial, compact, far[=PIXELS], lod[=PIXELS], sh0, sh1, sh2, \
                     keep=SHARE or colors=N";

/// Share that pruned baselines keep (Fan et al., LightGaussian, 2024: 66 % are pruned).
const PRUNE_KEEP: f64 = 0.34;
const LEVEL_PITCH_PX: f64 = 0.7;
const BACKGROUND_PITCH_PX: f64 = 2.0;
/// Least number of colors of a codebook; shapes have half as many.
const COLORS_MIN: f64 = 2.0;
const COLORS_MAX: f64 = decouplegs::scene::codebook::COLORS_MAX as f64;

impl Mode {
    /// Compressed agents that drive, drawn as exactly as can be; the other modes are this one with
    /// something changed.
    fn decoupled(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            what:
                "compressed agents that drive; the background's depth keys are kept while a camera does not turn, with the same \
                   images to the last bit; agents' updates overlap the frame before; 2 frames in flight"
                    .into(),
            agents: Agents::Coded(Coding::default()),
            keep_keys: true,
            level_pitch_px: None,
            sh_degree_max: sh::DEGREE_MAX,
            overlap: true,
            frames_in_flight: 2,
            storage: Storage::Exact,
            background_pitch_px: None,
        }
    }

    fn vanilla(name: &str) -> Self {
        Self {
            what:
                "the baseline: every agent is an uncompressed copy in world space, all depth keys are computed in every frame; \
                   2 frames in flight"
                    .into(),
            agents: Agents::Copies { keep: 1.0 },
            keep_keys: false,
            ..Self::decoupled(name)
        }
    }

    pub fn is_vanilla(&self) -> bool {
        self.agents == Agents::Copies { keep: 1.0 }
    }

    /// True if the mode is the renderer's own, without changes.
    pub fn is_decoupled(&self) -> bool {
        *self == Self::decoupled("decoupled")
    }

    pub fn options(&self, rules: Rules, color: ColorFormat) -> RenderOptions {
        RenderOptions {
            rules,
            outputs: Outputs {
                color,
                ..Outputs::default()
            },
            sh_degree_max: self.sh_degree_max,
            keep_keys: self.keep_keys,
            level_pitch_px: self.level_pitch_px,
            frames_in_flight: self.frames_in_flight,
            overlap: self.overlap,
            storage: self.storage,
            background_pitch_px: self.background_pitch_px,
            ..RenderOptions::default()
        }
    }
}

impl FromStr for Mode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (base, value) = text
            .split_once('=')
            .map_or((text, None), |(base, value)| (base, Some(value)));
        // A value where the mode takes one, its default where it is left out; an error where it is
        // out of its range.
        let number = |least: f64, most: f64, default: Option<f64>| match (value, default) {
            (None, Some(default)) => Ok(default),
            (given, _) => given
                .and_then(|given| given.parse().ok())
                .filter(|number| (least..=most).contains(number))
                .ok_or_else(|| {
                    format!(
                        "'{text}': {base} takes a number from {least} to {most}, such as {base}={}",
                        default.unwrap_or(most)
                    )
                }),
        };
        let decoupled = Self::decoupled(text);
        let coded = |keep, colors, how: String| Self {
            agents: Agents::Coded(Coding { keep, colors }),
            what: format!("decoupled, assets compressed {how}"),
            ..Self::decoupled(text)
        };
        Ok(match (base, value) {
            ("vanilla", None) => Self::vanilla(text),
            ("prune", _) => {
                let keep = number(1e-6, 1.0, Some(PRUNE_KEEP))?;
                Self {
                    agents: Agents::Copies { keep },
                    what: format!(
                        "vanilla with {keep} of all splats kept, by their weights in the ego's views and their volume"
                    ),
                    ..Self::vanilla(text)
                }
            }
            ("decoupled", None) => decoupled,
            ("decoupled-serial", None) => {
                Self {
                    overlap: false,
                    frames_in_flight: 1,
                    what: "decoupled, the agents' updates in line with the rest of the frame, 1 frame in flight".into(),
                    ..decoupled
                }
            }
            ("compact", None) => Self {
                storage: Storage::Compact,
                what:
                    "decoupled, the background in compact storage, 120 bytes per splat of degree 3"
                        .into(),
                ..decoupled
            },
            ("far", _) => {
                let pitch_px = number(0.01, 1000.0, Some(BACKGROUND_PITCH_PX))?;
                Self {
                    background_pitch_px: Some(pitch_px),
                    what: format!(
                        "decoupled, the background with fewer splats where they lie at most {pitch_px} px apart"
                    ),
                    ..decoupled
                }
            }
            ("lod", _) => {
                let pitch_px = number(0.01, 1000.0, Some(LEVEL_PITCH_PX))?;
                Self {
                    level_pitch_px: Some(pitch_px),
                    what: format!(
                        "decoupled, agents at the coarsest level whose splats are at most {pitch_px} px apart"
                    ),
                    ..decoupled
                }
            }
            ("sh0" | "sh1" | "sh2", None) => {
                let sh_degree_max = base.as_bytes()[2] - b'0';
                Self {
                    sh_degree_max,
                    what: format!("decoupled, colors evaluated to degree {sh_degree_max}"),
                    ..decoupled
                }
            }
            ("keep", _) => {
                let keep = number(1e-6, 1.0, None)? as f32;
                coded(Some(keep), None, format!("with {keep} of their splats kept"))
            }
            ("colors", _) => {
                let colors = number(COLORS_MIN, COLORS_MAX, None)? as usize;
                let what = format!("with {colors} colors and {} shapes", colors / 2);
                coded(None, Some(colors), what)
            }
            _ => return Err(format!("'{text}' is no mode: there are {KNOWN}")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_by_default_is_one() {
        let modes = |list: &str| -> Vec<Mode> {
            list.split(',').map(|name| name.parse().unwrap()).collect()
        };
        assert_eq!(
            modes(DEFAULT_MODES)
                .iter()
                .map(|mode| mode.name.as_str())
                .collect::<Vec<_>>(),
            ["vanilla", "decoupled"]
        );
        let modes = modes("vanilla,prune,decoupled,decoupled-serial,lod,sh1,sh0");
        assert!(
            modes[0].is_vanilla() && modes.iter().filter(|mode| mode.is_vanilla()).count() == 1
        );
        assert_eq!(modes[1].agents, Agents::Copies { keep: 0.34 });
        let serial = modes[3].options(Rules::DEFAULT, ColorFormat::U8);
        assert_eq!(
            (serial.overlap, serial.frames_in_flight, serial.keep_keys),
            (false, 1, true)
        );
    }

    #[test]
    fn values_are_read_and_nonsense_is_refused_with_what_there_is() {
        let lod: Mode = "lod=1.5".parse().unwrap();
        assert_eq!(
            lod.options(Rules::DEFAULT, ColorFormat::F32).level_pitch_px,
            Some(1.5)
        );
        let few: Mode = "colors=64".parse().unwrap();
        assert_eq!(
            few.agents,
            Agents::Coded(Coding {
                keep: None,
                colors: Some(64)
            })
        );
        for nonsense in ["", "vanila", "vanilla=1", "sh3", "sh", "decoupled=2"] {
            assert!(
                nonsense
                    .parse::<Mode>()
                    .unwrap_err()
                    .contains("decoupled-serial"),
                "{nonsense}"
            );
        }
        for nonsense in [
            "prune=0",
            "prune=2",
            "lod=",
            "lod=-1",
            "lod=NaN",
            "keep",
            "keep=x",
            "colors=5000",
        ] {
            assert!(
                nonsense.parse::<Mode>().unwrap_err().contains("from"),
                "{nonsense}"
            );
        }
    }
}
