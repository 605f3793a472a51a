//! Orders that outlive a frame: the ranks of the background's splats along the directions that cameras look.
//!
//! The depth of a splat is f.p - f.c: along one direction f the order is the same wherever the camera stands. So ranks that
//! were found for a direction serve every frame that looks the same way, and driving straight sorts nothing. After a small turn
//! they are almost right, and cheaper to put right than to find again.

use decouplegs_gpu::{Buffer, Gpu, Residence};
use decouplegs_scene::{DepthOrder, Rules};
use glam::{DVec3, Vec3};

use crate::RenderError;
use crate::layout::{CameraRecord, OrderStep, View, ViewOrder};
use crate::resident::ResidentWorld;
use crate::stages::{Measured, PURPOSE};

/// Ranks are repaired after turns of up to this at first; a repair that failed halves it.
const REPAIR_ANGLE_RAD: f64 = 6e-5;
/// Places over which a repair looks after the widest turn that it is tried for: looking farther takes longer than the sort that
/// it saves (measured, H200 and lavapipe).
const REPAIR_REACH: u32 = 32;
/// A repair angle is not halved below this.
const REPAIR_ANGLE_MIN_RAD: f64 = 1e-6;
/// Ranks of a direction are found when it turned by less than this share of the angle that they serve for since the frame
/// before, so that they serve ten frames: finding them takes as long as sorting what one view sees seven times (measured, H200, 2 M splats).
const STEADY_SHARE: f64 = 0.1;

/// How splats come into front-to-back order.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub enum OrderMode {
    /// Everything is sorted in every frame.
    Full,
    /// Orders are kept, repaired where that is proved, and found again where it is not. Pictures are those of `Full` to the
    /// last bit.
    #[default]
    Exact,
    /// As `Exact`, but an order serves as it is until the camera has turned by `angle_rad`, and every frame says how wrong it
    /// may be.
    Bounded {
        /// Largest angle between a camera and the direction whose order it takes, radians.
        angle_rad: f64,
        /// The error is measured in one of so many segments of macro tiles' lists, in others in the next frame: measuring in
        /// all takes longer than sorting.
        measured_one_of: u32,
    },
}

impl OrderMode {
    fn stale_rad(self) -> f64 {
        if let Self::Bounded { angle_rad, .. } = self { angle_rad } else { 0.0 }
    }
}

/// How the background of one view came into order.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub enum OrderPath {
    /// The visible splats were sorted.
    Sorted,
    /// All splats were sorted, and their ranks kept.
    Found,
    /// The ranks of this very direction: nothing was sorted.
    Kept,
    /// The ranks of a direction nearby, put right.
    Repaired,
    /// Repair was tried and not enough; the visible splats were sorted.
    RepairFailed,
    /// The ranks of a direction nearby, as they are.
    Stale,
}

impl OrderPath {
    /// Whether it took no pass of the radix sort over the background.
    #[must_use]
    pub fn is_free_of_sorting(self) -> bool {
        matches!(self, Self::Kept | Self::Repaired | Self::Stale)
    }
}

/// What decides the order of a static world, to the last bit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Direction {
    forward: [f32; 3],
    forward_low: [f32; 3],
    key_scale: f32,
}

impl Direction {
    fn of(camera: &CameraRecord) -> Self {
        Self { forward: camera.row_z, forward_low: camera.row_z_low, key_scale: camera.key_scale }
    }

    /// The angle to another one, radians; infinite where keys are scaled otherwise.
    fn angle_to(&self, other: &Self) -> f64 {
        if self.key_scale != other.key_scale {
            return f64::INFINITY;
        }
        let vector = |direction: &Self| -> DVec3 {
            Vec3::from_array(direction.forward).as_dvec3() + Vec3::from_array(direction.forward_low).as_dvec3()
        };
        2.0 * (0.5 * (vector(self) - vector(other)).length()).min(1.0).asin()
    }
}

