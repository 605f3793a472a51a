//! Levels of detail of a background: the same splats by ever fewer ones, cut into nodes of which
//! each camera draws the coarsest that are fine enough for it.
//!
//! A node is a run of [`NODE_SPLATS`] splats. The finest nodes are the background itself, in its
//! order. Four neighboring nodes have one parent, whose splats are theirs, merged four to one. Each
//! node has the distance over which its splats were moved by merging, and a ball that holds all
//! splats below it; both never shrink towards the root. So of all nodes above a splat the errors in
//! an image rise towards the root, and exactly one is fine enough while its parent is not. No
//! traversal is needed: each node decides by itself. (Kerbl et al., A Hierarchical 3D Gaussian
//! Representation, 2024, cut a tree of splats in the same way.)

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::merge::{clusters, covered_m2, merged};
use crate::{Bounds, SplatCloud};

/// Splats of a node.
pub const NODE_SPLATS: usize = 256;

/// Nodes with one parent, and splats that become one.
pub const MERGED: usize = 4;

/// Largest number of nodes from which no coarser level is made.
const ROOTS_MAX: usize = 8;

/// Parent of a node that has none.
pub const NO_PARENT: u32 = u32::MAX;

/// Weight of color beside place when splats are grouped ([`clusters`]). On a street of 2.2 million
/// splats, 640x360, 0.1 left 587,000 visible splats at 40.9 dB, 0.3 526,000 at 41.3 dB, and 1.0
/// 564,000 at 40.7 dB (limits of 2, 2.5 and 3 pixels).
const COLOR_WEIGHT: f64 = 0.3;

/// Smallest error of a node that is not one of the finest, meters: a limit of 0 draws none of them.
const ERROR_MIN_M: f32 = 1e-9;

/// A run of [`NODE_SPLATS`] splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetailNode {
    /// Center of a ball that holds the means of all finest splats below the node, meters.
    pub center_m: [f32; 3],
    /// Radius of the ball, meters.
    pub radius_m: f32,
    /// Distance of splats that were merged into one: twice their root mean square distance from its
    /// mean, meters; at least that of all nodes below, and 0 for the finest.
    pub error_m: f32,
    /// Node of the next coarser level, or [`NO_PARENT`].
    pub parent: u32,
}

/// A background with its levels of detail.
#[derive(Clone, Debug, PartialEq)]
pub struct DetailLevels {
    /// Splats of all nodes, node by node; where a node has fewer, ones of opacity 0 follow.
    pub splats: SplatCloud,
    /// Instance of each splat; empty if there are none.
    pub instance_from_splat: Vec<u16>,
    /// The finest nodes, then those of each coarser level.
    pub nodes: Vec<DetailNode>,
    /// Number of finest nodes.
    pub finest_nodes: usize,
}

impl DetailLevels {
    /// Merges `splats` level by level, until at most eight nodes are left. Neighbors should be
    /// neighbors in space ([`SplatCloud::spatial_order`]): others are never near enough to one
    /// another to be merged. Splats of different instances are not merged; `instance_from_splat`
    /// is empty or has one id per splat.
    #[must_use]
    pub fn build(splats: &SplatCloud, instance_from_splat: &[u16]) -> Self {
        let mut level = Level::finest(splats, instance_from_splat);
        let mut levels = Self {
            splats: SplatCloud::with_degree(splats.sh_degree),
            instance_from_splat: Vec::new(),
            nodes: Vec::new(),
            finest_nodes: level.nodes.len(),
        };
        while level.nodes.len() > ROOTS_MAX {
            let coarser = level.coarser();
            let first_parent = (levels.nodes.len() + level.nodes.len()) as u32;
            for (place, node) in level.nodes.iter_mut().enumerate() {
                node.parent = first_parent + (place / MERGED) as u32;
            }
            levels.append(std::mem::replace(&mut level, coarser));
        }
        levels.append(level);
        levels
    }

