//! Rendering: the model of the surface, the camera and the rasteriser.

use std::array;
use std::ops::Range;

use image::{Rgb, RgbImage};

use super::heights::Heights;
use crate::files::export::Palette;
use crate::files::model::{Mesh, Points};
use crate::page::figure::resized;

/// Number of samples per pixel along each axis.
const SAMPLES: u32 = 2;

/// Brightness of unlit areas, of the textured and of the colour-coded panel. The textured panel is brighter, since a
/// photograph has its own shading.
const AMBIENT: [f32; 2] = [0.5, 0.35];

/// Greatest brightness of lit areas.
const BRIGHTEST: f32 = 1.25;

/// Direction towards the light in camera coordinates: right, up, towards the camera; unit length. Light from the upper
/// left is what readers expect: light from below makes hills look like hollows.
const LIGHT: [f32; 3] = [-0.48, 0.6, 0.64];

/// Distance of the camera from the middle of the surface, in units of the surface's longer side. A shorter distance
/// exaggerates perspective; a longer one makes near and far look alike.
const DISTANCE: f32 = 3.0;

/// Red, green and blue, 0 to 255, of a point in the textured and in the colour-coded panel.
type Colors = [[f32; 3]; 2];

/// The surface: points of an image whose longer side is 1, with x right, y up and z near from the middle of the surface,
/// and the mesh between them.
#[derive(Clone, Debug)]
pub(super) struct Model {
    points: Points,
    mesh: Mesh,
    /// Colours of the vertices without light.
    colors: Vec<Colors>,
}

impl Model {
    pub(super) fn new(heights: &Heights, relief: f32, texture: &RgbImage, palette: Palette) -> Self {
        let (width, height) = (heights.width, heights.height);
        let longer = width.max(height) as f32;
        let position = |(i, nearness): (usize, &f32)| {
            let from_middle = |at: usize, count: usize| (at as f32 + 0.5 - count as f32 / 2.0) / longer;
            [from_middle(i % width, width), -from_middle(i / width, height), (nearness - 0.5) * relief]
        };
        let texture = resized(texture, (width as u32, height as u32));
        let points = Points {
            width,
            height,
            cell: 1,
            positions: heights.data.iter().enumerate().map(position).collect(),
            colors: texture.pixels().map(|pixel| pixel.0).collect(),
            unit: String::new(),
            comments: Vec::new(),
        };
        let mesh = Mesh::of(&points);
        let colors = |&i: &usize| [points.colors[i], palette.color(f64::from(heights.data[i]))];
        let colors = mesh.vertices.iter().map(colors).map(|colors| colors.map(|color| color.map(f32::from))).collect();
        Self { points, mesh, colors }
    }

    /// Draws the textured and the colour-coded panel. Empty pixels are white.
    pub(super) fn draw(&self, camera: &Camera, fit: &Fit) -> [RgbImage; 2] {
        let (width, height) = fit.size;
        let samples = self.samples(camera, &fit.enlarged(SAMPLES));
        let row = (width * SAMPLES) as usize;
        [0, 1].map(|panel| {
            RgbImage::from_fn(width, height, |x, y| {
                let (x, y) = ((x * SAMPLES) as usize, (y * SAMPLES) as usize);
                let mut sum = [0.0; 3];
                for sample in (0..SAMPLES as usize).flat_map(|dy| &samples[(y + dy) * row + x..][..SAMPLES as usize]) {
                    sum.iter_mut().zip(sample.colors[panel]).for_each(|(sum, c)| *sum += c);
                }
                Rgb(sum.map(|c| (c / (SAMPLES * SAMPLES) as f32).round() as u8))
            })
        })
    }

    /// Positions of the vertices.
    fn positions(&self) -> impl Iterator<Item = [f32; 3]> {
        self.mesh.vertices.iter().map(|&i| self.points.positions[i])
    }

