//! Descriptions of photograph files for the report, and the decoding of their values.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::curve::{LINEAR, UNREADABLE};
use super::metadata::{Carried, Exif};
use crate::base::{Decode, Depth, Error, Frame, photon_transfer};

/// The file of a photograph.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// The name as given.
    pub file: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// SHA-256 of the file, as `sha256sum` prints it.
    pub sha256: String,
    /// Bits of a stored sample.
    pub bits: u32,
    /// 1 for grey, 3 for colour; alpha is not counted.
    pub channels: u32,
    /// Whether the file has an alpha channel.
    pub alpha: bool,
    /// File format: "PNG", "JPEG", "TIFF", "PNM", "PFM", "EXR", "BMP", "WebP" or "raw".
    pub format: String,
    /// Number of pages of the file.
    pub pages: usize,
    /// The page that is read, from 1, if the path names one.
    pub page: Option<usize>,
    /// Transfer curve that the file states: "sRGB", "linear", "gamma 1.80" or "an ICC curve".
    /// The source is the curve of the ICC profile, the chunks of a PNG, or EXIF. EXR and PFM are linear by convention.
    pub encoding: Option<String>,
    /// EXIF of the camera and the lens.
    pub exif: Option<Exif>,
    /// What files made from the photograph carry.
    #[serde(skip)]
    pub carried: Arc<Carried>,
    /// Whether the file states another orientation than the first frame of the sweep, by which it is turned.
    #[serde(skip)]
    pub is_turned_otherwise: bool,
}

/// Warnings about the files of a pair; one sentence each.
pub fn pair_warnings(inputs: &[Input], decode: Decode) -> Vec<String> {
    let [i1, i2] = inputs else { return Vec::new() };
    let mut warnings = Vec::new();
    if i1.channels != i2.channels {
        let (gray, color) = if i1.channels < i2.channels { (i1, i2) } else { (i2, i1) };
        warnings.push(format!(
            "{} is grey and {} is coloured, so that a colour that reads otherwise in grey looks like a change of \
             exposure: take both in one way",
            gray.file, color.file
        ));
    }
    for input in inputs.iter().filter(|input| input.pages > 1 && input.page.is_none()) {
        warnings.push(format!(
            "{0} has {1} pages, and the first is read: name the page, as in '{0}#2', or '{0}#1' for this one",
            input.file, input.pages
        ));
    }
    warnings.extend(encoding_warning([i1, i2], decode));
    warnings
}

/// The decoding of stored values to intensities, and its reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Values {
    /// The decoding.
    pub decode: Decode,
    /// Its reason.
    pub by: Basis,
}

/// The reason for a decoding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// The user stated it.
    #[default]
    Stated,
    /// All files state it.
    Files,
    /// At least one file does not state it. It is assumed from the bits of a sample.
    Assumed,
    /// No file states it. The noise of the photographs shows it.
    Noise,
}

impl Values {
    /// The decoding that a user stated.
    pub fn stated(decode: Decode) -> Self {
        Self { decode, by: Basis::Stated }
    }

    /// Resolves [`Decode::Auto`] by the statements of the files of one scene, or by their bits if no file states a
    /// curve ([`Decode::resolved`]).
    ///
    /// A file without a statement is read as the others state. Values with a curve other than linear and sRGB, such as
    /// gamma 1.8, are sRGB values once [`corrected`](Self::corrected) has converted them.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if two files contradict each other.
    pub fn of(decode: Decode, files: &[Input]) -> Result<Self, Error> {
        if decode != Decode::Auto {
            return Ok(Self::stated(decode));
        }
        let stated: Vec<(&Input, Decode)> =
            files.iter().filter_map(|file| Some((file, stated_decode(file)?))).collect();
        let by = if stated.len() == files.len() { Basis::Files } else { Basis::Assumed };
        let Some(&(first, decode)) = stated.first() else {
            let depths = files.iter().map(|file| if file.bits <= 8 { Depth::U8 } else { Depth::U16 });
            return Ok(Self { decode: decode.resolved(depths), by });
        };
        match stated.iter().find(|(_, other)| *other != decode) {
            None => Ok(Self { decode, by }),
            Some((other, _)) => Err(Error::Mismatch(format!(
                "{} says that its values are {}, and {} that its are {}: save both in one way, or give --decode none or srgb",
                first.file,
                first.encoding.as_deref().unwrap_or_default(),
                other.file,
                other.encoding.as_deref().unwrap_or_default()
            ))),
        }
    }

