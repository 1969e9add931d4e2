//! The file formats of the surface: PLY, glTF binary, STL and OBJ.

use std::io::{self, Cursor, Write};

use image::{ImageFormat, RgbImage};
use serde_json::{Value, json};

use super::points::Points;

/// The points without holes, their normals and triangles.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Mesh {
    /// Indices of the vertices in the grid.
    pub(crate) vertices: Vec<usize>,
    /// Unit normals of the vertices, towards the camera.
    pub(crate) normals: Vec<[f32; 3]>,
    /// Vertices of the triangles, counter-clockwise as seen by the camera.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Connects each four neighbouring points by two triangles, three points by one; holes stay open.
    ///
    /// # Errors
    /// If there are more points than 32-bit indices.
    fn new(points: &Points) -> io::Result<Self> {
        if points.positions.len() > u32::MAX as usize {
            return Err(io::Error::other("there are too many points for a mesh; reduce it by --mesh-cells"));
        }
        Ok(Self::of(points))
    }

    /// As [`new`](Self::new), of at most 2^32 - 1 points.
    pub(crate) fn of(points: &Points) -> Self {
        let vertices: Vec<usize> = (0..points.positions.len()).filter(|&i| points.is_point(i)).collect();
        let triangles = triangles([points.width, points.height], &vertices);
        let normals = normals(points, &vertices, &triangles);
        Self { vertices, normals, triangles }
    }
}

/// The triangles of a grid whose points at the indices `vertices` are no holes, counter-clockwise as seen by the
/// camera.
fn triangles([width, height]: [usize; 2], vertices: &[usize]) -> Vec<[u32; 3]> {
    const NONE: u32 = u32::MAX;
    let mut number = vec![NONE; width * height];
    (0..).zip(vertices).for_each(|(k, &i)| number[i] = k);
    let mut triangles = Vec::with_capacity(2 * vertices.len());
    for y in 1..height {
        for x in 1..width {
            let at = y * width + x;
            let [a, b, c, d] = [at - width - 1, at - width, at, at - 1].map(|i| number[i]);
            // If a corner is missing, one of the two diagonals of the square gives all remaining triangles.
            let cuts = if a == NONE || c == NONE { [[b, d, c], [a, d, b]] } else { [[a, c, b], [a, d, c]] };
            triangles.extend(cuts.into_iter().filter(|t| !t.contains(&NONE)));
        }
    }
    triangles
}

/// Normals of the vertices: means of the triangles' normals, weighted by area. A vertex without triangles has a normal
/// towards the camera.
fn normals(points: &Points, vertices: &[usize], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0f64; 3]; vertices.len()];
    for corners in triangles {
        let across = across(corners.map(|k| points.positions[vertices[k as usize]]));
        corners.iter().for_each(|&k| (0..3).for_each(|i| normals[k as usize][i] += across[i]));
    }
    normals.into_iter().map(unit).collect()
}

/// Unit normal of a triangle, from its corners.
fn normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    unit(across(corners))
}

/// Normal of a triangle. Its length is twice the area.
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

/// Writes PLY (Turk 1994), binary: the points with normals and colours, and the triangles.
pub(super) fn write_ply(writer: &mut dyn Write, points: &Points) -> io::Result<()> {
    let mesh = Mesh::new(points)?;
    write_vertices(writer, points, &mesh, Some(&mesh.triangles))
}

/// Writes PLY, binary: the points with normals and colours.
pub(super) fn write_cloud(writer: &mut dyn Write, points: &Points) -> io::Result<()> {
    write_vertices(writer, points, &Mesh::new(points)?, None)
}

fn write_vertices(
    writer: &mut dyn Write,
    points: &Points,
    mesh: &Mesh,
    triangles: Option<&[[u32; 3]]>,
) -> io::Result<()> {
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
    if let Some(triangles) = triangles {
        writeln!(writer, "element face {}\nproperty list uchar int vertex_indices", triangles.len())?;
    }
    writeln!(writer, "end_header")?;
    for (&i, normal) in mesh.vertices.iter().zip(&mesh.normals) {
        let mut vertex = [0; 27];
        let numbers = points.positions[i].iter().chain(normal);
        vertex.chunks_exact_mut(4).zip(numbers).for_each(|(bytes, n)| bytes.copy_from_slice(&n.to_le_bytes()));
        vertex[24..].copy_from_slice(&points.colors[i]);
        writer.write_all(&vertex)?;
    }
    for corners in triangles.unwrap_or_default() {
        let mut face = [3; 13];
        face[1..].chunks_exact_mut(4).zip(corners).for_each(|(bytes, n)| bytes.copy_from_slice(&n.to_le_bytes()));
        writer.write_all(&face)?;
    }
    Ok(())
}

/// The text without line breaks, which would end a comment.
fn one_line(text: &str) -> String {
    text.replace(['\r', '\n'], " ")
}

/// Component types and buffer targets of glTF 2.0.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes glTF 2.0 in its binary form: the mesh with its texture.
///
/// The unit of glTF is the metre: a node scales millimetres to it, and the longer side of other units to 1.
pub(super) fn write_glb(writer: &mut dyn Write, points: &Points, texture: &RgbImage) -> io::Result<()> {
    let mesh = Mesh::new(points)?;
    if mesh.triangles.is_empty() {
        // glTF has no empty mesh.
        let text = json!({ "asset": asset(points), "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "name": "surface" }] }).to_string();
        return container(writer, text.as_bytes(), &[]);
    }
    let mut png = Cursor::new(Vec::new());
    texture.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other)?;
    let png = png.into_inner();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|&i| points.positions[i]).collect();
    let places: Vec<[f32; 2]> =
        mesh.vertices.iter().map(|&i| texture_coordinate(i, points, texture.dimensions())).collect();
    let parts: [&[u8]; 5] = [
        bytemuck::cast_slice(&positions),
        bytemuck::cast_slice(&mesh.normals),
        bytemuck::cast_slice(&places),
        bytemuck::cast_slice(&mesh.triangles),
        &png,
    ];
    let text = scene(points, &positions, mesh.triangles.len(), parts.map(<[u8]>::len));
    container(writer, text.to_string().as_bytes(), &parts)
}

