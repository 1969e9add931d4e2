//! The height field as triangles.

use super::heights::Heights;

/// A corner of triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vertex {
    /// x right, y up, z near; the longer side of the image is 1, the middle of the surface the origin.
    pub position: [f32; 3],
    /// Unit normal, towards near.
    pub normal: [f32; 3],
    /// Place in the image, 0 to 1, right and down.
    pub uv: [f32; 2],
    /// 0 far, 1 near.
    pub nearness: f32,
}

/// Triangles over shared vertices.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mesh {
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Two triangles between each four neighbouring nodes, one where only three are valid.
    pub(super) fn new(heights: &Heights, relief: f32) -> Self {
        let mut index = vec![u32::MAX; heights.data.len()];
        let mut vertices = Vec::with_capacity(heights.data.len());
        for (at, height) in heights.data.iter().enumerate() {
            if !height.is_nan() {
                index[at] = vertices.len() as u32;
                vertices.push(vertex(heights, relief, at % heights.width, at / heights.width));
            }
        }
        let mut triangles = Vec::with_capacity(2 * vertices.len());
        for y in 1..heights.height {
            for x in 1..heights.width {
                let at = y * heights.width + x;
                let [a, b, c, d] = [at - heights.width - 1, at - heights.width, at, at - 1].map(|i| index[i]);
                // One of the two ways to cut a square has both triangles, or the only one, for any missing corner.
                let cuts = if a == u32::MAX || c == u32::MAX { [[b, c, d], [a, b, d]] } else { [[a, b, c], [a, c, d]] };
                triangles.extend(cuts.into_iter().filter(|t| !t.contains(&u32::MAX)));
            }
        }
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
        // One side alone at the edge, none for a lonely node.
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
    use super::*;

    fn heights(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Heights {
        let data = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Heights { width, height, data }
    }

    #[test]
    fn a_plane_has_one_normal_everywhere() {
        // Nearness rises by 0.1 a node, 4 nodes to the unit: dz/dx = 0.1 * 4 * relief.
        let mesh = Mesh::new(&heights(4, 3, |x, _| 0.1 * x as f32), 0.5);
        let expected = unit([-0.2, 0.0, 1.0]);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (12, 12));
        for vertex in &mesh.vertices {
            assert!(vertex.normal.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{vertex:?}");
        }
        let up = Mesh::new(&heights(3, 4, |_, y| 0.1 * y as f32), 0.5).vertices[0].normal;
        assert!(up[1] > 0.1, "nearer below leans up: {up:?}");
    }

    #[test]
    fn holes_are_not_drawn_and_their_corners_are_cut() {
        let hole = |hx: usize, hy: usize| heights(4, 4, move |x, y| if (x, y) == (hx, hy) { f32::NAN } else { 0.5 });
        // Of the four squares around an inner node each keeps one triangle.
        assert_eq!(Mesh::new(&hole(1, 2), 1.0).triangles.len(), 2 * 5 + 4);
        assert_eq!(Mesh::new(&hole(0, 0), 1.0).triangles.len(), 2 * 8 + 1);
        assert_eq!(Mesh::new(&hole(3, 3), 1.0).triangles.len(), 2 * 8 + 1);
        let empty = Mesh::new(&heights(3, 3, |_, _| f32::NAN), 1.0);
        assert!(empty.triangles.is_empty() && empty.vertices.is_empty());
    }

    #[test]
    fn the_relief_is_from_far_to_near_and_the_longer_side_is_one() {
        let mesh = Mesh::new(&heights(5, 3, |x, _| (x == 2) as u8 as f32), 0.3);
        let z: Vec<f32> = mesh.vertices.iter().map(|vertex| vertex.position[2]).collect();
        assert_eq!((z[0], z[2]), (-0.15, 0.15));
        assert!((mesh.vertices[0].position[0] + 0.4).abs() < 1e-6 && (mesh.vertices[0].position[1] - 0.2).abs() < 1e-6);
    }
}
