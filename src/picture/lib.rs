//! Pictures of a deformed body, coloured by displacement.

mod camera;
mod raster;
mod surface;

use camera::{Camera, Frame};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle, iso_8859_1::FONT_10X20};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use nalgebra::Vector3;
use raster::{Corner, Raster, Rgb, linear};
use std::convert::Infallible;
use std::io::{BufWriter, Write};
use surface::Surface;

const WIDTH: usize = 1280;
const HEIGHT: usize = 960;
const BACKGROUND: [u8; 3] = [250, 250, 250];
const INK: Rgb888 = Rgb888::new(40, 40, 45);
const FONT: MonoFont<'static> = FONT_10X20;

/// Where the body goes: the captions stand above and below, the legend to the right.
const FRAME: Frame = Frame { left: 50.0, top: 100.0, width: 1000.0, height: 780.0 };
/// The legend's bar: left, top, width, height.
const BAR: [usize; 4] = [1130, 200, 26, 560];
const N_TICKS: usize = 5;

/// A body that is drawn several times, always from the same side and at the same scale.
pub struct Album {
    rest: Vec<Vector3<f64>>,
    surface: Surface,
    camera: Camera,
    max_displacement_m: f64,
}

/// One picture of it.
pub struct Picture<'a> {
    /// Above the body.
    pub title: &'a str,
    /// Below the body.
    pub caption: &'a str,
    /// The displacement of every vertex in m, `n_vertices × 3`.
    pub displacement: &'a [f32],
    /// Pairs joined by stitches, drawn as dots.
    pub stitches: &'a [[u32; 2]],
}

impl Album {
    /// Of a body at `vertices` (in m). Looks at `focus` (vertices worth seeing) and makes room for every one of `displacements`.
    pub fn new(
        vertices: &[[f64; 3]],
        tets: &[[u32; 4]],
        focus: &[[u32; 2]],
        displacements: &[&[f32]],
    ) -> Album {
        let rest: Vec<Vector3<f64>> = vertices.iter().map(|x| Vector3::from(*x)).collect();
        let surface = Surface::of(rest.len(), tets);
        let mut on_surface: Vec<u32> = surface.triangles().iter().flatten().copied().collect();
        on_surface.sort_unstable();
        on_surface.dedup();
        let mut points = Vec::with_capacity(on_surface.len() * displacements.len());
        let mut max_displacement_m = 0.0f64;
        for displacement in displacements {
            let moved = deformed(&rest, displacement);
            points.extend(on_surface.iter().map(|&v| moved[v as usize]));
            let norms = displacement.chunks_exact(3).map(norm);
            max_displacement_m = norms.fold(max_displacement_m, f64::max);
        }
        let seen: Vec<Vector3<f64>> = focus.iter().flatten().map(|&v| rest[v as usize]).collect();
        let focus = seen.iter().sum::<Vector3<f64>>() / seen.len().max(1) as f64;
        let camera = Camera::facing(focus, &points, FRAME);
        Album { rest, surface, camera, max_displacement_m }
    }

    /// Draws one picture and writes it as PNG.
    pub fn write(&self, picture: &Picture<'_>, file: impl Write) -> Result<(), png::EncodingError> {
        let moved = deformed(&self.rest, picture.displacement);
        let normals = self.surface.corner_normals(&moved);
        let mut raster = Raster::new(WIDTH, HEIGHT, linear(BACKGROUND));
        let value = |vertex: u32| {
            let at = 3 * vertex as usize;
            norm(&picture.displacement[at..at + 3]) / self.max_displacement_m.max(f64::MIN_POSITIVE)
        };
        for (triangle, normals) in self.surface.triangles().iter().zip(normals) {
            let corners = [0, 1, 2].map(|i| Corner {
                position: moved[triangle[i] as usize],
                normal: normals[i],
                value: value(triangle[i]),
            });
            raster.triangle(&self.camera, &corners, colour);
        }
        raster.outline();
        for [a, b] in picture.stitches {
            for vertex in [a, b] {
                let position = &moved[*vertex as usize];
                raster.disc(&self.camera, position, 5.0, linear([255, 255, 255]));
                raster.disc(&self.camera, position, 3.5, linear([190, 30, 30]));
            }
        }
        let mut canvas = Canvas { bytes: raster.to_srgb() };
        self.legend(&mut canvas);
        canvas.text(picture.title, [50, 40], Alignment::Left);
        for (line, text) in picture.caption.lines().enumerate() {
            canvas.text(text, [50, HEIGHT as i32 - 60 + 24 * line as i32], Alignment::Left);
        }
        canvas.write(file)
    }

