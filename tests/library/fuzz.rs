//! Fuzz test of the file readers: photographs, fields, kernels, transforms, reports and results folders.
//! A reader must return a value or an error for any content.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::codecs::{jpeg::JpegEncoder, png::PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageBuffer, ImageEncoder, ImageFormat};
use parfocal::export::{self, Registration, Results};
use parfocal::image_io::{self, Photograph};

use crate::common::fuzz::{self, Share, Target};

/// Maximum number of pixels that are decoded. Of a larger image, only the header and metadata are read.
/// The program itself checks the limits of the device before it decodes a large image.
const PIXELS: u32 = 1 << 20;

/// Reads a photograph in the same way as the program.
fn photograph(file: &Path) {
    let Ok(photograph) = Photograph::open(file) else { return };
    photograph.describe();
    let (width, height) = photograph.size();
    if width.saturating_mul(height) <= PIXELS {
        let _ = photograph.decode();
    }
}

fn is_small(file: &Path) -> bool {
    Photograph::open(file).is_ok_and(|photograph| photograph.size().0.saturating_mul(photograph.size().1) <= PIXELS)
}

const SIZE: [u32; 2] = [12, 9];

fn pixels<T: image::Primitive>(channels: u32, of: impl Fn(u32) -> T) -> Vec<T> {
    (0..SIZE[0] * SIZE[1] * channels).map(of).collect()
}

/// Returns one picture for each pixel type.
fn pictures() -> Vec<DynamicImage> {
    let [w, h] = SIZE;
    let byte = |i: u32| (i * 37 % 251) as u8;
    let word = |i: u32| (i * 7919 % 65_521) as u16;
    vec![
        ImageBuffer::from_raw(w, h, pixels(1, byte)).map(DynamicImage::ImageLuma8).unwrap(),
        ImageBuffer::from_raw(w, h, pixels(3, byte)).map(DynamicImage::ImageRgb8).unwrap(),
        ImageBuffer::from_raw(w, h, pixels(4, byte)).map(DynamicImage::ImageRgba8).unwrap(),
        ImageBuffer::from_raw(w, h, pixels(1, word)).map(DynamicImage::ImageLuma16).unwrap(),
        ImageBuffer::from_raw(w, h, pixels(3, word)).map(DynamicImage::ImageRgb16).unwrap(),
    ]
}

/// Encodes the pictures in each format that supports their pixel type.
fn encoded(formats: &[ImageFormat]) -> Vec<Vec<u8>> {
    let write = |picture: &DynamicImage, format| {
        let mut bytes = Vec::new();
        picture.write_to(&mut Cursor::new(&mut bytes), format).ok().map(|()| bytes)
    };
    formats.iter().flat_map(|format| pictures().into_iter().filter_map(move |p| write(&p, *format))).collect()
}

/// Encodes a picture with EXIF metadata and an ICC profile. PNG compresses the profile; JPEG does not.
fn described(mut encoder: impl ImageEncoder) {
    use exif::{Field, In, Rational, Tag, Value};
    let ratio = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let fields = [
        (Tag::Make, Value::Ascii(vec![b"Maker".to_vec()])),
        (Tag::Model, Value::Ascii(vec![b"Maker 1".to_vec()])),
        (Tag::Orientation, Value::Short(vec![6])),
        (Tag::FocalLength, ratio(1000, 10)),
        (Tag::FNumber, ratio(56, 10)),
        (Tag::SubjectDistance, ratio(125, 100)),
        (Tag::FocalPlaneXResolution, ratio(2540, 1)),
        (Tag::ColorSpace, Value::Short(vec![1])),
    ];
    let fields = fields.map(|(tag, value)| Field { tag, ifd_num: In::PRIMARY, value });
    let (mut writer, mut bytes) = (exif::experimental::Writer::new(), Cursor::new(Vec::new()));
    fields.iter().for_each(|field| writer.push_field(field));
    writer.write(&mut bytes, false).unwrap();
    encoder.set_exif_metadata(bytes.into_inner()).unwrap();
    encoder.set_icc_profile(moxcms::ColorProfile::new_display_p3().encode().unwrap()).unwrap();
    encoder.write_image(&pixels(3, |i| i as u8), SIZE[0], SIZE[1], ExtendedColorType::Rgb8).unwrap();
}

