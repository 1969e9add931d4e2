//! The surface as a mesh: heights on a grid, and triangles.

use super::Surface;
use crate::files::model::triangles;

/// Nearness, 0 to 1, at the nodes of a grid; NaN at nodes without a valid pixel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Heights {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Heights {
    /// Computes the mean nearness of square cells of pixels, about `nodes` along the longer side, smoothed over
    /// `radius` cells.
    pub(super) fn of(surface: &Surface, nodes: usize, radius: usize) -> Self {
        let longer = surface.width.max(surface.height);
        let cell = ((longer as f64 / nodes as f64).round() as usize).max(1);
        let (width, height) = (surface.width.div_ceil(cell), surface.height.div_ceil(cell));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| mean(surface, x * cell, y * cell, cell)));
        }
        let heights = Self { width, height, data };
        if radius == 0 { heights } else { heights.smoothed(radius) }
    }

    /// Nearness at a node; NaN outside.
    pub(super) fn get(&self, x: isize, y: isize) -> f32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside { self.data[y as usize * self.width + x as usize] } else { f32::NAN }
    }

    /// Applies a median, which removes spikes and keeps steps, and then a mean of 3 x 3, which smooths its facets. The
    /// median uses 7 x 7 sampled nodes of the square of that radius: all nodes would take many times as long.
    fn smoothed(self, radius: usize) -> Self {
        let spread = radius.min(3) as isize;
        let offsets: Vec<isize> = (-spread..=spread).map(|k| k * radius as isize / spread.max(1)).collect();
        let median = |window: &mut [f32]| *window.select_nth_unstable_by(window.len() / 2, f32::total_cmp).1;
        let mean = |window: &mut [f32]| window.iter().sum::<f32>() / window.len() as f32;
        self.filtered(&offsets, median).filtered(&[-1, 0, 1], mean)
    }

    /// Combines each valid node with the valid nodes at these offsets in x and y, which include (0, 0).
    fn filtered(&self, offsets: &[isize], combine: impl Fn(&mut [f32]) -> f32) -> Self {
        let mut window = Vec::with_capacity(offsets.len().pow(2));
        let at = |i: usize| {
            if self.data[i].is_nan() {
                return f32::NAN;
            }
            let (x, y) = ((i % self.width) as isize, (i / self.width) as isize);
            window.clear();
            for dy in offsets {
                window.extend(offsets.iter().map(|dx| self.get(x + dx, y + dy)).filter(|v| !v.is_nan()));
            }
            combine(&mut window)
        };
        Self { data: (0..self.data.len()).map(at).collect(), ..*self }
    }
}

fn mean(surface: &Surface, left: usize, top: usize, cell: usize) -> f32 {
    let (right, bottom) = ((left + cell).min(surface.width), (top + cell).min(surface.height));
    let (mut sum, mut count) = (0.0, 0);
    for y in top..bottom {
        for &v in &surface.values[y * surface.width + left..y * surface.width + right] {
            if v.is_finite() {
                sum += surface.scale.nearness(v);
                count += 1;
            }
        }
    }
    if count == 0 { f32::NAN } else { (sum / f64::from(count)) as f32 }
}

/// A vertex of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vertex {
    /// Position: x right, y up, z near. The longer side of the image is 1, and the origin is the middle of the surface.
    pub position: [f32; 3],
    /// Unit normal, towards near.
    pub normal: [f32; 3],
    /// Texture coordinates, 0 to 1, right and down.
    pub uv: [f32; 2],
    /// Nearness: 0 far, 1 near.
    pub nearness: f32,
}

/// Triangles over shared vertices.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mesh {
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Connects each four neighbouring nodes by two triangles, and three valid nodes by one.
    pub(super) fn new(heights: &Heights, relief: f32) -> Self {
        let nodes: Vec<usize> = (0..heights.data.len()).filter(|&at| !heights.data[at].is_nan()).collect();
        let vertices = nodes.iter().map(|at| vertex(heights, relief, at % heights.width, at / heights.width)).collect();
        // The rasteriser takes corners clockwise.
        let triangles =
            triangles([heights.width, heights.height], &nodes).into_iter().map(|[a, b, c]| [a, c, b]).collect();
        Self { vertices, triangles }
    }
}

