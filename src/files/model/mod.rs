//! The surface for other programs: PLY mesh and point cloud, glTF 2.0 with texture, STL and OBJ.
//!
//! All formats are written from [`Points`] on a grid, in mm with a lens, else exaggerated.

mod formats;
mod points;

use std::io::Write;

pub(crate) use formats::Mesh;
pub use points::{COORDINATE_FILES, Points};

use crate::base::Frame;
use crate::files::export::Extra;
use crate::files::image_io::preview;

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// `surface.ply`: a mesh with colours and normals.
    Ply,
    /// `points.ply`: all points with colours and normals.
    Cloud,
    /// `surface.glb`: a mesh with normals and the picture as texture.
    Glb,
    /// `surface.stl`: triangles alone.
    Stl,
    /// `surface.obj`: a mesh with colours and normals.
    Obj,
}

impl Points {
    /// The content of a file of this format. `texture` is the picture on `surface.glb`; `nodes` limits the points of a
    /// mesh along the longer side.
    pub fn file<'a>(&'a self, model: Model, texture: &'a Frame, nodes: Option<usize>) -> Extra<'a> {
        let mesh = move || nodes.map_or_else(|| self.clone(), |nodes| self.reduced(nodes));
        let name = match model {
            Model::Ply => "surface.ply",
            Model::Cloud => "points.ply",
            Model::Stl => "surface.stl",
            Model::Obj => "surface.obj",
            Model::Glb => "surface.glb",
        };
        let write = move |w: &mut dyn Write| match model {
            Model::Ply => formats::write_ply(w, &mesh()),
            Model::Cloud => formats::write_cloud(w, self),
            Model::Stl => formats::write_stl(w, &mesh()),
            Model::Obj => formats::write_obj(w, &mesh()),
            Model::Glb => formats::write_glb(w, &mesh(), &preview(texture)),
        };
        Extra::new(name, move |_, w| write(w).map_err(|e| e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use gltf::mesh::util::ReadIndices;
    use gltf::{Document, Gltf, Semantic};

    use super::*;
    use crate::base::Error;
    use crate::files::export::Nearer;

    /// A tilted plane of 6 x 5 points, with a hole at (2, 1) if `hole` is set.
    fn plane(hole: bool) -> (Points, Frame) {
        let (width, height) = (6usize, 5usize);
        let v = |i: usize| {
            if hole && i == width + 2 { f32::NAN } else { 0.5 * (i % width) as f32 - 0.25 * (i / width) as f32 }
        };
        let blur: Vec<f32> = (0..width * height).map(v).collect();
        let bytes = (0..width * height).flat_map(|i| [10 * (i % width) as u8, 20 * (i / width) as u8, 7]).collect();
        let fused = Frame::new(6, 5, crate::base::Channels::Rgb, crate::base::Samples::U8(bytes)).unwrap();
        (Points::of_relative_blur(&blur, &fused, Nearer::First, 2.0).unwrap(), fused)
    }

    /// z = 2 V = x + y/2, y up, so the normal is along (-1, -1/2, 1).
    const NORMAL: [f32; 3] = [-2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0];

    fn assert_normals(normals: &[[f32; 3]]) {
        for n in normals {
            assert!(n.iter().zip(NORMAL).all(|(a, b)| (a - b).abs() < 1e-5), "{n:?}");
        }
    }

    /// The content of a PLY with exactly the properties that are written.
    struct Ply {
        comments: Vec<String>,
        vertices: Vec<([f32; 3], [f32; 3], [u8; 3])>,
        faces: Vec<[u32; 3]>,
    }

    fn read_ply(bytes: &[u8]) -> Ply {
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        let lines: Vec<&str> = header.lines().filter(|line| !line.starts_with("comment ")).collect();
        assert_eq!(lines[..2], ["ply", "format binary_little_endian 1.0"]);
        let properties: Vec<&str> = lines[3..12].to_vec();
        let floats = ["x", "y", "z", "nx", "ny", "nz"].map(|name| format!("property float {name}"));
        let colors = ["red", "green", "blue"].map(|name| format!("property uchar {name}"));
        assert_eq!(properties, [&floats[..], &colors].concat());
        let count = |line: &str, name: &str| line.strip_prefix(name).unwrap().parse::<usize>().unwrap();
        let faces = lines.get(12).map_or(0, |line| count(line, "element face "));
        assert!(lines.len() == 12 || lines[13..] == ["property list uchar int vertex_indices"]);
        let body = &bytes[end + 11..];
        let (vertex_bytes, face_bytes) = body.split_at(27 * count(lines[2], "element vertex "));
        assert_eq!(face_bytes.len(), 13 * faces);
        let number = |bytes: &[u8], k: usize| f32::from_le_bytes(bytes[4 * k..4 * k + 4].try_into().unwrap());
        let vertex =
            |b: &[u8]| ([0, 1, 2].map(|k| number(b, k)), [3, 4, 5].map(|k| number(b, k)), [24, 25, 26].map(|k| b[k]));
        let corner = |b: &[u8], k: usize| u32::from_le_bytes(b[4 * k + 1..4 * k + 5].try_into().unwrap());
        let face = |b: &[u8]| {
            assert_eq!(b[0], 3);
            [0, 1, 2].map(|k| corner(b, k))
        };
        Ply {
            comments: header.lines().filter_map(|line| line.strip_prefix("comment ")).map(str::to_string).collect(),
            vertices: vertex_bytes.chunks_exact(27).map(vertex).collect(),
            faces: face_bytes.chunks_exact(13).map(face).collect(),
        }
    }

    fn ply(points: &Points) -> Ply {
        let mut bytes = Vec::new();
        formats::write_ply(&mut bytes, points).unwrap();
        read_ply(&bytes)
    }

    /// A GLB as read by a reader that checks lengths, indices and required entries.
    fn glb(points: &Points, texture: &Frame) -> (Document, Option<Vec<u8>>) {
        let mut bytes = Vec::new();
        formats::write_glb(&mut bytes, points, &preview(texture)).unwrap();
        let Gltf { document, blob } = Gltf::from_slice(&bytes).unwrap();
        (document, blob)
    }

    /// Whether a triangle is counter-clockwise as seen by the camera.
    fn faces_the_camera([a, b, c]: [[f32; 3]; 3]) -> bool {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    }

    #[test]
    fn a_mesh_covers_the_whole_plane() {
        let (points, _) = plane(false);
        let found = ply(&points);
        assert_eq!((found.vertices.len(), found.faces.len()), (30, 2 * 20));
        assert_eq!(found.vertices[8], ([2.0, -1.0, 2.0 * 0.75], found.vertices[8].1, [20, 20, 7]));
        assert_normals(&found.vertices.iter().map(|v| v.1).collect::<Vec<_>>());
        assert!(found.faces.iter().all(|f| faces_the_camera(f.map(|i| found.vertices[i as usize].0))));
        assert!(found.comments.iter().any(|c| c.contains("unit: px")), "{:?}", found.comments);
        assert!(found.comments.iter().any(|c| c.contains("z = 2 px per px^2")), "{:?}", found.comments);
    }

    #[test]
    fn no_triangle_crosses_a_hole() {
        let (points, _) = plane(true);
        let found = ply(&points);
        // Each of the four squares around the hole keeps one triangle.
        assert_eq!((found.vertices.len(), found.faces.len()), (29, 2 * 16 + 4));
        assert_normals(&found.vertices.iter().map(|v| v.1).collect::<Vec<_>>());
        let area = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|i| found.vertices[i as usize].0);
            ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs() / 2.0
        };
        assert!(found.faces.iter().all(|f| area(f) == 0.5));
        let mut bytes = Vec::new();
        formats::write_cloud(&mut bytes, &points).unwrap();
        let cloud = read_ply(&bytes);
        assert_eq!((cloud.vertices, cloud.faces.len()), (found.vertices, 0));
    }

    #[test]
    fn the_image_focused_nearer_is_up() {
        let fused = Frame::gray(2, 1, vec![0.5; 2]).unwrap();
        let z = |nearer| Points::of_relative_blur(&[3.0, 0.0], &fused, nearer, 2.0).unwrap().positions[0][2];
        assert_eq!((z(Nearer::First), z(Nearer::Second)), (6.0, -6.0));
        assert!(matches!(Points::of_relative_blur(&[1.0], &fused, Nearer::First, 1.0), Err(Error::Mismatch(_))));
    }

    #[test]
    fn a_reduced_mesh_has_the_means_and_keeps_holes() {
        let (points, _) = plane(true);
        let reduced = points.reduced(3);
        assert_eq!((reduced.width, reduced.height, reduced.cell), (3, 3, 2));
        // (0, 0), (1, 0), (0, -1), (1, -1).
        assert_eq!(reduced.positions[0], [0.5, -0.5, 0.5 - 0.25]);
        assert_eq!(reduced.colors[0], [5, 10, 7]);
        // (2, 1) is a hole.
        assert_eq!(reduced.positions[1][..2], [8.0 / 3.0, -1.0 / 3.0]);
        assert_eq!(points.reduced(6).positions.len(), 30);
        let mut empty = points.clone();
        empty.positions.iter_mut().for_each(|p| p[2] = f32::NAN);
        let found = ply(&empty.reduced(3));
        assert_eq!((found.vertices.len(), found.faces.len()), (0, 0));
    }

    #[test]
    fn a_glb_is_valid_and_has_the_mesh_under_its_texture() {
        for hole in [false, true] {
            let (points, fused) = plane(hole);
            let texture = preview(&fused);
            let (document, blob) = glb(&points, &fused);
            let blob = blob.unwrap();
            assert_eq!(document.buffers().next().unwrap().length(), blob.len());
            let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
            let reader = primitive.reader(|_| Some(&blob));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            assert_eq!(positions.len(), if hole { 29 } else { 30 });
            let accessor = primitive.get(&Semantic::Positions).unwrap();
            for k in 0..3 {
                let values = || positions.iter().map(|p| p[k]);
                assert_eq!(accessor.min().unwrap()[k].as_f64().unwrap() as f32, values().fold(f32::INFINITY, f32::min));
                assert_eq!(
                    accessor.max().unwrap()[k].as_f64().unwrap() as f32,
                    values().fold(f32::NEG_INFINITY, f32::max)
                );
            }
            assert_normals(&reader.read_normals().unwrap().collect::<Vec<_>>());
            let Some(ReadIndices::U32(indices)) = reader.read_indices() else { panic!("32-bit indices") };
            let indices: Vec<u32> = indices.collect();
            assert_eq!(indices.len(), 3 * if hole { 36 } else { 40 });
            assert!(indices.iter().all(|&i| (i as usize) < positions.len()));
            let corners = |t: &[u32]| [0, 1, 2].map(|k| positions[t[k] as usize]);
            assert!(indices.chunks_exact(3).all(|t| faces_the_camera(corners(t))));
            let places: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
            assert_eq!((places[0], places[places.len() - 1]), ([0.5 / 6.0, 0.1], [5.5 / 6.0, 0.9]));
            let image = document.images().next().unwrap();
            let gltf::image::Source::View { view, mime_type: "image/png" } = image.source() else {
                panic!("a PNG inside")
            };
            let png = &blob[view.offset()..view.offset() + view.length()];
            assert_eq!(image::load_from_memory(png).unwrap().into_rgb8(), texture);
        }
    }

    #[test]
    fn millimetres_become_metres_and_pixels_are_scaled_to_a_side_of_one() {
        for (unit, scale) in [("mm", 1e-3), ("px", 1.0 / 6.0)] {
            let (points, fused) = plane(false);
            let (document, _) = glb(&Points { unit: unit.to_string(), ..points }, &fused);
            let (_, _, found) = document.nodes().next().unwrap().transform().decomposed();
            assert!(found.iter().all(|s| (f64::from(*s) - scale).abs() < 1e-6), "{found:?}");
        }
    }

    #[test]
    fn a_reduced_glb_keeps_its_texture_in_place() {
        let (points, fused) = plane(false);
        let (document, blob) = glb(&points.reduced(2), &fused);
        let blob = blob.unwrap();
        let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
        let places: Vec<[f32; 2]> = primitive.reader(|_| Some(&blob)).read_tex_coords(0).unwrap().into_f32().collect();
        // Cells of 3: columns 0 to 2, rows 3 and 4.
        assert_eq!(places[2], [0.25, 0.8]);
    }

    #[test]
    fn a_surface_without_triangles_is_an_empty_scene() {
        let fused = Frame::gray(2, 1, vec![0.5; 2]).unwrap();
        let points = Points::of_relative_blur(&[3.0, 0.0], &fused, Nearer::First, 2.0).unwrap();
        let (document, blob) = glb(&points, &fused);
        assert!(blob.is_none() && document.meshes().len() == 0 && document.default_scene().is_some());
    }
}
