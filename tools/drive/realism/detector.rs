//! Detectors: models in ONNX, which a Python with onnxruntime runs in a process of its own.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use decouplegs::render::rendered_image::Image;
use serde_json::{Value, json};

/// The program that runs the model. It is handed over as text, so that nothing needs to be
/// installed but onnxruntime and NumPy.
const PROGRAM: &str = include_str!("../../python/decouplegs/detect.py");
/// The variable that names another Python than `python3`.
const PYTHON: &str = "DECOUPLEGS_PYTHON";
/// Bytes of an answer, at most.
const ANSWER_BYTES_MAX: u64 = 1 << 26;

/// Colors and numbers that a model is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DetectorInput {
    /// Usual input of models of its layout
    #[default]
    Auto,
    /// Red, green, blue from 0 to 1
    #[value(name = "rgb-1")]
    Rgb1,
    /// Red, green, blue from 0 to 255
    #[value(name = "rgb-255")]
    Rgb255,
    /// Blue, green, red from 0 to 1
    #[value(name = "bgr-1")]
    Bgr1,
    /// Blue, green, red from 0 to 255
    #[value(name = "bgr-255")]
    Bgr255,
    /// Red, green, blue less ImageNet's mean, over its deviation
    RgbImagenet,
}

/// A detector to run on images.
#[derive(clap::Args, Clone, Debug)]
pub struct DetectorArguments {
    /// Run this detector on photographs, on rendered images, and as a control on photographs of
    /// half the size: outputs as those of YOLOv5, YOLOv8, YOLOv10, YOLOX, DETR or SSD. Needs a
    /// Python with onnxruntime: python3, or DECOUPLEGS_PYTHON
    #[arg(long, value_name = "MODEL.onnx", conflicts_with = "detections")]
    detector: Option<PathBuf>,
    /// Least score of detections
    #[arg(long, value_name = "0..1", default_value_t = 0.3, value_parser = share, requires = "detector")]
    detector_score: f64,
    /// Colors and numbers that the detector is given
    #[arg(long, value_enum, default_value_t, requires = "detector")]
    detector_input: DetectorInput,
}

fn share(text: &str) -> Result<f64, String> {
    let share: Option<f64> = text.parse().ok();
    share
        .filter(|share| (0.0..=1.0).contains(share))
        .ok_or_else(|| format!("expected a score from 0 to 1, found {text:?}"))
}

/// A detector that runs.
pub struct Detector {
    model: PathBuf,
    child: Child,
    images: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    /// Layout of the model's outputs, from the first image on.
    layout: Option<String>,
}

impl DetectorArguments {
    /// Starts the detector that is asked for.
    ///
    /// # Errors
    /// Returns an error if the model cannot be used, or no Python with onnxruntime be started.
    pub fn start(&self) -> Result<Option<Detector>> {
        let Some(model) = &self.detector else {
            return Ok(None);
        };
        ensure!(
            model.is_file(),
            "{} is no file; expected a model in ONNX",
            model.display()
        );
        let python = std::env::var_os(PYTHON).unwrap_or_else(|| "python3".into());
        let input = self.detector_input.to_possible_value();
        let input = input.expect("every kind has a name");
        let mut child = Command::new(&python)
            .args(["-B", "-c", PROGRAM])
            .arg(model)
            .arg(self.detector_score.to_string())
            .arg(input.get_name())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| {
                format!(
                    "{} cannot be started: name a Python that has onnxruntime in {PYTHON}",
                    Path::new(&python).display()
                )
            })?;
        let (images, answers) = (child.stdin.take(), child.stdout.take());
        let mut detector = Detector {
            model: model.clone(),
            images,
            answers: BufReader::new(answers.expect("its output is piped")),
            child,
            layout: None,
        };
        let ready = detector.answer()?;
        ensure!(
            ready.get("inputs").is_some(),
            detector.not_understood(&ready)
        );
        Ok(Some(detector))
    }
}

impl Detector {
    /// Model and layout of its outputs.
    pub fn name(&self) -> String {
        let layout = self.layout.as_deref().unwrap_or("no image seen");
        format!("{} ({layout})", self.model.display())
    }

    /// Detections in `image`: a list of `category_id`, `bbox` and `score`.
    ///
    /// # Errors
    /// Returns an error with what the model's program says, if it ends or answers something else.
    pub fn detect(&mut self, image: &Image) -> Result<Value> {
        let sent = self.send(image);
        // What the program says of itself tells more than a broken pipe.
        let answer = self.answer()?;
        sent.with_context(|| format!("{} takes no images", self.model.display()))?;
        let layout = answer.get("layout").and_then(Value::as_str);
        let (Some(layout), Some(found)) = (layout, answer.get("detections")) else {
            bail!(self.not_understood(&answer));
        };
        self.layout = Some(layout.to_owned());
        Ok(found.clone())
    }

    fn send(&mut self, image: &Image) -> std::io::Result<()> {
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        let pixels: Vec<u8> = image
            .rgb
            .iter()
            .flatten()
            .map(|value| byte(*value))
            .collect();
        let head = json!({ "width": image.width, "height": image.height });
        let images = self.images.as_mut().ok_or(std::io::ErrorKind::BrokenPipe)?;
        writeln!(images, "{head}")?;
        images.write_all(&pixels)?;
        images.flush()
    }

    fn answer(&mut self) -> Result<Value> {
        let mut line = String::new();
        let unreadable = || format!("the detector {} answers no text", self.model.display());
        (&mut self.answers)
            .take(ANSWER_BYTES_MAX)
            .read_line(&mut line)
            .with_context(unreadable)?;
        ensure!(
            !line.is_empty(),
            "the detector {} ended before it answered",
            self.model.display()
        );
        let value: Value = serde_json::from_str(&line).with_context(unreadable)?;
        if let Some(error) = value.get("error").and_then(Value::as_str) {
            bail!("the detector {}: {error}", self.model.display());
        }
        Ok(value)
    }

    fn not_understood(&self, value: &Value) -> String {
        format!("the detector {} answers {value}", self.model.display())
    }
}

impl Drop for Detector {
    fn drop(&mut self) {
        // It ends with the stream of images; one that hangs in a model does not.
        drop(self.images.take());
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
