//! Tests of writing and reading every format, and of damaged files.

use std::fs;
use std::path::{Path, PathBuf};

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage, f16};
use image::codecs::jpeg::JpegEncoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageBuffer, ImageEncoder, ImageFormat, Luma, Rgb};
use tempfile::TempDir;
use tiff::encoder::{TiffEncoder, colortype};

use super::header::check_size;
use super::similar_file::similarity;
use super::*;
use crate::base::{Channels, Samples};

/// Opens a photograph from the bytes that the file has now.
fn describe(path: &Path) -> Result<Input, Error> {
    Photograph::open(path).map(|photograph| photograph.describe())
}

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
fn lossless_formats_round_trip_in_their_own_bit_depth() {
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
fn transparent_pixels_do_not_count_and_grey_with_alpha_stays_grey() {
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
    let mut clear = rgb8().to_rgba8();
    clear.put_pixel(2, 1, image::Rgba([9, 9, 9, 127]));
    let path = save(&folder, "clear.png", &clear.into(), ImageFormat::Png);
    let frame = read(&path).unwrap();
    let counted: Vec<u8> = (0..WIDTH * HEIGHT).map(|i| u8::from(i != WIDTH + 2)).collect();
    assert_eq!(frame.counted(), Some(&counted[..]));
    assert_eq!(frame.intensities(Decode::None)[3 * (WIDTH as usize + 2)..][..3], [0.0; 3]);
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

/// Writes pages of one size. Each is a tiled picture with tiles of `tile` x `tile` pixels; the parts of tiles beyond
/// the picture are 0.
fn tiled<C: colortype::ColorType<Inner = T>, T: Copy + Default>(path: &Path, values: &[T], tile: u32)
where
    [T]: tiff::encoder::TiffValue,
{
    use tiff::tags::Tag;
    let samples = C::BITS_PER_SAMPLE.len();
    let mut encoder = TiffEncoder::new(fs::File::create(path).unwrap()).unwrap();
    let mut directory = encoder.image_directory().unwrap();
    let (mut offsets, mut counts) = (Vec::new(), Vec::new());
    for top in (0..HEIGHT).step_by(tile as usize) {
        for left in (0..WIDTH).step_by(tile as usize) {
            let places = (top..top + tile).flat_map(|y| (left..left + tile).map(move |x| (x, y)));
            let pixel = |(x, y): (u32, u32)| {
                let at = (y * WIDTH + x) as usize * samples;
                if x < WIDTH && y < HEIGHT { values[at..at + samples].to_vec() } else { vec![T::default(); samples] }
            };
            let data: Vec<T> = places.flat_map(pixel).collect();
            offsets.push(directory.write_data(data.as_slice()).unwrap() as u32);
            counts.push((data.len() * size_of::<T>()) as u32);
        }
    }
    let format: Vec<u16> = C::SAMPLE_FORMAT.iter().map(|f| f.to_u16()).collect();
    for (tag, value) in [
        (Tag::ImageWidth, WIDTH),
        (Tag::ImageLength, HEIGHT),
        (Tag::Compression, 1),
        (Tag::PhotometricInterpretation, u32::from(C::TIFF_VALUE.to_u16())),
        (Tag::SamplesPerPixel, samples as u32),
        (Tag::TileWidth, tile),
        (Tag::TileLength, tile),
    ] {
        directory.write_tag(tag, value).unwrap();
    }
    directory.write_tag(Tag::BitsPerSample, C::BITS_PER_SAMPLE).unwrap();
    directory.write_tag(Tag::SampleFormat, format.as_slice()).unwrap();
    directory.write_tag(Tag::TileOffsets, offsets.as_slice()).unwrap();
    directory.write_tag(Tag::TileByteCounts, counts.as_slice()).unwrap();
    directory.finish().unwrap();
}

#[test]
fn tiled_tiff_is_read_in_every_depth() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("tiled.tif");
    let (gray, rgb, deep) = (gray8().into_luma8(), rgb8().into_rgb8(), rgb16().into_rgb16());
    tiled::<colortype::Gray8, _>(&path, gray.as_raw(), 16);
    assert_eq!(read(&path).unwrap().samples(), &Samples::U8(gray.into_raw()));
    tiled::<colortype::RGB8, _>(&path, rgb.as_raw(), 32);
    assert_eq!(read(&path).unwrap().samples(), &Samples::U8(rgb.into_raw()));
    tiled::<colortype::RGB16, _>(&path, deep.as_raw(), 16);
    assert_eq!(read(&path).unwrap().samples(), &Samples::U16(deep.into_raw()));
    let values: Vec<f32> = (0..WIDTH * HEIGHT).map(|i| i as f32 * 0.5).collect();
    tiled::<colortype::Gray32Float, _>(&path, &values, 16);
    assert_eq!(read(&path).unwrap(), Frame::gray(WIDTH, HEIGHT, values).unwrap());
}

#[test]
fn a_page_is_selected_by_its_number() {
    use tiff::tags::Tag;
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("stack.tif");
    let page = |n: u32| PathBuf::from(format!("{}#{n}", path.display()));
    let (gray, deep) = (gray8().into_luma8(), rgb16().into_rgb16());
    let float: Vec<f32> = (0..WIDTH * HEIGHT).map(|i| i as f32).collect();
    for big in [false, true] {
        let file = fs::File::create(&path).unwrap();
        macro_rules! write {
            ($encoder:expr) => {{
                let mut encoder = $encoder;
                encoder.write_image::<colortype::Gray8>(WIDTH, HEIGHT, gray.as_raw()).unwrap();
                let mut reduced = encoder.new_image::<colortype::Gray8>(2, 1).unwrap();
                reduced.encoder().write_tag(Tag::NewSubfileType, 1u32).unwrap();
                reduced.write_data(&[1, 2]).unwrap();
                encoder.write_image::<colortype::RGB16>(WIDTH, HEIGHT, deep.as_raw()).unwrap();
                encoder.write_image::<colortype::Gray32Float>(WIDTH, HEIGHT, &float).unwrap();
            }};
        }
        if big {
            write!(TiffEncoder::new_big(file).unwrap())
        } else {
            write!(TiffEncoder::new(file).unwrap())
        }
        for first in [path.clone(), page(1)] {
            assert_eq!(read(&first).unwrap().samples(), &Samples::U8(gray.as_raw().clone()));
        }
        assert_eq!(read(&page(2)).unwrap().samples(), &Samples::U16(deep.as_raw().clone()));
        assert_eq!(read(&page(3)).unwrap().samples(), &Samples::F32(float.clone()));
        assert!(read(&page(4)).unwrap_err().to_string().contains("has 3 pages and no page 4"));
        let [all, third] = [&path, &page(3)].map(|p| describe(p).unwrap());
        assert_eq!((all.pages, all.page, all.bits), (3, None, 8));
        assert_eq!((third.pages, third.page, third.bits), (3, Some(3), 32));
        assert_eq!(all.sha256, third.sha256);
        assert!(
            pair_warnings(&[page(1), page(2)].map(|p| describe(&p).unwrap()), Decode::None)[0].contains("coloured")
        );
    }
    let png = save(&folder, "one.png", &gray8(), ImageFormat::Png);
    assert!(read(&png.with_file_name("one.png#2")).unwrap_err().to_string().contains("one page only"));
    assert!(read(&png.with_file_name("one.png#1")).is_ok());
    // An existing file takes precedence over a page.
    let odd = save(&folder, "one.png#3", &gray16(), ImageFormat::Png);
    assert!(matches!(read(&odd).unwrap().samples(), Samples::U16(_)));
}

/// EXIF: a big-endian TIFF header and one entry, tag 0x112 (orientation), SHORT, count 1, value 6 (turn right).
const TURNED: &[u8] = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";

#[test]
fn png_and_tiff_are_rotated_too() {
    let folder = TempDir::new().unwrap();
    let turned = |image: &DynamicImage| image.rotate90().into_luma8().into_raw();
    let path = folder.path().join("turned.png");
    let mut encoder = image::codecs::png::PngEncoder::new(fs::File::create(&path).unwrap());
    encoder.set_exif_metadata(TURNED.to_vec()).unwrap();
    encoder.write_image(gray8().as_bytes(), WIDTH, HEIGHT, image::ExtendedColorType::L8).unwrap();
    let frame = read(&path).unwrap();
    assert_eq!((frame.width(), frame.height()), (HEIGHT, WIDTH));
    assert_eq!(frame.samples(), &Samples::U8(turned(&gray8())));
    // A frame of a sweep whose camera took another side for the upper one.
    let flipped = save(&folder, "plain.png", &gray8(), ImageFormat::Png);
    let frames = read_frames(Photograph::open(&path).unwrap(), &[flipped]).unwrap();
    assert_eq!(frames[1].0.samples(), frame.samples());
    assert_eq!([0, 1].map(|n: usize| frames[n].1.is_turned_otherwise), [false, true]);

    let path = folder.path().join("turned.tif");
    for orientation in 1..=8u16 {
        let upright = {
            let mut image = gray8();
            image.apply_orientation(Orientation::from_exif(orientation as u8).unwrap());
            image.into_luma8()
        };
        let values: Vec<f32> = gray8().as_bytes().iter().map(|&v| v.into()).collect();
        for float in [false, true] {
            let mut encoder = TiffEncoder::new(fs::File::create(&path).unwrap()).unwrap();
            macro_rules! write {
                ($kind:ty, $values:expr) => {{
                    let mut image = encoder.new_image::<$kind>(WIDTH, HEIGHT).unwrap();
                    image.encoder().write_tag(tiff::tags::Tag::Orientation, orientation).unwrap();
                    image.write_data($values).unwrap();
                }};
            }
            if float {
                write!(colortype::Gray32Float, &values)
            } else {
                write!(colortype::Gray8, gray8().as_bytes())
            }
            let frame = read(&path).unwrap();
            assert_eq!((frame.width(), frame.height()), upright.dimensions(), "{orientation}");
            let found: Vec<f32> = match frame.samples() {
                Samples::U8(values) => values.iter().map(|&v| v.into()).collect(),
                Samples::F32(values) => values.clone(),
                Samples::U16(_) => panic!("16 bits"),
            };
            assert!(found.iter().zip(upright.as_raw()).all(|(a, b)| *a == f32::from(*b)), "{orientation} {float}");
        }
    }
}

#[test]
fn a_pair_may_have_two_bit_depths() {
    let folder = TempDir::new().unwrap();
    let a = save(&folder, "a.png", &gray8(), ImageFormat::Png);
    let b = save(&folder, "b.tif", &rgb16(), ImageFormat::Tiff);
    let (i1, i2) = read_pair(&a, &b).unwrap();
    assert!(matches!((i1.samples(), i2.samples()), (Samples::U8(_), Samples::U16(_))));
}

#[test]
fn jpeg_is_read_and_rotated_as_the_camera_states() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("turned.jpg");
    let mut encoder = JpegEncoder::new_with_quality(fs::File::create(&path).unwrap(), 95);
    encoder.set_exif_metadata(TURNED.to_vec()).unwrap();
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
fn infinity_is_refused_with_its_position() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("inf.exr");
    let values = vec![0.0, 0.0, 0.0, 0.0, f32::INFINITY, f32::INFINITY];
    exr_file(&path, 3, 2, vec![("Y", FlatSamples::F32(values))]);
    let message = read(&path).unwrap_err().to_string();
    assert!(message.contains("inf.exr") && message.contains("(1, 1)"), "{message}");
}

