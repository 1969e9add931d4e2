//! Rendering: the camera and the rasteriser.

use super::mesh::{Mesh, Vertex};

/// Distance of the camera from the middle of the surface, in units of the surface's longer side. A shorter distance
/// exaggerates perspective; a longer one makes near and far look alike.
const DISTANCE: f32 = 3.0;

/// A camera that looks at the origin. The surface is in the plane of x (right) and y (up); near is +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Camera {
    azimuth: (f32, f32),
    elevation: (f32, f32),
}

/// A map from the camera's view to the pixels of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    scale: f32,
    left: f32,
    top: f32,
    /// Size of the picture, px.
    pub size: (u32, u32),
}

impl Camera {
    /// Makes a camera from angles in degrees, as in [`View`](super::View).
    pub(super) fn new(elevation: f64, azimuth: f64) -> Self {
        let sin_cos = |degrees: f64| degrees.to_radians().sin_cos();
        let single = |(sin, cos): (f64, f64)| (sin as f32, cos as f32);
        Self { azimuth: single(sin_cos(azimuth)), elevation: single(sin_cos(elevation)) }
    }

    /// A direction in camera coordinates: right, up, towards the camera.
    pub(super) fn turn(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.azimuth, self.elevation);
        let (x, y) = (x * cos_a + y * sin_a, y * cos_a - x * sin_a);
        [x, y * sin_e + z * cos_e, z * sin_e - y * cos_e]
    }

    /// A point in perspective: right, up, and a value that is greater for nearer points.
    pub(super) fn project(&self, point: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = self.turn(point);
        // The surface stays within 1.5 of the origin, so it is never behind the camera.
        let near = DISTANCE / (DISTANCE - z);
        [x * near, y * near, near]
    }
}

impl Fit {
    /// Makes the map for a picture of this width, px, that contains the mesh as seen by all cameras, with a margin.
    pub(super) fn new(cameras: &[Camera], mesh: &Mesh, width: u32, margin: f32) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for camera in cameras {
            for vertex in &mesh.vertices {
                let seen = camera.project(vertex.position);
                (low, high) = ([0, 1, 2].map(|i| low[i].min(seen[i])), [0, 1, 2].map(|i| high[i].max(seen[i])));
            }
        }
        let ([left, bottom, _], [right, top, _]) = (low, high);
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
    pub(super) fn enlarged(self, factor: u32) -> Self {
        let (width, height) = self.size;
        Self { scale: self.scale * factor as f32, size: (width * factor, height * factor), ..self }
    }

    /// The position of a point: px right, px down, and a value that is greater for nearer points.
    pub(super) fn place(&self, [x, y, near]: [f32; 3]) -> [f32; 3] {
        [(x + self.left) * self.scale, (self.top - y) * self.scale, near]
    }
}

/// The surface point that is visible in a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fragment {
    /// A value that is greater for nearer points; negative infinity for an empty pixel.
    pub near: f32,
    /// Cosine of the angle between light and normal, over that of a flat surface seen from above. 1 leaves the
    /// brightness of the picture unchanged.
    pub light: f32,
    /// Texture coordinates, 0 to 1, right and down.
    pub uv: [f32; 2],
    /// 0 far, 1 near.
    pub nearness: f32,
}

impl Fragment {
    const EMPTY: Self = Self { near: f32::NEG_INFINITY, light: 0.0, uv: [0.0; 2], nearness: 0.0 };

    pub(super) fn is_empty(&self) -> bool {
        self.near == f32::NEG_INFINITY
    }
}

/// Direction towards the light in camera coordinates: right, up, towards the camera; unit length. Light from the upper
/// left is what readers expect: light from below makes hills look like hollows.
const LIGHT: [f32; 3] = [-0.48, 0.6, 0.64];

