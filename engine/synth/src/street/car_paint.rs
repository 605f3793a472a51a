//! Appearance of a car's surfaces: paint, glass, lamps, grille, plates, door gaps, rims.

use glam::{Vec2, Vec3};

use super::car::Build;
use super::random::{cell, smoothstep};
use super::surface::{FAR_M, SurfacePoint, Texel, display};

/// The finish of a car.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    /// Linear RGB.
    pub color: Vec3,
    /// A chequered band along the sides.
    pub taxi: bool,
    /// No windows behind the front doors.
    pub cargo: bool,
}

fn plastic(shade: f32) -> Texel {
    Texel {
        openness: 0.8,
        gloss: 0.1,
        ..Texel::matt(display(40, 42, 44) * shade)
    }
}

fn painted(paint: &Paint, normal: Vec3) -> Texel {
    // Clear coat mirrors sky on faces that look up, and the street on those that look down.
    let mirrored =
        display(170, 196, 224).lerp(display(60, 58, 56), smoothstep(0.1, -0.5, normal.z));
    let share = 0.05 + 0.13 * (1.0 - normal.z.abs()).powi(2) + 0.06 * normal.z.max(0.0);
    Texel {
        gloss: 1.0,
        ..Texel::matt(paint.color.lerp(mirrored, share))
    }
}

/// The body at `p`, meters from the ground point under the middle of the car.
pub(super) fn body_texel(build: &Build, paint: &Paint, point: &SurfacePoint, p: Vec3) -> Texel {
    let low = p.z - build.bottom_z(p.x);
    if point.normal.z < -0.75 {
        return plastic(0.4);
    }
    if let Some(texel) = wheel_arch(build, p, point.normal) {
        return texel;
    }
    let shade = 0.55 + 0.45 * smoothstep(0.0, 0.35, low);
    let ends = 0.5 * build.size.x;
    let texel = if p.x > ends - 0.45 && point.normal.x > 0.25 {
        front_texel(build, paint, point.normal, p)
    } else if p.x < -ends + 0.4 && point.normal.x < -0.25 {
        rear_texel(build, paint, point.normal, p)
    } else {
        side_texel(build, paint, point.normal, p)
    };
    Texel {
        openness: texel.openness * shade,
        ..texel
    }
}

/// The dark round each wheel, and the lip about it.
fn wheel_arch(build: &Build, p: Vec3, normal: Vec3) -> Option<Texel> {
    if normal.y.abs() < 0.5 {
        return None;
    }
    let radius_m = build.wheel_radius_m;
    let distance_m = build
        .axles_x
        .iter()
        .map(|x| Vec2::new(p.x - x, p.z - radius_m).length())
        .fold(FAR_M, f32::min);
    (distance_m < radius_m + 0.055).then(|| Texel {
        openness: 0.25,
        ..plastic(0.45)
    })
}

fn front_texel(build: &Build, paint: &Paint, normal: Vec3, p: Vec3) -> Texel {
    let half = 0.5 * build.size.y;
    let nose = build.nose_cowl_tail_z[0];
    let (y, z) = (p.y.abs() / half, p.z);
    if (nose - 0.19..nose - 0.03).contains(&z) && (0.52..0.93).contains(&y) {
        // A bright lens with a dark rim.
        let inside =
            ((z - nose + 0.19).min(nose - 0.03 - z) / 0.05).min((y - 0.52).min(0.93 - y) / 0.06);
        let lens =
            display(120, 126, 132).lerp(display(246, 248, 250), smoothstep(0.2, 1.0, inside));
        return Texel {
            gloss: 1.0,
            openness: 1.2,
            ..Texel::matt(lens)
        };
    }
    if p.y.abs() < 0.26 && (0.40..0.52).contains(&z) {
        return plate(p.y, z - 0.40);
    }
    if y < 0.5 && (nose - 0.22..nose - 0.06).contains(&z) || y < 0.72 && (0.28..0.40).contains(&z) {
        let slat = if ((z * 28.0).fract()) < 0.3 { 2.2 } else { 0.7 };
        return plastic(slat);
    }
    if z < 0.30 {
        plastic(0.9)
    } else {
        painted(paint, normal)
    }
}

