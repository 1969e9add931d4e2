//! Depth, or V or focus where it is not known in mm, and its standard deviation, for programs that compute: NumPy's NPY, TIFF in
//! floats, Zarr. NaN where nothing is measured.

mod npy;
mod zarr;
mod zip;

use std::io::{Cursor, Write};

use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray32Float;
use tiff::tags::Tag;

use super::Extra;
use super::meaning::SOFTWARE;
use crate::metric::MetricDepth;
use crate::solve::sweep::Sweep;

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArrayKind {
    /// `depth.npy` and `deviation.npy`.
    Npy,
    /// `depth.tiff` and `deviation.tiff`.
    Tiff,
    /// `depth.zarr.zip`, with both.
    Zarr,
}

/// A field and its standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrays {
    /// Width and height.
    size: (u32, u32),
    quantity: &'static str,
    /// In ASCII, as TIFF wants it.
    unit: &'static str,
    values: Vec<f32>,
    deviation: Vec<f32>,
}

impl Arrays {
    /// Of V and its standard deviation, px², row-major, `size` being width and height.
    pub fn of_relative_blur(size: (u32, u32), values: &[f32], deviation: &[f32]) -> Self {
        Self::new(size, ["relative_blur", "px^2"], values, deviation)
    }

    /// Of depth in mm.
    pub fn of_depth(metric: &MetricDepth) -> Self {
        Self::new((metric.width, metric.height), ["depth", "mm"], &metric.depth, &metric.deviation)
    }

    /// Of a sweep: depth in mm, or focus where that is not known.
    pub fn of_sweep(sweep: &Sweep) -> Self {
        let size = (sweep.width, sweep.height);
        match &sweep.depth {
            Some(found) => Self::new(size, ["depth", "mm"], &found.depth, &found.deviation),
            None => Self::new(size, ["focus", sweep.unit], &sweep.focus, &sweep.uncertainty),
        }
    }

    fn new(size: (u32, u32), [quantity, unit]: [&'static str; 2], values: &[f32], deviation: &[f32]) -> Self {
        // What was filled in has no value, and then no deviation.
        let known = |(&v, &s): (&f32, &f32)| if v.is_finite() { s } else { f32::NAN };
        let deviation = values.iter().zip(deviation).map(known).collect();
        Self { size, quantity, unit, values: values.to_vec(), deviation }
    }

    /// The names of the files of a kind.
    pub fn names(kind: ArrayKind) -> &'static [&'static str] {
        match kind {
            ArrayKind::Npy => &["depth.npy", "deviation.npy"],
            ArrayKind::Tiff => &["depth.tiff", "deviation.tiff"],
            ArrayKind::Zarr => &["depth.zarr.zip"],
        }
    }

    /// The files of a kind.
    pub fn files(&self, kind: ArrayKind) -> Vec<Extra<'_>> {
        let both = Self::names(kind).iter().zip([(&self.values, false), (&self.deviation, true)]);
        both.map(|(name, (values, is_deviation))| match kind {
            ArrayKind::Npy => Extra::new(name, move |w| npy::write(w, self.size, values)),
            ArrayKind::Tiff => Extra::new(name, move |w| self.write_tiff(w, values, is_deviation)),
            ArrayKind::Zarr => Extra::new(name, |w| zarr::write(w, self)),
        })
        .collect()
    }

    /// What one of both is, in words.
    fn comments(&self, is_deviation: bool) -> String {
        let of = if is_deviation { "standard deviation of " } else { "" };
        format!("{of}{} in {}; NaN where it is not measured", self.quantity.replace('_', " "), self.unit)
    }

    fn write_tiff(&self, writer: &mut dyn Write, values: &[f32], is_deviation: bool) -> Result<(), String> {
        let description = format!("{}\nunits={}\n", self.comments(is_deviation), self.unit);
        // The format goes back and forth in its file.
        let mut bytes = Cursor::new(Vec::new());
        let encode = |bytes: &mut Cursor<Vec<u8>>| {
            let mut encoder = TiffEncoder::new(bytes)?;
            let mut image = encoder.new_image::<Gray32Float>(self.size.0, self.size.1)?;
            image.encoder().write_tag(Tag::ImageDescription, description.as_str())?;
            image.encoder().write_tag(Tag::Software, SOFTWARE)?;
            image.write_data(values)
        };
        encode(&mut bytes).map_err(|e| e.to_string())?;
        writer.write_all(&bytes.into_inner()).map_err(|e| e.to_string())
    }
}
