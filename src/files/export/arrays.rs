//! Depth, or V or focus, for other programs: NPY, TIFF and Zarr in floats, PNG and TIFF in 16 bits.

use std::io::{Cursor, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use png::ColorType;
use serde_json::json;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::{Gray16, Gray32Float};
use tiff::tags::Tag;

use super::image_files::{Description, Pixels, SOFTWARE, add_text, finish_png, png_encoder};
use super::report::Depth16Report;
use super::results::{Extra, Results};
use super::scale::Quantity;
use super::zip::Zip;

/// A format of arrays in floats. Pixels that are not measured are NaN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArrayKind {
    /// NumPy arrays `depth.npy` and `deviation.npy`.
    Npy,
    /// `depth.tiff` and `deviation.tiff`.
    Tiff,
    /// `depth.zarr.zip`, which holds both arrays.
    Zarr,
}

impl ArrayKind {
    /// Names of the files.
    pub fn files(self) -> &'static [&'static str] {
        match self {
            Self::Npy => &["depth.npy", "deviation.npy"],
            Self::Tiff => &["depth.tiff", "deviation.tiff"],
            Self::Zarr => &["depth.zarr.zip"],
        }
    }

    /// The files of results, as extras.
    pub fn extras<'a>(self) -> Vec<Extra<'a>> {
        let arrays: [fn(&Arrays) -> &Array; 2] = [|arrays| &arrays.quantity, |arrays| &arrays.deviation];
        let each = self.files().iter().zip(arrays);
        each.map(|(name, of)| {
            Extra::new(name, move |results, w| {
                let arrays = Arrays::new(results);
                let array = of(&arrays);
                match self {
                    Self::Npy => write_npy(w, arrays.size, &array.values),
                    Self::Tiff => arrays.write_tiff(w, array),
                    Self::Zarr => arrays.write_zarr(w),
                }
            })
        })
        .collect()
    }
}

/// A quantity and its standard deviation.
struct Arrays {
    size: (u32, u32),
    /// ASCII, as TIFF requires.
    unit: String,
    quantity: Array,
    deviation: Array,
    pixel_size_um: Option<f64>,
}

/// An array in floats.
struct Array {
    name: &'static str,
    comments: String,
    values: Vec<f32>,
}

/// The unit in ASCII.
fn ascii(unit: &str) -> String {
    unit.replace("px²", "px^2")
}

impl Arrays {
    fn new(results: &Results<'_>) -> Self {
        let quantity = results.best_measured();
        let Quantity { name, values, deviation, .. } = quantity;
        // A value that is not measured has no standard deviation either.
        let known = |(v, s): (&f32, &f32)| if v.is_finite() { *s } else { f32::NAN };
        let deviation = values.iter().zip(deviation.iter()).map(known).collect();
        let (unit, pixel_size_um) = (ascii(quantity.unit), results.report.pixel_size_um);
        let words = name.replace('_', " ");
        let array = |name, of: &str, values| {
            let comments = format!("{of}{words} in {unit}; NaN where it is not measured");
            Array { name, comments, values }
        };
        let deviation = array("standard_deviation", "standard deviation of ", deviation);
        let quantity = array(name, "", values.into_owned());
        Self { size: results.size(), unit, quantity, deviation, pixel_size_um }
    }

    fn write_tiff(&self, writer: &mut dyn Write, array: &Array) -> Result<(), String> {
        let pixel = self.pixel_size_um.map_or(String::new(), |um| format!("pixel_size_um={um}\n"));
        let description = format!("{}\nunits={}\n{pixel}", array.comments, self.unit);
        write_tiff::<Gray32Float>(writer, self.size, &array.values, &description)
    }