    /// The visible points, row-major, of the picture's size.
    fn samples(&self, camera: &Camera, fit: &Fit) -> Vec<Sample> {
        let flat = dot(camera.turn([0.0, 0.0, 1.0]), LIGHT).max(0.1);
        let corner = |((position, normal), colors): (([f32; 3], &[f32; 3]), &Colors)| {
            // The cosine of the angle between light and normal, over that of a flat surface.
            let light = dot(camera.turn(*normal), LIGHT).max(0.0) / flat;
            let lit = |panel: usize| {
                let light = (AMBIENT[panel] + (1.0 - AMBIENT[panel]) * light).min(BRIGHTEST);
                colors[panel].map(|c| (c * light).min(255.0))
            };
            let [x, y, near] = fit.place(camera.project(position));
            Corner { x, y, sample: Sample { near, colors: [lit(0), lit(1)] } }
        };
        let corners: Vec<Corner> = self.positions().zip(&self.mesh.normals).zip(&self.colors).map(corner).collect();
        let (width, height) = (fit.size.0 as usize, fit.size.1 as usize);
        let mut samples = vec![Sample::EMPTY; width * height];
        for triangle in &self.mesh.triangles {
            fill(&mut samples, width, triangle.map(|i| &corners[i as usize]));
        }
        samples
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A camera that looks at the origin. The surface is in the plane of x (right) and y (up); near is +z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    azimuth: (f32, f32),
    elevation: (f32, f32),
}

impl Camera {
    /// Makes a camera from angles in degrees, as in [`View`](super::surface::View).
    pub(super) fn new(elevation: f64, azimuth: f64) -> Self {
        let sin_cos = |degrees: f64| degrees.to_radians().sin_cos();
        let single = |(sin, cos): (f64, f64)| (sin as f32, cos as f32);
        Self { azimuth: single(sin_cos(azimuth)), elevation: single(sin_cos(elevation)) }
    }

    /// A direction in camera coordinates: right, up, towards the camera.
    fn turn(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.azimuth, self.elevation);
        let (x, y) = (x * cos_a + y * sin_a, y * cos_a - x * sin_a);
        [x, y * sin_e + z * cos_e, z * sin_e - y * cos_e]
    }

    /// A point in perspective: right, up, and a value that is greater for nearer points.
    fn project(&self, point: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = self.turn(point);
        // The surface stays within 1.5 of the origin, so it is never behind the camera.
        let near = DISTANCE / (DISTANCE - z);
        [x * near, y * near, near]
    }
}

/// A map from the camera's view to the pixels of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    scale: f32,
    left: f32,
    top: f32,
    /// Size of the picture, px.
    pub(super) size: (u32, u32),
}

impl Fit {
    /// Makes the map for a picture of this width, px, that contains the surface as seen by all cameras, with a margin.
    pub(super) fn new(cameras: &[Camera], model: &Model, width: u32, margin: f32) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for camera in cameras {
            for position in model.positions() {
                let [x, y, _] = camera.project(position);
                (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]);
            }
        }
        let ([left, bottom], [right, top]) = (low, high);
        if left >= right {
            return Self { scale: 1.0, left: 0.0, top: 0.0, size: (width, width / 2) };
        }
        let scale = (width as f32 - 2.0 * margin).max(1.0) / (right - left);
        // A long narrow surface is at most twice as tall as the picture is wide.
        let scale = scale.min((2.0 * width as f32 - 2.0 * margin).max(1.0) / (top - bottom).max(1e-6));
        let height = (scale * (top - bottom) + 2.0 * margin).ceil() as u32;
        let middle = (left + right) / 2.0;
        Self { scale, left: width as f32 / 2.0 / scale - middle, top: top + margin / scale, size: (width, height) }
    }

    /// Scales the picture by `factor`.
    fn enlarged(self, factor: u32) -> Self {
        let (width, height) = self.size;
        Self { scale: self.scale * factor as f32, size: (width * factor, height * factor), ..self }
    }

    /// The position of a point: px right, px down, and a value that is greater for nearer points.
    fn place(&self, [x, y, near]: [f32; 3]) -> [f32; 3] {
        [(x + self.left) * self.scale, (self.top - y) * self.scale, near]
    }
}

