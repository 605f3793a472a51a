//! The steps of a command line, in its order.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::builder::{OsStringValueParser, StringValueParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, ArgGroup, ArgMatches, Command, Error, FromArgMatches};
use decouplegs_scene::Similarity;
use glam::{DQuat, DVec3, EulerRot};

/// Largest coordinate, meters.
const PLACE_MAX: f64 = 1e12;
/// Scales are within this factor of 1, either way.
const SCALE_MAX: f64 = 1e9;
/// Largest departure of a quaternion's length from 1.
const LENGTH_SPARE: f64 = 1e-3;
/// Share of the splats below which a group that stands alone is a floater.
const FLOATER_SHARE: &str = "0.001";

/// A change of all splats, or of some.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Turns, scales or moves.
    Move(Similarity),
    /// Leaves splats whose means are in a box.
    CropBox { min: DVec3, max: DVec3 },
    /// Leaves splats whose means are in a sphere.
    CropSphere { center: DVec3, radius_m: f64 },
    /// Leaves splats of at least this opacity.
    DropFaint(f32),
    /// Leaves out groups of fewer than this share of the splats that stand alone.
    DropFloaters(f64),
    /// Adds the splats of another file.
    Merge(PathBuf),
}

/// An option that is a step.
struct StepOption {
    name: &'static str,
    values: &'static str,
    help: &'static str,
    parse: fn(&str) -> Result<Step, String>,
}

const OPTIONS: [StepOption; 8] = [
    StepOption {
        name: "translate",
        values: "X,Y,Z",
        help: "Move by X,Y,Z meters",
        parse: |text| Ok(moved(Similarity::from_translation(three(text)?))),
    },
    StepOption {
        name: "rotate-deg",
        values: "X,Y,Z",
        help: "Turn by X degrees around the x axis, then Y around the y axis, then Z around the z axis; \
               the axes stand still",
        parse: |text| {
            let [x, y, z] = three(text)?.to_array().map(f64::to_radians);
            let turn = DQuat::from_euler(EulerRot::ZYX, z, y, x);
            Ok(moved(Similarity::from_rotation(turn)))
        },
    },
    StepOption {
        name: "quaternion",
        values: "W,X,Y,Z",
        help: "Turn by a unit quaternion",
        parse: quaternion,
    },
    StepOption {
        name: "axes",
        values: "FROM:TO",
        help: "Turn so that what is up along FROM is up along TO: x, y, z, -x, -y or -z. `-y:z` makes z up \
               in what was trained from COLMAP, and in a .glb, which is turned to that when it is read. \
               z-up is short for y:z, and y-up for z:y",
        parse: axes,
    },
    StepOption {
        name: "scale",
        values: "FACTOR",
        help: "Scale positions and sizes by FACTOR, above 0",
        parse: |text| {
            let factor = text.parse().ok();
            let factor =
                factor.filter(|&factor: &f64| (SCALE_MAX.recip()..=SCALE_MAX).contains(&factor));
            let factor = factor
                .ok_or_else(|| format!("expected a factor from 1e-9 to 1e9, found {text:?}"))?;
            Ok(moved(Similarity::from_scale(factor)))
        },
    },
    StepOption {
        name: "crop-box",
        values: "X0,Y0,Z0,X1,Y1,Z1",
        help: "Leave out splats whose positions are not in the box between two corners, the lower one first",
        parse: crop_box,
    },
    StepOption {
        name: "crop-sphere",
        values: "X,Y,Z,RADIUS",
        help: "Leave out splats whose positions are farther than RADIUS from a point",
        parse: crop_sphere,
    },
    StepOption {
        name: "drop-faint",
        values: "OPACITY",
        help: "Leave out splats of less than this opacity, 0 to 1",
        parse: |text| {
            let least = text
                .parse()
                .ok()
                .filter(|least| (0.0..=1.0).contains(least));
            let least =
                least.ok_or_else(|| format!("expected an opacity from 0 to 1, found {text:?}"))?;
            Ok(Step::DropFaint(least))
        },
    },
];

/// Name of the option whose value may be left out.
const DROP_FLOATERS: &str = "drop-floaters";
/// Name of the option whose value is a path.
const MERGE: &str = "merge";

/// Steps, each with the words that ask for it.
#[derive(Clone, Debug, Default)]
pub struct Steps(Vec<(String, Step)>);

impl Steps {
    pub fn in_order(&self) -> impl Iterator<Item = (&str, &Step)> {
        self.0.iter().map(|(words, step)| (words.as_str(), step))
    }

