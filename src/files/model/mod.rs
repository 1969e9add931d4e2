//! The surface for other programs: PLY mesh and point cloud, glTF 2.0 with texture, STL and OBJ.
//!
//! All formats are written from [`Points`] on a grid, in mm with a lens, else exaggerated.

mod formats;

use std::io::Write;

pub(crate) use formats::triangles;
use tiff::encoder::colortype::Gray32Float;

use crate::base::{Error, Frame, Lens, Region};
use crate::files::export::{Extra, Nearer, Quantity, Results, Scale, write_tiff};
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

/// Points in the order of an image's pixels, and their colours.
///
/// x is to the right, y up and z towards the camera: a right-handed system, which shows the scene as photographed.
#[derive(Clone, Debug, PartialEq)]
pub struct Points {
    /// Points per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Side of the square of pixels that a point represents, px: 1 before [`reduced`](Self::reduced).
    pub cell: usize,
    /// Positions, row-major; a point with a coordinate that is not finite is a hole.
    pub positions: Vec<[f32; 3]>,
    /// Colours, sRGB.
    pub colors: Vec<[u8; 3]>,
    /// Unit of the coordinates: "px", "mm".
    pub unit: String,
    /// More about the coordinates; a line each.
    pub comments: Vec<String>,
}

impl Points {
    /// The surface of results without filled-in values. It is in mm if depth is known, with the size of a pixel or the
    /// lens, and no exaggeration is set; else it is exaggerated. The default exaggeration makes the
    /// relief 15 % of the longer side.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the image does not have the size of the results.
    pub fn of(results: &Results<'_>, fused: &Frame, exaggeration: Option<f64>) -> Result<Self, Error> {
        let quantities = results.measured();
        if let (Some(depth), None) = (quantities.get(1), exaggeration) {
            if let Some(pixel) = results.pixel_mm() {
                return Self::of_heights(depth, pixel, fused);
            }
            if let Some(lens) = results.lens() {
                let (part, photograph) = (results.report.region, results.report.photograph.into());
                return Self::of_depth(&depth.values, lens, part, photograph, fused);
            }
        }
        let quantity = &quantities[0];
        let relief = || relief(quantity.scale(), fused.width(), fused.height());
        let exaggeration = exaggeration.unwrap_or_else(relief);
        match quantity.name {
            "focus" => Self::of_focus(quantity, &results.positions(), fused, exaggeration),
            _ => Self::of_relative_blur(&quantity.values, fused, quantity.nearer, exaggeration),
        }
    }

    /// The surface of V over the pixels of I1: x = column, y = -row, z = ±V times `exaggeration` (px per px²), near up.
    /// It has holes where V is not finite.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if the image does not have as many pixels as there are values.
    pub fn of_relative_blur(
        relative_blur: &[f32],
        fused: &Frame,
        nearer: Nearer,
        exaggeration: f64,
    ) -> Result<Self, Error> {
        let sign = if nearer == Nearer::First { 1.0 } else { -1.0 };
        let factor = (sign * exaggeration) as f32;
        let z = format!("z = {factor} px per px^2 times the relative blur V; near is up; not metric");
        Self::raised(relative_blur, fused, |v| factor * v, ["first image", &z])
    }

    /// The surface of depth in mm over pixels of one size, mm: x = column and y = -row times the size, z = ±depth, near
    /// up. It has holes where depth is not finite.
    fn of_heights(depth: &Quantity<'_>, pixel: f64, fused: &Frame) -> Result<Self, Error> {
        let sign = if depth.nearer == Nearer::First { 1.0 } else { -1.0 };
        let z = if sign > 0.0 { "z = depth; near is up; metric" } else { "z = -depth; near is up; metric" };
        let xy = format!("reference image, times {pixel} mm");
        let raised = Self::raised(&depth.values, fused, |z| sign * z, [&xy, z])?;
        let scaled = |[x, y, z]: [f32; 3]| [(pixel * f64::from(x)) as f32, (pixel * f64::from(y)) as f32, z];
        let positions = raised.positions.iter().copied().map(scaled).collect();
        Ok(Self { positions, unit: "mm".to_string(), ..raised })
    }

