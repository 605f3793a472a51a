//! Lanes as rows of splats across them, each as long as it may be along the lane and narrow beside
//! painted lines.

use decouplegs_scene::LaneKind;
use glam::{Vec2, Vec3};

use super::Drawn;
use super::canvas::{Canvas, Disc, Look};
use super::paint::{DASH_M, LINE_M, Line, line};
use super::strips::{Section, Strip};
use crate::street::random::{cell, fractal_noise, smoothstep};
use crate::street::surface::display;

/// Length of a row and width of its columns over the spacing.
const ROW_OVER_SPACING: f32 = 1.6;
const COLUMN_OVER_SPACING: f32 = 0.8;

/// Longest row over the spacing, meters: bends are followed.
const ROW_M_MAX: f32 = 6.0;

/// Ratio of the widths of neighboring columns, away from a line.
const WIDENING: f32 = 1.7;

/// Standard deviations over length and width: at 0.55 a tenth of what is below shines through as a
/// lattice. Beside lines narrower, so that they stay white.
pub(super) const SCALE_OVER_ROW: f32 = 0.7;
const SCALE_OVER_COLUMN: f32 = 0.68;
const SCALE_BESIDE_LINE: f32 = 0.46;

/// Sidewalks lie above the road, meters.
const KERB_M: f32 = 0.09;

pub(super) fn pavement(canvas: &mut Canvas, place: &Drawn, spacing_m: f32) {
    for (index, strip) in place.index.strips.iter().enumerate() {
        let mut at_m = 0.0;
        while at_m < strip.length_m() && !canvas.is_full() {
            let row = Row::new(place, (index, strip), at_m, spacing_m);
            row.lay(canvas, place);
            at_m += row.length_m;
        }
    }
}

/// A piece of a lane, cut across.
struct Row<'a> {
    index: usize,
    strip: &'a Strip,
    section: Section,
    ahead: Vec3,
    at_m: f32,
    length_m: f32,
    column_m: f32,
    lines: [Line; 2],
}

