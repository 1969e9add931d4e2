//! Points of the surface, in mm with a lens, else exaggerated.

use std::io::Write;

use tiff::encoder::colortype::Gray32Float;

use crate::base::{Error, Frame, Lens, Region};
use crate::files::export::{Extra, Nearer, Quantity, Results, Scale, write_tiff};
use crate::files::image_io::preview;

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

    pub(super) fn is_point(&self, i: usize) -> bool {
        self.positions[i].iter().all(|c| c.is_finite())
    }

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