fn rear_texel(build: &Build, paint: &Paint, normal: Vec3, p: Vec3) -> Texel {
    let half = 0.5 * build.size.y;
    let tail = build.nose_cowl_tail_z[2];
    let (y, z) = (p.y.abs() / half, p.z);
    if (tail - 0.30..tail - 0.12).contains(&z) && (0.55..0.97).contains(&y) {
        let bulb = smoothstep(0.16, 0.05, (y - 0.8).abs());
        let red = display(120, 8, 10).lerp(display(226, 30, 26), bulb);
        return Texel {
            gloss: 0.8,
            openness: 1.1,
            ..Texel::matt(red)
        };
    }
    if p.y.abs() < 0.26 && (0.52..0.64).contains(&z) {
        return plate(p.y, z - 0.52);
    }
    if (p.y.abs() < 0.31 && (0.49..0.67).contains(&z)) || z < 0.36 {
        return plastic(0.9);
    }
    // The lower edge of the boot lid.
    if (z - 0.76).abs() < 0.012 && y < 0.8 {
        return plastic(0.5);
    }
    painted(paint, normal)
}

/// A license plate 0.52 m by 0.12 m: a pale ground with marks that read as writing.
fn plate(y: f32, z: f32) -> Texel {
    let (column, row) = (
        ((y + 0.22) / 0.032).floor() as i32,
        ((z - 0.025) / 0.024).floor() as i32,
    );
    let written = y.abs() < 0.21
        && (0.025..0.095).contains(&z)
        && column % 3 != 0
        && cell(77, column, row) > 0.42;
    let albedo = if written {
        display(30, 32, 40)
    } else if y > 0.225 {
        display(30, 70, 160)
    } else {
        display(238, 238, 230)
    };
    Texel::matt(albedo)
}

fn side_texel(build: &Build, paint: &Paint, normal: Vec3, p: Vec3) -> Texel {
    let low = p.z - build.bottom_z(p.x);
    if normal.y.abs() > 0.45 {
        if low < 0.09 {
            return plastic(0.8);
        }
        let door_x = [
            build.cowl_x - 0.18,
            0.5 * (build.cowl_x + build.roof_x[1]) - 0.05,
            build.axles_x[1] + build.wheel_radius_m + 0.12,
        ];
        let between = (door_x[2] - 0.02..door_x[0] + 0.02).contains(&p.x);
        let gap_m = door_x.iter().map(|x| (p.x - x).abs()).fold(FAR_M, f32::min);
        let belt_m = build.top_z(p.x) - p.z;
        if gap_m < 0.011 && belt_m > 0.06 {
            return plastic(0.35);
        }
        let handle = [door_x[1] + 0.12, door_x[2] + 0.28]
            .iter()
            .any(|x| (p.x - x).abs() < 0.1)
            && (belt_m - 0.17).abs() < 0.016;
        if handle && between {
            return Texel {
                gloss: 0.6,
                ..Texel::matt(display(176, 180, 184))
            };
        }
        if paint.taxi && between && (belt_m - 0.3).abs() < 0.07 {
            let dark = ((p.x / 0.09).floor() as i32 + (p.z / 0.07).floor() as i32) % 2 == 0;
            return Texel {
                gloss: 0.7,
                ..Texel::matt(if dark {
                    display(20, 20, 22)
                } else {
                    display(240, 240, 236)
                })
            };
        }
        // The front and rear lamps wrap round the corners.
        let ends = 0.5 * build.size.x;
        let nose = build.nose_cowl_tail_z[0];
        if p.x < -ends + 0.45
            && (build.nose_cowl_tail_z[2] - 0.28..build.nose_cowl_tail_z[2] - 0.13).contains(&p.z)
        {
            return Texel {
                gloss: 0.8,
                ..Texel::matt(display(170, 14, 16))
            };
        }
        if p.x > ends - 0.5 && (nose - 0.15..nose - 0.03).contains(&p.z) {
            return Texel {
                gloss: 0.9,
                ..Texel::matt(display(206, 210, 214))
            };
        }
    } else if normal.z > 0.5 {
        // The gap about the hood.
        let half = 0.5 * build.size.y;
        if p.x > build.cowl_x && (p.y.abs() - 0.8 * half).abs() < 0.012
            || (p.x - build.cowl_x - 0.06).abs() < 0.02
        {
            return plastic(0.5);
        }
    }
    painted(paint, normal)
}