/// Ranks along one direction.
struct RankSet {
    direction: Direction,
    last_used: u64,
}

/// How the backgrounds of a frame's views come into order.
#[derive(Clone, Debug)]
pub(crate) struct OrderDecision {
    pub view_orders: Vec<ViewOrder>,
    pub paths: Vec<OrderPath>,
    /// The camera whose ranks are to be found, and the set they are to be kept in.
    pub find: Option<(usize, usize)>,
    /// Places over which a repair looks.
    pub repair_reach: u32,
    /// Where the error of stale orders is measured.
    pub measured: Measured,
}

impl OrderDecision {
    /// Everything sorted.
    pub fn sorted(views: usize) -> Self {
        Self {
            view_orders: vec![ViewOrder::default(); views],
            paths: vec![OrderPath::Sorted; views],
            find: None,
            repair_reach: 0,
            measured: Measured::ALL,
        }
    }

    pub fn is_ranked(&self) -> bool {
        self.view_orders.iter().any(|order| order.path != OrderStep::Sorted as u32)
    }

    pub fn sorts(&self) -> bool {
        self.paths.iter().any(|path| !matches!(path, OrderPath::Kept | OrderPath::Stale | OrderPath::Found))
    }

    pub fn has(&self, path: OrderPath) -> bool {
        self.paths.contains(&path)
    }
}

/// The kept orders of one world.
pub(crate) struct Orders {
    world: u64,
    ranks: Buffer<u32>,
    sets: Vec<RankSet>,
    sets_max: usize,
    previous: Vec<Direction>,
    repair_angle_rad: f64,
    frame: u64,
}