impl<'a> Row<'a> {
    /// The row of a strip from `at_m` on. Rows end where dashes do.
    fn new(place: &Drawn, (index, strip): (usize, &'a Strip), at_m: f32, spacing_m: f32) -> Self {
        let spacing_m = spacing_m * place.coarseness(strip.at(at_m).middle());
        let dashes_in = (DASH_M / (ROW_OVER_SPACING * spacing_m).min(ROW_M_MAX)).max(0.5);
        let piece_m = DASH_M
            / if dashes_in < 1.0 {
                0.5
            } else {
                dashes_in.ceil()
            };
        let end_m = ((at_m / piece_m + 1e-3).floor() + 1.0) * piece_m;
        let length_m = (end_m.min(strip.length_m()) - at_m).max(1e-2);
        let section = strip.at(at_m + 0.5 * length_m);
        let ahead =
            (strip.at(at_m + length_m).middle() - strip.at(at_m).middle()).normalize_or(Vec3::X);
        let line = |on_left| line(&place.index, index, &section, ahead.truncate(), on_left);
        let lines = [line(false), line(true)];
        Self {
            index,
            strip,
            section,
            ahead,
            at_m,
            length_m,
            column_m: COLUMN_OVER_SPACING * spacing_m,
            lines,
        }
    }

    fn lay(&self, canvas: &mut Canvas, place: &Drawn) {
        let width_m = self.section.width_m();
        if width_m < 0.05 {
            return;
        }
        let edges = self.edges(width_m);
        for pair in edges.windows(2) {
            let (middle_m, column_m) = (0.5 * (pair[0] + pair[1]), pair[1] - pair[0]);
            let beside_line =
                self.lines.iter().any(|line| *line != Line::None) && column_m < 2.0 * LINE_M;
            let scale = if beside_line {
                SCALE_BESIDE_LINE
            } else {
                SCALE_OVER_COLUMN
            };
            let at = self
                .section
                .right
                .lerp(self.section.left, middle_m / width_m);
            if place.index.owns(self.index, at) {
                let albedo = self.albedo(place.seed, at, middle_m / width_m);
                canvas.push(self.disc(at, scale * column_m, albedo, gloss(self.strip.kind)));
            }
        }
        for (line, border) in self
            .lines
            .into_iter()
            .zip([self.section.right, self.section.left])
        {
            let dash = ((self.at_m + 0.5 * self.length_m) / DASH_M).floor() as i64 % 3 == 0;
            match line {
                Line::None | Line::OfNeighbor => {}
                Line::Dashed if !dash => {
                    let albedo = self.albedo(place.seed, border, 0.0);
                    canvas.push(self.disc(
                        border,
                        SCALE_OVER_COLUMN * LINE_M,
                        albedo,
                        gloss(self.strip.kind),
                    ));
                }
                Line::Dashed | Line::Solid => {
                    let worn = 0.82
                        + 0.3 * fractal_noise(place.seed + 61, border.x * 0.7, border.y * 0.7, 3);
                    canvas.push(self.disc(
                        border,
                        0.42 * LINE_M,
                        display(236, 234, 226) * worn.min(1.0),
                        0.15,
                    ));
                }
            }
        }
    }

    /// Column boundaries, meters from the right border: fine beside lines, equal without lines.
    fn edges(&self, width_m: f32) -> Vec<f32> {
        let half_m = 0.5 * width_m;
        let from_border = |line: Line| {
            let mut edges = vec![if line == Line::None {
                0.0
            } else {
                (0.5 * LINE_M).min(0.5 * half_m)
            }];
            let mut column_m = if line == Line::None {
                self.column_m
            } else {
                self.column_m.min(LINE_M)
            };
            while edges[edges.len() - 1] + 1.4 * column_m < half_m {
                edges.push(edges[edges.len() - 1] + column_m);
                column_m = (WIDENING * column_m).min(self.column_m);
            }
            edges
        };
        let mut edges = from_border(self.lines[0]);
        let left = from_border(self.lines[1]);
        // The two meet in the middle of the lane; without lines one column may be all there is.
        if edges.len() > 1 || left.len() > 1 || self.column_m < half_m {
            edges.push(half_m);
        }
        edges.extend(left.iter().rev().map(|edge| width_m - edge));
        edges
    }

    fn disc(&self, middle: Vec3, across_m: f32, albedo: Vec3, gloss: f32) -> Disc {
        let lift_m = if self.strip.kind == LaneKind::Walking {
            KERB_M
        } else {
            0.0
        };
        let across = (self.section.left - self.section.right).normalize_or(Vec3::Y);
        let across = (across - self.ahead * across.dot(self.ahead)).normalize_or(Vec3::Y);
        Disc {
            middle: middle + Vec3::Z * lift_m,
            along: self.ahead * (SCALE_OVER_ROW * self.length_m),
            across: across * across_m,
            albedo,
            look: Look::Lit { gloss },
        }
    }

    /// Linear RGB of the surface, `place` of the way from the right border to the left.
    fn albedo(&self, seed: u64, at: Vec3, place: f32) -> Vec3 {
        match self.strip.kind {
            LaneKind::Driving | LaneKind::Parking => {
                display(114, 112, 111) * wear(seed, at.truncate(), place)
            }
            LaneKind::Bicycle => display(132, 98, 88) * wear(seed, at.truncate(), 0.0),
            LaneKind::Walking => {
                display(172, 166, 156)
                    * (0.8 + 0.35 * fractal_noise(seed + 41, at.x * 0.8, at.y * 0.8, 3))
            }
            // Shoulders and medians are paved where narrow.
            LaneKind::Other if self.section.width_m() < 2.5 => {
                display(128, 125, 120) * wear(seed, at.truncate(), 0.0)
            }
            LaneKind::Other => {
                display(104, 118, 70)
                    * (0.6 + 0.8 * fractal_noise(seed + 157, at.x * 0.9, at.y * 0.9, 3))
            }
        }
    }
}

fn gloss(kind: LaneKind) -> f32 {
    match kind {
        LaneKind::Driving | LaneKind::Parking => 0.35,
        LaneKind::Bicycle | LaneKind::Walking => 0.1,
        LaneKind::Other => 0.05,
    }
}

/// Aging of asphalt: a factor on its albedo.
fn wear(seed: u64, at: Vec2, place: f32) -> f32 {
    let coarse = fractal_noise(seed, at.x * 0.16, at.y * 0.16, 4);
    // Of each splat its own: a smooth noise as fine as splats would show as a pattern of theirs.
    let grain = cell(seed + 5, (at.x * 64.0) as i32, (at.y * 64.0) as i32);
    let tracks = (-((((place - 0.5).abs() - 0.24) * 12.0).powi(2))).exp();
    // Cracks follow the zero of a slow noise.
    let ridge = (fractal_noise(seed + 21, at.x * 0.23, at.y * 0.23, 3) - 0.5).abs();
    (0.9 + 0.3 * (coarse - 0.5) + 0.12 * (grain - 0.5))
        * (1.0 - 0.12 * tracks)
        * (1.0 - 0.2 * smoothstep(0.012, 0.003, ridge))
}
