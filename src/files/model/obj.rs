//! OBJ (Wavefront), in letters: vertices with their colours after them, as MeshLab and Blender read them, normals, triangles.

use std::io::{self, Write};

use super::Points;
use super::mesh::Mesh;

/// Writes the mesh.
pub(super) fn write(writer: &mut dyn Write, points: &Points) -> Result<(), String> {
    let mesh = Mesh::new(points)?;
    body(writer, points, &mesh).map_err(|e| e.to_string())
}

fn body(writer: &mut dyn Write, points: &Points, mesh: &Mesh) -> io::Result<()> {
    writeln!(writer, "# parfocal {}", env!("CARGO_PKG_VERSION"))?;
    writeln!(writer, "# unit: {}; x right, y up, z towards the camera", points.unit)?;
    for comment in &points.comments {
        writeln!(writer, "# {}", comment.replace(['\r', '\n'], " "))?;
    }
    writeln!(writer, "o surface")?;
    for &i in &mesh.vertices {
        let ([x, y, z], [r, g, b]) = (points.positions[i], points.colors[i].map(|c| f32::from(c) / 255.0));
        writeln!(writer, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}")?;
    }
    for [x, y, z] in &mesh.normals {
        writeln!(writer, "vn {x:.5} {y:.5} {z:.5}")?;
    }
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|k| k + 1);
        writeln!(writer, "f {a}//{a} {b}//{b} {c}//{c}")?;
    }
    Ok(())
}