    /// Converts the frames of these files that have a curve of their own to sRGB, and corrects sRGB that is only
    /// assumed, by their noise.
    ///
    /// In linear light the variance of noise grows in proportion to brightness. If it clearly does, 8-bit files are
    /// linear. If not, or if a file states a curve, or if the user stated the decoding, nothing changes.
    #[must_use]
    pub fn corrected(self, files: &[Input], frames: &mut [Frame]) -> Self {
        self.convert(files, frames);
        let is_open = self.by == Basis::Assumed && self.decode == Decode::Srgb;
        if !is_open || files.iter().any(|file| stated_decode(file).is_some()) {
            return self;
        }
        let step = frames.len().div_ceil(MOST_MEASURED).max(1);
        match photon_transfer::is_linear(&frames.iter().step_by(step).collect::<Vec<_>>()) {
            true => Self { decode: Decode::None, by: Basis::Noise },
            false => self,
        }
    }

    /// Converts the frames of these files to sRGB, if one has a curve of its own.
    pub(crate) fn convert(self, files: &[Input], frames: &mut [Frame]) {
        if files.iter().any(|file| self.converts(file)) {
            for (file, frame) in files.iter().zip(frames) {
                let curve = file.carried.curve.as_ref().filter(|_| self.converts(file));
                *frame = curve.map_or_else(|| frame.widened(), |curve| curve.in_srgb(frame));
            }
        }
    }

    /// Whether the values of a file with a curve of its own are converted to sRGB.
    pub(crate) fn converts(self, file: &Input) -> bool {
        self.by != Basis::Stated && self.decode == Decode::Srgb && file.carried.curve.is_some()
    }
}

/// The most frames of a sweep whose noise is measured.
const MOST_MEASURED: usize = 3;

/// The decoding that a file states.
fn stated_decode(file: &Input) -> Option<Decode> {
    match file.encoding.as_deref()? {
        UNREADABLE => None,
        LINEAR => Some(Decode::None),
        _ => Some(Decode::Srgb),
    }
}