/// The surface point that is visible in a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    /// A value that is greater for nearer points; negative infinity for an empty pixel.
    near: f32,
    /// Lit colours.
    colors: Colors,
}

impl Sample {
    const EMPTY: Self = Self { near: f32::NEG_INFINITY, colors: [[255.0; 3]; 2] };
}

/// A vertex in the picture: px right, px down.
struct Corner {
    x: f32,
    y: f32,
    sample: Sample,
}

/// Fills the pixels with their middle in the triangle, unless they show a nearer point. The values of the corners are
/// interpolated linearly: triangles are too small for perspective to matter.
fn fill(samples: &mut [Sample], width: usize, [a, b, c]: [&Corner; 3]) {
    let place = |corner: &Corner| [corner.x, corner.y];
    let area = edge(place(a), place(b), place(c));
    if area == 0.0 || !area.is_finite() {
        return;
    }
    for y in span([a.y, b.y, c.y], samples.len() / width) {
        for x in span([a.x, b.x, c.x], width) {
            let middle = [x as f32 + 0.5, y as f32 + 0.5];
            let weights = [(b, c), (c, a), (a, b)].map(|(p, q)| edge(place(p), place(q), middle) / area);
            if weights.iter().any(|&w| w < 0.0) {
                continue;
            }
            let mix = |value: &dyn Fn(&Sample) -> f32| dot(weights, [a, b, c].map(|corner| value(&corner.sample)));
            let near = mix(&|sample| sample.near);
            let seen = &mut samples[y * width + x];
            if near > seen.near {
                let color = |panel: usize, c: usize| mix(&|sample| sample.colors[panel][c]);
                *seen = Sample { near, colors: array::from_fn(|panel| array::from_fn(|c| color(panel, c))) };
            }
        }
    }
}

