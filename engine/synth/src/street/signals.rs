//! Traffic lights: posts of the crossing with their heads, and heads as assets that show a color.
//! Stop and yield signs as assets.

use decouplegs_scene::{LightColor, Pose, SignKind, SplatCloud};
use glam::{Quat, Vec3};

use super::AssetLight;
use super::emit::emit;
use super::focus::Focus;
use super::furniture::post;
use super::layout::{Axis, KERB_M, LANES_HALF_M, ROAD_HALF_M};
use super::light::Light;
use super::loft::Loft;
use super::surface::{Element, Shape, SurfacePoint, Texel, boxed, display};
use super::weather::Air;

/// Half the size of a head, meters.
const HEAD_HALF_M: Vec3 = Vec3::new(0.13, 0.19, 0.5);
/// Difference in size of heads that are assets to those of the background, which they hide, meters:
/// a dark layer, for splats are not wholly opaque, and the head.
const COVER_M: [f32; 2] = [0.02, 0.04];
/// Height of a head on a post, meters.
const HEAD_Z_M: f32 = 3.0;
/// Albedo of lenses of assets that are not lit, relative to their color.
const UNLIT: f32 = 0.03;
/// Height of the middle of a sign, and its radius, meters; splats of its face relative to a post's.
const SIGN_Z_M: f32 = 2.3;
const SIGN_RADIUS_M: f32 = 0.42;
const SIGN_DENSITY: f32 = 30.0;
/// Splats of a head, a post or a sign that is an asset.
const ASSET_SPLATS: usize = 3_000;
/// Seed of the assets.
const SEED: u64 = 1;

/// Head of a traffic light of the street.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalHead {
    /// Name of its light in the street's map.
    pub light: &'static str,
    /// Middle of the head; x is the direction of the traffic that obeys it.
    pub pose: Pose,
}

/// A traffic light before the crossing on every arm: green for the main street, red for the other.
pub(super) fn traffic_lights() -> Vec<Element> {
    let mut elements = Vec::new();
    for (foot, yaw_rad, axis) in signal_feet() {
        let lit = match axis {
            Axis::Main => LightColor::Green,
            Axis::Cross => LightColor::Red,
        };
        elements.extend(
            signal(lit)
                .into_iter()
                .map(|e| e.placed(Quat::from_rotation_z(yaw_rad), foot)),
        );
    }
    elements
}

/// All heads of the street.
pub(super) fn heads() -> Vec<SignalHead> {
    signal_feet()
        .flat_map(|(foot, yaw_rad, axis)| {
            let light = match axis {
                Axis::Main => "main",
                Axis::Cross => "cross",
            };
            let turn = Quat::from_rotation_z(yaw_rad);
            head_centers().map(move |center| SignalHead {
                light,
                pose: Pose::from_yaw(f64::from(yaw_rad), (foot + turn * center).as_dvec3()),
            })
        })
        .collect()
}

/// Feet of the posts of the traffic lights, their headings, and the street whose traffic they stop.
pub(super) fn signal_feet() -> impl Iterator<Item = (Vec3, f32, Axis)> {
    [Axis::Main, Axis::Cross].into_iter().flat_map(|axis| {
        [-1.0f32, 1.0].map(|arm| {
            let s = axis.crossing_s() + arm * (ROAD_HALF_M + 4.9);
            let foot = axis.at(s, arm * (ROAD_HALF_M + 0.55)).extend(KERB_M);
            // Local x runs with the traffic that obeys it, so the lenses face -x; local y is
            // that traffic's left.
            let turned_rad = if arm < 0.0 { 0.0 } else { std::f32::consts::PI };
            (foot, axis.yaw_rad() + turned_rad, axis)
        })
    })
}

/// End of the arm of a post.
fn arm_end() -> Vec3 {
    Vec3::new(0.0, ROAD_HALF_M - LANES_HALF_M + 2.2, 6.0)
}

/// Heads of a post: beside the road and over it.
fn head_centers() -> [Vec3; 2] {
    [Vec3::Z * HEAD_Z_M, arm_end() - Vec3::Z * 0.55]
}

fn signal(lit: LightColor) -> Vec<Element> {
    let top = Vec3::Z * 5.9;
    let mut elements = vec![post(Vec3::ZERO, top, 0.1), post(top, arm_end(), 0.07)];
    for center in head_centers() {
        elements.extend(head(center, HEAD_HALF_M, lit, 0.12));
    }
    elements
}