fn png() -> Vec<Vec<u8>> {
    let mut bytes = Vec::new();
    described(PngEncoder::new(&mut bytes));
    [encoded(&[ImageFormat::Png]), vec![bytes]].concat()
}

fn jpeg() -> Vec<Vec<u8>> {
    let mut bytes = Vec::new();
    described(JpegEncoder::new(&mut bytes));
    [encoded(&[ImageFormat::Jpeg]), vec![bytes]].concat()
}

/// Returns a grey and a colour image in each compression.
fn exr() -> Vec<Vec<u8>> {
    use exr::image::write::channels::WritableChannels;
    use exr::prelude::*;

    fn layer(encoding: Encoding, channels: impl for<'a> WritableChannels<'a>) -> Vec<u8> {
        let size = SIZE.map(|side| side as usize);
        let layer = Layer::new((size[0], size[1]), LayerAttributes::default(), encoding, channels);
        let mut bytes = Cursor::new(Vec::new());
        Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    let value = |at: Vec2<usize>, n: usize| ((at.0 * 3 + at.1 * n) % 17) as f32 / 4.0 - 2.0;
    let compressions = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
    ];
    let mut files = Vec::new();
    for compression in compressions {
        let encoding = Encoding { compression, ..Encoding::FAST_LOSSLESS };
        let gray = SpecificChannels::build().with_channel("Y").with_pixel_fn(move |at| (value(at, 5),));
        let color = SpecificChannels::rgb(move |at| (value(at, 1), f16::from_f32(value(at, 2)), value(at, 3)));
        files.extend([layer(encoding, gray), layer(encoding, color)]);
    }
    files
}

