//! The surface for metrology: X3P (ISO 25178-72) and SDF (ISO 25178-71).

use std::io::{self, Write};

use super::md5;
use super::results::{Extra, Results};
use super::scale::Nearer;
use super::zip::Zip;

/// A format of surface texture. Heights are in metres, positive towards the camera, on a grid with one size of a pixel.
/// The last row of the picture is first: with z towards the camera, axes are right-handed if y points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TopographyKind {
    /// `surface.x3p`: X3P, ISO 25178-72 (ISO 5436-2).
    X3p,
    /// `surface.sdf`: SDF, ISO 25178-71, binary.
    Sdf,
    /// `surface_ascii.sdf`: SDF as text, formerly BCR.
    SdfAscii,
}

impl TopographyKind {
    /// Name of the file.
    pub fn file(self) -> &'static str {
        match self {
            Self::X3p => "surface.x3p",
            Self::Sdf => "surface.sdf",
            Self::SdfAscii => "surface_ascii.sdf",
        }
    }

    /// The file of results, as an extra. Writing fails unless depth is in mm and the size of a pixel is known.
    pub fn extra<'a>(self) -> Extra<'a> {
        Extra::new(self.file(), move |results, w| {
            let topography = Topography::new(results)?;
            match self {
                Self::X3p => topography.write_x3p(w),
                Self::Sdf => topography.write_sdf(w),
                Self::SdfAscii => topography.write_sdf_ascii(w).map_err(|e| e.to_string()),
            }
        })
    }
}

/// Heights on a grid.
struct Topography {
    size: (u32, u32),
    /// Heights, m, from the bottom row of the picture to its top; NaN where not measured.
    heights: Vec<f64>,
    /// Size of a pixel, m.
    pixel: f64,
}

impl Topography {
    fn new(results: &Results<'_>) -> Result<Self, String> {
        let depth = results.best_measured();
        let Some(footprint) = results.footprint() else {
            return Err("it needs depth in mm and the size of a pixel: --pixel-size".to_string());
        };
        let sign = if depth.nearer == Nearer::First { 1e-3 } else { -1e-3 };
        let height = |z: &f32| if z.is_finite() { sign * f64::from(*z) } else { f64::NAN };
        let size = results.size();
        let heights = bottom_first(&depth.values, size.0 as usize).map(height).collect();
        Ok(Self { size, heights, pixel: 1e-3 * footprint })
    }

    /// Writes X3P: a ZIP file with a description in XML, the heights in 64-bit floats, and the checksum of both.
    fn write_x3p(&self, writer: &mut dyn Write) -> Result<(), String> {
        let data: Vec<u8> = self.heights.iter().flat_map(|z| z.to_le_bytes()).collect();
        let main = self.x3p_description(&md5::digest(&data).to_uppercase());
        let mut zip = Zip::new(writer);
        zip.add_deflated("main.xml", main.as_bytes())?;
        zip.add_deflated("bindata/data.bin", &data)?;
        zip.add("md5checksum.hex", format!("{} *main.xml\n", md5::digest(main.as_bytes())).as_bytes())?;
        zip.finish()
    }

