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
    pub(super) fn new(points: &Points, with_triangles: bool) -> Result<Self, String> {
        if points.positions.len() > u32::MAX as usize {
            return Err("there are too many points for a mesh; reduce it by --mesh-cells".to_string());
        }
        let vertices: Vec<usize> = (0..points.positions.len()).filter(|&i| points.is_there(i)).collect();
        let normals = vertices.iter().map(|&i| normal(points, i)).collect();
        let triangles = if with_triangles { triangles(points, &vertices) } else { Vec::new() };
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

/// Across the slopes along rows and columns; straight at the camera where there is none.
fn normal(points: &Points, i: usize) -> [f32; 3] {
    let (x, y) = (i % points.width, i / points.width);
    let right = slope(points, i, (x + 1 < points.width).then_some(i + 1), x.checked_sub(1).map(|_| i - 1));
    let down =
        slope(points, i, (y + 1 < points.height).then(|| i + points.width), y.checked_sub(1).map(|_| i - points.width));
    match (down, right) {
        (Some(down), Some(right)) => unit(cross(down, right)),
        _ => [0.0, 0.0, 1.0],
    }
}

/// From the point behind to the one ahead, with the point itself in place of one that is not there.
fn slope(points: &Points, i: usize, ahead: Option<usize>, behind: Option<usize>) -> Option<[f32; 3]> {
    let there = |j: Option<usize>| j.filter(|&j| points.is_there(j));
    let (from, to) = match (there(behind), there(ahead)) {
        (None, None) => return None,
        (behind, ahead) => (behind.unwrap_or(i), ahead.unwrap_or(i)),
    };
    let [p, q] = [from, to].map(|j| points.positions[j]);
    Some([q[0] - p[0], q[1] - p[1], q[2] - p[2]])
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    // In double precision no finite length overflows.
    let length = v.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
    if length > 0.0 { v.map(|c| (f64::from(c) / length) as f32) } else { [0.0, 0.0, 1.0] }
}