/// Cabin: glass between pillars, a painted roof.
pub(super) fn cabin_texel(build: &Build, paint: &Paint, point: &SurfacePoint, p: Vec3) -> Texel {
    let rise = (p.z - build.belt_z()) / (build.size.z - build.belt_z());
    if rise > 0.86 || point.normal.z > 0.93 {
        if paint.taxi
            && (p.x - 0.5 * (build.roof_x[0] + build.roof_x[1])).abs() < 0.12
            && p.y.abs() < 0.3
        {
            return Texel::matt(display(250, 250, 240));
        }
        return painted(paint, point.normal);
    }
    let half = 0.5 * build.size.y * (0.93 - 0.16 * rise);
    let [front, rear] = build.cabin_x(rise);
    let sideways = point.normal.y.abs() > 0.66;
    let border_m = if sideways {
        // A pillar behind the front doors, and before and behind the rear ones.
        let middle = 0.5 * (build.cowl_x + build.roof_x[1]) - 0.05;
        let cargo_wall = paint.cargo && p.x < middle - 0.1;
        let pillars = (p.x - middle).abs() - 0.045;
        if cargo_wall {
            -1.0
        } else {
            pillars.min(front - 0.16 - p.x).min(p.x - rear - 0.2)
        }
    } else if p.x > 0.5 * (front + rear) {
        half - 0.12 - p.y.abs()
    } else if paint.cargo {
        (half - 0.2 - p.y.abs()).min(p.y.abs() - 0.06)
    } else {
        half - 0.16 - p.y.abs()
    };
    let border_m = border_m.min((rise - 0.1) * 0.5).min((0.86 - rise) * 0.5);
    if border_m > 0.0 {
        glass(rise)
    } else if border_m > -0.022 {
        // Rubber about the panes.
        plastic(0.6)
    } else {
        painted(paint, point.normal)
    }
}

/// Tinted glass: dark below, mirroring the sky towards the roof.
fn glass(rise: f32) -> Texel {
    let albedo = display(22, 27, 32).lerp(display(92, 118, 140), smoothstep(0.35, 1.0, rise));
    Texel {
        gloss: 1.0,
        ..Texel::matt(albedo)
    }
}

/// A wheel seen from its side, `at` in radii from the hub: tire, rim and five double spokes.
pub(super) fn rim_texel(at: Vec2) -> Texel {
    let radius = at.length();
    if radius > 0.68 {
        let wall = if (0.80..0.84).contains(&radius) {
            1.5
        } else {
            1.0
        };
        return Texel {
            openness: 0.7,
            ..Texel::matt(display(42, 42, 44) * wall)
        };
    }
    let silver = display(186, 190, 194);
    if !(0.14..0.60).contains(&radius) {
        return Texel {
            gloss: 0.7,
            ..Texel::matt(silver * if radius < 0.06 { 0.5 } else { 1.0 })
        };
    }
    let turn = (at.y.atan2(at.x) / std::f32::consts::TAU * 5.0).rem_euclid(1.0);
    let spoke = (turn - 0.5).abs() * radius < 0.16 - 0.1 * radius;
    if spoke {
        Texel {
            gloss: 0.6,
            ..Texel::matt(silver * (0.8 + 0.2 * radius))
        }
    } else {
        plastic(0.7)
    }
}