    /// The surface of depth in mm through a lens, with the middle of the lens as origin: x and y follow the ray of each
    /// pixel, z = -depth. It has holes where depth is not finite. `part` is the part of the photographs that the depths
    /// cover. The optical axis is assumed to pass through the middle of the photographs.
    fn of_depth(depth: &[f32], lens: &Lens, part: Region, photograph: [u32; 2], fused: &Frame) -> Result<Self, Error> {
        let comments = [
            "the lens' middle is the origin: x and y by the ray of each pixel of the first image, z = -depth",
            "metric",
        ];
        let raised = Self::raised(depth, fused, |z| -z, comments)?;
        let middle = photograph.map(|side| f64::from(side - 1) / 2.0);
        let corner = [part.x, part.y].map(f64::from);
        let metric_place = |(i, [_, _, z]): (usize, [f32; 3])| {
            let at = [i % raised.width, i / raised.width].map(|k| k as f64);
            let side = lens.footprint(-f64::from(z));
            let [x, y] = [0, 1].map(|k| ((corner[k] + at[k] - middle[k]) * side) as f32);
            [x, -y, z]
        };
        let positions = raised.positions.iter().copied().enumerate().map(metric_place).collect();
        Ok(Self { positions, unit: "mm".to_string(), comments: comments.map(String::from).to_vec(), ..raised })
    }

    /// The surface of the focus over the reference's pixels: z is the setting minus the middle of the sweep, times
    /// `exaggeration` (px per setting).
    fn of_focus(focus: &Quantity<'_>, positions: &[f64], fused: &Frame, exaggeration: f64) -> Result<Self, Error> {
        let ends = [positions.first(), positions.last()].map(|end| end.copied().unwrap_or(0.0));
        let middle = 0.5 * (ends[0] + ends[1]);
        let factor = if focus.nearer == Nearer::First { exaggeration } else { -exaggeration };
        let unit = if focus.unit == "settings" { "setting" } else { focus.unit };
        let z = format!("z = {factor} px per {unit} times the focus less {middle}; near is up; not metric");
        let height = |u: f32| (factor * (f64::from(u) - middle)) as f32;
        Self::raised(&focus.values, fused, height, ["reference frame", &z])
    }

    /// A field over the pixels of an image.
    fn raised(
        values: &[f32],
        fused: &Frame,
        height: impl Fn(f32) -> f32,
        [pixels, z]: [&str; 2],
    ) -> Result<Self, Error> {
        let picture = preview(fused);
        let (width, rows) = (fused.width() as usize, fused.height() as usize);
        if values.len() != width * rows || values.is_empty() {
            let values = values.len();
            return Err(Error::Mismatch(format!("{values} values of V are no surface under {width}x{rows} pixels")));
        }
        let point = |(i, &v): (usize, &f32)| [(i % width) as f32, -((i / width) as f32), height(v)];
        Ok(Self {
            width,
            height: rows,
            cell: 1,
            positions: values.iter().enumerate().map(point).collect(),
            colors: picture.pixels().map(|p| p.0).collect(),
            unit: "px".to_string(),
            comments: vec![format!("x = column and y = -row of the {pixels}"), z.to_string()],
        })
    }

    /// Averages square cells of pixels to one point each, about `nodes` along the longer side. A smaller surface stays
    /// as it is.
    pub fn reduced(&self, nodes: usize) -> Self {
        let cell = self.width.max(self.height).div_ceil(nodes.max(1));
        if cell <= 1 {
            return self.clone();
        }
        let (width, height) = (self.width.div_ceil(cell), self.height.div_ceil(cell));
        let means = (0..width * height).map(|i| self.mean(i % width * cell, i / width * cell, cell));
        let (positions, colors) = means.unzip();
        let (unit, comments) = (self.unit.clone(), self.comments.clone());
        Self { width, height, cell: cell * self.cell, positions, colors, unit, comments }
    }