    /// The colour map with its scale in mm, and a bar of a round length.
    fn legend(&self, canvas: &mut Canvas) {
        let [left, top, width, height] = BAR;
        for row in 0..height {
            let value = 1.0 - row as f64 / (height - 1) as f64;
            for column in 0..width {
                canvas.set(left + column, top + row, map(value));
            }
        }
        let max_mm = 1e3 * self.max_displacement_m;
        let decimals = (2.0 - max_mm.max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize;
        for tick in 0..N_TICKS {
            let fraction = tick as f64 / (N_TICKS - 1) as f64;
            let y = top + ((1.0 - fraction) * (height - 1) as f64) as usize;
            for column in 0..6 {
                canvas.set(left + width + column, y, [INK.r(), INK.g(), INK.b()]);
            }
            let label = format!("{:.decimals$}", fraction * max_mm);
            canvas.text(&label, [(left + width + 12) as i32, y as i32 - 10], Alignment::Left);
        }
        let middle = (left + width / 2) as i32;
        canvas.text("displacement", [middle + 10, top as i32 - 56], Alignment::Center);
        canvas.text("mm", [middle, top as i32 - 32], Alignment::Center);

        let length_mm = round_length(120.0 / self.camera.pixels_per_m() * 1e3);
        let length_px = (length_mm * 1e-3 * self.camera.pixels_per_m()) as usize;
        let (x, y) = (left, top + height + 70);
        for column in 0..length_px {
            for row in 0..3 {
                canvas.set(x + column, y + row, [INK.r(), INK.g(), INK.b()]);
            }
        }
        let label = format!("{length_mm} mm");
        canvas.text(&label, [(x + length_px / 2) as i32, y as i32 + 8], Alignment::Center);
    }
}

/// The largest of 1, 2, 5 × 10ⁿ that is not above `length`.
fn round_length(length: f64) -> f64 {
    let decade = 10f64.powf(length.max(1e-12).log10().floor());
    let steps = [5.0, 2.0, 1.0].map(|step| step * decade);
    steps.into_iter().find(|step| *step <= length).unwrap_or(decade)
}

fn deformed(rest: &[Vector3<f64>], displacement: &[f32]) -> Vec<Vector3<f64>> {
    let moved = |(x, u): (&Vector3<f64>, &[f32])| x + Vector3::from_fn(|i, _| f64::from(u[i]));
    rest.iter().zip(displacement.chunks_exact(3)).map(moved).collect()
}

fn norm(u: &[f32]) -> f64 {
    u.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt()
}

/// The colour map: perceptually uniform, readable without colour vision.
fn map(value: f64) -> [u8; 3] {
    let colour = colorous::VIRIDIS.eval_continuous(value.clamp(0.0, 1.0));
    [colour.r, colour.g, colour.b]
}

fn colour(value: f64) -> Rgb {
    linear(map(value))
}

/// Pixels in sRGB to write on.
struct Canvas {
    bytes: Vec<u8>,
}

impl Canvas {
    fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < WIDTH && y < HEIGHT {
            let at = 3 * (y * WIDTH + x);
            self.bytes[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn text(&mut self, text: &str, [x, y]: [i32; 2], alignment: Alignment) {
        let layout = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Top).build();
        let style = MonoTextStyle::new(&FONT, INK);
        let Ok(_) = Text::with_text_style(text, Point::new(x, y), style, layout).draw(self);
    }

    fn write(&self, file: impl Write) -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(BufWriter::new(file), WIDTH as u32, HEIGHT as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.bytes)?;
        writer.finish()
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(WIDTH as u32, HEIGHT as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(Point { x, y }, colour) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) {
                self.set(x, y, [colour.r(), colour.g(), colour.b()]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_bars_have_round_lengths() {
        for (length, expected) in [(1.0, 1.0), (1.9, 1.0), (2.1, 2.0), (79.0, 50.0), (0.07, 0.05)] {
            assert!((round_length(length) - expected).abs() < 1e-12 * expected);
        }
    }

    #[test]
    fn a_body_fills_its_frame_and_the_file_is_a_png() {
        let vertices = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
        let displacement = [0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let album = Album::new(&vertices, &[[0, 1, 2, 3]], &[[0, 1]], &[&displacement]);
        let picture = Picture {
            title: "a tet",
            caption: "pulled",
            displacement: &displacement,
            stitches: &[],
        };
        let mut file = Vec::new();
        album.write(&picture, &mut file).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let is_body = |pixel: &[u8]| pixel[1].abs_diff(pixel[2]) > 20;
        let n_body = pixels.chunks_exact(3).filter(|pixel| is_body(pixel)).count();
        assert!(n_body > WIDTH * HEIGHT / 20, "{n_body} pixels");
    }
}
