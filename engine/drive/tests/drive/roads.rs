//! Synthetic roads as splats, their heights known.

use decouplegs_scene::SplatCloud;
use glam::{DMat3, DQuat, DVec2, DVec3};

/// Numbers that look random and are the same in every run (SplitMix64).
pub struct Random(pub u64);

impl Random {
    /// Evenly in 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Normal, of deviation one.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// Options of a test road.
pub struct RoadOptions {
    pub length_m: f64,
    pub width_m: f64,
    /// Splats a square meter.
    pub density: f64,
    /// Deviation of splats' heights.
    pub noise_m: f64,
    /// True if splats lie along the surface; otherwise they are round.
    pub flat: bool,
}

pub const ROAD: RoadOptions = RoadOptions {
    length_m: 40.0,
    width_m: 10.0,
    density: 60.0,
    noise_m: 0.015,
    flat: true,
};

pub fn add_splat(
    cloud: &mut SplatCloud,
    mean: DVec3,
    scales: [f64; 3],
    rotation: DQuat,
    opacity: f64,
) {
    cloud.means.push(mean.as_vec3().to_array());
    cloud.scales.push(scales.map(|scale| scale as f32));
    cloud
        .rotations
        .push([rotation.w, rotation.x, rotation.y, rotation.z].map(|x| x as f32));
    cloud.opacities.push(opacity as f32);
    cloud.sh_dc.push([0.0; 3]);
}

/// Splats over `options.length_m` along x from 0 and `options.width_m` across, at `height`.
pub fn add_surface(
    cloud: &mut SplatCloud,
    random: &mut Random,
    options: &RoadOptions,
    height: &dyn Fn(DVec2) -> f64,
) {
    let count = options.length_m * options.width_m * options.density;
    for _ in 0..count as usize {
        let half = 0.5 * options.width_m;
        let at = DVec2::new(
            random.between(0.0, options.length_m),
            random.between(-half, half),
        );
        let (dx, dy) = (
            height(at + DVec2::X * 0.01) - height(at),
            height(at + DVec2::Y * 0.01) - height(at),
        );
        let normal = DVec3::new(
            -dx / 0.01 + 0.05 * random.normal(),
            -dy / 0.01 + 0.05 * random.normal(),
            1.0,
        )
        .normalize();
        let mean = at.extend(height(at) + options.noise_m * random.normal());
        let scales = [
            random.between(0.05, 0.2),
            random.between(0.05, 0.2),
            random.between(0.005, 0.02),
        ];
        let scales = if options.flat { scales } else { [0.06; 3] };
        let turn = DQuat::from_rotation_z(random.between(0.0, std::f64::consts::TAU));
        let side = normal.any_orthonormal_vector();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(side, normal.cross(side), normal)) * turn;
        add_splat(cloud, mean, scales, rotation, random.between(0.4, 1.0));
    }
}

/// Leaves from 4 to 7 m over the road's middle third, floaters over all of it, debris below.
pub fn add_clutter(
    cloud: &mut SplatCloud,
    random: &mut Random,
    options: &RoadOptions,
    height: &dyn Fn(DVec2) -> f64,
) {
    let area = options.length_m * options.width_m;
    let mut scatter = |count: f64, x: [f64; 2], z: [f64; 2], size: [f64; 2], alpha: [f64; 2]| {
        for _ in 0..count as usize {
            let half = 0.5 * options.width_m;
            let at = DVec2::new(
                random.between(x[0], x[1]) * options.length_m,
                random.between(-half, half),
            );
            let mean = at.extend(height(at) + random.between(z[0], z[1]));
            let scale = random.between(size[0], size[1]);
            let rotation = DQuat::from_euler(
                glam::EulerRot::XYZ,
                random.unit(),
                6.0 * random.unit(),
                6.0 * random.unit(),
            );
            add_splat(
                cloud,
                mean,
                [scale, scale * 0.6, scale * 0.2],
                rotation,
                random.between(alpha[0], alpha[1]),
            );
        }
    };
    scatter(
        area / 3.0 * 80.0,
        [0.33, 0.67],
        [4.0, 7.0],
        [0.05, 0.2],
        [0.3, 1.0],
    );
    scatter(area, [0.0, 1.0], [0.1, 3.0], [0.05, 0.3], [0.05, 0.6]);
    scatter(
        area * 2.0,
        [0.0, 1.0],
        [-1.5, -0.1],
        [0.05, 0.2],
        [0.05, 0.8],
    );
}

/// A road of `height` with canopy, floaters and debris.
pub fn cluttered(options: &RoadOptions, height: &dyn Fn(DVec2) -> f64, seed: u64) -> SplatCloud {
    let (mut cloud, mut random) = (SplatCloud::default(), Random(seed));
    add_surface(&mut cloud, &mut random, options, height);
    add_clutter(&mut cloud, &mut random, options, height);
    cloud
}

/// Places on the road, away from its edges.
pub fn positions(options: &RoadOptions, count: usize, seed: u64) -> Vec<DVec2> {
    let mut random = Random(seed);
    let half = 0.5 * options.width_m - 0.5;
    (0..count)
        .map(|_| {
            DVec2::new(
                random.between(0.5, options.length_m - 0.5),
                random.between(-half, half),
            )
        })
        .collect()
}
