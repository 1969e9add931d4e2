//! NPY 1.0 (NumPy Enhancement Proposal 1): a header in Python's words, then the values, rows one after the other.

use std::io::Write;

/// Bytes of the header, of which the values begin at a multiple.
const HEADER: usize = 128;

/// Writes an array of height x width 32-bit floats.
pub(super) fn write(writer: &mut dyn Write, (width, height): (u32, u32), values: &[f32]) -> Result<(), String> {
    let words = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}");
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend(((HEADER - 10) as u16).to_le_bytes());
    header.extend(words.bytes());
    header.resize(HEADER - 1, b' ');
    header.push(b'\n');
    let mut out = |bytes: &[u8]| writer.write_all(bytes).map_err(|e| e.to_string());
    out(&header)?;
    values.chunks(1 << 16).try_for_each(|values| out(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>()))
}
