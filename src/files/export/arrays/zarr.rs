//! Zarr, version 2 of the format (Zarr Community 2015), in one file of ZIP as `zarr.storage.ZipStore` keeps it: a group of two
//! arrays in squares, uncompressed.

use std::io::Write;

use serde_json::json;

use super::super::meaning::SOFTWARE;
use super::Arrays;
use super::zip::Zip;

/// Side of a chunk, px: a megabyte, as the format's authors advise.
const CHUNK: usize = 512;

/// Writes the arrays `depth`, `relative_blur` or `focus`, and `standard_deviation`.
pub(super) fn write(writer: &mut dyn Write, arrays: &Arrays) -> Result<(), String> {
    let mut zip = Zip::new(writer);
    let text = |zip: &mut Zip<'_>, name: &str, value: serde_json::Value| zip.add(name, value.to_string().as_bytes());
    text(&mut zip, ".zgroup", json!({ "zarr_format": 2 }))?;
    text(&mut zip, ".zattrs", json!({ "software": SOFTWARE }))?;
    for (name, values, is_deviation) in
        [(arrays.quantity, &arrays.values, false), ("standard_deviation", &arrays.deviation, true)]
    {
        let (width, height) = (arrays.size.0 as usize, arrays.size.1 as usize);
        let array = json!({
            "zarr_format": 2, "shape": [height, width], "chunks": [CHUNK, CHUNK], "dtype": "<f4", "compressor": null,
            "fill_value": "NaN", "order": "C", "filters": null,
        });
        text(&mut zip, &format!("{name}/.zarray"), array)?;
        let about = json!({
            "units": arrays.unit, "comments": arrays.comments(is_deviation), "_ARRAY_DIMENSIONS": ["y", "x"],
        });
        text(&mut zip, &format!("{name}/.zattrs"), about)?;
        for (row, column) in (0..height.div_ceil(CHUNK)).flat_map(|r| (0..width.div_ceil(CHUNK)).map(move |c| (r, c))) {
            zip.add(&format!("{name}/{row}.{column}"), &chunk(values, [width, height], [column * CHUNK, row * CHUNK]))?;
        }
    }
    zip.finish()
}

/// A square of the field, NaN beyond its edges.
fn chunk(values: &[f32], [width, height]: [usize; 2], [left, top]: [usize; 2]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 * CHUNK * CHUNK);
    for y in top..top + CHUNK {
        let at = |x: usize| if x < width && y < height { values[y * width + x] } else { f32::NAN };
        bytes.extend((left..left + CHUNK).flat_map(|x| at(x).to_le_bytes()));
    }
    bytes
}
