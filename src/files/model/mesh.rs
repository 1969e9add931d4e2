//! Normals and triangles of points on a grid.

use super::Points;

/// Points that are there, one after the other, with what a mesh needs besides.
pub(super) struct Mesh {
    /// Which points of the grid the vertices are.
    pub vertices: Vec<usize>,
    /// Unit normals of the vertices, towards the camera.
    pub normals: Vec<[f32; 3]>,
    /// Corners, counter-clockwise as the camera sees them, by number of the vertex.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Two triangles between each four neighbouring points, one where only three are there, none across a hole.
    ///
    /// # Errors
    /// A phrase that says so where there are more points than a 32-bit number counts.
    pub(super) fn new(points: &Points) -> Result<Self, String> {
        if points.positions.len() > u32::MAX as usize {
            return Err("there are too many points for a mesh; reduce it by --mesh-cells".to_string());
        }
        let vertices: Vec<usize> = (0..points.positions.len()).filter(|&i| points.is_there(i)).collect();
        let triangles = triangles(points, &vertices);
        let normals = normals(points, &vertices, &triangles);
        Ok(Self { vertices, normals, triangles })
    }
}

fn triangles(points: &Points, vertices: &[usize]) -> Vec<[u32; 3]> {
    const NONE: u32 = u32::MAX;
    let mut number = vec![NONE; points.positions.len()];
    (0..).zip(vertices).for_each(|(k, &i)| number[i] = k);
    let mut triangles = Vec::with_capacity(2 * vertices.len());
    for y in 1..points.height {
        for x in 1..points.width {
            let at = y * points.width + x;
            let [a, b, c, d] = [at - points.width - 1, at - points.width, at, at - 1].map(|i| number[i]);
            // One of the two ways to cut a square has both triangles, or the only one, for any missing corner.
            let cuts = if a == NONE || c == NONE { [[b, d, c], [a, d, b]] } else { [[a, c, b], [a, d, c]] };
            triangles.extend(cuts.into_iter().filter(|t| !t.contains(&NONE)));
        }
    }
    triangles
}

/// At each vertex the mean of its triangles' normals by their areas; straight at the camera where it has none.
fn normals(points: &Points, vertices: &[usize], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0f64; 3]; vertices.len()];
    for corners in triangles {
        let across = across(corners.map(|k| points.positions[vertices[k as usize]]));
        corners.iter().for_each(|&k| (0..3).for_each(|i| normals[k as usize][i] += across[i]));
    }
    normals.into_iter().map(unit).collect()
}

/// Unit normal of a triangle, by its corners.
pub(super) fn normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    unit(across(corners))
}

/// Perpendicular to a triangle, and twice as long as its area is large.
fn across(corners: [[f32; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
    cross(u, v)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f32; 3] {
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 { v.map(|c| (c / length) as f32) } else { [0.0, 0.0, 1.0] }
}
