//! The pairs of the experiments: scenes with their truth, a displaced photograph, and photographs.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use parfocal::{
    Frame, Settings, Solution,
    export::Nearer,
    frame::Samples,
    image_io,
    internals::scene::{self, Preset, Scene, Shape},
    internals::stages::{Field, ingest},
    internals::{LUMINANCE, brightened},
    settings::{Decode, Kernel, Method},
    transform::{Brightness, Similarity, centre},
};

use crate::section::{Runner, settings};

/// A pair with known registration.
pub(crate) struct KnownPair {
    pub images: [Frame; 2],
    pub transform: Similarity,
    /// V at each pixel of I1, px²; empty if it is not known.
    pub relative_blur: Vec<f32>,
    pub kernel: Kernel,
}

impl KnownPair {
    pub(crate) fn render(scene: &Scene) -> Result<Self, String> {
        let pair = scene.render().map_err(|e| e.to_string())?;
        let kernel = match scene.kernel {
            scene::Kernel::Gaussian => Kernel::Gaussian,
            scene::Kernel::Pillbox => Kernel::Pillbox,
            scene::Kernel::HalfGaussian => Kernel::HalfGaussian,
        };
        let (images, transform) = ([pair.i1, pair.i2], pair.transform);
        Ok(Self { images, transform, relative_blur: pair.relative_blur, kernel })
    }

    pub(crate) fn solve(&self, runner: &mut Runner, settings: &Settings) -> Result<Solution, String> {
        runner.solve(self.images.each_ref(), settings)
    }

    /// The default settings. They state the kernel if it is asymmetric, since a user must do so too.
    pub(crate) fn default_settings(&self) -> Settings {
        default_settings(&self.kernel)
    }
}

/// The default settings for a pair with this kernel, which is stated only if it is asymmetric. Samples are decoded as
/// stored.
pub(crate) fn default_settings(kernel: &Kernel) -> Settings {
    let kernel = match kernel {
        Kernel::Gaussian | Kernel::Pillbox => Kernel::Auto,
        other => other.clone(),
    };
    Settings { kernel, decode: Decode::None, ..Settings::default() }
}

/// Two photographs of a data set, in a folder with its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhotographedPair {
    pub name: &'static str,
    files: [&'static str; 2],
    /// The photograph that is focused nearer. A lens that refocuses moves out for near objects and magnifies them: if T
    /// has a scale above 1, I2 is the nearer.
    pub nearer: Nearer,
}

const PAIRS: [PhotographedPair; 6] = [
    PhotographedPair { name: "heatsink", files: ["frame_15.png", "frame_30.png"], nearer: Nearer::Second },
    PhotographedPair { name: "pcb-header", files: ["pcb_003.jpg", "pcb_005.jpg"], nearer: Nearer::First },
    PhotographedPair { name: "pcb-macro", files: ["pcb_003.JPG", "pcb_006.JPG"], nearer: Nearer::Second },
    PhotographedPair { name: "dimple", files: ["image05.jpg", "image09.jpg"], nearer: Nearer::First },
    PhotographedPair { name: "leaves", files: ["02sm.png", "04sm.png"], nearer: Nearer::First },
    CUP,
];

/// The pair by Watanabe and Nayar, which is telecentric and aligned. The paper displaces it.
const CUP: PhotographedPair =
    PhotographedPair { name: "cup", files: ["breakfast_near.png", "breakfast_far.png"], nearer: Nearer::First };

/// Least width of the reduced photographs of a quick run, px.
const QUICK_WIDTH: u32 = 240;

impl PhotographedPair {
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        PAIRS.into_iter()
    }

    /// The missing files of the pair.
    pub(crate) fn missing(&self, data: &Path) -> Vec<PathBuf> {
        self.paths(data).into_iter().filter(|path| !path.is_file()).collect()
    }

    fn paths(&self, data: &Path) -> [PathBuf; 2] {
        self.files.map(|file| data.join(self.name).join(file))
    }

    /// Reads the photographs, reduced in a quick run.
    pub(crate) fn read(&self, data: &Path, quick: bool) -> Result<[Frame; 2], String> {
        let [first, second] = self.paths(data);
        let (i1, i2) = image_io::read_pair(&first, &second).map_err(|e| e.to_string())?;
        let factor = if quick { (i1.width() / QUICK_WIDTH).max(1) } else { 1 };
        if factor == 1 { Ok([i1, i2]) } else { Ok([reduced(&i1, factor)?, reduced(&i2, factor)?]) }
    }
}