/// A warning if two photographs state different curves, or if a linear one is decoded as sRGB.
fn encoding_warning([i1, i2]: [&Input; 2], decode: Decode) -> Option<String> {
    let [first, second] = [i1, i2].map(|input| input.encoding.as_deref());
    if let (Some(a), Some(b)) = (first, second)
        && a != b
    {
        let (f1, f2) = (&i1.file, &i2.file);
        return Some(format!("{f1} says that its values are {a}, and {f2} that its are {b}: save both in one way"));
    }
    let linear = [i1, i2].into_iter().find(|input| input.encoding.as_deref() == Some(LINEAR))?;
    (decode == Decode::Srgb)
        .then(|| format!("{} says that its values are linear, and --decode srgb bends them: leave it out", linear.file))
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::io;
    use std::path::{Path, PathBuf};

    use ::exif::experimental::Writer;
    use ::exif::{Field, In, Rational, Tag, Value};
    use image::codecs::jpeg::JpegEncoder;
    use image::codecs::png::PngEncoder;
    use image::{ExtendedColorType, ImageEncoder};
    use tempfile::TempDir;
    use tiff::encoder::{TiffEncoder, colortype};

    use super::*;
    use crate::base::color::stored;
    use crate::base::random::Random;
    use crate::base::{Channels, Error, Samples};
    use crate::files::image_io::Photograph;

    fn describe(path: &Path) -> Result<Input, Error> {
        Photograph::open(path).map(|photograph| photograph.describe())
    }

    /// EXIF of a camera with a focus distance of 1.25 m, or an unknown one.
    fn camera(distance: (u32, u32)) -> Vec<u8> {
        let ratio = |num, denom| Value::Rational(vec![Rational { num, denom }]);
        let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
        let fields = [
            (Tag::Make, text("Canon")),
            (Tag::Model, text("Canon EOS 5D")),
            (Tag::FocalLength, ratio(1000, 10)),
            (Tag::FocalLengthIn35mmFilm, Value::Short(vec![100])),
            (Tag::FNumber, ratio(56, 10)),
            (Tag::SubjectDistance, ratio(distance.0, distance.1)),
            (Tag::FocalPlaneXResolution, ratio(2540, 1)),
            (Tag::ColorSpace, Value::Short(vec![1])),
        ];
        let fields = fields.map(|(tag, value)| Field { tag, ifd_num: In::PRIMARY, value });
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = io::Cursor::new(Vec::new());
        writer.write(&mut bytes, false).unwrap();
        bytes.into_inner()
    }

    fn save(folder: &TempDir, name: &str, exif: Vec<u8>) -> PathBuf {
        let path = folder.path().join(name);
        let file = File::create(&path).unwrap();
        let pixels = vec![7; 5 * 3 * 3];
        if name.ends_with("png") {
            let mut encoder = PngEncoder::new(file);
            encoder.set_exif_metadata(exif).unwrap();
            encoder.write_image(&pixels, 5, 3, ExtendedColorType::Rgb8).unwrap();
        } else {
            let mut encoder = JpegEncoder::new(file);
            encoder.set_exif_metadata(exif).unwrap();
            encoder.write_image(&pixels, 5, 3, ExtendedColorType::Rgb8).unwrap();
        }
        path
    }

    #[test]
    fn the_lens_is_read_if_the_camera_states_it() {
        let folder = TempDir::new().unwrap();
        for name in ["a.jpg", "a.png"] {
            let input = describe(&save(&folder, name, camera((125, 100)))).unwrap();
            let expected = Exif {
                camera: Some("Canon EOS 5D".to_string()),
                focal_length_mm: Some(100.0),
                focal_length_35mm_mm: Some(100.0),
                f_number: Some(5.6),
                subject_distance_mm: Some(1250.0),
                pixel_pitch_mm: Some(0.01),
                taken: None,
            };
            assert_eq!(input.exif, Some(expected), "{name}");
            assert_eq!((input.encoding.as_deref(), input.bits, input.channels), (Some("sRGB"), 8, 3));
        }
        for unknown in [(0, 1), (u32::MAX, 1), (1, 0)] {
            let input = describe(&save(&folder, "a.jpg", camera(unknown))).unwrap();
            assert_eq!(input.exif.unwrap().subject_distance_mm, None, "{unknown:?}");
        }
        let input = describe(&save(&folder, "a.jpg", b"II*\0nonsense".to_vec())).unwrap();
        assert_eq!((input.exif, input.encoding), (None, None));
        let path = folder.path().join("a.tif");
        let mut encoder = TiffEncoder::new(File::create(&path).unwrap()).unwrap();
        let mut image = encoder.new_image::<colortype::Gray8>(4, 1).unwrap();
        image.encoder().write_tag(tiff::tags::Tag::Model, "bench").unwrap();
        image.write_data(&[1, 2, 3, 4]).unwrap();
        assert_eq!(describe(&path).unwrap().exif.unwrap().camera.as_deref(), Some("bench"));
    }

    #[test]
    fn a_png_states_its_transfer_curve() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.png");
        let write = |set: &dyn Fn(&mut png::Encoder<File>)| {
            let mut encoder = png::Encoder::new(File::create(&path).unwrap(), 2, 1);
            set(&mut encoder);
            encoder.write_header().unwrap().write_image_data(&[1, 2]).unwrap();
            describe(&path).unwrap().encoding
        };
        assert_eq!(write(&|_| ()), None);
        assert_eq!(write(&|e| e.set_source_srgb(png::SrgbRenderingIntent::Perceptual)).as_deref(), Some("sRGB"));
        assert_eq!(write(&|e| e.set_source_gamma(png::ScaledFloat::new(1.0))).as_deref(), Some("linear"));
        assert_eq!(write(&|e| e.set_source_gamma(png::ScaledFloat::new(0.45455))).as_deref(), Some("sRGB"));
        assert_eq!(write(&|e| e.set_source_gamma(png::ScaledFloat::new(0.55556))).as_deref(), Some("gamma 1.80"));
    }

    #[test]
    fn the_hash_is_that_of_sha256sum() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("a.pgm");
        fs::write(&path, "P2 2 1 255 0 255\n").unwrap();
        let input = describe(&path).unwrap();
        assert_eq!(input.bytes, 17);
        assert_eq!(input.sha256, "d76b71c5c2925d05d8176edc363b6c0c7d6c5f7787296055a8e638c09184bef7");
        assert_eq!((input.format.as_str(), input.pages, input.alpha), ("PNM", 1, false));
    }

    fn input_of(file: &str, bits: u32, encoding: Option<&str>) -> Input {
        let (file, sha256, encoding) = (file.to_string(), file.to_string(), encoding.map(String::from));
        Input { file, sha256, bits, channels: 3, pages: 1, encoding, ..Input::default() }
    }

    #[test]
    fn files_that_do_not_match_give_warnings() {
        let [a, b] = ["a", "b"].map(|name| input_of(name, 8, None));
        let warn = |b: Input, decode| pair_warnings(&[a.clone(), b], decode).join("; ");
        assert_eq!(warn(b.clone(), Decode::None), "");
        assert!(warn(Input { channels: 1, ..b.clone() }, Decode::None).contains("b is grey and a is coloured"));
        assert!(warn(Input { pages: 3, ..b.clone() }, Decode::None).contains("b has 3 pages"));
        assert_eq!(warn(Input { pages: 3, page: Some(2), ..b.clone() }, Decode::None), "");
        let linear = Input { encoding: Some("linear".to_string()), ..b.clone() };
        assert_eq!(warn(linear.clone(), Decode::None), "");
        assert!(warn(linear.clone(), Decode::Srgb).contains("b says that its values are linear"));
        let both = pair_warnings(&[Input { encoding: Some("sRGB".to_string()), ..a.clone() }, linear], Decode::None);
        assert!(both[0].contains("a says that its values are sRGB, and b that its are linear"), "{both:?}");
    }

    #[test]
    fn decoding_follows_the_files_or_else_their_bits() {
        let of = |files: &[Input]| {
            Values::of(Decode::Auto, files).map(|Values { decode, by }| (decode, by)).map_err(|e| e.to_string())
        };
        let (plain, deep) = (input_of("a", 8, None), input_of("d", 16, None));
        assert_eq!(of(std::slice::from_ref(&plain)), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(std::slice::from_ref(&deep)), Ok((Decode::None, Basis::Assumed)));
        assert_eq!(of(&[deep.clone(), plain.clone()]), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(&[deep, input_of("b", 8, Some("sRGB"))]), Ok((Decode::Srgb, Basis::Assumed)));
        assert_eq!(of(&[plain, input_of("e", 32, Some("linear"))]), Ok((Decode::None, Basis::Assumed)));
        for curve in ["sRGB", "Adobe RGB (1998)", "gamma 1.80"] {
            assert_eq!(of(&[input_of("s", 16, Some(curve))]), Ok((Decode::Srgb, Basis::Files)));
        }
        assert_eq!(of(&[input_of("u", 16, Some(UNREADABLE))]), Ok((Decode::None, Basis::Assumed)));
        let problem = of(&[input_of("s", 8, Some("sRGB")), input_of("l", 8, Some("linear"))]).unwrap_err();
        assert!(problem.starts_with("s says that its values are sRGB, and l that its are linear: "), "{problem}");
        assert!(problem.contains("--decode"), "{problem}");
    }

    /// A frame of 8 bits with light from 0.02 to 0.96 and the noise of 4000 electrons at white, stored by a curve.
    fn noisy(curve: impl Fn(f64) -> f64) -> Frame {
        let mut random = Random::new(1, 1);
        let mut sample = |n: usize| {
            let light = 0.02 + 0.94 * (n % 512) as f64 / 512.0;
            (255.0 * curve(light + (light / 4000.0).sqrt() * random.normal())).round() as u8
        };
        let samples = (0..512 * 256).map(&mut sample).collect();
        Frame::new(512, 256, Channels::Gray, Samples::U8(samples)).unwrap()
    }

    #[test]
    fn noise_corrects_only_what_is_assumed() {
        let plain = [input_of("a", 8, None), input_of("b", 8, None)];
        let linear = [noisy(|light| light), noisy(|light| light)];
        let corrected = |decode, files: &[Input], frames: &[Frame]| {
            let values = Values::of(decode, files).unwrap().corrected(files, &mut frames.to_vec());
            (values.decode, values.by)
        };
        assert_eq!(corrected(Decode::Auto, &plain, &linear), (Decode::None, Basis::Noise));
        assert_eq!(corrected(Decode::Srgb, &plain, &linear), (Decode::Srgb, Basis::Stated));
        for (first, by) in [(Some("sRGB"), Basis::Assumed), (Some(UNREADABLE), Basis::Noise)] {
            let files = [input_of("a", 8, first), plain[1].clone()];
            assert_eq!(corrected(Decode::Auto, &files, &linear).1, by, "{first:?}");
        }
        let srgb = noisy(|light| f64::from(stored(light as f32, Decode::Srgb)));
        assert_eq!(corrected(Decode::Auto, &plain, &[srgb.clone(), srgb]), (Decode::Srgb, Basis::Assumed));
        // Of a sweep the first, a middle and a late frame are measured.
        let files: Vec<Input> = (0..7).map(|n| input_of(&n.to_string(), 8, None)).collect();
        assert_eq!(corrected(Decode::Auto, &files, &vec![linear[0].clone(); 7]).1, Basis::Noise);
    }
}
