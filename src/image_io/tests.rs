//! Every format there and back, and what damaged files are told.

use std::fs;
use std::path::{Path, PathBuf};

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage, f16};
use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageBuffer, ImageEncoder, ImageFormat, Luma, Rgb};
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};

use super::*;
use crate::{Channels, Samples};

const WIDTH: u32 = 37;
const HEIGHT: u32 = 21;

fn gray8() -> DynamicImage {
    ImageBuffer::from_fn(WIDTH, HEIGHT, |x, y| Luma([(5 * x + 3 * y) as u8])).into()
}

fn rgb8() -> DynamicImage {
    ImageBuffer::from_fn(WIDTH, HEIGHT, |x, y| Rgb([(7 * x) as u8, (11 * y) as u8, (x * y) as u8])).into()
}

fn gray16() -> DynamicImage {
    ImageBuffer::from_fn(WIDTH, HEIGHT, |x, y| Luma([(1717 * x + 31 * y) as u16])).into()
}

fn rgb16() -> DynamicImage {
    ImageBuffer::from_fn(WIDTH, HEIGHT, |x, y| Rgb([(1771 * x) as u16, (311 * y) as u16, 65535])).into()
}

fn save(folder: &TempDir, name: &str, image: &DynamicImage, format: ImageFormat) -> PathBuf {
    let path = folder.path().join(name);
    image.save_with_format(&path, format).unwrap();
    path
}

fn exr_file(path: &Path, width: usize, height: usize, channels: Vec<(&str, FlatSamples)>) {
    let channels = channels.into_iter().map(|(name, samples)| AnyChannel::new(name, samples)).collect();
    let layer =
        Layer::new((width, height), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
    Image::from_layer(layer).write().to_file(path).unwrap();
}

fn samples_of(image: &DynamicImage) -> (Channels, Samples) {
    match image {
        DynamicImage::ImageLuma8(b) => (Channels::Gray, Samples::U8(b.as_raw().clone())),
        DynamicImage::ImageLuma16(b) => (Channels::Gray, Samples::U16(b.as_raw().clone())),
        DynamicImage::ImageRgb8(b) => (Channels::Rgb, Samples::U8(b.as_raw().clone())),
        DynamicImage::ImageRgb16(b) => (Channels::Rgb, Samples::U16(b.as_raw().clone())),
        DynamicImage::ImageRgb32F(b) => (Channels::Rgb, Samples::F32(b.as_raw().clone())),
        other => panic!("{:?}", other.color()),
    }
}

#[test]
fn lossless_formats_round_trip_in_their_own_depth() {
    let folder = TempDir::new().unwrap();
    for (kind, format) in [("png", ImageFormat::Png), ("tiff", ImageFormat::Tiff), ("pnm", ImageFormat::Pnm)] {
        for (name, image) in [("g8", gray8()), ("c8", rgb8()), ("g16", gray16()), ("c16", rgb16())] {
            let path = save(&folder, &format!("{name}-{kind}.misleading"), &image, format);
            let (channels, samples) = samples_of(&image);
            let expected = Frame::new(WIDTH, HEIGHT, channels, samples).unwrap();
            assert!(read(&path).unwrap() == expected, "{name} as {kind}");
        }
    }
}

#[test]
fn alpha_is_dropped_and_grey_with_alpha_stays_grey() {
    let folder = TempDir::new().unwrap();
    for image in [gray8(), rgb8(), gray16(), rgb16()] {
        let (channels, samples) = samples_of(&image);
        let with_alpha = match image.color() {
            image::ColorType::L8 => image.to_luma_alpha8().into(),
            image::ColorType::L16 => image.to_luma_alpha16().into(),
            image::ColorType::Rgb8 => DynamicImage::from(image.to_rgba8()),
            _ => DynamicImage::from(image.to_rgba16()),
        };
        let path = save(&folder, "alpha.png", &with_alpha, ImageFormat::Png);
        assert!(read(&path).unwrap() == Frame::new(WIDTH, HEIGHT, channels, samples).unwrap());
    }
}

#[test]
fn float_tiff_round_trips_in_grey_and_colour() {
    let folder = TempDir::new().unwrap();
    let values: Vec<f32> = (0..WIDTH * HEIGHT).map(|i| i as f32 * 1.25e-3 - 0.1).collect();
    let path = folder.path().join("gray.tif");
    let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
    encoder.write_image::<colortype::Gray32Float>(WIDTH, HEIGHT, &values).unwrap();
    assert_eq!(read(&path).unwrap(), Frame::gray(WIDTH, HEIGHT, values).unwrap());

    let image = DynamicImage::from(rgb8().to_rgb32f());
    let path = save(&folder, "color.tif", &image, ImageFormat::Tiff);
    let (channels, samples) = samples_of(&image);
    assert_eq!(read(&path).unwrap(), Frame::new(WIDTH, HEIGHT, channels, samples).unwrap());
}

#[test]
fn jpeg_is_read_and_turned_as_the_camera_says() {
    let folder = TempDir::new().unwrap();
    // Big-endian TIFF header, one entry: tag 0x112 (orientation), SHORT, count 1, value 6 (turn right).
    let exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0".to_vec();
    let path = folder.path().join("turned.jpg");
    let mut encoder = JpegEncoder::new_with_quality(fs::File::create(&path).unwrap(), 95);
    encoder.set_exif_metadata(exif).unwrap();
    encoder.encode_image(&gray8().into_luma8()).unwrap();
    let frame = read(&path).unwrap();
    assert_eq!((frame.width(), frame.height()), (HEIGHT, WIDTH));
    let Samples::U8(values) = frame.samples() else { panic!("8 bits expected") };
    assert_eq!(frame.format().channels, Channels::Gray);
    let upright = gray8().rotate90().into_luma8();
    let worst = values.iter().zip(upright.as_raw()).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(worst < 12, "turned the wrong way: {worst}");
}

#[test]
fn exr_reads_colour_luminance_or_a_single_channel() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("image.exr");
    let ramp = |from: f32| (0..6).map(|i| from + i as f32 * 0.125).collect::<Vec<f32>>();
    let half = |from| FlatSamples::F16(ramp(from).into_iter().map(f16::from_f32).collect());
    let alpha = || ("A", FlatSamples::F32(vec![1.0; 6]));
    exr_file(&path, 3, 2, vec![("G", half(1.0)), alpha(), ("B", FlatSamples::F32(ramp(2.0))), ("R", half(0.0))]);
    let Samples::F32(values) = read(&path).unwrap().samples().clone() else { panic!("floats expected") };
    assert_eq!(values[..6], [0.0, 1.0, 2.0, 0.125, 1.125, 2.125]);
    for name in ["Y", "depth"] {
        exr_file(&path, 3, 2, vec![(name, half(0.5)), alpha()]);
        assert_eq!(read(&path).unwrap(), Frame::gray(3, 2, ramp(0.5)).unwrap());
    }
    exr_file(&path, 3, 2, vec![("u", half(0.0)), ("v", half(0.0))]);
    assert!(read(&path).unwrap_err().to_string().contains("channels u, v"));
    exr_file(&path, 3, 2, vec![("Y", FlatSamples::U32(vec![1; 6]))]);
    assert!(read(&path).unwrap_err().to_string().contains("32-bit integers"));
}

