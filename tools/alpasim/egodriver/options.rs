//! Address of a driver, and options of what it is shown.

use std::fmt;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use decouplegs::planner::Frame;
use decouplegs::scene::Invalid;
use decouplegs_cli::arguments::seconds_within;

use crate::encoding::{Encoding, encode};

/// Quality of JPEG images, as AlpaSim asks for it.
const QUALITY: u8 = 95;
/// Default of [`DriverOptions::driver_warm_up`], seconds: AlpaSim's Transfuser needs as long.
const WARM_UP_S: f64 = 3.0;

/// Address of a driver: `egodriver://HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DriverAddress {
    authority: String,
}

impl DriverAddress {
    /// Beginning of an address.
    pub const SCHEME: &str = "egodriver://";

    /// The address as gRPC takes it.
    #[must_use]
    pub fn uri(&self) -> String {
        format!("http://{}", self.authority)
    }
}

impl FromStr for DriverAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let authority = text.strip_prefix(Self::SCHEME).unwrap_or_default();
        let parsed = authority.parse::<http::uri::Authority>().ok();
        match parsed.filter(|parsed| parsed.port().is_some() && !authority.contains('@')) {
            Some(_) => Ok(Self {
                authority: authority.to_owned(),
            }),
            None => Err(format!("expected egodriver://HOST:PORT, found {text:?}")),
        }
    }
}

impl fmt::Display for DriverAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", Self::SCHEME, self.authority)
    }
}

/// Camera of the rig, and its name for the driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraChoice {
    /// Name in the rig.
    pub name: String,
    /// Name for the driver.
    pub logical_id: String,
}

impl FromStr for CameraChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, logical_id) = text.split_once('=').unwrap_or((text, text));
        if name.is_empty() || logical_id.is_empty() {
            return Err(format!("expected CAMERA or CAMERA=ID, found {text:?}"));
        }
        Ok(Self {
            name: name.to_owned(),
            logical_id: logical_id.to_owned(),
        })
    }
}

impl fmt::Display for CameraChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.logical_id)
    }
}

/// Lens of the cameras of a driver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SensorLens {
    /// The lens in the scene file.
    #[default]
    Own,
    /// An f-theta lens that shows the same angles at the left and right edge of the image.
    FTheta,
}

/// File format of the images that a driver gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ImageFile {
    /// PNG, without losses.
    #[default]
    Png,
    /// JPEG of quality 95.
    Jpeg,
}

impl ImageFile {
    /// The file of `frame`.
    ///
    /// # Errors
    /// A sentence, when the format cannot hold the size.
    pub fn encode(self, frame: &Frame) -> Result<Vec<u8>, String> {
        let k = &frame.camera.intrinsics;
        let encoding = match self {
            Self::Png => Encoding::Png,
            Self::Jpeg => Encoding::Jpeg { quality: QUALITY },
        };
        encode(frame.rgba, [k.width_px, k.height_px], encoding)
    }
}

/// End of a route with fewer than 20 points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Padding {
    /// Points of NaN up to 20, as AlpaSim sends them.
    #[default]
    Nan,
    /// No further points.
    None,
}

/// Options of what a driver is shown.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Drivers of AlpaSim (--planner egodriver://HOST:PORT)")]
pub struct DriverOptions {
    /// Camera that the driver gets, and its name for the driver, such as
    /// `front=camera_front_wide_120fov`. May be repeated [default: all, by their own names]
    #[arg(long, value_name = "CAMERA[=ID]")]
    pub driver_camera: Vec<CameraChoice>,
    /// Lens of its cameras: `f-theta` draws them with an f-theta lens of the same horizontal field
    /// of view, which AlpaSim's own drivers expect
    #[arg(
        long,
        value_name = "own|f-theta",
        value_enum,
        default_value_t,
        hide_possible_values = true
    )]
    pub driver_lens: SensorLens,
    /// File format of its images; JPEG has quality 95
    #[arg(
        long,
        value_name = "png|jpeg",
        value_enum,
        default_value_t,
        hide_possible_values = true
    )]
    pub driver_images: ImageFile,
    /// End of its route near the goal: `nan` fills it up to 20 points as AlpaSim does, `none` sends
    /// the points that there are
    #[arg(
        long,
        value_name = "nan|none",
        value_enum,
        default_value_t,
        hide_possible_values = true
    )]
    pub driver_padding: Padding,
    /// Time since the start in which the driver may answer without a plan: the ego then follows its
    /// route at its speed, and the log and the score say so. Later, it stands
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = WARM_UP_S, value_parser = seconds)]
    pub driver_warm_up: f64,
    /// Tell the driver the name of the scenario
    #[arg(long)]
    pub tell_scene: bool,
}