/// Twice the signed area of a triangle.
fn edge(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// The range of pixels along an axis that may have their middle in a triangle.
fn span([a, b, c]: [f32; 3], size: usize) -> Range<usize> {
    // These casts saturate.
    let first = (a.min(b).min(c) - 0.5).ceil().max(0.0) as usize;
    let end = ((a.max(b).max(c) - 0.5).floor() + 1.0).max(0.0) as usize;
    first..end.min(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Heights {
        let data = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Heights { width, height, data }
    }

    fn model(heights: &Heights, relief: f32) -> Model {
        Model::new(heights, relief, &RgbImage::new(1, 1), Palette::Viridis)
    }

    fn assert_near(a: [f32; 3], b: [f32; 3]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} {b:?}");
    }

    #[test]
    fn the_relief_is_from_far_to_near_and_normals_lean_away_from_near() {
        // Nearness rises by 0.1 per node, with 4 nodes per unit: dz/dx = 0.1 * 4 * relief.
        let plane = model(&grid(4, 3, |x, _| 0.1 * x as f32), 0.5);
        plane.mesh.normals.iter().for_each(|normal| assert_near(*normal, [-0.196_116, 0.0, 0.980_581]));
        let ridge = model(&grid(5, 3, |x, _| (x == 2) as u8 as f32), 0.3);
        assert_near(ridge.points.positions[0], [-0.4, 0.2, -0.15]);
        assert_near(ridge.points.positions[2], [0.0, 0.2, 0.15]);
        let empty = model(&grid(3, 3, |_, _| f32::NAN), 1.0);
        assert_eq!(Fit::new(&[Camera::new(50.0, 0.0)], &empty, 200, 10.0).size, (200, 100));
    }

    #[test]
    fn cameras_see_right_up_and_near() {
        let above = Camera::new(90.0, 0.0);
        assert_near(above.project([0.1, 0.2, 0.0]), [0.1, 0.2, 1.0]);
        let (near, far) = (above.project([0.1, 0.0, 0.5]), above.project([0.1, 0.0, -0.5]));
        assert!(near[0] > 0.1 && far[0] < 0.1 && near[2] > far[2], "nearer points are larger");
        // From the edge, height points up, and the lower edge is near.
        let edge = Camera::new(0.0, 0.0);
        assert_near(edge.turn([0.0, 0.0, 1.0]), [0.0, 1.0, 0.0]);
        assert_near(edge.turn([0.0, -1.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_near(Camera::new(0.0, 90.0).turn([1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn the_whole_mesh_is_in_the_picture_from_all_cameras() {
        let model = model(&grid(10, 6, |x, y| ((x + y) % 3) as f32 / 2.0), 0.3);
        let cameras = [-40.0, 0.0, 40.0].map(|azimuth| Camera::new(50.0, azimuth));
        let fit = Fit::new(&cameras, &model, 200, 10.0);
        assert_eq!(fit.size.0, 200);
        for seen in cameras.iter().flat_map(|camera| model.positions().map(|at| camera.project(at))) {
            let [x, y, _] = fit.place(seen);
            assert!((9.9..=190.1).contains(&x) && y >= 9.9 && y <= fit.size.1 as f32 - 9.0, "{x} {y}");
        }
    }

    /// A far square of four nodes with a side of 0.5, and a near one in its middle if `near` is set, far first or last.
    fn squares(near: Option<&str>) -> Model {
        let mut model = model(&grid(2, 2, |_, _| 0.5), 0.0);
        model.colors = vec![[[100.0; 3], [50.0; 3]]; 4];
        if let Some(place) = near {
            model.points.positions.extend_from_within(..);
            model.points.positions[4..].iter_mut().for_each(|at| *at = [at[0] / 2.0, at[1] / 2.0, 0.2]);
            model.mesh.vertices.extend(4..8);
            model.mesh.normals.extend_from_within(..);
            model.colors.extend([[[200.0; 3], [100.0; 3]]; 4]);
            let above: Vec<_> = model.mesh.triangles.iter().map(|triangle| triangle.map(|i| i + 4)).collect();
            model.mesh.triangles.extend(above);
            if place == "first" {
                model.mesh.triangles.rotate_left(2);
            }
        }
        model
    }

    #[test]
    fn a_square_from_above_fills_its_silhouette_and_the_nearer_one_hides_the_other() {
        let camera = Camera::new(90.0, 0.0);
        let fit = Fit::new(&[camera], &squares(None), 80, 20.0);
        for (x, y, pixel) in squares(None).draw(&camera, &fit)[0].enumerate_pixels() {
            let inside = (20..60).contains(&x) && (20..60).contains(&y);
            assert_eq!(pixel.0, if inside { [100; 3] } else { [255; 3] }, "{x} {y}");
        }
        let [textured, coded] = squares(Some("last")).draw(&camera, &fit);
        assert_eq!([&textured, &coded], squares(Some("first")).draw(&camera, &fit).each_ref());
        let colors = |x, y| [textured.get_pixel(x, y).0[0], coded.get_pixel(x, y).0[0]];
        assert_eq!([colors(40, 40), colors(22, 22)], [[200, 100], [100, 50]]);
    }

    #[test]
    fn a_surface_that_leans_towards_the_light_is_brighter() {
        let lit = |normal: [f32; 3]| {
            let mut model = squares(None);
            model.mesh.normals.fill(normal);
            let camera = Camera::new(90.0, 0.0);
            let fit = Fit::new(&[camera], &model, 20, 0.0);
            model.samples(&camera, &fit)[10 * 20 + 10].colors[0][0]
        };
        // Lambert: the cosine over that of the flat surface.
        let cosine = (-0.48 * 0.6 + 0.64 * 0.8) / LIGHT[2];
        assert!((lit([0.6, 0.0, 0.8]) - 100.0 * (AMBIENT[0] + (1.0 - AMBIENT[0]) * cosine)).abs() < 1e-2);
        assert!((lit(LIGHT) - 100.0 * BRIGHTEST).abs() < 1e-2 && (lit([0.0, 0.0, 1.0]) - 100.0).abs() < 1e-2);
        assert!((lit([0.8, -0.6, 0.0]) - 100.0 * AMBIENT[0]).abs() < 1e-2);
    }
}