#[test]
fn a_float_that_is_no_number_is_refused_with_its_place() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("nan.exr");
    for bad in [f32::NAN, f32::INFINITY] {
        let values = vec![0.0, 0.0, 0.0, 0.0, bad, bad];
        exr_file(&path, 3, 2, vec![("Y", FlatSamples::F32(values))]);
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("nan.exr") && message.contains("(1, 1)"), "{message}");
    }
}

#[test]
fn sizes_that_differ_are_told_with_both_names() {
    let folder = TempDir::new().unwrap();
    let a = save(&folder, "a.png", &gray8(), ImageFormat::Png);
    let b = save(&folder, "b.png", &gray8().crop_imm(0, 0, 30, 20), ImageFormat::Png);
    let message = read_pair(&a, &b).unwrap_err().to_string();
    for part in ["a.png", "b.png", "37x21", "30x20"] {
        assert!(message.contains(part), "{message}");
    }
    assert!(read_pair(&a, &a).is_ok());
}

#[test]
fn a_header_that_claims_too_much_is_refused_before_decoding() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("huge.pgm");
    fs::write(&path, b"P5 100000 100000 255\n").unwrap();
    let message = read(&path).unwrap_err().to_string();
    assert!(message.contains("100000x100000") && message.contains("crop"), "{message}");
}

/// Samples of every format, small enough to be cut and bent at many places.
fn one_of_each(folder: &TempDir) -> Vec<PathBuf> {
    let mut paths = vec![
        save(folder, "a.png", &rgb16(), ImageFormat::Png),
        save(folder, "a.jpg", &rgb8(), ImageFormat::Jpeg),
        save(folder, "a.tif", &rgb16(), ImageFormat::Tiff),
        save(folder, "a.ppm", &rgb8(), ImageFormat::Pnm),
    ];
    let float = folder.path().join("float.tif");
    let mut encoder = TiffEncoder::new(fs::File::create(&float).unwrap()).unwrap();
    encoder.write_image::<colortype::Gray32Float>(8, 8, &[0.5; 64]).unwrap();
    let exr = folder.path().join("a.exr");
    exr_file(&exr, 20, 20, vec![("Y", FlatSamples::F32((0..400).map(|i| i as f32).collect()))]);
    paths.extend([float, exr]);
    paths
}

#[test]
fn truncated_files_are_refused_at_every_length() {
    let folder = TempDir::new().unwrap();
    for path in one_of_each(&folder) {
        let bytes = fs::read(&path).unwrap();
        // Half of a PNG's closing chunk may be missing without a pixel being lost, and TIFF may end in padding.
        for length in (0..bytes.len() - 16).step_by(7) {
            fs::write(&path, &bytes[..length]).unwrap();
            let message = read(&path).expect_err(&format!("{} cut to {length} bytes", path.display())).to_string();
            assert!(message.starts_with(&path.display().to_string()), "{message}");
        }
    }
}

#[test]
fn bent_files_never_panic() {
    let folder = TempDir::new().unwrap();
    for path in one_of_each(&folder) {
        let bytes = fs::read(&path).unwrap();
        for at in 0..bytes.len().min(600) {
            let mut bent = bytes.clone();
            bent[at] ^= 0xa5;
            fs::write(&path, &bent).unwrap();
            let _ = read(&path);
        }
    }
}

#[test]
fn fields_may_hold_what_photographs_may_not() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("field.exr");
    exr_file(&path, 2, 1, vec![("Y", FlatSamples::F32(vec![f32::NAN, -3.5]))]);
    let (width, height, values) = read_field(&path).unwrap();
    assert!((width, height) == (2, 1) && values[0].is_nan() && values[1] == -3.5, "{values:?}");
    assert!(read(&path).is_err());
    let plane = || FlatSamples::F32(vec![0.5; 2]);
    exr_file(&path, 2, 1, vec![("B", plane()), ("G", plane()), ("R", plane())]);
    assert!(read_field(&path).unwrap_err().to_string().contains("one channel"));
    let png = save(&folder, "field.png", &gray8(), ImageFormat::Png);
    assert!(read_field(&png).unwrap_err().to_string().contains("is no EXR"));
}
