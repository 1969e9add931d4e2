//! STL (3D Systems 1989), binary: triangles and their normals, and nothing else.

use std::io::{self, Write};

use super::Points;
use super::mesh::{Mesh, normal};

/// Writes the mesh.
pub(super) fn write(writer: &mut dyn Write, points: &Points) -> Result<(), String> {
    let mesh = Mesh::new(points)?;
    body(writer, points, &mesh).map_err(|e| e.to_string())
}

fn body(writer: &mut dyn Write, points: &Points, mesh: &Mesh) -> io::Result<()> {
    // 80 bytes of anything but "solid", by which the format in letters begins.
    let about =
        format!("parfocal {}, unit: {}; x right, y up, z towards the camera", env!("CARGO_PKG_VERSION"), points.unit);
    let mut header = [b' '; 80];
    header.iter_mut().zip(about.bytes()).for_each(|(to, from)| *to = from);
    writer.write_all(&header)?;
    writer.write_all(&(mesh.triangles.len() as u32).to_le_bytes())?;
    for corners in &mesh.triangles {
        let corners = corners.map(|k| points.positions[mesh.vertices[k as usize]]);
        let numbers = [normal(corners)].into_iter().chain(corners).flatten();
        let mut facet = [0; 50];
        facet.chunks_exact_mut(4).zip(numbers).for_each(|(bytes, n)| bytes.copy_from_slice(&n.to_le_bytes()));
        writer.write_all(&facet)?;
    }
    Ok(())
}