/// A pair of Table 1.
pub(crate) struct TablePair {
    pub name: String,
    pub source: Source,
}

/// The source of a pair of Table 1.
pub(crate) enum Source {
    Scene(Box<Scene>),
    /// The Cup with a displaced I2.
    Cup,
}

impl TablePair {
    /// The pairs of Table 1: scenes with symmetric blur, scenes with asymmetric blur, and the Cup if it exists.
    pub(crate) fn all(data: &Path, quick: bool) -> Vec<Self> {
        let symmetric: &[Preset] =
            if quick { &[Preset::Plane] } else { &[Preset::Plane, Preset::Relief, Preset::Steps, Preset::Cylinders] };
        let sigmas: &[f64] = if quick { &[2.5] } else { &[1.0, 1.5, 2.5] };
        let asymmetric: &[Preset] =
            if quick { &[Preset::HalfGaussianDots] } else { &[Preset::HalfGaussianTexture, Preset::HalfGaussianDots] };
        let symmetric = symmetric.iter().map(|preset| (preset.name().to_string(), preset.scene()));
        let asymmetric = asymmetric.iter().flat_map(|preset| {
            sigmas.iter().map(|sigma| {
                let shape = Shape::Uniform { variance: sigma * sigma };
                (format!("{}, σ {sigma}", preset.name()), Scene { shape, ..preset.scene() })
            })
        });
        let scenes = symmetric.chain(asymmetric).map(|(name, mut scene)| {
            if quick {
                (scene.width, scene.height) = (128, 128);
            }
            Self { name, source: Source::Scene(Box::new(scene)) }
        });
        let cup =
            CUP.missing(data).is_empty().then(|| Self { name: "cup, displaced".to_string(), source: Source::Cup });
        scenes.chain(cup).collect()
    }

    /// The pair, and the same pair without displacement.
    pub(crate) fn prepare(&self, runner: &mut Runner, data: &Path) -> Result<[KnownPair; 2], String> {
        match &self.source {
            Source::Scene(scene) => {
                let aligned = Scene { transform: Similarity::IDENTITY, ..(**scene).clone() };
                Ok([KnownPair::render(scene)?, KnownPair::render(&aligned)?])
            }
            Source::Cup => {
                let [i1, i2] = CUP.read(data, runner.quick)?;
                // The truth includes the small displacement of the photographs themselves.
                let own =
                    runner.solve([&i1, &i2], &settings(Method::Unified, &Kernel::Gaussian))?.transform.at_centre();
                let by = Similarity::new(1.8, 2.3, 0.2, 1.01);
                let pair = |i2: Frame, transform| KnownPair {
                    images: [i1.clone(), i2],
                    transform,
                    relative_blur: Vec::new(),
                    kernel: Kernel::Gaussian,
                };
                Ok([pair(displaced(&i2, &by)?, by.after(&own)), pair(i2, Similarity::IDENTITY)])
            }
        }
    }
}

/// Number of neighbours on either side for the interpolation. Its response is flat up to 0.8 of the Nyquist frequency.
const RADIUS: isize = 12;

/// The grey frame J with `J(T x) = frame(x)`, interpolated by a sinc with a squared-cosine window.
fn displaced(frame: &Frame, transform: &Similarity) -> Result<Frame, String> {
    let (width, height) = (frame.width(), frame.height());
    let grey = ingest::cpu_reference(frame, Decode::None, LUMINANCE);
    let (back, c) = (transform.inverse(), centre(width, height));
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [f64::from(x), f64::from(y)]));
    Frame::gray(width, height, places.map(|place| read(&grey, back.apply(place, c)) as f32).collect())
}