    /// Limit of the splats of all levels of a background of `splats`.
    #[must_use]
    pub fn splats_at_most(splats: usize) -> usize {
        // Each level may end with a node that is not full, and 4^32 splats are none that fit.
        splats + splats.div_ceil(MERGED - 1) + 32 * NODE_SPLATS
    }

    fn append(&mut self, level: Level) {
        if self.splats.is_empty() {
            self.splats = level.splats; // the finest, which is most of it, without a copy
        } else {
            self.splats.append(&level.splats);
        }
        self.instance_from_splat.extend(level.instances);
        self.nodes.extend(level.nodes);
    }

    /// Indices of the splats that are drawn for a camera at `center_m` with `focal_px` pixels per
    /// radian, if splats may be merged that lie at most `pitch_px` pixels apart.
    #[must_use]
    pub fn cut(&self, center_m: Vec3, focal_px: f32, pitch_px: f32) -> Vec<u32> {
        let shown = (0..self.nodes.len())
            .filter(|&node| is_shown(&self.nodes, node, center_m, focal_px, pitch_px));
        shown
            .flat_map(|node| (node * NODE_SPLATS..(node + 1) * NODE_SPLATS).map(|s| s as u32))
            .collect()
    }
}

/// True if `node` is fine enough and its parent is not, in the arithmetic of `detail.glsl`.
#[must_use]
pub fn is_shown(
    nodes: &[DetailNode],
    node: usize,
    center_m: Vec3,
    focal_px: f32,
    pitch_px: f32,
) -> bool {
    let fine_enough = |node: &DetailNode| {
        let distance_m = (Vec3::from_array(node.center_m) - center_m).length() - node.radius_m;
        node.error_m * focal_px <= pitch_px * distance_m.max(0.0)
    };
    let node = &nodes[node];
    fine_enough(node) && (node.parent == NO_PARENT || !fine_enough(&nodes[node.parent as usize]))
}

/// The nodes of one level.
struct Level {
    splats: SplatCloud,
    instances: Vec<u16>,
    nodes: Vec<DetailNode>,
}

impl Level {
    fn finest(splats: &SplatCloud, instance_from_splat: &[u16]) -> Self {
        let mut level = Self {
            splats: splats.clone(),
            instances: instance_from_splat.to_vec(),
            nodes: Vec::new(),
        };
        level.pad_to(splats.len().next_multiple_of(NODE_SPLATS));
        let nodes = (0..level.splats.len() / NODE_SPLATS).into_par_iter();
        level.nodes = nodes
            .map(|node| {
                let means = level.drawn(node..node + 1).into_iter();
                ball(means.map(|splat| (level.splats.mean_m(splat as usize), 0.0)))
            })
            .collect();
        level
    }

    /// Appends splats of opacity 0 until there are `count`.
    fn pad_to(&mut self, count: usize) {
        let missing = count - self.splats.len();
        self.splats.append(&unseen(missing, self.splats.sh_degree));
        if !self.instances.is_empty() {
            self.instances.resize(count, 0);
        }
    }

    /// Splats of `nodes` that can be drawn at all.
    fn drawn(&self, nodes: std::ops::Range<usize>) -> Vec<u32> {
        let end = self.splats.len().min(nodes.end * NODE_SPLATS);
        let splats = nodes.start * NODE_SPLATS..end;
        splats
            .filter(|&splat| {
                self.splats.defect_of(splat).is_none() && self.splats.opacities[splat] > 0.0
            })
            .map(|splat| splat as u32)
            .collect()
    }

    fn coarser(&self) -> Self {
        let parents: Vec<(SplatCloud, Vec<u16>, DetailNode)> = (0..self.nodes.len())
            .into_par_iter()
            .step_by(MERGED)
            .map(|first| self.parent_of(first..(first + MERGED).min(self.nodes.len())))
            .collect();
        let mut level = Self {
            splats: SplatCloud::with_degree(self.splats.sh_degree),
            instances: Vec::new(),
            nodes: Vec::new(),
        };
        for (splats, instances, node) in &parents {
            level.splats.append(splats);
            level.instances.extend(instances);
            level.nodes.push(*node);
            level.pad_to(level.nodes.len() * NODE_SPLATS);
        }
        level
    }

