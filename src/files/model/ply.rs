//! PLY (Turk 1994), binary and little-endian.

use std::io::{self, Write};

use super::Points;
use super::mesh::Mesh;

/// Writes the points that are there, with normals and colours, and the triangles between them if asked.
pub(super) fn write(writer: &mut dyn Write, points: &Points, with_triangles: bool) -> Result<(), String> {
    let mesh = Mesh::new(points)?;
    body(writer, points, &mesh, with_triangles).map_err(|e| e.to_string())
}

fn body(writer: &mut dyn Write, points: &Points, mesh: &Mesh, with_triangles: bool) -> io::Result<()> {
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    writeln!(writer, "comment parfocal {}", env!("CARGO_PKG_VERSION"))?;
    writeln!(writer, "comment unit: {}; x right, y up, z towards the camera", one_line(&points.unit))?;
    for comment in &points.comments {
        writeln!(writer, "comment {}", one_line(comment))?;
    }
    writeln!(writer, "element vertex {}", mesh.vertices.len())?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(writer, "property float {name}")?;
    }
    for name in ["red", "green", "blue"] {
        writeln!(writer, "property uchar {name}")?;
    }
    if with_triangles {
        writeln!(writer, "element face {}\nproperty list uchar int vertex_indices", mesh.triangles.len())?;
    }
    writeln!(writer, "end_header")?;
    for (&i, normal) in mesh.vertices.iter().zip(&mesh.normals) {
        let mut vertex = [0; 27];
        let numbers = points.positions[i].iter().chain(normal);
        vertex.chunks_exact_mut(4).zip(numbers).for_each(|(bytes, n)| bytes.copy_from_slice(&n.to_le_bytes()));
        vertex[24..].copy_from_slice(&points.colors[i]);
        writer.write_all(&vertex)?;
    }
    for corners in mesh.triangles.iter().filter(|_| with_triangles) {
        let mut face = [3; 13];
        face[1..].chunks_exact_mut(4).zip(corners).for_each(|(bytes, n)| bytes.copy_from_slice(&n.to_le_bytes()));
        writer.write_all(&face)?;
    }
    Ok(())
}

/// A comment ends with its line.
fn one_line(text: &str) -> String {
    text.replace(['\r', '\n'], " ")
}
