//! The system in full, and without one part after the other.

use anyhow::{Context, Result};
use decouplegs::render::metrics::{MaskedDifference, MaskedErrors};
use decouplegs::render::{FrameSplats, Image};
use decouplegs::scene::Trajectory;
use decouplegs::synth::street::Weather;

use super::placing::{Drift, Placing, Tracks};
use super::reinsert::{Arm, Reinserted, Reinsertion, Sample, agents_at, unlight};
use super::speed::Speed;
use crate::stress::figures::Measured;

/// Part that is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Without {
    Nothing,
    Compression,
    CompressionFresh,
    Registration,
    Relighting,
}

impl Without {
    pub const ALL: [Self; 5] = [
        Self::Nothing,
        Self::Compression,
        Self::CompressionFresh,
        Self::Registration,
        Self::Relighting,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "full",
            Self::Compression => "no asset compression",
            Self::CompressionFresh => "no asset compression, copies that drive",
            Self::Registration => "no map-guided registration",
            Self::Relighting => "no relighting",
        }
    }

    /// Description for the reader of a report.
    pub fn what(self) -> &'static str {
        match self {
            Self::Nothing => {
                "compressed cars on registered tracks, relit, with contact shadows; 2 frames in flight"
            }
            Self::Compression => {
                "whole cars as copies in one cloud, relit once; all splats are sorted in every frame; 2 frames in flight. The copies \
                 stand where they are in the middle of the drive, which flatters its speed"
            }
            Self::CompressionFresh => {
                "the same with copies relit, placed and uploaded anew in each frame, so that they drive as in the full system; \
                 1 frame in flight"
            }
            Self::Registration => "the full system with tracks as logged",
            Self::Relighting => "the full system with cars in neutral light and without shadows",
        }
    }

    /// FPS, ADE in meters and PAE in degrees of the paper's table 4.
    pub fn paper(self) -> Option<[f64; 3]> {
        match self {
            Self::Nothing => Some([35.4, 0.05, 6.8]),
            Self::Compression => Some([8.5, 0.05, 6.8]),
            Self::CompressionFresh => None,
            Self::Registration => Some([36.2, 0.48, 6.8]),
            Self::Relighting => Some([38.5, 0.05, 48.5]),
        }
    }

    fn arm(self) -> Arm {
        match self {
            Self::Nothing | Self::Registration => Arm::Ours,
            Self::Compression | Self::CompressionFresh => Arm::OursUncompressed,
            Self::Relighting => Arm::NoRelighting,
        }
    }
}

/// One row.
pub struct SystemRow {
    pub without: Without,
    pub speed: Measured,
    pub placing: Placing,
    /// Errors over vehicles' pixels, cars at their true poses.
    pub at_truth: MaskedDifference,
    /// Errors over vehicles' pixels, cars where this row's tracks put them.
    pub as_placed: MaskedDifference,
}

/// All rows.
pub struct System {
    pub weather: Weather,
    pub rows: Vec<SystemRow>,
    /// Splats of the background, and in all with whole cars.
    pub splats: [usize; 2],
    pub start_s: f64,
}

impl Reinsertion<'_> {
    /// Every row, in the street of this stage; `samples` are of true images, `measured` of cars at
    /// true poses.
    pub fn system(
        &self,
        drift: &Drift,
        samples: &[Sample],
        measured: &Reinserted,
        frames: u32,
    ) -> Result<System> {
        let tracks = Tracks::register(self.stage, drift)?;
        let speed = Speed::over(self.gpu, &self.stage.loaded, frames);
        let middle_s = speed.schedule.middle_s();
        let mut rows = Vec::new();
        for without in Without::ALL {
            let placed = if without == Without::Registration {
                &tracks.logged
            } else {
                &tracks.registered
            };
            let mut driven = self.stage.driven(&placed.ways);
            if without == Without::Relighting {
                driven.light = None;
            }
            let measured_speed = match without {
                Without::Nothing | Without::Registration | Without::Relighting => {
                    speed.of_coded(&driven)?
                }
                Without::Compression | Without::CompressionFresh => {
                    let world = self.world(&driven)?;
                    let copies_at = |time_s| self.copies(&agents_at(&world, time_s));
                    match without {
                        Without::Compression => speed.of_copies(copies_at(middle_s))?,
                        _ => speed.of_fresh_copies(copies_at)?,
                    }
                }
            };
            let at_truth = measured
                .arms
                .iter()
                .find(|figures| figures.arm == without.arm());
            rows.push(SystemRow {
                without,
                speed: measured_speed,
                placing: placed.placing,
                at_truth: at_truth.context("an arm was not measured")?.vehicles,
                as_placed: self.as_placed(without, &placed.ways, samples)?,
            });
        }
        let background = self.stage.loaded.splat_scene.splats.len();
        let whole = self
            .stage
            .loaded
            .agents
            .iter()
            .map(|agent| self.cars.originals[agent.asset].len())
            .sum::<usize>();
        let splats = [background, background + whole];
        Ok(System {
            weather: self.stage.weather(),
            rows,
            splats,
            start_s: speed.schedule.start_s,
        })
    }

    /// Errors over the pixels that show vehicles in the truth, of cars that drive on `ways`.
    fn as_placed(
        &self,
        without: Without,
        ways: &[Trajectory],
        samples: &[Sample],
    ) -> Result<MaskedDifference> {
        let mut renderer = self.renderer();
        let world = self.world(&self.stage.driven(ways))?;
        let mut errors = MaskedErrors::new(self.floor);
        for sample in samples {
            let mut cars = agents_at(&world, sample.time_s);
            if without.arm() == Arm::NoRelighting {
                unlight(&mut cars);
            }
            if without.arm() == Arm::OursUncompressed {
                let splat_scene = renderer.upload(&self.copies(&cars))?;
                renderer.render(&splat_scene, &sample.cameras)?;
            } else {
                let render = |splats: FrameSplats<'_>| renderer.render(splats, &sample.cameras);
                world.scene().lend(&cars, render)?;
            }
            let images: Vec<Image> = renderer.read_images()?;
            for (at, found) in images.iter().enumerate() {
                errors.add(found, &sample.truth[at], |pixel| sample.vehicles[at][pixel])?;
            }
        }
        errors.finish().context("no camera sees a car")
    }
}