    /// Files that are merged.
    pub fn merged(&self) -> impl Iterator<Item = &Path> {
        self.0.iter().filter_map(|(_, step)| match step {
            Step::Merge(path) => Some(path.as_path()),
            _ => None,
        })
    }
}

/// The option `name`, whose values `parse` makes steps of.
fn option(name: &'static str, values: &'static str, help: &'static str) -> Arg {
    Arg::new(name)
        .long(name)
        .value_name(values)
        .help(help)
        .action(ArgAction::Append)
        .allow_hyphen_values(true)
        .help_heading("Steps")
}

// By hand: derived options forget the order among them.
impl clap::Args for Steps {
    fn augment_args(command: Command) -> Command {
        let words = |name: &'static str| move |text: &str| format!("--{name} {text}");
        let mut command = command;
        for StepOption {
            name,
            values,
            help,
            parse,
        } in OPTIONS
        {
            let parser = StringValueParser::new()
                .try_map(move |text: String| parse(&text).map(|step| (words(name)(&text), step)));
            command = command.arg(option(name, values, help).value_parser(parser));
        }
        let floaters = StringValueParser::new().try_map(|text: String| {
            floater_share(&text).map(|step| (format!("--{DROP_FLOATERS}={text}"), step))
        });
        let help = "Leave out small groups of splats in empty space: those of fewer than SHARE of all \
                    splats (default: 0.001) that touch no others. Sparse background far away goes too";
        let merge = OsStringValueParser::new().map(|path: OsString| {
            let path = PathBuf::from(path);
            (format!("--{MERGE} {}", path.display()), Step::Merge(path))
        });
        let names = OPTIONS.map(|option| option.name);
        command
            .arg(
                option(DROP_FLOATERS, "SHARE", help)
                    .num_args(0..=1)
                    .require_equals(true)
                    .default_missing_value(FLOATER_SHARE)
                    .value_parser(floaters),
            )
            .arg(option(MERGE, "FILE", "Add the splats of another file").value_parser(merge))
            .group(
                ArgGroup::new("step")
                    .args(names)
                    .args([DROP_FLOATERS, MERGE])
                    .required(true)
                    .multiple(true),
            )
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Steps {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let names = OPTIONS.map(|option| option.name);
        let mut steps = Vec::new();
        for name in names.into_iter().chain([DROP_FLOATERS, MERGE]) {
            let given = matches
                .try_get_many::<(String, Step)>(name)
                .map_err(|_| Error::new(ErrorKind::InvalidValue))?;
            let places = matches.indices_of(name).into_iter().flatten();
            steps.extend(places.zip(given.into_iter().flatten().cloned()));
        }
        steps.sort_by_key(|(place, _)| *place);
        Ok(Self(steps.into_iter().map(|(_, step)| step).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn moved(similarity: Similarity) -> Step {
    Step::Move(similarity)
}

/// `N` coordinates with commas between them.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number = |part: &str| {
        let number = part.trim().parse().ok();
        number.filter(|number: &f64| number.abs() <= PLACE_MAX)
    };
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    numbers?.try_into().ok()
}

fn three(text: &str) -> Result<DVec3, String> {
    let parsed = numbers(text).map(DVec3::from_array);
    parsed.ok_or_else(|| {
        format!("expected three numbers of at most 1e12 like 1.5,0,-2, found {text:?}")
    })
}

fn quaternion(text: &str) -> Result<Step, String> {
    let parsed = numbers(text).map(|[w, x, y, z]| DQuat::from_xyzw(x, y, z, w));
    let unit = parsed.filter(|turn| (turn.length() - 1.0).abs() <= LENGTH_SPARE);
    let unit = unit.ok_or_else(|| {
        format!("expected four numbers w,x,y,z of length 1 like 0.8,0,-0.6,0, found {text:?}")
    })?;
    Ok(moved(Similarity::from_rotation(unit)))
}

fn axes(text: &str) -> Result<Step, String> {
    let text = match text {
        "z-up" => "y:z",
        "y-up" => "z:y",
        other => other,
    };
    let axis = |name: &str| {
        let (sign, name) = name
            .strip_prefix('-')
            .map_or((1.0, name), |name| (-1.0, name));
        let known = ["x", "y", "z"].iter().position(|known| *known == name);
        known.map(|known| sign * DVec3::AXES[known])
    };
    let parsed = text
        .split_once(':')
        .and_then(|(from, to)| Some((axis(from)?, axis(to)?)));
    let (from, to) = parsed.ok_or_else(|| {
        format!("expected z-up, y-up, or two of x, y, z, -x, -y and -z like -y:z, found {text:?}")
    })?;
    Ok(moved(Similarity::from_axes(from, to)))
}

fn crop_box(text: &str) -> Result<Step, String> {
    let corners = numbers(text)
        .map(|[x0, y0, z0, x1, y1, z1]| (DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)));
    let corners = corners.filter(|(min, max)| min.cmple(*max).all());
    let (min, max) = corners.ok_or_else(|| {
        format!("expected six numbers, the lower corner first, like -1,-1,0,1,1,2, found {text:?}")
    })?;
    Ok(Step::CropBox { min, max })
}

fn crop_sphere(text: &str) -> Result<Step, String> {
    let sphere = numbers(text).filter(|sphere: &[f64; 4]| sphere[3] > 0.0);
    let [x, y, z, radius_m] = sphere.ok_or_else(|| {
        format!("expected a center and a radius above 0 like 0,0,1,2.5, found {text:?}")
    })?;
    Ok(Step::CropSphere {
        center: DVec3::new(x, y, z),
        radius_m,
    })
}

fn floater_share(text: &str) -> Result<Step, String> {
    let share = text
        .parse()
        .ok()
        .filter(|share| *share > 0.0 && *share < 1.0);
    let share = share.ok_or_else(|| format!("expected a share between 0 and 1, found {text:?}"))?;
    Ok(Step::DropFloaters(share))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Only {
        #[command(flatten)]
        steps: Steps,
    }

    fn parsed(words: &[&str]) -> Result<Vec<String>, Error> {
        let only = Only::try_parse_from([&["transform"], words].concat())?;
        Ok(only
            .steps
            .in_order()
            .map(|(words, _)| words.to_owned())
            .collect())
    }

    #[test]
    fn steps_come_in_the_order_of_the_command_line() {
        let steps = parsed(&[
            "--scale",
            "2",
            "--drop-floaters",
            "--merge",
            "a.ply",
            "--translate",
            "-1,0,0",
            "--scale=3",
            "--drop-floaters=0.5",
        ]);
        assert_eq!(
            steps.unwrap(),
            [
                "--scale 2",
                "--drop-floaters=0.001",
                "--merge a.ply",
                "--translate -1,0,0",
                "--scale 3",
                "--drop-floaters=0.5",
            ]
        );
        assert!(parsed(&[]).unwrap_err().to_string().contains("--translate"));
    }

    #[test]
    fn numbers_that_mean_nothing_are_refused() {
        for words in [
            ["--scale", "0"],
            ["--scale", "-1"],
            ["--scale", "NaN"],
            ["--scale", "inf"],
            ["--scale", "1e300"],
            ["--translate", "1,2"],
            ["--translate", "1,2,nan"],
            ["--translate", "inf,0,0"],
            ["--rotate-deg", "1,2,3,4"],
            ["--quaternion", "0,0,0,0"],
            ["--quaternion", "2,0,0,0"],
            ["--quaternion", "nan,0,0,1"],
            ["--axes", "z"],
            ["--axes", "y:w"],
            ["--axes", ""],
            ["--crop-box", "1,0,0,0,1,1"],
            ["--crop-box", "0,0,0,1,1"],
            ["--crop-sphere", "0,0,0,0"],
            ["--crop-sphere", "0,0,0,-2"],
            ["--crop-sphere", "0,0,0,NaN"],
            ["--drop-faint", "1.5"],
            ["--drop-faint", "NaN"],
            ["--drop-floaters=0", "--drop-floaters"],
            ["--drop-floaters=nan", "--drop-floaters"],
        ] {
            let Err(error) = parsed(&words) else {
                panic!("{words:?} was taken");
            };
            assert_eq!(error.exit_code(), 2, "{words:?}");
            assert!(error.to_string().contains("expected"), "{error}");
        }
    }

    #[test]
    fn turns_are_around_axes_that_stand_still() {
        let turned = |option: fn(&str) -> Result<Step, String>, text: &str| match option(text) {
            Ok(Step::Move(similarity)) => similarity.transform(DVec3::new(1.0, 2.0, 3.0)),
            other => panic!("{other:?}"),
        };
        let near = |found: DVec3, expected: [f64; 3]| {
            assert!(
                (found - DVec3::from_array(expected)).length() < 1e-12,
                "{found}"
            );
        };
        // Around x: (1, -3, 2); then around z: (3, 1, 2).
        near(turned(OPTIONS[1].parse, "90,0,90"), [3.0, 1.0, 2.0]);
        near(turned(axes, "z-up"), [1.0, -3.0, 2.0]);
        near(turned(axes, "y-up"), [1.0, 3.0, -2.0]);
        near(turned(axes, "-y:z"), [1.0, 3.0, -2.0]);
        near(turned(quaternion, "0,0,0,1"), [-1.0, -2.0, 3.0]);
    }
}