impl Default for DriverOptions {
    fn default() -> Self {
        Self {
            driver_camera: Vec::new(),
            driver_lens: SensorLens::default(),
            driver_images: ImageFile::default(),
            driver_padding: Padding::default(),
            driver_warm_up: WARM_UP_S,
            tell_scene: false,
        }
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    seconds_within(text, &(0.0..=60.0))
}

impl DriverOptions {
    /// Checks that each camera has one name, and each name is that of one camera.
    ///
    /// # Errors
    /// A sentence naming what is there twice.
    pub fn check(&self) -> Result<(), Invalid> {
        for (index, choice) in self.driver_camera.iter().enumerate() {
            let before = &self.driver_camera[..index];
            if before.iter().any(|other| other.name == choice.name) {
                let reason = format!("--driver-camera names camera {:?} twice", choice.name);
                return Err(Invalid::new(reason));
            }
            if before
                .iter()
                .any(|other| other.logical_id == choice.logical_id)
            {
                let id = &choice.logical_id;
                let reason = format!("--driver-camera gives the name {id:?} to two cameras");
                return Err(Invalid::new(reason));
            }
        }
        Ok(())
    }

    /// Names of the chosen cameras in the rig; none for all.
    #[must_use]
    pub fn camera_names(&self) -> Vec<String> {
        let names = self.driver_camera.iter().map(|choice| choice.name.clone());
        names.collect()
    }

    /// Name of the camera `name` for the driver.
    #[must_use]
    pub fn logical_id<'a>(&'a self, name: &'a str) -> &'a str {
        let mut choices = self.driver_camera.iter();
        let choice = choices.find(|choice| choice.name == name);
        choice.map_or(name, |choice| &choice.logical_id)
    }

    /// The options, for the settings of a run.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        let cameras = self.driver_camera.iter().map(ToString::to_string);
        serde_json::json!({
            "cameras": cameras.collect::<Vec<_>>(),
            "f_theta": self.driver_lens == SensorLens::FTheta,
            "jpeg": self.driver_images == ImageFile::Jpeg,
            "nan": self.driver_padding == Padding::Nan,
            "warm_up": self.driver_warm_up,
            "tell_scene": self.tell_scene,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_back_and_others_are_refused() {
        for text in [
            "egodriver://localhost:50051",
            "egodriver://[::1]:1",
            "egodriver://10.0.0.1:80",
        ] {
            let address: DriverAddress = text.parse().unwrap();
            assert_eq!(address.to_string(), text);
            assert!(address.uri().starts_with("http://"));
        }
        for text in [
            "egodriver://",
            "egodriver://host",
            "host:1",
            "egodriver://a@b:1",
            "egodriver://h:1/x",
        ] {
            let refused = text.parse::<DriverAddress>().unwrap_err();
            assert!(refused.contains("egodriver://HOST:PORT"), "{refused}");
        }
    }

    #[test]
    fn cameras_have_the_names_that_the_driver_knows() {
        let options = DriverOptions {
            driver_camera: vec![
                "front=camera_front_wide_120fov".parse().unwrap(),
                "rear".parse().unwrap(),
            ],
            ..DriverOptions::default()
        };
        assert_eq!(options.camera_names(), ["front", "rear"]);
        assert_eq!(options.logical_id("front"), "camera_front_wide_120fov");
        assert_eq!(options.logical_id("rear"), "rear");
        assert!(options.check().is_ok());
        for (twice, said) in [
            ("front=a", "camera \"front\" twice"),
            ("left=rear", "name \"rear\""),
        ] {
            let mut twice_named = options.clone();
            twice_named.driver_camera.push(twice.parse().unwrap());
            let refused = twice_named.check().unwrap_err();
            assert!(refused.reason().contains(said), "{refused}");
        }
        for text in ["", "=x", "x="] {
            assert!(text.parse::<CameraChoice>().is_err(), "{text}");
        }
    }
}
