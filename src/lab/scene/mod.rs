//! The image formation model: synthetic pairs with ground truth.
//!
//! A [`Scene`] is plain data: a shape (blur, or depth and a lens), a radiance, a kernel, and the displacement and
//! exposure of the second image. [`Scene::render`] makes the pair; [`SweepScene::render`] makes a focus sweep of the
//! same scene.
//!
//! ```
//! use parfocal::internals::scene::{Preset, Scene};
//!
//! # fn main() -> Result<(), parfocal::Error> {
//! let scene = Scene { noise: 0.003, width: 64, height: 48, ..Preset::Relief.scene() };
//! let pair = scene.render()?;
//! println!("V at the first pixel is {} px², T is {:?}", pair.relative_blur[0], pair.transform);
//! # assert_eq!(pair.relative_blur.len(), 64 * 48);
//! # Ok(())
//! # }
//! ```
//!
//! # What is computed
//!
//! With r the radiance in focus, h(u; v) the kernel of variance v, V1 and V2 the blur of both images in px² of I1, and
//! `x = T⁻¹ q`:
//!
//! ```text
//! I1(x) = ∫ h(u; V1(x)) r(x - u) du
//! I2(q) = ∫ h(u; s² V2(x)) r(T⁻¹(q - u)) du          V(x) = V2(x) - V1(x)
//! ```
//!
//! Blur is a gather, with the variance at the receiving position: **occlusion is ignored**. At a jump in depth, both
//! sides are visible through each other's blur, as if neither hid the other. The exception is [`Shape::Layers`], which
//! is rendered by rays: each shows the first layer that it meets. The kernel is oriented with the sensor of its own
//! image. Nothing is resampled: texture has a closed form with every kernel, and for other radiance the kernel is
//! integrated over a continuous function. No code is shared with the solver's blur.

mod files;
mod kernel;
mod layers;
mod presets;
mod radiance;
mod raster;
mod shape;
mod sweep;
mod view;

use serde::Serialize;

pub use files::{
    FrameTruth, PairField, SweepField, Truth, simulated_files, simulated_sweep_files, write_simulated,
    write_simulated_sweep,
};
pub use kernel::Kernel;
pub use layers::Arrangement;
pub use presets::Preset;
pub use radiance::{Radiance, Wave};
pub use shape::Shape;
pub use sweep::{Shot, SimulatedSweep, SweepScene};

use self::kernel::Rules;
use self::layers::{Layer, Layered};
use self::radiance::Pattern;
use self::view::{View, fill_rows};
use crate::base::random::Random;
use crate::base::{Channels, Error, Frame, Lens, Photometric, Samples, Similarity};

/// A description from which a pair is rendered. [`Preset::scene`] makes one with defaults.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scene {
    /// The name in `truth.json`.
    pub name: String,
    /// Pixels per row, at least 16.
    pub width: u32,
    /// Rows, at least 16; at most 2^24 pixels in all.
    pub height: u32,
    /// Seed of texture, dots, relief and noise. Each has its own sequence of random numbers.
    pub seed: u64,
    /// Seed of the noise, if it is not `seed`: for repeated photographs of one scene.
    pub noise_seed: Option<u64>,
    /// The shape: blur, or depth and a lens.
    pub shape: Shape,
    /// The texture of the surface.
    pub radiance: Radiance,
    /// The range from the darkest to the brightest radiance: p in [0, 1] becomes `½ + contrast (p - ½)`. Above 0, at
    /// most 1.
    pub contrast: f64,
    /// Shape of the blur of both images.
    pub kernel: Kernel,
    /// Blur of both images even in focus, added to V1 and V2: px² of I1, 0 to 16.
    pub base_blur: f64,
    /// T: `I2(T x)` corresponds to I1(x).
    pub transform: Similarity,
    /// By how much a camera that moved across its axis displaces what is at the nearer focus distance against what is at
    /// the farther one in I2, px: layers only, as seen from the second place. What is midway stays.
    #[serde(skip_serializing_if = "is_still")]
    pub camera_moves: [f64; 2],
    /// The exposure of I2 relative to I1.
    pub exposure: Exposure,
    /// Standard deviation of the Gaussian noise of both images, added after the exposure, intensities; 0 to 1.
    pub noise: f64,
}

fn is_still(moves: &[f64; 2]) -> bool {
    *moves == [0.0; 2]
}

/// The exposure of I2, `I2 ← gain I2 + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Exposure {
    /// Factor applied to I2, 0.01 to 100.
    pub gain: f64,
    /// Added after the gain, intensities, -10 to 10.
    pub offset: f64,
}