fn head(center: Vec3, half: Vec3, lit: LightColor, unlit: f32) -> Vec<Element> {
    boxed(center - half, center + half, 9.0, move |point| {
        let offset = point.position - center;
        let lens = (-(offset.z / 0.31).round()).clamp(-1.0, 1.0);
        let radius_m = (offset.y * offset.y + (offset.z + lens * 0.31).powi(2)).sqrt();
        if point.normal.x > -0.5 || radius_m > 0.125 {
            return Texel::matt(display(34, 36, 36));
        }
        let (shows, color) = match lens as i32 {
            -1 => (LightColor::Red, display(255, 60, 44)),
            0 => (LightColor::Yellow, display(220, 160, 40)),
            _ => (LightColor::Green, display(70, 255, 150)),
        };
        if shows == lit {
            Texel {
                emitted: Some(color),
                ..Texel::matt(color)
            }
        } else {
            Texel::matt(color * unlit)
        }
    })
}

/// Heads that show green, yellow and red, and hide a head of the background. Origin in the middle.
#[must_use]
pub fn head_assets() -> [SplatCloud; 3] {
    LightColor::ALL.map(|lit| {
        let half = COVER_M.map(|cover_m| HEAD_HALF_M + cover_m);
        let dark = |_: &SurfacePoint| Texel::matt(display(34, 36, 36));
        let mut elements = boxed(-half[0], half[0], 9.0, dark);
        elements.extend(head(Vec3::ZERO, half[1], lit, UNLIT));
        asset(&elements)
    })
}

/// Posts with a head that show green, yellow and red. Origin at the foot.
#[must_use]
pub fn post_assets() -> [SplatCloud; 3] {
    LightColor::ALL.map(|lit| {
        let mut elements = vec![post(Vec3::ZERO, Vec3::Z * HEAD_Z_M, 0.08)];
        elements.extend(head(Vec3::Z * HEAD_Z_M, HEAD_HALF_M, lit, UNLIT));
        asset(&elements)
    })
}

/// Stop and yield signs on a post, in the order of [`SignKind::ALL`]. Origin at the foot; x is the
/// direction of the traffic that obeys them.
#[must_use]
pub fn sign_assets() -> [SplatCloud; 2] {
    SignKind::ALL.map(|kind| {
        let center = Vec3::new(-0.06, 0.0, SIGN_Z_M);
        // An octagon, or a triangle on its tip.
        let (corners, first) = match kind {
            SignKind::Stop => (8.0, 0.5),
            SignKind::Yield => (3.0, 0.25),
        };
        let corner = move |at: f32| {
            let (sin, cos) = (std::f32::consts::TAU * (at + first) / corners).sin_cos();
            Vec3::new(0.0, cos, sin) * SIGN_RADIUS_M
        };
        let edge = move |u: f32| {
            let at = (corners * u).min(corners - 1e-3);
            corner(at.floor()).lerp(corner(at.floor() + 1.0), at.fract())
        };
        let face = Loft::new(center + Vec3::X * 4.0, move |u, v| center + edge(u) * v);
        let face = Element::new(Shape::Loft(face.bordered()), SIGN_DENSITY, move |point| {
            let offset = point.position - center;
            // Four blocks where the letters are.
            let block = (offset.y / 0.14 + 0.5).rem_euclid(1.0) - 0.5;
            let letters = offset.z.abs() < 0.1 && offset.y.abs() < 0.28 && block.abs() > 0.12;
            let (red, white) = (display(196, 24, 32), display(240, 240, 236));
            let rim = point.v > 0.8;
            Texel::matt(match kind {
                SignKind::Stop if letters || point.v > 0.93 => white,
                SignKind::Yield if !rim => white,
                _ => red,
            })
        });
        asset(&[post(Vec3::ZERO, Vec3::Z * SIGN_Z_M, 0.05), face])
    })
}

fn asset(elements: &[Element]) -> SplatCloud {
    let air = Air::of_assets(AssetLight::Neutral);
    let light = Light::new(air, vec![]).on_asset(Quat::IDENTITY, Vec3::ZERO);
    emit(elements, ASSET_SPLATS, 0, SEED, &light, &Focus::nowhere())
}