#[test]
fn an_error_about_sizes_names_both_files() {
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

/// Samples of every format, small enough to be truncated and altered at many positions.
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
    let pfm = folder.path().join("a.pfm");
    fs::write(&pfm, [&b"Pf\n10 8\n-1\n"[..], &[0; 320]].concat()).unwrap();
    paths.extend([float, exr, pfm]);
    paths
}

#[test]
fn truncated_files_are_refused_at_every_length() {
    let folder = TempDir::new().unwrap();
    for path in one_of_each(&folder) {
        let bytes = fs::read(&path).unwrap();
        // Half of a PNG's closing chunk may be missing without a lost pixel, and TIFF may end in padding.
        for length in (0..bytes.len() - 16).step_by(7) {
            fs::write(&path, &bytes[..length]).unwrap();
            let message = read(&path).expect_err(&format!("{} cut to {length} bytes", path.display())).to_string();
            assert!(message.starts_with(&path.display().to_string()), "{message}");
        }
    }
}

#[test]
fn altered_files_never_panic() {
    let folder = TempDir::new().unwrap();
    for path in one_of_each(&folder) {
        let bytes = fs::read(&path).unwrap();
        for at in 0..bytes.len().min(600) {
            let mut bent = bytes.clone();
            bent[at] ^= 0xa5;
            fs::write(&path, &bent).unwrap();
            let _ = (read(&path), describe(&path));
        }
    }
}