    fn x3p_description(&self, checksum: &str) -> String {
        let ((width, height), pixel) = (self.size, self.pixel);
        let axis = |name: &str, kind: &str, increment: f64| {
            format!(
                "<{name}><AxisType>{kind}</AxisType><DataType>D</DataType><Increment>{increment:e}</Increment>\
                 <Offset>0</Offset></{name}>"
            )
        };
        let axes = [axis("CX", "I", pixel), axis("CY", "I", pixel), axis("CZ", "A", 1.0)].concat();
        let namespace = "http://www.opengps.eu/2008/ISO5436_2";
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"no\"?>\n<p:ISO5436_2 xmlns:p=\"{namespace}\" \
             xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:schemaLocation=\"{namespace} \
             {namespace}/ISO5436_2.xsd\">\n<Record1><Revision>ISO5436 - 2000</Revision>\
             <FeatureType>SUR</FeatureType><Axes>{axes}</Axes></Record1>\n<Record3><MatrixDimension>\
             <SizeX>{width}</SizeX><SizeY>{height}</SizeY><SizeZ>1</SizeZ></MatrixDimension><DataLink>\
             <PointDataLink>bindata/data.bin</PointDataLink>\
             <MD5ChecksumPointData>{checksum}</MD5ChecksumPointData></DataLink></Record3>\n\
             <Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4>\n</p:ISO5436_2>\n"
        )
    }

    /// Writes SDF in binary, with heights in 32-bit integers: the least one is not measured.
    fn write_sdf(&self, writer: &mut dyn Write) -> Result<(), String> {
        let most = self.heights.iter().filter(|z| z.is_finite()).fold(0.0f64, |most, z| most.max(z.abs()));
        let scale = if most > 0.0 { most / f64::from(i32::MAX - 1) } else { 1e-12 };
        let sample = |z: &f64| if z.is_finite() { (z / scale).round() as i32 } else { i32::MIN };
        let mut header = b"bISO-1.0".to_vec();
        header.extend(format!("{MANUFACTURER:<10}{NO_DATE}{NO_DATE}").bytes());
        for side in self.sides()? {
            header.extend(side.to_le_bytes());
        }
        // A resolution below 0 is not stated.
        header.extend([self.pixel, self.pixel, scale, -1.0].iter().flat_map(|v| v.to_le_bytes()));
        header.extend([0, INT32, 0]);
        let mut out = |bytes: &[u8]| writer.write_all(bytes).map_err(|e| e.to_string());
        out(&header)?;
        out(&self.heights.iter().flat_map(|z| sample(z).to_le_bytes()).collect::<Vec<_>>())
    }

    /// Writes SDF as text, with heights in mm: BAD is not measured.
    fn write_sdf_ascii(&self, writer: &mut dyn Write) -> io::Result<()> {
        let [points, profiles] = self.sides().map_err(io::Error::other)?;
        let pixel = self.pixel;
        writeln!(writer, "aISO-1.0")?;
        for (name, value) in [
            ("ManufacID", MANUFACTURER.to_string()),
            ("CreateDate", NO_DATE.to_string()),
            ("ModDate", NO_DATE.to_string()),
            ("NumPoints", points.to_string()),
            ("NumProfiles", profiles.to_string()),
            ("Xscale", format!("{pixel:e}")),
            ("Yscale", format!("{pixel:e}")),
            ("Zscale", "1e-3".to_string()),
            ("Zresolution", "-1".to_string()),
            ("Compression", "0".to_string()),
            ("DataType", DOUBLE.to_string()),
            ("CheckType", "0".to_string()),
        ] {
            writeln!(writer, "{name:<12}= {value}")?;
        }
        writeln!(writer, "*")?;
        for row in self.heights.chunks(usize::from(points)) {
            let number = |z: &f64| if z.is_finite() { ((1e3 * z) as f32).to_string() } else { "BAD".to_string() };
            writeln!(writer, "{}", row.iter().map(number).collect::<Vec<_>>().join(" "))?;
        }
        writeln!(writer, "*\n*")
    }

    /// Points of a profile and number of profiles, which SDF stores in 16 bits.
    fn sides(&self) -> Result<[u16; 2], String> {
        let problem = "SDF holds up to 65535 pixels a side: solve a part with --roi";
        let narrow = |side: u32| u16::try_from(side).map_err(|_| problem.to_string());
        Ok([narrow(self.size.0)?, narrow(self.size.1)?])
    }
}

/// Returns values from the bottom row to the top.
fn bottom_first(values: &[f32], width: usize) -> impl Iterator<Item = &f32> {
    values.chunks(width).rev().flatten()
}

/// Data types of SDF.
const INT32: u8 = 6;
const DOUBLE: u8 = 7;
/// The manufacturer in SDF, up to 10 characters.
const MANUFACTURER: &str = "parfocal";
/// A date that is not stated, so that equal results are equal files.
const NO_DATE: &str = "000000000000";

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(write: impl FnOnce(&Topography, &mut dyn Write) -> Result<(), String>) -> Vec<u8> {
        let heights = vec![1e-3, -2e-3, f64::NAN, 0.0, 5e-4, 2.5e-4];
        let mut written = Vec::new();
        write(&Topography { size: (3, 2), heights, pixel: 4.5e-6 }, &mut written).unwrap();
        written
    }

    #[test]
    fn the_bottom_row_is_first_and_is_not_mirrored() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(bottom_first(&values, 3).copied().collect::<Vec<_>>(), [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn binary_sdf_has_its_header_of_81_bytes_and_integers() {
        let found = bytes(|of, w| of.write_sdf(w));
        assert_eq!(found.len(), 81 + 6 * 4);
        assert_eq!(&found[..18], b"bISO-1.0parfocal  ");
        let number = |at: usize| f64::from_le_bytes(found[at..at + 8].try_into().unwrap());
        assert_eq!((&found[42..46], number(46)), (&[3, 0, 2, 0][..], 4.5e-6));
        let scale = number(62);
        let height = |n: usize| i32::from_le_bytes(found[81 + 4 * n..85 + 4 * n].try_into().unwrap());
        assert!((scale * f64::from(height(0)) - 1e-3).abs() < 1e-12 && height(2) == i32::MIN);
        assert!((scale * f64::from(height(1)) + 2e-3).abs() < 1e-12);
    }

    #[test]
    fn ascii_sdf_has_a_line_per_profile() {
        let found = String::from_utf8(bytes(|of, w| of.write_sdf_ascii(w).map_err(|e| e.to_string()))).unwrap();
        let lines: Vec<&str> = found.lines().collect();
        assert_eq!((lines[0], lines[4], lines[6]), ("aISO-1.0", "NumPoints   = 3", "Xscale      = 4.5e-6"));
        assert_eq!(lines[13..], ["*", "1 -2 BAD", "0 0.5 0.25", "*", "*"]);
    }
}