    /// Writes Zarr, version 2 (Zarr Community 2015), in one ZIP file like `zarr.storage.ZipStore`. It is a group of two
    /// arrays in square chunks: `depth`, `relative_blur` or `focus`, and `standard_deviation`. Chunks are shuffled by
    /// bytes and compressed by zlib.
    fn write_zarr(&self, writer: &mut dyn Write) -> Result<(), String> {
        let (width, height) = (self.size.0 as usize, self.size.1 as usize);
        let mut group = json!({ "software": SOFTWARE });
        if let Some(um) = self.pixel_size_um {
            group["pixel_size_um"] = um.into();
        }
        let mut metadata = vec![(".zgroup".to_string(), json!({ "zarr_format": 2 })), (".zattrs".to_string(), group)];
        let arrays = [&self.quantity, &self.deviation];
        for Array { name, comments, .. } in arrays {
            let array = json!({
                "zarr_format": 2, "shape": [height, width], "chunks": [CHUNK, CHUNK], "dtype": "<f4",
                "compressor": { "id": "zlib", "level": COMPRESSION }, "fill_value": "NaN", "order": "C",
                "filters": [{ "id": "shuffle", "elementsize": 4 }],
            });
            let attributes = json!({
                "units": self.unit, "comments": comments, "_ARRAY_DIMENSIONS": ["y", "x"],
            });
            metadata.extend([(format!("{name}/.zarray"), array), (format!("{name}/.zattrs"), attributes)]);
        }
        let mut zip = Zip::new(writer);
        for (name, value) in &metadata {
            zip.add(name, value.to_string().as_bytes())?;
        }
        // All of it in one file, which xarray reads first.
        let all: serde_json::Map<String, serde_json::Value> = metadata.into_iter().collect();
        let consolidated = json!({ "zarr_consolidated_format": 1, "metadata": all });
        zip.add(".zmetadata", consolidated.to_string().as_bytes())?;
        for Array { name, values, .. } in arrays {
            let columns = width.div_ceil(CHUNK);
            for (row, column) in (0..height.div_ceil(CHUNK)).flat_map(|row| (0..columns).map(move |c| (row, c))) {
                let bytes = shuffled(&chunk(values, [width, height], [column * CHUNK, row * CHUNK]));
                let mut compressor = ZlibEncoder::new(Vec::new(), Compression::new(COMPRESSION));
                let packed = compressor.write_all(&bytes).and_then(|()| compressor.finish());
                zip.add(&format!("{name}/{row}.{column}"), &packed.map_err(|e| e.to_string())?)?;
            }
        }
        zip.finish()
    }
}

/// Level of compression of a chunk, 0 to 9.
const COMPRESSION: u32 = 6;

/// The first bytes of all floats, then the second ones, and so on: bytes that are alike compress better.
fn shuffled(bytes: &[u8]) -> Vec<u8> {
    (0..4).flat_map(|n| bytes.iter().skip(n).step_by(4).copied()).collect()
}

/// Writes a TIFF of one channel.
pub(crate) fn write_tiff<C: tiff::encoder::colortype::ColorType>(
    writer: &mut dyn Write,
    (width, height): (u32, u32),
    samples: &[C::Inner],
    description: &str,
) -> Result<(), String>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    // The encoder seeks.
    let mut bytes = Cursor::new(Vec::new());
    let encode = |bytes: &mut Cursor<Vec<u8>>| {
        let mut encoder = TiffEncoder::new(bytes)?;
        let mut image = encoder.new_image::<C>(width, height)?;
        image.encoder().write_tag(Tag::ImageDescription, description)?;
        image.encoder().write_tag(Tag::Software, SOFTWARE)?;
        image.write_data(samples)
    };
    encode(&mut bytes).map_err(|e| e.to_string())?;
    writer.write_all(&bytes.into_inner()).map_err(|e| e.to_string())
}

/// Side of a chunk of a Zarr array, px. A chunk has a megabyte, as the format's authors advise.
const CHUNK: usize = 512;

/// The values of a chunk, NaN beyond the edges of the array.
fn chunk(values: &[f32], [width, height]: [usize; 2], [left, top]: [usize; 2]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 * CHUNK * CHUNK);
    for y in top..top + CHUNK {
        let at = |x: usize| if x < width && y < height { values[y * width + x] } else { f32::NAN };
        bytes.extend((left..left + CHUNK).flat_map(|x| at(x).to_le_bytes()));
    }
    bytes
}

/// Size of the header of NPY, bytes.
const NPY_HEADER: usize = 128;

/// Writes NPY 1.0 (NumPy Enhancement Proposal 1): a header in Python syntax, then height x width floats by rows.
fn write_npy(writer: &mut dyn Write, (width, height): (u32, u32), values: &[f32]) -> Result<(), String> {
    let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}");
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend(((NPY_HEADER - 10) as u16).to_le_bytes());
    header.extend(text.bytes());
    header.resize(NPY_HEADER - 1, b' ');
    header.push(b'\n');
    let mut out = |bytes: &[u8]| writer.write_all(bytes).map_err(|e| e.to_string());
    out(&header)?;
    values.chunks(1 << 16).try_for_each(|values| out(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>()))
}

/// Names of the files of a [`Depth16`].
pub(super) const DEPTH16_FILES: [&str; 2] = ["depth16.png", "depth16.tiff"];