#[test]
fn a_panic_of_a_decoder_is_an_error_of_the_file() {
    // A changed byte of B44 makes the decoder underflow. Without overflow checks it continues.
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hostile/b44_overflow.exr"));
    let found = read(path);
    if cfg!(debug_assertions) {
        let error = found.unwrap_err().to_string();
        assert!(error.contains("the decoder fails over it"), "{error}");
    }
}

#[test]
fn fields_may_hold_nan_and_infinity() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("field.exr");
    exr_file(&path, 2, 1, vec![("Y", FlatSamples::F32(vec![f32::NAN, -3.5]))]);
    let (width, height, values) = read_field(&path).unwrap();
    assert!((width, height) == (2, 1) && values[0].is_nan() && values[1] == -3.5, "{values:?}");
    let frame = read(&path).unwrap();
    assert_eq!((frame.samples(), frame.counted()), (&Samples::F32(vec![0.0, -3.5]), Some(&[0, 1][..])));
    exr_file(&path, 2, 1, vec![("Y", FlatSamples::F32(vec![f32::NAN; 2]))]);
    assert!(read(&path).unwrap_err().to_string().contains("NaN"));
    let plane = || FlatSamples::F32(vec![0.5; 2]);
    exr_file(&path, 2, 1, vec![("B", plane()), ("G", plane()), ("R", plane())]);
    assert!(read_field(&path).unwrap_err().to_string().contains("one channel"));
    let png = save(&folder, "field.png", &gray8(), ImageFormat::Png);
    assert!(read_field(&png).unwrap_err().to_string().contains("is no EXR"));
}