    /// Splats and node instead of `nodes`.
    fn parent_of(&self, nodes: std::ops::Range<usize>) -> (SplatCloud, Vec<u16>, DetailNode) {
        let drawn = self.drawn(nodes.clone());
        let own = self.splats.select(&drawn);
        let weights: Vec<f64> = (0..own.len())
            .map(|splat| covered_m2(&own, splat))
            .collect();
        let instances: Vec<u16> = match self.instances.is_empty() {
            true => vec![0; own.len()],
            false => drawn
                .iter()
                .map(|&splat| self.instances[splat as usize])
                .collect(),
        };
        let groups = groups(&own, &weights, &instances);
        let is_whole = groups.len() <= NODE_SPLATS;
        let groups = &groups[..groups.len().min(NODE_SPLATS)];
        let merged = merged(&own, &weights, groups);
        let spread_m2 = |(splat, members): (usize, &Vec<u32>)| -> f64 {
            let mean = merged.mean_m(splat);
            let offsets = members
                .iter()
                .map(|&member| own.mean_m(member as usize) - mean);
            offsets.map(DVec3::length_squared).sum()
        };
        let spread_m2: f64 = groups.iter().enumerate().map(spread_m2).sum();
        let moved_m = 2.0 * (spread_m2 / own.len().max(1) as f64).sqrt();
        let below = &self.nodes[nodes];
        let node = ball(below.iter().map(|node| {
            let center = DVec3::from_array(node.center_m.map(f64::from));
            (center, f64::from(node.radius_m))
        }));
        let error_m = below.iter().fold(moved_m as f32, |error, node| {
            error.max(node.error_m * 1.000_01)
        });
        let instances = match self.instances.is_empty() {
            true => Vec::new(),
            false => groups
                .iter()
                .map(|group| instances[group[0] as usize])
                .collect(),
        };
        let error_m = match is_whole {
            true => error_m.max(ERROR_MIN_M),
            false => f32::INFINITY, // more instances than splats: never fine enough
        };
        (merged, instances, DetailNode { error_m, ..node })
    }
}

/// Splats of opacity 0.
fn unseen(count: usize, sh_degree: u8) -> SplatCloud {
    let mut cloud = SplatCloud::with_degree(sh_degree);
    cloud.means = vec![[0.0; 3]; count];
    cloud.scales = vec![[1e-3; 3]; count];
    cloud.rotations = vec![[1.0, 0.0, 0.0, 0.0]; count];
    cloud.opacities = vec![0.0; count];
    cloud.sh_dc = vec![[0.0; 3]; count];
    cloud.sh_rest = vec![[0.0; 3]; count * cloud.rest_stride()];
    cloud
}

/// A ball around balls of center and radius (m), without error and parent.
fn ball(balls: impl Iterator<Item = (DVec3, f64)> + Clone) -> DetailNode {
    let corners = balls.clone().flat_map(|(center, radius_m)| {
        [-radius_m, radius_m].map(|by| (center + by).as_vec3().to_array())
    });
    let corners: Vec<[f32; 3]> = corners.collect();
    let center_m = match corners.is_empty() {
        true => [0.0; 3],
        false => Bounds::from_points(&corners).center(),
    };
    let center = DVec3::from_array(center_m.map(f64::from));
    let radius_m = balls.fold(0.0f64, |most, (at, radius_m)| {
        most.max(center.distance(at) + radius_m)
    });
    DetailNode {
        center_m,
        // f32 rounds distances to far centers; a ball a little too large only draws finer.
        radius_m: (radius_m * 1.000_01 + center.length() * 1e-6) as f32,
        error_m: 0.0,
        parent: NO_PARENT,
    }
}