/// Texture coordinate of a point, 0 to 1 right and down: the middle of its cell within the image.
fn texture_coordinate(i: usize, points: &Points, (width, height): (u32, u32)) -> [f32; 2] {
    let along = |k: usize, size: u32| {
        let (first, end) = (k * points.cell, ((k + 1) * points.cell).min(size as usize));
        (first + end) as f32 / 2.0 / size as f32
    };
    [along(i % points.width, width), along(i / points.width, height)]
}

fn scene(points: &Points, positions: &[[f32; 3]], triangles: usize, lengths: [usize; 5]) -> Value {
    let bound = |pick: fn(f32, f32) -> f32, from: f32| {
        positions.iter().fold([from; 3], |bound, p| [0, 1, 2].map(|k| pick(bound[k], p[k])))
    };
    let (low, high) = (bound(f32::min, f32::INFINITY), bound(f32::max, f32::NEG_INFINITY));
    let scale = if points.unit == "mm" { 1e-3 } else { 1.0 / (points.cell * points.width.max(points.height)) as f64 };
    let middle = [0, 1, 2].map(|k| -scale * (f64::from(low[k]) + f64::from(high[k])) / 2.0);
    let mut offset = 0;
    let views = [ARRAY_BUFFER, ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, 0].iter().zip(lengths);
    let views: Vec<_> = views
        .map(|(&target, length)| {
            let mut view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": length });
            if target != 0 {
                view["target"] = target.into();
            }
            offset += padded(length);
            view
        })
        .collect();
    json!({
        "asset": asset(points),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "surface", "mesh": 0, "scale": [scale, scale, scale], "translation": middle }],
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 }, "indices": 3, "material": 0,
        }] }],
        "materials": [{
            "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0, "roughnessFactor": 1.0 },
        }],
        "textures": [{ "source": 0, "sampler": 0 }],
        "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }],
        "images": [{ "bufferView": 4, "mimeType": "image/png" }],
        "accessors": [
            { "bufferView": 0, "componentType": FLOAT, "count": positions.len(), "type": "VEC3", "min": low, "max": high },
            { "bufferView": 1, "componentType": FLOAT, "count": positions.len(), "type": "VEC3" },
            { "bufferView": 2, "componentType": FLOAT, "count": positions.len(), "type": "VEC2" },
            { "bufferView": 3, "componentType": UNSIGNED_INT, "count": 3 * triangles, "type": "SCALAR" },
        ],
        "bufferViews": views,
        "buffers": [{ "byteLength": offset }],
    })
}

fn asset(points: &Points) -> Value {
    json!({
        "version": "2.0",
        "generator": concat!("parfocal ", env!("CARGO_PKG_VERSION")),
        "extras": { "unit": points.unit, "comments": points.comments, "axes": "x right, y up, z towards the camera" },
    })
}

/// The next multiple of four, to which glTF pads chunks.
fn padded(length: usize) -> usize {
    length.next_multiple_of(4)
}

/// Writes the header and its two chunks.
fn container(writer: &mut dyn Write, text: &[u8], parts: &[&[u8]]) -> io::Result<()> {
    let binary: usize = parts.iter().map(|part| padded(part.len())).sum();
    let whole = 12 + 8 + padded(text.len()) + if binary > 0 { 8 + binary } else { 0 };
    let Ok(whole) = u32::try_from(whole) else {
        let problem = format!("{whole} bytes are too many for glTF; reduce the mesh by --mesh-cells");
        return Err(io::Error::other(problem));
    };
    let mut out = |bytes: &[u8]| writer.write_all(bytes);
    let chunk =
        |kind: &[u8; 4], length: usize| (length as u32).to_le_bytes().into_iter().chain(*kind).collect::<Vec<_>>();
    out(b"glTF")?;
    out(&2u32.to_le_bytes())?;
    out(&whole.to_le_bytes())?;
    out(&chunk(b"JSON", padded(text.len())))?;
    out(text)?;
    out(&b"   "[..padded(text.len()) - text.len()])?;
    if binary > 0 {
        out(&chunk(b"BIN\0", binary))?;
    }
    for part in parts {
        out(part)?;
        out(&[0; 3][..padded(part.len()) - part.len()])?;
    }
    Ok(())
}

/// Writes STL, binary: triangles alone.
pub(super) fn write_stl(writer: &mut dyn Write, points: &Points) -> io::Result<()> {
    let mesh = Mesh::new(points)?;
    // 80 bytes that do not begin with "solid", as text STL does.
    let comment =
        format!("parfocal {}, unit: {}; x right, y up, z towards the camera", env!("CARGO_PKG_VERSION"), points.unit);
    let mut header = [b' '; 80];
    header.iter_mut().zip(comment.bytes()).for_each(|(to, from)| *to = from);
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

/// Writes OBJ: the mesh with normals and colours, as text.
pub(super) fn write_obj(writer: &mut dyn Write, points: &Points) -> io::Result<()> {
    let mesh = Mesh::new(points)?;
    writeln!(writer, "# parfocal {}", env!("CARGO_PKG_VERSION"))?;
    writeln!(writer, "# unit: {}; x right, y up, z towards the camera", points.unit)?;
    for comment in &points.comments {
        writeln!(writer, "# {}", one_line(comment))?;
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