/// The field at a position between its pixels, mirrored at its border.
fn read(field: &Field, [x, y]: [f64; 2]) -> f64 {
    let ((left, columns), (top, rows)) = (taps(x), taps(y));
    let row = |j: isize| -> f64 { columns.iter().zip(left..).map(|(w, i)| w * field.mirrored(i, j)).sum() };
    rows.iter().zip(top..).map(|(w, j)| w * row(j)).sum()
}

/// The index of the first neighbour, and the weights from there on, with the sum 1.
fn taps(place: f64) -> (isize, [f64; 2 * RADIUS as usize]) {
    let first = place.floor() as isize - RADIUS + 1;
    let weight = |n: usize| {
        let d = PI * (place - (first + n as isize) as f64);
        let sinc = if d.abs() < 1e-9 { 1.0 } else { d.sin() / d };
        sinc * (d / (2.0 * RADIUS as f64)).cos().powi(2)
    };
    let weights: [f64; 2 * RADIUS as usize] = std::array::from_fn(weight);
    let sum: f64 = weights.iter().sum();
    (first, weights.map(|w| w / sum))
}

/// The frame reduced by a factor: means of `factor` x `factor` pixels of each colour, as floats.
fn reduced(frame: &Frame, factor: u32) -> Result<Frame, String> {
    let (width, height, channels) = (frame.width() / factor, frame.height() / factor, frame.format().channels);
    let (values, count) = (intensities(frame), channels.count());
    let mean = |x: u32, y: u32, c: u32| {
        let square = (0..factor).flat_map(|j| (0..factor).map(move |i| (x * factor + i, y * factor + j)));
        let sum: f64 = square.map(|(x, y)| f64::from(values[((y * frame.width() + x) * count + c) as usize])).sum();
        (sum / f64::from(factor * factor)) as f32
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let samples = pixels.flat_map(|(x, y)| (0..count).map(move |c| (x, y, c))).map(|(x, y, c)| mean(x, y, c));
    Frame::new(width, height, channels, Samples::F32(samples.collect()))
}

/// The intensities of a frame as stored, interleaved, white at 1.
pub(crate) fn intensities(frame: &Frame) -> Vec<f32> {
    brightened(frame, &Brightness::identity([frame.width(), frame.height()]), Decode::None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::frame::Channels;

    #[test]
    fn a_displaced_wave_is_the_shifted_wave() {
        let wave = |[x, y]: [f64; 2]| 0.5 + 0.3 * (0.9 * x + 0.4 * y).cos() + 0.1 * (1.3 * y).sin();
        let (width, height) = (80, 64);
        let at = |i: u32| wave([f64::from(i % width), f64::from(i / width)]) as f32;
        let frame = Frame::gray(width, height, (0..width * height).map(at).collect()).unwrap();
        let t = Similarity::new(1.8, 2.3, 0.2, 1.01);
        let moved = displaced(&frame, &t).unwrap();
        let Samples::F32(values) = moved.samples() else { panic!("not floats") };
        for y in 20..44 {
            for x in 20..60 {
                let expected = wave(t.inverse().apply([f64::from(x), f64::from(y)], centre(width, height)));
                assert!((f64::from(values[(y * width + x) as usize]) - expected).abs() < 2e-3, "({x}, {y})");
            }
        }
    }

    #[test]
    fn reduction_averages_each_colour() {
        let samples = vec![0, 10, 20, 255, 30, 40, 0, 0, 0, 255, 0, 0];
        let frame = Frame::new(2, 2, Channels::Rgb, Samples::U8(samples)).unwrap();
        let Samples::F32(values) = reduced(&frame, 2).unwrap().samples().clone() else { panic!("not floats") };
        for (found, expected) in values.iter().zip([127.5, 10.0, 15.0]) {
            assert!((f64::from(*found) * 255.0 - expected).abs() < 1e-4);
        }
    }

    #[test]
    fn missing_files_of_a_pair_are_named() {
        let empty = tempfile::TempDir::new().unwrap();
        assert_eq!(CUP.missing(empty.path())[0], empty.path().join("cup/breakfast_near.png"));
        assert!(TablePair::all(empty.path(), false).iter().all(|pair| !pair.name.contains("cup")));
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data");
        assert!(PAIRS[0].missing(&data).is_empty());
    }
}