/// Depth, or V or focus if depth is not known, in 16 bits. The sample is 0 where it is not measured, 1 at the least
/// value, 65535 at the greatest, and linear in between.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth16 {
    size: (u32, u32),
    samples: Vec<u16>,
    report: Depth16Report,
}

impl Depth16 {
    /// Encodes depth, or V or focus if depth is not known.
    pub fn of(results: &Results<'_>) -> Self {
        let quantity = results.best_measured();
        let name = quantity.name;
        Self::new(results.size(), &quantity.values, name, ascii(quantity.unit))
    }

    fn new(size: (u32, u32), values: &[f32], quantity: &'static str, unit: String) -> Self {
        let valid = || values.iter().copied().filter(|v| v.is_finite()).map(f64::from);
        let (low, high) = (valid().fold(f64::INFINITY, f64::min), valid().fold(f64::NEG_INFINITY, f64::max));
        let (low, scale) = match high - low {
            span if span > 0.0 => (low, span / 65534.0),
            // One value, or none, fits any scale.
            _ => (if low.is_finite() { low } else { 0.0 }, 1.0),
        };
        let sample = |v: f32| if v.is_finite() { 1 + ((f64::from(v) - low) / scale).round() as u16 } else { 0 };
        let samples = values.iter().map(|&v| sample(v)).collect();
        let report = Depth16Report { quantity: quantity.into(), unit: unit.into(), scale, offset: low - scale };
        Self { size, samples, report }
    }

    /// The meaning of the samples.
    pub fn report(&self) -> Depth16Report {
        self.report.clone()
    }

    /// `depth16.png` and `depth16.tiff`.
    pub fn into_files<'a>(self) -> [Extra<'a>; 2] {
        let [png, tiff] = DEPTH16_FILES;
        let copy = self.clone();
        [Extra::new(png, move |_, w| copy.write_png(w)), Extra::new(tiff, move |_, w| self.write_tiff(w))]
    }

    fn comments(&self) -> String {
        let quantity = match &*self.report.quantity {
            "depth" => "Depth",
            "focus" => "Focus",
            _ => "Relative blur V",
        };
        format!("{quantity}, {} = offset + scale * sample; sample 0 is not valid", self.report.unit)
    }

    fn write_png(&self, writer: &mut dyn Write) -> Result<(), String> {
        let description = Description { units: self.report.unit.clone(), comments: self.comments().into() };
        let mut encoder = png_encoder(writer, self.size, &description, None)?;
        add_text(&mut encoder, "Scale", &self.report.scale.to_string())?;
        add_text(&mut encoder, "Offset", &self.report.offset.to_string())?;
        finish_png(encoder, ColorType::Grayscale, &Pixels::Words(&self.samples))
    }

    fn write_tiff(&self, writer: &mut dyn Write) -> Result<(), String> {
        let Depth16Report { unit, scale, offset, .. } = &self.report;
        let description = format!("{}\nunits={unit}\nscale={scale}\noffset={offset}\n", self.comments());
        write_tiff::<Gray16>(writer, self.size, &self.samples, &description)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(size: (u32, u32), values: &[f32]) -> Depth16 {
        Depth16::new(size, values, "relative_blur", "px^2".to_string())
    }

    fn values(field: &Depth16) -> Vec<Option<f64>> {
        let Depth16Report { scale, offset, .. } = field.report();
        field.samples.iter().map(|&s| (s > 0).then(|| offset + scale * f64::from(s))).collect()
    }

    #[test]
    fn every_value_is_recovered_to_half_a_step() {
        let stored: Vec<f32> = (0..999).map(|i| 600.0 + 0.137 * ((i * i) % 977) as f32).chain([f32::NAN]).collect();
        let field = field((100, 10), &stored);
        for (found, value) in values(&field).into_iter().zip(stored) {
            assert_eq!(found.is_none(), value.is_nan());
            assert!(found.is_none_or(|v| (v - f64::from(value)).abs() <= 0.5001 * field.report.scale), "{value}");
        }
        assert!(field.samples.contains(&1) && field.samples.contains(&65535));
    }

    #[test]
    fn a_single_value_no_value_and_the_widest_range_have_a_scale() {
        assert_eq!(values(&field((2, 1), &[-2.5, f32::NAN])), [Some(-2.5), None]);
        assert_eq!(values(&field((2, 1), &[f32::NAN, f32::INFINITY])), [None, None]);
        let wide = field((2, 1), &[f32::MIN, f32::MAX]);
        assert_eq!(wide.samples, [1, 65535]);
        assert!(wide.report.scale.is_finite() && wide.report.offset.is_finite());
    }
}