fn pfm() -> Vec<u8> {
    let mut bytes = format!("Pf\n{} {}\n-1.0\n", SIZE[0], SIZE[1]).into_bytes();
    bytes.extend(pixels(1, |i| i as f32 / 8.0).iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

fn tiff() -> Vec<Vec<u8>> {
    use tiff::encoder::{Compression, TiffEncoder, colortype};
    let mut files = encoded(&[ImageFormat::Tiff]);
    for compression in [Compression::Uncompressed, Compression::Lzw, Compression::Packbits] {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).unwrap().with_compression(compression);
        encoder.write_image::<colortype::Gray16>(SIZE[0], SIZE[1], &pixels(1, |i| i as u16)).unwrap();
        encoder.write_image::<colortype::Gray32Float>(SIZE[0], SIZE[1], &pixels(1, |i| i as f32)).unwrap();
        encoder.write_image::<colortype::RGB8>(SIZE[0], SIZE[1], &pixels(3, |i| i as u8)).unwrap();
        files.push(bytes.into_inner());
    }
    files
}

/// Returns a golden part in a file.
fn golden() -> Vec<u8> {
    use export::{GoldenPart, GoldenReport, TaughtPart};
    let [width, height] = SIZE;
    let heights = parfocal::metric::inspect::Heights::new(SIZE, &pixels(1, |i| i as f32), &pixels(1, |_| 0.5)).unwrap();
    let parts = vec![TaughtPart { folder: "good".to_string(), least_tolerance: 0.5 }];
    let settings = serde_json::json!({ "levels": null });
    let report = GoldenReport::new(parts, ("relative blur", "px²"), (1.0, true), settings);
    let picture = parfocal::Frame::gray(width, height, pixels(1, |i| i as f32 / 200.0)).unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    let file = folder.path().join("golden.exr");
    export::write_golden(&file, &GoldenPart { report, heights, picture }).unwrap();
    fs::read(file).unwrap()
}

/// Reads a golden part.
fn golden_part(file: &Path) {
    if is_small(file) {
        let _ = export::read_golden(file);
    }
}

const REPORT: &str = r#"{"program": "parfocal", "kind": "pair", "version": "0.1.0", "frames": [
{"file": "a.png", "transform": {"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1}, "gain": 1.0, "offset": 0.0},
{"file": "b.png", "transform": {"tx_px": 1.5, "ty_px": -0.5, "rotation_deg": 0.25, "scale": 1.01}, "gain": 1.0, "offset": 0.0}],
"reference": 0, "size": {"width": 12, "height": 9}, "photograph": {"width": 12, "height": 9}, "nearer": 1,
"region": {"x": 0, "y": 0, "width": 12, "height": 9}, "values": {"decode": "none", "by": "files"}, "unfinished": false,
"files": ["relative_blur.exr", "a"], "levels": [], "warnings": [],
"hashes": {"a": {"bytes": 3, "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"}}}"#;

fn texts() -> Vec<Vec<u8>> {
    let matrix = r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1, "matrix": [[1.01, 0.002, 3.5], [-0.002, 0.99, -1.25], [1e-6, 0, 1]]}"#;
    vec![REPORT.into(), matrix.into(), r#"{"tx_px": 1, "ty_px": 2, "rotation_deg": 0, "scale": 1}"#.into()]
}

/// Reads a results folder whose report is the mutated file.
fn folder(file: &Path) {
    let folder = file.parent().unwrap();
    if !folder.join("relative_blur.exr").exists() {
        let field = exr().swap_remove(0);
        let names = ["relative_blur.exr", "confidence.exr", "uncertainty.exr", "focus.exr"];
        names.iter().for_each(|name| fs::write(folder.join(name), &field).unwrap());
    }
    let _ = Results::read(folder).is_ok();
    let _ = (export::listed_in(folder, "report.json"), export::profiles_in(folder));
    if let Ok(Ok(report)) = fs::read(file).map(|bytes| serde_json::from_slice(&bytes)) {
        let _ = export::is_whole(folder, "report.json", &report);
    }
}

/// Reads the size and the transform from a file.
fn transform(file: &Path) {
    let _ = (image_io::size(file).is_ok(), Registration::read(file).is_ok());
}

fn kernel(file: &Path) {
    if is_small(file) {
        let _ = image_io::read_kernel(file);
    }
}

fn field(file: &Path) {
    if is_small(file) {
        let _ = image_io::read_field(file);
    }
}

#[test]
fn whatever_a_file_holds_it_is_read_or_refused() {
    let target = |name, file, corpus, read| Target { name, file, corpus, read };
    let pnm: Vec<Vec<u8>> = vec![
        b"P5 12 9 255\n0123456789abcdefghijklmnopqrstuvwxyz0123456789abcdefghijklmnopqrstuvwxyz0123456789abcdefghijklmnopqrstuvwxyz!".to_vec(),
        b"P2\n# text\n3 2\n65535\n1 2 3\n40000 5 6\n".to_vec(),
        b"P3 2 1 255 1 2 3 4 5 6".to_vec(),
        b"P6 2 2 255\nabcdefghijkl".to_vec(),
        b"P4 8 2\nab".to_vec(),
        pfm(),
    ];
    let hostile = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hostile/dwaa_abort.exr")).unwrap();
    let targets = [
        target("png", "photograph.png", png(), photograph as fn(&Path)),
        target("jpeg", "photograph.jpg", jpeg(), photograph),
        target("tiff", "photograph.tif", tiff(), photograph),
        target("pnm", "photograph.pnm", [encoded(&[ImageFormat::Pnm]), pnm].concat(), photograph),
        target("bmp", "photograph.bmp", encoded(&[ImageFormat::Bmp]), photograph),
        target("webp", "photograph.webp", encoded(&[ImageFormat::WebP]), photograph),
        target("exr", "photograph.exr", [exr(), vec![hostile]].concat(), photograph),
        target("field", "relative_blur.exr", exr(), field),
        target("golden", "golden.exr", vec![golden()], golden_part),
        target("kernel", "kernel.png", [encoded(&[ImageFormat::Png]), exr()].concat(), kernel),
        target("transform", "transform.json", texts(), transform),
        target("report", "report.json", texts(), folder),
    ];
    // A case takes about 100 µs.
    fuzz::run("fuzz::whatever_a_file_holds_it_is_read_or_refused", &targets, &Share { short: 2000, long: 100_000 });
}
