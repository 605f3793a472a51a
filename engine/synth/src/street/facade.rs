//! Appearance of a house front: wall, windows, shops, doors.

use glam::Vec3;

use super::random::{Stream, cell, fractal_noise, smoothstep};
use super::surface::{Texel, display};
use super::weather::lamplight;

/// Top of the shop windows' storey, meters.
pub(super) const SHOP_STOREY_M: f32 = 4.0;

/// Covering of a wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cladding {
    Brick,
    Render,
    Panels,
}

/// The design of one house.
#[derive(Clone, Copy, Debug)]
pub(super) struct Design {
    pub seed: u64,
    pub cladding: Cladding,
    pub wall: Vec3,
    pub trim: Vec3,
    pub frame: Vec3,
    pub storey_m: f32,
    pub bay_m: f32,
    pub window_m: [f32; 2],
    pub shops: bool,
    pub sign: Vec3,
}

impl Design {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Stream::new(seed, 3 << 40, 0);
        let cladding = *random.pick(&[
            Cladding::Brick,
            Cladding::Brick,
            Cladding::Render,
            Cladding::Render,
            Cladding::Render,
            Cladding::Panels,
        ]);
        let (wall, storey_m, bay_m, window_m) = match cladding {
            Cladding::Brick => {
                let walls = [
                    display(158, 88, 66),
                    display(138, 74, 58),
                    display(176, 122, 92),
                    display(124, 82, 70),
                ];
                (
                    *random.pick(&walls),
                    3.3,
                    random.range(2.3, 2.9),
                    [1.15, 1.75],
                )
            }
            Cladding::Render => {
                let walls = [
                    display(226, 206, 168),
                    display(214, 178, 138),
                    display(196, 208, 204),
                    display(222, 214, 202),
                    display(206, 160, 132),
                    display(186, 198, 178),
                ];
                (
                    *random.pick(&walls),
                    3.2,
                    random.range(2.4, 3.2),
                    [1.2, 1.7],
                )
            }
            Cladding::Panels => {
                let walls = [
                    display(170, 172, 174),
                    display(140, 146, 154),
                    display(200, 196, 188),
                ];
                (
                    *random.pick(&walls),
                    3.5,
                    random.range(3.0, 3.6),
                    [2.5, 2.0],
                )
            }
        };
        let signs = [
            display(32, 76, 120),
            display(150, 32, 36),
            display(28, 92, 66),
            display(200, 150, 40),
            display(52, 46, 60),
        ];
        Self {
            seed,
            cladding,
            wall: wall * random.range(0.85, 1.1),
            trim: if random.chance(0.6) {
                display(232, 226, 214)
            } else {
                wall * 0.6
            },
            frame: if random.chance(0.65) {
                display(236, 234, 228)
            } else {
                display(58, 54, 52)
            },
            storey_m,
            bay_m,
            window_m,
            shops: random.chance(0.72),
            sign: *random.pick(&signs),
        }
    }

    /// The bays of a front `width_m` wide: how many, and how wide each.
    pub(super) fn bays(&self, width_m: f32) -> (u32, f32) {
        let count = ((width_m - 0.8) / self.bay_m).floor().max(1.0);
        (count as u32, width_m / count)
    }

    /// Height of the floor of storey `storey`, the first above the ground floor being 1.
    pub(super) fn floor_m(&self, storey: u32) -> f32 {
        SHOP_STOREY_M + (storey as f32 - 1.0) * self.storey_m
    }

    /// Storeys above the ground floor that fit below the cornice of a house `height_m` high.
    pub(super) fn storeys(&self, height_m: f32) -> u32 {
        ((height_m - SHOP_STOREY_M - 0.5) / self.storey_m)
            .floor()
            .max(0.0) as u32
    }

    /// Lower left and upper right corner, meters along and up the front, of the window of a bay and
    /// storey.
    pub(super) fn window(&self, bay: u32, storey: u32, width_m: f32) -> [f32; 4] {
        let (_, pitch_m) = self.bays(width_m);
        let center_m = (bay as f32 + 0.5) * pitch_m;
        let half_m = 0.5 * self.window_m[0].min(pitch_m - 0.5);
        let sill_m = self.floor_m(storey) + 0.85;
        [
            center_m - half_m,
            sill_m,
            center_m + half_m,
            sill_m + self.window_m[1],
        ]
    }

    /// The front at `x` meters along and `z` meters up, on a house of the given width and height.
    pub(super) fn front(&self, x: f32, z: f32, width_m: f32, height_m: f32) -> Texel {
        let texel = if z < SHOP_STOREY_M {
            self.ground_floor(x, z, width_m)
        } else {
            self.upper_floor(x, z, width_m, height_m)
        };
        Texel {
            openness: texel.openness * (0.5 + 0.5 * smoothstep(-0.3, 2.0, z)),
            ..texel
        }
    }

    fn upper_floor(&self, x: f32, z: f32, width_m: f32, height_m: f32) -> Texel {
        let (count, pitch_m) = self.bays(width_m);
        let bay = ((x / pitch_m) as u32).min(count - 1);
        let storey = ((z - SHOP_STOREY_M) / self.storey_m) as u32 + 1;
        if storey > self.storeys(height_m) {
            return self.wall_texel();
        }
        let window = self.window(bay, storey, width_m);
        let inside = [
            (x - window[0]).min(window[2] - x),
            (z - window[1]).min(window[3] - z),
        ];
        if inside[0] > 0.0 && inside[1] > 0.0 {
            return self.glazing(
                bay as i32,
                storey as i32,
                x - window[0],
                z - window[1],
                inside,
                window,
            );
        }
        let outside = [
            (window[0] - x).max(x - window[2]),
            (window[1] - z).max(z - window[3]),
        ];
        let surround_m = outside[0].max(outside[1]);
        let mut texel = self.wall_texel();
        if surround_m < 0.16 && self.cladding != Cladding::Panels {
            texel.albedo = self.trim;
        }
        texel
    }

    /// A window: frame and bars, and glass that shows sky, room or curtain.
    fn glazing(
        &self,
        bay: i32,
        storey: i32,
        x: f32,
        z: f32,
        inside: [f32; 2],
        window: [f32; 4],
    ) -> Texel {
        let (width_m, height_m) = (window[2] - window[0], window[3] - window[1]);
        let bar_m = (x - 0.5 * width_m).abs();
        let transom_m = (z - 0.68 * height_m).abs();
        let frame_m = inside[0].min(inside[1]);
        if frame_m < 0.08 || bar_m < 0.03 || (transom_m < 0.03 && self.cladding != Cladding::Panels)
        {
            return Texel {
                openness: 0.9,
                ..Texel::matt(self.frame)
            };
        }
        let taste = cell(self.seed + 61, bay, storey);
        let height = z / height_m;
        // The upper part mirrors sky, the lower the houses across the street.
        let glass = display(46, 54, 62).lerp(
            display(128, 156, 182),
            smoothstep(0.15, 0.95, height + 0.5 * (taste - 0.5)),
        );
        let curtain = display(214, 204, 184) * (0.7 + 0.3 * (x * 42.0).sin().abs());
        let albedo = match () {
            () if taste < 0.22 && height > 0.35 => curtain * 0.75,
            () if (0.22..0.40).contains(&taste) && (x / width_m - 0.5).abs() > 0.27 => {
                curtain * 0.7
            }
            () if taste > 0.93 => display(236, 196, 122),
            () => glass,
        };
        // The reveal above and beside the glass keeps the sky out.
        let openness = 0.45 + 0.55 * smoothstep(0.05, 0.45, height_m - z);
        // Some rooms have a light on, by their lamps from yellow to white, weaker behind curtains
        // and towards the sill.
        let evening = cell(self.seed + 109, bay, storey);
        let lamp = lamplight().lerp(
            display(236, 238, 240),
            0.6 * cell(self.seed + 113, bay, storey),
        );
        let glow = if evening < 0.34 {
            lamp * (0.3 + 1.6 * evening) * (0.5 + 0.5 * height)
        } else {
            Vec3::ZERO
        };
        Texel {
            gloss: 0.9,
            openness,
            glow: glow * if taste < 0.4 { 0.6 } else { 1.0 },
            ..Texel::matt(albedo)
        }
    }

    /// Shop windows with a sign above, or a plain ground floor with a door.
    fn ground_floor(&self, x: f32, z: f32, width_m: f32) -> Texel {
        let (count, pitch_m) = if self.shops {
            (
                (width_m / 4.2).round().max(1.0) as u32,
                width_m / (width_m / 4.2).round().max(1.0),
            )
        } else {
            self.bays(width_m)
        };
        let bay = ((x / pitch_m) as u32).min(count - 1);
        let door = bay == (cell(self.seed + 67, 0, 0) * count as f32) as u32;
        let from_middle_m = (x - (bay as f32 + 0.5) * pitch_m).abs();
        if self.shops && (3.05..3.75).contains(&z) && (0.3..width_m - 0.3).contains(&x) {
            return self.sign_band(x, z, bay);
        }
        let (half_m, low_m, high_m) = match (self.shops, door) {
            (_, true) => (0.62, 0.0, 2.5),
            (true, false) => (0.5 * pitch_m - 0.3, 0.45, 2.85),
            (false, false) => (0.5 * self.window_m[0].min(pitch_m - 0.6), 1.1, 2.9),
        };
        let inside = [half_m - from_middle_m, (z - low_m).min(high_m - z)];
        if inside[0] > 0.0 && inside[1] > 0.0 {
            return if door {
                self.door(inside, z)
            } else {
                self.shop_window(bay, x, z, inside)
            };
        }
        let mut texel = self.wall_texel();
        if z < 0.45 {
            texel.albedo = self.wall * 0.45 + display(120, 116, 110) * 0.3;
        } else if self.shops {
            texel.albedo = texel.albedo * 0.5 + self.sign * 0.3;
        }
        texel
    }

    fn sign_band(&self, x: f32, z: f32, bay: u32) -> Texel {
        let tint = cell(self.seed + 71, bay as i32, 1);
        let board = self.sign.lerp(display(60, 60, 64), 0.5 * tint);
        // Letters: blocks of a row, readable as writing from a car but as no word.
        let letter = (x / 0.34).floor() as i32;
        let within = (x / 0.34).fract();
        let written = (3.22..3.58).contains(&z)
            && (0.15..0.8).contains(&within)
            && cell(self.seed + 73, letter / 9, 2) > 0.35;
        let stroke = cell(
            self.seed + 79,
            (x / 0.085).floor() as i32,
            ((z - 3.22) / 0.12).floor() as i32,
        ) > 0.4;
        let (albedo, glow) = if written && stroke {
            (display(240, 234, 220), 0.75)
        } else {
            (board, 0.25)
        };
        Texel {
            gloss: 0.25,
            glow: albedo * glow,
            ..Texel::matt(albedo)
        }
    }

    fn door(&self, inside: [f32; 2], z: f32) -> Texel {
        let leaf = self.sign * 0.8 + display(60, 40, 28) * 0.4;
        let frame = inside[0] < 0.09 || inside[1] < 0.09 && z > 1.0;
        let pane = z > 1.5 && inside[0] > 0.25 && inside[1] > 0.25;
        let albedo = if frame {
            self.trim
        } else if pane {
            display(70, 84, 96)
        } else {
            leaf
        };
        Texel {
            openness: 0.75,
            gloss: 0.2,
            ..Texel::matt(albedo)
        }
    }

    /// Dim glass with goods and lights behind.
    fn shop_window(&self, bay: u32, x: f32, z: f32, inside: [f32; 2]) -> Texel {
        let frame_m = inside[0].min(inside[1]);
        if frame_m < 0.07 {
            return Texel::matt(display(70, 66, 62));
        }
        let goods = fractal_noise(self.seed + 83 + u64::from(bay), x * 2.2, z * 1.6, 3);
        let depth = smoothstep(2.7, 0.9, z);
        let room =
            display(44, 46, 50).lerp(display(150, 122, 88), smoothstep(0.52, 0.72, goods) * depth);
        let mirrored = display(116, 138, 156) * 0.55;
        let open = cell(self.seed + 127, 0, 0) < 0.7;
        let glow = if open {
            lamplight()
                * (0.10
                    + 0.55 * smoothstep(0.40, 0.72, goods) * depth
                    + 0.25 * smoothstep(2.2, 2.8, z))
        } else {
            Vec3::ZERO
        };
        Texel {
            gloss: 0.9,
            openness: 0.9,
            glow,
            ..Texel::matt(room.lerp(mirrored, 0.35 + 0.4 * smoothstep(1.4, 2.8, z)))
        }
    }

    /// The bare wall.
    pub(super) fn wall_texel(&self) -> Texel {
        Texel {
            weathered: true,
            ..Texel::matt(self.wall)
        }
    }

    /// A factor on its albedo: courses of brick, streaks on render, joints of panels.
    pub(super) fn weather(&self, x: f32, z: f32) -> f32 {
        let streaks = fractal_noise(self.seed + 89, x * 0.9, z * 0.12, 3);
        let blotches = fractal_noise(self.seed + 97, x * 0.35, z * 0.35, 3);
        let mut shade = 0.78 + 0.22 * streaks + 0.2 * blotches;
        match self.cladding {
            Cladding::Brick => {
                let course = (z / 0.16).floor();
                let brick = (x / 0.42 + 0.5 * (course % 2.0)).floor();
                shade *= 0.82 + 0.36 * cell(self.seed + 101, brick as i32, course as i32);
            }
            Cladding::Render => {}
            Cladding::Panels => {
                let (i, j) = (
                    (x / 1.6).fract(),
                    ((z - SHOP_STOREY_M) / self.storey_m).rem_euclid(1.0),
                );
                if i < 0.03 || j < 0.02 {
                    shade *= 0.6;
                }
            }
        }
        shade
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_fit_their_walls_and_do_not_touch() {
        for seed in 0..200 {
            let design = Design::new(seed);
            let (width_m, height_m) = (9.0 + (seed % 10) as f32, 9.5 + (seed % 13) as f32);
            let (bays, _) = design.bays(width_m);
            for storey in 1..=design.storeys(height_m) {
                let mut left = 0.0;
                for bay in 0..bays {
                    let [x0, z0, x1, z1] = design.window(bay, storey, width_m);
                    assert!(
                        x0 > left + 0.1 && x1 < width_m && z0 > design.floor_m(storey),
                        "{design:?}"
                    );
                    assert!(z1 < design.floor_m(storey) + design.storey_m && z1 < height_m);
                    left = x1;
                }
            }
        }
    }

    #[test]
    fn glass_is_not_wall() {
        let design = Design::new(4);
        let [x0, z0, x1, z1] = design.window(0, 1, 12.0);
        let glass = design.front(x0 + 0.3 * (x1 - x0), z0 + 0.3 * (z1 - z0), 12.0, 15.0);
        let wall = design.front(0.05, z0, 12.0, 15.0);
        assert!(glass.gloss > 0.5 && wall.gloss < 0.1);
    }
}