impl Orders {
    /// None kept yet, with no memory taken.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        Ok(Self {
            world: 0,
            ranks: gpu.buffer("ranks", PURPOSE, 0, Residence::Device)?,
            sets: Vec::new(),
            sets_max: 0,
            previous: Vec::new(),
            repair_angle_rad: REPAIR_ANGLE_RAD,
            frame: 0,
        })
    }

    /// Places in the order, `[rank set][splat]`.
    pub fn ranks(&self) -> &Buffer<u32> {
        &self.ranks
    }

    /// A repair was not enough: smaller turns from now on.
    pub fn repair_failed(&mut self) {
        self.repair_angle_rad = (0.5 * self.repair_angle_rad).max(REPAIR_ANGLE_MIN_RAD);
    }

    /// Decides for the views of the next frame. What it decides to find is taken as found.
    pub fn decide(
        &mut self,
        gpu: &Gpu,
        world: &ResidentWorld,
        view: &View,
        mode: OrderMode,
        rules: &Rules,
    ) -> Result<OrderDecision, RenderError> {
        let views = view.cameras.len();
        let bytes = (world.splats * views * 4) as u64;
        let possible = bytes > 0 && bytes <= gpu.limits().storage_buffer_bytes_max;
        if mode == OrderMode::Full || rules.order == DepthOrder::Radial || !possible {
            return Ok(OrderDecision::sorted(views));
        }
        self.frame += 1;
        self.fit(gpu, world, views)?;
        let directions: Vec<Direction> = view.cameras.iter().map(Direction::of).collect();
        let find = self.worth_finding(&directions, mode).map(|camera| (camera, self.free_set(directions[camera], &directions)));
        if find.is_some() && self.ranks.is_empty() {
            // Those who draw a single picture have no use for it.
            self.ranks = gpu.buffer("ranks", PURPOSE, world.splats * self.sets_max, Residence::Device)?;
        }
        let repair_reach = self.reach_for(&directions);
        let stride = if let OrderMode::Bounded { measured_one_of, .. } = mode { measured_one_of.max(1) } else { 1 };
        let measured = Measured { stride, first: (self.frame % u64::from(stride)) as u32 };
        let mut decision = OrderDecision { view_orders: Vec::new(), paths: Vec::new(), find, repair_reach, measured };
        for (camera, direction) in directions.iter().enumerate() {
            let (order, path) = self.order_of(direction, mode);
            decision.view_orders.push(order);
            decision.paths.push(if find.is_some_and(|(found, _)| found == camera) { OrderPath::Found } else { path });
        }
        self.previous = directions;
        Ok(decision)
    }

    /// Sets for as many views. What was kept of another world is forgotten.
    fn fit(&mut self, gpu: &Gpu, world: &ResidentWorld, views: usize) -> Result<(), RenderError> {
        if self.world != world.id || self.sets_max < views {
            self.sets.clear();
            self.previous.clear();
            self.ranks = gpu.buffer("ranks", PURPOSE, 0, Residence::Device)?;
            (self.world, self.sets_max) = (world.id, views);
        }
        Ok(())
    }

    /// The first camera that looks where no ranks are known and has hardly turned since the frame before. One a frame: what is
    /// found is paid for in one frame and serves many.
    fn worth_finding(&self, directions: &[Direction], mode: OrderMode) -> Option<usize> {
        let serves_rad = self.repair_angle_rad.max(mode.stale_rad());
        let steady = |camera: usize| {
            let before = self.previous.get(camera);
            before.is_some_and(|before| before.angle_to(&directions[camera]) <= STEADY_SHARE * serves_rad)
        };
        let stands = |camera: usize| self.previous.get(camera) == Some(&directions[camera]);
        (0..directions.len()).find(|&camera| {
            let angle = self.nearest(&directions[camera]).map_or(f64::INFINITY, |(_, angle)| angle);
            angle > 0.0 && (stands(camera) || (angle > serves_rad && steady(camera)))
        })
    }

    /// How far a repair has to look: entries move in proportion to the turn.
    fn reach_for(&self, directions: &[Direction]) -> u32 {
        let repaired = directions.iter().filter_map(|direction| self.nearest(direction)).map(|(_, angle)| angle);
        let widest_rad = repaired.filter(|&angle| angle <= self.repair_angle_rad).fold(0.0, f64::max);
        let share = widest_rad / self.repair_angle_rad;
        ((share * f64::from(REPAIR_REACH)) as u32 + 1).next_multiple_of(8).min(REPAIR_REACH)
    }

    /// The set for the ranks along `direction`: a new one, or the one whose last use is longest ago.
    fn free_set(&mut self, direction: Direction, wanted: &[Direction]) -> usize {
        let set = RankSet { direction, last_used: self.frame };
        if self.sets.len() < self.sets_max {
            self.sets.push(set);
            return self.sets.len() - 1;
        }
        let in_use = |set: &RankSet| wanted.contains(&set.direction);
        let oldest = (0..self.sets.len()).min_by_key(|&i| (in_use(&self.sets[i]), self.sets[i].last_used)).unwrap_or(0);
        self.sets[oldest] = set;
        oldest
    }

    fn nearest(&self, direction: &Direction) -> Option<(usize, f64)> {
        let angles = self
            .sets
            .iter()
            .map(|set| if set.direction == *direction { 0.0 } else { set.direction.angle_to(direction).max(f64::MIN_POSITIVE) });
        angles.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
    }

    fn order_of(&mut self, direction: &Direction, mode: OrderMode) -> (ViewOrder, OrderPath) {
        let order = |step: OrderStep, set: usize| ViewOrder { path: step as u32, rank_set: set as u32 };
        let Some((set, angle)) = self.nearest(direction) else {
            return (order(OrderStep::Sorted, 0), OrderPath::Sorted);
        };
        let (step, path) = if angle == 0.0 {
            (OrderStep::Kept, OrderPath::Kept)
        } else if angle <= mode.stale_rad() {
            (OrderStep::Kept, OrderPath::Stale)
        } else if angle <= self.repair_angle_rad {
            (OrderStep::Repaired, OrderPath::Repaired)
        } else {
            return (order(OrderStep::Sorted, 0), OrderPath::Sorted);
        };
        self.sets[set].last_used = self.frame;
        (order(step, set), path)
    }
}
