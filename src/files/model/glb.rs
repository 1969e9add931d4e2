//! glTF 2.0 in one binary file (Khronos 2021; ISO/IEC 12113).

use std::io::{Cursor, Write};

use image::{ImageFormat, RgbImage};
use serde_json::{Value, json};

use super::Points;
use super::mesh::Mesh;

/// Numbers of the format.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes the mesh under its texture.
///
/// glTF counts in metres: a node scales millimetres to them, and makes the longer side of anything else 1.
pub(super) fn write(writer: &mut dyn Write, points: &Points, texture: &RgbImage) -> Result<(), String> {
    let mesh = Mesh::new(points)?;
    if mesh.triangles.is_empty() {
        // The format knows no empty mesh.
        let text = json!({ "asset": asset(points), "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "name": "surface" }] }).to_string();
        return container(writer, text.as_bytes(), &[]);
    }
    let mut png = Cursor::new(Vec::new());
    texture.write_to(&mut png, ImageFormat::Png).map_err(|e| e.to_string())?;
    let png = png.into_inner();
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|&i| points.positions[i]).collect();
    let places: Vec<[f32; 2]> = mesh.vertices.iter().map(|&i| place(i, points, texture.dimensions())).collect();
    let parts: [&[u8]; 5] = [
        bytemuck::cast_slice(&positions),
        bytemuck::cast_slice(&mesh.normals),
        bytemuck::cast_slice(&places),
        bytemuck::cast_slice(&mesh.triangles),
        &png,
    ];
    let text = description(points, &positions, mesh.triangles.len(), parts.map(<[u8]>::len));
    container(writer, text.to_string().as_bytes(), &parts)
}

/// Where a point is in the texture, 0 to 1 right and down: in the middle of its cell, as far as that is in the image.
fn place(i: usize, points: &Points, (width, height): (u32, u32)) -> [f32; 2] {
    let along = |k: usize, size: u32| {
        let (first, end) = (k * points.cell, ((k + 1) * points.cell).min(size as usize));
        (first + end) as f32 / 2.0 / size as f32
    };
    [along(i % points.width, width), along(i / points.width, height)]
}

fn description(points: &Points, positions: &[[f32; 3]], triangles: usize, lengths: [usize; 5]) -> Value {
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

/// To the next multiple of four, as the format asks.
fn padded(length: usize) -> usize {
    length.next_multiple_of(4)
}

/// The header and its two chunks.
fn container(writer: &mut dyn Write, text: &[u8], parts: &[&[u8]]) -> Result<(), String> {
    let binary: usize = parts.iter().map(|part| padded(part.len())).sum();
    let whole = 12 + 8 + padded(text.len()) + if binary > 0 { 8 + binary } else { 0 };
    let Ok(whole) = u32::try_from(whole) else {
        return Err(format!("{whole} bytes are too many for glTF; reduce the mesh by --mesh-cells"));
    };
    let mut out = |bytes: &[u8]| writer.write_all(bytes).map_err(|e| e.to_string());
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
