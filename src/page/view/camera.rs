//! The camera: where a point of the surface stands in the picture.

use super::mesh::Mesh;

/// Distance of the camera from the middle of the surface, in units of the surface's longer side. Nearer, the
/// perspective exaggerates; farther, near and far look alike.
const DISTANCE: f32 = 3.0;

/// A camera that looks at the origin; the surface lies in the plane of x (right) and y (up), near is +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Camera {
    azimuth: (f32, f32),
    elevation: (f32, f32),
}

/// Brings what a camera sees into a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    scale: f32,
    left: f32,
    top: f32,
    /// Size of the picture, px.
    pub size: (u32, u32),
}

impl Camera {
    /// Degrees, as in [`View`](super::View).
    pub(super) fn new(elevation: f64, azimuth: f64) -> Self {
        let sin_cos = |degrees: f64| degrees.to_radians().sin_cos();
        let single = |(sin, cos): (f64, f64)| (sin as f32, cos as f32);
        Self { azimuth: single(sin_cos(azimuth)), elevation: single(sin_cos(elevation)) }
    }

    /// A direction as the camera sees it: right, up, towards the camera.
    pub(super) fn turn(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.azimuth, self.elevation);
        let (x, y) = (x * cos_a + y * sin_a, y * cos_a - x * sin_a);
        [x, y * sin_e + z * cos_e, z * sin_e - y * cos_e]
    }

    /// A point in perspective: right, up, and what is greater nearer to the camera.
    pub(super) fn project(&self, point: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = self.turn(point);
        // The surface stays within 1.5 of the origin: never behind the camera.
        let near = DISTANCE / (DISTANCE - z);
        [x * near, y * near, near]
    }
}

impl Fit {
    /// A picture of this width that holds the mesh as all cameras see it, with a margin, px.
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
        // A long narrow surface is not shown taller than twice the width.
        let scale = scale.min((2.0 * width as f32 - 2.0 * margin).max(1.0) / (top - bottom).max(1e-6));
        let height = (scale * (top - bottom) + 2.0 * margin).ceil() as u32;
        let middle = (left + right) / 2.0;
        Self { scale, left: width as f32 / 2.0 / scale - middle, top: top + margin / scale, size: (width, height) }
    }

    /// The same picture, `factor` times as large.
    pub(super) fn enlarged(self, factor: u32) -> Self {
        let (width, height) = self.size;
        Self { scale: self.scale * factor as f32, size: (width * factor, height * factor), ..self }
    }

    /// Px right and down, and what is greater nearer to the camera.
    pub(super) fn place(&self, [x, y, near]: [f32; 3]) -> [f32; 3] {
        [(x + self.left) * self.scale, (self.top - y) * self.scale, near]
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Vertex;
    use super::*;

    fn assert_near(a: [f32; 3], b: [f32; 3]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} {b:?}");
    }

    #[test]
    fn from_above_it_is_as_photographed() {
        let camera = Camera::new(90.0, 0.0);
        assert_near(camera.turn([0.1, 0.2, 0.3]), [0.1, 0.2, 0.3]);
        assert_near(camera.project([0.1, 0.2, 0.0]), [0.1, 0.2, 1.0]);
    }

    #[test]
    fn from_the_edge_height_points_up_and_the_lower_edge_is_near() {
        let camera = Camera::new(0.0, 0.0);
        assert_near(camera.turn([0.0, 0.0, 1.0]), [0.0, 1.0, 0.0]);
        assert_near(camera.turn([0.0, -1.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn going_around_to_the_right_brings_the_right_side_near() {
        assert_near(Camera::new(0.0, 90.0).turn([1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn what_is_nearer_is_larger() {
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
}