impl Default for Exposure {
    fn default() -> Self {
        Self { gain: 1.0, offset: 0.0 }
    }
}

impl Exposure {
    /// The gain and offset that undo the exposure and map I2 onto I1.
    pub fn photometric(&self) -> Photometric {
        // Adding zero turns -0, of an exposure without offset, into 0.
        Photometric { gain: 1.0 / self.gain, offset: -self.offset / self.gain + 0.0 }
    }
}

/// A rendered pair, and the truth about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Simulated {
    /// The reference image, 32-bit floats with white at 1; grey unless the radiance is in colour. Not clipped.
    pub i1: Frame,
    /// The other image.
    pub i2: Frame,
    /// V at each pixel of I1, px² of I1, row-major.
    pub relative_blur: Vec<f32>,
    /// Depth at each pixel of I1, mm, row-major; only if the scene has a lens.
    pub depth: Option<Vec<f32>>,
    /// T.
    pub transform: Similarity,
    /// Gain and offset that map I2 onto I1.
    pub photometric: Photometric,
}

/// Least width and height, px.
const LEAST_SIDE: u32 = 16;

/// Greatest number of pixels. The texture of more takes minutes.
const MOST_PIXELS: u64 = 1 << 24;

/// Largest variance of either blur, px² of its own image: σ 24 px.
const MOST_VARIANCE: f64 = 576.0;