/// Draws a mesh. Returns fragments, row-major, of the picture's size.
pub(super) fn draw(mesh: &Mesh, camera: &Camera, fit: &Fit) -> Vec<Fragment> {
    let (width, height) = (fit.size.0 as usize, fit.size.1 as usize);
    let flat = dot(camera.turn([0.0, 0.0, 1.0]), LIGHT).max(0.1);
    let corner = |vertex: &Vertex| Corner {
        place: fit.place(camera.project(vertex.position)),
        light: dot(camera.turn(vertex.normal), LIGHT).max(0.0) / flat,
        uv: vertex.uv,
        nearness: vertex.nearness,
    };
    let corners: Vec<Corner> = mesh.vertices.iter().map(corner).collect();
    let mut target = Target { width, height, fragments: vec![Fragment::EMPTY; width * height] };
    for triangle in &mesh.triangles {
        target.triangle(triangle.map(|i| &corners[i as usize]));
    }
    target.fragments
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A vertex in the picture.
struct Corner {
    /// Px right, px down, and a value that is greater for nearer points.
    place: [f32; 3],
    light: f32,
    uv: [f32; 2],
    nearness: f32,
}

struct Target {
    width: usize,
    height: usize,
    fragments: Vec<Fragment>,
}

impl Target {
    /// Fills the pixels with their middle in the triangle, unless they show a nearer point. The values of the corners
    /// are interpolated linearly: triangles are too small for perspective to matter.
    fn triangle(&mut self, [a, b, c]: [&Corner; 3]) {
        let area = edge(a.place, b.place, c.place);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let (xs, ys) = (span(a, b, c, 0, self.width), span(a, b, c, 1, self.height));
        for y in ys {
            for x in xs.clone() {
                let middle = [x as f32 + 0.5, y as f32 + 0.5, 0.0];
                let weights =
                    [edge(b.place, c.place, middle), edge(c.place, a.place, middle), edge(a.place, b.place, middle)]
                        .map(|w| w / area);
                if weights.iter().any(|&w| w < 0.0) {
                    continue;
                }
                let mix = |values: [f32; 3]| dot(weights, values);
                let near = mix([a.place[2], b.place[2], c.place[2]]);
                let fragment = &mut self.fragments[y * self.width + x];
                if near > fragment.near {
                    *fragment = Fragment {
                        near,
                        light: mix([a.light, b.light, c.light]),
                        uv: [mix([a.uv[0], b.uv[0], c.uv[0]]), mix([a.uv[1], b.uv[1], c.uv[1]])],
                        nearness: mix([a.nearness, b.nearness, c.nearness]),
                    };
                }
            }
        }
    }
}

/// Twice the signed area of a triangle.
fn edge(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// The range of pixels along an axis that may have their middle in the triangle.
fn span(a: &Corner, b: &Corner, c: &Corner, axis: usize, size: usize) -> std::ops::Range<usize> {
    let [a, b, c] = [a, b, c].map(|corner| corner.place[axis]);
    // These casts saturate.
    let first = (a.min(b).min(c) - 0.5).ceil().max(0.0) as usize;
    let end = ((a.max(b).max(c) - 0.5).floor() + 1.0).max(0.0) as usize;
    first..end.min(size)
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Vertex;
    use super::*;

    fn assert_near(a: [f32; 3], b: [f32; 3]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} {b:?}");
    }

    #[test]
    fn a_surface_from_above_looks_as_photographed() {
        let camera = Camera::new(90.0, 0.0);
        assert_near(camera.turn([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3]);
        assert_near(camera.project([0.1, 0.2, 0.0]), [0.1, 0.2, 1.0]);
    }

    #[test]
    fn in_a_view_from_the_edge_height_points_up_and_the_lower_edge_is_near() {
        let camera = Camera::new(0.0, 0.0);
        assert_near(camera.turn([0.0, 0.0, 1.0]), [0.0, 1.0, 0.0]);
        assert_near(camera.turn([0.0, -1.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_camera_to_the_right_has_the_right_side_near() {
        assert_near(Camera::new(0.0, 90.0).turn([1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn nearer_points_are_larger() {
        let camera = Camera::new(90.0, 0.0);
        let (near, far) = (camera.project([0.1, 0.0, 0.5]), camera.project([0.1, 0.0, -0.5]));
        assert!(near[0] > 0.1 && far[0] < 0.1 && near[2] > far[2]);
    }

    #[test]
    fn the_whole_mesh_is_in_the_picture_from_all_cameras() {
        let points = [[-0.5, -0.3, 0.1], [0.5, 0.3, -0.1], [0.5, -0.3, 0.2], [-0.5, 0.3, 0.0]];
        let vertex = |position| Vertex { position, normal: [0.0, 0.0, 1.0], uv: [0.0; 2], nearness: 0.0 };
        let mesh = Mesh { vertices: points.map(vertex).to_vec(), triangles: Vec::new() };
        let cameras = [-40.0, 0.0, 40.0].map(|azimuth| Camera::new(50.0, azimuth));
        let fit = Fit::new(&cameras, &mesh, 200, 10.0);
        assert_eq!(fit.size.0, 200);
        for camera in cameras {
            for point in points {
                let [x, y, _] = fit.place(camera.project(point));
                assert!((9.9..=190.1).contains(&x) && y >= 9.9 && y <= fit.size.1 as f32 - 9.0, "{x} {y}");
            }
        }
        let none = Mesh { vertices: Vec::new(), triangles: Vec::new() };
        assert_eq!(Fit::new(&cameras, &none, 200, 10.0).size, (200, 100));
    }

    fn square(z: f32, side: f32, nearness: f32) -> Mesh {
        let vertex = |x: f32, y: f32| Vertex {
            position: [x * side, y * side, z],
            normal: [0.0, 0.0, 1.0],
            uv: [x + 0.5, 0.5 - y],
            nearness,
        };
        let vertices = vec![vertex(-0.5, 0.5), vertex(0.5, 0.5), vertex(0.5, -0.5), vertex(-0.5, -0.5)];
        Mesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] }
    }

    fn joined(a: Mesh, b: Mesh) -> Mesh {
        let first = a.vertices.len() as u32;
        let triangles = a.triangles.into_iter().chain(b.triangles.into_iter().map(|t| t.map(|i| i + first)));
        Mesh { vertices: a.vertices.iter().chain(&b.vertices).copied().collect(), triangles: triangles.collect() }
    }

    #[test]
    fn a_square_seen_from_above_fills_its_silhouette_exactly() {
        let (mesh, camera) = (square(0.0, 1.0, 0.25), Camera::new(90.0, 0.0));
        let fit = Fit::new(&[camera], &mesh, 60, 10.0);
        let fragments = draw(&mesh, &camera, &fit);
        assert_eq!(fit.size, (60, 60));
        for (i, fragment) in fragments.iter().enumerate() {
            let (x, y) = (i % 60, i / 60);
            let inside = (10..50).contains(&x) && (10..50).contains(&y);
            assert_eq!(!fragment.is_empty(), inside, "{x} {y}");
            if inside {
                let expected = [(x as f32 - 9.5) / 40.0, (y as f32 - 9.5) / 40.0];
                assert!((fragment.light - 1.0).abs() < 1e-5 && (fragment.nearness - 0.25).abs() < 1e-6);
                assert!(fragment.uv.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{fragment:?}");
            }
        }
    }

    #[test]
    fn the_nearer_square_hides_the_other_in_either_order() {
        let camera = Camera::new(90.0, 0.0);
        let (far, near) = (|| square(-0.1, 1.0, 0.0), || square(0.1, 0.5, 1.0));
        let fit = Fit::new(&[camera], &far(), 80, 2.0);
        let first = draw(&joined(far(), near()), &camera, &fit);
        assert_eq!(first, draw(&joined(near(), far()), &camera, &fit));
        let at = |x: usize, y: usize| first[y * 80 + x].nearness;
        assert_eq!((at(40, 40), at(8, 8)), (1.0, 0.0));
    }

    #[test]
    fn a_surface_that_leans_towards_the_light_is_brighter() {
        let lit = |normal: [f32; 3]| {
            let mut mesh = square(0.0, 1.0, 0.0);
            mesh.vertices.iter_mut().for_each(|vertex| vertex.normal = normal);
            let camera = Camera::new(90.0, 0.0);
            let fit = Fit::new(&[camera], &mesh, 20, 0.0);
            draw(&mesh, &camera, &fit)[10 * 20 + 10].light
        };
        // Lambert: the cosine over that of the flat surface.
        assert!((lit(LIGHT) - 1.0 / LIGHT[2]).abs() < 1e-4);
        assert!((lit([0.6, 0.0, 0.8]) - (-0.48 * 0.6 + 0.64 * 0.8) / LIGHT[2]).abs() < 1e-4);
        assert_eq!(lit([0.8, -0.6, 0.0]), 0.0);
    }
}