#[test]
fn hash_and_pixels_are_of_the_bytes_that_were_opened() {
    let folder = TempDir::new().unwrap();
    for (at, path) in one_of_each(&folder).into_iter().enumerate() {
        let (input, frame) = (describe(&path).unwrap(), read(&path).unwrap());
        let photograph = Photograph::open(&path).unwrap();
        assert_eq!((photograph.size(), photograph.depth()), ((frame.width(), frame.height()), frame.format().depth));
        // First another file takes the name, then the bytes change in place, then the file is removed.
        match at % 3 {
            0 => fs::rename(save(&folder, "other", &gray16(), ImageFormat::Png), &path).unwrap(),
            1 => fs::write(&path, "P5 1 1 255 \0").unwrap(),
            _ => fs::remove_file(&path).unwrap(),
        }
        assert_eq!(photograph.describe(), input);
        assert!(photograph.decode().unwrap() == frame, "{}", path.display());
    }
}

#[test]
fn frames_of_any_depth_become_eight_bits() {
    let gray = Frame::gray(2, 1, vec![-1.0, 0.5]).unwrap();
    assert_eq!(preview_in(&gray, Tone::default()).into_raw(), [0, 0, 0, 128, 128, 128]);
    assert_eq!(preview(&gray).into_raw(), [0, 0, 0, 255, 255, 255]);
    let deep = Frame::new(1, 1, Channels::Rgb, Samples::U16(vec![0, 0x8000, 0xffff])).unwrap();
    assert_eq!(preview(&deep).into_raw(), [0, 128, 255]);
}

#[test]
fn the_greatest_size_is_allowed_and_one_row_more_is_not() {
    assert!(check_size((1 << 14, 1 << 14)).is_ok());
    let problem = check_size((1 << 14, (1 << 14) + 1)).unwrap_err();
    assert!(problem.contains("16384x16385") && problem.contains("268435456"), "{problem}");
    assert!(check_size((u32::MAX, u32::MAX)).is_err());
    assert!(check_size((0, 5)).is_err());
}

#[test]
fn a_name_with_other_numbers_is_no_misspelling() {
    for (name, other) in
        [("naer.png", "near.png"), ("i1.jpg", "i1.png"), ("Frame_1.png", "frame_01.png"), ("shot", "shots")]
    {
        assert!(similarity(name, other).is_some(), "{name} {other}");
    }
    for (name, other) in [("frame_09.png", "frame_01.png"), ("i3.png", "i1.png"), ("depth.png", "report.png")] {
        assert_eq!(similarity(name, other), None, "{name} {other}");
    }
}