impl Scene {
    /// The lens, if the scene has one.
    pub fn lens(&self) -> Option<&Lens> {
        self.shape.lens()
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::TooSmall`]; [`Error::Setting`] with the first field that is out of range.
    pub fn check(&self) -> Result<(), Error> {
        let (width, height) = (self.width, self.height);
        if width.min(height) < LEAST_SIDE {
            return Err(Error::TooSmall { width, height, least: LEAST_SIDE });
        }
        range("number of pixels", f64::from(width) * f64::from(height), 256.0, MOST_PIXELS as f64)?;
        match self.shape {
            Shape::Plane { limit } | Shape::Steps { limit } | Shape::Relief { limit } => {
                range("largest relative blur", limit, 0.0, 256.0)?;
            }
            Shape::Uniform { variance } => range("uniform relative blur", variance, -256.0, 256.0)?,
            Shape::DepthFile { unit, .. } => range("unit of depth", unit, 1e-9, 1e9)?,
            Shape::Layers { .. } => self.check_layers()?,
            Shape::Cylinders { .. } | Shape::RelativeBlurFile { .. } => {}
        }
        // Textures of layers are rendered so far around the frame.
        let most = if matches!(self.shape, Shape::Layers { .. }) { 40.0 } else { 0.0 };
        self.camera_moves.iter().try_for_each(|&px| range("movement of the camera", px, -most, most))?;
        self.lens().map_or(Ok(()), Lens::check)?;
        range("contrast", self.contrast, 1e-3, 1.0)?;
        range("base blur", self.base_blur, 0.0, 16.0)?;
        range("noise", self.noise, 0.0, 1.0)?;
        range("gain of I2", self.exposure.gain, 0.01, 100.0)?;
        range("offset of I2", self.exposure.offset, -10.0, 10.0)?;
        range("translation x", self.transform.tx, -1e4, 1e4)?;
        range("translation y", self.transform.ty, -1e4, 1e4)?;
        range("rotation", self.transform.rotation_deg(), -360.0, 360.0)?;
        range("scale", self.transform.scale, 0.2, 5.0)
    }

    /// Checks that layers can be rendered.
    fn check_layers(&self) -> Result<(), Error> {
        if self.kernel == Kernel::HalfGaussian || self.radiance != Radiance::Texture {
            let problem = "layers are rendered with texture under a gaussian or a pillbox; state these";
            return Err(Error::Mismatch(problem.to_string()));
        }
        // Sharper edges than σ 0.3 px would show the nodes of the sum.
        range("base blur of layers", self.base_blur, 0.09, 16.0)
    }

    /// Renders the pair. Uses all processors, for a second or two at the default size.
    ///
    /// # Errors
    /// As [`check`](Self::check); [`Error::File`] if the file of the radiance or the shape cannot be used;
    /// [`Error::Setting`] if depth and lens give a blur beyond σ 24 px.
    pub fn render(&self) -> Result<Simulated, Error> {
        self.check()?;
        let size = [self.width, self.height];
        let surface = self.shape.surface([self.width, self.height], self.seed, self.transform.scale)?;
        let views = [View::new(&Similarity::IDENTITY, size), View::new(&self.transform, size)];
        let [i1, i2] = if let Shape::Layers { arrangement, lens } = &self.shape {
            self.layered_pair(&views, arrangement.layers(self.seed, size, lens), lens)?
        } else {
            let channels = self.radiance.channels([self.width, self.height], self.seed)?;
            let planes = |i: usize| self.gathered(&views[i], |x| surface(x).variances[i], &channels);
            [self.exposed(0, &planes(0)?)?, self.exposed(1, &planes(1)?)?]
        };
        let point = |i: usize| surface([(i % self.width as usize) as f64, (i / self.width as usize) as f64]);
        let pixels = self.width as usize * self.height as usize;
        let relative_blur = (0..pixels).map(point).map(|p| (p.variances[1] - p.variances[0]) as f32).collect();
        let depth = (0..pixels).map(point).map(|p| p.depth.map(|z| z as f32)).collect();
        let (transform, photometric) = (self.transform, self.exposure.photometric());
        Ok(Simulated { i1, i2, relative_blur, depth, transform, photometric })
    }

    /// Renders both images with occlusion.
    fn layered_pair(&self, views: &[View; 2], layers: Vec<Layer>, lens: &Lens) -> Result<[Frame; 2], Error> {
        let deviations =
            [0, 1].map(|image| layers.iter().map(|l| lens.signed_sigma(image, l.depth)).collect::<Vec<_>>());
        let first = self.layered(layers, deviations.iter().flatten())?;
        let second = first.changed(|layers| self.displace(layers, lens, 1.0));
        let image = |i: usize, layered: &Layered| self.exposed(i, &[layered.image(&views[i], &deviations[i])]);
        Ok([image(0, &first)?, image(1, &second)?])
    }

    /// Displaces layers as a camera sees them that has made a share of its movement.
    fn displace(&self, layers: &mut [Layer], lens: &Lens, share: f64) {
        let (near, far) = (lens.focus[0].min(lens.focus[1]), lens.focus[0].max(lens.focus[1]));
        for layer in layers {
            let nearness = (layer.depth.recip() - far.recip()) / (near.recip() - far.recip());
            layer.displace(self.camera_moves.map(|px| share * px * (nearness - 0.5)));
        }
    }

    /// Prepares layers for blur of these standard deviations, px.
    fn layered<'a>(&self, layers: Vec<Layer>, deviations: impl Iterator<Item = &'a f64>) -> Result<Layered, Error> {
        check_widest(deviations.map(|d| d * d))?;
        Ok(Layered::new(layers, self.seed, [self.width, self.height], self.base_blur, self.kernel))
    }

    /// Renders each channel of an image without occlusion. `variance` is that of the blur at a position of I1, px² of
    /// I1.
    fn gathered(
        &self,
        view: &View,
        variance: impl Fn([f64; 2]) -> f64 + Sync,
        channels: &[Pattern],
    ) -> Result<Vec<Vec<f64>>, Error> {
        let (size, width) = ([self.width, self.height], self.width as usize);
        // On the sensor the same blur has s² times the variance.
        let own = view.scale.powi(2);
        let variances = fill_rows(size, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = own * (self.base_blur + variance(view.place([x as f64, y as f64])));
            }
        });
        let largest = check_widest(variances.iter().copied())?;
        let rules = Rules::new(self.kernel, largest.sqrt());
        let render = |pattern: &Pattern| {
            fill_rows(size, |y, values| {
                pattern.fill(self.kernel, &rules, &view.row(y, &variances[y * width..][..width]), values);
            })
        };
        Ok(channels.iter().map(render).collect())
    }

    /// The view of I1, image 0, or of I2, image 1.
    fn exposed(&self, image: usize, planes: &[Vec<f64>]) -> Result<Frame, Error> {
        self.expose(image, if image == 0 { Exposure::default() } else { self.exposure }, |_| 1.0, planes)
    }

    /// Applies contrast, `light` at each pixel, exposure, and the noise of the image of this number. Channels are
    /// interleaved.
    fn expose(
        &self,
        image: usize,
        Exposure { gain, offset }: Exposure,
        light: impl Fn(usize) -> f64,
        planes: &[Vec<f64>],
    ) -> Result<Frame, Error> {
        let mut random = Random::new(self.noise_seed.unwrap_or(self.seed), 10 + image as u64);
        let mut samples = Vec::with_capacity(planes.len() * planes[0].len());
        for i in 0..planes[0].len() {
            let gain = gain * light(i);
            for plane in planes {
                let intensity = 0.5 + self.contrast * (plane[i] - 0.5);
                let noise = if self.noise > 0.0 { self.noise * random.normal() } else { 0.0 };
                samples.push((gain * intensity + offset + noise) as f32);
            }
        }
        let channels = if planes.len() == 1 { Channels::Gray } else { Channels::Rgb };
        Frame::new(self.width, self.height, channels, Samples::F32(samples)).map_err(Error::Mismatch)
    }
}

/// The largest of the variances of a blur, px² of its own image. An error if it cannot be rendered.
fn check_widest(variances: impl Iterator<Item = f64>) -> Result<f64, Error> {
    let largest = variances.fold(0.0, f64::max);
    range("largest variance of the blur", largest, 0.0, MOST_VARIANCE).map(|()| largest)
}

fn range(name: &'static str, value: f64, low: f64, high: f64) -> Result<(), Error> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(Error::Setting { name, value, range: format!("{low} to {high}") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::centre;

    fn values(frame: &Frame) -> &[f32] {
        match frame.samples() {
            Samples::F32(values) => values,
            other => panic!("{other:?}"),
        }
    }

    fn sharp(radiance: Radiance, transform: Similarity) -> Scene {
        let shape = Shape::Plane { limit: 0.0 };
        Scene { width: 65, height: 65, base_blur: 0.0, shape, radiance, transform, ..Preset::Plane.scene() }
    }

    /// With V = 0, `I2(T x) = I1(x)` for each T that maps pixels to pixels: right angles, 3-4-5 triangles, and shifts.
    #[test]
    fn where_blur_is_equal_the_images_agree_under_every_similarity() {
        let triangle = (0.6f64).acos().to_degrees();
        let shapes = [(0.0, 0.0, 0.0, 1.0), (3.0, -2.0, 0.0, 1.0), (1.0, 2.0, 90.0, 1.0), (-4.0, 1.0, 270.0, 2.0)];
        let more = [(2.0, -1.0, triangle, 5.0), (0.0, 3.0, -triangle, 5.0), (1.0, 0.0, 180.0, 0.5)];
        for (tx, ty, degrees, scale) in shapes.into_iter().chain(more) {
            let t = Similarity::new(tx, ty, degrees, scale);
            for radiance in [Radiance::Texture, Radiance::Dots] {
                let pair = sharp(radiance, t).render().unwrap();
                let (i1, i2) = (values(&pair.i1), values(&pair.i2));
                let mut compared = 0;
                for (i, value) in i1.iter().enumerate() {
                    let [x, y] = t.apply([(i % 65) as f64, (i / 65) as f64], centre(65, 65));
                    let whole = (x - x.round()).abs() < 1e-9 && (y - y.round()).abs() < 1e-9;
                    let (x, y) = (x.round(), y.round());
                    if whole && (0.0..65.0).contains(&x) && (0.0..65.0).contains(&y) {
                        compared += 1;
                        let other = i2[y as usize * 65 + x as usize];
                        assert!((value - other).abs() < 1e-6, "{t:?} at ({x}, {y}): {value} and {other}");
                    }
                }
                assert!(compared > 100, "{t:?}: {compared}");
            }
        }
    }

    /// A symmetric kernel commutes with the similarity: blur of equal variance on I1's grid keeps the images equal. An
    /// asymmetric kernel does not, since it is oriented with its own sensor.
    #[test]
    fn equal_blur_on_the_grid_of_i1_stays_equal_under_scale_and_rotation() {
        let t = Similarity::new(0.0, 0.0, 90.0, 2.0);
        for (kernel, equal) in [(Kernel::Gaussian, true), (Kernel::Pillbox, true), (Kernel::HalfGaussian, false)] {
            let pair = Scene { base_blur: 2.0, kernel, ..sharp(Radiance::Texture, t) }.render().unwrap();
            let at = |frame: &Frame, x: usize, y: usize| values(frame)[y * 65 + x];
            let worst = (0..16)
                .flat_map(|i| (0..16).map(move |j| (i, j)))
                .map(|(i, j)| {
                    let (x, y) = (24 + i, 24 + j);
                    let [u, v] = t.apply([x as f64, y as f64], centre(65, 65));
                    (at(&pair.i1, x, y) - at(&pair.i2, u.round() as usize, v.round() as usize)).abs()
                })
                .fold(0.0, f32::max);
            assert_eq!(worst < 1e-6, equal, "{kernel:?}: {worst}");
        }
    }

    #[test]
    fn the_seed_determines_all_and_noise_has_its_standard_deviation() {
        let scene = Scene { width: 48, height: 32, noise: 0.01, ..Preset::Relief.scene() };
        let pair = scene.render().unwrap();
        assert_eq!(pair, scene.render().unwrap());
        let other = Scene { seed: 2, ..scene.clone() }.render().unwrap();
        assert!(other.i1 != pair.i1 && other.relative_blur != pair.relative_blur);
        let again = Scene { noise_seed: Some(2), ..scene.clone() }.render().unwrap();
        assert!(again.i1 != pair.i1 && again.relative_blur == pair.relative_blur);
        let clean = Scene { noise: 0.0, ..scene }.render().unwrap();
        for (a, b) in [(&pair.i1, &clean.i1), (&pair.i2, &clean.i2)] {
            let squares = values(a).iter().zip(values(b)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            let deviation = (squares / (48.0 * 32.0)).sqrt();
            assert!((deviation / 0.01 - 1.0).abs() < 0.1, "{deviation}");
        }
    }

    #[test]
    fn the_photometric_of_an_exposure_undoes_it() {
        let plain = Scene { width: 32, height: 32, ..Preset::Plane.scene() };
        let exposed = Scene { exposure: Exposure { gain: 0.9, offset: 0.05 }, ..plain.clone() }.render().unwrap();
        let (plain, p) = (plain.render().unwrap(), exposed.photometric);
        assert!((p.gain - 1.0 / 0.9).abs() < 1e-12 && (p.offset + 0.05 / 0.9).abs() < 1e-12);
        assert_eq!(exposed.i1, plain.i1);
        for (a, b) in values(&exposed.i2).iter().zip(values(&plain.i2)) {
            assert!((p.gain * f64::from(*a) + p.offset - f64::from(*b)).abs() < 1e-6);
        }
    }

    #[test]
    fn no_preset_clips_and_contrast_scales_around_the_middle() {
        for preset in Preset::ALL {
            let scene = Scene { width: 64, height: 64, ..preset.scene() };
            let pair = scene.render().unwrap();
            for frame in [&pair.i1, &pair.i2] {
                assert!(values(frame).iter().all(|v| (0.02..=0.98).contains(v)), "{}", scene.name);
            }
            assert_eq!(pair.depth.is_some(), preset.scene().lens().is_some());
            let half = Scene { contrast: 0.45, ..scene }.render().unwrap();
            assert!((values(&half.i1)[77] - 0.5 - 0.5 * (values(&pair.i1)[77] - 0.5)).abs() < 1e-6);
        }
    }

    #[test]
    fn the_lens_determines_blur_and_depth() {
        let scene = Scene { width: 64, height: 64, ..Preset::Cylinders.scene() };
        let (pair, lens) = (scene.render().unwrap(), *scene.lens().unwrap());
        assert!((scene.transform.scale - lens.breathing()).abs() < 1e-12);
        for (v, z) in pair.relative_blur.iter().zip(pair.depth.as_ref().unwrap()) {
            assert!((lens.relative_blur(f64::from(*z), lens.breathing()) - f64::from(*v)).abs() < 1e-3);
        }
    }

    #[test]
    fn an_error_names_the_field_that_is_out_of_range() {
        let plane = || Preset::Plane.scene();
        let cases = [
            (Scene { width: 8, ..plane() }, "8x256 is too small"),
            (Scene { width: 1 << 20, height: 1 << 20, ..plane() }, "number of pixels"),
            (Scene { noise: -0.1, ..plane() }, "noise is -0.1"),
            (Scene { noise: f64::NAN, ..plane() }, "noise"),
            (Scene { contrast: 0.0, ..plane() }, "contrast"),
            (Scene { shape: Shape::Plane { limit: 1e9 }, ..plane() }, "largest relative blur"),
            (Scene { transform: Similarity::new(0.0, 0.0, 0.0, 0.0), ..plane() }, "scale"),
            (Scene { exposure: Exposure { gain: 0.0, offset: 0.0 }, ..plane() }, "gain of I2"),
        ];
        for (scene, part) in cases {
            let problem = scene.render().unwrap_err().to_string();
            assert!(problem.contains(part), "{problem}");
        }
        let lens = Lens { f_number: 0.01, ..*Preset::Cylinders.scene().lens().unwrap() };
        let blurred = Scene { shape: Shape::Cylinders { lens }, ..plane() };
        assert!(blurred.render().unwrap_err().to_string().contains("largest variance"));
    }
}
