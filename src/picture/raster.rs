//! A z-buffered rasteriser of shaded triangles.

use crate::camera::Camera;
use nalgebra::Vector3;

/// A colour in linear light, 0 to 1 each.
pub(crate) type Rgb = [f32; 3];

/// One corner of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner {
    pub(crate) position: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
    /// What the colour map is asked for.
    pub(crate) value: f64,
}

/// Samples a pixel has along each side.
pub(crate) const OVERSAMPLING: usize = 3;

/// Depth steps larger than this many pixels are drawn as an outline.
const OUTLINE_STEP_PX: f64 = 14.0;

/// Samples of colour and depth, [`OVERSAMPLING`]² of them a pixel.
pub(crate) struct Raster {
    width: usize,
    height: usize,
    colour: Vec<Rgb>,
    depth: Vec<f64>,
}

impl Raster {
    /// `width` × `height` pixels of `background`.
    pub(crate) fn new(width: usize, height: usize, background: Rgb) -> Raster {
        let (width, height) = (width * OVERSAMPLING, height * OVERSAMPLING);
        Raster {
            width,
            height,
            colour: vec![background; width * height],
            depth: vec![f64::NEG_INFINITY; width * height],
        }
    }

    /// Draws a triangle; `colour_of` maps values to colours.
    pub(crate) fn triangle(
        &mut self,
        camera: &Camera,
        corners: &[Corner; 3],
        colour_of: impl Fn(f64) -> Rgb,
    ) {
        let scale = OVERSAMPLING as f64;
        let p = corners.map(|corner| camera.project(&corner.position));
        let p = p.map(|[x, y, z]| [x * scale, y * scale, z]);
        // Twice the area; the y axis points down, so what faces the eye runs clockwise on screen.
        let area = edge(&p[0], &p[1], p[2][0], p[2][1]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let extent = |axis: usize, limit: usize| {
            let low = p.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = p.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
            let clamp = |x: f64| x.clamp(0.0, limit as f64) as usize;
            clamp(low.floor())..clamp(high.ceil() + 1.0)
        };
        for y in extent(1, self.height) {
            for x in extent(0, self.width) {
                let (sx, sy) = (x as f64 + 0.5, y as f64 + 0.5);
                let weights = [
                    edge(&p[1], &p[2], sx, sy) / area,
                    edge(&p[2], &p[0], sx, sy) / area,
                    edge(&p[0], &p[1], sx, sy) / area,
                ];
                if weights.iter().any(|weight| *weight < 0.0) {
                    continue;
                }
                let mix = |of: [f64; 3]| (0..3).map(|i| weights[i] * of[i]).sum::<f64>();
                let depth = mix(p.map(|p| p[2]));
                let sample = y * self.width + x;
                if depth <= self.depth[sample] {
                    continue;
                }
                self.depth[sample] = depth;
                let normal = (0..3).map(|i| corners[i].normal * weights[i]).sum::<Vector3<f64>>();
                let light = light(camera, normal, area < 0.0);
                let colour = colour_of(mix(corners.map(|corner| corner.value)));
                self.colour[sample] = colour.map(|channel| channel * light);
            }
        }
    }

    /// A disc of `radius` pixels around `position`, unless something hides it.
    pub(crate) fn disc(
        &mut self,
        camera: &Camera,
        position: &Vector3<f64>,
        radius: f64,
        colour: Rgb,
    ) {
        let scale = OVERSAMPLING as f64;
        let [x, y, depth] = camera.project(position);
        let (x, y, radius) = (x * scale, y * scale, radius * scale);
        let span = |centre: f64, limit: usize| {
            let clamp = |x: f64| x.clamp(0.0, limit as f64) as usize;
            clamp((centre - radius).floor())..clamp((centre + radius).ceil() + 1.0)
        };
        // The disc lies in the surface, which may rise a little above its centre.
        let depth = depth + 2.0 * radius / scale;
        for row in span(y, self.height) {
            for column in span(x, self.width) {
                let distance = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
                let sample = row * self.width + column;
                if distance <= radius && depth >= self.depth[sample] {
                    self.colour[sample] = colour;
                }
            }
        }
    }

    /// Draws a line where the surface steps back behind itself.
    pub(crate) fn outline(&mut self) {
        let line: Rgb = [0.02, 0.02, 0.03];
        let behind =
            |depth: &[f64], here: usize, there: usize| depth[here] - depth[there] > OUTLINE_STEP_PX;
        for y in 1..self.height - 1 {
            for x in 1..self.width - 1 {
                let here = y * self.width + x;
                let around = [here - 1, here + 1, here - self.width, here + self.width];
                if around.iter().any(|&there| behind(&self.depth, here, there)) {
                    self.colour[here] = line;
                }
            }
        }
    }

    /// Averages the samples of each pixel: sRGB, 3 bytes a pixel.
    pub(crate) fn to_srgb(&self) -> Vec<u8> {
        let (width, height) = (self.width / OVERSAMPLING, self.height / OVERSAMPLING);
        let mut bytes = Vec::with_capacity(3 * width * height);
        for y in 0..height {
            for x in 0..width {
                for channel in 0..3 {
                    let mut sum = 0.0;
                    for row in 0..OVERSAMPLING {
                        let start = (y * OVERSAMPLING + row) * self.width + x * OVERSAMPLING;
                        let samples = &self.colour[start..start + OVERSAMPLING];
                        sum += samples.iter().map(|colour| colour[channel]).sum::<f32>();
                    }
                    bytes.push(encode(sum / (OVERSAMPLING * OVERSAMPLING) as f32));
                }
            }
        }
        bytes
    }
}

/// Twice the signed area of the triangle (a, b, (x, y)).
fn edge(a: &[f64; 3], b: &[f64; 3], x: f64, y: f64) -> f64 {
    (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
}

/// Diffuse light of a key and a fill lamp over an ambient one; inner sides lie in the shade.
fn light(camera: &Camera, normal: Vector3<f64>, faces_eye: bool) -> f32 {
    let normal = normal.try_normalize(0.0).unwrap_or(Vector3::z());
    let normal = if faces_eye { normal } else { -normal };
    let key = normal.dot(&camera.direction([-0.45, 0.60, 0.66])).max(0.0);
    let fill = normal.dot(&camera.direction([0.80, -0.10, 0.59])).max(0.0);
    let light = 0.30 + 0.72 * key + 0.16 * fill;
    (if faces_eye { light } else { 0.45 * light }) as f32
}

/// Linear light to an sRGB byte.
fn encode(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let srgb = if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (255.0 * srgb).round() as u8
}

/// An sRGB colour to linear light.
pub(crate) fn linear(srgb: [u8; 3]) -> Rgb {
    srgb.map(|byte| {
        let x = f32::from(byte) / 255.0;
        if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_survives_the_round_trip() {
        for byte in 0..=255 {
            assert_eq!(encode(linear([byte; 3])[0]), byte);
        }
    }
}