fn vertex(heights: &Heights, relief: f32, x: usize, y: usize) -> Vertex {
    let longer = heights.width.max(heights.height) as f32;
    let (u, v) = ((x as f32 + 0.5) / heights.width as f32, (y as f32 + 0.5) / heights.height as f32);
    let nearness = heights.data[y * heights.width + x];
    let position = [
        (u - 0.5) * heights.width as f32 / longer,
        (0.5 - v) * heights.height as f32 / longer,
        (nearness - 0.5) * relief,
    ];
    let (ix, iy) = (x as isize, y as isize);
    let slope = |dx: isize, dy: isize| {
        let ahead = heights.get(ix + dx, iy + dy) - nearness;
        let behind = nearness - heights.get(ix - dx, iy - dy);
        // One-sided at an edge, 0 for an isolated node.
        let sides = [ahead, behind].map(|d| if d.is_nan() { (0.0, 0.0) } else { (d, 1.0f32) });
        relief * longer * (sides[0].0 + sides[1].0) / (sides[0].1 + sides[1].1).max(1.0)
    };
    // Rows run down, y up.
    let normal = unit([-slope(1, 0), slope(0, 1), 1.0]);
    Vertex { position, normal, uv: [u, v], nearness }
}

fn unit([x, y, z]: [f32; 3]) -> [f32; 3] {
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::*;
    use crate::files::export::{Nearer, Scale};

    fn heights(width: usize, height: usize, blur: &[f32], nodes: usize, radius: usize) -> Heights {
        let scale = Scale { low: 0.0, high: 1.0, nearer: Nearer::First };
        let surface = Surface {
            width,
            height,
            values: blur,
            texture: RgbImage::new(1, 1),
            scale,
            names: [""; 2],
            to_scale: None,
        };
        Heights::of(&surface, nodes, radius)
    }

    #[test]
    fn cells_are_the_mean_of_their_valid_pixels() {
        let nan = f32::NAN;
        let found = heights(5, 2, &[0.25, 0.5, nan, nan, 1.0, 0.25, nan, nan, nan, 7.0], 3, 0);
        assert_eq!((found.width, found.height), (3, 1));
        assert!((found.data[0] - 1.0 / 3.0).abs() < 1e-6 && found.data[1].is_nan() && found.data[2] == 1.0);
        assert_eq!(heights(2, 1, &[0.0, 1.0], 900, 0).data, [0.0, 1.0]);
    }

    #[test]
    fn smoothing_removes_spikes_and_keeps_steps_and_holes() {
        let mut blur: Vec<f32> = (0..81).map(|i| if i % 9 < 4 { 0.0 } else { 1.0 }).collect();
        (blur[20], blur[42], blur[80]) = (1.0, 0.0, f32::NAN);
        let found = heights(9, 9, &blur, 9, 2);
        for (i, v) in found.data.iter().enumerate().filter(|(i, _)| *i != 80) {
            // The mean of 3 x 3 makes the step two nodes wide.
            let expected = [0.0, 0.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 1.0, 1.0, 1.0][i % 9];
            assert!((v - expected).abs() < 1e-6, "{i}: {v}");
        }
        assert!(found.data[80].is_nan());
    }

    fn grid(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Heights {
        let data = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Heights { width, height, data }
    }

    #[test]
    fn a_plane_has_one_normal_everywhere() {
        // Nearness rises by 0.1 per node, with 4 nodes per unit: dz/dx = 0.1 * 4 * relief.
        let mesh = Mesh::new(&grid(4, 3, |x, _| 0.1 * x as f32), 0.5);
        let expected = unit([-0.2, 0.0, 1.0]);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (12, 12));
        for vertex in &mesh.vertices {
            assert!(vertex.normal.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{vertex:?}");
        }
        let up = Mesh::new(&grid(3, 4, |_, y| 0.1 * y as f32), 0.5).vertices[0].normal;
        assert!(up[1] > 0.1, "nearer below leans up: {up:?}");
    }

    #[test]
    fn holes_are_not_drawn_and_their_corners_are_cut() {
        let hole = |hx: usize, hy: usize| grid(4, 4, move |x, y| if (x, y) == (hx, hy) { f32::NAN } else { 0.5 });
        // Each of the four squares around an inner node keeps one triangle.
        assert_eq!(Mesh::new(&hole(1, 2), 1.0).triangles.len(), 2 * 5 + 4);
        assert_eq!(Mesh::new(&hole(0, 0), 1.0).triangles.len(), 2 * 8 + 1);
        assert_eq!(Mesh::new(&hole(3, 3), 1.0).triangles.len(), 2 * 8 + 1);
        let empty = Mesh::new(&grid(3, 3, |_, _| f32::NAN), 1.0);
        assert!(empty.triangles.is_empty() && empty.vertices.is_empty());
    }

    #[test]
    fn the_relief_is_from_far_to_near_and_the_longer_side_is_one() {
        let mesh = Mesh::new(&grid(5, 3, |x, _| (x == 2) as u8 as f32), 0.3);
        let z: Vec<f32> = mesh.vertices.iter().map(|vertex| vertex.position[2]).collect();
        assert_eq!((z[0], z[2]), (-0.15, 0.15));
        assert!((mesh.vertices[0].position[0] + 0.4).abs() < 1e-6 && (mesh.vertices[0].position[1] - 0.2).abs() < 1e-6);
    }
}
