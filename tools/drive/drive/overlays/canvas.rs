//! Image that lines and words are drawn onto.

use std::path::Path;

use anyhow::{Context, Result};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X10, FONT_10X20};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};
use glam::DVec2;
use tiny_skia::{
    Color, FillRule, LineCap, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke,
    Transform,
};

/// Width of images from which on letters are large, pixels.
const WIDE_PX: u32 = 480;
/// Darkness of the ground behind words, 0 to 1.
const GROUND: f32 = 0.55;

/// An image.
pub struct Canvas(Pixmap);

impl Canvas {
    pub fn open(path: &Path) -> Result<Self> {
        let pixels = Pixmap::load_png(path);
        Ok(Self(pixels.with_context(|| {
            format!("{} cannot be read", path.display())
        })?))
    }

    pub fn save(&self, path: &Path) -> Result<()> {
        let saved = self.0.save_png(path);
        saved.with_context(|| format!("{} cannot be written", path.display()))
    }

    /// A line through pixels; it is interrupted where one is `None`.
    pub fn line(&mut self, pixels: &[Option<DVec2>], color: [u8; 3], width_px: f32) {
        let mut path = PathBuilder::new();
        for pair in pixels.windows(2) {
            if let [Some(from), Some(to)] = [pair[0], pair[1]].map(|end| self.within(end)) {
                path.move_to(from[0], from[1]);
                path.line_to(to[0], to[1]);
            }
        }
        let Some(path) = path.finish() else { return };
        let stroke = Stroke {
            width: width_px * self.scale(),
            line_cap: LineCap::Round,
            ..Stroke::default()
        };
        let paint = paint(color);
        (self.0).stroke_path(&path, &paint, &stroke, Transform::identity(), None);
    }

    /// A disk about a pixel.
    pub fn dot(&mut self, pixel: Option<DVec2>, color: [u8; 3], radius_px: f32) {
        let Some([x, y]) = self.within(pixel) else {
            return;
        };
        let circle = PathBuilder::from_circle(x, y, radius_px * self.scale());
        if let Some(circle) = circle {
            let paint = paint(color);
            (self.0).fill_path(
                &circle,
                &paint,
                FillRule::Winding,
                Transform::identity(),
                None,
            );
        }
    }

    /// Lines of text at the top left, over a dark ground.
    pub fn words(&mut self, lines: &[(String, [u8; 3])]) {
        let font: &MonoFont = match self.0.width() < WIDE_PX {
            true => &FONT_6X10,
            false => &FONT_10X20,
        };
        let [across, down] = [font.character_size.width, font.character_size.height];
        let longest = lines.iter().map(|(line, _)| line.chars().count()).max();
        let width_px = (longest.unwrap_or(0) as u32 + 1) * across;
        let height_px = lines.len() as u32 * down + down / 2;
        let ground = Rect::from_xywh(0.0, 0.0, width_px as f32, height_px as f32);
        if let Some(ground) = ground {
            let mut paint = Paint::default();
            paint.set_color(Color::from_rgba(0.0, 0.0, 0.0, GROUND).unwrap_or(Color::BLACK));
            (self.0).fill_rect(ground, &paint, Transform::identity(), None);
        }
        for (index, (line, [r, g, b])) in lines.iter().enumerate() {
            let style = MonoTextStyle::new(font, Rgb888::new(*r, *g, *b));
            let at = Point::new(across as i32 / 2, (index as u32 * down + down / 4) as i32);
            // Drawing onto pixels in memory cannot fail.
            let _ = Text::with_baseline(line, at, style, Baseline::Top).draw(self);
        }
    }

    /// Width of lines in large images, in multiples of that in small ones.
    fn scale(&self) -> f32 {
        (self.0.width() as f32 / 960.0).clamp(0.5, 2.0)
    }

    /// A pixel as the path builder takes it; `None` far outside the image.
    fn within(&self, pixel: Option<DVec2>) -> Option<[f32; 2]> {
        let size = DVec2::new(self.0.width().into(), self.0.height().into());
        let pixel = pixel?;
        let is_near = pixel.cmpgt(-size).all() && pixel.cmplt(2.0 * size).all();
        is_near.then(|| pixel.as_vec2().to_array())
    }
}

fn paint(color: [u8; 3]) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(color[0], color[1], color[2], 255);
    paint.anti_alias = true;
    paint
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = std::convert::Infallible;

    fn draw_iter<I>(&mut self, pixels: I) -> Result<(), Self::Error>
    where
        I: IntoIterator<Item = Pixel<Self::Color>>,
    {
        let [width, height] = [self.0.width(), self.0.height()].map(i64::from);
        for Pixel(at, color) in pixels {
            let [x, y] = [at.x, at.y].map(i64::from);
            let is_inside = (0..width).contains(&x) && (0..height).contains(&y);
            let color = PremultipliedColorU8::from_rgba(color.r(), color.g(), color.b(), 255);
            if let Some(color) = color.filter(|_| is_inside) {
                self.0.pixels_mut()[(y * width + x) as usize] = color;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black() -> Canvas {
        let mut pixels = Pixmap::new(200, 100).unwrap();
        pixels.fill(Color::BLACK);
        Canvas(pixels)
    }

    /// Pixels that are not black, with the middle of them.
    fn lit(canvas: &Canvas) -> (usize, DVec2) {
        let pixels = canvas.0.pixels().iter().enumerate();
        let lit = pixels.filter(|(_, pixel)| pixel.red().max(pixel.blue()) > 64);
        let places: Vec<DVec2> = lit
            .map(|(index, _)| DVec2::new((index % 200) as f64 + 0.5, (index / 200) as f64 + 0.5))
            .collect();
        let count = places.len();
        (count, places.iter().sum::<DVec2>() / count.max(1) as f64)
    }

    #[test]
    fn lines_and_dots_lie_where_they_are_told() {
        let mut canvas = black();
        let ends = [DVec2::new(20.0, 50.0), DVec2::new(180.0, 50.0)];
        canvas.line(&ends.map(Some), [255, 0, 0], 4.0);
        let (count, middle) = lit(&canvas);
        assert!((300..400).contains(&count), "{count}");
        assert!(middle.distance(DVec2::new(100.0, 50.0)) < 0.6, "{middle}");
        let mut canvas = black();
        canvas.dot(Some(DVec2::new(30.0, 70.0)), [0, 0, 255], 8.0);
        let (count, middle) = lit(&canvas);
        assert!((30..70).contains(&count), "{count}");
        assert!(middle.distance(DVec2::new(30.0, 70.0)) < 0.3, "{middle}");
    }

    #[test]
    fn what_is_not_in_the_image_draws_nothing() {
        let mut canvas = black();
        let inside = Some(DVec2::new(50.0, 50.0));
        canvas.line(&[inside, None, inside], [255, 0, 0], 2.0);
        canvas.line(&[inside, Some(DVec2::new(1e9, 50.0))], [255, 0, 0], 2.0);
        canvas.dot(None, [255, 0, 0], 2.0);
        assert_eq!(lit(&canvas).0, 0);
        // Words that are longer than the image are cut.
        canvas.words(&[("long ".repeat(40), [255; 3]), ("²".into(), [255, 0, 0])]);
        assert!(lit(&canvas).0 > 200);
    }
}