    /// Mean of the points of a cell that are not holes.
    fn mean(&self, left: usize, top: usize, cell: usize) -> ([f32; 3], [u8; 3]) {
        let (right, bottom) = ((left + cell).min(self.width), (top + cell).min(self.height));
        let (mut position, mut color, mut count) = ([0.0f64; 3], [0.0f64; 3], 0.0);
        for i in (top..bottom).flat_map(|y| y * self.width + left..y * self.width + right) {
            if self.is_point(i) {
                (0..3).for_each(|k| position[k] += f64::from(self.positions[i][k]));
                (0..3).for_each(|k| color[k] += f64::from(self.colors[i][k]));
                count += 1.0;
            }
        }
        // If all points are holes, this is 0 / 0, a hole.
        (position.map(|sum| (sum / count) as f32), color.map(|sum| (sum / count).round() as u8))
    }

    fn is_point(&self, i: usize) -> bool {
        self.positions[i].iter().all(|c| c.is_finite())
    }

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
            Model::Ply => formats::write_ply(w, &mesh(), true),
            Model::Cloud => formats::write_ply(w, self, false),
            Model::Stl => formats::write_stl(w, &mesh()),
            Model::Obj => formats::write_obj(w, &mesh()),
            Model::Glb => formats::write_glb(w, &mesh(), &preview(texture)),
        };
        Extra::new(name, move |_, w| write(w).map_err(|e| e.to_string()))
    }
}

impl Points {
    /// The coordinates as three images in 32-bit floats, for HALCON and others: `surface_x.tiff` to the right,
    /// `surface_y.tiff` down, `surface_z.tiff` away from the camera. A hole is NaN in all three.
    pub fn coordinate_files(&self) -> [Extra<'_>; 3] {
        let axes = [("x", "to the right", 1.0), ("y", "down", -1.0), ("z", "away from the camera", -1.0)];
        std::array::from_fn(|n| {
            let (axis, direction, sign) = axes[n];
            let write = move |w: &mut dyn Write| {
                let of = |p: &[f32; 3]| if p.iter().all(|c| c.is_finite()) { sign * p[n] } else { f32::NAN };
                let values: Vec<f32> = self.positions.iter().map(of).collect();
                let description = format!("{axis}, {direction}; NaN where it is not measured\nunits={}\n", self.unit);
                write_tiff::<Gray32Float>(w, (self.width as u32, self.height as u32), &values, &description)
            };
            Extra::new(COORDINATE_FILES[n], move |_, w| write(w))
        })
    }
}

/// Names of the files of coordinates.
pub const COORDINATE_FILES: [&str; 3] = ["surface_x.tiff", "surface_y.tiff", "surface_z.tiff"];

/// Exaggeration, px per unit of a scale, at which its range is 15 % of the longer side.
fn relief(scale: Scale, width: u32, height: u32) -> f64 {
    0.15 * f64::from(width.max(height)) / (f64::from(scale.high) - f64::from(scale.low))
}

#[cfg(test)]
mod tests {
    use gltf::mesh::util::ReadIndices;
    use gltf::{Document, Gltf, Semantic};

    use super::*;

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

    fn ply(points: &Points, with_triangles: bool) -> Ply {
        let mut bytes = Vec::new();
        formats::write_ply(&mut bytes, points, with_triangles).unwrap();
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
        let found = ply(&points, true);
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
        let found = ply(&points, true);
        // Each of the four squares around the hole keeps one triangle.
        assert_eq!((found.vertices.len(), found.faces.len()), (29, 2 * 16 + 4));
        assert_normals(&found.vertices.iter().map(|v| v.1).collect::<Vec<_>>());
        let area = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|i| found.vertices[i as usize].0);
            ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs() / 2.0
        };
        assert!(found.faces.iter().all(|f| area(f) == 0.5));
        let cloud = ply(&points, false);
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
        let found = ply(&empty.reduced(3), true);
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