/// Groups of splats to merge, a fourth as many as there are splats in each instance, rounded up,
/// and at most [`NODE_SPLATS`] in all, unless there are more instances.
fn groups(cloud: &SplatCloud, weights: &[f64], instances: &[u16]) -> Vec<Vec<u32>> {
    let mut ids = instances.to_vec();
    ids.sort_unstable();
    ids.dedup();
    let of_id = |id: &u16| -> Vec<u32> {
        let all = 0..instances.len() as u32;
        all.filter(|&splat| instances[splat as usize] == *id)
            .collect()
    };
    let members: Vec<Vec<u32>> = ids.iter().map(of_id).collect();
    let mut counts: Vec<usize> = members.iter().map(|m| m.len().div_ceil(MERGED)).collect();
    while counts.iter().sum::<usize>() > NODE_SPLATS {
        // Rounding up made too many.
        let Some(largest) = counts.iter_mut().max().filter(|count| **count > 1) else {
            break;
        };
        *largest -= 1;
    }
    let of_instance = members.iter().zip(counts).flat_map(|(members, count)| {
        let own = cloud.select(members);
        let weights: Vec<f64> = members.iter().map(|&m| weights[m as usize]).collect();
        let groups = clusters(&own, &weights, count, COLOR_WEIGHT);
        let indices = move |group: Vec<u32>| group.iter().map(|&m| members[m as usize]).collect();
        groups.into_iter().map(indices).collect::<Vec<Vec<u32>>>()
    });
    of_instance.collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::random;

    /// `count` small splats in a slab of 20 x 10 x 2 m, in spatial order.
    fn slab(count: usize, seed: u64) -> SplatCloud {
        let mut state = seed;
        let mut number = || random::unit(random::next(&mut state)) as f32;
        let mut cloud = unseen(count, 1);
        for splat in 0..count {
            cloud.means[splat] = [20.0 * number(), 10.0 * number(), 2.0 * number()];
            cloud.scales[splat] = [0.05 + 0.1 * number(), 0.05, 0.01];
            cloud.opacities[splat] = 0.2 + 0.8 * number();
            cloud.sh_dc[splat] = [number(), number(), number()];
        }
        cloud.in_spatial_order()
    }

    /// For each finest node, how many of it and those above it are drawn.
    fn drawn_above(nodes: &[DetailNode], finest: usize, at: Vec3, pitch_px: f32) -> Vec<usize> {
        let count = |mut node: usize| {
            let mut drawn = 0;
            loop {
                drawn += usize::from(is_shown(nodes, node, at, 500.0, pitch_px));
                match nodes[node].parent {
                    NO_PARENT => return drawn,
                    parent => node = parent as usize,
                }
            }
        };
        (0..finest).map(count).collect()
    }

    proptest! {
        #[test]
        fn every_splat_is_drawn_once_from_everywhere(
            place in prop::array::uniform3(-100.0f32..100.0),
            pitch_px in 0.0f32..50.0,
        ) {
            static LEVELS: std::sync::OnceLock<DetailLevels> = std::sync::OnceLock::new();
            let levels = LEVELS.get_or_init(|| DetailLevels::build(&slab(20_000, 1), &[]));
            let at = Vec3::from_array(place);
            let drawn = drawn_above(&levels.nodes, levels.finest_nodes, at, pitch_px);
            prop_assert!(drawn.iter().all(|&count| count == 1), "{drawn:?}");
        }
    }

    #[test]
    fn a_ball_that_does_not_hold_its_children_is_seen() {
        let levels = DetailLevels::build(&slab(20_000, 1), &[]);
        let mut nodes = levels.nodes.clone();
        for node in &mut nodes {
            (node.radius_m, node.error_m) = (0.0, node.error_m.min(0.1));
        }
        let wrong = (0..200).any(|step| {
            let at = Vec3::new(0.2 * step as f32 - 10.0, 5.0, 1.0);
            let drawn = drawn_above(&nodes, levels.finest_nodes, at, 10.0);
            drawn.iter().any(|&count| count != 1)
        });
        assert!(wrong);
    }

    #[test]
    fn levels_fall_by_four_and_rise_in_error() {
        let cloud = slab(20_000, 2);
        let levels = DetailLevels::build(&cloud, &[]);
        // 79 nodes, 20 and 5.
        assert_eq!((levels.finest_nodes, levels.nodes.len()), (79, 104));
        assert_eq!(levels.splats.len(), 104 * NODE_SPLATS);
        assert!(levels.splats.len() <= DetailLevels::splats_at_most(cloud.len()));
        assert_eq!(levels.splats.means[..20_000], cloud.means);
        assert!(levels.nodes[..79].iter().all(|node| node.error_m == 0.0));
        for node in &levels.nodes {
            if node.parent == NO_PARENT {
                continue;
            }
            let parent = &levels.nodes[node.parent as usize];
            assert!(parent.error_m > node.error_m, "{node:?} {parent:?}");
            let between = Vec3::from_array(node.center_m) - Vec3::from_array(parent.center_m);
            assert!(between.length() + node.radius_m <= parent.radius_m * 1.000_1);
        }
        let covered = |range: std::ops::Range<usize>| -> f64 {
            range.map(|splat| covered_m2(&levels.splats, splat)).sum()
        };
        let [fine, coarse] = [0..79 * NODE_SPLATS, 79 * NODE_SPLATS..99 * NODE_SPLATS].map(covered);
        assert!((coarse / fine - 1.0).abs() < 0.2, "{fine} became {coarse}");
    }

    #[test]
    fn a_limit_of_zero_draws_the_finest_and_a_large_one_the_coarsest() {
        let levels = DetailLevels::build(&slab(5_000, 3), &[]);
        let at = Vec3::new(-30.0, 5.0, 1.0);
        let finest: Vec<u32> = (0..20 * NODE_SPLATS as u32).collect();
        assert_eq!(levels.cut(at, 500.0, 0.0), finest);
        let coarsest = levels.cut(at, 500.0, 1e6);
        assert_eq!(coarsest.len(), 5 * NODE_SPLATS);
        assert!(coarsest.iter().all(|&splat| splat as usize >= finest.len()));
    }

    #[test]
    fn instances_are_never_mixed() {
        let cloud = slab(4_096, 4);
        let few: Vec<u16> = (0..4_096).map(|splat| (splat / 7 % 3) as u16).collect();
        let levels = DetailLevels::build(&cloud, &few);
        let share = |range: std::ops::Range<usize>, id: u16| -> f64 {
            let own = range.filter(|&splat| levels.instance_from_splat[splat] == id);
            own.map(|splat| covered_m2(&levels.splats, splat)).sum()
        };
        for id in 0..3 {
            let ratio = share(4_096..5_120, id) / share(0..4_096, id);
            assert!((ratio - 1.0).abs() < 0.2, "instance {id}: {ratio}");
        }
        // Instances of three splats: a parent cannot hold one splat of each.
        let many: Vec<u16> = (0..4_096).map(|splat| (splat / 3) as u16).collect();
        let levels = DetailLevels::build(&cloud, &many);
        let drawn = levels.cut(Vec3::new(-1e4, 0.0, 0.0), 1.0, 1e6);
        assert_eq!(drawn.len(), 4_096, "the finest are drawn instead");
    }

    #[test]
    fn defects_and_clouds_of_any_size_are_taken() {
        for count in [0, 1, 255, 256, 257, 3_000] {
            let mut cloud = slab(count, 5);
            if count > 2 {
                cloud.means[1] = [f32::NAN; 3];
                cloud.opacities[2] = f32::INFINITY;
            }
            let levels = DetailLevels::build(&cloud, &[]);
            let finite = |node: &DetailNode| {
                node.center_m.iter().all(|x| x.is_finite()) && node.radius_m.is_finite()
            };
            assert!(levels.nodes.iter().all(finite), "{count}");
            assert_eq!(levels.finest_nodes, count.div_ceil(NODE_SPLATS));
        }
        // All splats in one place: one splat per parent is enough.
        let mut heap = slab(4_096, 6);
        heap.means.fill([1.0, 2.0, 3.0]);
        heap.sh_dc.fill([0.5; 3]);
        let levels = DetailLevels::build(&heap, &[]);
        assert_eq!(levels.splats.len(), levels.nodes.len() * NODE_SPLATS);
    }
}
